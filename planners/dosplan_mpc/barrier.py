"""A line before which the ego has to stop, as a forbidden set behind it."""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import PATH_HEADING, PATH_X, PATH_Y, EvenPath
from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.obstacles import ForbiddenSets
from dosplan_mpc.shape import disc_offsets

BARRIER_ID: Final = int(np.iinfo(np.int64).min)
"""Stands for the line among the ids of road users."""


def barrier(
    config: MpcConfig,
    vehicle: VehicleParameters,
    path: EvenPath,
    line: float,
    penalty: FloatArray,
) -> ForbiddenSets:
    """A standing set that begins at the line.

    Its near side is where the ego's foremost disc is when the ego's front is at the line.

    Args:
        config: Settings.
        vehicle: The ego.
        path: Reference path.
        line: Arc length of the line, m.
        penalty: (T,) penalty at each step.

    Returns:
        One set.
    """
    discs, _ = disc_offsets(vehicle, config.discs)
    front = vehicle.rear_to_centre + 0.5 * vehicle.length
    row = path.at(np.array(line))
    cos, sin = np.cos(row[PATH_HEADING]), np.sin(row[PATH_HEADING])
    size, steps = config.barrier, len(penalty)
    ahead = size.length - (front - float(discs[-1]))
    centre = np.array([row[PATH_X] + ahead * cos, row[PATH_Y] + ahead * sin])
    matrix = np.array(
        [[cos / size.length, sin / size.length], [-sin / size.width, cos / size.width]]
    )
    return ForbiddenSets(
        ids=np.array([BARRIER_ID]),
        centre=np.tile(centre, (1, steps, 1)),
        matrix=np.tile(matrix, (1, steps, 1, 1)),
        penalty=penalty[None],
    )
