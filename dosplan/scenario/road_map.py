"""Lanelets and the drivable area."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from dosplan.types import FloatArray, Lanelet, RoadMap

SEAM: Final = 0.05
"""Half the width of the gaps between lanelets that count as road, m.

Neighbouring lanelets of recorded maps do not share their bounds exactly. Of the published
solutions (71 looked at), 13 leave the plain union of lanelets and none the union with gaps of up
to 0.04 m closed; the rest of the 0.1 m that is closed here is reserve.
"""


def lanelet_cells(lanelet: Lanelet) -> FloatArray:
    """Quadrilaterals between consecutive pairs of a lanelet's bound points.

    Args:
        lanelet: A lanelet of P points.

    Returns:
        (P - 1, 4, 2) corners: left, next left, next right, right, m.
    """
    left, right = lanelet.left, lanelet.right
    return np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)


def lanelet_polygon(lanelet: Lanelet) -> Polygon | MultiPolygon:
    """Area of a lanelet.

    A lanelet whose bounds cross or fold back has no valid outline; its area is then the union of
    the convex hulls of its cells.

    Args:
        lanelet: A lanelet.

    Returns:
        A valid polygon, m.
    """
    outline = Polygon(np.concatenate([lanelet.left, lanelet.right[::-1]]))
    if outline.is_valid and outline.area > 0:
        return outline
    return areas(shapely.union_all(shapely.convex_hull(shapely.polygons(lanelet_cells(lanelet)))))


def areas(shape: shapely.Geometry) -> Polygon | MultiPolygon:
    """The polygons of a geometry, without the points and lines that overlays leave behind.

    Args:
        shape: Any geometry.

    Returns:
        One polygon, or several as a MultiPolygon (empty where there is none).
    """
    parts = [p for p in shapely.get_parts(shape) if isinstance(p, Polygon) and not p.is_empty]
    return parts[0] if len(parts) == 1 else MultiPolygon(parts)


def drivable_area(lanelets: tuple[Lanelet, ...]) -> Polygon | MultiPolygon:
    """Union of the lanelets with the seams between them closed (see ``SEAM``).

    Args:
        lanelets: Every lanelet of the map.

    Returns:
        The area on which the ego may drive, m.
    """
    union = shapely.union_all([lanelet_polygon(lanelet) for lanelet in lanelets])
    grown = shapely.buffer(union, SEAM, join_style="mitre")
    return areas(shapely.buffer(grown, -SEAM, join_style="mitre"))


def read_road_map(network: Any) -> RoadMap:
    """The map of a commonroad-io lanelet network; links to lanelets it does not hold are dropped.

    Args:
        network: A ``LaneletNetwork``.

    Returns:
        The map.
    """
    known = {lanelet.lanelet_id for lanelet in network.lanelets}

    def neighbour(name: int | None, same_direction: bool | None) -> int | None:
        return name if same_direction and name in known else None

    lanelets = tuple(
        Lanelet(
            id=lanelet.lanelet_id,
            left=lanelet.left_vertices[:, :2],
            right=lanelet.right_vertices[:, :2],
            successors=tuple(i for i in lanelet.successor if i in known),
            predecessors=tuple(i for i in lanelet.predecessor if i in known),
            left_neighbour=neighbour(lanelet.adj_left, lanelet.adj_left_same_direction),
            right_neighbour=neighbour(lanelet.adj_right, lanelet.adj_right_same_direction),
            speed_limit=_speed_limit(network, lanelet),
        )
        for lanelet in network.lanelets
    )
    return RoadMap(lanelets, drivable_area(lanelets))


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
    return min(limits, default=None)
