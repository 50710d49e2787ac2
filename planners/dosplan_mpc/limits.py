"""Limits of a plan: those of the vehicle, less the planner's margins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import ComfortSettings, MpcConfig


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


def discomfort(
    comfort: ComfortSettings, along: Any, lateral: Any, maximum: Callable[[Any, float], Any]
) -> Any:
    """How far accelerations exceed what is comfortable: of arrays, or of CasADi's expressions.

    Args:
        comfort: From where on they do.
        along: Acceleration along the way, m/s2.
        lateral: Acceleration across it, m/s2.
        maximum: The larger one of two, element by element: NumPy's or CasADi's function.

    Returns:
        Sum of the squares of what is too much, m2/s4.
    """
    return (
        maximum(along - comfort.speeding, 0.0) ** 2
        + maximum(-along - comfort.braking, 0.0) ** 2
        + maximum(abs(lateral) - comfort.lateral, 0.0) ** 2
    )
