"""How one closed-loop run is judged: its outcome and metrics."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dosplan.types.episode import Arm


class Outcome(StrEnum):
    """What became of an episode: the first that applies, in this order."""

    COLLISION = "collision"
    OUT_OF_BOUNDS = "out_of_bounds"
    PLANNER_FAILURE = "planner_failure"
    GOAL_MISSED = "goal_missed"
    SUCCESS = "success"


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

    Attributes:
        scenario: Id of the scenario.
        arm: The arm.
        outcome: What became of the episode.
        safe: Driven to the end without collision and within bounds (the paper's success).
        at_fault: Whether the ego is to blame for a collision; False without one.
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
            None where none is below the horizon that is looked at.
        cycle_ms_p50: Median time of a full cycle (predict and plan), ms.
        cycle_ms_p99: 99th percentile of it, ms.
        fallback_cycles: Cycles in which a fallback was driven.
        error: What went wrong in a planner failure, or None.

    The solver's columns are None where no cycle ran, and in rows of versions without them:

        iterations_p50: Median of the solver's iterations in a cycle.
        iterations_max: The most of them in a cycle.
        max_slack: Largest slack of a set constraint, in normalised set distance.
        slack_cycles: Cycles whose plan enters a set (``dosplan.scoring.solver.SLACK_SEEN``).
        max_road_slack: How far a plan leaves the road at most, m.
        solver_failures: Cycles in which the solver gave no plan.

    And, ``replay`` in rows of versions without it:

        traffic: Name of the traffic.
    """

    scenario: str
    arm: Arm
    outcome: Outcome
    safe: bool
    at_fault: bool
    collision_class: CollisionClass | None
    collision_with: int | None
    collision_step: int | None
    out_of_bounds_step: int | None
    goal_step: int | None
    velocity: float
    progress: float
    steps: int
    comfortable: bool
    max_abs_acceleration: float
    max_abs_lateral_acceleration: float
    max_abs_jerk: float
    min_time_to_collision: float | None
    cycle_ms_p50: float | None
    cycle_ms_p99: float | None
    fallback_cycles: int
    error: str | None
    iterations_p50: float | None = None
    iterations_max: int | None = None
    max_slack: float | None = None
    slack_cycles: int | None = None
    max_road_slack: float | None = None
    solver_failures: int | None = None
    traffic: str = "replay"
