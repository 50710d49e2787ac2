"""Traffic lights by lane: which hold at a lanelet's end, and what road users have ahead."""

from __future__ import annotations

from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

import numpy as np
import shapely

from dosplan.geometry.plane import lanelet_polygon, wrap_angle
from dosplan.types import (
    COLOURS,
    USER_HEADING,
    USER_SIZE,
    USER_X,
    USER_Y,
    FloatArray,
    IntArray,
    Lanelet,
    LightStates,
    RoadMap,
)
from dosplan.types.arrays import frozen

NO_LIGHT: Final = -1
"""In place of the number of a colour: there is no light ahead."""

_ALONG: Final = np.deg2rad(60.0)  # Who points farther off a lanelet's direction crosses it.
_TANGENT: Final = 0.5  # m before and behind a place; the line through both is its direction.


@dataclass(frozen=True)
class LightsAhead:
    """What traffic lights show N road users.

    Attributes:
        distance: (N,) from the front of the road user to the line before which it would stop,
            along the lanelets, m; infinite where no light is ahead. Down to minus half its length
            where its front has passed the line already and its centre has not.
        colour: (N,) what is shown, an index of ``COLOURS``; ``NO_LIGHT`` where no light is ahead.
        seconds: (N,) for how long it has been shown, s; zero where no light is ahead.
    """

    distance: FloatArray
    colour: IntArray
    seconds: FloatArray

    def __post_init__(self) -> None:
        frozen(self, "distance", np.float64, (None,))
        frozen(self, "colour", np.int64, self.distance.shape)
        frozen(self, "seconds", np.float64, self.distance.shape, finite=True)


@dataclass(frozen=True)
class _Line:
    """The line at which lights hold: their ids, its lanelet, and its arc length on the centre line.

    That is 0 where the line lies before the lanelet's beginning.
    """

    lights: tuple[int, ...]
    lanelet: int
    arclength: float


class LightIndex:
    """Finds the traffic lights that road users have ahead; made once for a map.

    Which way a road user will take is not known. Where lanelets part before a line, the nearest
    line is taken; where the lights of a line differ by direction, the strictest counts, as in
    ``LightStates.shown``. Somebody who changes lanes has the light of the lane that it is on.
    """

    def __init__(self, road_map: RoadMap, reach: float = 50.0) -> None:
        """Walks from each line with lights up the road.

        Args:
            road_map: The map.
            reach: How far ahead a light is seen, m.
        """
        self._reach = reach
        by_id = {lanelet.id: lanelet for lanelet in road_map.lanelets}
        centres = _CentreLines(by_id)
        self._lines: list[_Line] = []
        # Nearest first: of each lanelet, the line that it leads to, and the line's arc length
        # counted from the lanelet's start.
        heap: list[tuple[float, int, int, int]] = []
        for lanelet in road_map.lanelets:
            if lights := lights_at(road_map, lanelet):
                arclength = centres.stop(lanelet)
                heappush(heap, (0.0, len(self._lines), lanelet.id, len(self._lines)))
                self._lines.append(_Line(lights, lanelet.id, arclength))
        found: dict[int, tuple[int, float]] = {}
        while heap:
            beyond, _, name, line = heappop(heap)
            if name in found:
                continue
            ends = self._lines[line]
            own = ends.arclength if name == ends.lanelet else centres.length(name)
            found[name] = (line, beyond + own)
            if beyond + own < reach:
                for before in by_id[name].predecessors:
                    if before in by_id and before not in found:
                        heappush(heap, (beyond + own, len(found), before, line))
        self._line_of = np.array([line for line, _ in found.values()], dtype=np.int64)
        self._line_at = np.array([at for _, at in found.values()], dtype=np.float64)
        self._centres = np.array([centres.line(name) for name in found], dtype=object)
        areas = [lanelet_polygon(by_id[name].left, by_id[name].right) for name in found]
        self._tree = shapely.STRtree(areas)

    def ahead(self, states: FloatArray, size: FloatArray, lights: LightStates) -> LightsAhead:
        """Finds the light that each road user has ahead.

        Args:
            states: (N, 4) road-user states, as the last column of ``Observation.states``.
            size: (N, 2) their length and width, m.
            lights: What the lights show.

        Returns:
            Distances, colours, and for how long.
        """
        states = np.asarray(states, dtype=np.float64).reshape(-1, USER_SIZE)
        count = len(states)
        distance = np.full(count, np.inf)
        colour = np.full(count, NO_LIGHT, dtype=np.int64)
        seconds = np.zeros(count)
        points = shapely.points(states[:, [USER_X, USER_Y]])
        users, lanelets = self._tree.query(points, predicate="intersects")
        if len(users):
            lines = self._centres[lanelets]
            along = shapely.line_locate_point(lines, points[users])
            way = _xy(lines, along + _TANGENT) - _xy(lines, along - _TANGENT)
            turned = wrap_angle(np.arctan2(way[:, 1], way[:, 0]) - states[users, USER_HEADING])
            left = self._line_at[lanelets] - along
            here = (np.abs(turned) < _ALONG) & (left >= 0.0)
            left = left - 0.5 * size[users, 0]
            kept = np.flatnonzero(here & (left <= self._reach))
            # Where lanelets overlap, the one in whose middle a road user is; it comes last and
            # stays.
            aside = shapely.distance(lines[kept], points[users[kept]])
            kept = kept[np.lexsort((-left[kept], -aside))]
            shown, since = self._shown(lights)
            at = self._line_of[lanelets[kept]]
            distance[users[kept]] = left[kept]
            colour[users[kept]], seconds[users[kept]] = shown[at], since[at]
        return LightsAhead(distance=distance, colour=colour, seconds=seconds)

    def _shown(self, lights: LightStates) -> tuple[IntArray, FloatArray]:
        """What each line's lights show together, an index of ``COLOURS``, and for how long, s."""
        shown = np.empty(len(self._lines), dtype=np.int64)
        since = np.zeros(len(self._lines))
        for index, line in enumerate(self._lines):
            colour = lights.shown(line.lights)
            times = [lights.seconds(x) for x in line.lights if lights.colour(x) is colour]
            shown[index], since[index] = COLOURS.index(colour), max(times)
        return shown, since


def lights_at(road_map: RoadMap, lanelet: Lanelet) -> tuple[int, ...]:
    """The traffic lights that hold for those who leave a lanelet at its end.

    Args:
        road_map: The map.
        lanelet: One of its lanelets.

    Returns:
        Ids of the lights, in the file's order. Where the map says which ways go on from there,
        lights for none of these are left out.
    """
    stop = lanelet.stop_line
    named = dict.fromkeys((*lanelet.lights, *(() if stop is None else stop.lights)))
    lights = [light for light in road_map.lights if light.id in named]
    ways = {road_map.turn(lanelet.id, successor) for successor in lanelet.successors}
    holding = [light.id for light in lights if any(way and light.holds_for(way) for way in ways)]
    return tuple(holding or (light.id for light in lights))


class _CentreLines:
    """The centre lines of lanelets, made where they are asked for."""

    def __init__(self, lanelets: dict[int, Lanelet]) -> None:
        self._lanelets = lanelets
        self._lines: dict[int, shapely.LineString] = {}

    def line(self, name: int) -> shapely.LineString:
        if name not in self._lines:
            self._lines[name] = shapely.LineString(self._lanelets[name].centre)
        return self._lines[name]

    def length(self, name: int) -> float:
        return float(self.line(name).length)

    def stop(self, lanelet: Lanelet) -> float:
        """Arc length of a lanelet's stop line; of its end where it has none."""
        if lanelet.stop_line is None:
            return self.length(lanelet.id)
        middle = shapely.Point(lanelet.stop_line.ends.mean(axis=0))
        return float(self.line(lanelet.id).project(middle))


def _xy(lines: FloatArray, along: FloatArray) -> FloatArray:
    """(M, 2) points of lines at arc lengths, m; of their ends where that is beyond."""
    inside = np.maximum(along, 0.0)  # A negative one would be counted from the end.
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(lines, inside)))
