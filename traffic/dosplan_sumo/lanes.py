"""The lanes of a network of SUMO, and how its coordinates lie to those of a map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import shapely

from dosplan.types import FloatArray, RoadMap
from dosplan_sumo.simulator import SumoError

NEAR: Final = 3.0
"""Farthest that a road user is from the middle of a lane on which it is put, m."""
_SAME_ROAD: Final = 2.5
"""Farthest that the middle of a lanelet is from that of a lane of SUMO, m: a lane and a half."""
_SHARE: Final = 0.8
"""Share of the lanelets' points that lie on lanes of SUMO where map and network are the same."""
_METRES_PER_RADIAN: Final = 3.0
"""How much a difference in heading counts beside the distance from a lane."""


class Lanes:
    """The lanes of the running simulation.

    Attributes:
        ids: Their names.
    """

    def __init__(self, sumo: Any) -> None:
        """Reads them.

        Args:
            sumo: The library.
        """
        self.ids: tuple[str, ...] = tuple(sumo.lane.getIDList())
        lines = [np.array(sumo.lane.getShape(lane)) for lane in self.ids]
        self._lines = np.array([shapely.LineString(line) for line in lines])
        self._tree = shapely.STRtree(self._lines)
        self._edges = {lane: str(sumo.lane.getEdgeID(lane)) for lane in self.ids}
        self._for_walkers = np.array(
            [tuple(sumo.lane.getAllowed(lane)) == ("pedestrian",) for lane in self.ids]
        )
        self._through: dict[str, tuple[str, str]] = {}
        for lane in self.ids:
            if not lane.startswith(":"):
                for target, *_, via in (link[:5] for link in sumo.lane.getLinks(lane)):
                    if via:
                        self._through[via] = (self._edges[lane], self._edges[target])

    def offset(self, road_map: RoadMap, net_offset: FloatArray) -> FloatArray:
        """What is added to the map's coordinates to get SUMO's.

        A network is in the map's coordinates, or shifted by what it states as its offset.

        Args:
            road_map: The map.
            net_offset: (2,) the offset that the network states, m.

        Returns:
            (2,) the shift, m.

        Raises:
            SumoError: The lanelets lie on the lanes of SUMO by neither.
        """
        centres = [lanelet.centre for lanelet in road_map.lanelets if lanelet.for_cars]
        points = np.concatenate(centres)
        for shift in (np.zeros(2), net_offset):
            near = self._tree.query(
                shapely.points(points + shift), predicate="dwithin", distance=_SAME_ROAD
            )
            if len(np.unique(near[0])) >= _SHARE * len(points):
                return np.asarray(shift)
        raise SumoError(
            "the lanelets and the network of SUMO do not lie on each other; make the network of "
            "this map"
        )

    def at(self, front: FloatArray, heading: float) -> str | None:
        """The lane on which a vehicle is.

        Args:
            front: (2,) middle of its front bumper, in SUMO's coordinates, m.
            heading: rad.

        Returns:
            The name of the lane that fits place and heading best; None where none is near.
        """
        point = shapely.Point(front)
        near = self._tree.query(point, predicate="dwithin", distance=NEAR)
        near = near[~self._for_walkers[near]]
        if not len(near):
            return None
        lines = self._lines[near]
        along = shapely.line_locate_point(lines, point)
        ahead = shapely.line_interpolate_point(lines, along + 0.5)
        behind = shapely.line_interpolate_point(lines, np.maximum(along - 0.5, 0.0))
        way = shapely.get_coordinates(ahead) - shapely.get_coordinates(behind)
        turned = np.arctan2(way[:, 1], way[:, 0]) - heading
        turned = np.abs((turned + np.pi) % (2.0 * np.pi) - np.pi)
        cost = shapely.distance(lines, point) + _METRES_PER_RADIAN * turned
        return self.ids[int(near[np.argmin(cost)])]

    def way_from(
        self, lane: str, sumo: Any, routes: Sequence[tuple[str, ...]], ends: Sequence[str]
    ) -> tuple[str, ...]:
        """How a vehicle may go on from a lane.

        Args:
            lane: The lane.
            sumo: The library.
            routes: Known routes, the likeliest first.
            ends: Edges at which vehicles leave, the likeliest first.

        Returns:
            Edges from the lane's own on: the rest of the first route that leads over it, or else
            the way to the first end that can be reached.
        """
        begun = self._through.get(lane, (self._edges[lane],))
        for route in routes:
            for first in range(len(route) - len(begun) + 1):
                if route[first : first + len(begun)] == begun:
                    return route[first:]
        for end in ends:
            found = tuple(sumo.simulation.findRoute(begun[-1], end).edges)
            if found:
                return (*begun[:-1], *found)
        return begun
