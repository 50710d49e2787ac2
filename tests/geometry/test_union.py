"""The ellipse that covers a union, against points on the boundary of every component."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon, area, union_all

from dosplan.geometry import (
    covering_ellipse,
    ellipse_area,
    ellipse_boundary,
    mahalanobis,
    occupancy_of_union,
    set_area,
    set_distance,
)
from dosplan.scenario.synthetic import busy_scenario
from dosplan.simulation.world import World
from dosplan.types import FloatArray, Occupancy, SetUnion, ShapeError
from tests.support.factories import occupancy_at, random_union


def boundary(union: SetUnion) -> FloatArray:
    """(N, M, T, 720, 2) points on the boundary of every component."""
    return ellipse_boundary(union.centre, union.semi_axes, union.angle, 720)


def farthest(union: SetUnion) -> FloatArray:
    """(N, M, T) largest distance of a component's boundary, in multiples of the cover."""
    cover = [part[:, None, :, None] for part in covering_ellipse(union)]
    return np.asarray(mahalanobis(boundary(union), *cover).max(axis=-1))


@given(
    st.integers(0, 10_000),
    st.integers(2, 4),
    st.sampled_from([0.0, 1e-6, 0.1, 5.0, 100.0]),
    st.sampled_from([0.0, 1e-3, 0.5, 4.0, 30.0]),
)
@settings(deadline=None, max_examples=50)
def test_every_component_is_inside_and_the_cover_touches_one(
    seed: int, count: int, spread: float, reach: float
) -> None:
    union = random_union(np.random.default_rng(seed), 5, count, 4, spread, reach)
    inside = farthest(union)
    assert inside.max() <= 1.0
    if spread >= 0.1 and reach >= 0.5:  # Else a millimetre that makes it safe shows.
        assert inside.max(axis=1).min() > 0.999


def test_one_component_is_its_own_cover() -> None:
    union = random_union(np.random.default_rng(1), 20, 1, 6, spread=50.0, reach=3.0)
    for cover, own in zip(
        covering_ellipse(union), (union.centre, union.semi_axes, union.angle), strict=True
    ):
        np.testing.assert_array_equal(cover, own[:, 0])


def test_the_same_ellipse_twice_is_its_own_cover() -> None:
    one = random_union(np.random.default_rng(2), 20, 1, 6, spread=50.0, reach=3.0)
    parts = (one.centre, one.semi_axes, one.angle, one.heading)
    union = SetUnion(np.full((20, 2), 0.5), *(np.repeat(part, 2, axis=1) for part in parts))
    centre, semi_axes, _ = covering_ellipse(union)
    np.testing.assert_allclose(centre, one.centre[:, 0])
    longest = np.sort(one.semi_axes[:, 0], axis=-1)
    np.testing.assert_allclose(np.sort(semi_axes, axis=-1), longest, atol=2e-3)


def test_two_discs_have_the_smallest_cover_there_is() -> None:
    # Of ellipses around two points at distance 2 d whose discs of radius r are small, the smallest
    # has the semi-axes sqrt(2) d and sqrt(2) r.
    union = SetUnion(
        weight=np.array([[0.9, 0.1]]),
        centre=np.array([[-50.0, 0.0], [50.0, 0.0]])[None, :, None],
        semi_axes=np.ones((1, 2, 1, 2)),
        angle=np.zeros((1, 2, 1)),
        heading=np.zeros((1, 2, 1)),
    )
    _, semi_axes, angle = covering_ellipse(union)
    assert semi_axes[0, 0] == pytest.approx(np.sqrt(2.0) * np.array([50.0, 1.0]), rel=0.02)
    assert np.sin(angle[0, 0]) == pytest.approx(0.0, abs=1e-9)


def test_a_component_without_weight_is_not_covered_and_may_hold_anything() -> None:
    union = random_union(np.random.default_rng(3), 6, 3, 5, spread=20.0, reach=2.0)
    weight = np.array(union.weight)
    weight[:, 1] = 0.0
    weight /= weight.sum(axis=1, keepdims=True)
    union = replace(union, weight=weight)
    names = ("centre", "semi_axes", "angle", "heading")
    hidden, fewer = ({name: np.array(getattr(union, name)) for name in names} for _ in range(2))
    for name in names:
        hidden[name][:, 1] = np.nan
        fewer[name] = np.delete(fewer[name], 1, axis=1)
    two = SetUnion(weight=np.delete(weight, 1, axis=1), **fewer)
    for found, wanted in zip(
        covering_ellipse(replace(union, **hidden)), covering_ellipse(two), strict=True
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert farthest(two).max() <= 1.0


def test_the_cover_of_overlapping_sets_is_not_much_larger_than_they_are() -> None:
    union = random_union(np.random.default_rng(4), 50, 3, 10, spread=0.3, reach=4.0)
    cover = ellipse_area(covering_ellipse(union)[1])
    largest = ellipse_area(union.semi_axes).max(axis=1)
    assert np.median(cover / largest) < 2.0


def test_an_occupancy_of_a_union_is_of_its_cover_and_its_most_likely_heading() -> None:
    seen = World(busy_scenario(), first_step=40, history=5).observation()
    n = len(seen.ids)
    union = random_union(np.random.default_rng(5), n, 3, 7, spread=20.0, reach=2.0)
    occupancy = occupancy_of_union(seen, union)
    assert occupancy.valid.all()
    assert occupancy.union is union
    np.testing.assert_array_equal(occupancy.centre, covering_ellipse(union)[0])
    first = union.heading[0, np.argmax(union.weight[0])]
    np.testing.assert_array_equal(occupancy.heading[0], first)
    with pytest.raises(ShapeError):
        occupancy_of_union(seen, union, np.ones((n, 6), dtype=np.bool_))


def occupancy_with(union: SetUnion) -> Occupancy:
    users, steps = len(union.weight), union.horizon
    flat = occupancy_at(np.zeros((users, 2)), steps)
    centre, semi_axes, angle = covering_ellipse(union)
    return replace(flat, centre=centre, semi_axes=semi_axes, angle=angle, union=union)


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("spread", [0.0, 0.5, 2.0, 6.0])
def test_the_area_of_a_union_is_that_of_its_polygons(count: int, spread: float) -> None:
    union = random_union(np.random.default_rng(6), 40, count, 2, spread, reach=5.0)
    for scale in (0.6, 1.0, 1.7):
        scaled = replace(union, semi_axes=scale * union.semi_axes)
        polygons = np.vectorize(Polygon, signature="(n,c)->()")(boundary(scaled))
        wanted = area(union_all(np.moveaxis(polygons, 1, 0), axis=0))
        found = set_area(occupancy_with(union), scale)
        np.testing.assert_allclose(found, wanted, rtol=0.03)
        assert found.mean() == pytest.approx(wanted.mean(), rel=1e-3)


def test_areas_of_ellipses_that_lie_on_each_other_in_each_other_and_of_points() -> None:
    def area_of(centres: list[float], axes: list[tuple[float, float]]) -> float:
        m = len(centres)
        union = SetUnion(
            weight=np.full((1, m), 1.0 / m),
            centre=np.array([[x, 0.0] for x in centres])[None, :, None],
            semi_axes=np.array(axes)[None, :, None],
            angle=np.full((1, m, 1), 0.3),
            heading=np.zeros((1, m, 1)),
        )
        return float(set_area(occupancy_with(union))[0, 0]) / np.pi

    assert area_of([0.0, 0.0], [(2.0, 1.0), (2.0, 1.0)]) == pytest.approx(2.0)
    assert area_of([0.0, 0.1, 0.0], [(1.0, 1.0), (3.0, 3.0), (1.0, 1.0)]) == pytest.approx(9.0)
    assert area_of([0.0, 9.0], [(2.0, 1.0), (1.0, 1.0)]) == pytest.approx(3.0)
    assert area_of([0.0, 2.0], [(1.0, 1.0), (1.0, 1.0)]) == pytest.approx(2.0, rel=1e-3)
    assert area_of([0.0, 0.0], [(2.0, 1.0), (0.0, 0.0)]) == pytest.approx(2.0)
    assert area_of([0.0, 0.0], [(2.0, 1.0), (3.0, 0.0)]) == pytest.approx(2.0)
    assert area_of([0.0, 1.0], [(0.0, 0.0), (0.0, 0.0)]) == 0.0


def test_area_and_distance_without_a_union_are_those_of_the_ellipse() -> None:
    union = random_union(np.random.default_rng(7), 5, 1, 3, spread=3.0, reach=5.0)
    sets = replace(occupancy_with(union), union=None)
    hidden = np.ones((5, 3), dtype=np.bool_)
    hidden[2, 1] = False
    sets = replace(sets, valid=hidden)
    point = sets.centre + 1.0
    wanted = mahalanobis(point, sets.centre, sets.semi_axes, sets.angle)
    np.testing.assert_array_equal(
        set_area(sets), np.where(hidden, ellipse_area(sets.semi_axes), 0.0)
    )
    np.testing.assert_array_equal(set_distance(point, sets), np.where(hidden, wanted, np.inf))
    point[2, 1] = np.nan
    assert np.isnan(set_distance(point, sets)[2, 1])


def test_a_point_is_in_a_union_where_it_is_in_any_component() -> None:
    union = random_union(np.random.default_rng(8), 6, 3, 4, spread=4.0, reach=3.0)
    sets = occupancy_with(union)
    points = sets.centre + np.random.default_rng(9).normal(scale=5.0, size=(50, 6, 4, 2))
    each = mahalanobis(points[:, :, None], union.centre, union.semi_axes, union.angle)
    np.testing.assert_array_equal(set_distance(points, sets), each.min(axis=2))
    inside = set_distance(points, sets) <= 1.0
    assert 0.05 < inside.mean() < 0.95
    assert np.all(mahalanobis(points, sets.centre, sets.semi_axes, sets.angle)[inside] <= 1.0)
