"""Upper limits: the smallest set of each shape that just touches the true centre.

No set around the same predicted position can cover the centre with less area. The paper shows
these limits as a figure and leaves open how long and thin an ellipse may be: without a bound the
smallest ellipse through a point has area zero. Here the ratio rho = a / b of the semi-axes (a
along the given angle) is within [1/R, R], R = ``MAX_RATIO``.

Derivation: with (u, v) the error along and across the angle, the ellipse touches where
(u / a)^2 + (v / b)^2 = 1, so a^2 = u^2 + rho^2 v^2 and the area pi a b = pi a^2 / rho is
pi (u^2 / rho + rho v^2). That is convex in rho > 0 with its minimum, 2 pi |u v|, at |u / v|; within
the bounds the minimum is at |u / v| cut to them. With the angle free as well, pi e^2 (cos^2 / rho
+ rho sin^2) >= pi e^2 / R, reached where the long axis points at the truth.

Of a prediction of several positions, as the components of a union have them, the smallest set that
touches the truth is around one of them: its area is the smallest of theirs.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.types import FloatArray

MAX_RATIO: Final = 4.0
BEST_OF: Final = 3  # Of up to so many positions, the most likely ones first, limits are given.
REPRESENTATIONS: Final = ("circle", "theta=0", "theta=pi/4", "v1", "v2", "free")


def circle_area(error: FloatArray) -> FloatArray:
    """Area of the circle around the prediction that touches the truth.

    Args:
        error: (..., 2) true minus predicted centre, m.

    Returns:
        (...) m2.
    """
    return np.asarray(np.pi * np.sum(error**2, axis=-1))


def ellipse_limit(error: FloatArray, angle: FloatArray, max_ratio: float = MAX_RATIO) -> FloatArray:
    """Area of the smallest ellipse of a given angle that touches the truth.

    Args:
        error: (..., 2) true minus predicted centre, m.
        angle: (...) direction of an axis, rad.
        max_ratio: Bound R >= 1 on the ratio of the semi-axes, whichever is longer.

    Returns:
        (...) m2.
    """
    x, y = np.moveaxis(error, -1, 0)
    along = np.abs(np.cos(angle) * x + np.sin(angle) * y)
    across = np.abs(np.cos(angle) * y - np.sin(angle) * x)
    # Divided only where the quotient is within the bound: what is across may be zero.
    within = along < max_ratio * across
    best = np.divide(along, across, out=np.full_like(along, max_ratio), where=within)
    ratio = np.maximum(best, 1.0 / max_ratio)
    return np.asarray(np.pi * (along**2 / ratio + ratio * across**2))


def free_limit(error: FloatArray, max_ratio: float = MAX_RATIO) -> FloatArray:
    """Area of the smallest ellipse of any angle that touches the truth.

    Args:
        error: (..., 2) true minus predicted centre, m.
        max_ratio: Bound R >= 1 on the ratio of the semi-axes.

    Returns:
        (...) m2.
    """
    return circle_area(error) / max_ratio


def upper_limits(
    error: FloatArray, heading: FloatArray, motion: FloatArray, predicted: FloatArray
) -> FloatArray:
    """Areas of the smallest sets of every representation.

    Args:
        error: (..., 2) true minus predicted centre, m.
        heading: (...) present heading, the x axis of the road user's frame, rad.
        motion: (...) direction of the present velocity, rad.
        predicted: (...) predicted heading at that step, rad.

    Returns:
        (..., 6) m2, in the order of ``REPRESENTATIONS``: the fixed angles are those of the road
        user's frame, v1 is along ``motion``, v2 along ``predicted``.
    """
    return np.stack(
        [
            circle_area(error),
            ellipse_limit(error, heading),
            ellipse_limit(error, heading + np.pi / 4.0),
            ellipse_limit(error, motion),
            ellipse_limit(error, predicted),
            free_limit(error),
        ],
        axis=-1,
    )
