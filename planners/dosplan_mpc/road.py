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

from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, PATH_SIZE, EvenPath, areas
from dosplan.types import EGO_HEADING, BoolArray, FloatArray, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.reference import LANE_LEFT, LANE_RIGHT, NO_EDGE, PATH_LEFT, PATH_RIGHT
from dosplan_mpc.shape import STATIONS, station_offsets
from dosplan_mpc.stage import Edge, Station

REACH: Final = 12.0
"""An edge farther from the ego than this bounds nothing, m."""
_SIMPLER: Final = 0.01  # m; how far simplified edges may be off.
_UPRIGHT: Final = 1e-9  # m; a length along the ego's axis that is none.
_ACROSS: Final = 0.87  # Sine of the angle to the path from which on an edge lies across it.
_SMALLEST_SHRINK: Final = 0.3  # Of 1 - kappa d: near a bend's centre, arc lengths are undefined.

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
        self,
        road_map: RoadMap,
        path: EvenPath,
        vehicle: VehicleParameters,
        half_width: float,
        closed: shapely.Geometry,
    ) -> None:
        """Cuts the area out along the path.

        Args:
            road_map: The map.
            path: Reference path, with the columns of ``reference``.
            vehicle: The ego.
            half_width: Distance that its axis keeps from an edge beside it, m.
            closed: Road that is no way for the ego, m; see ``fork``.
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
        area = road_map.road_within(west, south, east, north).difference(closed)
        near = shapely.LineString(path.points).buffer(2.0 * REACH)
        self.area = shapely.simplify(areas(area.intersection(near)), _SIMPLER)
        shapely.prepare(self.area)
        edges = shapely.boundary(self.area).difference(near.boundary.buffer(0.1))
        points, line = shapely.get_coordinates(shapely.get_parts(edges), return_index=True)
        same = line[1:] == line[:-1]
        edges = np.stack([points[:-1][same], points[1:][same]], axis=1)
        self._edges = edges[~_ends_of_road(edges, path)]
        self._paved = shapely.contains_xy(self.area, path.points)
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

    def outside(self, states: FloatArray, arclength: FloatArray, offset: FloatArray) -> FloatArray:
        """How far the ego's outline reaches beyond the road's edges, and those of lanes against it.

        The same edges bound a plan, see ``beside``; here they are met wherever the ego is.

        Args:
            states: (C, K, 5 or more) states of C trajectories.
            arclength: (C, K) their arc lengths, m.
            offset: (C, K) their lateral offsets from the path, m.

        Returns:
            (C, K) m; zero on the road.
        """
        row = self._path.at(arclength)
        turn = states[..., EGO_HEADING] - row[..., PATH_HEADING]
        half, middle = self._half_width, float(self._stations[_MIDDLE])
        heading = states[..., EGO_HEADING]
        axis = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        if len(states) == 1:  # One trajectory at once, many step by step: few edges are near.
            closest = self._closest(states[0, :, :2], axis[0])[None]
        else:
            closest = np.stack(
                [self._closest(states[:, k, :2], axis[:, k]) for k in range(states.shape[1])],
                axis=1,
            )
        outside = np.asarray(half - closest)
        centre = states[..., :2] + middle * axis
        off_road = ~shapely.contains_xy(self.area, centre[..., 0], centre[..., 1])
        off_road &= self._is_paved(arclength + middle)
        if off_road.any():
            beyond = self._beyond(arclength, offset, turn, row, middle, (PATH_RIGHT, PATH_LEFT))
            outside = np.where(off_road, half + np.maximum(beyond, 0.0), outside)
        if np.any(np.abs(row[..., [LANE_RIGHT, LANE_LEFT]]) < NO_EDGE):
            for ahead in (self._stations[0], self._stations[-1]):
                beyond = self._beyond(arclength, offset, turn, row, ahead, (LANE_RIGHT, LANE_LEFT))
                outside = np.maximum(outside, beyond + half)
        return outside

    def _beyond(
        self,
        arclength: FloatArray,
        offset: FloatArray,
        turn: FloatArray,
        row: FloatArray,
        ahead: float,
        columns: tuple[int, int],
    ) -> FloatArray:
        """(C, K) how far a point of the ego's axis is beyond two columns of the path's table, m.

        The path is an arc: over a way l along it, it bends aside by kappa l^2 / 2.
        """
        right, left = columns
        curvature, along = row[..., PATH_CURVATURE], ahead * np.cos(turn)
        there = offset + ahead * np.sin(turn) - 0.5 * curvature * along**2
        shrink = np.maximum(1.0 - curvature * offset, _SMALLEST_SHRINK)
        beside = self._path.at(arclength + along / shrink)
        return np.asarray(np.maximum(there - beside[..., left], beside[..., right] - there))

    def _closest(self, places: FloatArray, axis: FloatArray) -> FloatArray:
        """(K,) how near an edge beside the ego's length comes to its axis, up to half its width.

        Args:
            places: (K, 2) rear axles, m.
            axis: (K, 2) directions of the ego's axis.
        """
        begin, end = self._stations[0], self._stations[-1]
        edges = self._edges_within(places, end + self._half_width)
        if not len(edges):
            return np.full(len(places), self._half_width)
        u, w = _seen_from(places, axis, edges)
        step = u[..., 1] - u[..., 0]
        upright = np.abs(step) < _UPRIGHT
        slope = np.where(upright, 0.0, w[..., 1] - w[..., 0]) / np.where(upright, 1.0, step)
        clipped = np.clip(u, begin, end)
        aside = np.where(
            upright[..., None], w, w[..., :1] + slope[..., None] * (clipped - u[..., :1])
        )
        closest = np.minimum(np.abs(aside[..., 0]), np.abs(aside[..., 1]))
        closest = np.where(aside[..., 0] * aside[..., 1] <= 0.0, 0.0, closest)
        met = (u.min(axis=-1) <= end) & (u.max(axis=-1) >= begin)
        return np.asarray(np.where(met, closest, np.inf).min(axis=1).clip(max=self._half_width))

    def _is_paved(self, arclength: FloatArray) -> BoolArray:
        """Whether the path is on the road at arc lengths; it goes on beyond the road's end."""
        nearest = np.rint(arclength / self._path.length * (len(self._paved) - 1)).astype(np.int64)
        return np.asarray(self._paved[np.clip(nearest, 0, len(self._paved) - 1)])

    def _edges_within(self, places: FloatArray, reach: float) -> FloatArray:
        """(E, 2, 2) the edges near some places, by their boxes."""
        low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
        return np.asarray(self._edges[self._tree.query(shapely.box(*low, *high))])

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
        edges = self._edges_within(places, REACH)
        shape, rows = (len(places), len(self._parts)), np.arange(len(places))
        found = [
            _Nearest(np.full(shape, REACH), np.tile(self._stations, (shape[0], 1)), np.zeros(shape))
            for _ in _SIDES
        ]
        crossed = np.zeros(shape, dtype=np.bool_)
        if not len(edges):
            return (found[0], found[1]), crossed
        u, w = _seen_from(places, axis, edges)
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


def _seen_from(
    places: FloatArray, axis: FloatArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(K, E, 2) where the ends of edges are ahead of the ego's rear axle and to its left, m."""
    to_edge = edges - places[:, None, None]  # (K, E, 2 ends, 2)
    cos, sin = axis[:, 0, None, None], axis[:, 1, None, None]
    ahead = cos * to_edge[..., 0] + sin * to_edge[..., 1]
    return ahead, cos * to_edge[..., 1] - sin * to_edge[..., 0]


def _ends_of_road(edges: FloatArray, path: EvenPath) -> BoolArray:
    """(E,) whether edges lie across the path: the road ends there, which the speed sees to."""
    lines = shapely.linestrings(edges)
    along = edges[:, 1] - edges[:, 0]
    direction = np.arctan2(along[:, 1], along[:, 0])
    heading = path.heading_at(path.locate(edges.mean(axis=1)))
    across = np.abs(np.sin(direction - heading)) > _ACROSS
    return np.asarray(across & shapely.intersects(lines, shapely.LineString(path.points)))
