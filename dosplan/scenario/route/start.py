"""How far the ego's wheels are turned at its start."""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely

from dosplan.geometry import ReferencePath, rectangle_corners
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    STEP_SECONDS,
    FloatArray,
    RoadMap,
    Route,
)
from dosplan.vehicle import VehicleParameters

SLOWEST: Final = 0.1
"""Speed up to which a yaw rate says nothing about the wheels, m/s: files round both."""
_ALONG_ROUTE: Final = 0.87  # Cosine of the largest angle to the route at which it is followed.
_SHARES: Final = np.linspace(1.0, 0.0, 9)
_SECONDS: Final = 1.5
_ANGLES: Final = 11
_BRAKING: Final = (0.0, -4.0, -8.0)
_HAIRLINE: Final = 0.005


def wheels_by_yaw_rate(velocity: float, yaw_rate: float, vehicle: VehicleParameters) -> float:
    """The steering angle at which a car turns so fast.

    Args:
        velocity: m/s.
        yaw_rate: rad/s.
        vehicle: The ego.

    Returns:
        ``atan(l_wb yaw_rate / v)``, rad, within what the wheels can be turned; zero where the car
        all but stands.
    """
    if velocity <= SLOWEST:
        return 0.0
    angle = np.arctan(vehicle.wheelbase * yaw_rate / velocity)
    return float(np.clip(angle, -vehicle.max_steering, vehicle.max_steering))


def with_wheels_turned(
    start: FloatArray, route: Route, road_map: RoadMap, vehicle: VehicleParameters
) -> FloatArray:
    """The start with the wheels turned along the route where the file gives no yaw rate.

    Nine in ten files write a yaw rate of zero, in bends too. A car that follows its lane has
    its wheels turned already; with straight wheels it would leave a tight bend at once. One that
    cuts the bend has them turned less: they are turned only as far as the road can be kept from
    there, by some steering angle that is turned to at once, with or without braking; where it can
    be kept from no such start, all the way along the route.

    Args:
        start: (5,) ego state.
        route: The ego's way.
        road_map: The map.
        vehicle: The ego.

    Returns:
        (5,) ego state.
    """
    if start[EGO_STEERING] != 0.0:
        return start
    path = ReferencePath.of(route)
    along = path.locate_first(start[:2])
    if np.cos(start[EGO_HEADING] - path.heading_at(along)) < _ALONG_ROUTE:
        return start
    limit = vehicle.max_steering
    wanted = np.clip(np.arctan(vehicle.wheelbase * path.curvature_at(along)), -limit, limit)
    if wanted == 0.0:
        return start
    reach = vehicle.length + (_SECONDS * start[EGO_VELOCITY])
    road = road_map.road_within(*(start[:2] - reach), *(start[:2] + reach))
    road = shapely.buffer(road, _HAIRLINE)
    shapely.prepare(road)
    for share in _SHARES:
        steered = start.copy()
        steered[EGO_STEERING] = share * wanted
        if _keeps(steered, road, vehicle):
            return steered
    steered = start.copy()
    steered[EGO_STEERING] = wanted
    return steered


def _keeps(start: FloatArray, road: shapely.Geometry, vehicle: VehicleParameters) -> bool:
    """Whether some short drive from a start keeps the road."""
    angles = np.linspace(-vehicle.max_steering, vehicle.max_steering, _ANGLES)
    angles = np.append(angles, start[EGO_STEERING])
    wanted, braking = (x.ravel() for x in np.meshgrid(angles, _BRAKING))
    states = np.tile(start, (len(wanted), 1))
    alive = np.ones(len(wanted), dtype=np.bool_)
    for _ in range(round(_SECONDS / STEP_SECONDS)):
        turned = (wanted - states[:, EGO_STEERING]) / STEP_SECONDS
        inputs = vehicle.clip_input(states, np.column_stack([turned, braking]), STEP_SECONDS)
        states = vehicle.step(states, inputs, STEP_SECONDS)
        outlines = shapely.polygons(rectangle_corners(vehicle.poses(states), vehicle.size))
        alive &= shapely.covers(road, outlines)
        if not alive.any():
            return False
        states, wanted, braking = states[alive], wanted[alive], braking[alive]
        alive = alive[alive]
    return True
