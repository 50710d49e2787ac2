"""``idm-v1``: the Intelligent Driver Model along the route.

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62, 2000; the free-road term and the figures are those of Treiber,
Kesting, "Traffic Flow Dynamics", 2013, sec. 11.3.7 and table 11.2 (city traffic).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from dosplan.api import Planner
from dosplan.geometry import ReferencePath, rectangle_corners, set_sizes
from dosplan.types import (
    EGO_VELOCITY,
    FloatArray,
    GoalState,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
)
from dosplan.vehicle import VehicleParameters
from dosplan_baseline.tracking import bend_speed, extended_path, roll_out

TIME_GAP = 1.0  # s
LEAST_GAP = 2.0  # m
ACCELERATION = 1.0  # m/s2
DECELERATION = 1.5  # m/s2, comfortable
EXPONENT = 4.0

FULL_BRAKING = 8.0  # m/s2
LATERAL_ACCELERATION = 3.0  # m/s2 in bends
LEAST_VELOCITY = 1.0  # m/s; below this wish a vehicle would never arrive anywhere.
SIDE_MARGIN = 0.2  # m on either side of the ego's corridor
GOAL_MARGIN = 2.0  # m inside either end of the goal's region
LOOK_AHEAD = 10  # Predicted steps that are searched for a leader: the time gap.


@dataclass(frozen=True)
class Leaders:
    """Road users in the way, as they would be at the present if their speed along the path held.

    Attributes:
        rear: (L,) arc length of their nearest point, m.
        velocity: (L,) velocity along the path, m/s, not negative.
    """

    rear: FloatArray
    velocity: FloatArray


def idm_acceleration(
    velocity: float, wish: float, gap: FloatArray, leader_velocity: FloatArray
) -> float:
    """Acceleration of the model, for the leader that asks for the hardest braking.

    Args:
        velocity: Own velocity, m/s.
        wish: Desired velocity, m/s, positive.
        gap: (L,) bumper-to-bumper gaps, m; L may be 0.
        leader_velocity: (L,) m/s.

    Returns:
        m/s2, at least ``-FULL_BRAKING``.
    """
    if velocity <= wish:
        free = ACCELERATION * (1.0 - (velocity / wish) ** EXPONENT)
    else:
        power = ACCELERATION * EXPONENT / DECELERATION
        free = -DECELERATION * (1.0 - (wish / velocity) ** power)
    closing = velocity * (velocity - leader_velocity)
    dynamic = velocity * TIME_GAP + closing / (2.0 * np.sqrt(ACCELERATION * DECELERATION))
    ratio = (LEAST_GAP + np.maximum(dynamic, 0.0)) / np.maximum(gap, 0.1)
    return float(max(free - ACCELERATION * np.max(ratio**2, initial=0.0), -FULL_BRAKING))


def find_leaders(
    path: ReferencePath,
    observation: Observation,
    occupancy: Occupancy,
    vehicle: VehicleParameters,
) -> Leaders:
    """Road users whose set, with their footprint, enters the ego's corridor within a time gap.

    A set is searched at each of the next steps. What it blocks is moved back to the present by
    the way its road user makes along the path until then, so that a steady leader has the same
    gap at every step, and one that cuts in is seen before it is there.

    Args:
        path: The ego's path.
        observation: What is known now.
        occupancy: The sets of the road users of ``observation``.
        vehicle: The ego.

    Returns:
        Every road user and step that blocks the corridor ahead of the ego.
    """
    steps = min(LOOK_AHEAD, occupancy.horizon)
    valid = occupancy.valid[:, :steps]
    corners = set_corners(occupancy, steps)
    s = path.locate(corners)
    lateral = path.offset(corners, s)
    side = 0.5 * vehicle.width + SIDE_MARGIN
    blocks = valid & (lateral.min(axis=-1) < side) & (lateral.max(axis=-1) > -side)

    now = path.locate(observation.states[:, -1, :2])
    then = path.locate(corners.mean(axis=-2))
    way = then - now[:, None]
    time = observation.dt * np.arange(1, steps + 1)
    ego = path.locate(vehicle.centre(observation.ego))
    chosen = blocks & (now > ego)[:, None]
    return Leaders(rear=(s.min(axis=-1) - way)[chosen], velocity=(way / time)[chosen])


def set_corners(occupancy: Occupancy, steps: int) -> FloatArray:
    """Corners of the rectangles of ``geometry.set_sizes``.

    Args:
        occupancy: The sets of N road users.
        steps: Number S of steps.

    Returns:
        (N, S, 4, 2) corners, m; around the origin where the occupancy is not valid.
    """
    poses = np.concatenate(
        [occupancy.centre[:, :steps], occupancy.heading[:, :steps, None]], axis=-1
    )
    poses = np.where(occupancy.valid[:, :steps, None], poses, 0.0)
    return rectangle_corners(poses, set_sizes(occupancy, steps))


class IdmPlanner(Planner):
    """Follows the route, the goal's deadline and the leader."""

    name = "idm-v1"

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Prepares the path, the speed its bends allow and the way to each goal.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """
        self._vehicle = vehicle
        self._path = extended_path(task.route)
        self._bends = bend_speed(self._path, LATERAL_ACCELERATION, DECELERATION)
        self._start_velocity = float(task.start[EGO_VELOCITY])
        self._goals = [(goal, _extent(goal, self._path)) for goal in task.goals]

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Rolls the model out behind leaders that keep their speed.

        Args:
            observation: What is known now.
            occupancy: What the leaders are found in.

        Returns:
            The plan.
        """
        leaders = find_leaders(self._path, observation, occupancy, self._vehicle)
        wish = self._wish(observation)
        front = self._vehicle.rear_to_centre + 0.5 * self._vehicle.length

        def acceleration(step: int, s: float, velocity: float) -> float:
            allowed = max(min(wish, float(np.interp(s, *self._bends))), LEAST_VELOCITY)
            gap = leaders.rear + leaders.velocity * step * observation.dt - (s + front)
            return idm_acceleration(velocity, allowed, gap, leaders.velocity)

        return roll_out(self._path, observation.ego, acceleration, self._vehicle, observation.dt)

    def _wish(self, observation: Observation) -> float:
        """The speed of the start, changed as little as the goal's place, time and speed ask."""
        now = observation.step
        goal, (near, far) = next(
            (pair for pair in self._goals if pair[0].last_step > now), self._goals[-1]
        )
        window = max(goal.first_step, now + 1), max(goal.last_step, now + 1)
        time = (0.5 * sum(window) - now) * observation.dt
        s = float(self._path.locate(self._vehicle.centre(observation.ego)))
        wish = float(np.clip(self._start_velocity, (near - s) / time, (far - s) / time))
        return float(np.clip(wish, *(goal.velocity or (0.0, np.inf))))


def _extent(goal: GoalState, path: ReferencePath) -> tuple[float, float]:
    """First and last arc length of a goal's region, a little inside; infinite without one."""
    if goal.region is None:
        return -np.inf, np.inf
    s = path.locate(shapely.get_coordinates(goal.region))
    margin = min(GOAL_MARGIN, 0.25 * float(np.ptp(s)))
    return float(s.min()) + margin, float(s.max()) - margin
