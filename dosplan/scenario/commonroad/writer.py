"""Writes CommonRoad 2020a files whose bytes depend on their content alone."""

from __future__ import annotations

import gzip
import io
from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from dosplan.scenario.commonroad.drafts import (
    AUTHOR,
    DATE,
    Header,
    LaneletDraft,
    LaneletMap,
    Light,
    ProblemDraft,
    UserDraft,
)
from dosplan.types import STEP_SECONDS, FloatArray


def scenario_xml(
    header: Header,
    lanelet_map: LaneletMap,
    users: Iterable[UserDraft],
    problem: ProblemDraft | None,
) -> bytes:
    """A CommonRoad file.

    Args:
        header: Its metadata.
        lanelet_map: The map.
        users: The road users.
        problem: The planning problem; None for a recording without one, which CommonRoad's
            schema does not know, but its reader does.

    Returns:
        The XML.
    """
    root = Element(
        "commonRoad",
        timeStepSize=_number(STEP_SECONDS),
        commonRoadVersion="2020a",
        author=AUTHOR,
        affiliation="dosplan",
        source=header.source,
        benchmarkID=header.benchmark_id,
        date=DATE,
    )
    location = _child(root, "location")
    for tag, value in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        _child(location, tag, value)
    marks = _child(root, "scenarioTags")
    for tag in sorted(header.tags):
        _child(marks, tag)
    _map(root, lanelet_map)
    named = [(user, next(lanelet_map.free_ids) if user.id is None else user.id) for user in users]
    for user, name in sorted(named, key=lambda pair: not pair[0].static):
        _user(root, user, name)
    if problem is not None:
        add_problem(root, problem, next(lanelet_map.free_ids), STEP_SECONDS)
    return bytes(tostring(root, xml_declaration=True, encoding="utf-8"))


def compress(data: bytes) -> bytes:
    """Compresses with gzip, without a name and a time, so that equal content gives equal bytes.

    Args:
        data: What to compress.

    Returns:
        The compressed bytes.
    """
    buffer = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", compresslevel=9, fileobj=buffer, mtime=0) as stream:
        stream.write(data)
    return buffer.getvalue()


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


def _map(root: Element, lanelet_map: LaneletMap) -> None:
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
        _light(root, light)
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


def _light(root: Element, light: Light) -> None:
    element = SubElement(root, "trafficLight", id=str(light.id))
    cycle = _child(element, "cycle")
    for colour, steps in light.cycle:
        part = _child(cycle, "cycleElement")
        _child(part, "duration", str(steps))
        _child(part, "color", colour)
    if light.offset:
        _child(cycle, "timeOffset", str(light.offset))
    _point(_child(element, "position"), light.position)
    if light.direction is not None:
        _child(element, "direction", light.direction)
    _child(element, "active", "true")


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


def _user(root: Element, user: UserDraft, name: int) -> None:
    tag = "staticObstacle" if user.static else "dynamicObstacle"
    element = SubElement(root, tag, id=str(name))
    _child(element, "type", user.kind)
    _rectangle(element, user.size)
    if user.static:
        _state(element, "initialState", np.array([*user.states[0, :3], 0.0]), 0)
        return
    _state(element, "initialState", user.states[0], user.first)
    trajectory = _child(element, "trajectory")
    for step, state in enumerate(user.states[1:], user.first + 1):
        _state(trajectory, "state", state, step)


def add_problem(root: Element, problem: ProblemDraft, name: int, dt: float) -> None:
    """Adds a planning problem to a file.

    Args:
        root: Root element of the file.
        problem: The planning problem.
        name: Its id.
        dt: Step of the file, s.
    """
    drive, goal = problem.drive, problem.goal
    element = SubElement(root, "planningProblem", id=str(name))
    _state(element, "initialState", drive[0], problem.start)
    initial = element[0]
    _exact(initial, "yawRate", _number((drive[1, 2] - drive[0, 2]) / dt, 4))
    _exact(initial, "slipAngle", "0")
    target = _child(element, "goalState")
    _interval(target, "time", str(problem.goal_first), str(problem.goal_last))
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
