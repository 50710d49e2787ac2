"""Other futures of a recording, for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from shapely.geometry import box

from dosplan.scenario.synthetic import CAR_SIZE, LANE_WIDTH
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    GoalState,
    RoadUserKind,
    Scenario,
    Tracks,
)
from dosplan.vehicle import VehicleParameters
from tests.support.factories import ruled_scenario

BRAKING = 6.0
"""Deceleration of who stops, m/s2."""


def stopped(tracks: Tracks, name: int, start: int) -> Tracks:
    """A future in which a road user brakes to a stop, straight on, after ``start``."""
    row = int(np.flatnonzero(tracks.ids == name)[0])
    states, valid = np.array(tracks.states), np.array(tracks.valid)
    x, y, heading, speed = states[row, start]
    time = 0.1 * np.arange(1, tracks.steps - start)
    time = np.minimum(time, speed / BRAKING)
    way = speed * time - 0.5 * BRAKING * time**2
    states[row, start + 1 :, USER_X] = x + way * np.cos(heading)
    states[row, start + 1 :, USER_Y] = y + way * np.sin(heading)
    states[row, start + 1 :, USER_HEADING] = heading
    states[row, start + 1 :, USER_VELOCITY] = speed - BRAKING * time
    valid[row, start + 1 :] = True
    return replace(tracks, states=states, valid=valid)


def moved_on(tracks: Tracks, name: int, start: int, x: float) -> Tracks:
    """A future in which a road user is a little further along x after ``start``."""
    states = np.array(tracks.states)
    states[tracks.ids == name, start + 1 :, USER_X] += x
    return replace(tracks, states=states)


def without(tracks: Tracks, name: int, start: int) -> Tracks:
    """A future in which a road user has left after ``start``."""
    row = int(np.flatnonzero(tracks.ids == name)[0])
    states, valid = np.array(tracks.states), np.array(tracks.valid)
    states[row, start + 1 :], valid[row, start + 1 :] = np.nan, False
    return replace(tracks, states=states, valid=valid)


def appended(tracks: Tracks, name: int, first: int) -> Tracks:
    """A future in which somebody on foot comes onto the scene at a step, and stays."""
    states = np.full((1, tracks.steps, 4), np.nan)
    states[0, first:] = [40.0, -4.0, 1.5, 0.0]
    return Tracks(
        ids=np.append(tracks.ids, name),
        kinds=(*tracks.kinds, RoadUserKind.PEDESTRIAN),
        size=np.append(tracks.size, [[0.5, 0.5]], axis=0),
        states=np.concatenate([tracks.states, states]),
        valid=np.concatenate([tracks.valid, ~np.isnan(states[..., 0])]),
        outlines=(*tracks.outlines, None),
    )


def goal_at(x: float, last: int) -> GoalState:
    """A goal 12 m long on the ego's lane of the straight road, at any time until a step."""
    half = 0.5 * LANE_WIDTH
    return GoalState(0, last, box(x - 6.0, -half, x + 6.0, half))


def leader_brakes(gap: float) -> Scenario:
    """A leader and a column beside it drive at 12 m/s; the leader brakes hard in future 1 alone.

    Args:
        gap: From the ego's front to the leader's rear, m.
    """
    vehicle = VehicleParameters()
    front = vehicle.rear_to_centre + 0.5 * vehicle.length
    column = [(x, LANE_WIDTH, 0.0, 12.0) for x in np.arange(-12.0, 90.0, 8.0)]
    users = [(front + gap + 0.5 * CAR_SIZE[0], 0.0, 0.0, 12.0), *column]
    scenario = ruled_scenario(users=users, velocity=12.0, goals=[goal_at(62.0, 110)], seconds=11.0)
    return replace(scenario, futures=(stopped(scenario.tracks, 100, 10),))


def steps_out(x: float, at: int = 8) -> Scenario:
    """Somebody stands at the right edge of the lane, and walks across it in future 1 alone.

    A column drives in the lane beside the ego at its speed, 12 m/s.

    Args:
        x: Where, m.
        at: The last step at which the person stands.
    """
    column = [(c, LANE_WIDTH, 0.0, 12.0) for c in np.arange(-12.0, 90.0, 8.0)]
    scenario = ruled_scenario(
        users=[*column, (x, -2.2, np.pi / 2.0, 0.0)],
        kinds=(*[RoadUserKind.CAR] * len(column), RoadUserKind.PEDESTRIAN),
        velocity=12.0,
        goals=[goal_at(62.0, 110)],
        seconds=11.0,
    )
    states = np.array(scenario.tracks.states)
    states[-1, at + 1 :, USER_Y] += 0.25 * np.arange(1, scenario.tracks.steps - at)
    states[-1, at + 1 :, USER_VELOCITY] = 2.5
    return replace(scenario, futures=(replace(scenario.tracks, states=states),))
