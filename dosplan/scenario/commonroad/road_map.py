"""Lanelets and the drivable area."""

from __future__ import annotations

from typing import Any, Final

import shapely
from shapely.geometry import MultiPolygon, Polygon

from dosplan.geometry import areas, lanelet_polygon
from dosplan.types import Lanelet, RoadMap

SEAM: Final = 0.1
"""Half the width of the gaps between lanelets that count as road, m.

Neighbouring lanelets of recorded maps do not share their bounds exactly, and where several meet
they leave slivers open. Of the published solutions (71 looked at), 13 leave the plain union of
lanelets and none the union with gaps of up to 0.04 m closed. A gap of 0.2 m is narrower than a
car's tyre: none that narrow is an edge of the road that a car could drive off.
"""
_CARS: Final = frozenset({"VEHICLE", "CAR"})
_NO_CARS: Final = frozenset({"BICYCLE_LANE", "CROSSWALK", "SIDEWALK"})


def drivable_area(lanelets: tuple[Lanelet, ...]) -> Polygon | MultiPolygon:
    """Union of the lanelets with the seams between them closed (see ``SEAM``).

    Args:
        lanelets: Every lanelet of the map.

    Returns:
        The area on which the ego may drive, m.
    """
    union = shapely.union_all([lanelet_polygon(x.left, x.right) for x in lanelets])
    grown = shapely.buffer(union, SEAM, join_style="mitre")
    return areas(shapely.buffer(grown, -SEAM, join_style="mitre"))


def read_road_map(network: Any) -> RoadMap:
    """The map of a commonroad-io lanelet network.

    Links to lanelets that it does not hold are dropped, and so are those between a lanelet for
    cars and one that is not.

    Args:
        network: A ``LaneletNetwork``.

    Returns:
        The map.
    """
    for_cars = {lanelet.lanelet_id: _is_for_cars(lanelet) for lanelet in network.lanelets}
    lanelets = tuple(_lanelet(network, lanelet, for_cars) for lanelet in network.lanelets)
    return RoadMap(lanelets, drivable_area(lanelets))


def _lanelet(network: Any, lanelet: Any, for_cars: dict[int, bool]) -> Lanelet:
    use = for_cars[lanelet.lanelet_id]

    def alike(names: list[int]) -> tuple[int, ...]:
        return tuple(name for name in names if for_cars.get(name) is use)

    def neighbour(name: int | None, same_direction: bool | None) -> int | None:
        return name if same_direction and name is not None and alike([name]) else None

    return Lanelet(
        id=lanelet.lanelet_id,
        left=lanelet.left_vertices[:, :2],
        right=lanelet.right_vertices[:, :2],
        successors=alike(lanelet.successor),
        predecessors=alike(lanelet.predecessor),
        left_neighbour=neighbour(lanelet.adj_left, lanelet.adj_left_same_direction),
        right_neighbour=neighbour(lanelet.adj_right, lanelet.adj_right_same_direction),
        speed_limit=_speed_limit(network, lanelet),
        for_cars=use,
    )


def _is_for_cars(lanelet: Any) -> bool:
    """Whether neither the type of a lanelet nor the users it names exclude cars."""
    users = {user.name for user in lanelet.user_one_way | lanelet.user_bidirectional}
    types = {kind.name for kind in lanelet.lanelet_type}
    return types.isdisjoint(_NO_CARS) and (not users or not users.isdisjoint(_CARS))


def _speed_limit(network: Any, lanelet: Any) -> float | None:
    """Lowest limit on a lanelet's traffic signs, m/s.

    commonroad-io's own interpreter knows the signs of a few countries only; every country's
    sign is called MAX_SPEED, so the name is enough.
    """
    signs = (network.find_traffic_sign_by_id(name) for name in sorted(lanelet.traffic_signs))
    limits = [
        float(element.additional_values[0])
        for sign in signs
        if sign is not None
        for element in sign.traffic_sign_elements
        if element.traffic_sign_element_id.name == "MAX_SPEED" and element.additional_values
    ]
    if any(limit < 0.0 for limit in limits):
        raise ValueError(f"lanelet {lanelet.lanelet_id} has a speed limit below zero; correct it")
    return min(limits, default=None)
