"""Whether a scenario can be driven at all; where it cannot, no planner is to blame."""

from __future__ import annotations

import numpy as np

from dosplan.scoring.bounds import HAIRLINE, outside
from dosplan.scoring.collision import first_contacts
from dosplan.types import EGO_VELOCITY, GoalState, PlanningTask, RoadMap, Scenario


def unusable(scenario: Scenario) -> str | None:
    """Tells why nobody could drive a scenario.

    It is judged as a drive is: an overlap at the start is a collision, and an outline that is off
    the road is out of bounds, by the tolerances of ``dosplan.scoring.collision`` and
    ``dosplan.scoring.bounds``.

    Args:
        scenario: A scenario that could be read.

    Returns:
        What is wrong and what to do, in a line without the file's name; None where it can be
        driven, as far as anybody knows.
    """
    task = scenario.task
    wrong = _start_overlap(scenario) or _start_off_road(scenario) or _no_goal(task, scenario)
    return None if wrong is None else f"planning problem {scenario.problem_id}: {wrong}"


def _start_overlap(scenario: Scenario) -> str | None:
    task, tracks = scenario.task, scenario.tracks
    start = task.start[None]
    ego = np.column_stack([task.vehicle.poses(start), start[:, EGO_VELOCITY]])
    touched = first_contacts(ego, task.vehicle.size, tracks, task.start_step)
    if not touched:
        return None
    user = touched[0].user
    return (
        f"the ego's start overlaps road user {tracks.ids[user]} ({tracks.kinds[user]}); remove "
        "that road user if it is the ego's own recording, otherwise correct one of the positions"
    )


def _start_off_road(scenario: Scenario) -> str | None:
    task = scenario.task
    pose = task.vehicle.poses(task.start[None])
    if not outside(pose, task.vehicle.size, scenario.road_map)[0]:
        return None
    return "part of the ego is off the road at its start; correct its initial position or the map"


def _no_goal(task: PlanningTask, scenario: Scenario) -> str | None:
    reasons = [_unreachable(goal, task, scenario.road_map) for goal in task.goals]
    if None in reasons:
        return None
    which = "its goal" if len(reasons) == 1 else "none of its goals can be reached: the first"
    return f"{which} {reasons[0]}"


def _unreachable(goal: GoalState, task: PlanningTask, road_map: RoadMap) -> str | None:
    """Why no state of the ego can reach a goal; None where one may."""
    if max(goal.first_step, task.start_step) > goal.last_step:
        return "counts at no step of the episode; correct its <time>"
    if goal.velocity is not None:
        low, high = goal.velocity
        if max(low, 0.0) > min(high, task.vehicle.max_velocity):
            return (
                f"asks for a velocity that the ego cannot have, from 0 to "
                f"{task.vehicle.max_velocity:g} m/s; correct its <velocity>"
            )
    if goal.region is None:
        return None
    # The ego's centre has to be in the region, and no edge of the road nearer to it than half a
    # width. Cracks and overhang that pass as on the road (``outside``) are allowed for.
    width = task.vehicle.width
    west, south, east, north = goal.region.bounds
    around = road_map.road_within(west - width, south - width, east + width, north + width)
    inner = around.buffer(HAIRLINE).buffer(-0.5 * width)
    if inner.intersects(goal.region):
        return None
    return (
        "lies beside the road, or so near its edge that no ego in it would be on the road; correct "
        "its <position>"
    )
