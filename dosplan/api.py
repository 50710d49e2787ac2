"""What a plug-in implements: one method of ``Planner`` or of ``Predictor``.

The public methods ``reset``, ``plan`` and ``predict`` belong to the benchmark: they check what a
plug-in returns and name the plug-in in error messages, so that no plug-in has to. A class
that overrides one of them is refused. A plug-in fills ``compute_plan`` or ``compute_occupancy``
and, where it prepares something per episode, ``prepare``. Traffic, a third kind of plug-in, is in
``dosplan.simulation.traffic``.

The options of a plug-in are the fields of a frozen dataclass, its ``settings``. Every field has a
default, and ``__post_init__`` raises ``ValueError`` for a value out of range, in a message that
names the field. A field may be another plug-in, as a ``PluginSpec``.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar, final

import numpy as np

from dosplan.system.errors import DosplanError
from dosplan.types import (
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    Tracks,
)
from dosplan.types.arrays import EGO_COLUMNS
from dosplan.vehicle import VehicleParameters

START_TOLERANCE = 1e-6  # How far a plan's first state may be off the present one, m and rad.


class PluginError(DosplanError, RuntimeError):
    """A plug-in broke its contract; the message names it."""


class NoPlanError(DosplanError, RuntimeError):
    """A planner found no plan and has no fallback: it reports its failure.

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


def _elsewhere(start: FloatArray, observation: Observation) -> str:
    """How a plan's first state differs from the ego's."""
    ego = observation.ego
    if np.allclose(start[:2], observation.task.vehicle.centre(ego), 0.0, START_TOLERANCE):
        return "the plan starts at the ego's centre, not at its rear axle"
    column = int(np.argmax(np.abs(start - ego)))
    name = ("x", "y", "steering angle", "velocity", "heading")[column]
    return (
        f"the plan starts {abs(start[column] - ego[column]):.3g} away from the ego's state, its "
        f"{name} is {start[column]:.6g}, that of the ego {ego[column]:.6g}"
    )


@dataclass(frozen=True)
class NoSettings:
    """The settings of a planner or a traffic that has no options."""


@dataclass(frozen=True)
class DeadlineSettings:
    """The settings of a planner that can keep a deadline inherit from it.

    Attributes:
        deadline: Wall-clock time after which the planner takes the best plan that it has, s. None
            leaves it to the loop: none, or a share of its period where the loop charges the time
            that plans take.
    """

    deadline: float | None = None

    def __post_init__(self) -> None:
        if self.deadline is not None and not 0.0 < self.deadline < math.inf:
            raise ValueError(f"deadline is {self.deadline}, expected more than 0, or None")


@dataclass(frozen=True)
class PredictorSettings:
    """The options of every predictor; the settings of a predictor inherit from it.

    Attributes:
        horizon: Number T of steps to predict.
    """

    horizon: int = 40

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise ValueError(f"horizon is {self.horizon}, expected 1 or more")

    def seen_by(self, *, exact: bool) -> Self:
        """Settles what is left to the loop that the predictor is used in; nothing by default.

        Args:
            exact: Whether the road users that are seen are seen as they are.

        Returns:
            The settings for such a loop; a run writes down these.
        """
        return self

    def check_reach(self, base: PluginSpec[Predictor], name: str = "base") -> None:
        """For ``__post_init__``: refuses a nested predictor with a shorter horizon.

        Args:
            base: The nested predictor.
            name: The setting that holds it.

        Raises:
            ValueError: It predicts fewer steps.
        """
        if base.settings.horizon < self.horizon:
            raise ValueError(
                f"{name} predicts {base.settings.horizon} steps, horizon is {self.horizon}; "
                f"raise {name}.horizon as well"
            )


PluginT = TypeVar("PluginT", bound="Planner | Predictor")


@dataclass(frozen=True)
class PluginSpec(Generic[PluginT]):
    """A plug-in that is not built yet; a value of settings, where one plug-in uses another.

    A field of settings declares it as ``base: PluginSpec[Predictor] = PluginSpec(MyPredictor)``.
    A user then sets a name, ``{predictor: NAME, options: {...}}``, or one of its options as
    ``base.NAME``.

    Attributes:
        plugin: Its class.
        settings: An instance of the class's ``settings``; the defaults where None is given.
    """

    plugin: type[PluginT]
    settings: Any = None

    def __post_init__(self) -> None:
        if self.settings is None:
            object.__setattr__(self, "settings", self.plugin.settings())

    def build(self, seed: int = 0, **others: int) -> PluginT:
        """Makes the plug-in.

        Args:
            seed: Seed of the run.
            **others: What else its constructor takes, such as the future of a traffic.

        Returns:
            A new instance.
        """
        return self.plugin(seed=seed, settings=self.settings, **others)


class Planner(ABC):
    """Drives the ego.

    Attributes:
        name: Versioned name that goes into results (``mpc-v12``); a changed behaviour is a new
            version.
        settings: In the class the frozen dataclass of its options, in an instance its own ones.
        look_ahead: Number of predicted steps that it needs; a predictor with a shorter horizon is
            refused. A planner whose settings decide on it assigns it in its constructor.
        plan_steps: Number of steps that each of its plans lasts at least, assigned likewise; a loop
            that drives further from one plan is refused before anything is driven. None where
            it is not known: then an episode fails where a plan does not last.
        last_seconds: Wall-clock time of the last ``plan``, s.
    """

    name: ClassVar[str]
    settings: Any = NoSettings
    look_ahead: int = 1
    plan_steps: int | None = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        _refuse_overrides(cls, Planner, {"reset": "prepare", "plan": "compute_plan"})

    def __init__(self, *, seed: int = 0, settings: Any = NoSettings()) -> None:
        """Keeps the seed; every random choice of a planner must come from it.

        Args:
            seed: Seed of the run.
            settings: The options.
        """
        self.seed = seed
        self.settings = settings
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
            PluginError: The sets do not reach ``look_ahead`` steps ahead, or the plug-in returned
                something that is not such a plan, or one of fewer than ``plan_steps`` steps.
        """
        if occupancy.horizon < self.look_ahead:
            raise PluginError(
                f"planner {self.name}: looks {self.look_ahead} steps ahead, the sets reach "
                f"{occupancy.horizon}; raise the predictor's horizon"
            )
        started = time.perf_counter()
        try:
            plan = self.compute_plan(observation, occupancy)
        finally:
            self.last_seconds = time.perf_counter() - started
        if not isinstance(plan, Plan):
            raise PluginError(
                f"planner {self.name}: compute_plan returned {type(plan).__name__}, not a Plan"
            )
        if np.max(np.abs(plan.states[0] - observation.ego)) > START_TOLERANCE:
            raise PluginError(
                f"planner {self.name}: {_elsewhere(plan.states[0], observation)}; Plan.states[0] "
                f"must be observation.ego: {EGO_COLUMNS}"
            )
        if self.plan_steps is not None and len(plan.inputs) < self.plan_steps:
            raise PluginError(
                f"planner {self.name}: the plan holds {len(plan.inputs)} inputs, plan_steps says "
                f"{self.plan_steps} or more; lower it, or plan further"
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
    """Predicts where road users will be.

    Attributes:
        name: Versioned name that goes into results (``constant-velocity-v1``).
        settings: In the class the frozen dataclass of its options, a ``PredictorSettings``; in an
            instance its own ones.
        has_sets: Whether its sets have an extent. Where it predicts points, both arms drive alike,
            and a sweep drives one.
        horizon: Number T of steps that it predicts.
        last_seconds: Wall-clock time of the last ``predict``, s.
    """

    name: ClassVar[str]
    settings: Any = PredictorSettings
    has_sets: ClassVar[bool] = True

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        _refuse_overrides(cls, Predictor, {"reset": "prepare", "predict": "compute_occupancy"})

    def __init__(self, *, seed: int = 0, settings: PredictorSettings = PredictorSettings()) -> None:
        """Keeps the seed and the horizon.

        Args:
            seed: Seed of the run.
            settings: The options.
        """
        self.seed = seed
        self.settings = settings
        self.horizon = settings.horizon
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
        if not self.has_sets and np.any(occupancy.semi_axes):
            raise PluginError(
                f"predictor {self.name}: its sets have an extent; set has_sets = True"
            )
        return occupancy

    def weight_files(self) -> tuple[Path, ...]:
        """Lists the files of trained weights that it uses.

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
