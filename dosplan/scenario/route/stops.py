"""Where the ego may have to stop on its route: lights, signs and crosswalks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import shapely
from shapely.ops import substring

from dosplan.geometry import areas, lanelet_polygon, wrap_angle
from dosplan.types import (
    FloatArray,
    Lanelet,
    RoadMap,
    RouteStop,
    SignRule,
    StopCause,
)

STRAIGHT: Final = np.deg2rad(30.0)
"""Change of heading up to which a way goes straight on, where no intersection says so."""
BEFORE_CROSSWALK: Final = 1.0
"""How far before a crosswalk without a stop line one stops, m (as in the German RMS-1)."""
_BESIDE: Final = 3.0
"""How far a stop line may be from the path to be on it, m."""
_SAME_PLACE: Final = 1.0
"""Area that two lanelets share from which on their ways cross, m2."""
_LIGHT_NEAR: Final = 10.0
"""How far before a crosswalk a line may be that is drawn for it, m."""


@dataclass(frozen=True)
class _Passage:
    """How a path crosses something: arc lengths, m."""

    begin: float
    end: float


def stops_on(
    path: FloatArray, arclength: FloatArray, ids: Sequence[int], road_map: RoadMap
) -> tuple[RouteStop, ...]:
    """The places at which the ego may have to stop.

    Args:
        path: (P, 2) reference path, m.
        arclength: (P,) its arc length, m.
        ids: The lanelets of the route, in the order they are driven.
        road_map: The map.

    Returns:
        The places in the order of the path. A light is one where a lanelet of the route ends at
        it, and it holds for the way that the route takes from there. A sign is one where it tells
        to stop or to give way at the end of such a lanelet; the lights there are named, as they
        overrule it while they are lit. A crosswalk is one where the path crosses it.
    """
    line = shapely.LineString(path)
    lanelets = {lanelet.id: lanelet for lanelet in road_map.lanelets}
    outlines: dict[int, shapely.Geometry] = {}

    def area(name: int) -> shapely.Geometry:
        if name not in outlines:
            outlines[name] = lanelet_polygon(lanelets[name].left, lanelets[name].right)
        return outlines[name]

    found: list[RouteStop] = []
    from_here = 0.0
    for before, after in pairwise(ids):
        if after not in lanelets[before].successors:
            continue
        here = lanelets[before]
        signs = [s for s in road_map.signs if s.id in here.signs and s.rule in _CAUSES]
        if not here.lights and not signs:
            continue
        ends = _line_of(here)
        at = _along(line, 0.5 * (ends[0] + ends[1]), from_here)
        if at is None:
            continue
        from_here = at
        until = _along(line, lanelets[after].centre[-1], at) or float(arclength[-1])
        turn = road_map.turn(before, after) or turn_by_shape(here, lanelets[after])
        holding = tuple(x.id for x in road_map.lights if x.id in here.lights and x.holds_for(turn))
        if holding:
            found.append(RouteStop(StopCause.LIGHT, at, until, holding))
        if signs:
            cause = max((_CAUSES[sign.rule] for sign in signs), key=_STRICTER.index)
            others = _with_priority(after, lanelets, road_map)
            conflict = _conflict(area(after), [area(name) for name in others])
            found.append(RouteStop(cause, at, until, holding, conflict))
    for crosswalk in road_map.crosswalks:
        for passage in _passages(line, area(crosswalk.id)):
            at = max(passage.begin - BEFORE_CROSSWALK, 0.0)
            stop = RouteStop(StopCause.CROSSWALK, at, passage.end, (), area(crosswalk.id))
            found.append(_at_line(stop, found))
    return tuple(sorted(found, key=lambda stop: (stop.arclength, stop.until)))


_CAUSES: Final = {SignRule.STOP: StopCause.STOP_SIGN, SignRule.GIVE_WAY: StopCause.GIVE_WAY}
_STRICTER: Final = [StopCause.GIVE_WAY, StopCause.STOP_SIGN]


def _line_of(lanelet: Lanelet) -> FloatArray:
    """(2, 2) ends of the line before which one stops on a lanelet, m."""
    if lanelet.stop_line is not None:
        return lanelet.stop_line.ends
    return np.array([lanelet.left[-1], lanelet.right[-1]])


def _along(line: shapely.LineString, place: FloatArray, first: float) -> float | None:
    """Arc length of a place on a path, not before ``first``, m; None where it is beside it."""
    rest = substring(line, first, line.length)
    where = shapely.Point(place)
    if rest.length == 0.0 or shapely.distance(rest, where) > _BESIDE:
        return None
    return first + float(shapely.line_locate_point(rest, where))


def turn_by_shape(before: Lanelet, after: Lanelet) -> str:
    """Which way one takes, by the shape of the lanelets alone.

    Args:
        before: The lanelet that leads in.
        after: Its successor.

    Returns:
        ``left``, ``straight`` or ``right``.
    """
    way_in, way_out = before.centre[-1] - before.centre[-2], after.centre[-1] - after.centre[-2]
    turned = wrap_angle(np.arctan2(way_out[1], way_out[0]) - np.arctan2(way_in[1], way_in[0]))
    if abs(float(turned)) <= STRAIGHT:
        return "straight"
    return "left" if turned > 0.0 else "right"


def _with_priority(after: int, lanelets: Mapping[int, Lanelet], road_map: RoadMap) -> Iterator[int]:
    """Lanelets whose traffic goes first where a sign on the way into ``after`` says so.

    They come from elsewhere, and no sign tells those who come to stop or to give way.
    """
    yielding = {sign.id for sign in road_map.signs if sign.rule in _CAUSES}
    for name, lanelet in lanelets.items():
        same_way = set(lanelet.predecessors) & set(lanelets[after].predecessors)
        if name == after or not lanelet.is_road or same_way:
            continue
        before = [lanelets[i] for i in lanelet.predecessors if i in lanelets]
        if before and not any(yielding.intersection(x.signs) for x in before):
            yield name


def _conflict(own: shapely.Geometry, others: Iterable[shapely.Geometry]) -> shapely.Geometry:
    """Where the ways of others cross one's own."""
    shared = [shapely.intersection(own, other) for other in others]
    return areas(shapely.union_all([part for part in shared if part.area > _SAME_PLACE]))


def _passages(line: shapely.LineString, area: shapely.Geometry) -> Iterator[_Passage]:
    """Where a path crosses an area."""
    for part in shapely.get_parts(shapely.intersection(line, area)):
        if part.length > 0.0:
            ends = shapely.get_coordinates(part)[[0, -1]]
            s = sorted(shapely.line_locate_point(line, shapely.points(ends)).tolist())
            yield _Passage(float(s[0]), float(s[1]))


def _at_line(crosswalk: RouteStop, stops: Iterable[RouteStop]) -> RouteStop:
    """A crosswalk with the lights of the crossing it belongs to, and the line just before it."""
    begin = crosswalk.arclength + BEFORE_CROSSWALK
    for stop in stops:
        if stop.cause is StopCause.CROSSWALK:
            continue
        # A line may be drawn on the edge of the crosswalk, and be off by a little.
        if stop.arclength - BEFORE_CROSSWALK <= begin <= stop.until + BEFORE_CROSSWALK:
            near = begin <= stop.arclength + _LIGHT_NEAR
            at = stop.arclength if near else crosswalk.arclength
            return replace(crosswalk, arclength=at, lights=stop.lights)
    return crosswalk
