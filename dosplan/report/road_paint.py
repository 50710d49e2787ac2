"""What is drawn of a road besides its surface: lines, stop lines, crosswalks, signs and lights.

Films and pages draw the same things from here, each in its own way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import lights_at
from dosplan.types import (
    FloatArray,
    IntArray,
    Lanelet,
    LineMarking,
    RoadMap,
    Signals,
    SignRule,
    TrafficSign,
)


class Look(StrEnum):
    """How a line along a lanelet is drawn; the names are those of the page's data."""

    KERB = "kerb"
    BROAD_SOLID = "broadSolid"
    SOLID = "solid"
    BROAD_DASHED = "broadDashed"
    DASHED = "dashed"
    BOUND = "lines"
    """Nothing is painted there, or it is not known: the bound of a lanelet, drawn faintly."""


_LOOKS: Final = {
    LineMarking.CURB: Look.KERB,
    LineMarking.LOWERED_CURB: Look.KERB,
    LineMarking.BROAD_SOLID: Look.BROAD_SOLID,
    LineMarking.SOLID_SOLID: Look.BROAD_SOLID,
    LineMarking.SOLID: Look.SOLID,
    LineMarking.BROAD_DASHED: Look.BROAD_DASHED,
    LineMarking.DASHED_DASHED: Look.BROAD_DASHED,
    LineMarking.DASHED: Look.DASHED,
    LineMarking.NO_MARKING: Look.BOUND,
    LineMarking.UNKNOWN: Look.BOUND,
}
_PAIRS: Final = {
    LineMarking.SOLID_DASHED: (Look.SOLID, Look.DASHED),
    LineMarking.DASHED_SOLID: (Look.DASHED, Look.SOLID),
}
"""Looks of the left and the right one of two lines that differ."""

_APART: Final = 0.15  # m; half the distance of two lines.
_SAME: Final = 0.05  # m; lines whose points agree as well as this are one.
_NEAR: Final = 8.0  # m; the same sign again within this, beside the other lane, is left out,
_NEAR_LIMIT: Final = 25.0  # or within this, the same limit: maps name it for every lanelet.
_DRAWN: Final = (
    SignRule.STOP, SignRule.GIVE_WAY, SignRule.PRIORITY, SignRule.SPEED_LIMIT, SignRule.SPEED_ZONE
)  # fmt: skip
_MPH: Final = 0.44704  # m/s
_KMH: Final = 1.0 / 3.6  # m/s
_US_LIMIT: Final = "R2"  # Speed limits of the catalogue of the USA, in miles per hour.
_FROM_LEFT: Final = {
    "left": 0.0, "leftStraight": 0.5, "straight": 1.0, "straightRight": 1.5, "right": 2.0
}  # fmt: skip
_BETWEEN: Final = 1.0  # Lights for all ways, and for left and right.


@dataclass(frozen=True)
class Line:
    """A line along a lanelet.

    Attributes:
        look: How it is drawn.
        points: (P, 2) m.
    """

    look: Look
    points: FloatArray


@dataclass(frozen=True)
class Crosswalk:
    """A crosswalk where it is on the road; its stripes lie across its centre line.

    Attributes:
        centre: (P, 2) the way of the pedestrians, m.
        width: m.
    """

    centre: FloatArray
    width: float


@dataclass(frozen=True)
class Plate:
    """A sign as it is drawn.

    Attributes:
        rule: What it regulates.
        place: (2,) m.
        text: The number on a speed limit; empty on others.
        unit: Of that number: ``km/h`` or ``mph``; empty on others.
    """

    rule: SignRule
    place: FloatArray
    text: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Lamp:
    """Lights at a stop line that show the same at every step.

    Attributes:
        place: (2,) m.
        colours: (K,) what is shown at steps 0 .. K-1, an index of ``COLOURS``; the last holds for
            all later steps.
    """

    place: FloatArray
    colours: IntArray

    def at(self, step: int) -> int:
        """What is shown at a step, an index of ``COLOURS``."""
        return int(self.colours[min(step, len(self.colours) - 1)])


def lines(road_map: RoadMap) -> list[Line]:
    """The bounds of the lanelets with what is painted on them.

    Args:
        road_map: The map.

    Returns:
        A line for each bound, one alone where two lanelets share it, what is painted before what
        is not. Inside an intersection, where lanelets cross, and of crosswalks, which have their
        stripes, only what is painted.
    """
    found: dict[bytes, Line] = {}
    inside = {name for intersection in road_map.intersections for name in intersection.inside}
    bounds = [
        bound
        for lanelet in road_map.lanelets
        for bound in _bounds(lanelet)
        if bound.look is not Look.BOUND or not (lanelet.id in inside or lanelet.is_crosswalk)
    ]
    for line in sorted(bounds, key=lambda line: list(Look).index(line.look)):
        whole = np.rint(line.points / _SAME).astype(np.int64)
        found.setdefault(min(whole.tobytes(), whole[::-1].tobytes()), line)
    return list(found.values())


def stop_lines(road_map: RoadMap) -> list[FloatArray]:
    """The stop lines.

    Args:
        road_map: The map.

    Returns:
        (2, 2) ends of each, m.
    """
    return [x.stop_line.ends for x in road_map.lanelets if x.stop_line is not None]


def crosswalks(road_map: RoadMap) -> list[Crosswalk]:
    """The crosswalks, as far as they are on the road.

    Args:
        road_map: The map.

    Returns:
        A piece for each crossing of a carriageway.
    """
    found = []
    for lanelet in road_map.crosswalks:
        width = float(np.linalg.norm(lanelet.left - lanelet.right, axis=1).mean())
        on_road = shapely.intersection(shapely.LineString(lanelet.centre), road_map.drivable)
        found += [
            Crosswalk(shapely.get_coordinates(part), width)
            for part in shapely.get_parts(shapely.line_merge(on_road))
            if isinstance(part, shapely.LineString) and part.length > 0.0
        ]
    return found


def plates(road_map: RoadMap) -> list[Plate]:
    """The signs that regulate who goes first and how fast.

    Args:
        road_map: The map.

    Returns:
        The signs, one alone where the same stands beside each lane.
    """
    found: list[Plate] = []
    by_id = {lanelet.id: lanelet for lanelet in road_map.lanelets}
    for sign in road_map.signs:
        place = _place(sign, by_id)
        if sign.rule not in _DRAWN or place is None:
            continue
        plate = Plate(sign.rule, place, *_limit(sign))
        near = _NEAR_LIMIT if plate.text else _NEAR
        if not any(
            (one.rule, one.text) == (plate.rule, plate.text)
            and np.linalg.norm(one.place - place) < near
            for one in found
        ):
            found.append(plate)
    return found


def lamps(road_map: RoadMap, signals: Signals) -> list[Lamp]:
    """The traffic lights with what they show, on the stop lines.

    Args:
        road_map: The map.
        signals: What the lights show.

    Returns:
        One lamp in the middle of the line of each lane; several side by side, from left to right
        as the ways go, where the lights of the lane differ at some step. Of lights at no lane that
        is road, one at each place.
    """
    rows = {name: row for row, name in enumerate(signals.ids.tolist())}
    lights = {light.id: light for light in road_map.lights if light.id in rows}
    found, used = [], set()
    for lanelet in road_map.lanelets:
        here = [lights[name] for name in lights_at(road_map, lanelet) if name in lights]
        used |= {*lanelet.lights, *(light.id for light in here)}
        if not here or not lanelet.is_road:
            continue
        apart: dict[bytes, list[float]] = {}
        for light in here:
            shown = signals.colours[rows[light.id]]
            apart.setdefault(shown.tobytes(), []).append(_FROM_LEFT.get(light.direction, _BETWEEN))
        stop = lanelet.stop_line
        ends = np.stack([lanelet.left[-1], lanelet.right[-1]]) if stop is None else stop.ends
        if np.linalg.norm(ends[0] - lanelet.left[-1]) > np.linalg.norm(ends[1] - lanelet.left[-1]):
            ends = ends[::-1]
        order = sorted(apart, key=lambda shown: float(np.mean(apart[shown])))
        for index, shown in enumerate(order):
            share = (index + 1) / (len(order) + 1)
            place = ends[0] + share * (ends[1] - ends[0])
            found.append(Lamp(place, np.frombuffer(shown, dtype=np.int64)))
    alone = [light for light in lights.values() if light.id not in used]
    places = {
        light.position.tobytes(): Lamp(light.position, signals.colours[rows[light.id]])
        for light in alone
        if light.position is not None
    }
    return [*found, *places.values()]


def _bounds(lanelet: Lanelet) -> Iterator[Line]:
    for points, marking in (
        (lanelet.left, lanelet.left_marking),
        (lanelet.right, lanelet.right_marking),
    ):
        if marking in _PAIRS:
            for look, aside in zip(_PAIRS[marking], (_APART, -_APART), strict=True):
                moved = shapely.offset_curve(shapely.LineString(points), aside)
                yield Line(look, shapely.get_coordinates(moved))
        else:
            yield Line(_LOOKS[marking], points)


def _place(sign: TrafficSign, lanelets: dict[int, Lanelet]) -> FloatArray | None:
    """(2,) where a sign stands; beside the beginning of its first lanelet where nothing is said."""
    if sign.position is not None:
        return sign.position
    first = next((lanelets[name] for name in sign.lanelets if name in lanelets), None)
    return None if first is None else first.right[0]


def _limit(sign: TrafficSign) -> tuple[str, str]:
    """Number and unit of a speed limit; empty of other signs."""
    if sign.speed is None or not np.isfinite(sign.speed):
        return "", ""
    unit, metres = ("mph", _MPH) if sign.code.startswith(_US_LIMIT) else ("km/h", _KMH)
    return f"{sign.speed / metres:.0f}", unit


def units(signs: Iterable[Plate]) -> str:
    """The units of the numbers on some signs, for a legend: ``km/h``; empty where none has one."""
    return " and ".join(sorted({sign.unit for sign in signs if sign.unit}))
