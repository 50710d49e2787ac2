"""Lanelets and the drivable area."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from shapely.geometry import Polygon

from dosplan.geometry import areas, close_seams, lanelet_polygon, lanelet_union
from dosplan.scenario.commonroad.elements import (
    FaultError,
    child,
    identity,
    label,
    naming,
    points,
    references,
    whole,
)
from dosplan.scenario.commonroad.regulation import (
    LightProgram,
    known_references,
    read_intersections,
    read_lights,
    read_plates,
    read_speed,
)
from dosplan.types import (
    FloatArray,
    Lanelet,
    LineMarking,
    RoadMap,
    SignRule,
    StopLine,
    TrafficLight,
    TrafficSign,
)

OPEN_END: Final = 5.0
"""Length of road that is taken to go on beyond an open end of the map, m: about a car's."""
_CARS: Final = frozenset({"vehicle", "car"})
_ON_WHEELS: Final = _CARS | {"truck", "bus", "taxi", "priorityVehicle", "motorcycle"}
_NO_ROAD: Final = frozenset({"bicycleLane", "crosswalk", "sidewalk"})
_NO_CARS: Final = _NO_ROAD | {"busLane"}
"""Types over which no route leads. A bus lane is carriageway, so a car on it is not off the road;
but cars may not drive along it, and many maps name neither when they may nor who else."""


@dataclass(frozen=True)
class MapReading:
    """The road of a file.

    Attributes:
        road_map: The map.
        two_way: Ids of the lanelets that may be driven in both directions.
        lights: The programs of its traffic lights.
        notes: What was left out or corrected, a line each.
    """

    road_map: RoadMap
    two_way: frozenset[int]
    lights: tuple[LightProgram, ...]
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
    not. Neighbours whose traffic comes the other way are those that the file names and holds.

    Args:
        root: The file's root element.

    Returns:
        The map.

    Raises:
        FaultError: A lanelet cannot be read, or the lanelets contradict each other.
    """
    notes: list[str] = []
    plates = read_plates(root, notes)
    found: dict[int, Lanelet] = {}
    for element in root.iterfind("lanelet"):
        name = identity(element)
        if name in found:
            raise FaultError(f"names lanelet {name} twice; give one of them another id")
        with naming(label(element)):
            found[name] = _lanelet(element, name, plates, notes)
    lanelets = tuple(_linked(found).values())
    if circle := _goes_round(lanelets):
        raise FaultError(
            f"lanelet {circle} leads back to itself from neighbour to neighbour on the same side; "
            "correct <adjacentLeft> and <adjacentRight>"
        )
    lights = read_lights(root, notes)
    two_way = frozenset(
        identity(x) for x in root.iterfind("lanelet") if x.find("userBidirectional") is not None
    )
    drivable = lanelet_union(x for x in lanelets if x.is_road)
    road_map = RoadMap(
        lanelets=lanelets,
        drivable=drivable,
        open_ends=open_ends(lanelets, drivable),
        signs=tuple(
            replace(plate, lanelets=_where(lanelets, "signs", plate.id))
            for on_post in plates.values()
            for plate in on_post
        ),
        lights=tuple(
            TrafficLight(x.id, x.direction, x.position, _where(lanelets, "lights", x.id))
            for x in lights
        ),
        intersections=read_intersections(root, frozenset(found), notes),
    )
    return MapReading(road_map, two_way, lights, tuple(notes))


def _where(lanelets: Iterable[Lanelet], kind: str, name: int) -> tuple[int, ...]:
    """Ids of the lanelets that refer to a sign or a light."""
    return tuple(lanelet.id for lanelet in lanelets if name in getattr(lanelet, kind))


def _lanelet(
    element: Element,
    name: int,
    plates: Mapping[int, Sequence[TrafficSign]],
    notes: list[str],
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
    signs = [
        sign
        for sign in known_references(element, "trafficSignRef", f"lanelet {name}", notes)
        if sign in plates
    ]
    limit, source = _speed_limit(element, name, [p for sign in signs for p in plates[sign]], notes)
    line = _stop_line(element, name, left, right, notes)
    return Lanelet(
        id=name,
        left=left,
        right=right,
        successors=tuple(references(element, "successor")),
        predecessors=tuple(references(element, "predecessor")),
        left_neighbour=_neighbour(element, "adjacentLeft", "same"),
        right_neighbour=_neighbour(element, "adjacentRight", "same"),
        left_opposite=_neighbour(element, "adjacentLeft", "opposite"),
        right_opposite=_neighbour(element, "adjacentRight", "opposite"),
        speed_limit=limit,
        speed_limit_source=source,
        for_cars=_is_used_by(element, _CARS, _NO_CARS),
        is_road=_is_used_by(element, _ON_WHEELS, _NO_ROAD),
        kinds=_words(element, "laneletType"),
        users=_words(element, "userOneWay"),
        users_both_ways=_words(element, "userBidirectional"),
        left_marking=_marking(element.find("leftBound")),
        right_marking=_marking(element.find("rightBound")),
        stop_line=line,
        lights=_together(
            known_references(element, "trafficLightRef", f"lanelet {name}", notes),
            line.lights if line else (),
        ),
        signs=_together(signs, [x for x in (line.signs if line else ()) if x in plates]),
    )


def _together(own: Iterable[int], more: Iterable[int]) -> tuple[int, ...]:
    return tuple(dict.fromkeys([*own, *more]))


def _words(element: Element, tag: str) -> frozenset[str]:
    found = ((child.text or "").strip() for child in element.iterfind(tag))
    return frozenset(word for word in found if word)


def _marking(element: Element | None) -> LineMarking:
    """What is painted along a bound or as a stop line; what no word is known for is unknown."""
    word = "" if element is None else (element.findtext("lineMarking") or "").strip()
    try:
        return LineMarking(word)
    except ValueError:
        return LineMarking.UNKNOWN


def _speed_limit(
    element: Element, name: int, plates: Iterable[TrafficSign], notes: list[str]
) -> tuple[float | None, str | None]:
    """The lowest limit on a lanelet, m/s, and what names it; None twice where nothing does."""
    limits = [
        (plate.speed, f"{_SIGN_NAMES[plate.rule]} {plate.id} ({plate.code})")
        for plate in plates
        if plate.speed is not None and plate.rule in _SIGN_NAMES
    ]
    given = element.find("speedLimit")
    if given is not None and (limit := read_speed(given.text, f"lanelet {name}", notes)):
        limits.append((limit, "lanelet"))
    return min(limits, default=(None, None))


_SIGN_NAMES: Final = {SignRule.SPEED_LIMIT: "sign", SignRule.SPEED_ZONE: "zone sign"}


def _stop_line(
    element: Element, name: int, left: FloatArray, right: FloatArray, notes: list[str]
) -> StopLine | None:
    """The stop line of a lanelet; one that is given no points lies across its end."""
    line = element.find("stopLine")
    if line is None:
        return None
    ends = np.array([left[-1], right[-1]])
    try:
        given = points(line)
        if len(given) >= 2:
            ends = given[[0, -1]]
    except FaultError as error:
        notes.append(f"lanelet {name}: its stop line cannot be read ({error}); its end is taken")
    return StopLine(
        ends=ends,
        marking=_marking(line),
        lights=tuple(known_references(line, "trafficLightRef", f"lanelet {name}", notes)),
        signs=tuple(known_references(line, "trafficSignRef", f"lanelet {name}", notes)),
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


def _neighbour(element: Element, tag: str, direction: str) -> int | None:
    """Id of the adjacent lanelet on one side, where it runs in that direction."""
    beside = element.find(tag)
    if beside is None or beside.get("drivingDir") != direction:
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
        opposite = [
            other if other in found else None
            for other in (lanelet.left_opposite, lanelet.right_opposite)
        ]
        out[name] = lanelet
        if links != given or opposite != [lanelet.left_opposite, lanelet.right_opposite]:
            out[name] = replace(
                lanelet,
                successors=links[0],
                predecessors=links[1],
                left_neighbour=links[2],
                right_neighbour=links[3],
                left_opposite=opposite[0],
                right_opposite=opposite[1],
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
    users = _words(element, "userOneWay") | _words(element, "userBidirectional")
    types = _words(element, "laneletType")
    if not users.isdisjoint(who):
        types -= {"crosswalk", "busLane"}
    return types.isdisjoint(excluded) and (not users or not users.isdisjoint(who))
