"""What the optimal control problem knows of the ego's shape: covering discs and stations."""

from __future__ import annotations

import numpy as np

from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters

STATIONS = 5  # Equally spaced from the rear to the front bumper.


def disc_offsets(vehicle: VehicleParameters, count: int) -> tuple[FloatArray, float]:
    """Equal discs that cover the ego's rectangle.

    Args:
        vehicle: The ego.
        count: Number of discs.

    Returns:
        (count,) offsets of the centres ahead of the rear axle, m, and the radius, m.
    """
    piece = vehicle.length / count
    first = vehicle.rear_to_centre - vehicle.length / 2.0 + piece / 2.0
    return np.asarray(first + piece * np.arange(count), dtype=np.float64), float(
        np.hypot(piece, vehicle.width) / 2.0
    )


def station_offsets(vehicle: VehicleParameters) -> FloatArray:
    """Offsets of the stations ahead of the rear axle, m; the middle one is the centre.

    Args:
        vehicle: The ego.

    Returns:
        (STATIONS,) m.
    """
    half = vehicle.length / 2.0
    return np.asarray(vehicle.rear_to_centre + np.linspace(-half, half, STATIONS))
