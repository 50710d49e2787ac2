"""The distribution of scores given what is known of a road user: quantile regression.

The quantile of level p of a score d_M at step t, given covariates x, is

    q(p | x, t) = exp(a(x, t) + b(x, t) log(-log(1 - p))),

a Weibull distribution whose scale and shape depend on x. a and log b are linear in x;
each coefficient is interpolated linearly in the square root of time. They minimise
the pinball loss of log d_M at several levels at once (Koenker, "Quantile Regression", 2005; Zou and
Yuan, "Composite quantile regression", 2008). Where that loss is least, the share covered is p when
weighted by each function of x: this is what Gibbs, Cherian and Candes, "Conformal prediction with
conditional guarantees" (2025), ask for, but for their term for the one new window, which is of the
order of coefficients by windows. What is left is for split conformal to mend: it calibrates the
*rank* of a score, -log(1 - p), which is e.g. 1 at p = 63 % and 2.3 at 90 %, whatever x is
(Chernozhukov, Wuethrich and Zhu, "Distributional conformal prediction", 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from dosplan.types import FloatArray, IntArray, ShapeError

LEVELS: Final = (0.5, 0.75, 0.9, 0.95)
"""Levels at which the pinball loss is taken."""

TIMES: Final = 5
"""Steps between which coefficients are interpolated."""

OUTER: Final = (0.005, 0.995)
"""Quantiles of each covariate beyond which it counts as no further out: nothing is extrapolated."""

RIDGE: Final = 1e-3
"""Penalty on squared coefficients, but for the constant ones."""

STEPS: Final = 300
BATCH: Final = 4096
RATE: Final = 0.05

_SMALLEST: Final = 1e-3
"""Smaller scores count as this one: a thousandth of a set, which no level asks for."""
_SLOPES: Final = (0.2, 3.0)
"""Bounds of b."""


@dataclass(frozen=True, eq=False)
class ConditionalScores:
    """Quantiles of scores given F covariates, at T steps.

    Attributes:
        low: (F,) least value of each covariate that is told from smaller ones.
        high: (F,) greatest.
        scale: (1 + F, TIMES) coefficients of a at points in time, the constant first.
        shape: (1 + F, TIMES) coefficients of log b.
        horizon: Number T of steps.
    """

    low: FloatArray
    high: FloatArray
    scale: FloatArray
    shape: FloatArray
    horizon: int

    def __post_init__(self) -> None:
        covariates = len(self.low)
        size = (1 + covariates, TIMES)
        wanted = {"low": (covariates,), "high": (covariates,), "scale": size, "shape": size}
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise ShapeError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")

    @classmethod
    def fit(cls, scores: FloatArray, covariates: FloatArray, seed: int = 0) -> Self:
        """Fits the quantiles.

        Args:
            scores: (n, T) d_M; NaN where it is not recorded.
            covariates: (n, F) what is known.
            seed: Seed of the order in which windows are looked at.

        Returns:
            The quantiles.
        """
        low, high = np.quantile(covariates, OUTER, axis=0)
        design = _design(covariates, low, high)
        target = np.log(np.maximum(scores, _SMALLEST))
        horizon = scores.shape[1]
        scale, shape = _minimise(design, target, _over_time(horizon), seed)
        return cls(low, high, scale, shape, horizon)

    def rank(self, scores: FloatArray, covariates: FloatArray) -> FloatArray:
        """Where scores lie in their distributions.

        Args:
            scores: (N, T) d_M; NaN stays NaN.
            covariates: (N, F) what is known.

        Returns:
            (N, T) -log(1 - p) for scores that are quantiles of level p; 0 or more.
        """
        a, b = self._parameters(covariates)
        with np.errstate(over="ignore"):
            return np.asarray(np.exp((np.log(np.maximum(scores, _SMALLEST)) - a) / b))

    def score(self, rank: FloatArray, covariates: FloatArray) -> FloatArray:
        """The scores of given ranks, the inverse of ``rank``.

        Args:
            rank: (N, T) more than 0.
            covariates: (N, F) what is known.

        Returns:
            (N, T) d_M.
        """
        a, b = self._parameters(covariates)
        return np.asarray(np.exp(a + b * np.log(rank)))

    def _parameters(self, covariates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, T) a and b."""
        design = _design(covariates, self.low, self.high)
        over = _over_time(self.horizon)
        return design @ self.scale @ over, _slope(design @ self.shape @ over)


def _slope(value: FloatArray) -> FloatArray:
    return np.asarray(np.exp(np.clip(value, *np.log(_SLOPES))))


def _design(covariates: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """(N, 1 + F) one, and each covariate within its bounds, from -1/2 to 1/2."""
    bounded = np.clip(covariates, low, high)
    # Centred, so that no covariate takes the place of the constant.
    centred = (bounded - 0.5 * (low + high)) / np.maximum(high - low, 1e-9)
    return np.concatenate((np.ones((len(bounded), 1)), centred), axis=1)


def _over_time(horizon: int) -> FloatArray:
    """(B, T) weights of the points in time at each step: linear in the square root of time."""
    at = np.sqrt(np.arange(1, horizon + 1) / horizon)
    points = np.linspace(np.sqrt(1 / horizon), 1.0, TIMES)
    if horizon == 1:
        return np.full((TIMES, 1), 1.0 / TIMES)
    return np.stack([np.interp(at, points, row) for row in np.eye(TIMES)])


def _minimise(
    design: FloatArray, target: FloatArray, over: FloatArray, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Adam on the pinball loss; NaN in (n, T) targets counts for nothing."""
    random = np.random.default_rng(seed)
    known = np.isfinite(target)
    target = np.where(known, target, 0.0)
    levels = np.array(LEVELS)[:, None, None]
    at = np.log(-np.log1p(-levels))
    theta = np.zeros((2, design.shape[1], over.shape[0]))
    theta[0, 0] = np.mean(target[known])
    first, second = np.zeros_like(theta), np.zeros_like(theta)
    average = np.zeros_like(theta)
    for step in range(1, STEPS + 1):
        rows = random.integers(0, len(design), min(BATCH, len(design)))
        phi, y, counts = design[rows], target[rows], known[rows]
        a, g = phi @ theta[0] @ over, phi @ theta[1] @ over
        b = _slope(g)
        free = (g > np.log(_SLOPES[0])) & (g < np.log(_SLOPES[1]))
        # d loss / d quantile: 1 - p where the target is below it, -p above; by level.
        push = np.where(y < a + b * at, 1.0 - levels, -levels) * (counts / levels.size)
        total = max(int(counts.sum()), 1)
        to_a, to_g = push.sum(axis=0) / total, (push * at).sum(axis=0) * b * free / total
        gradient = np.stack([phi.T @ part @ over.T for part in (to_a, to_g)])
        gradient[:, 1:] += RIDGE * theta[:, 1:]
        first = 0.9 * first + 0.1 * gradient
        second = 0.99 * second + 0.01 * gradient**2
        rate = RATE * 0.5 * (1.0 + np.cos(np.pi * step / STEPS))
        move = first / (1 - 0.9**step) / (np.sqrt(second / (1 - 0.99**step)) + 1e-8)
        theta = theta - rate * move
        average = theta if step == 1 else 0.95 * average + 0.05 * theta
    return average[0], average[1]


def cross_fitted(
    scores: FloatArray, covariates: FloatArray, fold: IntArray
) -> tuple[ConditionalScores, FloatArray]:
    """Fits the quantiles, and ranks each score by those that were fitted without its fold.

    Split conformal wants ranks of scores that the quantiles were not fitted to. Setting a part
    aside would waste recordings; here every fold is ranked by what the others say (CV+, Barber,
    Candes, Ramdas and Tibshirani, "Predictive inference with the jackknife+", 2021).

    Args:
        scores: (n, T) d_M; NaN where it is not recorded.
        covariates: (n, F) what is known.
        fold: (n,) fold of each window; windows of one place share one.

    Returns:
        The quantiles fitted to all windows, and (n, T) ranks.

    Raises:
        ValueError: There is one fold only.
    """
    folds = np.unique(fold)
    if len(folds) < 2:
        raise ValueError("quantiles of scores need recordings of two places or more")
    ranks = np.full(scores.shape, np.nan)
    for left_out in folds:
        own = fold == left_out
        fitted = ConditionalScores.fit(scores[~own], covariates[~own])
        ranks[own] = fitted.rank(scores[own], covariates[own])
    return ConditionalScores.fit(scores, covariates), ranks
