"""Paired differences against published examples, exact coverage and scipy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest, multinomial, ttest_rel

from dosplan.results.intervals import effective_number
from dosplan.results.paired import (
    Difference,
    mean_difference,
    share_difference,
    sign_flip_p,
    tango_interval,
)
from dosplan.types import FloatArray

# Scenarios of each place in the published run on recorded scenarios: 39 places, 150 scenarios.
SIZES = [20, 14, 12, 11, 11, 9, 6, 5, 5, 4, 4] + [3] * 6 + [2] * 9 + [1] * 13
RECORDED = [f"p{place}" for place, size in enumerate(SIZES) for _ in range(size)]

SUITE = [f"p{place}" for place in range(12) for _ in range(12 + (place < 6))]


def _each(n: int) -> list[str]:
    """Every scenario of a place of its own."""
    return [f"s{i}" for i in range(n)]


def _sides(n: int, only_a: int, only_b: int) -> tuple[FloatArray, FloatArray]:
    a, b = np.ones(n), np.ones(n)
    b[:only_a], a[only_a : only_a + only_b] = 0.0, 0.0
    return a, b


def _holds(found: Difference, truth: float) -> bool:
    assert found.low is not None
    assert found.high is not None
    return found.low <= truth <= found.high


@pytest.mark.parametrize(
    ("first", "second", "n", "level", "limits"),
    [
        # Tango (1998), section 6: sleeping difficulties, and soft contact lenses at 90 %.
        pytest.param(9, 3, 32, 0.95, (-0.027, 0.390), id="sleeping difficulties"),
        pytest.param(0, 1, 44, 0.90, (-0.096, 0.037), id="contact lenses"),
        # Fagerland, Lydersen, Laake, "Statistical Analysis of Contingency Tables", 2017, chapter 8:
        # complete response before and after consolidation therapy.
        pytest.param(6, 16, 161, 0.95, (-0.1240, -0.0054), id="consolidation therapy"),
    ],
)
def test_tango_gives_the_published_limits(
    first: int, second: int, n: int, level: float, limits: tuple[float, float]
) -> None:
    assert tango_interval(first, second, n, level) == pytest.approx(limits, abs=5e-4)


def test_tango_has_limits_where_nothing_differs_and_where_all_does() -> None:
    # Without a pair that differs the equation is n d = z^2 (1 - d).
    bound = 3.8414588 / (150 + 3.8414588)
    assert tango_interval(0, 0, 150) == pytest.approx((-bound, bound))
    low, high = tango_interval(150, 0, 150)
    assert high == 1.0
    assert 0.94 < low < 0.96
    assert tango_interval(0, 150, 150) == pytest.approx((-1.0, -low))


@pytest.mark.parametrize("n", [*range(1, 60), 149, 0.1398, 36.7])
def test_tango_has_limits_for_any_number_of_pairs_that_all_differ(n: float) -> None:
    # With D the difference the score is -sqrt(n (1 + D) / (1 - D)), and -z at the upper limit.
    limit = (3.8414588 - n) / (3.8414588 + n)
    assert tango_interval(0, n, n) == pytest.approx((-1.0, limit))
    assert tango_interval(n, 0, n) == pytest.approx((-limit, 1.0))


@pytest.mark.parametrize("change", [0.1, 0.5])
def test_equal_differences_have_no_p_whatever_their_rounding(change: float) -> None:
    before = np.array([0.3, 1.7, 2.9, 4.1, 8.3])
    assert mean_difference(before, before + change, ["a", "b", "c", "d", "e"]).p is None


def test_two_against_none_of_150_does_not_exclude_zero() -> None:
    """A percentile bootstrap of these ends at 0: it never draws a pair of the other kind."""
    found = share_difference(*_sides(150, 0, 2), _each(150))
    assert found.difference == pytest.approx(2 / 150)
    assert found.low is not None
    assert found.low < -0.01
    assert (found.only_a, found.only_b, found.p) == (0, 2, 0.5)


@pytest.mark.parametrize(("first", "second"), [(0.02, 0.01), (0.03, 0.0), (0.004, 0.004)])
def test_coverage_is_near_95_percent_for_few_pairs_that_differ(first: float, second: float) -> None:
    """Exact coverage for 150 pairs, over all counts of the two kinds that are not negligible."""
    truth, covered, seen = first - second, 0.0, 0.0
    law = multinomial(150, [first, second, 1.0 - first - second])
    for b in range(16):
        for c in range(16):
            weight = float(law.pmf([b, c, 150 - b - c]))
            if weight > 1e-7:
                low, high = tango_interval(b, c, 150)
                covered += weight * (low <= truth <= high)
                seen += weight
    assert seen > 0.999
    assert 0.93 < covered / seen <= 1.0


def test_an_interval_of_single_places_is_tangos() -> None:
    a, b = _sides(60, 2, 5)
    found = share_difference(a, b, _each(60))
    assert (found.low, found.high) == pytest.approx(tango_interval(5, 2, 60))
    assert found.places == 60


@settings(max_examples=50, deadline=None)
@given(st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=2, max_size=40))
def test_every_scenario_twice_at_its_place_tells_no_more(found: list[float]) -> None:
    differences = np.array(found)
    once = effective_number(differences, _each(len(found)))
    twice = effective_number(
        np.repeat(differences, 2), [s for s in _each(len(found)) for _ in "ab"]
    )
    assert once == len(found)
    if np.ptp(differences) > 0.0:
        assert twice <= once * (1.0 + 1e-9)


def test_an_interval_does_not_shrink_with_copies_at_the_same_places() -> None:
    a, b = _sides(60, 2, 5)
    once = share_difference(a, b, _each(60))
    twice = share_difference(np.tile(a, 2), np.tile(b, 2), _each(60) * 2)
    assert (twice.n, twice.places) == (120, 60)
    assert (twice.only_a, twice.only_b) == (4, 10)
    assert once.low is not None
    assert twice.low is not None
    assert twice.low <= once.low
    assert twice.low == pytest.approx(once.low, abs=0.005)


def test_what_differs_at_one_place_tells_less_than_at_many() -> None:
    places = [f"p{i // 5}" for i in range(100)]
    together, apart = np.zeros(100), np.zeros(100)
    together[:5] = apart[::20] = 1.0
    nothing = np.zeros(100)
    narrow, wide = (share_difference(nothing, b, places) for b in (apart, together))
    assert narrow.difference == wide.difference == 0.05
    assert wide.low is not None
    assert narrow.low is not None
    assert narrow.high is not None
    assert wide.high is not None
    assert wide.low < 0.0 < narrow.low
    assert wide.high > narrow.high


def test_one_place_alone_is_taken_as_independent_scenarios() -> None:
    rng = np.random.default_rng(0)
    a, b = _sides(30, 1, 4)
    found = share_difference(a, b, ["p"] * 30)
    assert (found.low, found.high) == pytest.approx(tango_interval(4, 1, 30))
    assert found.places == 1
    values = rng.normal(size=30)
    mean = mean_difference(np.zeros(30), values, ["p"] * 30)
    assert mean.p == pytest.approx(ttest_rel(values, np.zeros(30)).pvalue)


def test_sign_flips_of_groups_by_hand() -> None:
    # Totals of +-3 +-1 +-1: 5, 3 (twice), 1, -1, -3 (twice), -5.
    assert sign_flip_p(np.array([3.0, 1.0, 1.0])) == pytest.approx(2 / 8)
    assert sign_flip_p(np.array([3.0, -1.0, 0.0, 1.0])) == pytest.approx(6 / 8)
    assert sign_flip_p(np.array([-3.0, 1.0, 1.0])) == 1.0
    assert sign_flip_p(np.array([4.0])) == 1.0
    assert sign_flip_p(np.zeros(3)) == 1.0


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(-4, 4), min_size=1, max_size=10))
def test_the_law_of_sign_flips_is_that_of_all_of_them(sums: list[int]) -> None:
    totals = [
        sum(s * x for s, x in zip(signs, sums, strict=True))
        for signs in product((-1, 1), repeat=len(sums))
    ]
    far = sum(abs(total) >= abs(sum(sums)) for total in totals)
    assert sign_flip_p(np.array(sums, dtype=np.float64)) == pytest.approx(far / len(totals))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 40), st.integers(0, 40))
def test_sign_flips_of_single_pairs_are_mcnemars_test(first: int, second: int) -> None:
    sums = np.concatenate([-np.ones(first), np.zeros(3), np.ones(second)])
    pairs = first + second
    expected = float(binomtest(second, pairs).pvalue) if pairs else 1.0
    assert sign_flip_p(sums) == expected
    # The law of groups of two is the same, and goes another way.
    assert sign_flip_p(2.0 * sums) == pytest.approx(expected)


def test_futures_of_one_scenario_do_not_count_as_so_many_scenarios() -> None:
    """Ten futures of which each repeats the first leave p and interval as they were."""
    a, b = _sides(60, 2, 8)
    once = share_difference(a, b, _each(60))
    often = share_difference(np.tile(a, 10), np.tile(b, 10), _each(60) * 10)
    assert (often.n, often.only_a, often.only_b) == (600, 20, 80)
    for p in (once.p, once.p_places, often.p, often.p_places):
        assert p == pytest.approx(0.109375)
    assert (often.low, often.high) == pytest.approx((once.low, once.high), abs=0.01)


def test_places_and_scenarios_are_two_tests() -> None:
    # Six scenarios of two places differ, all to the better; so of the scenarios 2 / 2^6, of the
    # places 2 / 2^2. The third place does not differ.
    scenarios = [f"USA_{place}-{i}_1_T-1" for place in "ABC" for i in range(3)]
    b = np.array([1.0] * 6 + [0.0] * 3)
    found = share_difference(np.zeros(9), b, scenarios)
    assert found.places == 3
    assert found.p == pytest.approx(2 / 64)
    assert found.p_places == pytest.approx(2 / 4)


def test_the_sign_flip_test_keeps_its_level_where_futures_agree() -> None:
    """Futures of a scenario that all go one way: McNemar over episodes finds too much."""
    rng = np.random.default_rng(0)
    draws, futures, rejected, naive = 400, 8, 0, 0
    names = [f"s{i}" for i in range(15) for _ in range(futures)]
    for _ in range(draws):
        way = np.repeat(rng.choice([-1.0, 0.0, 1.0], size=15), futures)
        differences = way * (rng.random(len(way)) < 0.7)
        a, b = (differences < 0.0).astype(float), (differences > 0.0).astype(float)
        p = share_difference(a, b, names).p
        assert p is not None
        rejected += p < 0.05
        naive += binomtest(int(b.sum()), int(a.sum() + b.sum())).pvalue < 0.05
    assert rejected / draws < 0.08
    assert naive / draws > 0.3


def _coverage(places: Sequence[str], differ: float, draws: int = 300) -> tuple[float, float]:
    """Coverage with and without regard to places, where few places are prone to differ."""
    rng = np.random.default_rng(0)
    names = list(dict.fromkeys(places))
    index = np.array([names.index(place) for place in places])
    by_place = by_scenario = 0
    for _ in range(draws):
        # Half of the places differ at twice the rate, so what differs comes in lumps.
        prone = rng.random(len(names)) < 0.5
        # The direction is the place's, either with the same probability: the truth is 0.
        sign = rng.choice([-1.0, 1.0], size=len(names))
        hit = rng.random(len(places)) < 2.0 * differ * prone[index]
        b = np.where(hit, sign[index], 0.0)
        a = (b < 0.0).astype(np.float64)
        b = (b > 0.0).astype(np.float64)
        by_place += _holds(share_difference(a, b, places), 0.0)
        by_scenario += _holds(share_difference(a, b, _each(len(places))), 0.0)
    return by_place / draws, by_scenario / draws


@pytest.mark.parametrize("places", [RECORDED, SUITE], ids=["39 places", "12 places"])
def test_coverage_holds_where_the_scenarios_of_a_place_resemble_each_other(
    places: list[str],
) -> None:
    by_place, by_scenario = _coverage(places, differ=0.15)
    assert by_scenario < 0.80
    assert by_place > 0.90


def test_means_of_single_places_are_those_of_the_paired_t_test() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(5.0, 1.0, 40)
    b = a + rng.normal(0.2, 0.5, 40)
    found, oracle = mean_difference(a, b, _each(40)), ttest_rel(b, a)
    interval = oracle.confidence_interval()
    assert found.p == pytest.approx(oracle.pvalue)
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))
    assert (found.a, found.b) == pytest.approx((a.mean(), b.mean()))


def test_means_do_not_gain_by_copies_at_the_same_places() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(5.0, 1.0, 25)
    b = a + rng.normal(0.2, 0.5, 25)
    once = mean_difference(a, b, _each(25))
    many = mean_difference(np.tile(a, 4), np.tile(b, 4), _each(25) * 4)
    assert (many.n, many.places) == (100, 25)
    assert (many.low, many.high, many.p) == pytest.approx((once.low, once.high, once.p))


def test_coverage_of_means_holds_where_places_differ() -> None:
    rng = np.random.default_rng(0)
    names = list(dict.fromkeys(RECORDED))
    index = np.array([names.index(place) for place in RECORDED])
    zero, held = np.zeros(len(RECORDED)), 0
    for _ in range(400):
        values = rng.normal(size=len(names))[index] + rng.normal(size=len(RECORDED))
        held += _holds(mean_difference(zero, values, RECORDED), 0.0)
    # Places of 20 and of 1 scenario: the error of the mean is underestimated a little.
    assert held / 400 > 0.88


def test_what_cannot_be_told_is_none() -> None:
    one = mean_difference(np.array([1.0]), np.array([2.0]), ["p"])
    assert (one.difference, one.low, one.high, one.p) == (1.0, None, None, None)
    same = mean_difference(np.ones(3), np.ones(3), _each(3))
    assert (same.low, same.high, same.p) == (0.0, 0.0, 1.0)
    shifted = mean_difference(np.ones(3), np.full(3, 2.0), _each(3))
    assert (shifted.low, shifted.high, shifted.p) == (1.0, 1.0, None)
