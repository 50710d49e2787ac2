"""The body frame: there and back, and a case that can be checked by hand."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dosplan.geometry import to_body, to_world

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
