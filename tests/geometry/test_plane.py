"""The body frame, there and back, and rectangles that overlap; cases checked by hand."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from dosplan.geometry import rectangle_corners, rectangles_overlap, to_body, to_world

COORDINATE = st.floats(-1e3, 1e3)


def test_what_lies_north_is_on_the_left_of_who_looks_east() -> None:
    # From (10, 5), looking along x: 2 m ahead and 3 m to the left; looking north: 3 m ahead and
    # 2 m to the right.
    point = np.array([[[12.0, 8.0]], [[12.0, 8.0]]])
    poses = np.array([[10.0, 5.0, 0.0], [10.0, 5.0, np.pi / 2]])
    np.testing.assert_allclose(to_body(point, poses), [[[2.0, 3.0]], [[3.0, -2.0]]], atol=1e-12)


@given(
    st.tuples(COORDINATE, COORDINATE),
    st.tuples(COORDINATE, COORDINATE, st.floats(-10.0, 10.0)),
)
def test_to_body_undoes_to_world(point: tuple[float, float], pose: tuple[float, ...]) -> None:
    points, poses = np.array([[point]]), np.array([pose])
    np.testing.assert_allclose(to_body(to_world(points, poses), poses), points, atol=1e-9)


@pytest.mark.parametrize(
    ("place", "heading", "meets"),
    [
        ((3.9, 1.9), 0.0, True),  # Two of 4 m by 2 m side by side: up to 4 m and 2 m apart.
        ((4.1, 0.0), 0.0, False),
        ((0.0, 2.1), np.pi, False),
        ((2.9, 0.0), np.pi / 2.0, True),  # One across: 2 m and 1 m.
        ((3.1, 0.0), np.pi / 2.0, False),
        ((3.0, 2.4), np.pi / 4.0, True),  # The corner (2, 1) is inside.
        ((3.5, 3.0), np.pi / 4.0, False),  # Only its own axes part them.
        ((np.nan, 0.0), 0.0, False),
    ],
)
def test_rectangles_overlap_as_drawn_on_paper(
    place: tuple[float, float], heading: float, meets: bool
) -> None:
    here, there = np.zeros(3), np.array([*place, heading])
    assert rectangles_overlap(here, (4.0, 2.0), there, (4.0, 2.0)) == meets
    assert rectangles_overlap(there, (4.0, 2.0), here, (4.0, 2.0)) == meets


@given(st.integers(0, 2**32 - 1))
def test_many_rectangles_overlap_as_one_by_one(seed: int) -> None:
    """A plan of 6 steps against 5 road users; beside each pair alone, and shapely's polygons."""
    rng = np.random.default_rng(seed)
    ego = rng.uniform([-4.0, -4.0, -4.0], [4.0, 4.0, 4.0], (6, 3))
    users = rng.uniform([-4.0, -4.0, -9.0, 0.0], [4.0, 4.0, 9.0, 30.0], (5, 6, 4))
    size, sizes = np.array([4.5, 1.6]), rng.uniform(0.3, 8.0, (5, 1, 2))
    many = rectangles_overlap(ego, size, users, sizes)
    assert many.shape == (5, 6)
    for n, t in np.ndindex(many.shape):
        assert many[n, t] == rectangles_overlap(ego[t], size, users[n, t], sizes[n, 0])
        a = shapely.Polygon(rectangle_corners(ego[t], size))
        b = shapely.Polygon(rectangle_corners(users[n, t, :3], sizes[n, 0]))
        if a.intersection(b).area > 1e-9 or a.distance(b) > 1e-9:
            assert many[n, t] == a.intersects(b)


def test_no_rectangles_overlap_none() -> None:
    assert rectangles_overlap(np.empty((0, 3)), (4.0, 2.0), np.zeros(3), (4.0, 2.0)).shape == (0,)
