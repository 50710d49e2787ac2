"""Whether the ego has reached a goal: CommonRoad's semantics, shared by simulation and scoring."""

from __future__ import annotations

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
    return any(_holds(goal, step, centre, heading, velocity) for goal in goals)


def _holds(goal: GoalState, step: int, centre: FloatArray, heading: float, velocity: float) -> bool:
    if not goal.first_step <= step <= goal.last_step:
        return False
    if goal.velocity is not None and _outside(velocity, *goal.velocity):
        return False
    if goal.heading is not None:
        # Relative to the middle of the interval, so that one that spans +-pi needs no care.
        lower, upper = goal.heading
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        if _outside(float(wrap_angle(heading - middle)), -half, half):
            return False
    return goal.region is None or bool(
        shapely.dwithin(goal.region, shapely.Point(centre), TOLERANCE)
    )


def _outside(value: float, lower: float, upper: float) -> bool:
    return value < lower - TOLERANCE or value > upper + TOLERANCE
