"""nuPlan's closed-loop score of an episode, from nuPlan's own metrics.

Source: nuplan-devkit, ``closed_loop_nonreactive_agents_weighted_average`` (the reactive one has the
same weights), ``docs/metrics_description.md`` and the metrics that they name. The score is ::

    no_ego_at_fault_collisions * drivable_area_compliance * driving_direction_compliance
    * ego_is_making_progress * (5 ego_progress_along_expert_route
    + 5 time_to_collision_within_bound + 4 speed_limit_compliance + 2 ego_is_comfortable) / 16

What differs from nuPlan, as the scenarios do:

- There is no expert: progress is compared with what is expected (``dosplan.scoring.progress``).
- A drive ends at the first contact, at the goal, or at the end of the scenario; nuPlan drives on
  after a contact, for as long as the scenario lasts. A planner that fails has no score there and
  zero here.
- Contacts are found between steps, too, comfort is smoothed by a filter of 7 instead of 8 samples
  (``dosplan.scoring.comfort``), and a step on which the ego changes the lane counts for its
  direction (``dosplan.scoring.rules.wrong_way``).
- Who is struck from behind by traffic that reacts may be to blame for cutting in
  (`dosplan.scoring.fault`).
- In several lanes is who stands in lanelets that do not follow each other; an intersection is what
  lies in a lanelet that the file names as inside one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import rectangle_corners, wrap_angle
from dosplan.scoring.bounds import outside
from dosplan.scoring.collision import overlap_window
from dosplan.scoring.fault import BEHIND_ANGLE, in_several_lanes
from dosplan.scoring.part import ScoredPart
from dosplan.scoring.progress import makes_progress, progress_ratio
from dosplan.scoring.rules import excess_speed, wrong_way
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    Outcome,
    RoadUserKind,
)

MAX_OVERSPEED: Final = 2.23
"""Excess of the speed limit, m/s, that for a whole drive makes its compliance zero."""

MAX_OUTSIDE: Final = 0.3
"""Distance of a corner from the drivable area from which on the ego leaves it, m."""

MAX_WRONG_WAY: Final = 2.0
"""Distance against the lane's direction in a second from which on half the score is lost, m."""

NO_WRONG_WAY: Final = 6.0
"""The same from which on all of it is lost, m."""

LEAST_TIME_TO_COLLISION: Final = 0.95
"""Smallest time to collision that must be exceeded, s."""

TIME_STEP: Final = 0.1
"""Times to collision are multiples of this, s."""

AHEAD_ANGLE: Final = np.deg2rad(30.0)
"""Angle to the ego's heading, at its rear axle, below which a road user is ahead, rad."""

STOPPED: Final = 5e-3
"""Speed up to which the ego has no time to collision, m/s."""

_OBJECTS: Final = (RoadUserKind.STATIC,)


@dataclass(frozen=True)
class NuplanScore:
    """The parts of the score, by nuPlan's names, each from 0 to 1.

    Attributes:
        no_ego_at_fault_collisions: 0 where the ego is to blame for a collision with a person or a
            vehicle, 0.5 for one with an object, otherwise 1.
        drivable_area_compliance: 0 or 1.
        driving_direction_compliance: 0, 0.5 or 1.
        ego_is_making_progress: 0 or 1.
        ego_progress_along_expert_route: Share of the expected progress.
        time_to_collision_within_bound: 0 or 1.
        speed_limit_compliance: By duration and size of the excess.
        ego_is_comfortable: 0 or 1.
    """

    no_ego_at_fault_collisions: float
    drivable_area_compliance: float
    driving_direction_compliance: float
    ego_is_making_progress: float
    ego_progress_along_expert_route: float
    time_to_collision_within_bound: float
    speed_limit_compliance: float
    ego_is_comfortable: float

    @property
    def total(self) -> float:
        """The score: multipliers times the weighted mean."""
        multiplier = (
            self.no_ego_at_fault_collisions
            * self.drivable_area_compliance
            * self.driving_direction_compliance
            * self.ego_is_making_progress
        )
        mean = (
            5.0 * self.ego_progress_along_expert_route
            + 5.0 * self.time_to_collision_within_bound
            + 4.0 * self.speed_limit_compliance
            + 2.0 * self.ego_is_comfortable
        ) / 16.0
        return multiplier * mean


def nuplan_score(part: ScoredPart) -> float | None:
    """The closed-loop score of nuPlan.

    Args:
        part: What is scored.

    Returns:
        0 to 1; zero where the planner failed; None where no step was driven otherwise.
    """
    if part.outcome is Outcome.PLANNER_FAILURE:
        return 0.0
    return nuplan_parts(part).total if part.drove else None


def nuplan_parts(part: ScoredPart) -> NuplanScore:
    """The metrics of nuPlan of a drive.

    Args:
        part: What is scored; it has a step.

    Returns:
        The metrics that make the score.
    """
    return NuplanScore(
        no_ego_at_fault_collisions=_no_fault(part),
        drivable_area_compliance=float(not _leaves_area(part)),
        driving_direction_compliance=direction_compliance(part) or 0.0,
        ego_is_making_progress=float(makes_progress(part.progress, part.needed_progress)),
        ego_progress_along_expert_route=progress_ratio(part.progress, part.needed_progress),
        time_to_collision_within_bound=float(not _comes_too_close(part)),
        speed_limit_compliance=1.0 if (kept := speed_compliance(part)) is None else kept,
        ego_is_comfortable=float(part.ride.comfortable),
    )


def direction_compliance(part: ScoredPart) -> float | None:
    """The ``driving_direction_compliance`` of nuPlan.

    Args:
        part: What is scored.

    Returns:
        1 below ``MAX_WRONG_WAY`` metres against the lane's direction in a second, 0.5 below
        ``NO_WRONG_WAY``, otherwise 0; None where no step was driven.
    """
    way = wrong_way(part)
    if way is None:
        return None
    return 1.0 if way < MAX_WRONG_WAY else 0.5 if way < NO_WRONG_WAY else 0.0


def speed_compliance(part: ScoredPart) -> float | None:
    """The ``speed_limit_compliance`` of nuPlan.

    ``max(0, 1 - sum(excess) dt / (2.23 m/s * duration))``, over all states.

    Args:
        part: What is scored.

    Returns:
        0 to 1; None where no limit is known.
    """
    excess = excess_speed(part)
    if excess is None:
        return None
    return float(max(0.0, 1.0 - excess.sum() / (MAX_OVERSPEED * (len(excess) - 1))))


def _no_fault(part: ScoredPart) -> float:
    objects = [part.tracks.kinds[row] in _OBJECTS for row in part.at_fault_with]
    if not all(objects):
        return 0.0
    return max(0.0, 1.0 - 0.5 * len(objects))


def _leaves_area(part: ScoredPart) -> bool:
    """Whether a corner is ``MAX_OUTSIDE`` or more beside the drivable area at a step."""
    corners = rectangle_corners(part.ego[:, :3], part.scenario.task.vehicle.size)
    points = shapely.points(corners.reshape(-1, 2))
    road_map = part.scenario.road_map
    shapely.prepare(road_map.drivable)
    points = points[~shapely.intersects(road_map.drivable, points)]
    if not points.size:
        return False
    west, south, east, north = shapely.total_bounds(points)
    reach = MAX_OUTSIDE + 0.1  # What is farther away is too far, whatever it is.
    around = road_map.road_within(west - reach, south - reach, east + reach, north + reach)
    return around.is_empty or bool(np.any(shapely.distance(around, points) >= MAX_OUTSIDE))


def _comes_too_close(part: ScoredPart) -> bool:
    """Whether the time to collision is within the bound at a step.

    Rectangles are moved on at constant velocity in steps of ``TIME_STEP``. Those ahead count; those
    beside the ego count where it is in several lanes, off the road or in an intersection. Who
    touches the ego counts no more from that step on, but a collision that the ego is to blame for
    is a time of zero.
    """
    if part.at_fault_with:
        return True
    vehicle, first, tracks = part.scenario.task.vehicle, part.episode.start_step, part.tracks
    users = np.swapaxes(tracks.states[:, first : first + len(part.ego)], 0, 1)
    present = tracks.valid[:, first : first + len(part.ego)].T.copy()
    ego = part.ego[: len(users)]
    if len(part.ego) == len(users) and part.touched:
        present[-1, list(part.touched)] = False
    present &= (np.abs(ego[:, USER_VELOCITY]) > STOPPED)[:, None]
    heading = ego[:, USER_HEADING]
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    to_user = users[..., :2] - (ego[:, :2] - vehicle.rear_to_centre * forward)[:, None]
    angle = np.abs(wrap_angle(np.arctan2(to_user[..., 1], to_user[..., 0]) - heading[:, None]))
    step, user = np.nonzero(present & (angle <= BEHIND_ANGLE))
    meets = _meets_soon(ego[step], np.array(vehicle.size), users[step, user], tracks.size[user])
    step, user = step[meets], user[meets]
    ahead = angle[step, user] < AHEAD_ANGLE
    if ahead.any():
        return True
    road_map = part.scenario.road_map
    inside = {name for x in road_map.intersections for name in x.inside}
    lanelets = part.lanes.lanelets
    return any(
        (part.lanes.at[k] >= 0 and lanelets[part.lanes.at[k]].id in inside)
        or in_several_lanes(ego[k, :3], vehicle.size, road_map)
        or outside(ego[k : k + 1, :3], vehicle.size, road_map)[0]
        for k in np.unique(step)
    )


def _meets_soon(
    ego: FloatArray, size: FloatArray, users: FloatArray, sizes: FloatArray
) -> BoolArray:
    """Whether rectangles overlap at one of the times to collision that are too small.

    Args:
        ego: (M, 4) x, y, heading, velocity.
        size: (2,) length and width, m.
        users: (M, 4) the same of the road users.
        sizes: (M, 2) the same.

    Returns:
        (M,) whether they do.
    """
    speeds = [
        row[:, USER_VELOCITY, None]
        * np.stack([np.cos(row[:, USER_HEADING]), np.sin(row[:, USER_HEADING])], axis=-1)
        for row in (ego, users)
    ]
    begin, end = overlap_window(ego[:, :3], size, users[:, :3], sizes, speeds[1] - speeds[0])
    # overlap_window cuts the begin off at zero; times to collision begin at a first step.
    last = np.floor(LEAST_TIME_TO_COLLISION / TIME_STEP + 1e-9) * TIME_STEP
    found = np.isfinite(begin)
    hit = np.zeros(len(begin), dtype=np.bool_)
    time = np.maximum(np.ceil(begin[found] / TIME_STEP - 1e-9), 1.0) * TIME_STEP
    hit[found] = (time <= end[found]) & (time <= last + 1e-9)
    return hit
