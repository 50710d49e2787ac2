"""The road users in front of and behind the ego, and the speed that fits between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dosplan.geometry import PATH_HEADING, EvenPath
from dosplan.types import (
    EGO_VELOCITY,
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    BoolArray,
    Observation,
)
from dosplan.vehicle import VehicleParameters

_SIDE = 1.7  # m from the ego's offset within which a road user is in its lane
_ALIGNED = 0.7  # cosine of the largest angle to the path
_AHEAD, _BEHIND = 80.0, 40.0  # m
_STANDSTILL_GAP = 2.0  # m
_HEADWAY = 0.8  # s
_PRESSING = 1.5  # s; a follower that is nearer than this presses.
_GAP_GAIN = 0.5  # 1/s, share of the gap's error that is closed in a second


@dataclass(frozen=True)
class Traffic:
    """What drives in the ego's lane.

    Attributes:
        cruise: Speed that is wanted but for a goal, m/s.
        pressed: Whether a follower is close behind.
        followers: (N,) whether a road user of the observation follows the ego in its lane.
    """

    cruise: float
    pressed: bool
    followers: BoolArray


def look_around(
    observation: Observation,
    path: EvenPath,
    vehicle: VehicleParameters,
    position: float,
    offset: float,
    start_velocity: float,
) -> Traffic:
    """Finds leader and follower and the cruising speed.

    Recorded followers do not react: the flow's speed, and at least the speed the ego began with,
    keeps it out of their way. A leader may brake: the speed is bound by
    ``v_leader + gain (gap - (standstill gap + headway v))``.

    Args:
        observation: What is known now.
        path: Reference path.
        vehicle: The ego.
        position: Arc length of the ego's centre, m.
        offset: Its lateral offset, m.
        start_velocity: Velocity at the start of the episode, m/s.

    Returns:
        Cruising speed and followers.
    """
    if len(observation.ids) == 0:
        return Traffic(start_velocity, False, np.zeros(0, dtype=np.bool_))
    now = observation.states[:, -1]
    points = now[:, [USER_X, USER_Y]]
    along, across = path.project(points, path.locate(points), iterations=1)
    aligned = np.cos(now[:, USER_HEADING] - path.at(along)[:, PATH_HEADING]) > _ALIGNED
    lane = aligned & (np.abs(across - offset) < _SIDE)
    distance = along - position
    speed = now[:, USER_VELOCITY]
    behind = lane & (distance < 0.0) & (distance > -_BEHIND)
    front = lane & (distance > 0.0) & (distance < _AHEAD)
    cruise = start_velocity
    pressed = False
    if behind.any():
        follower = int(np.argmax(np.where(behind, distance, -np.inf)))
        cruise = max(cruise, float(speed[follower]))
        gap = -float(distance[follower]) - 0.5 * (observation.size[follower, 0] + vehicle.length)
        pressed = bool(gap < _PRESSING * speed[follower])
    if front.any():
        leader = int(np.argmin(np.where(front, distance, np.inf)))
        cruise = max(cruise, float(speed[leader]))
        gap = float(distance[leader] - 0.5 * (observation.size[leader, 0] + vehicle.length))
        wanted = _STANDSTILL_GAP + _HEADWAY * float(observation.ego[EGO_VELOCITY])
        cruise = min(cruise, max(float(speed[leader]) + _GAP_GAIN * (gap - wanted), 0.0))
    return Traffic(cruise, pressed, behind)
