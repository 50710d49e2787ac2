"""Ellipses against known answers, bounds and brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.geometry import (
    ellipse_area,
    ellipse_extent,
    inside_ellipse,
    mahalanobis,
    set_sizes,
)
from dosplan.types import Occupancy

LENGTH = st.floats(0.1, 50.0)
ANGLE = st.floats(-10.0, 10.0)
PLACE = st.floats(-100.0, 100.0)


@given(PLACE, PLACE, LENGTH, LENGTH, ANGLE, ANGLE, st.floats(0.0, 20.0))
def test_distance_is_the_factor_that_brings_the_boundary_to_the_point(
    x: float, y: float, a: float, b: float, angle: float, where: float, factor: float
) -> None:
    u, v = factor * a * np.cos(where), factor * b * np.sin(where)
    centre = np.array([x, y])
    turned = np.array(
        [np.cos(angle) * u - np.sin(angle) * v, np.sin(angle) * u + np.cos(angle) * v]
    )
    distance = mahalanobis(centre + turned, centre, np.array([a, b]), np.array(angle))
    assert distance == pytest.approx(factor, rel=1e-6, abs=1e-9)


def test_distance_on_both_sides_of_the_boundary() -> None:
    point = np.array([[1.999, 0.0], [2.0, 0.0], [2.001, 0.0], [0.0, 1.001]])
    inside = inside_ellipse(point, np.zeros(2), np.array([2.0, 1.0]), np.array(0.0))
    assert inside.tolist() == [True, True, False, False]


def test_a_set_without_extent_holds_its_centre_alone() -> None:
    point = np.array([[0.0, 0.0], [1e-9, 0.0], [0.5, 0.0], [0.5, 1e-9]])
    axes = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    distance = mahalanobis(point, np.zeros(2), axes, np.array(0.0))
    assert distance.tolist() == [0.0, np.inf, 0.5, np.inf]


def test_where_there_is_no_truth_there_is_no_distance_and_nothing_is_inside() -> None:
    point = np.array([[np.nan, np.nan], [0.0, 0.0]])
    axes = np.array([[1.0, 1.0], [0.0, 0.0]])
    distance = mahalanobis(point, np.zeros(2), axes, np.zeros(2))
    assert np.isnan(distance[0])
    assert inside_ellipse(point, np.zeros(2), axes, np.zeros(2)).tolist() == [False, True]


def test_areas_are_those_of_the_papers_circles() -> None:
    # Table 1: r = 1, r = 2, and v1 with z = 0.7 at 4 s.
    areas = ellipse_area(np.array([[1.0, 1.0], [2.0, 2.0], [2.8, 2.8]]))
    assert areas == pytest.approx([3.142, 12.566, 24.63], abs=5e-4)


@given(LENGTH, LENGTH, ANGLE)
@settings(deadline=None)
def test_the_extent_is_that_of_the_smallest_rectangle_around_it(
    first: float, second: float, turn: float
) -> None:
    around = np.linspace(0.0, 2.0 * np.pi, 721)
    x, y = first * np.cos(around), second * np.sin(around)
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    found = ellipse_extent(np.array([first, second]), np.array(turn))
    # A fan of half a degree misses the extreme by a share of 1 - cos(0.25 degrees) < 1e-5.
    assert found == pytest.approx([along.max(), across.max()], rel=1e-4, abs=1e-3)


def one_set(semi_axes: tuple[float, float], angle: float, heading: float) -> Occupancy:
    return Occupancy(
        ids=np.array([7]),
        centre=np.zeros((1, 2, 2)),
        semi_axes=np.tile(semi_axes, (1, 2, 1)),
        angle=np.full((1, 2), angle),
        valid=np.ones((1, 2), dtype=np.bool_),
        footprint=np.array([[4.0, 2.0]]),
        heading=np.full((1, 2), heading),
    )


@pytest.mark.parametrize(
    ("semi_axes", "angle", "heading", "size"),
    [
        ((0.0, 0.0), 0.3, 1.2, (4.0, 2.0)),  # No set: the footprint.
        ((3.0, 1.0), 0.5, 0.5, (10.0, 4.0)),  # Along the heading: 4 + 2 * 3 and 2 + 2 * 1.
        ((3.0, 1.0), 0.5 + np.pi / 2.0, 0.5, (6.0, 8.0)),  # Across it: 4 + 2 * 1 and 2 + 2 * 3.
    ],
)
def test_a_rectangle_grows_by_the_set(
    semi_axes: tuple[float, float], angle: float, heading: float, size: tuple[float, float]
) -> None:
    assert set_sizes(one_set(semi_axes, angle, heading))[0, 0] == pytest.approx(size)


def test_a_set_that_is_not_valid_is_its_footprint() -> None:
    sets = one_set((3.0, 1.0), 0.5, 0.5)
    sets = replace(sets, valid=np.array([[True, False]]), angle=np.array([[0.5, np.nan]]))
    assert set_sizes(sets)[0] == pytest.approx(np.array([[10.0, 4.0], [4.0, 2.0]]))
    assert set_sizes(sets, 1).shape == (1, 1, 2)
