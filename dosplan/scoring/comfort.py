"""nuPlan's comfort bounds, from driven states.

The bounds are those of nuplan-devkit's ``ego_is_comfortable``. nuPlan smooths before it compares,
with quadratic Savitzky-Golay filters over 8 samples for accelerations and 15 for derivatives, at
0.1 s. The same is done here, with 7 in place of 8, so that the filter is centred on its sample:
an input that is held for a step makes steps in the acceleration, whose plain differences are no
measure of what a passenger feels.

A drive is comfortable where all of it lies within

    -4.05 <= a <= 2.40 m/s2     |a_lat| <= 4.89 m/s2      a_lat = v * yaw rate, at the rear axle
    |da / dt| <= 4.13 m/s3      |d |(a, a_lat)| / dt| <= 8.37 m/s3
    |yaw rate| <= 0.95 rad/s    |yaw acceleration| <= 1.93 rad/s2
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.types import EGO_HEADING, EGO_VELOCITY, FloatArray

MIN_ACCELERATION: Final = -4.05
"""Longitudinal, m/s2."""

MAX_ACCELERATION: Final = 2.40
"""Longitudinal, m/s2."""

MAX_LATERAL_ACCELERATION: Final = 4.89
"""m/s2."""

MAX_LONGITUDINAL_JERK: Final = 4.13
"""m/s3."""

MAX_JERK: Final = 8.37
"""Rate of the magnitude of the acceleration, m/s3."""

MAX_YAW_RATE: Final = 0.95
"""rad/s."""

MAX_YAW_ACCELERATION: Final = 1.93
"""rad/s2."""

_SMOOTHING: Final = 7
_DERIVATIVE: Final = 15
_ORDER: Final = 2


@dataclass(frozen=True)
class Comfort:
    """Largest sizes that occur in a drive, each after smoothing.

    Attributes:
        comfortable: Whether every one of nuPlan's bounds holds.
        acceleration: |longitudinal acceleration|, m/s2.
        lateral_acceleration: |lateral acceleration| at the rear axle, m/s2.
        jerk: |longitudinal jerk|, m/s3.
    """

    comfortable: bool
    acceleration: float
    lateral_acceleration: float
    jerk: float


def comfort(states: FloatArray, dt: float) -> Comfort:
    """Judges a drive.

    Accelerations are differences of the velocity, one for each step, which is exact for inputs
    that are held for a step; the lateral one is velocity times yaw rate, both those of the step's
    middle. Yaw rate and yaw acceleration are derivatives of the heading. A drive that is shorter
    than a filter is smoothed as a whole; one of fewer than three steps counts as at rest and
    comfortable.

    Args:
        states: (K + 1, 5) ego states.
        dt: Step, s.

    Returns:
        The largest sizes and the verdict.
    """
    if len(states) <= _ORDER + 1:
        return Comfort(True, 0.0, 0.0, 0.0)
    velocity, heading = states[:, EGO_VELOCITY], np.unwrap(states[:, EGO_HEADING])
    longitudinal = _smooth(np.diff(velocity) / dt)
    lateral = _smooth(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(heading) / dt)
    longitudinal_jerk = _derivative(longitudinal, 1, dt)
    jerk = _derivative(np.hypot(longitudinal, lateral), 1, dt)
    yaw_rate, yaw_acceleration = _derivative(heading, 1, dt), _derivative(heading, 2, dt)
    comfortable = (
        longitudinal.min() >= MIN_ACCELERATION
        and longitudinal.max() <= MAX_ACCELERATION
        and _largest(lateral) <= MAX_LATERAL_ACCELERATION
        and _largest(longitudinal_jerk) <= MAX_LONGITUDINAL_JERK
        and _largest(jerk) <= MAX_JERK
        and _largest(yaw_rate) <= MAX_YAW_RATE
        and _largest(yaw_acceleration) <= MAX_YAW_ACCELERATION
    )
    return Comfort(
        bool(comfortable), _largest(longitudinal), _largest(lateral), _largest(longitudinal_jerk)
    )


def _smooth(values: FloatArray) -> FloatArray:
    from scipy.signal import savgol_filter  # Takes a second to import; see _derivative.

    return np.asarray(savgol_filter(values, min(_SMOOTHING, len(values)), _ORDER))


def _derivative(values: FloatArray, order: int, dt: float) -> FloatArray:
    from scipy.signal import savgol_filter  # Not paid by a process that only lists or compares.

    window = min(_DERIVATIVE, len(values))
    return np.asarray(savgol_filter(values, window, _ORDER, deriv=order, delta=dt))


def _largest(values: FloatArray) -> float:
    return float(np.abs(values).max())
