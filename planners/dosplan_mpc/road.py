"""The road beside the ego: how far its sides may move until they meet an edge.

The edges are those of the drivable area itself, seen from the ego: along its length to either
side, so that a corner that reaches between two places of its side counts where it is. Lanes against
the route are bounded by offsets from the reference path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import PATH_HEADING, PATH_SIZE, EvenPath, areas
from dosplan.types import EGO_HEADING, BoolArray, FloatArray, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.reference import LANE_LEFT, LANE_RIGHT, PATH_LEFT, PATH_RIGHT
from dosplan_mpc.shape import STATIONS, station_offsets
from dosplan_mpc.stage import Edge, Station

REACH: Final = 12.0
"""An edge farther from the ego than this bounds nothing, m."""
_SIMPLER: Final = 0.01  # m; how far simplified edges may be off.
_UPRIGHT: Final = 1e-9  # m; a length along the ego's axis that is none.

_MIDDLE: Final = STATIONS // 2
_SIDES: Final = (-1.0, 1.0)


@dataclass(frozen=True)
class _Nearest:
    """The nearest edge of the road to one side of each part of the ego's length.

    Attributes:
        aside: (K, STATIONS) how far it is from the ego's axis there, m.
        ahead: (K, STATIONS) where along the axis, m ahead of the rear axle.
        turned: (K, STATIONS) how far it is turned from the axis, rad; zero where a corner of the
            road reaches towards the ego's side.
    """

    aside: FloatArray
    ahead: FloatArray
    turned: FloatArray


class Road:
    """The edges of the drivable area along a path.

    Attributes:
        area: The area along the path, m.
    """

    def __init__(
        self, road_map: RoadMap, path: EvenPath, vehicle: VehicleParameters, half_width: float
    ) -> None:
        """Cuts the area out along the path.

        Args:
            road_map: The map.
            path: Reference path, with the columns of ``reference``.
            vehicle: The ego.
            half_width: Distance that its axis keeps from an edge beside it, m.
        """
        self._path = path
        self._half_width = half_width
        self._stations = station_offsets(vehicle)
        half = 0.5 * (self._stations[1] - self._stations[0])
        self._parts = np.column_stack(
            [
                np.maximum(self._stations - half, self._stations[0]),
                np.minimum(self._stations + half, self._stations[-1]),
            ]
        )
        west, south = path.points.min(axis=0) - 2.0 * REACH
        east, north = path.points.max(axis=0) + 2.0 * REACH
        area = road_map.road_within(west, south, east, north)
        near = shapely.LineString(path.points).buffer(2.0 * REACH)
        self.area = shapely.simplify(areas(area.intersection(near)), _SIMPLER)
        shapely.prepare(self.area)
        edges = shapely.boundary(self.area).difference(near.boundary.buffer(0.1))
        points, line = shapely.get_coordinates(shapely.get_parts(edges), return_index=True)
        same = line[1:] == line[:-1]
        self._edges = np.stack([points[:-1][same], points[1:][same]], axis=1)
        self._tree = shapely.STRtree(shapely.linestrings(self._edges))

    def beside(
        self, states: FloatArray, arclength: FloatArray, right: FloatArray, left: FloatArray
    ) -> Station:
        """The road beside the stations of the ego.

        Args:
            states: (K, 5 or more) ego states.
            arclength: (K,) their arc lengths, m.
            right: (K,) what bounds the middle station to the right besides, as an offset from the
                path, m.
            left: (K,) the same to the left.

        Returns:
            (K, STATIONS) edges to both sides, the nearest each: of the road, along the edge
            itself; of a lane against the path or what bounds it besides, along the path. Of a
            station that is off the road, the edges are those beside the path.
        """
        heading = states[:, EGO_HEADING]
        axis = np.column_stack([np.cos(heading), np.sin(heading)])
        points = states[:, None, :2] + self._stations[:, None] * axis[:, None]
        along, offset = self._path.project(points, arclength[:, None] + self._stations)
        row = self._path.at(along)
        nearest, crossed = self._nearest(states[:, :2], axis)
        on_road = shapely.contains_xy(self.area, points[..., 0], points[..., 1]) & ~crossed
        edges = []
        for side, edge, lane, beside, more in zip(
            _SIDES,
            nearest,
            (LANE_RIGHT, LANE_LEFT),
            (PATH_RIGHT, PATH_LEFT),
            (right, left),
            strict=True,
        ):
            # Off the road, the edges beside the path count, which lead back to it.
            limit = side * np.where(on_road, row[..., lane], row[..., beside])
            limit[:, _MIDDLE] = np.minimum(limit[:, _MIDDLE], side * more)
            # The ego's side, half a width aside, is nearer to a line that is turned from it.
            slack = self._half_width * (1.0 - np.cos(edge.turned))
            room = edge.aside * np.cos(edge.turned) - self._half_width * np.cos(edge.turned)
            real = on_road & (room < limit - side * offset - self._half_width)
            edges.append(
                Edge(
                    line=np.where(
                        real[..., None],
                        self._lines(states, axis, side, edge),
                        row[..., :PATH_SIZE],
                    ),
                    bound=side * np.where(real, slack, limit),
                    ahead=np.where(real, edge.ahead, self._stations),
                )
            )
        return Station(right=edges[0], left=edges[1])

    def _lines(
        self, states: FloatArray, axis: FloatArray, side: float, edge: _Nearest
    ) -> FloatArray:
        """(K, STATIONS, 4) straight lines along the nearest edges to one side."""
        normal = np.stack([-axis[:, 1], axis[:, 0]], axis=-1)
        lines = np.zeros((*edge.aside.shape, PATH_SIZE))
        lines[..., :2] = (
            states[:, None, :2]
            + edge.ahead[..., None] * axis[:, None]
            + side * edge.aside[..., None] * normal[:, None]
        )
        lines[..., PATH_HEADING] = states[:, EGO_HEADING, None] + edge.turned
        return lines

    def _nearest(
        self, places: FloatArray, axis: FloatArray
    ) -> tuple[tuple[_Nearest, _Nearest], BoolArray]:
        """The nearest edges beside each part of the ego's length.

        Args:
            places: (K, 2) rear axles, m.
            axis: (K, 2) directions of the ego's axis.

        Returns:
            Those to the right and to the left, and (K, STATIONS) whether an edge crosses the axis.
        """
        low, high = places.min(axis=0) - REACH, places.max(axis=0) + REACH
        edges = self._edges[self._tree.query(shapely.box(*low, *high))]
        shape, rows = (len(places), len(self._parts)), np.arange(len(places))
        found = [
            _Nearest(np.full(shape, REACH), np.tile(self._stations, (shape[0], 1)), np.zeros(shape))
            for _ in _SIDES
        ]
        crossed = np.zeros(shape, dtype=np.bool_)
        if not len(edges):
            return (found[0], found[1]), crossed
        to_edge = edges - places[:, None, None]  # (K, E, 2 ends, 2)
        cos, sin = axis[:, 0, None, None], axis[:, 1, None, None]
        u = cos * to_edge[..., 0] + sin * to_edge[..., 1]
        w = cos * to_edge[..., 1] - sin * to_edge[..., 0]
        step = u[..., 1] - u[..., 0]
        # An edge along the normal is met over all of its length.
        upright = (np.abs(step) < _UPRIGHT)[..., None]
        slope = ((w[..., 1] - w[..., 0]) / np.where(upright[..., 0], np.inf, step))[..., None]
        turned = np.arctan(slope[..., 0])
        first, last = u.min(axis=-1, keepdims=True), u.max(axis=-1, keepdims=True)
        ends = np.concatenate([first, last], axis=-1)
        for i, (begin, end) in enumerate(self._parts):
            met = (first <= end) & (last >= begin)
            at = np.clip(ends, begin, end)
            aside = np.where(upright, w, w[..., :1] + slope * (at - u[..., :1]))
            over = (aside.min(axis=-1) <= 0.0) & (aside.max(axis=-1) >= 0.0) & met[..., 0]
            crossed[:, i] = over.any(axis=1)
            for side, edge in zip(_SIDES, found, strict=True):
                away = np.where(met & (side * aside > 0.0), side * aside, REACH)
                away = away.reshape(len(places), -1)
                nearest = away.argmin(axis=1)
                seen = away[rows, nearest] < REACH
                place = at.reshape(len(places), -1)[rows, nearest]
                corner = (place > begin) & (place < end)
                edge.aside[:, i] = away[rows, nearest]
                edge.ahead[:, i] = np.where(seen, place, edge.ahead[:, i])
                edge.turned[:, i] = np.where(seen & ~corner, turned[rows, nearest // 2], 0.0)
        return (found[0], found[1]), crossed
