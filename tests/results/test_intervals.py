"""Intervals against known answers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest, ttest_1samp

from dosplan.results.intervals import mean_interval, metric_interval, share_interval
from dosplan.scoring.metrics import find_metric
from dosplan.scoring.score import failed_score
from dosplan.types import Arm, EpisodeKey, FloatArray, Outcome


def _each(n: int) -> list[str]:
    return [f"s{i}" for i in range(n)]


def _verdicts(count: int, n: int) -> FloatArray:
    return (np.arange(n) < count).astype(np.float64)


@pytest.mark.parametrize(("count", "n"), [(0, 150), (5, 10), (8, 10), (149, 150), (3, 3)])
def test_shares_of_single_places_have_wilsons_interval(count: int, n: int) -> None:
    oracle = binomtest(count, n).proportion_ci(method="wilson")
    expected = (count / n, oracle.low, oracle.high)
    assert share_interval(_verdicts(count, n), _each(n)) == pytest.approx(expected, abs=1e-12)


def test_a_share_is_in_its_interval_in_spite_of_rounding() -> None:
    for n in range(1, 400):
        for count in (0, 1, n - 1, n):
            share, low, high = share_interval(_verdicts(count, n), _each(n))
            assert 0.0 <= low <= share <= high <= 1.0


def test_none_of_n_is_bounded() -> None:
    """The upper end is z^2 / (n + z^2)."""
    bound = pytest.approx(3.8414588 / 153.8414588)
    assert share_interval(_verdicts(0, 150), _each(150)).high == bound


def test_means_of_single_places_have_the_t_interval() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(3.0, 1.0, 20)
    oracle = ttest_1samp(values, 0.0).confidence_interval()
    expected = (values.mean(), oracle.low, oracle.high)
    assert mean_interval(values, _each(20)) == pytest.approx(expected)
    assert mean_interval(np.full(7, 3.0), _each(7)) == (3.0, 3.0, 3.0)
    value, *ends = mean_interval(np.array([3.0]), ["p"])
    assert value == 3.0
    assert all(map(math.isnan, ends))


def test_copies_at_the_same_places_tell_no_more() -> None:
    rng = np.random.default_rng(1)
    values, verdicts = rng.normal(3.0, 1.0, 20), _verdicts(8, 20)
    places = _each(20) * 3
    assert mean_interval(np.tile(values, 3), places) == pytest.approx(
        mean_interval(values, _each(20))
    )
    once, thrice = share_interval(verdicts, _each(20)), share_interval(np.tile(verdicts, 3), places)
    assert thrice.value == once.value
    assert thrice.low < once.low < once.high < thrice.high
    assert (thrice.low, thrice.high) == pytest.approx((once.low, once.high), abs=0.02)


def test_the_interval_of_a_metric_is_over_the_episodes_that_have_a_value() -> None:
    failed = failed_score(EpisodeKey("ZAM_A-1_1_T-1", Arm.WITH_DOS), "it broke")
    rows = [
        replace(failed, scenario=f"ZAM_{place}-1_1_T-1", steps=9, velocity=velocity, error=None)
        for place, velocity in (("A", 4.0), ("B", 6.0), ("C", 8.0))
    ]
    rows[0] = replace(rows[0], outcome=Outcome.SUCCESS)
    found = metric_interval(find_metric("velocity"), [*rows, failed])
    assert found == pytest.approx(mean_interval(np.array([4.0, 6.0, 8.0]), _each(3)))
    share = metric_interval(find_metric("success"), rows)
    assert share == pytest.approx(share_interval(_verdicts(1, 3), _each(3)))
    assert metric_interval(find_metric("max_slack"), rows) is None
    assert metric_interval(find_metric("velocity"), [failed]) is None
