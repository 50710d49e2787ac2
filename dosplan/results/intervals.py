"""95 % intervals of what is averaged over episodes.

Scenarios of one place resemble each other, and futures of one scenario do, so they carry less
information than as many of different places. The variance of a mean is estimated from the sums over
places, taken as independent. Where every place has one episode, all intervals are those of
independent ones. Where there is one place alone, its scenarios are taken as independent, and an
interval says nothing about other places; where there is one scenario alone, likewise its futures.
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
    scenarios = [row.scenario for row in rows if metric.value(row) is not None]
    if not len(values) or metric.aggregate not in (Aggregate.SHARE, Aggregate.MEAN):
        return None
    return (share_interval if metric.is_share else mean_interval)(values, scenarios)


def share_interval(verdicts: FloatArray, scenarios: Sequence[str]) -> Interval:
    """A share with Wilson's score interval, of the effective number of episodes.

    Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
    American Statistical Association 22, 1927; see ``effective_number``.

    Args:
        verdicts: (n,) 0 or 1 in each episode, n > 0.
        scenarios: n ids of the scenarios they are of.

    Returns:
        The share and its interval.
    """
    share, n = float(verdicts.mean()), effective_number(verdicts, scenarios)
    z = NormalDist().inv_cdf(0.5 + 0.5 * LEVEL)
    centre = share + z * z / (2.0 * n)
    half = z * math.sqrt(share * (1.0 - share) / n + (z / (2.0 * n)) ** 2)
    whole = 1.0 + z * z / n
    # At shares of 0 and 1 an end is the share itself, which rounding may miss.
    low, high = min((centre - half) / whole, share), max((centre + half) / whole, share)
    return Interval(share, max(low, 0.0), min(high, 1.0))


def mean_interval(values: FloatArray, scenarios: Sequence[str]) -> Interval:
    """A mean with its t interval; see ``mean_test``.

    Args:
        values: (n,) values, n > 0.
        scenarios: n ids of the scenarios they are of.

    Returns:
        The mean and its interval.
    """
    from scipy.stats import t  # A slow import that listing does without.

    mean = float(values.mean())
    if len(values) == 1:
        return Interval(mean, math.nan, math.nan)
    error, freedom = mean_test(values, scenarios)
    half = float(t.ppf(0.5 + 0.5 * LEVEL, freedom)) * error
    return Interval(mean, mean - half, mean + half)


def mean_test(values: FloatArray, scenarios: Sequence[str]) -> MeanTest:
    """The error of a mean.

    The standard error is the cluster-robust one (Liang, Zeger, "Longitudinal data analysis using
    generalized linear models", Biometrika 73, 1986), with as many degrees of freedom as there are
    places less one (Cameron, Miller, "A practitioner's guide to cluster-robust inference", Journal
    of Human Resources 50, 2015). Where every place has one episode, it is the usual one.

    Args:
        values: (n,) values, n > 1.
        scenarios: n ids of the scenarios they are of.

    Returns:
        Standard error and degrees of freedom.
    """
    sums = sums_over(values - values.mean(), independent_groups(scenarios))
    freedom = len(sums) - 1
    return MeanTest(math.sqrt(len(sums) / freedom * float(sums @ sums)) / len(values), freedom)


def effective_number(values: FloatArray, scenarios: Sequence[str]) -> float:
    """Number of independent episodes that carry as much information as these.

    The number of episodes over the ``design_effect`` of places. As the variance is estimated from
    few places only, it is also multiplied by the squared ratio of the t quantiles of ``n - 1`` and
    of ``places - 1`` degrees of freedom (Korn, Graubard, "Confidence intervals for proportions with
    small expected number of positive counts estimated from survey data", Survey Methodology 24,
    1998).

    Args:
        values: (n,) value in each episode, n > 0.
        scenarios: n ids of the scenarios they are of.

    Returns:
        The number, ``n`` at most.
    """
    from scipy.stats import t

    groups = independent_groups(scenarios)
    n, count = len(values), len(set(groups))
    if count in (1, n):
        return float(n)
    many, few = t.ppf(0.5 + 0.5 * LEVEL, [n - 1, count - 1])
    return n / design_effect(values, groups) * float(many / few) ** 2


def design_effect(values: FloatArray, groups: Sequence[str]) -> float:
    """How many values are as good as one of independent ones, as groups have several each.

    Args:
        values: (n,) values.
        groups: n names of the groups they belong to, which are independent.

    Returns:
        The variance of the mean by groups over that of independent values, 1 at least; 1 where
        all values are the same, so that nothing is known of it.
    """
    n, count = len(values), len(set(groups))
    if count in (0, 1, n):
        return 1.0
    rest = values - values.mean()
    alone = n / (n - 1) * float(rest @ rest)
    sums = sums_over(rest, groups)
    return max(count / (count - 1) * float(sums @ sums) / alone, 1.0) if alone > 0.0 else 1.0


def independent_groups(scenarios: Sequence[str]) -> list[str]:
    """What is taken as independent.

    Args:
        scenarios: Ids of the scenarios of some episodes.

    Returns:
        For each episode its place; where all are of one place, its scenario.
    """
    places = [place_of(scenario) for scenario in scenarios]
    return places if len(set(places)) > 1 else list(scenarios)


def sums_over(values: FloatArray, groups: Sequence[str]) -> FloatArray:
    """Sums values over groups.

    Args:
        values: (n,) values.
        groups: n names of the groups they belong to.

    Returns:
        (K,) the sum over each group; the values themselves where there is one group.
    """
    _, group = np.unique(groups, return_inverse=True)
    sums = np.bincount(group, weights=values)
    return values if len(sums) == 1 else np.asarray(sums)
