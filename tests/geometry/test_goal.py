"""Goals: closed intervals, headings modulo a full turn, borders that belong to the region."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from dosplan.geometry.goal import TOLERANCE, goal_reached
from dosplan.types import GoalState

ORIGIN = np.zeros(2)
SQUARE = shapely.box(-1.0, -1.0, 1.0, 1.0)


@pytest.mark.parametrize(("step", "reached"), [(9, False), (10, True), (20, True), (21, False)])
def test_steps_are_a_closed_interval(step: int, reached: bool) -> None:
    assert goal_reached((GoalState(10, 20),), step, ORIGIN, 0.0, 0.0) is reached


@pytest.mark.parametrize(
    ("velocity", "reached"), [(2.999, False), (3.0, True), (5.0, True), (5.001, False)]
)
def test_velocity_is_a_closed_interval(velocity: float, reached: bool) -> None:
    goals = (GoalState(0, 9, velocity=(3.0, 5.0)),)
    assert goal_reached(goals, 0, ORIGIN, 0.0, velocity) is reached


@pytest.mark.parametrize(
    ("x", "reached"), [(0.0, True), (1.0, True), (1.0 + 0.5 * TOLERANCE, True), (1.001, False)]
)
def test_the_border_belongs_to_the_region(x: float, reached: bool) -> None:
    goals = (GoalState(0, 9, region=SQUARE),)
    assert goal_reached(goals, 0, np.array([x, 0.0]), 0.0, 0.0) is reached


def test_a_region_may_have_several_parts() -> None:
    parts = shapely.MultiPolygon([SQUARE, shapely.box(5.0, 5.0, 6.0, 6.0)])
    goals = (GoalState(0, 9, region=parts),)
    assert goal_reached(goals, 0, np.array([5.5, 5.5]), 0.0, 0.0)
    assert not goal_reached(goals, 0, np.array([3.0, 3.0]), 0.0, 0.0)


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
@pytest.mark.parametrize(
    ("bounds", "inside", "outside"),
    [
        ((-0.1, 0.1), (-0.1, 0.0, 0.1), (-0.11, 0.11, np.pi)),
        # Across the cut at pi.
        ((3.0, 3.4), (3.0, np.pi, 3.4), (2.99, 3.41, 0.0)),
        ((-3.4, -3.0), (-3.4, -3.0, np.pi), (-3.41, -2.99, 0.0)),
        ((-np.pi, np.pi), (-np.pi, 0.0, np.pi, 2.0), ()),
    ],
)
def test_headings_count_modulo_a_full_turn(
    bounds: tuple[float, float],
    inside: tuple[float, ...],
    outside: tuple[float, ...],
    turns: int,
) -> None:
    goals = (GoalState(0, 9, heading=bounds),)
    for heading in inside:
        assert goal_reached(goals, 0, ORIGIN, heading + 2.0 * np.pi * turns, 0.0)
    for heading in outside:
        assert not goal_reached(goals, 0, ORIGIN, heading + 2.0 * np.pi * turns, 0.0)


@given(
    lower=st.floats(-7.0, 7.0),
    width=st.floats(0.0, 6.0),
    share=st.floats(0.0, 1.0),
    turns=st.integers(-3, 3),
)
def test_a_heading_between_the_bounds_is_inside(
    lower: float, width: float, share: float, turns: int
) -> None:
    goals = (GoalState(0, 9, heading=(lower, lower + width)),)
    heading = lower + share * width + 2.0 * np.pi * turns
    assert goal_reached(goals, 0, ORIGIN, heading, 0.0)
    rest = 2.0 * np.pi - width
    assert not goal_reached(goals, 0, ORIGIN, lower - 0.5 * rest, 0.0)


def test_every_part_of_a_goal_must_hold_and_one_goal_is_enough() -> None:
    strict = GoalState(0, 9, SQUARE, heading=(-0.1, 0.1), velocity=(0.0, 1.0))
    assert goal_reached((strict,), 0, ORIGIN, 0.0, 0.5)
    assert not goal_reached((strict,), 0, ORIGIN, 0.2, 0.5)
    assert not goal_reached((strict,), 0, ORIGIN, 0.0, 1.5)
    assert not goal_reached((strict,), 0, np.array([2.0, 0.0]), 0.0, 0.5)
    assert goal_reached((strict, GoalState(0, 9)), 0, np.array([2.0, 0.0]), 0.2, 1.5)
