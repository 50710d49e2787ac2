"""dosplan's map, route and sets as the peers take them: as objects of CommonRoad's tools."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from shapely.geometry import LineString

from dosplan.geometry import set_sizes
from dosplan.types import FloatArray, GoalState, Occupancy, PlanningTask, RoadMap, Route
from dosplan_peers import INSTALL
from dosplan_peers.peer import WALL, Stop

try:
    from commonroad.scenario.lanelet import Lanelet
    from commonroad.scenario.scenario import Scenario
    from commonroad_dc import pycrcc
    from commonroad_dc.collision.trajectory_queries.trajectory_queries import (
        trajectory_preprocess_obb_sum,
    )
except ImportError as error:
    raise ImportError(f"{error}; {INSTALL}") from error

_EXTENSION: Final = 30.0  # m of straight path added at either end, as Frenetix's driver does.


def commonroad_scenario(road_map: RoadMap, dt: float) -> Scenario:
    """The road alone as a CommonRoad scenario: footways and the like are off the road here, too.

    Args:
        road_map: The map.
        dt: Step, s.

    Returns:
        A scenario without obstacles.
    """
    scenario = Scenario(dt)
    for lanelet in (lanelet for lanelet in road_map.lanelets if lanelet.is_road):
        bounds = (np.array(line) for line in (lanelet.left, lanelet.centre, lanelet.right))
        scenario.add_objects(Lanelet(*bounds, lanelet.id))
    return scenario


def goal_on_way(task: PlanningTask) -> GoalState:
    """The goal that a planner of a single one drives to.

    Args:
        task: Start, goals and route.

    Returns:
        The first goal whose region the route's path comes by, or that has none; the first of all
        where it comes by none.
    """
    path = LineString(task.route.path)
    on_way = (goal for goal in task.goals if goal.region is None or path.intersects(goal.region))
    return next(on_way, task.goals[0])


def reference_path(route: Route) -> FloatArray:
    """The route's path, a little longer at both ends, so that every sample can be projected.

    Args:
        route: The route.

    Returns:
        (P, 2) m.
    """
    headings = route.heading[[0, -1]]
    spacing = float(route.arclength[1] - route.arclength[0])
    steps = np.arange(spacing, _EXTENSION, spacing)[:, None]
    behind, ahead = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    return np.concatenate(
        [route.path[0] - steps[::-1] * behind, route.path, route.path[-1] + steps * ahead]
    )


def moving_rectangles(occupancy: Occupancy, step: int, steps: int) -> list[Any]:
    """The sets as obstacles of CommonRoad's collision checker.

    Args:
        occupancy: The sets.
        step: The present step: the sets begin at the one after it.
        steps: Number of steps to look at.

    Returns:
        A ``pycrcc.TimeVariantCollisionObject`` for each stretch of steps at which a road user is
        predicted to be on the scene; where its set is a union, for each of the components.
    """
    occupancy, _, _ = occupancy.by_component()
    sizes = set_sizes(occupancy)
    valid = np.pad(occupancy.valid[:, :steps].astype(np.int8), ((0, 0), (1, 1)))
    edges = np.diff(valid, axis=1)
    return [
        time_variant(
            occupancy.centre[user, first:end],
            occupancy.heading[user, first:end],
            sizes[user, first:end],
            int(step + 1 + first),
        )
        for (user, first), (_, end) in zip(
            np.argwhere(edges > 0), np.argwhere(edges < 0), strict=True
        )
    ]


def time_variant(centre: FloatArray, heading: FloatArray, size: FloatArray, step: int) -> Any:
    """A rectangle that moves, as an object of CommonRoad's collision checker.

    Args:
        centre: (T, 2) m.
        heading: (T,) rad.
        size: (T, 2) length and width, m.
        step: The step of the first pose.

    Returns:
        A ``pycrcc.TimeVariantCollisionObject``.
    """
    found = pycrcc.TimeVariantCollisionObject(step)
    # The binding takes Python's numbers four times as fast as numpy's.
    for row in np.column_stack([0.5 * size, heading, centre]).tolist():
        found.append_obstacle(pycrcc.RectOBB(*row))
    return found


def wall(stop: Stop, step: int, steps: int) -> Any:
    """The wall at a stop, as an object of CommonRoad's collision checker.

    Args:
        stop: The stop.
        step: The present step.
        steps: For how many steps it stands there.

    Returns:
        A ``pycrcc.TimeVariantCollisionObject``.
    """
    n = steps + 1
    return time_variant(
        np.tile(stop.centre, (n, 1)), np.full(n, stop.heading), np.tile(WALL, (n, 1)), step
    )


def swept(moving: Any) -> Any:
    """Rectangles around what a moving one sweeps from each step to the next.

    Args:
        moving: A ``pycrcc.TimeVariantCollisionObject``.

    Returns:
        Another one; the same where it is there for one step only.
    """
    if moving.time_end_idx() == moving.time_start_idx():
        return moving
    hulls, failed = trajectory_preprocess_obb_sum(moving)
    return moving if failed else hulls
