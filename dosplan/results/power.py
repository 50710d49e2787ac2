"""What a comparison can show: the smallest difference of two paired shares that it would find.

The test is that of ``dosplan.results.paired.sign_flip_p`` by scenarios. Its power is reckoned as
that of McNemar's exact test over the effective number of pairs: their number over the design effect
of scenarios, as several futures of one scenario tell less than as many scenarios.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from dosplan.results.intervals import LEVEL, design_effect
from dosplan.types import FloatArray

POWER: Final = 0.8
"""Probability with which a difference is to be found."""
_STEPS: Final = 30  # Halvings of the interval in which the difference is searched.


def smallest_difference(differences: FloatArray, scenarios: Sequence[str]) -> float | None:
    """The smallest difference that pairs would show, as alike and as often undecided as they are.

    Args:
        differences: (n,) 1, 0 or -1: what something is on side B less what it is on side A.
        scenarios: n ids of the scenarios they are of.

    Returns:
        The true difference of the shares that is found with a probability of ``POWER``, where as
        many pairs go the other way as in fewer of the two directions here; None where there is
        none that so few pairs would show.
    """
    n = len(differences)
    other = min(float(np.mean(differences > 0)), float(np.mean(differences < 0))) if n else 0.0
    return detectable_difference(int(n / design_effect(differences, scenarios)), other)


def detectable_difference(n: int, other: float = 0.0) -> float | None:
    """The smallest difference of two paired shares that McNemar's exact test finds.

    Args:
        n: Number of independent pairs.
        other: Share of the pairs that go against the difference.

    Returns:
        The difference at which ``mcnemar_power`` is ``POWER``; None where none has so much.
    """
    low, high = 0.0, 1.0 - 2.0 * other
    if high <= 0.0 or mcnemar_power(n, other + high, other) < POWER:
        return None
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        if mcnemar_power(n, other + middle, other) < POWER:
            low = middle
        else:
            high = middle
    return high


def mcnemar_power(n: int, first: float, second: float) -> float:
    """Power of McNemar's exact two-sided test at 5 %, exact and unconditional.

    The number of pairs that differ is binomial, and of these the number that go the first way is
    (Duffy, "Asymptotic and exact power for the McNemar test and its analogue with R controls",
    Biometrics 40, 1984).

    Args:
        n: Number of independent pairs.
        first: Share of the pairs that differ in the way that is to be found.
        second: Share that differ the other way.

    Returns:
        Probability that the test finds a difference in the right direction.
    """
    from scipy.stats import binom  # A slow import that the rest of a run does without.

    differ = first + second
    if n < 1 or differ <= 0.0:
        return 0.0
    counts = np.arange(n + 1)
    # The least number that go the first way with which the test is significant.
    least = binom.isf(0.5 * (1.0 - LEVEL), counts, 0.5) + 1
    found = binom.sf(least - 1, counts, first / differ)
    return float(binom.pmf(counts, n, min(differ, 1.0)) @ found)
