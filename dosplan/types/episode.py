"""What happened in one closed-loop run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np

from dosplan.types.arrays import (
    EGO_SIZE,
    USER_SIZE,
    FloatArray,
    IntArray,
    ShapeError,
    frozen,
)
from dosplan.types.lights import Signals
from dosplan.types.planning import Occupancy, Plan, SolveReport
from dosplan.types.scenario import Tracks


class Arm(StrEnum):
    """The two arms of the comparison; they differ in the ``Occupancy`` the planner is handed."""

    WITH_DOS = "with_dos"
    WITHOUT_DOS = "without_dos"


class ScenarioFuture(NamedTuple):
    """A scenario with one of its futures: what both arms and all planners meet.

    Attributes:
        scenario: Id of the scenario.
        future: Which continuation of its past; 0 where there is one.
    """

    scenario: str
    future: int = 0

    @property
    def title(self) -> str:
        """It in words; a future that is not the first is named."""
        return f"{self.scenario}, future {self.future}" if self.future else self.scenario


class EpisodeKey(NamedTuple):
    """Which episode of a run.

    Attributes:
        scenario: Id of the scenario.
        arm: The arm.
        future: Which continuation of the scenario's past; 0 where there is one.
    """

    scenario: str
    arm: Arm
    future: int = 0

    @property
    def title(self) -> str:
        """The episode in words; a future that is not the first is named."""
        future = f", future {self.future}" if self.future else ""
        return f"{self.scenario}, {self.arm}{future}"


class EpisodeEnd(StrEnum):
    """Why the simulation stopped."""

    GOAL_REACHED = "goal_reached"
    TIME_OVER = "time_over"
    PLANNER_FAILURE = "planner_failure"
    TRAFFIC_FAILURE = "traffic_failure"


@dataclass(frozen=True)
class Sightings:
    """What the ego saw of the road users, for each of C planning cycles; M sightings in all.

    Attributes:
        steps: (C,) step at which was seen what the cycle's plan is made from.
        cycle: (M,) index of the cycle.
        ids: (M,) id of the road user.
        states: (M, 4) road-user state as it was seen.
    """

    steps: IntArray
    cycle: IntArray
    ids: IntArray
    states: FloatArray

    def __post_init__(self) -> None:
        frozen(self, "steps", np.int64, (None,))
        frozen(self, "cycle", np.int64, (None,))
        m = len(self.cycle)
        frozen(self, "ids", np.int64, (m,))
        frozen(self, "states", np.float64, (m, USER_SIZE), finite=True)

    def of_cycle(self, cycle: int) -> dict[int, FloatArray]:
        """What the plan of a cycle was made of.

        Args:
            cycle: Row of the cycle.

        Returns:
            (4,) state by the id of each road user that was seen.
        """
        here = self.cycle == cycle
        return dict(zip(self.ids[here].tolist(), self.states[here], strict=True))


@dataclass(frozen=True)
class Episode:
    """Everything that happened in one closed-loop run.

    Attributes:
        scenario_id: Id of the scenario.
        arm: Which arm was driven.
        start_step: Step of the first state.
        states: (K + 1, 5) driven ego states.
        inputs: (K, 2) inputs that were applied.
        tracks: The road users as they were driven, aligned with the steps of the scenario.
        end: Why the simulation stopped.
        predict_seconds: (C,) wall-clock time of each prediction, s; C planning cycles.
        plan_seconds: (C,) wall-clock time of each plan, s.
        plans: The C plans.
        occupancies: The C occupancies that were handed to the planner.
        cycle_steps: (C,) step at which each plan begins: that of the planner's observation, which
            is later than what was seen by the loop's latency. The columns of its occupancy stand
            for the steps after it.
        error: What went wrong, where ``end`` is a failure.
        traffic: Name of the traffic.
        signals: The traffic lights as they were; None where that is as recorded.
        future: Which continuation of the scenario's past was driven.
        loop: Name of the loop, as ``dosplan.simulation.settings.loop_name`` gives it.
        sightings: What the ego saw; None where that is all there was, at the step of each cycle.
    """

    scenario_id: str
    arm: Arm
    start_step: int
    states: FloatArray
    inputs: FloatArray
    tracks: Tracks
    end: EpisodeEnd
    predict_seconds: FloatArray
    plan_seconds: FloatArray
    plans: tuple[Plan, ...]
    occupancies: tuple[Occupancy, ...]
    cycle_steps: IntArray
    error: str | None = None
    traffic: str = "replay"
    signals: Signals | None = None
    future: int = 0
    loop: str = "ideal"
    sightings: Sightings | None = None

    def __post_init__(self) -> None:
        frozen(self, "inputs", np.float64, (None, 2), finite=True)
        frozen(self, "states", np.float64, (len(self.inputs) + 1, EGO_SIZE), finite=True)
        c = len(self.plans)
        frozen(self, "predict_seconds", np.float64, (c,))
        frozen(self, "plan_seconds", np.float64, (c,))
        frozen(self, "cycle_steps", np.int64, (c,))
        if len(self.occupancies) != c:
            raise ShapeError(
                f"Episode.occupancies has {len(self.occupancies)} entries, expected {c}"
            )
        if self.sightings is not None and len(self.sightings.steps) != c:
            raise ShapeError(
                f"Episode.sightings is of {len(self.sightings.steps)} cycles, expected {c}"
            )

    @property
    def reports(self) -> tuple[SolveReport, ...]:
        """The reports of the C plans."""
        return tuple(plan.report for plan in self.plans)


class DrivenEpisode(Protocol):
    """What a score is computed from, besides the road users: an ``Episode`` or its file's content.

    The attributes are those of ``Episode``.
    """

    @property
    def scenario_id(self) -> str:
        """Id of the scenario."""

    @property
    def arm(self) -> Arm:
        """Which arm was driven."""

    @property
    def traffic(self) -> str:
        """Name of the traffic."""

    @property
    def loop(self) -> str:
        """Name of the loop."""

    @property
    def signals(self) -> Signals | None:
        """The traffic lights as they were; None where that is as recorded."""

    @property
    def future(self) -> int:
        """Which continuation of the scenario's past was driven."""

    @property
    def start_step(self) -> int:
        """Step of the first state."""

    @property
    def states(self) -> FloatArray:
        """(K + 1, 5) driven ego states."""

    @property
    def end(self) -> EpisodeEnd:
        """Why the simulation stopped."""

    @property
    def error(self) -> str | None:
        """What went wrong in a failure of the planner or the traffic, or None."""

    @property
    def cycle_steps(self) -> IntArray:
        """(C,) step at which each plan begins."""

    @property
    def predict_seconds(self) -> FloatArray:
        """(C,) time of each prediction, s."""

    @property
    def plan_seconds(self) -> FloatArray:
        """(C,) time of each plan, s."""

    @property
    def reports(self) -> Sequence[SolveReport]:
        """The reports of the C plans."""
