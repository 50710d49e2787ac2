"""Small CommonRoad files made by hand: roads, road users and planning problems as XML text.

Nothing here imports the package under test, so that a file is an independent statement of what
the format says. Lengths are metres, angles radians, times steps.
"""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lane:
    """A lanelet; ``left_neighbour`` and ``right_neighbour`` are ``(id, same direction)``."""

    id: int
    left: Array
    right: Array
    successors: tuple[int, ...] = ()
    predecessors: tuple[int, ...] = ()
    left_neighbour: tuple[int, bool] | None = None
    right_neighbour: tuple[int, bool] | None = None
    speed_limit: float | None = None
    bidirectional: bool = False
    kind: str = "urban"
    user: str | None = None


@dataclass(frozen=True)
class User:
    """A road user: one ``(x, y, heading, velocity)`` per step from ``first_step`` on.

    ``None`` in place of heading or velocity leaves the element out. ``shape`` is the inside of
    the ``shape`` element.
    """

    id: int
    states: Sequence[tuple[float, float, float | None, float | None]]
    first_step: int = 0
    kind: str = "car"
    shape: str = "<rectangle><length>4.5</length><width>1.8</width></rectangle>"
    static: bool = False


@dataclass(frozen=True)
class Goal:
    """A goal state; ``position`` is the inside of the ``position`` element."""

    first_step: int = 0
    last_step: int = 50
    position: str | None = None
    heading: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None
    exact_time: bool = False


@dataclass(frozen=True)
class Problem:
    """A planning problem; ``start`` is ``(x, y, heading, velocity)`` of the ego's centre."""

    id: int = 1000
    start: tuple[float, float, float, float] = (10.0, 0.0, 0.0, 10.0)
    goals: tuple[Goal, ...] = (Goal(),)
    start_step: int = 0
    yaw_rate: float | None = 0.0


def rectangle(
    length: float, width: float, x: float = 0.0, y: float = 0.0, angle: float = 0.0
) -> str:
    """A ``rectangle`` element."""
    return (
        f"<rectangle><length>{length}</length><width>{width}</width>"
        f"<orientation>{angle}</orientation><center><x>{x}</x><y>{y}</y></center></rectangle>"
    )


def circle(radius: float, x: float = 0.0, y: float = 0.0) -> str:
    """A ``circle`` element."""
    return f"<circle><radius>{radius}</radius><center><x>{x}</x><y>{y}</y></center></circle>"


def polygon(points: npt.ArrayLike) -> str:
    """A ``polygon`` element."""
    return f"<polygon>{_points(np.asarray(points, dtype=np.float64))}</polygon>"


def on_lanelets(*ids: int) -> str:
    """The ``lanelet`` elements of a goal position."""
    return "".join(f'<lanelet ref="{i}"/>' for i in ids)


def driving(
    x: float, y: float, velocity: float, steps: int, heading: float = 0.0
) -> list[tuple[float, float, float | None, float | None]]:
    """States at 0.1 s of a road user that keeps its velocity."""
    distance = 0.1 * velocity * np.arange(steps)
    return [
        (float(x + d * np.cos(heading)), float(y + d * np.sin(heading)), heading, velocity)
        for d in distance
    ]


def straight_road(
    lanes: int = 2,
    length: float = 200.0,
    width: float = 3.5,
    oncoming: int = 0,
    pieces: int = 1,
    speed_limit: float | None = None,
) -> tuple[Lane, ...]:
    """A straight road along x; the centre of the rightmost lane is y = 0.

    Lane k (from the right) of piece p has id ``100 * (p + 1) + k``; the ``oncoming`` lanes lie
    to the left of the others and have the ids after theirs.
    """
    total = lanes + oncoming
    cuts = np.linspace(0.0, length, pieces + 1)
    out = []
    for p in range(pieces):
        x = np.linspace(
            cuts[p], cuts[p + 1], max(int(np.ceil((cuts[p + 1] - cuts[p]) / 10)), 1) + 1
        )
        for k in range(total):
            against = k >= lanes
            low = np.stack([x, np.full_like(x, (k - 0.5) * width)], axis=-1)
            high = np.stack([x, np.full_like(x, (k + 0.5) * width)], axis=-1)
            name = 100 * (p + 1) + k
            later = (name + 100,) if p + 1 < pieces else ()
            earlier = (name - 100,) if p > 0 else ()
            above = (name + 1, against == (k + 1 >= lanes)) if k + 1 < total else None
            below = (name - 1, against == (k - 1 >= lanes)) if k > 0 else None
            if against:
                lane = Lane(name, low[::-1], high[::-1], earlier, later, below, above)
            else:
                lane = Lane(name, high, low, later, earlier, above, below)
            out.append(replace(lane, speed_limit=speed_limit))
    return tuple(out)


def mirrored(lanes: Sequence[Lane]) -> tuple[Lane, ...]:
    """The lanes with y turned round, so that traffic keeps to the other side of the road."""
    flip = np.array([1.0, -1.0])
    return tuple(
        replace(
            lane,
            left=lane.right * flip,
            right=lane.left * flip,
            left_neighbour=lane.right_neighbour,
            right_neighbour=lane.left_neighbour,
        )
        for lane in lanes
    )


def arc_lane(
    lane_id: int,
    start: tuple[float, float, float],
    radius: float,
    angle: float,
    width: float = 3.5,
    points: int = 25,
    successors: tuple[int, ...] = (),
    predecessors: tuple[int, ...] = (),
) -> Lane:
    """A lane whose centre line is an arc from ``start`` (x, y, heading), left for angle > 0."""
    x, y, heading = start
    side = np.sign(angle)
    turned = heading + np.linspace(0.0, angle, points)
    normal = np.stack([-np.sin(turned), np.cos(turned)], axis=-1)
    middle = np.array([x, y]) + side * radius * np.array([-np.sin(heading), np.cos(heading)])
    centre = middle - side * radius * normal
    return Lane(
        lane_id, centre + width / 2 * normal, centre - width / 2 * normal, successors, predecessors
    )


def straight_lane(
    lane_id: int,
    start: tuple[float, float, float],
    length: float,
    width: float = 3.5,
    successors: tuple[int, ...] = (),
    predecessors: tuple[int, ...] = (),
) -> Lane:
    """A straight lane whose centre line begins at ``start`` (x, y, heading)."""
    x, y, heading = start
    along = np.linspace(0.0, length, max(int(np.ceil(length / 5.0)), 1) + 1)[:, None]
    centre = np.array([x, y]) + along * np.array([np.cos(heading), np.sin(heading)])
    normal = width / 2 * np.array([-np.sin(heading), np.cos(heading)])
    return Lane(lane_id, centre + normal, centre - normal, successors, predecessors)


def curve(
    radius: float = 30.0, angle: float = np.pi / 2, width: float = 3.5, approach: float = 50.0
) -> tuple[Lane, ...]:
    """One lane: straight along x (id 1), an arc (id 2) and straight again (id 3)."""
    side = np.sign(angle)
    end = (
        approach + radius * np.sin(abs(angle)),
        side * radius * (1.0 - np.cos(angle)),
        angle,
    )
    return (
        straight_lane(1, (0.0, 0.0, 0.0), approach, width, successors=(2,)),
        arc_lane(2, (approach, 0.0, 0.0), radius, angle, width, successors=(3,), predecessors=(1,)),
        straight_lane(3, end, 100.0, width, predecessors=(2,)),
    )


def junction(width: float = 3.5) -> tuple[Lane, ...]:
    """A road along x (id 1) that forks at x = 50: straight (2, 5), left (3, 6) or right (4, 7).

    The turns have radii of 10 m (left) and 6 m (right); ids 5, 6 and 7 leave the junction.
    """
    left, right = (60.0, 10.0, np.pi / 2), (56.0, -6.0, -np.pi / 2)
    return (
        straight_lane(1, (0.0, 0.0, 0.0), 50.0, width, successors=(2, 3, 4)),
        straight_lane(2, (50.0, 0.0, 0.0), 20.0, width, successors=(5,), predecessors=(1,)),
        arc_lane(3, (50.0, 0.0, 0.0), 10.0, np.pi / 2, width, successors=(6,), predecessors=(1,)),
        arc_lane(4, (50.0, 0.0, 0.0), 6.0, -np.pi / 2, width, successors=(7,), predecessors=(1,)),
        straight_lane(5, (70.0, 0.0, 0.0), 150.0, width, predecessors=(2,)),
        straight_lane(6, left, 150.0, width, predecessors=(3,)),
        straight_lane(7, right, 150.0, width, predecessors=(4,)),
    )


def scenario_xml(
    lanes: Sequence[Lane] = (),
    users: Sequence[User] = (),
    problems: Sequence[Problem] = (Problem(),),
    version: str = "2020a",
    dt: float = 0.1,
    benchmark_id: str = "ZAM_Test-1_1_T-1",
) -> str:
    """A CommonRoad scenario as text; ``version`` is ``2018b`` or ``2020a``."""
    modern = version == "2020a"
    tags = "" if modern else ' tags="urban"'
    parts = [
        '<?xml version="1.0" encoding="utf-8"?>',
        f'<commonRoad affiliation="none" author="none" benchmarkID="{benchmark_id}" '
        f'commonRoadVersion="{version}" date="2020-01-01" source="made by hand"{tags} '
        f'timeStepSize="{dt}">',
    ]
    if modern:
        parts.append(
            "<location><geoNameId>-999</geoNameId><gpsLatitude>999</gpsLatitude>"
            "<gpsLongitude>999</gpsLongitude></location><scenarioTags><urban/></scenarioTags>"
        )
    parts += [_lane(lane, modern) for lane in lanes]
    if modern:
        parts += [_sign(lane) for lane in lanes if lane.speed_limit is not None]
    parts += [_user(user, modern) for user in users]
    parts += [_problem(problem) for problem in problems]
    return "\n".join([*parts, "</commonRoad>"])


def write_scenario_xml(
    path: Path,
    lanes: Sequence[Lane] | None = None,
    users: Sequence[User] = (),
    problems: Sequence[Problem] = (Problem(),),
    version: str = "2020a",
    dt: float = 0.1,
    benchmark_id: str = "ZAM_Test-1_1_T-1",
) -> Path:
    """Writes a CommonRoad scenario (``.xml``, or compressed for ``.gz``) and returns its path.

    Without ``lanes`` the map is ``straight_road()``.
    """
    lanes = straight_road() if lanes is None else lanes
    data = scenario_xml(lanes, users, problems, version, dt, benchmark_id).encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
    return path


def _points(points: Array) -> str:
    return "".join(f"<point><x>{x!r}</x><y>{y!r}</y></point>" for x, y in points.tolist())


def _lane(lane: Lane, modern: bool) -> str:
    links = "".join(f'<predecessor ref="{i}"/>' for i in lane.predecessors)
    links += "".join(f'<successor ref="{i}"/>' for i in lane.successors)
    for tag, neighbour in (
        ("adjacentLeft", lane.left_neighbour),
        ("adjacentRight", lane.right_neighbour),
    ):
        if neighbour is not None:
            direction = "same" if neighbour[1] else "opposite"
            links += f'<{tag} ref="{neighbour[0]}" drivingDir="{direction}"/>'
    if modern:
        links += f"<laneletType>{lane.kind}</laneletType>"
        links += "" if lane.user is None else f"<userOneWay>{lane.user}</userOneWay>"
        links += "<userBidirectional>car</userBidirectional>" if lane.bidirectional else ""
    if lane.speed_limit is not None:
        sign = f'<trafficSignRef ref="{90000 + lane.id}"/>'
        links += sign if modern else f"<speedLimit>{lane.speed_limit}</speedLimit>"
    return (
        f'<lanelet id="{lane.id}"><leftBound>{_points(lane.left)}</leftBound>'
        f"<rightBound>{_points(lane.right)}</rightBound>{links}</lanelet>"
    )


def _sign(lane: Lane) -> str:
    x, y = lane.right[0].tolist()
    return (
        f'<trafficSign id="{90000 + lane.id}"><trafficSignElement>'
        f"<trafficSignID>274</trafficSignID><additionalValue>{lane.speed_limit}</additionalValue>"
        f"</trafficSignElement><position><point><x>{x}</x><y>{y}</y></point></position>"
        "<virtual>false</virtual></trafficSign>"
    )


def _state(
    tag: str, step: int, state: tuple[float, float, float | None, float | None], extra: str = ""
) -> str:
    x, y, heading, velocity = state
    text = f"<position><point><x>{float(x)!r}</x><y>{float(y)!r}</y></point></position>"
    if heading is not None:
        text += f"<orientation><exact>{float(heading)!r}</exact></orientation>"
    text += f"<time><exact>{step}</exact></time>"
    if velocity is not None:
        text += f"<velocity><exact>{float(velocity)!r}</exact></velocity>"
    return f"<{tag}>{text}{extra}</{tag}>"


def _user(user: User, modern: bool) -> str:
    role = "static" if user.static else "dynamic"
    tag, role_tag = (f"{role}Obstacle", "") if modern else ("obstacle", f"<role>{role}</role>")
    later = "".join(
        _state("state", user.first_step + k, state) for k, state in enumerate(user.states) if k
    )
    return (
        f'<{tag} id="{user.id}">{role_tag}<type>{user.kind}</type><shape>{user.shape}</shape>'
        f"{_state('initialState', user.first_step, user.states[0])}"
        + (f"<trajectory>{later}</trajectory>" if later else "")
        + f"</{tag}>"
    )


def _interval(tag: str, bounds: tuple[float, float]) -> str:
    low, high = bounds
    return f"<{tag}><intervalStart>{low}</intervalStart><intervalEnd>{high}</intervalEnd></{tag}>"


def _goal(goal: Goal) -> str:
    text = ""
    if goal.position is not None:
        text += f"<position>{goal.position}</position>"
    if goal.heading is not None:
        text += _interval("orientation", goal.heading)
    if goal.exact_time:
        text += f"<time><exact>{goal.last_step}</exact></time>"
    else:
        text += _interval("time", (goal.first_step, goal.last_step))
    if goal.velocity is not None:
        text += _interval("velocity", goal.velocity)
    return f"<goalState>{text}</goalState>"


def _problem(problem: Problem) -> str:
    yaw = ""
    if problem.yaw_rate is not None:
        yaw = f"<yawRate><exact>{problem.yaw_rate}</exact></yawRate>"
    start = _state(
        "initialState",
        problem.start_step,
        problem.start,
        f"{yaw}<slipAngle><exact>0</exact></slipAngle>",
    )
    goals = "".join(_goal(goal) for goal in problem.goals)
    return f'<planningProblem id="{problem.id}">{start}{goals}</planningProblem>'
