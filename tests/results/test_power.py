"""What a comparison can show: exact for independent pairs, close where scenarios have several."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.stats import binomtest

from dosplan.results.comparison import compare_rows
from dosplan.results.intervals import design_effect, sums_over
from dosplan.results.markdown import power_line
from dosplan.results.paired import sign_flip_p
from dosplan.results.power import (
    POWER,
    detectable_difference,
    mcnemar_power,
    smallest_difference,
)
from dosplan.scoring.score import failed_score
from dosplan.types import Arm, EpisodeKey, FloatArray, Outcome, Score


@pytest.mark.parametrize(("n", "first", "second"), [(9, 0.7, 0.05), (12, 0.5, 0.1), (14, 0.6, 0.0)])
def test_power_is_the_chance_of_a_small_p(n: int, first: float, second: float) -> None:
    """Over all that can come of n pairs: so many one way, so many the other way."""
    expected = 0.0
    for one, other in itertools.product(range(n + 1), repeat=2):
        both = one + other
        if both > n or one <= other or binomtest(one, both).pvalue > 0.05:
            continue
        ways = math.comb(n, both) * math.comb(both, one)
        expected += ways * first**one * second**other * (1 - first - second) ** (n - both)
    assert mcnemar_power(n, first, second) == pytest.approx(expected)


@pytest.mark.parametrize(("n", "other"), [(150, 0.0), (150, 0.02), (750, 0.01)])
def test_the_smallest_difference_is_found_so_often(n: int, other: float) -> None:
    difference = detectable_difference(n, other)
    assert difference is not None
    assert mcnemar_power(n, other + difference, other) == pytest.approx(POWER, abs=1e-6)
    # Six pairs that all go one way are the least that is significant.
    assert difference * n > 6.0
    more = detectable_difference(2 * n, other)
    assert more is not None
    assert more < difference


def test_few_pairs_show_nothing() -> None:
    assert detectable_difference(0) is None
    assert detectable_difference(5) is None
    assert detectable_difference(100, 0.5) is None
    assert smallest_difference(np.empty(0), []) is None


def _simulated(
    rng: np.random.Generator, scenarios: int, futures: int, decisive: float, prevented: float
) -> FloatArray:
    """Differences of collisions where some scenarios decide, each future by a chance of its own."""
    here = rng.random(scenarios) < decisive
    return -(here[:, None] & (rng.random((scenarios, futures)) < prevented)).astype(np.float64)


@pytest.mark.parametrize(("scenarios", "futures", "prevented"), [(150, 5, 0.5), (60, 4, 0.8)])
def test_the_test_by_scenarios_finds_the_smallest_difference_as_often(
    scenarios: int, futures: int, prevented: float
) -> None:
    """The design effect of futures that are alike is right: simulated, with the test itself."""
    names = [f"s{i}" for i in range(scenarios) for _ in range(futures)]
    decisive = 0.05
    for _ in range(8):  # The share of scenarios at which the difference is the smallest one.
        # Variance of a scenario's sum over that of independent futures, of the law above.
        mean = decisive * prevented
        inside = futures * (mean * prevented * (futures - 1) + mean) - (futures * mean) ** 2
        effect = inside / (futures * mean * (1.0 - mean))
        smallest = detectable_difference(int(scenarios * futures / effect))
        assert smallest is not None
        decisive = smallest / prevented
    rng = np.random.default_rng(5)
    draws = [_simulated(rng, scenarios, futures, decisive, prevented).ravel() for _ in range(600)]
    found = np.mean([sign_flip_p(sums_over(draw, names)) <= 0.05 for draw in draws])
    assert found == pytest.approx(POWER, abs=0.1)
    effects = [design_effect(draw, names) for draw in draws]
    assert np.mean(effects) == pytest.approx(effect, rel=0.1)


def test_futures_that_repeat_each_other_add_nothing() -> None:
    once = np.zeros(40)
    once[:6], once[6] = -1.0, 1.0
    names = [f"s{i}" for i in range(40)]
    alone = smallest_difference(once, names)
    again = smallest_difference(np.repeat(once, 5), np.repeat(names, 5).tolist())
    assert design_effect(once, names) == 1.0
    assert alone is not None
    assert again == pytest.approx(alone, rel=0.1)


def _row(scenario: int, future: int, collides: bool) -> Score:
    key = EpisodeKey(f"ZAM_Kind-{scenario}_1_T-1", Arm.WITH_DOS, future)
    return failed_score(key, "", Outcome.COLLISION if collides else Outcome.SUCCESS)


def test_a_comparison_says_what_its_pairs_would_show() -> None:
    a = [_row(i, future, collides=i < 4) for i in range(50) for future in range(2)]
    b = [_row(i, future, collides=False) for i in range(50) for future in range(2)]
    found = compare_rows(a, b)
    assert (found.n, found.scenarios, found.futures) == (100, 50, 2)
    # Both futures of four scenarios: a hundred pairs are as good as some fifty.
    assert found.detectable == pytest.approx(detectable_difference(50), rel=0.05)
    assert found.detectable is not None
    assert power_line(found) == (
        "Power: with a probability of 80 %, 100 pairs of 50 scenarios show a difference of "
        f"collisions of {100 * found.detectable:.1f} points or more, as "
        f"{200 * found.detectable:.1f} % halved."
    )
    few = compare_rows(a[:4], b[:4])
    assert power_line(few) == (
        "Power: 4 pairs of 2 scenarios are too few to show any difference of collisions."
    )
