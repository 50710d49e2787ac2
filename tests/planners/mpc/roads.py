"""Stages of a straight road, for tests and times of the optimal control problem."""

from __future__ import annotations

import numpy as np
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.obstacles import ForbiddenSets
from dosplan_mpc.shape import STATIONS, station_offsets
from dosplan_mpc.stage import Edge, Reference, StageParameters, Station

from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters


def straight_stages(
    x: FloatArray, slots: int, sets: ForbiddenSets, right: float = 5.0
) -> StageParameters:
    """A road along +x with its left edge 5 m aside, driven at 10 m/s.

    Args:
        x: (N + 1,) where the guess is, m.
        slots: Number of slots of a stage.
        sets: Forbidden sets of stages 1 .. N.
        right: Distance of the right edge, m.

    Returns:
        Parameters of the stages.
    """
    zero = np.zeros(len(x))
    ahead = np.tile(station_offsets(VehicleParameters()), (len(x), 1))
    return StageParameters(
        reference=Reference(
            path=_along_x(x),
            velocity=np.full(len(x), 10.0),
            offset=zero,
            station=zero,
            station_weight=zero,
            heading=zero,
            heading_weight=zero,
            comfort=np.full(len(x), MpcConfig().utmost.comfort),
        ),
        stations=Station(
            right=Edge(_along_x(x[:, None] + ahead), np.full((len(x), STATIONS), -right), ahead),
            left=Edge(_along_x(x[:, None] + ahead), np.full((len(x), STATIONS), 5.0), ahead),
        ),
        slots=sets.fill(slots),
    )


def _along_x(x: FloatArray) -> FloatArray:
    """(..., 4) the path: the x axis."""
    zero = np.zeros_like(x)
    return np.stack([x, zero, zero, zero], axis=-1)
