"""What a plug-in implements: one method of ``Planner`` or of ``Predictor``.

The public methods ``reset``, ``plan`` and ``predict`` belong to the benchmark: they check what a
plug-in returns and name the plug-in in every complaint, so that no plug-in can forget to. A class
that overrides one of them is refused. A plug-in fills ``compute_plan`` or ``compute_occupancy``
and, where it prepares something per episode, ``prepare``.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np

from dosplan.system.errors import DosplanError
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap, Tracks
from dosplan.vehicle import VehicleParameters

START_TOLERANCE = 1e-6  # How far a plan's first state may be off the present one, m and rad.


class PluginError(DosplanError, RuntimeError):
    """A plug-in broke its contract; the message names it."""


class NoPlanError(DosplanError, RuntimeError):
    """A planner found no plan and has none to fall back to: it declares its failure.

    The episode ends there as a planner failure.
    """


def _refuse_overrides(plugin: type, base: type, instead: Mapping[str, str]) -> None:
    """Raises TypeError where a plug-in overrides what belongs to the benchmark."""
    for method, hook in instead.items():
        if getattr(plugin, method) is not getattr(base, method):
            raise TypeError(
                f"{plugin.__name__} overrides {base.__name__}.{method}, which belongs to the "
                f"benchmark; override {hook} instead"
            )


class Planner(ABC):
    """Drives the ego.

    Attributes:
        name: Versioned name that goes into results (``mpc-v3``); a changed behaviour is a new
            version.
        settings: Dataclass of the options that a user may set; the constructor then takes an
            instance of it as ``settings``. Where None, options are keyword arguments.
        last_seconds: Wall-clock time of the last ``plan``, s.
    """

    name: ClassVar[str]
    settings: ClassVar[type[Any] | None] = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        _refuse_overrides(cls, Planner, {"reset": "prepare", "plan": "compute_plan"})

    def __init__(self, *, seed: int = 0) -> None:
        """Keeps the seed; every random choice of a planner must come from it.

        Args:
            seed: Seed of the run.
        """
        self.seed = seed
        self.last_seconds = 0.0

    @final
    def reset(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Begins an episode.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """
        self.prepare(task, road_map, vehicle)

    @final
    def plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Plans from the present state.

        Args:
            observation: What is known now.
            occupancy: Sets to keep out of, for the steps after ``observation.step``.

        Returns:
            A plan that starts at ``observation.ego``.

        Raises:
            PluginError: The plug-in returned something that is not such a plan.
        """
        started = time.perf_counter()
        try:
            plan = self.compute_plan(observation, occupancy)
        finally:
            self.last_seconds = time.perf_counter() - started
        if not isinstance(plan, Plan):
            raise PluginError(
                f"planner {self.name}: compute_plan returned {type(plan).__name__}, not a Plan"
            )
        gap = float(np.max(np.abs(plan.states[0] - observation.ego)))
        if gap > START_TOLERANCE:
            raise PluginError(
                f"planner {self.name}: the plan starts {gap:.3g} away from the ego's state; "
                "Plan.states[0] must be observation.ego"
            )
        return plan

    def prepare(  # noqa: B027 - an optional hook
        self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters
    ) -> None:
        """Hook for what a planner builds once per episode; does nothing by default.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """

    @abstractmethod
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Plans from the present state; what a planner implements.

        Args:
            observation: What is known now.
            occupancy: Sets to keep out of, for the steps after ``observation.step``.

        Returns:
            A plan whose first state is ``observation.ego``.

        Raises:
            NoPlanError: There is none.
        """


class Predictor(ABC):
    """Foresees where road users will be.

    Attributes:
        name: Versioned name that goes into results (``constant-velocity-v1``).
        settings: Dataclass of the options that a user may set; the constructor then takes an
            instance of it as ``settings``. Where None, options are keyword arguments.
        last_seconds: Wall-clock time of the last ``predict``, s.
    """

    name: ClassVar[str]
    settings: ClassVar[type[Any] | None] = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        _refuse_overrides(cls, Predictor, {"reset": "prepare", "predict": "compute_occupancy"})

    def __init__(self, *, seed: int = 0, horizon: int = 40) -> None:
        """Keeps the seed and the horizon.

        Args:
            seed: Seed of the run.
            horizon: Number T of steps to predict.
        """
        self.seed = seed
        self.horizon = horizon
        self.last_seconds = 0.0

    @final
    def reset(self, task: PlanningTask, road_map: RoadMap) -> None:
        """Begins an episode.

        Args:
            task: Start, goal and route of the ego.
            road_map: The map.
        """
        self.prepare(task, road_map)

    @final
    def predict(self, observation: Observation) -> Occupancy:
        """Predicts the sets of every road user that is on the scene.

        Args:
            observation: What is known now.

        Returns:
            Sets for the ``horizon`` steps after ``observation.step``.

        Raises:
            PluginError: The plug-in returned something else.
        """
        started = time.perf_counter()
        try:
            occupancy = self.compute_occupancy(observation)
        finally:
            self.last_seconds = time.perf_counter() - started
        if not isinstance(occupancy, Occupancy):
            raise PluginError(
                f"predictor {self.name}: compute_occupancy returned "
                f"{type(occupancy).__name__}, not an Occupancy"
            )
        if not np.array_equal(occupancy.ids, observation.ids):
            raise PluginError(
                f"predictor {self.name}: Occupancy.ids must be observation.ids, in their order; "
                "mark a road user that has no prediction with valid = False"
            )
        if occupancy.horizon != self.horizon:
            raise PluginError(
                f"predictor {self.name}: predicted {occupancy.horizon} steps, asked for "
                f"{self.horizon}"
            )
        return occupancy

    @classmethod
    def weight_files(cls) -> tuple[Path, ...]:
        """Names the files of trained numbers that it loads by default.

        Their SHA-256 goes into ``run.json``: a run with other weights is another run.

        Returns:
            The files; none by default.
        """
        return ()

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:  # noqa: B027 - a hook
        """Hook for what a predictor builds once per episode; does nothing by default.

        Args:
            task: Start, goal and route of the ego.
            road_map: The map.
        """

    @abstractmethod
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Predicts; what a predictor implements.

        Args:
            observation: What is known now.

        Returns:
            Sets of the road users of ``observation.ids``, in their order, for the
            ``self.horizon`` steps after ``observation.step``.
        """


class OraclePredictor(Predictor):
    """A predictor that is shown the future: an upper bound, refused in ranked runs."""

    @abstractmethod
    def reveal(self, tracks: Tracks) -> None:
        """Shows the recording, before ``reset``.

        Args:
            tracks: Every road user at every step, future included.
        """
