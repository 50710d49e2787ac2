"""Differences of two sides that drove the same scenarios, with 95 % intervals and tests.

What is averaged is the difference within each scenario. Intervals take into account that several
scenarios are of one place, as all of ``dosplan.results.intervals``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np

from dosplan.results.intervals import LEVEL, effective_number, mean_interval, mean_test
from dosplan.types import FloatArray

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

    The interval is Tango's score interval of the effective number of scenarios (see
    ``effective_number``; the variance by places is then that of Obuchowski, "On the comparison of
    correlated proportions for clustered data", Statistics in Medicine 17, 1998). The test is
    McNemar's (1947), exact: among the scenarios whose verdicts differ, both directions are equally
    likely.

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
    weight = effective_number(b - a, places) / n
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
    """Compares means by the t test of the differences; see ``mean_test``.

    Where every place has one scenario, that is the paired t test.

    Args:
        a: (n,) values of side A, n > 0.
        b: (n,) those of side B.
        places: n names of the scenarios' places.

    Returns:
        The difference.
    """
    from scipy.stats import t

    n, differences = len(a), b - a
    mean, *ends = mean_interval(differences, places)
    low, high = ends if n > 1 else (None, None)
    p = None
    if n > 1:
        error, freedom = mean_test(differences, places)
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
