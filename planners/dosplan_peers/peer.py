"""What all peers, the third-party planners, share: a trajectory is found and becomes a plan.

Peers plan in a Frenet frame along the path. As in their own scripts, a cycle begins with the state
in that frame that the last trajectory has for this step: to project the ego at every step would add
the errors of their projection in bends. Only where the ego is elsewhere is it projected. Its
acceleration is then that of the last trajectory, since an ego state of dosplan holds none; the
first is zero, as with the peers.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.api import Planner
from dosplan.types import (
    EGO_STEERING,
    EGO_VELOCITY,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    SolveReport,
)
from dosplan.vehicle import VehicleParameters

ON_PLAN: Final = 0.01  # m; how far the ego may be from its last trajectory.


@dataclass(frozen=True)
class Trajectory:
    """A trajectory that a peer found.

    Attributes:
        steering: (T + 1,) steering angle at the present step and the T after it, rad.
        velocity: (T + 1,) m/s.
        acceleration: (T + 1,) m/s2.
        position: (T + 1, 2) of the rear axle, m.
        frenet: (T + 1, 6) position, velocity and acceleration along the path, then across it, as
            the peer counts them.
        fallback: Name of what it fell back to, or None.
    """

    steering: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    position: FloatArray
    frenet: FloatArray
    fallback: str | None = None


class Peer(Planner):
    """A third-party planner."""

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Forgets the last trajectory and prepares the peer."""
        self._vehicle = vehicle
        self._last: Trajectory | None = None
        self._last_step = task.start_step
        self.build(task, road_map, vehicle)

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Has the peer find a trajectory and turns it into inputs of the vehicle model.

        Args:
            observation: What is known now.
            occupancy: What the peer gets as its obstacles.

        Returns:
            The plan.

        Raises:
            NoPlanError: The peer found none.
        """
        acceleration, frenet = 0.0, None
        if self._last is not None:
            now = min(observation.step - self._last_step, len(self._last.acceleration) - 1)
            acceleration = float(self._last.acceleration[now])
            if np.hypot(*(self._last.position[now] - observation.ego[:2])) < ON_PLAN:
                frenet = self._last.frenet[now]
        found = self.find(observation, occupancy, acceleration, frenet)
        self._last, self._last_step = found, observation.step
        return follow(observation.ego, found, self._vehicle, observation.dt)

    @abstractmethod
    def build(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Prepares the peer for an episode.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """

    @abstractmethod
    def find(
        self,
        observation: Observation,
        occupancy: Occupancy,
        acceleration: float,
        frenet: FloatArray | None,
    ) -> Trajectory:
        """Searches a trajectory.

        Args:
            observation: What is known now.
            occupancy: The sets to keep out of.
            acceleration: The ego's acceleration now, m/s2.
            frenet: (6,) the ego's state in the Frenet frame by the last trajectory, see
                ``Trajectory``, or None where it has to be projected.

        Returns:
            The trajectory.

        Raises:
            NoPlanError: There is none.
        """


def follow(ego: FloatArray, found: Trajectory, vehicle: VehicleParameters, dt: float) -> Plan:
    """A plan whose steering angles and velocities are those of a trajectory.

    Args:
        ego: (5,) ego state now.
        found: The trajectory.
        vehicle: The ego.
        dt: Step, s.

    Returns:
        The plan; where the actuators cannot follow, its inputs are the nearest that they can
        deliver.
    """
    states, inputs = [ego], []
    for steering, velocity in zip(found.steering[1:], found.velocity[1:], strict=True):
        now = states[-1]
        wanted = np.array([steering - now[EGO_STEERING], velocity - now[EGO_VELOCITY]]) / dt
        inputs.append(vehicle.clip_input(now, wanted, dt))
        states.append(vehicle.step(now, inputs[-1], dt))
    return Plan(
        states=np.stack(states),
        inputs=np.stack(inputs),
        report=SolveReport(fallback=found.fallback),
    )
