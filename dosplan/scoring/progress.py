"""Progress along the route, beside what is expected of it: nuPlan's *making progress*.

nuPlan compares the ego's progress with that of the human who drove there. A CommonRoad problem
names no such driver. What is expected here is the way to the goal, where the goal has a place. Of
a goal that is a time alone, it is the way at the speed of the start until the goal counts, but not
past the road user ahead of the ego, where that one is at that time, nor past the line of a red
light.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely

from dosplan.geometry import ReferencePath
from dosplan.types import (
    EGO_VELOCITY,
    USER_HEADING,
    FloatArray,
    GoalState,
    PlanningTask,
    Scenario,
    Signals,
    StopCause,
    Tracks,
)

LEAST: Final = 2.0
"""Progress up to which none is told from standing, m (nuPlan's ``score_progress_threshold``)."""

MAKING_PROGRESS: Final = 0.2
"""Least share of the expected progress (nuPlan's ``min_progress_threshold``)."""


def is_time_alone(goal: GoalState) -> bool:
    """Whether a goal asks for nothing but a time: it is reached by standing still, too.

    Args:
        goal: The goal.

    Returns:
        Whether it sets no region and no velocity.
    """
    return goal.region is None and goal.velocity is None


def progress_ratio(progress: float, needed: float) -> float:
    """Share of the expected progress, by nuPlan's formula.

    ``min(1, max(progress, 2 m) / max(needed, 2 m))``, and 0 where the ego goes back more than 2 m.

    Args:
        progress: Driven along the route, m.
        needed: Expected, m.

    Returns:
        0 to 1.
    """
    if progress < -LEAST:
        return 0.0
    return min(1.0, max(progress, LEAST) / max(needed, LEAST))


def makes_progress(progress: float, needed: float) -> bool:
    """Whether the ego makes progress: nuPlan's ``ego_is_making_progress``.

    Args:
        progress: Driven along the route, m.
        needed: Expected, m.

    Returns:
        Whether its share is at least ``MAKING_PROGRESS``.
    """
    return progress_ratio(progress, needed) >= MAKING_PROGRESS


def needed_progress(scenario: Scenario, tracks: Tracks, signals: Signals) -> float:
    """Progress that is expected in a scenario.

    Args:
        scenario: The scenario.
        tracks: The road users as they were driven.
        signals: The traffic lights as they were.

    Returns:
        m along the reference path, not negative: of several goals, the least.
    """
    task = scenario.task
    path = ReferencePath.of(task.route)
    start = path.locate_first(task.vehicle.centre(task.start))
    ways = [
        _way_in_time(goal, scenario, path, start, tracks, signals)
        if goal.region is None
        else _way_to(goal.region, path, start)
        for goal in task.goals
    ]
    return max(0.0, min(ways))


def _way_to(region: shapely.Geometry, path: ReferencePath, start: float) -> float:
    """Way along a path until it enters a region, or else to the point nearest to it, m."""
    ahead = path.arclength >= start
    inside = ahead & shapely.intersects_xy(region, path.points[:, 0], path.points[:, 1])
    if inside.any():
        return float(path.arclength[np.argmax(inside)]) - start
    far = shapely.distance(region, shapely.points(path.points))
    return float(path.arclength[np.argmin(far)]) - start


def _way_in_time(
    goal: GoalState,
    scenario: Scenario,
    path: ReferencePath,
    start: float,
    tracks: Tracks,
    signals: Signals,
) -> float:
    task = scenario.task
    steps = max(goal.first_step - task.start_step, 0)
    front = start + 0.5 * task.vehicle.length
    way = float(task.start[EGO_VELOCITY]) * steps * scenario.dt
    way = min(way, _way_behind_others(task, path, start, tracks, task.start_step + steps))
    for stop in task.route.stops:
        if stop.cause is StopCause.LIGHT and stop.arclength >= front:
            shown = (signals.at(task.start_step + k).shown(stop.lights) for k in range(steps + 1))
            if any(colour.forbids for colour in shown):
                way = min(way, stop.arclength - front)
    return way


def _way_behind_others(
    task: PlanningTask, path: ReferencePath, start: float, tracks: Tracks, step: int
) -> float:
    """Way until the ego's front is at the rear of who drives ahead of it on the path, m.

    That is somebody who is ahead of the ego at its start, and on its path at the step.
    """
    step = min(step, tracks.steps - 1)
    if step < task.start_step:
        return np.inf
    there = np.flatnonzero(tracks.valid[:, task.start_step] & tracks.valid[:, step])
    first, last = (tracks.states[there, k] for k in (task.start_step, step))
    if not there.size:
        return np.inf
    before, after = (path.locate(places[:, :2], start) for places in (first, last))
    half_width = 0.5 * (task.vehicle.width + tracks.size[there, 1])
    on_path = (before > start) & (np.abs(path.offset(last[:, :2], after)) < half_width)
    turned = last[:, USER_HEADING] - path.heading_at(after)
    half: FloatArray = 0.5 * (
        np.abs(np.cos(turned)) * tracks.size[there, 0]
        + np.abs(np.sin(turned)) * tracks.size[there, 1]
    )
    gaps = after - half - start - 0.5 * task.vehicle.length
    return float(np.min(gaps[on_path], initial=np.inf))
