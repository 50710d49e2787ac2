"""Whether the ego's rectangle is on the road: inside the drivable area, or on any lanelet.

A pose is off the road where a disc of 1 cm fits into what sticks out. What the road is, is among
the definitions; the road of CommonRoad is the union of all lanelets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from dosplan.geometry import lanelet_union, rectangle_corners
from dosplan.types import BoolArray, FloatArray, RoadMap

HAIRLINE: Final = 0.01
"""Width of a part outside that is ignored, m."""


def outside(poses: FloatArray, size: npt.ArrayLike, road_map: RoadMap) -> BoolArray:
    """Tells for each pose whether part of the rectangle is outside the drivable area.

    The part outside counts where a disc of diameter ``HAIRLINE`` fits into it. So neither cracks in
    the area that are thinner than that, nor a rectangle that sticks out by less, count as off the
    road. An open end of the map is no edge of the road (``RoadMap.open_ends``). There is no other
    exemption: a start that is off the road is outside too.

    Args:
        poses: (K, 3) centre, m, and heading, rad.
        size: (2,) length and width, m.
        road_map: The map.

    Returns:
        (K,) True where it is outside.
    """
    return _leaves(poses, size, road_map, road_map.road_within)


def outside_lanelets(poses: FloatArray, size: npt.ArrayLike, road_map: RoadMap) -> BoolArray:
    """Tells for each pose whether part of the rectangle is outside the union of all lanelets.

    That is the road as CommonRoad's drivability checker counts it: a lanelet of whatever type is
    road, and an open end of the map is an edge. Unlike there, gaps between lanelets are closed and
    a hairline is ignored, as in ``outside``, so that the two differ in what is road alone.

    Args:
        poses: (K, 3) centre, m, and heading, rad.
        size: (2,) length and width, m.
        road_map: The map.

    Returns:
        (K,) True where it is outside.
    """

    def around(west: float, south: float, east: float, north: float) -> shapely.Geometry:
        # The margin holds every lanelet that closes a gap in the box.
        low, high = np.array([west, south]) - _MARGIN, np.array([east, north]) + _MARGIN
        return lanelet_union(
            x
            for x in road_map.lanelets
            if np.all(np.minimum(x.left.min(axis=0), x.right.min(axis=0)) <= high)
            and np.all(np.maximum(x.left.max(axis=0), x.right.max(axis=0)) >= low)
        )

    return _leaves(poses, size, road_map, around)


_MARGIN: Final = 1.0


def _leaves(
    poses: FloatArray,
    size: npt.ArrayLike,
    road_map: RoadMap,
    road_within: Callable[[float, float, float, float], shapely.Geometry],
) -> BoolArray:
    """Whether rectangles leave a road that holds the drivable area and is known box by box."""
    shapes = shapely.polygons(rectangle_corners(poses, size))
    shapely.prepare(road_map.drivable)
    found = np.logical_not(shapely.covers(road_map.drivable, shapes))
    rows = np.flatnonzero(found)
    if rows.size:
        # Only the map around these rectangles: a difference with all of it is slow.
        around = road_within(*shapely.total_bounds(shapes[rows]))
        parts = shapely.difference(shapes[rows], around)
        found[rows] = ~shapely.is_empty(shapely.buffer(parts, -0.5 * HAIRLINE))
    return np.asarray(found)
