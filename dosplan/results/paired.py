"""Differences of two sides that drove the same scenarios, with 95 % intervals and tests.

Scenarios of one place resemble each other, so they tell less than as many of different places. What
is averaged is the difference within each scenario; how much its mean is worth is judged from the
sums over places, which are taken as independent. Where every place has one scenario, all figures
are those of independent pairs. Where there is one place alone, its scenarios are taken as
independent, and the figures say nothing about other places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.types import FloatArray

_LEVEL: Final = 0.95
_TINY: Final = 1e-12  # Keeps the search for a limit off the ends, where the score has no value.


@dataclass(frozen=True)
class Difference:
    """A figure on both sides, and its mean paired difference.

    Attributes:
        n: Number of scenarios it is over.
        places: Number of places these are of.
        a: Mean over the scenarios of side A.
        b: Mean over the same scenarios of side B.
        difference: ``b - a``.
        low: Lower end of the 95 % interval of the difference; None where one scenario has none.
        high: Upper end.
        only_a: Scenarios in which it is so on side A alone; None for what is no share.
        only_b: The same for side B.
        p: Two-sided p. Of a share, that of the exact McNemar test, which takes scenarios as
            independent; of a mean, that of the t test by places. None where there is none.
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


def share_difference(a: FloatArray, b: FloatArray, places: Sequence[str]) -> Difference:
    """Compares how often something is so.

    The interval is Tango's score interval, with the number of scenarios replaced by the effective
    one; see ``effective_pairs``. The test is McNemar's (1947), exact: among the scenarios whose
    verdicts differ, both directions are equally likely.

    Args:
        a: (n,) 0 or 1 of side A in each scenario, n > 0.
        b: (n,) the same of side B.
        places: n names of the scenarios' places.

    Returns:
        The difference.
    """
    from scipy.stats import binomtest  # A slow import that the rest of a run does without.

    only_a, only_b = int(np.sum(a > b)), int(np.sum(b > a))
    n, discordant = len(a), only_a + only_b
    weight = effective_pairs(b - a, places) / n
    low, high = tango_interval(weight * only_b, weight * only_a, weight * n)
    return Difference(
        n=n,
        places=len(set(places)),
        a=float(a.mean()),
        b=float(b.mean()),
        difference=(only_b - only_a) / n,
        low=low,
        high=high,
        only_a=only_a,
        only_b=only_b,
        p=float(binomtest(only_b, discordant).pvalue) if discordant else 1.0,
    )


def mean_difference(a: FloatArray, b: FloatArray, places: Sequence[str]) -> Difference:
    """Compares means.

    Interval and p are those of a t test with the cluster-robust standard error of the mean (Liang,
    Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73, 1986) and as
    many degrees of freedom as there are places less one (Cameron, Miller, "A practitioner's guide
    to cluster-robust inference", Journal of Human Resources 50, 2015). Where every place has one
    scenario, that is the paired t test.

    Args:
        a: (n,) values of side A, n > 0.
        b: (n,) those of side B.
        places: n names of the scenarios' places.

    Returns:
        The difference.
    """
    from scipy.stats import t

    n, differences = len(a), b - a
    mean = float(differences.mean())
    low = high = p = None
    if n > 1:
        sums = _sums(differences - mean, places)
        error = math.sqrt(len(sums) / (len(sums) - 1) * float(sums @ sums)) / n
        freedom = len(sums) - 1
        half = float(t.ppf(0.5 + 0.5 * _LEVEL, freedom)) * error
        low, high = mean - half, mean + half
        if error > 0.0:
            p = 2.0 * float(t.sf(abs(mean) / error, freedom))
        elif mean == 0.0:
            p = 1.0
    return Difference(
        n=n,
        places=len(set(places)),
        a=float(a.mean()),
        b=float(b.mean()),
        difference=mean,
        low=low,
        high=high,
        p=p,
    )


def tango_interval(
    first: float, second: float, n: float, level: float = _LEVEL
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
    from statistics import NormalDist

    z = NormalDist().inv_cdf(0.5 + 0.5 * level)
    return -_upper_limit(second, first, n, z), _upper_limit(first, second, n, z)


def effective_pairs(differences: FloatArray, places: Sequence[str]) -> float:
    """How many independent scenarios tell as much as these.

    The number of scenarios over the design effect: the variance of the mean difference by places
    (Obuchowski, "On the comparison of correlated proportions for clustered data", Statistics in
    Medicine 17, 1998) over that of independent scenarios, 1 at least. That the variance is known
    from few places only is paid for in the number, too: it is multiplied by the squared ratio of
    the t quantiles of ``n - 1`` and of ``places - 1`` degrees of freedom (Korn, Graubard,
    "Confidence intervals for proportions with small expected number of positive counts estimated
    from survey data", Survey Methodology 24, 1998).

    Args:
        differences: (n,) -1, 0 or 1 in each scenario, n > 0.
        places: n names of the scenarios' places.

    Returns:
        The number, ``n`` at most.
    """
    from scipy.stats import t

    n, count = len(differences), len(set(places))
    if count in (1, n):
        return float(n)
    rest = differences - differences.mean()
    sums = _sums(rest, places)
    alone = n / (n - 1) * float(rest @ rest)
    effect = count / (count - 1) * float(sums @ sums) / alone if alone > 0.0 else 1.0
    many, few = t.ppf(0.5 + 0.5 * _LEVEL, [n - 1, count - 1])
    return n / max(effect, 1.0) * float(many / few) ** 2


def _sums(values: FloatArray, places: Sequence[str]) -> FloatArray:
    """(K,) the sum over the scenarios of each place; (n,) the values where there is one place."""
    _, place = np.unique(places, return_inverse=True)
    sums = np.bincount(place, weights=values)
    return values if len(sums) == 1 else np.asarray(sums)


def _upper_limit(first: float, second: float, n: float, z: float) -> float:
    from scipy.optimize import brentq

    estimate = (first - second) / n
    if estimate >= 1.0 - 2.0 * _TINY:
        return 1.0
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
