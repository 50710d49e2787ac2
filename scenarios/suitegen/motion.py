"""From SUMO's traces to the poses of rectangles that move like vehicles.

SUMO moves the front bumper along the lane, in steps of a car-following model, and turns the body
arbitrarily. Here the front axle follows SUMO's smoothed trace and the rear axle is dragged behind
it (a tractrix), which is how a vehicle that steers its front wheels moves: headings, velocities and
positions agree with each other and with the kinematic single track.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters

from .traffic import STEP, Trace

VEHICLE_SIGMA = 2.5
"""Standard deviation of the smoothing of vehicles, steps."""
VEHICLE_RADIUS = 10
"""How many steps before and after count in it."""
PEDESTRIAN_SIGMA = 4.0
"""The same for pedestrians, whose walk SUMO moves sideways in jumps."""
PEDESTRIAN_RADIUS = 16
SUBSTEPS = 5

_EGO = VehicleParameters()
REAR_TO_CENTRE = _EGO.rear_to_centre / _EGO.length
WHEELBASE = _EGO.wheelbase / _EGO.length
FRONT_OVERHANG = 0.5 - (WHEELBASE - REAR_TO_CENTRE)


@dataclass(frozen=True)
class Motion:
    """A road user's recorded drive.

    Attributes:
        trace: SUMO's trace that it came from.
        states: (K, 4) centre x, y, m, heading, rad, and velocity, m/s, from ``trace.first`` on.
    """

    trace: Trace
    states: FloatArray

    @property
    def first(self) -> int:
        """First step."""
        return self.trace.first

    @property
    def last(self) -> int:
        """Last step."""
        return self.trace.first + len(self.states) - 1

    def window(self, first: int, last: int) -> FloatArray:
        """States at the steps from ``first`` to ``last``, both of which it must cover."""
        return self.states[first - self.first : last - self.first + 1]


def smooth(values: FloatArray, sigma: float, radius: int) -> FloatArray:
    """Gaussian smoothing along the first axis; the ends go on as they were.

    Args:
        values: (K, ...) values, one a step.
        sigma: Standard deviation, steps.
        radius: How many steps before and after one count.

    Returns:
        (K, ...) smoothed values.
    """
    pad = min(radius, len(values) - 1)
    if pad == 0:
        return values
    widths = [(pad, pad)] + [(0, 0)] * (values.ndim - 1)
    padded = np.pad(values, widths, mode="reflect", reflect_type="odd")
    smoothed = gaussian_filter1d(padded, sigma, axis=0, radius=radius)[pad:-pad]
    return np.asarray(smoothed, dtype=np.float64)


def _direction(heading: FloatArray) -> FloatArray:
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def _drag(front: FloatArray, heading: float, length: float) -> FloatArray:
    """Heading of a rod of the given length whose front end is led along ``front``, rad."""
    number = SUBSTEPS * (len(front) - 1) + 1
    fine, coarse = np.linspace(0.0, 1.0, number), np.linspace(0.0, 1.0, len(front))
    leads = zip(*(np.interp(fine, coarse, column).tolist() for column in front.T), strict=True)
    x, y = front[0] - length * np.array([math.cos(heading), math.sin(heading)])
    angles = []
    for lead_x, lead_y in leads:
        angle = math.atan2(lead_y - y, lead_x - x)
        x, y = lead_x - length * math.cos(angle), lead_y - length * math.sin(angle)
        angles.append(angle)
    return np.unwrap(angles)[::SUBSTEPS]


def speed_of(centre: FloatArray) -> FloatArray:
    """(K,) speed of whose centre is at (K, 2) places, m/s, by central differences."""
    return np.asarray(np.linalg.norm(np.gradient(centre, STEP, axis=0), axis=1))


def vehicle_motion(trace: Trace, radius: int = VEHICLE_RADIUS) -> Motion:
    """Poses of a vehicle.

    Args:
        trace: SUMO's trace of two steps or more.
        radius: How many steps before and after one have a say in its pose; its velocity has one
            more.

    Returns:
        Its motion.
    """
    length = trace.size[0]
    axle = trace.front - FRONT_OVERHANG * length * _direction(trace.heading)
    axle = smooth(axle, VEHICLE_SIGMA, radius)
    heading = _drag(axle, float(trace.heading[0]), WHEELBASE * length)
    centre = axle - (WHEELBASE - REAR_TO_CENTRE) * length * _direction(heading)
    return Motion(trace, np.column_stack([centre, heading, speed_of(centre)]))


def pedestrian_motion(trace: Trace) -> Motion:
    """Poses of a pedestrian, whose heading is the direction of motion.

    Args:
        trace: SUMO's trace of two steps or more.

    Returns:
        Its motion.
    """
    centre = smooth(trace.front, PEDESTRIAN_SIGMA, PEDESTRIAN_RADIUS)
    velocity = smooth(np.gradient(centre, STEP, axis=0), PEDESTRIAN_SIGMA, PEDESTRIAN_RADIUS)
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])
    walking = np.hypot(velocity[:, 0], velocity[:, 1]) > 0.3
    heading[~walking] = np.nan
    known = np.flatnonzero(walking)
    if len(known) == 0:
        heading = trace.heading
    else:
        # A waiting pedestrian keeps the last direction.
        latest = known[
            np.clip(np.searchsorted(known, np.arange(len(heading)), "right") - 1, 0, None)
        ]
        heading = smooth(np.unwrap(heading[latest]), PEDESTRIAN_SIGMA, PEDESTRIAN_RADIUS)
    return Motion(trace, np.column_stack([centre, heading, speed_of(centre)]))


def motions(traces: tuple[Trace, ...]) -> tuple[Motion, ...]:
    """Motions of all road users seen at two steps or more, in the order of the traces."""
    return tuple(
        pedestrian_motion(trace) if trace.kind == "pedestrian" else vehicle_motion(trace)
        for trace in traces
        if len(trace.front) > 1
    )
