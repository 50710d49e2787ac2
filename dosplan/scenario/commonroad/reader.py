"""From a checked document to a ``Scenario``."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
import shapely
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.util import FileFormat, Interval
from commonroad.planning.goal import GoalRegion
from commonroad.planning.planning_problem import PlanningProblem
from commonroad.scenario.state import CustomState, InitialState

from dosplan.geometry import ReferencePath
from dosplan.scenario.commonroad.document import Document, ScenarioError, read_document
from dosplan.scenario.commonroad.obstacles import Resampling, read_tracks
from dosplan.scenario.commonroad.road_map import read_road_map
from dosplan.scenario.commonroad.states import exact, position, region
from dosplan.scenario.route.route import build_route
from dosplan.scenario.sources.catalogue import ScenarioRef
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    STEP_SECONDS,
    FloatArray,
    GoalState,
    PlanningTask,
    RoadMap,
    Route,
    Scenario,
)
from dosplan.vehicle import VehicleParameters

MAX_STEPS: Final = 36_000
"""Longest episode that is accepted: an hour."""
MAX_START_DISTANCE: Final = 5.0
"""Largest distance of the ego's start from the road, m."""
_MIN_STEERING_SPEED: Final = 1.0
_ALONG_ROUTE: Final = 0.87  # Cosine of the largest angle to the route at which it is followed.


def read_scenario(ref: ScenarioRef, content: bytes, *, onlooker: bool = False) -> Scenario:
    """Makes one episode of a file's content.

    Args:
        ref: The episode; an empty ``id`` stands for the one the file gives it.
        content: What its file holds, compressed or not.
        onlooker: Whether a file without a planning problem is given an ego that looks on.

    Returns:
        The scenario.

    Raises:
        ScenarioError: The file cannot be used.
    """
    document = read_document(ref.path, content)
    try:
        with _quiet():
            source, problems = CommonRoadFileReader(document.data, FileFormat.XML).open()
            listed = problems.planning_problem_dict
            if not listed and onlooker:
                listed = {0: _onlooker(source)}
            return _scenario(document, ref, source, listed)
    except ScenarioError:
        raise
    except Exception as error:  # commonroad-io raises whatever it meets
        reason = str(error) or "commonroad-io gives no reason"
        raise ScenarioError(
            ref.path, f"cannot be used ({type(error).__name__}: {reason})"
        ) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps commonroad-io's warnings and log lines off the console."""
    logger = logging.getLogger("commonroad")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _scenario(
    document: Document, ref: ScenarioRef, source: Any, problems: dict[int, Any]
) -> Scenario:
    benchmark_id = document.root.get("benchmarkID", "")
    problem = _choose(ref, problems)
    try:
        resampling = Resampling.of(source.dt)
        first_step = resampling.instant(int(exact(problem.initial_state.time_step)))
        goals = tuple(_goal(state, resampling) for state in problem.goal.state_list)
    except ValueError as error:
        raise ScenarioError(ref.path, str(error)) from None
    final_step = max(goal.last_step for goal in goals)
    if not first_step < final_step <= first_step + MAX_STEPS:
        raise ScenarioError(
            ref.path,
            f"starts at step {first_step} and ends at step {final_step}; "
            f"an episode has 1 to {MAX_STEPS} steps",
        )
    road_map = read_road_map(source.lanelet_network)
    if not any(lanelet.for_cars for lanelet in road_map.lanelets):
        raise ScenarioError(ref.path, "has no lanelet for cars; the ego needs one")
    vehicle = VehicleParameters()
    start = _start(problem.initial_state, vehicle)
    centre = vehicle.centre(start)
    _check_start(ref, road_map, centre, float(start[EGO_VELOCITY]), vehicle)
    name = ref.id or (benchmark_id if len(problems) == 1 else f"{benchmark_id}@{ref.problem_id}")
    route = build_route(
        road_map,
        centre=centre,
        heading=float(start[EGO_HEADING]),
        velocity=float(start[EGO_VELOCITY]),
        goals=goals,
        seconds=(final_step - first_step) * STEP_SECONDS,
        vehicle=vehicle,
        two_way=document.two_way,
    )
    return Scenario(
        id=name,
        benchmark_id=benchmark_id,
        problem_id=problem.planning_problem_id,
        dt=STEP_SECONDS,
        road_map=road_map,
        tracks=read_tracks(source, document.derived, resampling, final_step),
        task=PlanningTask(
            scenario_id=name,
            dt=STEP_SECONDS,
            start_step=first_step,
            start=_steered(start, route, vehicle),
            goals=goals,
            final_step=final_step,
            route=route,
            vehicle=vehicle,
        ),
        tags=frozenset(tag.value for tag in source.tags or ()),
    )


def _onlooker(source: Any) -> PlanningProblem:
    """The problem of an ego that stands where the map's first lanelet begins, to the very end."""
    lanelet = source.lanelet_network.lanelets[0]
    along = lanelet.center_vertices[1] - lanelet.center_vertices[0]
    start = InitialState(
        time_step=0,
        position=lanelet.center_vertices[0][:2],
        orientation=float(np.arctan2(along[1], along[0])),
        velocity=0.0,
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
    )
    predictions = [obstacle.prediction for obstacle in source.dynamic_obstacles]
    last = max([int(p.final_time_step) for p in predictions if p is not None], default=1)
    return PlanningProblem(0, start, GoalRegion([CustomState(time_step=Interval(0, last))]))


def _choose(ref: ScenarioRef, problems: dict[int, Any]) -> Any:
    if not problems:
        raise ScenarioError(ref.path, "has no planning problem; add one")
    if ref.problem_id is None and len(problems) > 1:
        known = ", ".join(str(name) for name in sorted(problems))
        raise ScenarioError(ref.path, f"holds the planning problems {known}; name one of them")
    name = next(iter(problems)) if ref.problem_id is None else ref.problem_id
    if name not in problems:
        raise ScenarioError(ref.path, f"holds no planning problem {name}")
    return problems[name]


def _start(state: Any, vehicle: VehicleParameters) -> FloatArray:
    velocity, yaw_rate = exact(state.velocity), exact(getattr(state, "yaw_rate", None) or 0.0)
    steering = 0.0
    if velocity > _MIN_STEERING_SPEED:
        steering = float(np.arctan(vehicle.wheelbase * yaw_rate / velocity))
    return vehicle.state_at(
        position(state.position),
        exact(state.orientation),
        velocity,
        float(np.clip(steering, -vehicle.max_steering, vehicle.max_steering)),
    )


def _steered(start: FloatArray, route: Route, vehicle: VehicleParameters) -> FloatArray:
    """The start with the wheels turned along the route where the file gives no yaw rate.

    Nine in ten files write a yaw rate of zero, in bends too. A car that follows its lane has
    its wheels turned already; with straight wheels it would leave a tight bend at once.
    """
    if start[EGO_STEERING] != 0.0:
        return start
    path = ReferencePath.of(route)
    along = path.locate(start[:2])
    if np.cos(start[EGO_HEADING] - path.heading_at(along)) < _ALONG_ROUTE:
        return start
    steered = start.copy()
    steered[EGO_STEERING] = np.clip(
        np.arctan(vehicle.wheelbase * path.curvature_at(along)),
        -vehicle.max_steering,
        vehicle.max_steering,
    )
    return steered


def _check_start(
    ref: ScenarioRef,
    road_map: RoadMap,
    centre: FloatArray,
    velocity: float,
    vehicle: VehicleParameters,
) -> None:
    if not 0.0 <= velocity <= vehicle.max_velocity:
        raise ScenarioError(
            ref.path,
            f"starts the ego at {velocity:g} m/s; "
            f"give it an initial velocity from 0 to {vehicle.max_velocity:g} m/s",
        )
    distance = float(shapely.distance(road_map.drivable, shapely.Point(centre)))
    if not distance <= MAX_START_DISTANCE:
        raise ScenarioError(
            ref.path,
            f"starts the ego {distance:.1f} m off the road; correct its initial position",
        )


def _goal(state: Any, resampling: Resampling) -> GoalState:
    window = resampling.window(int(state.time_step.start), int(state.time_step.end))
    place, heading, velocity = (
        getattr(state, name, None) for name in ("position", "orientation", "velocity")
    )
    return GoalState(
        first_step=window[0],
        last_step=window[1],
        region=None if place is None else region(place),
        heading=None if heading is None else (float(heading.start), float(heading.end)),
        velocity=None if velocity is None else (float(velocity.start), float(velocity.end)),
    )
