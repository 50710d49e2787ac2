"""The figures of an evaluation, as pure functions of arrays.

Shapes: ``...`` is any, W are windows (one road user seen at one step). Lengths are metres, areas
square metres. CR and OSA are those of "Towards Safe and Reliable Autonomous Driving: Dynamic
Occupancy Set Prediction" (Shao, Xu, Yu, Li, Wang).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dosplan.types import BoolArray, FloatArray, IntArray

COVERAGE: Final = 0.9  # What the sets of OSA@90 cover.
PAPER_AREAS: Final = (2.46, 5.83, 9.15, 13.36)
"""Mean area, m2, of the paper's own sets at 1, 2, 3, 4 s (its Table 1)."""
AREA_SCALES: Final = tuple(2.0 ** (k / 2.0) for k in range(-4, 5))
"""Factors on the semi-axes at which the areas of unions are kept."""

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Ratio:
    """A share or a mean with its standard error.

    Attributes:
        value: The ratio; None where nothing was counted.
        error: Its standard error over scenarios; None with fewer than two scenarios.
        n: How many windows were counted.
    """

    value: float | None
    error: float | None
    n: int


def displacement(predicted: FloatArray, truth: FloatArray) -> FloatArray:
    """Distance between predicted and true centres.

    Args:
        predicted: (..., 2) predicted centres, m.
        truth: (..., 2) true centres, m.

    Returns:
        (...) m; NaN where either is.
    """
    return np.asarray(np.linalg.norm(predicted - truth, axis=-1))


def average_displacement(total: FloatArray, count: IntArray) -> float | None:
    """ADE: the mean displacement over every pair of window and step that counts.

    A window whose recording ends early weighs less, by its missing steps.

    Args:
        total: (W,) sum of the displacements of a window, m.
        count: (W,) number of steps in that sum.

    Returns:
        m, or None where no pair counts.
    """
    pairs = int(count.sum())
    return float(total.sum()) / pairs if pairs else None


def mean_displacement(error: Floats) -> float | None:
    """Mean displacement at one step; at the last one, FDE.

    Args:
        error: (W,) displacements, m; NaN where there is no truth or no prediction.

    Returns:
        m, or None where nothing counts.
    """
    counted = np.isfinite(error)
    return float(error[counted].mean(dtype=np.float64)) if counted.any() else None


def covered(distance: Floats) -> BoolArray:
    """Whether a point is in its set; its boundary belongs to it.

    Args:
        distance: (...) Mahalanobis distances.

    Returns:
        (...) False where the distance is NaN.
    """
    return np.asarray(distance <= 1.0)


def clustered_ratio(values: npt.NDArray[Any], cluster: IntArray) -> Ratio:
    """Mean over windows; its standard error takes into account that a scenario's are correlated.

    The mean is a ratio of sums over scenarios c, R = sum y_c / sum n_c, and its error that of
    the ratio estimator (Cochran, "Sampling Techniques", 3rd ed., section 2.11 and ch. 6):
    var R = C / (C - 1) * sum (y_c - R n_c)^2 / (sum n_c)^2, C the number of scenarios that have
    a window at all.

    Args:
        values: (W,) what is averaged; booleans give a share.
        cluster: (W,) index of the scenario, >= 0.

    Returns:
        The mean, its error and W.
    """
    if not len(values):
        return Ratio(None, None, 0)
    total = np.bincount(cluster, weights=values)
    count = np.bincount(cluster)
    mean = float(total.sum() / len(values))
    clusters = int(np.count_nonzero(count))
    if clusters < 2:
        return Ratio(mean, None, len(values))
    spread = np.sum((total - mean * count) ** 2) * clusters / (clusters - 1)
    return Ratio(mean, float(np.sqrt(spread)) / len(values), len(values))


def covering_scale(distance: Floats, coverage: float = COVERAGE) -> float | None:
    """The smallest factor on all semi-axes that makes the sets cover a share of the windows.

    Args:
        distance: (W,) Mahalanobis distances to the sets as predicted.
        coverage: The wanted share.

    Returns:
        The factor: the quantile of the distances, itself one of them; None where there are no
        windows, or where no factor will do since sets are points.
    """
    if not len(distance):
        return None
    quantile: Callable[..., Any] = np.quantile
    factor = float(quantile(distance, coverage, method="inverted_cdf"))
    return factor if np.isfinite(factor) else None


def scaled_area(
    area: float | None, scale: float | None, shape: Floats | None = None
) -> float | None:
    """Mean area of sets whose semi-axes are multiplied by a factor: OSA@90.

    The area of an ellipse grows with the square of the factor, that of a union by less, since its
    components come to have more in common.

    Args:
        area: Mean area as predicted, m2.
        scale: The factor of ``covering_scale``.
        shape: (9,) mean area at each of ``AREA_SCALES`` over the factor's square, m2; None where
            every set is one ellipse. Between them, areas and factors are taken to be straight in
            their logarithms.

    Returns:
        m2; None where either is missing or the sets have no area.
    """
    if scale is None or not area:
        return None
    if shape is None or scale == 0.0:
        return area * scale**2
    return float(np.exp(np.interp(np.log(scale), *_growth(shape))))


def coverage_at_area(
    distance: Floats, area: float | None, wanted: float, shape: Floats | None = None
) -> float | None:
    """Share that sets cover when one factor on their semi-axes gives them a wanted mean area.

    The factor, sqrt(wanted / area) for ellipses, depends on the sets alone, not on the truth.

    Args:
        distance: (W,) Mahalanobis distances to the sets as predicted.
        area: Their mean area, m2.
        wanted: The mean area they shall have, m2.
        shape: As for ``scaled_area``.

    Returns:
        The share; None where there are no windows or the sets have no area.
    """
    if not len(distance) or not area:
        return None
    scale = np.sqrt(wanted / area)
    if shape is not None:
        logs, log_areas = _growth(shape)
        scale = np.exp(np.interp(np.log(wanted), log_areas, logs))
    return float(np.mean(distance <= np.float32(scale)))


def _growth(shape: Floats) -> tuple[FloatArray, FloatArray]:
    """Logarithms of factors and of the mean areas they give; beyond the ends as for ellipses."""
    logs = np.log(AREA_SCALES)
    far = np.array([-20.0, *logs, 20.0])
    return far, np.log(np.pad(shape, 1, mode="edge").astype(np.float64)) + 2.0 * far
