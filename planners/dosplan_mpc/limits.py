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
    comfort: ComfortSettings,
    along: Any,
    lateral: Any,
    share: Any,
    maximum: Callable[[Any, float], Any],
) -> Any:
    """What accelerations beyond what is comfortable cost: of arrays, or of CasADi's expressions.

    Args:
        comfort: From where on they do.
        along: Acceleration along the way, m/s2.
        lateral: Acceleration across it, m/s2.
        share: How much of the price counts, but for braking: a style may be in a hurry, and braking
            is for safety in each.
        maximum: The larger one of two, element by element: NumPy's or CasADi's function.

    Returns:
        Weighted sum of the squares of what is too much.
    """
    return (
        share * comfort.speeding_weight * maximum(along - comfort.speeding, 0.0) ** 2
        + comfort.braking_weight * maximum(-along - comfort.braking, 0.0) ** 2
        + share * comfort.lateral_weight * maximum(abs(lateral) - comfort.lateral, 0.0) ** 2
    )
