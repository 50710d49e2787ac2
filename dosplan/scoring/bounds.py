"""Whether the ego's rectangle is inside the drivable area."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from dosplan.geometry import rectangle_corners
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
    shapes = shapely.polygons(rectangle_corners(poses, size))
    shapely.prepare(road_map.drivable)
    found = np.logical_not(shapely.covers(road_map.drivable, shapes))
    rows = np.flatnonzero(found)
    if rows.size:
        # Only the map around these rectangles: a difference with all of it is slow.
        around = road_map.road_within(*shapely.total_bounds(shapes[rows]))
        parts = shapely.difference(shapes[rows], around)
        found[rows] = ~shapely.is_empty(shapely.buffer(parts, -0.5 * HAIRLINE))
    return np.asarray(found)
