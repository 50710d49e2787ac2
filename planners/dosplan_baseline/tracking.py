"""The speed that bends allow, and how far the built-in baselines plan."""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import ReferencePath, braking_envelope
from dosplan.types import FloatArray

PLAN_STEPS: Final = 30
"""Steps of a plan: 3 s."""


def bend_speed(
    path: ReferencePath, lateral: float, braking: float
) -> tuple[FloatArray, FloatArray]:
    """The fastest a vehicle may go at each point to take every bend ahead.

    Args:
        path: The path.
        lateral: Largest lateral acceleration, m/s2.
        braking: Deceleration with which it slows down before a bend, m/s2.

    Returns:
        (P,) arc length, m, and (P,) velocity, m/s.
    """
    squared = lateral / np.maximum(np.abs(path.curvature), 1e-6)
    return path.arclength, braking_envelope(squared, path.arclength, braking)
