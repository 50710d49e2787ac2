"""Differences of two sides that drove the same episodes, with 95 % intervals and tests.

What is averaged is the difference within each pair of episodes, of one scenario and future.
Intervals take into account that several futures are of one scenario and several scenarios of one
place, as all of ``dosplan.results.intervals``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np

from dosplan.results.intervals import (
    LEVEL,
    effective_number,
    independent_groups,
    mean_interval,
    mean_test,
    sums_over,
)
from dosplan.types import FloatArray, place_of

_TINY: Final = 1e-12  # Keeps the search for a limit off the ends, where the score has no value.


@dataclass(frozen=True)
class Difference:
    """A figure on both sides, and its mean paired difference.

    Attributes:
        n: Number of pairs it is over: scenarios times futures.
        places: Number of places these are of.
        a: Mean over the episodes of side A.
        b: Mean over the same episodes of side B.
        difference: ``b - a``.
        low: Lower end of the 95 % interval of the difference; None where one pair has none.
        high: Upper end.
        only_a: Pairs in which it is so on side A alone; None for what is no share.
        only_b: The same for side B.
        p: Two-sided p. Of a share, that of the exact sign-flip test, which takes scenarios as
            independent; with one future each, that is McNemar's exact test. Of a mean, that of the
            t test by places. None where there is none.
        p_places: Two-sided p of a share by the same sign-flip test, which takes places as
            independent; of a mean, the same as ``p``. Absent in summaries of earlier versions.
    """

    n: int
    places: int
    a: float
    b: float
    difference: float
    low: float | None
    high: float | None
    only_a: int | None = None
    only_b: int | None = None
    p: float | None = None
    p_places: float | None = None


def share_difference(a: FloatArray, b: FloatArray, scenarios: Sequence[str]) -> Difference:
    """Compares how often something is so.

    The interval is Tango's score interval of the effective number of episodes (see
    ``effective_number``; the variance by places is then that of Obuchowski, "On the comparison of
    correlated proportions for clustered data", Statistics in Medicine 17, 1998). The tests are
    those of ``sign_flip_p``, once by scenarios and once by places.

    Args:
        a: (n,) 0 or 1 of side A in each pair, n > 0.
        b: (n,) the same of side B.
        scenarios: n ids of the scenarios they are of.

    Returns:
        The difference.
    """
    only_a, only_b, n = int(np.sum(a > b)), int(np.sum(b > a)), len(a)
    weight = effective_number(b - a, scenarios) / n
    low, high = tango_interval(weight * only_b, weight * only_a, weight * n)
    return Difference(
        n=n,
        places=len(set(map(place_of, scenarios))),
        a=float(a.mean()),
        b=float(b.mean()),
        difference=(only_b - only_a) / n,
        low=low,
        high=high,
        only_a=only_a,
        only_b=only_b,
        p=sign_flip_p(sums_over(b - a, scenarios)),
        p_places=sign_flip_p(sums_over(b - a, independent_groups(scenarios))),
    )


def sign_flip_p(sums: FloatArray) -> float:
    """Exact test that neither side is better, of differences that come in groups.

    If neither is, a group's sum of differences is as likely to be its opposite, whatever goes on
    within the group. The p is the share of all 2^K choices of the K signs in which the total is as
    far from zero as it is. Where no sum is more than 1 in size, this is McNemar's test (1947),
    exact. The total is the numerator of the tests for such pairs by Obuchowski (see
    ``share_difference``) and by Durkalski, Palesch, Lipsitz, Rust, "Analysis of clustered
    matched-pair data", Statistics in Medicine 22, 2003; their chi-square needs many groups that
    differ, and here few do. Flipping the signs of whole groups: Winkler et al., "Multi-level block
    permutation", NeuroImage 123, 2015.

    Args:
        sums: (K,) the sum of the differences of each group, whole numbers.

    Returns:
        Two-sided p.
    """
    from scipy.stats import binom, binomtest  # A slow import that the rest of a run does without.

    sizes, counts = np.unique(np.abs(sums[sums != 0.0]).astype(np.int64), return_counts=True)
    if not len(sizes):
        return 1.0
    if sizes[-1] == 1:
        return float(binomtest(int(np.sum(sums > 0.0)), int(counts[0])).pvalue)
    # Groups of one size together have a binomial number of positive signs: the total, shifted to
    # begin at zero, is the sum over the sizes of twice the size times that number.
    law = np.ones(1)
    for size, count in zip(sizes.tolist(), counts.tolist(), strict=True):
        part = np.zeros(size * count + 1)
        part[::size] = binom.pmf(np.arange(count + 1), count, 0.5)
        law = np.convolve(law, part)
    largest = len(law) - 1
    away = np.abs(2 * np.arange(len(law)) - largest)
    return min(float(law[away >= abs(int(sums.sum()))].sum()), 1.0)


def mean_difference(a: FloatArray, b: FloatArray, scenarios: Sequence[str]) -> Difference:
    """Compares means by the t test of the differences; see ``mean_test``.

    Where every place has one pair, that is the paired t test.

    Args:
        a: (n,) values of side A, n > 0.
        b: (n,) those of side B.
        scenarios: n ids of the scenarios they are of.

    Returns:
        The difference.
    """
    from scipy.stats import t

    n, differences = len(a), b - a
    mean, *ends = mean_interval(differences, scenarios)
    low, high = ends if n > 1 else (None, None)
    p = None
    if n > 1:
        error, freedom = mean_test(differences, scenarios)
        # What rounding leaves of equal differences is no error.
        if error > _TINY * float(np.abs(differences).max()):
            p = 2.0 * float(t.sf(abs(mean) / error, freedom))
        elif mean == 0.0:
            p = 1.0
    return Difference(
        n=n,
        places=len(set(map(place_of, scenarios))),
        a=float(a.mean()),
        b=float(b.mean()),
        difference=mean,
        low=low,
        high=high,
        p=p,
        p_places=p,
    )


def tango_interval(
    first: float, second: float, n: float, level: float = LEVEL
) -> tuple[float, float]:
    """Score interval of the difference of two paired shares.

    Tango, "Equivalence test and confidence interval for the difference in proportions for the
    paired-sample design", Statistics in Medicine 17, 1998, equations 24 to 26. It holds for few
    pairs that differ: none of 150 and none leave an interval of a width.

    Args:
        first: Number of pairs in which it is so in the first sample alone; need not be whole.
        second: The same for the second.
        n: Number of pairs, > 0.
        level: Confidence level.

    Returns:
        Ends of the interval of ``(first - second) / n``.
    """
    z = NormalDist().inv_cdf(0.5 + 0.5 * level)
    return -_upper_limit(second, first, n, z), _upper_limit(first, second, n, z)


def _upper_limit(first: float, second: float, n: float, z: float) -> float:
    from scipy.optimize import brentq

    estimate = (first - second) / n
    if estimate >= 1.0 - 2.0 * _TINY:
        return 1.0
    if estimate <= -1.0 + 2.0 * _TINY:  # The score is -sqrt(n (1 + d) / (1 - d)) then.
        return (z * z - n) / (z * z + n)
    return float(
        brentq(
            lambda difference: _score(difference, first, second, n) + z,
            max(estimate, -1.0) + _TINY,
            1.0 - _TINY,
        )
    )


def _score(difference: float, first: float, second: float, n: float) -> float:
    """Tango's statistic for a true difference, which falls as that grows."""
    # The most likely share of the second kind of pairs if that is the difference.
    a = 2.0 * n
    b = -first - second + (2.0 * n - first + second) * difference
    c = -second * difference * (1.0 - difference)
    share = (math.sqrt(b * b - 4.0 * a * c) - b) / (2.0 * a)
    variance = n * (2.0 * share + difference * (1.0 - difference))
    return (first - second - n * difference) / math.sqrt(variance)
