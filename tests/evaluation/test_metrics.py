"""The figures of an evaluation against known answers, bounds and brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dosplan.evaluation.limits import (
    MAX_RATIO,
    REPRESENTATIONS,
    circle_area,
    ellipse_limit,
    free_limit,
    upper_limits,
)
from dosplan.evaluation.metrics import (
    average_displacement,
    clustered_ratio,
    coverage_at_area,
    covering_scale,
    displacement,
    mean_displacement,
    scaled_area,
)
from dosplan.types import FloatArray

LENGTH = st.floats(0.1, 50.0)
ANGLE = st.floats(-10.0, 10.0)
PLACE = st.floats(-100.0, 100.0)


def test_average_displacement_weighs_pairs_not_windows() -> None:
    # Windows of four steps at 1 m and of one step at 6 m: 10 m over 5 pairs, not 3.5 m.
    assert average_displacement(np.array([4.0, 6.0]), np.array([4, 1])) == pytest.approx(2.0)
    assert average_displacement(np.zeros(2), np.zeros(2, dtype=np.int64)) is None


def test_displacement_leaves_out_what_is_not_recorded() -> None:
    truth = np.array([[3.0, 4.0], [np.nan, np.nan]])
    error = displacement(np.zeros((2, 2)), truth)
    assert mean_displacement(error) == pytest.approx(5.0)
    assert mean_displacement(error[1:]) is None


def test_error_of_a_share_by_hand() -> None:
    # Scenario 0: 3 of 4, scenario 1: 1 of 4. R = 1/2, residuals 3 - 2 = 1 and 1 - 2 = -1, so
    # var = 2 / 1 * (1 + 1) / 8^2 = 1/16.
    values = np.array([True, True, True, False, True, False, False, False])
    ratio = clustered_ratio(values, np.repeat([0, 1], 4))
    assert (ratio.value, ratio.error, ratio.n) == (0.5, 0.25, 8)


@given(st.lists(st.booleans(), min_size=2, max_size=50))
def test_error_of_single_windows_is_the_textbook_one(values: list[bool]) -> None:
    n, share = len(values), float(np.mean(values))
    ratio = clustered_ratio(np.array(values), np.arange(n) + 3)
    assert ratio.error == pytest.approx(np.sqrt(share * (1 - share) / (n - 1)))


def test_repeating_every_window_of_a_scenario_adds_no_certainty() -> None:
    values, cluster = np.array([True, False, True, True]), np.array([0, 1, 2, 5])
    once = clustered_ratio(values, cluster)
    tenfold = clustered_ratio(np.repeat(values, 10), np.repeat(cluster, 10))
    assert tenfold.error == pytest.approx(once.error)
    assert tenfold.n == 40


def test_a_share_of_nothing_or_of_one_scenario_has_no_error() -> None:
    nothing = clustered_ratio(np.zeros(0), np.zeros(0, dtype=np.int64))
    assert (nothing.value, nothing.error, nothing.n) == (None, None, 0)
    assert clustered_ratio(np.array([1.0, 0.0]), np.array([4, 4])).error is None


@given(st.lists(st.floats(0.01, 100.0), min_size=1, max_size=80))
def test_scaled_sets_cover_nine_tenths_and_no_smaller_ones_do(distances: list[float]) -> None:
    distance = np.array(distances)
    scale = covering_scale(distance)
    assert scale is not None
    assert np.mean(distance / scale <= 1.0) >= 0.9
    assert np.mean(distance / np.nextafter(scale, 0.0) <= 1.0) < 0.9


def test_scale_of_ten_windows_is_the_ninth_distance() -> None:
    assert covering_scale(np.arange(10.0, 0.0, -1.0)) == 9.0


def test_coverage_at_an_area_by_hand() -> None:
    distance = np.array([0.5, 1.0, 1.9, 2.1], dtype=np.float32)
    # Four times the area is twice the axes: whoever is within two of them is covered.
    assert coverage_at_area(distance, 3.0, 12.0) == 0.75
    assert coverage_at_area(distance, 3.0, 3.0) == 0.5
    assert coverage_at_area(distance, 0.0, 3.0) is None
    assert coverage_at_area(distance, None, 3.0) is None
    assert coverage_at_area(distance[:0], 3.0, 3.0) is None


def test_points_cannot_be_scaled() -> None:
    assert covering_scale(np.array([0.0, np.inf])) is None
    assert covering_scale(np.array([0.0] * 9 + [np.inf])) == 0.0
    assert covering_scale(np.zeros(0)) is None
    assert scaled_area(3.0, None) is None
    assert scaled_area(0.0, 2.0) is None
    assert scaled_area(None, 2.0) is None
    assert scaled_area(3.0, 2.0) == 12.0


@given(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0), ANGLE)
def test_smallest_ellipse_of_an_angle_is_that_of_brute_force(
    x: float, y: float, angle: float
) -> None:
    error = np.array([x, y])
    u = np.cos(angle) * x + np.sin(angle) * y
    v = np.cos(angle) * y - np.sin(angle) * x
    ratio = np.geomspace(1.0 / MAX_RATIO, MAX_RATIO, 2001)
    a = np.sqrt(u**2 + (ratio * v) ** 2)  # Touches: (u / a)^2 + (ratio v / a)^2 = 1.
    best = float(np.min(np.pi * a * a / ratio))
    limit = float(ellipse_limit(error, np.array(angle)))
    assert limit <= best * (1.0 + 1e-9) + 1e-9
    assert limit == pytest.approx(best, rel=1e-5, abs=1e-9)


def test_free_ellipse_is_the_best_of_all_angles() -> None:
    error = np.array([3.0, 4.0])
    angles = np.arctan2(4.0, 3.0) + np.linspace(0.0, np.pi, 361)
    every: FloatArray = ellipse_limit(np.tile(error, (361, 1)), angles)
    assert free_limit(error) == pytest.approx(every.min())
    assert free_limit(error) == pytest.approx(25.0 * np.pi / 4.0)


def test_limits_by_hand() -> None:
    # Error (2, 1) with the axis along x: ratio 2 is within the bounds, area 2 pi u v = 4 pi.
    # At 45 degrees u = 3 / sqrt 2, v = 1 / sqrt 2: ratio 3, area 2 pi u v = 3 pi.
    areas = upper_limits(np.array([2.0, 1.0]), np.array(0.0), np.array(np.pi / 2), np.array(np.pi))
    expected = {
        "circle": 5.0, "theta=0": 4.0, "theta=pi/4": 3.0, "v1": 4.0, "v2": 4.0, "free": 1.25
    }  # fmt: skip
    assert tuple(expected) == REPRESENTATIONS
    assert areas / np.pi == pytest.approx(list(expected.values()))


def test_an_ellipse_of_ratio_one_is_the_circle_and_no_error_needs_no_area() -> None:
    error = np.array([[2.0, 1.0], [0.0, 0.0]])
    assert ellipse_limit(error, np.ones(2), max_ratio=1.0) == pytest.approx(circle_area(error))
    assert ellipse_limit(error[1], np.array(1.0)) == 0.0
