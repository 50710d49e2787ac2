"""Limits of a plan: those of the vehicle, less the planner's margins."""

from __future__ import annotations

from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig


def grip(config: MpcConfig, vehicle: VehicleParameters) -> float:
    """Radius of the friction circle that a plan may use.

    Args:
        config: Settings.
        vehicle: The ego.

    Returns:
        m/s2.
    """
    return config.grip * vehicle.max_acceleration


def half_width(config: MpcConfig, vehicle: VehicleParameters) -> float:
    """Distance that the ego's axis keeps from the road's edges.

    Args:
        config: Settings.
        vehicle: The ego.

    Returns:
        m.
    """
    return vehicle.width / 2.0 + config.road_margin
