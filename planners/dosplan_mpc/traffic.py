"""The road users in front of and behind the ego, and the speed that fits between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dosplan.geometry import PATH_HEADING, EvenPath
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    BoolArray,
    IntArray,
    Observation,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import TrafficSettings
from dosplan_mpc.reference import EgoOnPath


@dataclass(frozen=True)
class Traffic:
    """What drives in the ego's lane.

    Attributes:
        cruise: Speed that is wanted without a goal, m/s.
        pressed: Whether a follower is close behind.
        followers: (N,) whether a road user of the observation follows the ego in its lane.
    """

    cruise: float
    pressed: bool
    followers: BoolArray


@dataclass(frozen=True)
class Lane:
    """The ego's lane during an episode.

    Attributes:
        settings: Who counts as leader and follower, and which gaps are kept.
        path: Reference path.
        vehicle: The ego.
        start_velocity: Velocity at the start of the episode, m/s.
    """

    settings: TrafficSettings
    path: EvenPath
    vehicle: VehicleParameters
    start_velocity: float

    def look_around(self, observation: Observation, ego: EgoOnPath, passed: IntArray) -> Traffic:
        """Finds leader and follower and the cruising speed.

        Recorded followers do not react. To keep out of their way, the ego drives at the traffic's
        speed, and at least at the speed it began with. A leader may brake: the speed is bound by
        ``v_leader + gain (gap - (standstill gap + headway v))``.

        Args:
            observation: What is known now.
            ego: Where the ego is.
            passed: Rows of those that the ego goes round; they are no leaders.

        Returns:
            Cruising speed and followers.
        """
        settings, cruise, pressed = self.settings, self.start_velocity, False
        if len(observation.ids) == 0:
            return Traffic(cruise, pressed, np.zeros(0, dtype=np.bool_))
        now = observation.present
        points = now[:, [USER_X, USER_Y]]
        along, across = self.path.project(
            points, self.path.locate(points, ego.position), iterations=1
        )
        turn = now[:, USER_HEADING] - self.path.at(along)[:, PATH_HEADING]
        lane = np.cos(turn) > settings.alignment
        lane &= np.abs(across - ego.offset) < settings.side
        distance = along - ego.position
        speed = now[:, USER_VELOCITY]
        # Between bumpers.
        gap = np.abs(distance) - 0.5 * (observation.size[:, 0] + self.vehicle.length)
        behind = lane & (distance < 0.0) & (distance > -settings.behind)
        front = lane & (distance > 0.0) & (distance < settings.ahead)
        front[passed] = False
        if behind.any():
            follower = int(np.argmax(np.where(behind, distance, -np.inf)))
            cruise = max(cruise, float(speed[follower]))
            pressed = bool(gap[follower] < settings.pressing * speed[follower])
        if front.any():
            leader = int(np.argmin(np.where(front, distance, np.inf)))
            cruise = max(cruise, float(speed[leader]))
            wanted = settings.standstill_gap + settings.headway * ego.velocity
            closing = settings.gap_gain * (float(gap[leader]) - wanted)
            cruise = min(cruise, max(float(speed[leader]) + closing, 0.0))
        return Traffic(cruise, pressed, behind)
