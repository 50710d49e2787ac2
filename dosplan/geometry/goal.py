"""Whether the ego has reached a goal: CommonRoad's semantics, shared by simulation and scoring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import shapely

from dosplan.geometry import wrap_angle
from dosplan.types import FloatArray, GoalState

TOLERANCE: Final = 1e-6
"""Slack on every bound (m, rad, m/s), so that rounding does not turn a closed interval open."""


def goal_reached(
    goals: tuple[GoalState, ...], step: int, centre: FloatArray, heading: float, velocity: float
) -> bool:
    """Tells whether one of the alternative goals is reached.

    All intervals are closed, a region contains its border, and headings are compared modulo a
    full turn, as in ``GoalRegion.is_reached`` of commonroad-io. Bounds are widened by
    ``TOLERANCE``.

    Args:
        goals: Alternative goals; every part of a goal that is set must hold.
        step: The step of the ego state.
        centre: (2,) centre of the ego's rectangle, m.
        heading: Heading of the ego, rad, wrapped or not.
        velocity: m/s.

    Returns:
        True where at least one goal holds.
    """
    return any(goal_miss(goal, step, centre, heading, velocity).holds for goal in goals)


@dataclass(frozen=True)
class GoalMiss:
    """By how much a state misses a goal; a part that holds is zero.

    Attributes:
        steps: Positive where the goal has ceased to count, negative where it does not count yet.
        distance: Distance of the ego's centre to the region, m.
        heading: Turn beyond the interval, rad, counter-clockwise positive.
        velocity: Velocity beyond the interval, m/s; positive where the ego is too fast.
    """

    steps: int
    distance: float
    heading: float
    velocity: float

    @property
    def holds(self) -> bool:
        """Whether the goal is reached."""
        parts = (self.distance, abs(self.heading), abs(self.velocity))
        return self.steps == 0 and max(parts) <= TOLERANCE


def goal_miss(
    goal: GoalState, step: int, centre: FloatArray, heading: float, velocity: float
) -> GoalMiss:
    """Measures what keeps the ego from a goal.

    Args:
        goal: The goal.
        step: The step of the ego state.
        centre: (2,) centre of the ego's rectangle, m.
        heading: Heading of the ego, rad, wrapped or not.
        velocity: m/s.

    Returns:
        The misses; a part that the goal does not set is zero.
    """
    turned = 0.0
    if goal.heading is not None:
        # Relative to the middle of the interval, so that one across +-pi is no special case.
        lower, upper = goal.heading
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        turned = _beyond(float(wrap_angle(heading - middle)), -half, half)
    return GoalMiss(
        steps=int(_beyond(step, goal.first_step, goal.last_step)),
        distance=0.0
        if goal.region is None
        else float(shapely.distance(goal.region, shapely.Point(centre))),
        heading=turned,
        velocity=0.0 if goal.velocity is None else _beyond(velocity, *goal.velocity),
    )


def _beyond(value: float, lower: float, upper: float) -> float:
    return value - min(max(value, lower), upper)
