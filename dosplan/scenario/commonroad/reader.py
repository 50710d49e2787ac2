"""From a checked document to a ``Scenario``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from dosplan.scenario.commonroad.document import Document, ScenarioError, read_document
from dosplan.scenario.commonroad.elements import (
    FaultError,
    child,
    identity,
    interval,
    label,
    middle,
    naming,
    number,
    references,
    step,
)
from dosplan.scenario.commonroad.obstacles import Resampling, interactive, read_tracks
from dosplan.scenario.commonroad.regulation import signals
from dosplan.scenario.commonroad.road_map import read_road_map
from dosplan.scenario.commonroad.states import SHAPES, Part, position, read_shape, region
from dosplan.scenario.route.route import build_route
from dosplan.scenario.route.start import wheels_by_yaw_rate, with_wheels_turned
from dosplan.scenario.sources.catalogue import ScenarioRef
from dosplan.types import (
    EGO_HEADING,
    EGO_VELOCITY,
    STEP_SECONDS,
    FloatArray,
    GoalState,
    Lanelet,
    PlanningTask,
    RoadMap,
    Scenario,
)
from dosplan.vehicle import VehicleParameters

MAX_STEPS: Final = 36_000
"""Longest episode that is accepted: an hour."""
MAX_START_DISTANCE: Final = 5.0
"""Largest distance of the ego's start from the road, m."""
VELOCITY_SLACK: Final = 0.1
"""How far to each side a goal counts that asks for one exact velocity, m/s.

No controller holds a velocity exactly: a car that is braked to a stop creeps for a while at some
centimetres a second. 0.1 m/s is a centimetre in a step. It is also what CommonRoad's files round
recorded velocities to.
"""
ANY_HEADING: Final = 2.0 * np.pi - 1e-3
"""Width from which on an interval of headings holds every heading, rad."""


def read_scenario(ref: ScenarioRef, content: bytes, *, ego_optional: bool = False) -> Scenario:
    """Makes one episode of a file's content.

    Args:
        ref: The episode; an empty ``id`` stands for the one the file gives it.
        content: What its file holds, compressed or not.
        ego_optional: Whether a file without a planning problem is given a standing ego.

    Returns:
        The scenario.

    Raises:
        ScenarioError: The file cannot be used.
    """
    document = read_document(ref.path, content)
    try:
        return _scenario(document, ref, ego_optional)
    except FaultError as error:
        raise ScenarioError(ref.path, str(error)) from None
    except (ValueError, ArithmeticError, LookupError, shapely.GEOSException) as error:
        raise ScenarioError(
            ref.path,
            "holds a road or shapes that nothing can be computed with; look for points that repeat "
            "or lines that cross, and correct them",
        ) from error


@dataclass(frozen=True)
class _Problem:
    """A planning problem as the file states it, in steps of 0.1 s.

    Attributes:
        id: Its id.
        resampling: From the file's steps to these.
        first_step: Where the ego starts.
        start: (5,) ego state there.
        goals: Alternative goals.
    """

    id: int
    resampling: Resampling
    first_step: int
    start: FloatArray
    goals: tuple[GoalState, ...]


def _scenario(document: Document, ref: ScenarioRef, ego_optional: bool) -> Scenario:
    root = document.root
    benchmark_id = root.get("benchmarkID", "")
    dt = number(root.get("timeStepSize"), "its timeStepSize")
    resampling = Resampling.of(dt)  # Of which every problem begins where its ego starts.
    read = read_road_map(root)
    vehicle = VehicleParameters()
    elements = root.findall("planningProblem")
    if not elements and ego_optional:
        lanelets = read.road_map.lanelets
        where = next((lanelet for lanelet in lanelets if lanelet.for_cars), lanelets[0])
        problem = _standing_ego(root, where, resampling, vehicle)
    else:
        element = _chosen(ref, elements)
        with naming(label(element)):
            problem = _problem(element, dt, {x.id: x for x in read.road_map.lanelets}, vehicle)
    final_step = max(goal.last_step for goal in problem.goals)
    if not problem.first_step < final_step <= problem.first_step + MAX_STEPS:
        raise FaultError(
            f"starts at step {problem.first_step} and ends at step {final_step}, of 0.1 s; "
            f"an episode has 1 to {MAX_STEPS} steps"
        )
    road_map = read.road_map
    if not any(lanelet.for_cars for lanelet in road_map.lanelets):
        raise FaultError("has no lanelet for cars; the ego needs one")
    start, centre = problem.start, vehicle.centre(problem.start)
    _check_start(road_map, centre, float(start[EGO_VELOCITY]), vehicle)
    tracks, notes = read_tracks(root, problem.resampling, final_step, road_map.drivable)
    name = ref.id or (benchmark_id if len(elements) < 2 else f"{benchmark_id}@{ref.problem_id}")
    route = build_route(
        road_map,
        centre=centre,
        heading=float(start[EGO_HEADING]),
        velocity=float(start[EGO_VELOCITY]),
        goals=problem.goals,
        seconds=(final_step - problem.first_step) * STEP_SECONDS,
        vehicle=vehicle,
        two_way=read.two_way,
    )
    return Scenario(
        id=name,
        benchmark_id=benchmark_id,
        problem_id=problem.id,
        dt=STEP_SECONDS,
        road_map=road_map,
        tracks=tracks,
        task=PlanningTask(
            scenario_id=name,
            dt=STEP_SECONDS,
            start_step=problem.first_step,
            start=with_wheels_turned(start, route, road_map, vehicle),
            goals=problem.goals,
            final_step=final_step,
            route=route,
            vehicle=vehicle,
        ),
        signals=signals(read.lights, problem.resampling, max(final_step, tracks.steps - 1)),
        tags=_tags(root),
        notes=(*read.notes, *notes),
        interactive=interactive(root),
    )


def _tags(root: Element) -> frozenset[str]:
    listed = root.find("scenarioTags")
    return frozenset(
        (root.get("tags") or "").split() if listed is None else (tag.tag for tag in listed)
    )


def _standing_ego(
    root: Element, lanelet: Lanelet, resampling: Resampling, vehicle: VehicleParameters
) -> _Problem:
    """The problem of an ego that stands to the very end where a lanelet begins."""
    along = lanelet.centre[1] - lanelet.centre[0]
    start = vehicle.state_at(lanelet.centre[0], float(np.arctan2(along[1], along[0])), 0.0, 0.0)
    tags = ("dynamicObstacle", "obstacle")
    states = [s for tag in tags for s in root.iterfind(f"{tag}/trajectory/state")]
    last = resampling.instant(max([step(state) for state in states], default=1))
    return _Problem(0, resampling, 0, start, (GoalState(0, max(last, 1)),))


def _chosen(ref: ScenarioRef, problems: list[Element]) -> Element:
    if not problems:
        raise FaultError("has no planning problem; add one")
    known = [identity(problem) for problem in problems]
    if twice := [name for name in known if known.count(name) > 1]:
        raise FaultError(f"names planning problem {twice[0]} twice; give one another id")
    if ref.problem_id is None and len(problems) > 1:
        listed = ", ".join(str(name) for name in sorted(known))
        raise FaultError(f"holds the planning problems {listed}; name one of them")
    if ref.problem_id is not None and ref.problem_id not in known:
        raise FaultError(f"holds no planning problem {ref.problem_id}")
    return problems[0 if ref.problem_id is None else known.index(ref.problem_id)]


def _problem(
    element: Element, dt: float, lanelets: Mapping[int, Lanelet], vehicle: VehicleParameters
) -> _Problem:
    state = child(element, "initialState")
    with naming("its initial state"):
        begin, start = step(state), _start(state, vehicle)
        if begin < 0:
            raise FaultError(f"it is at step {begin}; steps count from 0")
    resampling = Resampling.of(dt, begin)
    goals = []
    for count, goal in enumerate(element.findall("goalState"), start=1):
        with naming(f"goal {count}"):
            goals.append(_goal(goal, resampling, lanelets))
    if not goals:
        raise FaultError("it has no <goalState>; add one that says what the ego has to reach")
    return _Problem(identity(element), resampling, resampling.instant(begin), start, tuple(goals))


def _start(state: Element, vehicle: VehicleParameters) -> FloatArray:
    velocity, heading = (middle(child(state, tag)) for tag in ("velocity", "orientation"))
    turning = state.find("yawRate")
    steering = 0.0
    if turning is not None:
        steering = wheels_by_yaw_rate(velocity, middle(turning), vehicle)
    return vehicle.state_at(position(state), heading, velocity, steering)


def _check_start(
    road_map: RoadMap, centre: FloatArray, velocity: float, vehicle: VehicleParameters
) -> None:
    if not 0.0 <= velocity <= vehicle.max_velocity:
        raise FaultError(
            f"starts the ego at {velocity:g} m/s; "
            f"give it an initial velocity from 0 to {vehicle.max_velocity:g} m/s"
        )
    if road_map.drivable.is_empty:
        raise FaultError("has lanelets of no area, so no road; correct their bounds")
    distance = float(shapely.distance(road_map.drivable, shapely.Point(centre)))
    if not distance <= MAX_START_DISTANCE:
        raise FaultError(
            f"starts the ego {distance:.1f} m off the road; correct its initial position"
        )


def _goal(state: Element, resampling: Resampling, lanelets: Mapping[int, Lanelet]) -> GoalState:
    time = state.find("time")
    if time is None:
        raise FaultError("it has no <time>; add the steps in which it counts")
    first_step, last_step = resampling.window(*(int(bound) for bound in interval(time)))
    place, turned, speed = (state.find(tag) for tag in ("position", "orientation", "velocity"))
    return GoalState(
        first_step=first_step,
        last_step=last_step,
        region=None if place is None else _region(place, lanelets),
        heading=None if turned is None else _heading(turned),
        velocity=None if speed is None else _velocity(speed),
    )


def _region(place: Element, lanelets: Mapping[int, Lanelet]) -> Polygon | MultiPolygon:
    if place.find("point") is not None:
        raise FaultError("it asks for a single <point>, which no drive meets; give it an area")
    names = references(place, "lanelet")
    if unknown := [name for name in names if name not in lanelets]:
        raise FaultError(f"it names lanelet {unknown[0]}, which the map does not hold; correct it")
    parts = [_lanelet_part(lanelets[name]) for name in names]
    if not parts or any(place.find(tag) is not None for tag in SHAPES):
        parts = read_shape(place) + parts
    area = region(parts)
    if area.is_empty:
        raise FaultError("it has an area of no size; correct it")
    return area


def _lanelet_part(lanelet: Lanelet) -> Part:
    outline = shapely.Polygon(np.concatenate([lanelet.right, lanelet.left[::-1]]))
    return Part(shapely.get_coordinates(shapely.orient_polygons(outline, exterior_cw=True))[:-1])


def _heading(turned: Element) -> tuple[float, float] | None:
    low, high = interval(turned)
    return None if high - low >= ANY_HEADING else (low, high)


def _velocity(speed: Element) -> tuple[float, float]:
    low, high = interval(speed)
    return (low - VELOCITY_SLACK, high + VELOCITY_SLACK) if low == high else (low, high)
