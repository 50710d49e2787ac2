"""On which lanelets an ego drives, and in which direction they run there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import lanelet_polygon
from dosplan.types import USER_HEADING, BoolArray, FloatArray, IntArray, Lanelet, RoadMap

_AS_GOOD: Final = np.cos(np.deg2rad(10.0))
"""A lanelet that runs within 10 degrees of the ego's heading is taken if it goes on with the one
before, even if another runs closer to it."""


@dataclass(frozen=True)
class DrivenLanes:
    """The lanelets under the ego's centre.

    Where lanelets overlap, as they do inside an intersection, the ego is on the one that it was on
    the step before or on a successor of that one, if it runs along with the ego within 10 degrees;
    otherwise on the one whose direction is nearest to its heading.

    Attributes:
        lanelets: The L lanelets of the map that are road near the drive.
        inside: (K + 1, L) whether the ego's centre is on a lanelet at a step.
        along: (K + 1, L) cosine of the angle between the ego's heading and the lanelet's direction;
            NaN where not ``inside``.
        offset: (K + 1, L) distance from the lanelet's centre line, m; NaN likewise.
        directions: (K + 1, L) direction of the lanelet there, rad; NaN likewise.
        at: (K + 1,) index of the lanelet on which the ego is, -1 where it is beside all.
    """

    lanelets: tuple[Lanelet, ...]
    inside: BoolArray
    along: FloatArray
    offset: FloatArray
    directions: FloatArray
    at: IntArray

    @cached_property
    def index(self) -> dict[int, int]:
        """Indices of the lanelets by their ids."""
        return {lanelet.id: i for i, lanelet in enumerate(self.lanelets)}

    @cached_property
    def direction(self) -> FloatArray:
        """(K + 1,) direction of the lanelet on which the ego is, rad; NaN where it is on none."""
        return self._chosen(self.directions)

    @cached_property
    def centre_offset(self) -> FloatArray:
        """(K + 1,) distance from the centre line of that lanelet, m; NaN likewise."""
        return self._chosen(self.offset)

    def _chosen(self, values: FloatArray) -> FloatArray:
        if not self.lanelets:
            return np.full(len(self.at), np.nan)
        picked = values[np.arange(len(self.at)), np.maximum(self.at, 0)]
        return np.where(self.at >= 0, picked, np.nan)


def lanes_of(ego: FloatArray, road_map: RoadMap) -> DrivenLanes:
    """Finds the lanelets on which an ego drives.

    Args:
        ego: (K + 1, 4) x, y, heading, velocity of its centre.
        road_map: The map.

    Returns:
        The lanelets at each step.
    """
    low, high = ego[:, :2].min(axis=0), ego[:, :2].max(axis=0)
    lanelets = tuple(
        x
        for x in road_map.lanelets
        if x.is_road
        and np.all(np.minimum(x.left.min(axis=0), x.right.min(axis=0)) <= high)
        and np.all(np.maximum(x.left.max(axis=0), x.right.max(axis=0)) >= low)
    )
    shape = (len(ego), len(lanelets))
    inside = np.zeros(shape, dtype=np.bool_)
    directions, offset = np.full(shape, np.nan), np.full(shape, np.nan)
    centres = shapely.points(ego[:, :2])
    for column, lanelet in enumerate(lanelets):
        area = lanelet_polygon(lanelet.left, lanelet.right)
        shapely.prepare(area)
        rows = np.flatnonzero(shapely.intersects(area, centres))
        inside[rows, column] = True
        if rows.size:
            directions[rows, column], offset[rows, column] = _beside(lanelet, centres[rows])
    along = np.cos(directions - ego[:, USER_HEADING, None])
    return DrivenLanes(
        lanelets, inside, along, offset, directions, _chosen(lanelets, inside, along)
    )


def _beside(lanelet: Lanelet, points: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Direction of a lanelet's centre line beside points, rad, and their distance from it, m.

    The direction turns evenly between the middles of the centre line's parts.
    """
    centre = lanelet.centre
    parts = np.diff(centre, axis=0)
    length = np.hypot(parts[:, 0], parts[:, 1])
    kept = length > 0.0
    if not kept.any():
        nothing = np.full(len(points), np.nan)
        return nothing, nothing
    ends = np.cumsum(length)
    middles = (ends - 0.5 * length)[kept]
    heading = np.unwrap(np.arctan2(parts[kept, 1], parts[kept, 0]))
    line = shapely.LineString(centre)
    where = shapely.line_locate_point(line, points)
    return np.interp(where, middles, heading), np.asarray(shapely.distance(line, points))


def _chosen(lanelets: tuple[Lanelet, ...], inside: BoolArray, along: FloatArray) -> IntArray:
    at = np.full(len(inside), -1, dtype=np.int64)
    before = -1
    for step, (here, cosine) in enumerate(zip(inside, along, strict=True)):
        candidates = np.flatnonzero(here & np.isfinite(cosine))
        if not candidates.size:
            before = -1
            continue
        best = int(candidates[np.argmax(cosine[candidates])])
        if before >= 0 and candidates.size > 1:
            following = lanelets[before].successors
            going_on = [
                i
                for i in candidates.tolist()
                if cosine[i] >= _AS_GOOD and (i == before or lanelets[i].id in following)
            ]
            if going_on:
                best = max(going_on, key=lambda i: (i == before, cosine[i]))
        at[step] = before = best
    return at
