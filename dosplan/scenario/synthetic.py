"""Scenes built in code, without a file: a straight road with two lanes in one direction.

The conformance checks drive plug-ins through them, and authors can try their own there.
The ego's lane is centred on the x axis, the other lane lies to its left; both run along +x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from shapely.geometry import box

from dosplan.geometry import occupancy_of_union
from dosplan.types import (
    STEP_SECONDS,
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    FloatArray,
    GoalState,
    Lanelet,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
    RoadUserKind,
    Route,
    Scenario,
    SetUnion,
    Tracks,
)
from dosplan.vehicle import VehicleParameters

LANE_WIDTH = 3.5
CAR_SIZE = (4.5, 1.8)
_BEHIND = 50.0  # Length of road behind the origin, m.
_SPACING = 0.5  # Distance between the points of a reference path, m.


def straight_map(length: float = 400.0) -> RoadMap:
    """Two parallel lanes along +x, from x = -50 m to ``length``.

    Args:
        length: x of the road's end, m.

    Returns:
        The map; lanelet 1 is centred on y = 0, lanelet 2 on y = ``LANE_WIDTH``.
    """
    x = np.arange(-_BEHIND, length + 1.0, 10.0)
    lines = [np.stack([x, np.full_like(x, (i - 0.5) * LANE_WIDTH)], axis=1) for i in range(3)]
    return RoadMap(
        lanelets=(
            Lanelet(id=1, left=lines[1], right=lines[0], left_neighbour=2),
            Lanelet(id=2, left=lines[2], right=lines[1], right_neighbour=1),
        ),
        drivable=box(x[0], -0.5 * LANE_WIDTH, x[-1], 1.5 * LANE_WIDTH),
    )


def straight_route(length: float = 400.0) -> Route:
    """The x axis from 20 m behind the origin, in the right one of the two lanes.

    Args:
        length: x of the path's end, m.

    Returns:
        The route.
    """
    x = np.arange(-20.0, length + _SPACING / 2.0, _SPACING)
    zeros = np.zeros_like(x)
    return Route(
        lanelet_ids=(1,),
        arclength=x - x[0],
        path=np.stack([x, zeros], axis=1),
        heading=zeros,
        curvature=zeros,
        left=zeros + 1.5 * LANE_WIDTH,
        right=zeros - 0.5 * LANE_WIDTH,
        outer_left=zeros + 1.5 * LANE_WIDTH,
        outer_right=zeros - 0.5 * LANE_WIDTH,
        speed_limit=np.full_like(x, np.inf),
    )


def steady_tracks(
    first: FloatArray | Sequence[Sequence[float]] = (),
    *,
    steps: int = 101,
    kinds: Sequence[RoadUserKind] | None = None,
    dt: float = STEP_SECONDS,
) -> Tracks:
    """Road users that keep their heading and velocity for the whole recording.

    Args:
        first: (N, 4) road-user states at step 0.
        steps: Number K of recorded steps.
        kinds: N kinds; cars by default. All have the size of a car.
        dt: Step, s.

    Returns:
        Tracks with ids 100, 101, ...
    """
    start = np.asarray(first, dtype=np.float64).reshape(-1, USER_SIZE)
    n = len(start)
    heading, velocity = start[:, USER_HEADING], start[:, USER_VELOCITY]
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    states = np.repeat(start[:, None, :], steps, axis=1)
    way = velocity[:, None] * dt * np.arange(steps)
    states[..., :2] += way[..., None] * direction[:, None, :]
    return Tracks(
        ids=100 + np.arange(n),
        kinds=tuple(kinds) if kinds is not None else (RoadUserKind.CAR,) * n,
        size=np.tile(CAR_SIZE, (n, 1)),
        states=states,
        valid=np.ones((n, steps), dtype=np.bool_),
    )


def straight_scenario(
    tracks: Tracks | None = None,
    *,
    velocity: float = 10.0,
    start_step: int = 0,
    final_step: int = 50,
    goals: Sequence[GoalState] | None = None,
    dt: float = STEP_SECONDS,
) -> Scenario:
    """The ego on the straight road, its rear axle in the origin.

    Args:
        tracks: The other road users; none by default.
        velocity: Velocity of the ego at the start, m/s.
        start_step: Step at which the ego starts.
        final_step: Last step of the drive.
        goals: Goals; by default the right lane, anywhere, at ``final_step``.
        dt: Step, s.

    Returns:
        The scenario.
    """
    if goals is None:
        lane = box(-_BEHIND, -0.5 * LANE_WIDTH, 400.0, 0.5 * LANE_WIDTH)
        goals = (GoalState(first_step=final_step, last_step=final_step, region=lane),)
    vehicle = VehicleParameters()
    task = PlanningTask(
        scenario_id="straight",
        dt=dt,
        start_step=start_step,
        start=vehicle.state_at(np.array([vehicle.rear_to_centre, 0.0]), 0.0, velocity),
        goals=tuple(goals),
        final_step=final_step,
        route=straight_route(),
        vehicle=vehicle,
    )
    return Scenario(
        id="straight",
        benchmark_id="straight",
        problem_id=1,
        dt=dt,
        road_map=straight_map(),
        tracks=steady_tracks(dt=dt) if tracks is None else tracks,
        task=task,
    )


def busy_scenario(velocity: float = 10.0) -> Scenario:
    """The ego behind a car at 8 m/s; a faster truck, a pedestrian and a parked car.

    Args:
        velocity: Velocity of the ego at the start, m/s.

    Returns:
        A scenario that starts 4 s into its recording.
    """
    first = [
        [30.0, 0.0, 0.0, 8.0],
        [-45.0, LANE_WIDTH, 0.0, 13.0],
        [60.0, 4.5, -np.pi / 2.0, 1.2],
        [90.0, -3.5, 0.0, 0.0],
    ]
    kinds = (
        RoadUserKind.CAR,
        RoadUserKind.TRUCK,
        RoadUserKind.PEDESTRIAN,
        RoadUserKind.PARKED,
    )
    tracks = steady_tracks(first, kinds=kinds)
    return straight_scenario(tracks, velocity=velocity, start_step=40, final_step=90)


def off_path_scenario() -> Scenario:
    """The busy scene; the ego starts beside the route's path, turned, and with its wheels turned.

    Returns:
        A scenario that starts 4 s into its recording.
    """
    scenario = busy_scenario()
    x, y, steering, velocity, heading = scenario.task.start
    start = np.array([x, y + 0.3, steering - 0.02, velocity, heading + 0.04])
    return replace(scenario, task=replace(scenario.task, start=start))


def crowded_scenario() -> Scenario:
    """Fifty cars that drive in every direction on and beside the road.

    Returns:
        A scenario that starts 4 s into its recording.
    """
    rng = np.random.default_rng(0)
    low, high = [-40.0, -15.0, -np.pi, 0.0], [150.0, 20.0, np.pi, 12.0]
    tracks = steady_tracks(rng.uniform(low, high, size=(50, USER_SIZE)))
    return straight_scenario(tracks, start_step=40, final_step=90)


def forking_sets(
    observation: Observation, horizon: int = 40, turning: float = 0.3, rate: float = 0.3
) -> Occupancy:
    """A plain prediction of two courses: who moves goes straight on, or turns left.

    Args:
        observation: What is known now.
        horizon: Number T of steps.
        turning: Weight of turning; who stands has one component.
        rate: How fast it turns, rad/s.

    Returns:
        Unions of two sets, as large as those of ``growing_sets``.
    """
    now = observation.states[:, -1]
    time = observation.dt * np.arange(1, horizon + 1)
    turn = np.array([0.0, rate])[:, None] * time
    heading = now[:, USER_HEADING, None, None] + turn
    # The chord of an arc is turned by half of its angle.
    chord = now[:, USER_HEADING, None, None] + turn / 2.0
    way = now[:, USER_VELOCITY, None, None] * time * np.sinc(turn / 2.0 / np.pi)
    direction = np.stack([np.cos(chord), np.sin(chord)], axis=-1)
    reach = 0.1 + 0.4 * np.tile(time, (len(now), 2, 1))
    turns = np.where(now[:, USER_VELOCITY] > 0.0, turning, 0.0)
    union = SetUnion(
        weight=np.stack([1.0 - turns, turns], axis=1),
        centre=now[:, None, None, :2] + way[..., None] * direction,
        semi_axes=np.stack([reach, 0.5 * reach], axis=-1),
        angle=heading,
        heading=heading,
    )
    return occupancy_of_union(observation, union)


def growing_sets(observation: Observation, horizon: int = 40) -> Occupancy:
    """A plain prediction to plan with: constant velocity and ellipses that grow with time.

    Args:
        observation: What is known now.
        horizon: Number T of steps.

    Returns:
        The sets, longer along the heading than across it.
    """
    now = observation.states[:, -1]
    time = observation.dt * np.arange(1, horizon + 1)
    heading = np.repeat(now[:, USER_HEADING, None], horizon, axis=1)
    way = now[:, USER_VELOCITY, None] * time
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    reach = 0.1 + 0.4 * time
    return Occupancy.from_trajectory(
        observation,
        centre=now[:, None, :2] + way[..., None] * direction,
        heading=heading,
        semi_axes=np.tile(np.stack([reach, 0.5 * reach], axis=-1), (len(now), 1, 1)),
    )
