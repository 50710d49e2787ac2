"""Small objects that several tests share, beside those of ``dosplan.scenario.synthetic``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from shapely import Geometry, Polygon

from dosplan.geometry import covering_ellipse
from dosplan.results.recording import Recording
from dosplan.scenario.synthetic import CAR_SIZE, steady_tracks, straight_scenario
from dosplan.types import (
    COLOURS,
    STEP_SECONDS,
    Arm,
    EpisodeEnd,
    FloatArray,
    GoalState,
    LightColour,
    Occupancy,
    RoadUserKind,
    Route,
    RouteStop,
    Scenario,
    SetUnion,
    Signals,
    StopCause,
)

PEDESTRIAN_SIZE = (0.6, 0.6)


def arc_route(radius: float, length: float = 200.0, spacing: float = 0.5) -> Route:
    """A left bend of constant radius that leaves the origin along +x; lanes 1.75 m to each side."""
    s = np.arange(0.0, length, spacing)
    angle = s / radius
    ones = np.ones_like(s)
    return Route(
        lanelet_ids=(1,),
        arclength=s,
        path=radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1),
        heading=angle,
        curvature=ones / radius,
        left=1.75 * ones,
        right=-1.75 * ones,
        outer_left=1.75 * ones,
        outer_right=-1.75 * ones,
        speed_limit=np.inf * ones,
    )


def ruled_scenario(
    *stops: RouteStop,
    users: Sequence[Sequence[float]] = (),
    kinds: Sequence[RoadUserKind] | None = None,
    lights: Mapping[int, Sequence[LightColour]] | None = None,
    limit: float = np.inf,
    velocity: float = 10.0,
    seconds: float = 10.0,
    goals: Sequence[GoalState] | None = None,
) -> Scenario:
    """The straight road of ``dosplan.scenario.synthetic`` with rules on it.

    Args:
        stops: Where the ego may have to stop; see ``stop_at``.
        users: (N, 4) road users that keep their velocity; of a car's size or a pedestrian's.
        kinds: What they are; cars by default.
        lights: What each traffic light shows, step by step; the last colour stays.
        limit: Speed limit, m/s.
        velocity: Velocity of the ego at the start, m/s; its rear axle is at x = 0.
        seconds: Length of the drive, s.
        goals: Goals; by default anywhere on the lane at the end.
    """
    last = round(seconds / STEP_SECONDS)
    tracks = steady_tracks(users, kinds=kinds, steps=last + 1)
    walks = np.array([kind is RoadUserKind.PEDESTRIAN for kind in tracks.kinds], dtype=np.bool_)
    tracks = replace(tracks, size=np.where(walks[:, None], PEDESTRIAN_SIZE, tracks.size))
    scenario = straight_scenario(tracks, velocity=velocity, final_step=last, goals=goals)
    road = scenario.task.route
    route = replace(road, stops=stops, speed_limit=np.full_like(road.arclength, limit))
    shown = lights or {}
    steps = max((len(colours) for colours in shown.values()), default=1)
    numbers = [
        [COLOURS.index(colours[min(k, len(colours) - 1)]) for k in range(steps)]
        for colours in shown.values()
    ]
    colours = np.array(numbers, dtype=np.int64).reshape(-1, steps)
    signals = Signals(
        ids=np.array(list(shown), dtype=np.int64),
        colours=colours,
        since=np.tile(np.arange(steps) * STEP_SECONDS, (len(colours), 1)).astype(np.float64),
    )
    return replace(scenario, task=replace(scenario.task, route=route), signals=signals)


def stop_at(
    cause: StopCause,
    x: float,
    end: float,
    lights: tuple[int, ...] = (),
    conflict: Geometry | None = None,
) -> RouteStop:
    """A stop of the straight road, whose line is at ``x`` and which ends at ``end``, m."""
    return RouteStop(cause, x + 20.0, end + 20.0, lights, conflict or Polygon())


def occupancy_at(centres: FloatArray, horizon: int, semi_axis: float = 0.0) -> Occupancy:
    """Cars that stand at (N, 2) ``centres``, heading along +x, with circular sets."""
    n = len(centres)
    return Occupancy(
        ids=100 + np.arange(n),
        centre=np.repeat(centres[:, None, :], horizon, axis=1),
        semi_axes=np.full((n, horizon, 2), semi_axis),
        angle=np.zeros((n, horizon)),
        valid=np.ones((n, horizon), dtype=np.bool_),
        footprint=np.tile(CAR_SIZE, (n, 1)),
        heading=np.zeros((n, horizon)),
    )


def recording_of_sets(
    ids: Sequence[int],
    centres: FloatArray,
    semi_axes: FloatArray,
    angles: FloatArray,
    *,
    arm: Arm = Arm.WITH_DOS,
    start_step: int = 0,
    steps: int = 10,
) -> Recording:
    """One cycle with (n, 2) sets 5 and 10 steps ahead; the ego stands in the origin."""
    return Recording(
        scenario_id="s",
        arm=arm,
        start_step=start_step,
        states=np.zeros((steps + 1, 5)),
        inputs=np.zeros((steps, 2)),
        end=EpisodeEnd.TIME_OVER,
        error=None,
        cycle_steps=np.array([start_step]),
        predict_seconds=np.full(1, 1e-3),
        plan_seconds=np.full(1, 1e-3),
        traffic="replay",
        tracks=None,
        status=("solved",),
        iterations=np.ones(1, dtype=np.int64),
        slack=np.zeros(1),
        road_slack=np.zeros(1),
        active_ids=((),),
        fallback=("",),
        plan_centres=np.zeros((1, 11, 2)),
        set_cycle=np.zeros(len(ids), dtype=np.int64),
        set_ids=np.array(ids),
        set_offsets=np.array([5, 10]),
        set_centres=centres,
        set_semi_axes=semi_axes,
        set_angles=angles,
    )


def random_union(
    rng: np.random.Generator, users: int, count: int, steps: int, spread: float, reach: float
) -> SetUnion:
    """Unions of ``count`` ellipses on a map, about ``spread`` apart and up to ``reach`` long."""
    weight = rng.uniform(0.1, 1.0, (users, count))
    apart = rng.normal(size=(users, count, steps, 2))
    return SetUnion(
        weight=weight / weight.sum(axis=1, keepdims=True),
        centre=5e5 + rng.uniform(-50.0, 50.0, (users, 1, 1, 2)) + spread * apart,
        semi_axes=reach * rng.uniform(0.1, 1.0, (users, count, steps, 2)),
        angle=rng.uniform(-9.0, 9.0, (users, count, steps)),
        heading=rng.uniform(-9.0, 9.0, (users, count, steps)),
    )


def union_of(weights: Sequence[float], *parts: Occupancy) -> Occupancy:
    """Sets that are unions of those of several occupancies of the same road users."""
    names = ("centre", "semi_axes", "angle", "heading")
    union = SetUnion(
        weight=np.tile(weights, (len(parts[0].ids), 1)),
        **{name: np.stack([getattr(part, name) for part in parts], axis=1) for name in names},
    )
    centre, semi_axes, angle = covering_ellipse(union)
    return replace(parts[0], centre=centre, semi_axes=semi_axes, angle=angle, union=union)
