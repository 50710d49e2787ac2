"""Poses of which no step tells what happens more than 0.8 s later.

Futures of one past branch 0.8 s after its end or later, so their pasts are the same. Smoothing
reaches as far as ``RADIUS``, velocities one step farther.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from suitegen.motion import PEDESTRIAN_SIGMA, Motion, smooth, speed_of, vehicle_motion
from suitegen.traffic import Trace

from .staging import PEDESTRIAN

RADIUS = 7
"""How many steps before and after one have a say in its pose."""


def _walk(trace: Trace) -> Motion:
    """Poses of somebody on foot, who faces where SUMO says."""
    centre = smooth(trace.front, PEDESTRIAN_SIGMA, RADIUS)
    heading = smooth(trace.heading, PEDESTRIAN_SIGMA, RADIUS)
    return Motion(trace, np.column_stack([centre, heading, speed_of(centre)]))


def motions(traces: Sequence[Trace]) -> dict[str, Motion]:
    """Motions of all who are seen at two steps or more.

    Args:
        traces: What SUMO drove in one future.

    Returns:
        Motions by the names of the road users.
    """
    return {
        trace.id: _walk(trace) if trace.kind == PEDESTRIAN else vehicle_motion(trace, RADIUS)
        for trace in traces
        if len(trace.front) > 1
    }
