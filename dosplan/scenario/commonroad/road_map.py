"""Lanelets and the drivable area."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from shapely.geometry import Polygon

from dosplan.geometry import areas, close_seams, lanelet_polygon, lanelet_union
from dosplan.scenario.commonroad.elements import (
    MAX_NUMBER,
    FaultError,
    child,
    identity,
    label,
    naming,
    points,
    quoted,
    references,
    whole,
)
from dosplan.types import FloatArray, Lanelet, RoadMap

OPEN_END: Final = 5.0
"""Length of road that is taken to go on beyond an open end of the map, m: about a car's."""
_CARS: Final = frozenset({"vehicle", "car"})
_ON_WHEELS: Final = _CARS | {"truck", "bus", "taxi", "priorityVehicle", "motorcycle"}
_NO_ROAD: Final = frozenset({"bicycleLane", "crosswalk", "sidewalk"})
_NO_CARS: Final = _NO_ROAD | {"busLane"}
"""Types over which no route leads. A bus lane is carriageway, so a car on it is not off the road;
but cars may not drive along it, and many maps name neither when they may nor who else."""

SPEED_LIMIT_SIGNS: Final = frozenset(
    {"274", "R2-1", "r301", "3.24", "R15", "C43", "B14", "\N{GREEK CAPITAL LETTER RHO}-32", "B31"}
)
"""Signs of a largest speed, whatever the country: the German number stands in files of many."""
ZONE_SIGN: Final = "274.1"
"""A zone with a largest speed; 30 km/h where the sign names none, else as in ``274.1-20``."""
_NO_LIMIT: Final = frozenset({"inf", "infinity", "+inf", "none", "unlimited", "nan"})
_UNITS: Final = {
    "": 1.0,
    "m/s": 1.0,
    "ms": 1.0,
    "mps": 1.0,
    "km/h": 1.0 / 3.6,
    "kmh": 1.0 / 3.6,
    "kph": 1.0 / 3.6,
    "kmph": 1.0 / 3.6,
    "mph": 0.44704,
    "mi/h": 0.44704,
}
_SPEED: Final = re.compile(r"([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:e[+-]?\d+)?)\s*([a-z/]*)")


@dataclass(frozen=True)
class MapReading:
    """The road of a file.

    Attributes:
        road_map: The map.
        two_way: Ids of the lanelets that may be driven in both directions.
        notes: What was left out or corrected, a line each.
    """

    road_map: RoadMap
    two_way: frozenset[int]
    notes: tuple[str, ...]


def open_ends(lanelets: tuple[Lanelet, ...], drivable: shapely.Geometry) -> shapely.Geometry:
    """What lies beyond the ends of the map at which roads are cut off.

    A road is cut off where a lanelet has no successor (or predecessor), no lane beside it goes on,
    and there is no other road in front of it: a lane that ends beside another one, or on another
    road, has an edge there.

    Args:
        lanelets: Every lanelet of the map.
        drivable: The area on which the ego may drive, m.

    Returns:
        ``OPEN_END`` of each road beyond its end, m; empty where none is cut off.
    """
    known = {lanelet.id: lanelet for lanelet in lanelets if lanelet.is_road}
    strips = np.array(
        [
            _beyond(lanelet, ahead)
            for lanelet in known.values()
            for ahead in (True, False)
            if not _goes_on(lanelet, known, ahead)
        ],
        dtype=object,
    )
    roads = np.array([lanelet_polygon(x.left, x.right) for x in known.values()], dtype=object)
    strip, road = shapely.STRtree(roads).query(strips, predicate="intersects")
    # Lanes that overlap count twice: all the more is there road in front.
    met = shapely.area(shapely.intersection(strips[strip], roads[road]))
    other = np.bincount(strip, weights=met, minlength=len(strips))
    beyond = [x for x, area in zip(strips, other, strict=True) if area < _OTHER_ROAD * x.area]
    return areas(shapely.difference(close_seams(shapely.union_all(beyond)), drivable))


_OTHER_ROAD: Final = 0.1
"""Share of what lies beyond an end from which on there is other road in front of it."""


def _goes_on(lanelet: Lanelet, known: Mapping[int, Lanelet], ahead: bool) -> bool:
    """Whether a lanelet, or one beside it in its direction, has one that follows."""
    seen, waiting = {lanelet.id}, [lanelet]
    while waiting:
        here = waiting.pop()
        if here.successors if ahead else here.predecessors:
            return True
        beside = (here.left_neighbour, here.right_neighbour)
        fresh = {name for name in beside if name is not None and name in known} - seen
        seen |= fresh
        waiting += [known[name] for name in fresh]
    return False


def _beyond(lanelet: Lanelet, ahead: bool) -> Polygon:
    """A strip as wide as a lanelet's end that goes on straight from there."""
    left, right = lanelet.left, lanelet.right
    if not ahead:
        left, right = left[::-1], right[::-1]
    way = 0.5 * (left[-1] + right[-1] - left - right)[:-1]
    # The end's direction over a metre at least: the last points of a map may lie close together.
    far = np.flatnonzero(np.hypot(*way.T) >= 1.0)
    along = way[far[-1] if far.size else 0]
    along = OPEN_END * along / max(float(np.hypot(*along)), 1e-9)
    return Polygon([left[-1], left[-1] + along, right[-1] + along, right[-1]])


def read_road_map(root: Element) -> MapReading:
    """The map of a scenario file.

    Links that one of two lanelets leaves out are completed from the other. Links to lanelets that
    the file does not hold are dropped, and so are those between a lanelet for cars and one that is
    not.

    Args:
        root: The file's root element.

    Returns:
        The map.

    Raises:
        FaultError: A lanelet cannot be read, or the lanelets contradict each other.
    """
    notes: list[str] = []
    limits = _speed_limits(root, notes)
    found: dict[int, Lanelet] = {}
    for element in root.iterfind("lanelet"):
        name = identity(element)
        if name in found:
            raise FaultError(f"names lanelet {name} twice; give one of them another id")
        with naming(label(element)):
            found[name] = _lanelet(element, name, limits, notes)
    if circle := _goes_round(found.values()):
        raise FaultError(
            f"lanelet {circle} leads back to itself from neighbour to neighbour on the same side; "
            "correct <adjacentLeft> and <adjacentRight>"
        )
    lanelets = tuple(_linked(found).values())
    two_way = frozenset(
        identity(x) for x in root.iterfind("lanelet") if x.find("userBidirectional") is not None
    )
    drivable = lanelet_union(x for x in lanelets if x.is_road)
    road_map = RoadMap(lanelets, drivable, open_ends(lanelets, drivable))
    return MapReading(road_map, two_way, tuple(notes))


def _lanelet(
    element: Element, name: int, limits: Mapping[str | None, float], notes: list[str]
) -> Lanelet:
    left, right = (_bound(element, f"{side}Bound") for side in ("left", "right"))
    if len(left) != len(right):
        notes.append(
            f"lanelet {name}: its bounds have {len(left)} and {len(right)} points; they were "
            "matched by their lengths"
        )
        left, right = _matched(left, right)
    if (turned := _turned(left, right)) is not None:
        notes.append(f"lanelet {name}: its bounds run against each other; one was turned")
        left, right = turned
    signs = [sign.get("ref") for sign in element.iterfind("trafficSignRef")]
    own = [limits[sign] for sign in signs if sign in limits]
    given = element.find("speedLimit")
    if given is not None and (limit := _speed(given.text, f"lanelet {name}", notes)) is not None:
        own.append(limit)
    return Lanelet(
        id=name,
        left=left,
        right=right,
        successors=tuple(references(element, "successor")),
        predecessors=tuple(references(element, "predecessor")),
        left_neighbour=_neighbour(element, "adjacentLeft"),
        right_neighbour=_neighbour(element, "adjacentRight"),
        speed_limit=min(own, default=None),
        for_cars=_is_used_by(element, _CARS, _NO_CARS),
        is_road=_is_used_by(element, _ON_WHEELS, _NO_ROAD),
    )


def _bound(element: Element, tag: str) -> FloatArray:
    line = points(child(element, tag))
    if len(line) < 2:
        raise FaultError(f"its <{tag}> has fewer than two points; give it two or more")
    return line


def _matched(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The bounds with points at the same shares of their lengths; every given point is kept."""
    shares = [_shares(line) for line in (left, right)]
    both = np.unique(np.concatenate(shares))
    both = both[np.concatenate([[True], np.diff(both) > _SAME_SHARE])]
    both[-1] = 1.0
    matched = [
        np.column_stack([np.interp(both, share, line[:, k]) for k in range(2)])
        for share, line in zip(shares, (left, right), strict=True)
    ]
    return matched[0], matched[1]


_SAME_SHARE: Final = 1e-6


def _shares(line: FloatArray) -> FloatArray:
    """(P,) share of a line's length at each of its points."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return np.asarray(s / s[-1]) if s[-1] > 0.0 else np.linspace(0.0, 1.0, len(line))


def _turned(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """The bounds of a lanelet of which one runs against the other, with that one turned.

    That is so where the bounds cross when they are joined as given, and do not when one is turned.
    The one is turned that leaves the left bound on the left.
    """
    gaps = np.hypot(*(left[[0, -1, 0, -1]] - right[[0, -1, -1, 0]]).T)
    if gaps[0] + gaps[1] <= gaps[2] + gaps[3] or Polygon(np.vstack([left, right[::-1]])).is_valid:
        return None
    outline = Polygon(np.vstack([left, right]))
    if not outline.is_valid:
        return None
    return (left[::-1], right) if outline.exterior.is_ccw else (left, right[::-1])


def _neighbour(element: Element, tag: str) -> int | None:
    """Id of the adjacent lanelet on one side, where it runs in the same direction."""
    beside = element.find(tag)
    if beside is None or beside.get("drivingDir") != "same":
        return None
    return whole(beside.get("ref"), f"the ref of <{tag}>")


def _linked(found: Mapping[int, Lanelet]) -> dict[int, Lanelet]:
    """The lanelets with their links completed from either side, and without those that lead off."""
    after = {name: dict.fromkeys(x.successors) for name, x in found.items()}
    before = {name: dict.fromkeys(x.predecessors) for name, x in found.items()}
    left = {name: x.left_neighbour for name, x in found.items()}
    right = {name: x.right_neighbour for name, x in found.items()}
    for name, lanelet in found.items():
        for other in lanelet.successors:
            before.get(other, {}).setdefault(name)
        for other in lanelet.predecessors:
            after.get(other, {}).setdefault(name)
        for beside, own, back in (
            (lanelet.left_neighbour, left, right),
            (lanelet.right_neighbour, right, left),
        ):
            if beside in back and back[beside] is None and own[beside] != name:
                back[beside] = name

    def alike(name: int, others: Iterable[int | None]) -> tuple[int, ...]:
        use = found[name].for_cars
        return tuple(n for n in others if n is not None and n in found and found[n].for_cars is use)

    out = {}
    for name, lanelet in found.items():
        links = (
            alike(name, after[name]),
            alike(name, before[name]),
            next(iter(alike(name, [left[name]])), None),
            next(iter(alike(name, [right[name]])), None),
        )
        given = (
            lanelet.successors,
            lanelet.predecessors,
            lanelet.left_neighbour,
            lanelet.right_neighbour,
        )
        out[name] = lanelet
        if links != given:
            out[name] = replace(
                lanelet,
                successors=links[0],
                predecessors=links[1],
                left_neighbour=links[2],
                right_neighbour=links[3],
            )
    return out


def _goes_round(lanelets: Iterable[Lanelet]) -> int | None:
    """A lanelet from which the way from neighbour to neighbour on one side leads back to it."""
    for side in ("left_neighbour", "right_neighbour"):
        beside = {x.id: neighbour for x in lanelets if (neighbour := getattr(x, side)) is not None}
        while beside:
            begun, here = beside.popitem()
            way = {begun}
            while here in beside:
                way.add(here)
                here = beside.pop(here)
            if here in way:
                return int(here)
    return None


def _is_used_by(element: Element, who: frozenset[str], excluded: frozenset[str]) -> bool:
    """Whether neither the type of a lanelet nor the users it names exclude some users.

    A crossing that names them is a lane that is crossed, a bus lane that does is theirs too.
    """
    users = {x.text for tag in ("userOneWay", "userBidirectional") for x in element.iterfind(tag)}
    types = {x.text for x in element.iterfind("laneletType")}
    if not users.isdisjoint(who):
        types -= {"crosswalk", "busLane"}
    return types.isdisjoint(excluded) and (not users or not users.isdisjoint(who))


def _speed_limits(root: Element, notes: list[str]) -> dict[str | None, float]:
    """Lowest limit, m/s, of each traffic sign that names one, by the sign's id as it is written."""
    limits: dict[str | None, float] = {}
    for sign in root.iterfind("trafficSign"):
        found = [
            limit
            for element in sign.iterfind("trafficSignElement")
            if (limit := _sign_limit(element, label(sign), notes)) is not None
        ]
        if found:
            limits[sign.get("id")] = min(found)
    return limits


def _sign_limit(element: Element, name: str, notes: list[str]) -> float | None:
    """The limit of one element of a traffic sign, m/s; None where it sets none."""
    kind, _, variant = (element.findtext("trafficSignID") or "").strip().partition("-")
    given = element.find("additionalValue")
    if kind == ZONE_SIGN:
        usual = f"{variant or 30} km/h"
        return _speed(usual if given is None else given.text, name, notes)
    whole_id = (element.findtext("trafficSignID") or "").strip()
    if whole_id not in SPEED_LIMIT_SIGNS and kind not in SPEED_LIMIT_SIGNS:
        return None
    if given is None:
        notes.append(f"{name}: it names no speed; no limit is taken from it")
        return None
    return _speed(given.text, name, notes)


def _speed(text: str | None, name: str, notes: list[str]) -> float | None:
    """A speed with or without its unit, m/s; without one it is in m/s, as CommonRoad defines it."""
    plain = (text or "").strip().lower()
    if plain in _NO_LIMIT:
        return None
    found = _SPEED.fullmatch(plain)
    if found is not None and found[2] in _UNITS:
        value = float(found[1].replace(",", ".")) * _UNITS[found[2]]
        if 0.0 < value <= MAX_NUMBER:
            return value
    notes.append(f"{name}: its speed limit {quoted(text)} cannot be read; no limit is taken")
    return None
