"""The other road users while the ego drives: a replay, or road users that react.

A traffic hands over the past when an episode begins, and at each step the road users at that step.
It never hands over the future: what a planner or a predictor observes is made of what was handed
over so far (``dosplan.simulation.world``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dosplan.api import NoSettings
from dosplan.scenario import INTERACTIVE
from dosplan.scenario.futures import count_futures
from dosplan.types import (
    USER_SIZE,
    FloatArray,
    IntArray,
    LightStates,
    RoadUserKind,
    Scenario,
    ShapeError,
    Tracks,
)
from dosplan.types.arrays import frozen


@dataclass(frozen=True)
class RoadUsers:
    """The road users on the scene at one step.

    Attributes:
        ids: (N,) ids, unique; a road user keeps its id, and an id that was not there before is a
            road user that has come onto the scene.
        kinds: N kinds; each road user keeps its own.
        size: (N, 2) length and width, m; each road user keeps its own.
        states: (N, 4) road-user states.
        outlines: N polygons (V, 2) in the body frame, m, where the shape is not the rectangle of
            ``size``; None otherwise. All are rectangles where none is given.
    """

    ids: IntArray
    kinds: tuple[RoadUserKind, ...]
    size: FloatArray
    states: FloatArray
    outlines: tuple[FloatArray | None, ...] = ()

    def __post_init__(self) -> None:
        frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        frozen(self, "size", np.float64, (n, 2), finite=True)
        frozen(self, "states", np.float64, (n, USER_SIZE), finite=True)
        if len(set(self.ids.tolist())) != n:
            raise ShapeError("RoadUsers.ids names a road user twice")
        if not self.outlines:
            object.__setattr__(self, "outlines", (None,) * n)
        for name in ("kinds", "outlines"):
            if len(getattr(self, name)) != n:
                raise ShapeError(
                    f"RoadUsers.{name} has {len(getattr(self, name))} entries, expected {n}"
                )


class Traffic(ABC):
    """The other road users of an episode.

    A class of one's own is given to a run as ``--traffic file.py:Class``, or as an entry point of
    the group ``dosplan.traffic``.

    Attributes:
        name: Name that goes into results; a changed behaviour is a new name.
        settings: In the class the frozen dataclass of its options, in an instance its own ones.
        as_recorded: Whether all drive as recorded, whatever the ego does. The tracks of an
            episode are then those of the scenario's recorded future of that number, and only then
            may a predictor be shown them. A subclass does not inherit it, as it may depart from
            the recording.
        has_futures: Whether the future number changes what comes; only then may a run ask for
            several. A subclass does not inherit it, as it may drive one future only.
    """

    name: ClassVar[str]
    settings: Any = NoSettings
    as_recorded: ClassVar[bool] = False
    has_futures: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name in ("as_recorded", "has_futures"):
            if name not in vars(cls):
                setattr(cls, name, False)

    def __init__(self, *, seed: int = 0, settings: Any = NoSettings(), future: int = 0) -> None:
        """Keeps the seed and the future.

        Every random choice of a traffic must come from these two and the scenario, never from
        what was driven before, so that both arms and all planners meet the same road users.

        Args:
            seed: Seed of the run.
            settings: The options.
            future: Which continuation of the same past is driven, 0 or more. A run has future 0
                alone unless it asks for several.
        """
        self.seed = seed
        self.settings = settings
        self.future = future

    @classmethod
    def refuses(cls, scenario: Scenario) -> str | None:
        """Tells why it cannot drive a scenario; asked before anything is driven.

        Args:
            scenario: The scenario.

        Returns:
            What is wrong and what to do, in a line without the file's name; None where it can. By
            default, a scenario is refused of which nothing is recorded.
        """
        return INTERACTIVE if scenario.interactive else None

    @classmethod
    def futures_of(cls, scenario: Path) -> int | None:
        """Tells how many futures it has for a scenario; asked before a run of several.

        Args:
            scenario: The scenario file.

        Returns:
            Their number; None, as by default, where it has any number.

        Raises:
            ScenarioError: A file that tells it is damaged.
        """
        return None

    @classmethod
    def reads(cls, scenario: Path) -> Iterable[Path]:
        """Names the files that its road users come from, besides the scenario's own.

        A run cannot be resumed once one of them has changed.

        Args:
            scenario: The scenario file, which need not be one that can be used.

        Returns:
            The files; none by default.
        """
        return ()

    @classmethod
    def versions(cls) -> Mapping[str, str]:
        """Versions that its road users depend on, for ``run.json``; none by default.

        Returns:
            Versions by name.
        """
        return {}

    @abstractmethod
    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        """Begins an episode, and forgets the last one.

        Args:
            scenario: What is driven.
            first_step: Step at which the ego starts.

        Returns:
            All that have been on the scene until then, at the steps 0 to ``first_step``.
        """

    @abstractmethod
    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        """Moves the road users on by one step.

        Args:
            step: The step that is reached: ``first_step + 1``, then one more in each call.
            ego: (K + 1, 5) ego states from its start to this step. Its last row is where the ego
                is after this step. A road user that decides at the same time as the ego, and does
                not know its move, may use the rows before only. A single row is an ego that stays
                where it is.

        Returns:
            The road users on the scene at that step.
        """

    def close(self) -> None:  # noqa: B027 - a hook
        """Hook for what is to be let go, such as a process; does nothing by default.

        It is called once when an episode has ended, however that was, also where ``begin`` has
        failed. ``begin`` may come again after it.
        """

    def lights(self, step: int) -> LightStates | None:
        """Tells what the traffic lights show, where the traffic switches them itself.

        Args:
            step: The present step: ``first_step`` after ``begin``, then that of the last ``step``.

        Returns:
            The states of the same lights at every step; None, as by default, where they change as
            the scenario's file says.
        """
        return None


class Replay(Traffic):
    """All drive as recorded in that future; the scene is empty once the recording has ended."""

    name = "replay"
    as_recorded = True
    has_futures = True

    def __init__(
        self, *, seed: int = 0, settings: NoSettings = NoSettings(), future: int = 0
    ) -> None:
        """Makes it; nothing here is random.

        Args:
            seed: Seed of the run.
            settings: There are none.
            future: Which of the scenario's recorded futures is driven.
        """
        super().__init__(seed=seed, settings=settings, future=future)
        self._recording = empty_tracks(0)

    @classmethod
    def futures_of(cls, scenario: Path) -> int:
        """Counts the futures that are recorded of a scenario.

        Args:
            scenario: The scenario file.

        Returns:
            How many there are; 1 where it has no other than its recording.

        Raises:
            ScenarioError: The file of the others is damaged.
        """
        return count_futures(scenario)

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        """Begins an episode.

        Args:
            scenario: What is driven.
            first_step: Step at which the ego starts.

        Returns:
            What is recorded until then.

        Raises:
            ShapeError: The scenario has not so many recorded futures.
        """
        tracks = self._recording = scenario.recorded(self.future)
        begun = slice(0, first_step + 1)
        seen = np.flatnonzero(tracks.valid[:, begun].any(axis=1))
        after = max(first_step + 1 - tracks.steps, 0)  # Steps for which nothing is recorded.
        states = np.pad(
            tracks.states[seen, begun], ((0, 0), (0, after), (0, 0)), constant_values=np.nan
        )
        valid = np.pad(tracks.valid[seen, begun], ((0, 0), (0, after)))
        return Tracks(
            ids=tracks.ids[seen],
            kinds=tuple(tracks.kinds[i] for i in seen),
            size=tracks.size[seen],
            states=states,
            valid=valid,
            outlines=tuple(tracks.outlines[i] for i in seen),
        )

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        """Reads the next step of the recording.

        Args:
            step: The step that is reached.
            ego: Not used.

        Returns:
            The road users recorded at that step, in the recording's order.
        """
        tracks = self._recording
        if step >= tracks.steps:
            return RoadUsers(
                np.empty(0, dtype=np.int64), (), np.empty((0, 2)), np.empty((0, USER_SIZE))
            )
        return users_at(tracks, step)


def users_at(tracks: Tracks, step: int) -> RoadUsers:
    """The road users of tracks that are on the scene at a step.

    Args:
        tracks: The tracks.
        step: One of their steps.

    Returns:
        The road users, in the tracks' order.
    """
    present = np.flatnonzero(tracks.valid[:, step])
    return RoadUsers(
        ids=tracks.ids[present],
        kinds=tuple(tracks.kinds[i] for i in present),
        size=tracks.size[present],
        states=tracks.states[present, step],
        outlines=tuple(tracks.outlines[i] for i in present),
    )


def empty_tracks(steps: int) -> Tracks:
    """The tracks of an empty scene.

    Args:
        steps: Number of steps.

    Returns:
        Tracks of no road user.
    """
    return Tracks(
        ids=np.empty(0, dtype=np.int64),
        kinds=(),
        size=np.empty((0, 2)),
        states=np.empty((0, steps, USER_SIZE)),
        valid=np.empty((0, steps), dtype=np.bool_),
    )
