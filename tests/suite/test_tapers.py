"""The wedge in which a lane of the suite runs out."""

from __future__ import annotations

import numpy as np
import pytest
from suitegen.tapers import END_WIDTH, LENGTH, taper

from dosplan.types import FloatArray


def _line(spacing: float = 5.0, length: float = 100.0) -> FloatArray:
    x = np.arange(0.0, length + spacing, spacing)
    return np.stack([x, np.zeros_like(x)], axis=1)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_wedge_narrows_evenly_on_its_own_side(side: float) -> None:
    inner, outer = taper(_line(), np.array([0.0, 3.5 * side]))
    # 45 m are nine pieces of 5 m; the width goes from 3.5 m to END_WIDTH in equal steps.
    np.testing.assert_allclose(inner, _line()[:10])
    np.testing.assert_allclose(outer[:, 0], inner[:, 0])
    np.testing.assert_allclose(outer[:, 1], side * np.linspace(3.5, END_WIDTH, 10))


def test_wedge_ends_at_a_point_of_the_lane_beside_it() -> None:
    inner, _ = taper(_line(spacing=20.0), np.array([0.0, 3.5]))
    assert inner[-1, 0] == 60.0 >= LENGTH


def test_wedge_is_no_longer_than_the_lane_beside_it() -> None:
    inner, outer = taper(_line(length=20.0), np.array([0.0, 3.5]))
    assert inner[-1, 0] == 20.0
    assert outer[-1, 1] == pytest.approx(END_WIDTH)


def test_wedge_begins_where_the_lane_stopped() -> None:
    # SUMO cuts lanes at a slant: the corner need not lie square to the line.
    corner = np.array([0.4, -3.4])
    _, outer = taper(_line(), corner)
    np.testing.assert_array_equal(outer[0], corner)
