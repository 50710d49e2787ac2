"""95 % intervals of what is averaged over scenarios."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from dosplan.types import FloatArray

_RESAMPLES: Final = 10_000
_DRAWN_AT_ONCE: Final = 1_000_000  # The draws of a million scenarios would not fit at once.
_SEED: Final = 0  # An interval is part of a result, so it is the same each time.


class Interval(NamedTuple):
    """A value between its bounds.

    Attributes:
        value: The value.
        low: Lower end of the 95 % interval.
        high: Upper end.
    """

    value: float
    low: float
    high: float


def share_interval(count: int, n: int) -> Interval:
    """A share with Wilson's interval.

    Args:
        count: How many it holds for.
        n: Of how many, > 0.

    Returns:
        The share and its interval.
    """
    from scipy.stats import binomtest  # A slow import that listing does without.

    found = binomtest(count, n).proportion_ci(method="wilson")
    return Interval(count / n, float(found.low), float(found.high))


def mean_interval(values: FloatArray) -> Interval:
    """A mean with its percentile-bootstrap interval.

    Efron, Tibshirani, "An Introduction to the Bootstrap", 1993, ch. 13.

    Args:
        values: (n,) values, n > 0.

    Returns:
        The mean and its interval.
    """
    rng = np.random.default_rng(_SEED)
    means = np.empty(_RESAMPLES)
    block = max(_DRAWN_AT_ONCE // len(values), 1)
    for first in range(0, _RESAMPLES, block):
        part = means[first : first + block]
        picks = rng.integers(len(values), size=(len(part), len(values)))
        part[:] = values[picks].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5]).tolist()
    return Interval(float(values.mean()), low, high)
