"""The road users of a running simulation, between SUMO's way to say where they are and ours.

SUMO places a vehicle by the middle of its front bumper and counts angles in degrees, clockwise from
north. A pedestrian is placed by the middle of the body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dosplan.types import FloatArray, RoadUserKind

_NOWHERE: Final = 1e8
"""Coordinates from which on SUMO means that somebody is nowhere, m."""

_KINDS: Final = {
    RoadUserKind.CAR: (
        "army", "authority", "custom1", "custom2", "delivery", "drone", "e-vehicle", "emergency",
        "evehicle", "hov", "passenger", "private", "taxi", "vip",
    ),
    RoadUserKind.TRUCK: ("trailer", "truck"),
    RoadUserKind.BUS: ("bus", "coach"),
    RoadUserKind.TRAIN: (
        "cable_car", "rail", "rail_electric", "rail_fast", "rail_urban", "subway", "tram",
    ),
    RoadUserKind.MOTORCYCLE: ("moped", "motorcycle"),
    RoadUserKind.BICYCLE: ("bicycle", "scooter"),
    RoadUserKind.PEDESTRIAN: ("pedestrian", "wheelchair"),
}  # fmt: skip
"""Our kinds, and SUMO's classes of each."""
_OF_CLASS: Final = {name: kind for kind, names in _KINDS.items() for name in names}
CLASS_OF: Final = {
    RoadUserKind.CAR: "passenger",
    RoadUserKind.TRUCK: "truck",
    RoadUserKind.BUS: "bus",
    RoadUserKind.TRAIN: "rail",
    RoadUserKind.MOTORCYCLE: "motorcycle",
    RoadUserKind.BICYCLE: "bicycle",
    RoadUserKind.PARKED: "passenger",
    RoadUserKind.UNKNOWN: "passenger",
}
"""SUMO's class of a vehicle of one of our kinds."""


@dataclass(frozen=True)
class User:
    """Somebody in SUMO.

    Attributes:
        name: SUMO's name.
        walks: Whether it is a person on foot.
        state: (4,) road-user state, in the map's coordinates.
    """

    name: str
    walks: bool
    state: FloatArray


def kind_of(sumo_class: str) -> RoadUserKind:
    """Our kind of a class of SUMO.

    Args:
        sumo_class: Its name.

    Returns:
        The kind; ``UNKNOWN`` for a class that is none of the road.
    """
    return _OF_CLASS.get(sumo_class, RoadUserKind.UNKNOWN)


def front_of(centre: FloatArray, heading: float, length: float) -> FloatArray:
    """Where SUMO places a vehicle.

    Args:
        centre: (2,) its centre, m.
        heading: rad.
        length: m.

    Returns:
        (2,) the middle of its front bumper, m.
    """
    return np.asarray(centre + 0.5 * length * np.array([np.cos(heading), np.sin(heading)]))


def angle_of(heading: float) -> float:
    """SUMO's angle of a heading.

    Args:
        heading: rad.

    Returns:
        Degrees, from 0 to 360.
    """
    return float((90.0 - np.rad2deg(heading)) % 360.0)


def heading_of(angle: float) -> float:
    """The heading of SUMO's angle.

    Args:
        angle: Degrees.

    Returns:
        rad, from -pi to pi.
    """
    turned = np.deg2rad(90.0 - angle)
    return float((turned + np.pi) % (2.0 * np.pi) - np.pi)


def users(sumo: Any, ego: str, offset: FloatArray) -> Iterator[User]:
    """Reads who is on the road.

    Args:
        sumo: The library.
        ego: The vehicle that is left out.
        offset: (2,) what is added to the map's coordinates to get SUMO's, m.

    Yields:
        Vehicles and people on foot. Who sits in a vehicle is part of it.
    """
    vehicle, person = sumo.vehicle, sumo.person
    for name in vehicle.getIDList():
        place = np.array(vehicle.getPosition(name))
        if name == ego or not np.all(np.abs(place) < _NOWHERE):
            continue
        heading = heading_of(vehicle.getAngle(name))
        centre = front_of(place - offset, heading, -vehicle.getLength(name))
        yield User(name, False, np.array([*centre, heading, vehicle.getSpeed(name)]))
    for name in person.getIDList():
        place = np.array(person.getPosition(name))
        if person.getVehicle(name) or not np.all(np.abs(place) < _NOWHERE):
            continue
        heading = heading_of(person.getAngle(name))
        yield User(name, True, np.array([*(place - offset), heading, person.getSpeed(name)]))
