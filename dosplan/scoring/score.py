"""Scores an episode: exact geometry, outcome, fault and metrics.

Definitions
-----------
- **Two arms.** Same predictor, same planner and settings, same scenarios, same seed. *With DOS*: a
  road user's centre may be anywhere in its set at step t; `mpc` keeps out of the set, widened by
  the road user's footprint and by the discs that cover the ego. *Without DOS*: the same with
  semi-axes of zero, so the predicted position alone, with its footprint, counts. No `if` in the
  planner: the arms differ in the `Occupancy` they are handed.
- **World** of a run: who else is on the road (`--traffic`), the ego's loop (`--loop`) and how many
  futures of each past are driven (`--futures`). Without these it is recorded traffic that does not
  react, the ideal loop and one future, the recorded one. Rows name it, a run keeps to one, and
  `dosplan compare` says where two runs differ in traffic or loop.
- **Outcome**, one per episode, the first that applies: `collision` (exact overlap of the ego's
  rectangle with a road user's shape at the same step; also swept between steps), `out_of_bounds`
  (part of the ego's rectangle outside the drivable area), `planner_failure` (exception, time-out,
  no plan and no fallback), `goal_missed`, `success`. The denominator is all episodes of the
  run but those that are unusable or in which the traffic failed: one that crashed counts.
  The paper counts success = neither collision nor out-of-bounds: report that as `safe` beside
  `success`. An episode that failed was not driven to its end and is not called safe.
- **Unusable**: what nobody could drive (unreadable, no goal, the start inside a road user or off
  the road, no trajectory). Told before anything is driven, listed by file and reason, outside the
  rates, inside the count. It is no outcome of a planner.
- **Traffic failure**: the traffic raised before anything else had happened. It is a row with its
  reason, outside the rates, inside the count, as what is unusable: no planner is judged by it.
- **Progress**: where a goal is a time alone, standing still is no success: nuPlan's *making
  progress* counts, at least 0.2 of the way that is expected. That is the way at the speed of the
  start until the goal counts, but not past who is ahead of the ego then, nor past a red light. So
  who starts in a queue or before a red light may stand.
- **Goal missed**: at no step is the ego's centre in a goal's region, within its time window, with
  heading and velocity within its intervals. So the ego passes beside it, comes too late, or is in
  it with the wrong heading or speed. Too early is a miss as well: who has driven through the region
  before the window opens has not reached the goal. `dosplan explain` tells which, and by how much.
- **Road**: the drivable area is the union of the lanelets that are carriageway by their type and
  users: sidewalks, bicycle lanes and crossings that are nothing else are not, nor is a lanelet
  whose users are all on foot, on bicycles or on rails; bus lanes are, though no route leads along
  them. Gaps between lanelets of up to 0.2 m, less than a tyre's width, are closed. An open end of
  the map is no edge of the road: 5 m beyond it count as road. This is the road of the ego, a car,
  which alone is judged: other road users are where they were recorded, on whatever lanelet.
  CommonRoad's checker counts every lanelet as road, an open end as an edge, and the gaps.
  `off_commonroad_road` counts the episodes that leave the road so defined, but for the gaps, which
  are closed there too.
- **Fault** of a collision: nuPlan's classes; and where road users react, the ego is also to blame
  for being struck from behind if its entry into the follower's way asked more than 5 m/s2 of the
  follower. Report collision rate and at-fault collision rate.
- **Velocity**: mean ego speed over the steps driven, m/s, averaged over episodes. Progress,
  comfort, time-to-collision, cycle time p50/p99 beside it.
- **CR_t** share of road users whose true centre at horizon t lies inside the set; **OSA_t** mean
  area, m2, pi/4 · l · w with l, w the full axes, and of a union of ellipses what they cover
  together; at 1, 2, 3, 4 s; masked where the recording ends.
  Beside them `OSA@90`: area when each method's sets are scaled by one factor per horizon to cover
  exactly 90 % on other recordings (`--scale-on`), or else on those that are evaluated: the fair
  comparison. ADE and FDE are of the most likely
  component; `min_ade` and `min_fde` of the best one.
- Scoring never uses the planner's own ellipses or discs; the planner never sees what scoring uses.

The drive that is scored
------------------------
A simulation does not stop at a collision, a car does. The drive begins at the first state and ends
at the first contact, at the first state that reaches a goal, or at the last state, whichever comes
first; every metric is over that drive alone, and so are cycle times and fallbacks: a cycle counts
where a step of the drive follows it. Whether a goal was reached is found out from the states. A
planner failure counts where the drive lasts until it; a goal at the very step of a contact is
noted, but the outcome is `collision`. If the ego left the road before it collided, the outcome is
`collision` and `out_of_bounds_step` is filled as well.

Several road users may be touched for the first time on the way to the same step. The collision
that is reported is the earliest of those in which the ego is at fault, or the earliest of all where
it is at fault in none.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import ReferencePath, wrap_angle
from dosplan.geometry.goal import goal_reached
from dosplan.scoring.bounds import outside
from dosplan.scoring.collision import Contact, first_contacts, overlap_window
from dosplan.scoring.comfort import comfort
from dosplan.scoring.fault import BEHIND_ANGLE, STOPPED_VELOCITY, STRUCK, at_fault, classify
from dosplan.scoring.imposed import CUT_IN_BRAKING, cut_in_demand
from dosplan.scoring.metrics import failed_measures, measured, measured_kinds
from dosplan.scoring.part import ScoredPart, scored_cycles, signals_of
from dosplan.scoring.progress import is_time_alone, makes_progress, needed_progress
from dosplan.types import (
    EGO_HEADING,
    EGO_VELOCITY,
    USER_HEADING,
    USER_VELOCITY,
    CollisionClass,
    DrivenEpisode,
    Episode,
    EpisodeEnd,
    EpisodeKey,
    FloatArray,
    IntArray,
    Outcome,
    PlanningTask,
    Route,
    Scenario,
    Score,
    Tracks,
)
from dosplan.vehicle import VehicleParameters

_FAILURES: Final = (Outcome.PLANNER_FAILURE, Outcome.TRAFFIC_FAILURE)

COLLISION_HORIZON: Final = 3.0
"""How far ahead a collision under constant velocities is looked for, s (nuPlan's)."""


def score(scenario: Scenario, episode: Episode) -> Score:
    """Scores one episode.

    Args:
        scenario: The scenario that was driven.
        episode: What happened.

    Returns:
        The episode's row.
    """
    return score_driven(scenario, episode, episode.tracks)


def score_driven(scenario: Scenario, episode: DrivenEpisode, tracks: Tracks) -> Score:
    """Scores what is known of an episode, from its file for instance.

    Args:
        scenario: The scenario that was driven.
        episode: What the ego did, and the planner's reports.
        tracks: The road users as they were driven.

    Returns:
        The episode's row.
    """
    task, vehicle = scenario.task, scenario.task.vehicle
    states, start = episode.states, episode.start_step
    goal_step = _goal_step(task, states, start)
    if goal_step is not None:
        states = states[: goal_step - start + 1]
    ego = np.column_stack([vehicle.poses(states), states[:, EGO_VELOCITY]])

    touched = first_contacts(ego, vehicle.size, tracks, start)
    classes = [classify(contact, tracks, vehicle) for contact in touched]
    faults = [
        at_fault(contact, kind, scenario.road_map, vehicle)
        or (kind in STRUCK and _cuts_in(contact, scenario, tracks, ego, start))
        for contact, kind in zip(touched, classes, strict=True)
    ]
    collision_class: CollisionClass | None = None
    collision_with = collision_step = None
    if touched:
        # In the order of contact: the first at fault, or the first of all where none is.
        reported = next((i for i, fault in enumerate(faults) if fault), 0)
        collision_class = classes[reported]
        collision_with = int(tracks.ids[touched[reported].user])
        collision_step = touched[reported].step
        states, ego = states[: collision_step - start + 1], ego[: collision_step - start + 1]
    driven = len(states) - 1
    if goal_step is not None and goal_step > start + driven:
        goal_step = None

    progress = _progress(task.route, ego)
    signals = signals_of(scenario, episode)
    needed = needed_progress(scenario, tracks, signals)
    waited = goal_step is not None and _needs_no_drive(task, states[-1], goal_step)
    if goal_step is not None and not waited:
        needed = min(needed, max(progress, 0.0))  # The ego is there: all that was to be driven.
    off_road = np.flatnonzero(outside(ego[:, :3], vehicle.size, scenario.road_map))
    out_of_bounds_step = start + int(off_road[0]) if off_road.size else None

    if collision_step is not None:
        outcome = Outcome.COLLISION
    elif out_of_bounds_step is not None:
        outcome = Outcome.OUT_OF_BOUNDS
    elif goal_step is not None and (not waited or makes_progress(progress, needed)):
        outcome = Outcome.SUCCESS
    elif episode.end is EpisodeEnd.PLANNER_FAILURE:
        outcome = Outcome.PLANNER_FAILURE
    elif episode.end is EpisodeEnd.TRAFFIC_FAILURE:
        outcome = Outcome.TRAFFIC_FAILURE
    else:
        outcome = Outcome.GOAL_MISSED

    ride = comfort(states, scenario.dt)
    cycles = scored_cycles(episode.cycle_steps, start, driven)
    part = ScoredPart(
        scenario=scenario,
        start_step=start,
        ego=ego,
        signals=signals,
        episode=episode,
        tracks=tracks,
        states=states,
        cycles=cycles,
        outcome=outcome,
        touched=tuple(contact.user for contact in touched),
        at_fault_with=tuple(
            contact.user for contact, fault in zip(touched, faults, strict=True) if fault
        ),
        ride=ride,
        progress=progress,
        needed_progress=needed,
    )
    median, slowest = _cycle_times(episode, cycles)
    return Score(
        scenario=episode.scenario_id,
        arm=episode.arm,
        outcome=outcome,
        safe=outcome in (Outcome.GOAL_MISSED, Outcome.SUCCESS),
        at_fault=any(faults),
        collision_class=collision_class,
        collision_with=collision_with,
        collision_step=collision_step,
        out_of_bounds_step=out_of_bounds_step,
        goal_step=goal_step,
        velocity=_mean_velocity(states),
        progress=progress,
        steps=driven,
        comfortable=ride.comfortable,
        max_abs_acceleration=ride.acceleration,
        max_abs_lateral_acceleration=ride.lateral_acceleration,
        max_abs_jerk=ride.jerk,
        min_time_to_collision=min_time_to_collision(ego, vehicle, tracks, start),
        cycle_ms_p50=median,
        cycle_ms_p99=slowest,
        fallback_cycles=sum(report.fallback is not None for report in part.reports),
        error=episode.error if outcome in _FAILURES else None,
        traffic=episode.traffic,
        future=episode.future,
        loop=episode.loop,
        measures=measured(part),
    )


def failed_score(key: EpisodeKey, error: str, outcome: Outcome = Outcome.PLANNER_FAILURE) -> Score:
    """The row of an episode that was not driven, for instance as its worker crashed.

    Args:
        key: The episode.
        error: What went wrong.
        outcome: A failure, of the planner or of the traffic, or ``UNUSABLE``.

    Returns:
        A row without a step; where its outcome is not the planner's, it takes part in no figure.
    """
    measures = failed_measures() if outcome.of_planner else dict.fromkeys(measured_kinds())
    return Score(**key._asdict(), outcome=outcome, error=error, measures=measures)


def min_time_to_collision(
    ego: FloatArray, vehicle: VehicleParameters, tracks: Tracks, start_step: int
) -> float | None:
    """Smallest time to a collision if all keep velocity and heading from a step on.

    As in nuPlan, a standing ego has no collision, and road users behind it (the rule of a
    rear collision) are left out. Shapes are the rectangles of ``Tracks.size``; the time
    is exact for them.

    Args:
        ego: (K + 1, 4) x, y, heading, velocity of the ego's centre at consecutive steps.
        vehicle: The ego's parameters.
        tracks: The road users as they were driven.
        start_step: Step of ``ego[0]``.

    Returns:
        s, over all steps, 0 where they overlap; None where it is nowhere below
        ``COLLISION_HORIZON``.
    """
    present = tracks.valid[:, start_step : start_step + len(ego)]
    users = tracks.states[:, start_step : start_step + len(ego)]
    ego = np.broadcast_to(ego[: users.shape[1]], users.shape)
    velocity = _velocity(users) - _velocity(ego)
    heading = ego[..., USER_HEADING]
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    to_user = users[..., :2] - (ego[..., :2] - vehicle.rear_to_centre * forward)
    angle = wrap_angle(np.arctan2(to_user[..., 1], to_user[..., 0]) - heading)
    relevant = present & (np.abs(angle) <= BEHIND_ANGLE)
    relevant &= np.abs(ego[..., USER_VELOCITY]) > STOPPED_VELOCITY
    sizes = np.broadcast_to(tracks.size[:, None], (*users.shape[:2], 2))
    times, _ = overlap_window(
        ego[relevant, :3],
        np.asarray(vehicle.size, dtype=np.float64),
        users[relevant, :3],
        sizes[relevant],
        velocity[relevant],
    )
    smallest = float(times.min(initial=np.inf))
    return smallest if smallest < COLLISION_HORIZON else None


def _cuts_in(
    contact: Contact, scenario: Scenario, tracks: Tracks, ego: FloatArray, start: int
) -> bool:
    """Whether a follower that reacts could not help running into an ego that came in its way."""
    if scenario.is_recorded(tracks):  # Nobody reacts: a recording runs into the ego in any case.
        return False
    demand = cut_in_demand(contact, tracks, ego, scenario.task.vehicle, start, scenario.dt)
    return demand is not None and demand > CUT_IN_BRAKING


def _needs_no_drive(task: PlanningTask, state: FloatArray, step: int) -> bool:
    """Whether the goals that hold at a state are times alone, so that a standing ego has them."""
    centre = task.vehicle.centre(state)
    heading, velocity = float(state[EGO_HEADING]), float(state[EGO_VELOCITY])
    held = (goal for goal in task.goals if goal_reached((goal,), step, centre, heading, velocity))
    return all(is_time_alone(goal) for goal in held)


def _goal_step(task: PlanningTask, states: FloatArray, start: int) -> int | None:
    centres = task.vehicle.centre(states)
    for step, (state, centre) in enumerate(zip(states, centres, strict=True), start):
        heading, velocity = float(state[EGO_HEADING]), float(state[EGO_VELOCITY])
        if goal_reached(task.goals, step, centre, heading, velocity):
            return step
    return None


def _velocity(states: FloatArray) -> FloatArray:
    heading, speed = states[..., USER_HEADING, None], states[..., USER_VELOCITY, None]
    return np.concatenate([speed * np.cos(heading), speed * np.sin(heading)], axis=-1)


def _mean_velocity(states: FloatArray) -> float:
    """Mean over the steps of the mean speed within each, exact for a held acceleration."""
    speed = np.abs(states[:, EGO_VELOCITY])
    return float(np.mean(0.5 * (speed[1:] + speed[:-1]))) if len(speed) > 1 else 0.0


def _progress(route: Route, ego: FloatArray) -> float:
    along = ReferencePath.of(route).follow(ego[:, :2])
    return float(along[-1] - along[0])


def _cycle_times(episode: DrivenEpisode, cycles: IntArray) -> tuple[float | None, float | None]:
    """Median and 99th percentile of the time of some full cycles, ms; None without a cycle."""
    if not cycles.size:
        return None, None
    times = 1e3 * (episode.predict_seconds + episode.plan_seconds)[cycles]
    median, slowest = np.percentile(times, [50.0, 99.0])
    return float(median), float(slowest)
