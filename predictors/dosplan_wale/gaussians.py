"""Plane Gaussians as ellipses."""

from __future__ import annotations

import math

import numpy as np

from dosplan.types import FloatArray


def ellipses(spread: FloatArray, coverage: float) -> tuple[FloatArray, FloatArray]:
    """Ellipses that hold a share of plane Gaussians.

    The squared Mahalanobis distance of a plane Gaussian follows the chi-square distribution with
    two degrees of freedom, whose quantile at p is -2 ln(1 - p). The semi-axes are the roots of
    the covariance's eigenvalues times that.

    Args:
        spread: (..., 3) reciprocal standard deviations along x and y, 1/m, and correlation.
        coverage: The share p, in (0, 1).

    Returns:
        (..., 2) semi-axes, m, the longer one first, and (...) its direction, rad.
    """
    x, y = 1.0 / spread[..., 0], 1.0 / spread[..., 1]
    both = spread[..., 2] * x * y
    covariance = np.stack([np.stack([x * x, both], -1), np.stack([both, y * y], -1)], -1)
    variances, axes = np.linalg.eigh(covariance)  # In ascending order.
    quantile = -2.0 * math.log1p(-coverage)
    semi_axes = np.sqrt(quantile * np.maximum(variances[..., ::-1], 0.0))
    return semi_axes, np.arctan2(axes[..., 1, 1], axes[..., 0, 1])
