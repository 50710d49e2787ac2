"""Paths in the plane: both kinds against each other, against circles and beyond their ends."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dosplan.geometry import (
    PATH_CURVATURE,
    PATH_HEADING,
    PATH_SIZE,
    EvenPath,
    ReferencePath,
    braking_envelope,
)
from dosplan.scenario.synthetic import straight_route
from dosplan.types import FloatArray
from tests.support.factories import arc_route

RADIUS = 30.0
ARC = arc_route(RADIUS, length=100.0)


def beside_arc(angle: float, offset: float) -> FloatArray:
    """A point beside the arc, which bends to the left around (0, RADIUS)."""
    away = RADIUS - offset
    return np.array([away * math.sin(angle), RADIUS - away * math.cos(angle)])


@given(angle=st.floats(0.2, 3.0), offset=st.floats(-5.0, 5.0), error=st.floats(-3.0, 3.0))
def test_both_paths_know_where_a_point_is_beside_an_arc(
    angle: float, offset: float, error: float
) -> None:
    point = beside_arc(angle, offset)
    even = EvenPath.of(ARC)
    located = even.locate(point)
    along, across = even.project(point, np.array(RADIUS * angle + error))
    # Chords of 0.5 m: at 5 m to the side, half a chord's angle shifts the nearest point of the
    # line by 5 * 0.5 / 30 / 2 = 0.04 m. Newton's method takes the headings between the points.
    assert float(located) == pytest.approx(RADIUS * angle, abs=0.05)
    assert float(along) == pytest.approx(RADIUS * angle, abs=0.02)
    assert float(across) == pytest.approx(offset, abs=0.005)
    assert float(even.offset(point, along)) == pytest.approx(float(across), abs=1e-9)


@given(s=st.floats(0.0, 99.0))
def test_a_division_finds_what_a_search_finds(s: float) -> None:
    search, division = ReferencePath.of(ARC), EvenPath.of(ARC)
    row = division.at(np.array(s))
    assert row[PATH_HEADING] == pytest.approx(float(search.heading_at(s)), abs=1e-12)
    assert row[PATH_CURVATURE] == pytest.approx(float(search.curvature_at(s)), abs=1e-12)
    assert float(search.offset(row[:2], s)) == pytest.approx(0.0, abs=1e-12)


def test_more_columns_are_looked_up_as_well() -> None:
    route = straight_route()
    more = (route.left, 2.0 * route.arclength)
    path = EvenPath(route.arclength, route.path, route.heading, route.curvature, more)
    rows = path.at(np.array([[3.3, 10.0]]))
    assert rows.shape == (1, 2, PATH_SIZE + 2)
    np.testing.assert_allclose(rows[0, :, -1], [6.6, 20.0])
    np.testing.assert_allclose(rows[0, :, -2], route.left[0])
    # Beyond its ends a path has no row: it is clipped.
    np.testing.assert_allclose(
        path.at(np.array([-5.0, 1e6]))[:, -1], [0.0, 2.0 * path.length], atol=1e-3
    )


def test_on_a_ring_the_first_lap_counts() -> None:
    ring = EvenPath.of(arc_route(RADIUS, length=2.4 * 2.0 * math.pi * RADIUS))
    lap = 2.0 * math.pi * RADIUS
    # By rounding alone the second lap is nearer to some of these.
    for angle in np.linspace(0.1, 6.0, 40):
        for offset in (-2.0, 0.0, 2.0):
            found = ring.locate_first(beside_arc(angle, offset))
            assert found == pytest.approx(RADIUS * angle, abs=0.05)
    assert any(float(ring.locate(beside_arc(a, 0.0))) > lap - 1.0 for a in np.linspace(0.1, 2, 40))
    # A path that comes by once is located as ever.
    even = EvenPath.of(ARC)
    for s in np.linspace(0.0, 99.0, 23):
        point = beside_arc(s / RADIUS, 1.0)
        assert even.locate_first(point) == float(even.locate(point))


def test_on_a_ring_others_are_located_near_the_ego() -> None:
    lap = 2.0 * math.pi * RADIUS
    ring = EvenPath.of(arc_route(RADIUS, length=2.4 * lap))
    for ego in (0.5 * lap, 1.2 * lap, 1.8 * lap):
        ahead = ego + np.linspace(-0.2, 0.5, 30) * lap
        others = np.stack([beside_arc(s / RADIUS, 1.0) for s in ahead])
        np.testing.assert_allclose(ring.locate(others, ego), ahead, atol=0.05)
        np.testing.assert_allclose(ring.locate(others, np.full(30, ego)), ahead, atol=0.05)
    even = EvenPath.of(ARC)
    points = np.stack([beside_arc(a, 1.0) for a in (0.3, 1.0, 1.7)])
    np.testing.assert_array_equal(even.locate(points, 3.0), even.locate(points))


@pytest.mark.parametrize("step", [2.0, 35.0])
def test_who_drives_round_a_ring_or_turns_back_is_followed(step: float) -> None:
    ring = ReferencePath.of(arc_route(RADIUS, length=2.4 * 2.0 * math.pi * RADIUS))
    driven = np.arange(3.0, float(ring.arclength[-1]), step)
    points = np.stack([beside_arc(s / RADIUS, -0.6) for s in driven])
    np.testing.assert_allclose(ring.follow(points), driven, atol=0.05)


def test_who_turns_back_beside_its_own_way_is_followed() -> None:
    way = np.arange(0.0, 60.0, 0.5)
    x, y = np.append(way, way[::-1]), np.repeat([0.0, 1.2], len(way))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    turn = ReferencePath(
        along, np.stack([x, y], axis=1), np.where(y > 0.0, np.pi, 0.0), np.zeros_like(x)
    )
    aside = np.where(x < 50.0, 0.62, 0.5)  # Nearer to the other side, but where it turns.
    places = np.stack([x, y + np.where(y > 0.0, -aside, aside)], axis=1)
    np.testing.assert_allclose(turn.follow(places), along, atol=1.1)
    assert np.abs(turn.locate(places) - along).max() > 100.0


def test_arc_lengths_are_those_the_path_was_given() -> None:
    route = straight_route()  # From x = -20 m on.
    shifted = ReferencePath(route.arclength - 7.0, route.path, route.heading, route.curvature)
    assert float(shifted.locate(np.array([0.0, 1.5]))) == pytest.approx(13.0)


def test_a_thinned_line_locates_nearly_the_same() -> None:
    thin = ReferencePath(ARC.arclength, ARC.path, ARC.heading, ARC.curvature, thinning=0.005)
    points = np.stack([beside_arc(a, d) for a in (0.5, 1.0, 2.0) for d in (-3.0, 0.0, 3.0)])
    whole = ReferencePath.of(ARC).locate(points)
    assert 0.0 < np.abs(thin.locate(points) - whole).max() < 0.1


def test_braking_envelope_is_the_closed_form() -> None:
    s = np.arange(0.0, 50.0, 1.0)
    limit = np.where(s < 30.0, 20.0, 5.0)
    # v^2 = 5^2 + 2 * 2 * (30 - s) before the limit, capped by 20.
    expected = np.minimum(20.0, np.sqrt(25.0 + 4.0 * np.maximum(30.0 - s, 0.0)))
    np.testing.assert_allclose(braking_envelope(limit**2, s, 2.0), expected)
