"""Fault of a collision: nuPlan's classes.

Source: nuplan-devkit, ``no_ego_at_fault_collisions`` and its ``collision_utils``. The classes are
tried in the order of ``CollisionClass``. nuPlan looks at the first step at which shapes overlap,
up to 0.1 s into the collision; here the moment of contact is known, and the poses and velocities
of that moment are judged.

1. Stopped ego: ``|v| <= 0.05 m/s``. Not at fault.
2. Stopped track: the road user stands, by the same bound. At fault.
3. Active rear: the road user's centre is more than 150 degrees from the ego's heading, seen from
   the ego's rear axle. Not at fault, but for a cut-in (``imposed``).
4. Active front: the ego's front edge touches the road user. At fault.
5. Active lateral: all else. At fault where no single lane holds all corners of the ego, or where
   it is off the drivable area.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely

from dosplan.geometry import lanelet_polygon, rectangle_corners, wrap_angle
from dosplan.scoring.bounds import outside
from dosplan.scoring.collision import Contact, shape_at
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    CollisionClass,
    FloatArray,
    RoadMap,
    Tracks,
)
from dosplan.vehicle import VehicleParameters

STOPPED_VELOCITY: Final = 0.05
"""Speed up to which a road user or the ego counts as standing, m/s."""

BEHIND_ANGLE: Final = np.deg2rad(150.0)
"""Angle to the ego's heading, at its rear axle, beyond which a road user is behind it, rad."""

STRUCK: Final = (CollisionClass.ACTIVE_REAR, CollisionClass.STOPPED_EGO)
"""Classes in which others run into the ego; it is to blame for a cut-in alone (``imposed``)."""


def classify(contact: Contact, tracks: Tracks, vehicle: VehicleParameters) -> CollisionClass:
    """Sorts a collision into nuPlan's classes.

    Args:
        contact: The moment at which ego and road user touch.
        tracks: The road users as they were driven.
        vehicle: The ego's parameters.

    Returns:
        The first class that applies.
    """
    ego, user = contact.ego_state, contact.user_state
    heading = ego[USER_HEADING]
    forward = np.array([np.cos(heading), np.sin(heading)])
    to_user = user[:2] - (ego[:2] - vehicle.rear_to_centre * forward)
    angle = wrap_angle(np.arctan2(to_user[1], to_user[0]) - heading)
    # Of the full rectangle, which a contact is some millimetres inside of.
    front_left, _, _, front_right = rectangle_corners(ego[:3], vehicle.size)
    bumper = shapely.LineString([front_left, front_right])
    if abs(ego[USER_VELOCITY]) <= STOPPED_VELOCITY:
        return CollisionClass.STOPPED_EGO
    if abs(user[USER_VELOCITY]) <= STOPPED_VELOCITY:
        return CollisionClass.STOPPED_TRACK
    if abs(angle) > BEHIND_ANGLE:
        return CollisionClass.ACTIVE_REAR
    if bumper.intersects(shape_at(tracks, contact.user, user)):
        return CollisionClass.ACTIVE_FRONT
    return CollisionClass.ACTIVE_LATERAL


def at_fault(
    contact: Contact, kind: CollisionClass, road_map: RoadMap, vehicle: VehicleParameters
) -> bool:
    """Whether the ego is at fault in a collision.

    It is when it hits a standing road user, or hits one with its front bumper, and in a lateral
    collision while it is in several lanes or off the drivable area. That it is also to blame
    for what its entry into somebody's way leads to, where road users react, is judged by
    ``imposed.cut_in_demand``.

    Args:
        contact: The moment at which ego and road user touch.
        kind: The class of the collision.
        road_map: The map.
        vehicle: The ego's parameters.

    Returns:
        True where the ego is at fault.
    """
    if kind is CollisionClass.ACTIVE_LATERAL:
        pose = contact.ego_state[:3]
        return in_several_lanes(pose, vehicle.size, road_map) or bool(
            outside(pose[None], vehicle.size, road_map)[0]
        )
    return kind in (CollisionClass.STOPPED_TRACK, CollisionClass.ACTIVE_FRONT)


def in_several_lanes(pose: FloatArray, size: tuple[float, float], road_map: RoadMap) -> bool:
    """Whether no single lane holds the whole ego.

    A lane is a chain of lanelets, each a successor of the one before: to stand across the seam
    between a lanelet and its successor is to be in one lane. The four corners decide, as in
    nuPlan; a corner beside every lanelet is a matter of the drivable area and is left out.

    Args:
        pose: (3,) centre of the ego, m, and heading, rad.
        size: Length and width of the ego, m.
        road_map: The map.

    Returns:
        True where the corners are in more than one lane.
    """
    corners = rectangle_corners(pose, size)
    areas = np.array([lanelet_polygon(x.left, x.right) for x in road_map.lanelets])
    shapely.prepare(areas)
    inside = shapely.intersects(areas[:, None], shapely.points(corners))
    near = shapely.intersects(areas, shapely.Polygon(corners))
    held = {
        lanelet.id: frozenset(np.flatnonzero(row).tolist())
        for lanelet, row, close in zip(road_map.lanelets, inside, near, strict=True)
        if close
    }
    successors = {lanelet.id: lanelet.successors for lanelet in road_map.lanelets}

    def chain_holds(first: int, missing: frozenset[int], unused: frozenset[int]) -> bool:
        missing, unused = missing - held[first], unused - {first}
        return not missing or any(
            chain_holds(follower, missing, unused)
            for follower in successors[first]
            if follower in unused
        )

    needed = frozenset(np.flatnonzero(inside.any(axis=0)).tolist())
    return bool(needed) and not any(chain_holds(x, needed, frozenset(held)) for x in held)
