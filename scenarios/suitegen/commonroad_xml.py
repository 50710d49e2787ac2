"""Writes CommonRoad 2020a files whose bytes depend on their content alone."""

from __future__ import annotations

import gzip
import io
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from dosplan.types import FloatArray

from .lanelets import LaneletDraft, LaneletMap
from .motion import Motion
from .selection import Moment
from .traffic import RECORD_FROM, STEP

AUTHOR = "The dosplan developers"
DATE = "2026-11-01"
"""The same in every file: the day of the build must not change its bytes."""

OBSTACLE_TYPES = {"ego": "car", "van": "car", "parked": "car"}
"""Names that CommonRoad has another word for."""
AT_REST = 0.02
"""Largest movement, m, of a parked vehicle that stays."""


@dataclass(frozen=True)
class Goal:
    """The goal of the planning problem.

    Attributes:
        length: Of the rectangle around the recorded arrival, along it, m.
        width: Across, m.
        heading_window: Half the width of the window of headings, rad, or None.
        velocity: Lower and upper velocity, m/s, or None.
    """

    length: float
    width: float
    heading_window: float | None
    velocity: tuple[float, float] | None


def _number(value: float, decimals: int = 3) -> str:
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def _child(parent: Element, tag: str, text: str | None = None) -> Element:
    element = SubElement(parent, tag)
    element.text = text
    return element


def _exact(parent: Element, tag: str, text: str) -> None:
    _child(_child(parent, tag), "exact", text)


def _interval(parent: Element, tag: str, low: str, high: str) -> None:
    element = _child(parent, tag)
    _child(element, "intervalStart", low)
    _child(element, "intervalEnd", high)


def _point(parent: Element, point: Iterable[float]) -> None:
    element = _child(parent, "point")
    for tag, value in zip("xy", point, strict=True):
        _child(element, tag, _number(value))


def _references(parent: Element, tag: str, ids: Iterable[int]) -> None:
    for name in ids:
        SubElement(parent, tag, ref=str(name))


def _lanelet(root: Element, draft: LaneletDraft, signs: dict[float, int]) -> None:
    element = SubElement(root, "lanelet", id=str(draft.id))
    for tag, bound in (("leftBound", draft.left), ("rightBound", draft.right)):
        side = _child(element, tag)
        for point in bound:
            _point(side, point)
    _references(element, "predecessor", draft.predecessors)
    _references(element, "successor", draft.successors)
    for tag, adjacent in (
        ("adjacentLeft", draft.adjacent_left),
        ("adjacentRight", draft.adjacent_right),
    ):
        if adjacent is not None:
            direction = "same" if adjacent[1] else "opposite"
            SubElement(element, tag, ref=str(adjacent[0]), drivingDir=direction)
    if draft.lights:
        line = _child(element, "stopLine")
        _point(line, draft.left[-1])
        _point(line, draft.right[-1])
        _child(line, "lineMarking", "solid")
        _references(line, "trafficLightRef", draft.lights)
    _child(element, "laneletType", draft.kind)
    for user in draft.users:
        _child(element, "userOneWay", user)
    for user in draft.both_ways:
        _child(element, "userBidirectional", user)
    if draft.speed is not None:
        _references(element, "trafficSignRef", [signs[draft.speed]])
    _references(element, "trafficLightRef", draft.lights)


def _map(root: Element, lanelet_map: LaneletMap, first_step: int) -> None:
    limits = sorted({d.speed for d in lanelet_map.lanelets if d.speed is not None})
    signs = {limit: next(lanelet_map.free_ids) for limit in limits}
    for draft in lanelet_map.lanelets:
        _lanelet(root, draft, signs)
    for limit, name in signs.items():
        sign = SubElement(root, "trafficSign", id=str(name))
        part = _child(sign, "trafficSignElement")
        _child(part, "trafficSignID", "274")
        _child(part, "additionalValue", _number(limit))
        at = next(draft.right[0] for draft in lanelet_map.lanelets if draft.speed == limit)
        _point(_child(sign, "position"), at)
        _child(sign, "virtual", "true")
    for light in lanelet_map.lights:
        element = SubElement(root, "trafficLight", id=str(light.id))
        cycle = _child(element, "cycle")
        for colour, steps in light.cycle:
            part = _child(cycle, "cycleElement")
            _child(part, "duration", str(steps))
            _child(part, "color", colour)
        total = sum(steps for _, steps in light.cycle)
        # SUMO's cycle begins at its time 0, which lies before step 0 of the scenario.
        offset = -(round(RECORD_FROM / STEP) + first_step) % total
        if offset:
            _child(cycle, "timeOffset", str(offset))
        _point(_child(element, "position"), light.position)
        _child(element, "direction", light.direction)
        _child(element, "active", "true")
    for intersection in lanelet_map.intersections:
        element = SubElement(root, "intersection", id=str(intersection.id))
        for incoming in intersection.incomings:
            part = SubElement(element, "incoming", id=str(incoming.id))
            _references(part, "incomingLanelet", incoming.lanelets)
            for direction in ("right", "straight", "left"):
                tag = f"successors{direction.capitalize()}"
                _references(part, tag, incoming.inside.get(direction, ()))
        if intersection.crossings:
            crossing = _child(element, "crossing")
            _references(crossing, "crossingLanelet", intersection.crossings)


def _rectangle(parent: Element, size: tuple[float, float]) -> None:
    element = _child(_child(parent, "shape"), "rectangle")
    _child(element, "length", _number(size[0]))
    _child(element, "width", _number(size[1]))


def _state(parent: Element, tag: str, state: FloatArray, step: int) -> None:
    element = _child(parent, tag)
    _point(_child(element, "position"), state[:2])
    _exact(element, "orientation", _number(_wrapped(state[2]), 4))
    _exact(element, "time", str(step))
    _exact(element, "velocity", _number(state[3]))


def _wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def _stays(motion: Motion, states: FloatArray) -> bool:
    return motion.trace.kind == "parked" and bool(np.ptp(states[:, :2], axis=0).max() < AT_REST)


def _obstacles(root: Element, moment: Moment, ids: Iterable[int]) -> None:
    windows = []
    for motion, name in zip(moment.others, ids, strict=False):
        begin = max(motion.first, moment.first)
        end = min(motion.last, moment.first + moment.last)
        windows.append((motion, name, begin - moment.first, motion.window(begin, end)))
    windows.sort(key=lambda row: not _stays(row[0], row[3]))
    for motion, name, step, states in windows:
        stays = _stays(motion, states)
        tag, kind = ("staticObstacle", "parkedVehicle") if stays else ("dynamicObstacle", None)
        element = SubElement(root, tag, id=str(name))
        trace = motion.trace
        _child(element, "type", kind or OBSTACLE_TYPES.get(trace.kind, trace.kind))
        _rectangle(element, trace.size)
        if stays:
            _state(element, "initialState", np.array([*states[0, :3], 0.0]), 0)
            continue
        _state(element, "initialState", states[0], step)
        trajectory = _child(element, "trajectory")
        for offset, state in enumerate(states[1:], step + 1):
            _state(trajectory, "state", state, offset)


def _problem(root: Element, moment: Moment, goal: Goal, name: int) -> None:
    drive = moment.drive()
    element = SubElement(root, "planningProblem", id=str(name))
    _state(element, "initialState", drive[0], moment.start)
    initial = element[0]
    _exact(initial, "yawRate", _number((drive[1, 2] - drive[0, 2]) / STEP, 4))
    _exact(initial, "slipAngle", "0")
    target = _child(element, "goalState")
    _interval(target, "time", str(moment.goal_first), str(moment.last))
    region = _child(_child(target, "position"), "rectangle")
    end = drive[-1]
    _child(region, "length", _number(goal.length))
    _child(region, "width", _number(goal.width))
    _child(region, "orientation", _number(_wrapped(end[2]), 4))
    centre = _child(region, "center")
    _child(centre, "x", _number(end[0]))
    _child(centre, "y", _number(end[1]))
    if goal.heading_window is not None:
        low, high = (_wrapped(end[2]) + side * goal.heading_window for side in (-1.0, 1.0))
        _interval(target, "orientation", _number(low, 4), _number(high, 4))
    if goal.velocity is not None:
        _interval(target, "velocity", *(_number(value) for value in goal.velocity))


def scenario_xml(
    benchmark_id: str,
    source: str,
    tags: Iterable[str],
    lanelet_map: LaneletMap,
    moment: Moment,
    goal: Goal,
) -> bytes:
    """A CommonRoad file.

    Args:
        benchmark_id: Its id.
        source: Where it comes from.
        tags: CommonRoad tags.
        lanelet_map: The map.
        moment: Traffic and ego.
        goal: The goal.

    Returns:
        The XML.
    """
    root = Element(
        "commonRoad",
        timeStepSize=_number(STEP),
        commonRoadVersion="2020a",
        author=AUTHOR,
        affiliation="dosplan",
        source=source,
        benchmarkID=benchmark_id,
        date=DATE,
    )
    location = _child(root, "location")
    for tag, value in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        _child(location, tag, value)
    marks = _child(root, "scenarioTags")
    for tag in sorted({*tags, "simulated"}):
        _child(marks, tag)
    _map(root, lanelet_map, moment.first)
    _obstacles(root, moment, lanelet_map.free_ids)
    _problem(root, moment, goal, next(lanelet_map.free_ids))
    return bytes(tostring(root, xml_declaration=True, encoding="utf-8"))


def compress(data: bytes) -> bytes:
    """Compresses with gzip, without a name and a time, so that equal content gives equal bytes."""
    buffer = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", compresslevel=9, fileobj=buffer, mtime=0) as stream:
        stream.write(data)
    return buffer.getvalue()
