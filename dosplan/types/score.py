"""The score of one episode: its outcome and metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any

from dosplan.types.episode import Arm, EpisodeKey, ScenarioFuture

Measure = float | int | bool | None
"""Value of a metric in one episode; None where the episode has none."""


class Outcome(StrEnum):
    """Outcome of an episode: the first that applies, in this order.

    ``UNUSABLE`` and ``TRAFFIC_FAILURE`` are no outcomes of a planner: nobody could drive the
    scenario, so it was not driven, or the traffic failed before anything else had happened.
    """

    UNUSABLE = "unusable"

    COLLISION = "collision"
    OUT_OF_BOUNDS = "out_of_bounds"
    PLANNER_FAILURE = "planner_failure"
    TRAFFIC_FAILURE = "traffic_failure"
    GOAL_MISSED = "goal_missed"
    SUCCESS = "success"

    @property
    def of_planner(self) -> bool:
        """Whether the planner is judged by it."""
        return self not in (Outcome.UNUSABLE, Outcome.TRAFFIC_FAILURE)


class CollisionClass(StrEnum):
    """nuPlan's classes of a collision, in the order they are tried."""

    STOPPED_EGO = "stopped_ego"
    STOPPED_TRACK = "stopped_track"
    ACTIVE_REAR = "active_rear"
    ACTIVE_FRONT = "active_front"
    ACTIVE_LATERAL = "active_lateral"


@dataclass(frozen=True)
class Score:
    """Outcome and metrics of one episode: the columns of a row of ``scenarios.jsonl``.

    The defaults are those of an episode that never drove a step.

    Attributes:
        scenario: Id of the scenario.
        arm: The arm.
        outcome: Outcome of the episode.
        safe: Driven to the end without collision and within bounds (the paper's success).
        at_fault: Whether the ego is at fault in a collision; False without one.
        collision_class: Class of the first collision, or None.
        collision_with: Id of the road user of the first collision, or None.
        collision_step: Step of the first contact, or None.
        out_of_bounds_step: First step off the drivable area, or None.
        goal_step: Step at which the goal was reached, or None.
        velocity: Mean ego speed over the steps driven, m/s.
        progress: Distance driven along the reference path, m.
        steps: Steps driven.
        comfortable: Whether every one of nuPlan's comfort bounds holds.
        max_abs_acceleration: Largest |longitudinal acceleration|, m/s2.
        max_abs_lateral_acceleration: Largest |lateral acceleration|, m/s2.
        max_abs_jerk: Largest |longitudinal jerk|, m/s3.
        min_time_to_collision: Smallest time to collision under constant velocities, s;
            None where none is below the horizon.
        cycle_ms_p50: Median time of a full cycle (predict and plan), ms.
        cycle_ms_p99: 99th percentile of it, ms.
        fallback_cycles: Cycles in which a fallback was driven.
        error: What went wrong in a failure of the planner or the traffic, or why the scenario is
            unusable: its file and the reason; None otherwise.
        traffic: Name of the traffic; ``replay`` in rows of versions without it.
        future: Which continuation of the scenario's past was driven; 0 where there is one.
        loop: Name of the loop; ``ideal`` in rows of versions without it.
        measures: Values of the metrics that are measured on the episode, by name
            (``dosplan.scoring.metrics``); None too where a row of an earlier version lacks one.
    """

    scenario: str
    arm: Arm
    outcome: Outcome
    safe: bool = False
    at_fault: bool = False
    collision_class: CollisionClass | None = None
    collision_with: int | None = None
    collision_step: int | None = None
    out_of_bounds_step: int | None = None
    goal_step: int | None = None
    velocity: float = 0.0
    progress: float = 0.0
    steps: int = 0
    comfortable: bool = True
    max_abs_acceleration: float = 0.0
    max_abs_lateral_acceleration: float = 0.0
    max_abs_jerk: float = 0.0
    min_time_to_collision: float | None = None
    cycle_ms_p50: float | None = None
    cycle_ms_p99: float | None = None
    fallback_cycles: int = 0
    error: str | None = None
    traffic: str = "replay"
    future: int = 0
    loop: str = "ideal"
    measures: Mapping[str, Measure] = field(default_factory=dict)

    @property
    def key(self) -> EpisodeKey:
        """Which episode of the run it is of."""
        return EpisodeKey(self.scenario, self.arm, self.future)

    @property
    def scenario_future(self) -> ScenarioFuture:
        """What was driven, whatever the arm: rows that agree in it are compared."""
        return ScenarioFuture(self.scenario, self.future)

    def columns(self) -> dict[str, Any]:
        """The row as it is written: its fields, with ``measures`` flattened into it."""
        own = {column.name: getattr(self, column.name) for column in fields(self)}
        del own["measures"]
        return {**own, **self.measures}
