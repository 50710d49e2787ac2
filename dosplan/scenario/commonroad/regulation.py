"""What regulates the traffic in a file: signs, lights and intersections.

A part of these that cannot be read is left out and noted: the road and the road users of the file
are of use without it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from dosplan.scenario.commonroad.elements import (
    FaultError,
    child,
    identity,
    label,
    point,
    quoted,
    references,
    whole,
)
from dosplan.scenario.commonroad.obstacles import Resampling
from dosplan.types import (
    COLOURS,
    FloatArray,
    Incoming,
    Intersection,
    LightColour,
    Signals,
    SignRule,
    TrafficSign,
)
from dosplan.types.arrays import MAX_NUMBER

_RULES: Final = {
    SignRule.SPEED_LIMIT: [
        *("274", "R2-1", "r301", "3.24", "R15", "C43", "B14", "B31"),
        "\N{GREEK CAPITAL LETTER RHO}-32",
    ],
    SignRule.SPEED_ZONE: ["274.1"],
    SignRule.STOP: ["206", "R1-1", "R1-3", "r2", "2.5", "B5", "AB4"],
    SignRule.GIVE_WAY: ["205", "R1-2", "r1", "2.4", "B1", "AB3a"],
    SignRule.PRIORITY: ["301", "306", "r3", "2.1", "B9", "AB6"],
    SignRule.RIGHT_BEFORE_LEFT: ["102"],
    SignRule.NO_OVERTAKING: ["276", "R4-1", "r305", "3.20", "C35", "B3"],
}
"""Numbers of signs in the catalogues of countries, whatever the country of the file: German numbers
stand in files of many. B1, B3, B5, B9, B14 and B31 are Belgian, French and Croatian."""
_RULE_OF: Final = {code: rule for rule, codes in _RULES.items() for code in codes}
_ZONE_SPEED: Final = 30
"""Limit of a zone whose sign names none, km/h; it may be part of its number: ``274.1-20``."""
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
_DIRECTIONS: Final = frozenset(
    {"right", "straight", "left", "leftStraight", "straightRight", "leftRight", "all"}
)


@contextmanager
def _left_out(name: str, notes: list[str]) -> Iterator[None]:
    """Notes a fault in a part that can be left out, and goes on."""
    try:
        yield
    except FaultError as error:
        notes.append(f"{name}: {error}; it is left out")


def known_references(element: Element, tag: str, name: str, notes: list[str]) -> list[int]:
    """Ids to which an element refers; where one is no number, none of them, and a note.

    Args:
        element: The element.
        tag: Tag of the children that refer.
        name: What the element is called in notes.
        notes: To which a note is added.

    Returns:
        The ids, each once.
    """
    with _left_out(name, notes):
        return references(element, tag)
    return []


def read_plates(root: Element, notes: list[str]) -> dict[int, list[TrafficSign]]:
    """The traffic signs of a file.

    Args:
        root: The file's root element.
        notes: To which what is left out is added.

    Returns:
        The plates on each post, by the sign's id; on which lanelets they hold is not known yet.
    """
    plates: dict[int, list[TrafficSign]] = {}
    for sign in root.iterfind("trafficSign"):
        with _left_out(label(sign), notes):
            name = identity(sign)
            position = _position(sign)
            plates[name] = [
                _plate(element, name, position, notes)
                for element in sign.iterfind("trafficSignElement")
            ]
    return plates


def _plate(
    element: Element, name: int, position: FloatArray | None, notes: list[str]
) -> TrafficSign:
    code = (element.findtext("trafficSignID") or "").strip()
    kind, _, variant = code.partition("-")
    rule = _RULE_OF.get(code) or _RULE_OF.get(kind, SignRule.OTHER)
    given = element.find("additionalValue")
    speed = None
    if rule in (SignRule.SPEED_LIMIT, SignRule.SPEED_ZONE):
        text = None if given is None else given.text
        if given is None and rule is SignRule.SPEED_ZONE:
            text = f"{variant or _ZONE_SPEED} km/h"
        if text is None and given is None:
            notes.append(f"traffic sign {name}: it names no speed; no limit is taken from it")
        else:
            speed = read_speed(text, f"traffic sign {name}", notes)
    return TrafficSign(name, code, rule, speed, position)


def read_speed(text: str | None, name: str, notes: list[str]) -> float | None:
    """A speed with or without its unit; without one it is in m/s, as CommonRoad defines it.

    Args:
        text: What the file holds.
        name: What it belongs to, for notes.
        notes: To which a note is added where it cannot be read.

    Returns:
        m/s; None where it is no limit or cannot be read.
    """
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


def _position(element: Element) -> FloatArray | None:
    """Where a sign or a light stands; None where that is not said, or is no place in the plane."""
    place = element.find("position/point")
    if place is None:
        return None
    try:
        return np.array(point(place))
    except FaultError:
        return None


@dataclass(frozen=True)
class LightProgram:
    """A traffic light of a file, with what it shows when.

    Attributes:
        id: Its id.
        direction: The ways for which it holds, in the words of CommonRoad.
        position: (2,) m, or None.
        colours: The colours of its cycle, in their order.
        ends: (C,) step of the file, from the begin of the cycle, at which each of them ends.
        offset: Step of the file at which a cycle begins.
    """

    id: int
    direction: str
    position: FloatArray | None
    colours: tuple[LightColour, ...]
    ends: FloatArray
    offset: float

    def at(self, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What it shows at some steps of the file.

        A cycle goes on for ever, and did before step 0: as CommonRoad defines it, the colour at
        step k is that at ``(k - offset) mod length``.

        Args:
            steps: (K,) steps of the file, whole or between two.

        Returns:
            (K,) number of the colour, an index of ``COLOURS``, and (K,) for how many steps of the
            file it has been shown; a light that never changes, since step 0.
        """
        numbers = np.array([COLOURS.index(colour) for colour in self.colours])
        if len(set(self.colours)) == 1:
            return np.full(len(steps), numbers[0]), steps.copy()
        cycles, phase = np.divmod(steps - self.offset, self.ends[-1])
        part = np.searchsorted(self.ends, phase, side="right")
        begins = np.concatenate([[0.0], self.ends[:-1]])
        for before, later in pairwise(range(len(numbers))):
            if numbers[before] == numbers[later]:
                begins[later] = begins[before]
        since = phase - begins[part]
        # The first part may go on with the last colour of the cycle before. A file that begins
        # with its cycle may be a recording as long as the cycle: then nothing was before.
        if numbers[0] == numbers[-1]:
            begun, away = np.divmod(-self.offset, self.ends[-1])  # The cycle of step 0.
            known = (begins[part] == 0.0) & ((cycles > begun) | (away != 0.0))
            since = np.where(known, since + self.ends[-1] - begins[-1], since)
        return numbers[part], since


def read_lights(root: Element, notes: list[str]) -> tuple[LightProgram, ...]:
    """The traffic lights of a file.

    Args:
        root: The file's root element.
        notes: To which what is left out is added.

    Returns:
        The lights. One that is not active, or has no cycle, is dark all the time.
    """
    lights: dict[int, LightProgram] = {}
    for element in root.iterfind("trafficLight"):
        with _left_out(label(element), notes):
            light = _light(element)
            if light.id in lights:
                raise FaultError("the file names it twice")
            lights[light.id] = light
    return tuple(lights.values())


def _light(element: Element) -> LightProgram:
    name = identity(element)
    direction = (element.findtext("direction") or "all").strip()
    cycle = element.find("cycle")
    parts = [] if cycle is None else [_part(part) for part in cycle.iterfind("cycleElement")]
    parts = [part for part in parts if part[1] > 0]
    if (element.findtext("active") or "true").strip() == "false" or not parts:
        parts = [(LightColour.INACTIVE, 1)]
    offset = None if cycle is None else cycle.find("timeOffset")
    return LightProgram(
        id=name,
        direction=direction if direction in _DIRECTIONS else "all",
        position=_position(element),
        colours=tuple(colour for colour, _ in parts),
        ends=np.cumsum([steps for _, steps in parts], dtype=np.float64),
        offset=0.0 if offset is None else float(whole(offset.text, "its <timeOffset>")),
    )


def _part(element: Element) -> tuple[LightColour, int]:
    word = (child(element, "color").text or "").strip()
    steps = whole(child(element, "duration").text, "a <duration> of its cycle")
    if steps < 0:
        raise FaultError(f"a <duration> of its cycle is {steps} steps; give it 0 or more")
    try:
        return LightColour(word), steps
    except ValueError:
        known = ", ".join(LightColour)
        raise FaultError(f"it shows the colour {quoted(word)}; one of {known} is known") from None


def signals(lights: tuple[LightProgram, ...], resampling: Resampling, last: int) -> Signals:
    """What lights show at the steps of a scenario.

    Args:
        lights: The lights of the file.
        resampling: From the file's steps to the scenario's.
        last: Last step that is wanted.

    Returns:
        Their states at the steps 0 to ``last``.
    """
    steps = np.arange(last + 1)
    old = (resampling.begin + resampling.every * steps) / resampling.times
    shown = [light.at(old) for light in lights]
    shape = (len(lights), last + 1)
    return Signals(
        ids=np.array([light.id for light in lights], dtype=np.int64),
        colours=np.reshape([colour for colour, _ in shown], shape).astype(np.int64),
        since=np.reshape([since for _, since in shown], shape) * resampling.file_seconds,
    )


def read_intersections(
    root: Element, lanelets: frozenset[int], notes: list[str]
) -> tuple[Intersection, ...]:
    """The intersections of a file.

    Args:
        root: The file's root element.
        lanelets: Ids of the lanelets that the file holds.
        notes: To which what is left out is added.

    Returns:
        The intersections, without lanelets that the file does not hold.
    """
    found = []
    for element in root.iterfind("intersection"):
        with _left_out(label(element), notes):
            roads = [_incoming(road, lanelets) for road in element.iterfind("incoming")]
            crossing = element.find("crossing")
            crossings = [] if crossing is None else references(crossing, "crossingLanelet")
            known = tuple(name for name in crossings if name in lanelets)
            found.append(Intersection(identity(element), tuple(roads), known))
    return tuple(found)


def _incoming(element: Element, lanelets: frozenset[int]) -> Incoming:
    def held(tag: str) -> tuple[int, ...]:
        return tuple(name for name in references(element, tag) if name in lanelets)

    left_of = element.find("isLeftOf")
    return Incoming(
        id=identity(element),
        lanelets=held("incomingLanelet"),
        left=held("successorsLeft"),
        straight=held("successorsStraight"),
        right=held("successorsRight"),
        left_of=None if left_of is None else whole(left_of.get("ref"), "the ref of <isLeftOf>"),
    )
