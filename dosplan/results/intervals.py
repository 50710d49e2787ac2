"""95 % intervals of what is averaged over scenarios.

Scenarios of one place resemble each other, so they carry less information than as many of different
places. The variance of a mean is estimated from the sums over places, taken as independent. Where
every place has one scenario, all intervals are those of independent scenarios. Where there is one
place alone, its scenarios are taken as independent, and an interval says nothing about other
places.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Final, NamedTuple

import numpy as np

from dosplan.scoring.metrics import Aggregate, Metric
from dosplan.types import FloatArray, Score, place_of

LEVEL: Final = 0.95


class Interval(NamedTuple):
    """A value between its bounds.

    Attributes:
        value: The value.
        low: Lower end of the 95 % interval; NaN for the mean of one value.
        high: Upper end.
    """

    value: float
    low: float
    high: float


class MeanTest(NamedTuple):
    """What a t test of a mean rests on.

    Attributes:
        error: Standard error of the mean.
        freedom: Degrees of freedom.
    """

    error: float
    freedom: int


def metric_interval(metric: Metric, rows: Sequence[Score]) -> Interval | None:
    """The interval of a metric's figure over the episodes of an arm.

    Args:
        metric: The metric.
        rows: Rows of the episodes.

    Returns:
        The interval of a share or a mean; None for other figures, and where nothing has a value.
    """
    values = metric.values(rows)
    places = [place_of(row.scenario) for row in rows if metric.value(row) is not None]
    if not len(values) or metric.aggregate not in (Aggregate.SHARE, Aggregate.MEAN):
        return None
    return (share_interval if metric.is_share else mean_interval)(values, places)


def share_interval(verdicts: FloatArray, places: Sequence[str]) -> Interval:
    """A share with Wilson's score interval, of the effective number of scenarios.

    Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
    American Statistical Association 22, 1927; see ``effective_number``.

    Args:
        verdicts: (n,) 0 or 1 in each scenario, n > 0.
        places: n names of the scenarios' places.

    Returns:
        The share and its interval.
    """
    share, n = float(verdicts.mean()), effective_number(verdicts, places)
    z = NormalDist().inv_cdf(0.5 + 0.5 * LEVEL)
    centre = share + z * z / (2.0 * n)
    half = z * math.sqrt(share * (1.0 - share) / n + (z / (2.0 * n)) ** 2)
    whole = 1.0 + z * z / n
    return Interval(share, max(centre - half, 0.0) / whole, min((centre + half) / whole, 1.0))


def mean_interval(values: FloatArray, places: Sequence[str]) -> Interval:
    """A mean with its t interval; see ``mean_test``.

    Args:
        values: (n,) values, n > 0.
        places: n names of the scenarios' places.

    Returns:
        The mean and its interval.
    """
    from scipy.stats import t  # A slow import that listing does without.

    mean = float(values.mean())
    if len(values) == 1:
        return Interval(mean, math.nan, math.nan)
    error, freedom = mean_test(values, places)
    half = float(t.ppf(0.5 + 0.5 * LEVEL, freedom)) * error
    return Interval(mean, mean - half, mean + half)


def mean_test(values: FloatArray, places: Sequence[str]) -> MeanTest:
    """The error of a mean.

    The standard error is the cluster-robust one (Liang, Zeger, "Longitudinal data analysis using
    generalized linear models", Biometrika 73, 1986), with as many degrees of freedom as there are
    places less one (Cameron, Miller, "A practitioner's guide to cluster-robust inference", Journal
    of Human Resources 50, 2015). Where every place has one scenario, it is the usual one.

    Args:
        values: (n,) values, n > 1.
        places: n names of the scenarios' places.

    Returns:
        Standard error and degrees of freedom.
    """
    sums = _sums(values - values.mean(), places)
    freedom = len(sums) - 1
    return MeanTest(math.sqrt(len(sums) / freedom * float(sums @ sums)) / len(values), freedom)


def effective_number(values: FloatArray, places: Sequence[str]) -> float:
    """Number of independent scenarios that carry as much information as these.

    The number of scenarios over the design effect: the variance of the mean by places over that of
    independent scenarios, 1 at least. As the variance is estimated from few places only, the
    number is also multiplied by the squared ratio of the t quantiles of ``n - 1`` and of
    ``places - 1`` degrees of freedom (Korn, Graubard, "Confidence intervals for proportions with
    small expected number of positive counts estimated from survey data", Survey Methodology 24,
    1998).

    Args:
        values: (n,) value in each scenario, n > 0.
        places: n names of the scenarios' places.

    Returns:
        The number, ``n`` at most.
    """
    from scipy.stats import t

    n, count = len(values), len(set(places))
    if count in (1, n):
        return float(n)
    rest = values - values.mean()
    sums = _sums(rest, places)
    alone = n / (n - 1) * float(rest @ rest)
    effect = count / (count - 1) * float(sums @ sums) / alone if alone > 0.0 else 1.0
    many, few = t.ppf(0.5 + 0.5 * LEVEL, [n - 1, count - 1])
    return n / max(effect, 1.0) * float(many / few) ** 2


def _sums(values: FloatArray, places: Sequence[str]) -> FloatArray:
    """(K,) the sum over the scenarios of each place; (n,) the values where there is one place."""
    _, place = np.unique(places, return_inverse=True)
    sums = np.bincount(place, weights=values)
    return values if len(sums) == 1 else np.asarray(sums)
