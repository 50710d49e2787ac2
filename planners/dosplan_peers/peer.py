"""What all peers, the third-party planners, share: a trajectory is found and becomes a plan.

Peers plan in a Frenet frame along the path. As in their own scripts, a cycle begins with the state
in that frame that the last trajectory has for this step: to project the ego at every step would add
the errors of their projection in bends. Only where the ego is elsewhere is it projected. Its
acceleration, which no ego state of dosplan holds, is then that of its last step; the first is zero,
as with the peers.

No peer knows lights, stop lines or signs, but each drives at a desired velocity that it is given,
and keeps clear of what stands. So dosplan's ``StopRules`` decide where the ego has to stop, as they
do for ``idm`` and ``mpc``; the desired velocity is limited to what comes to zero there, and a wall
stands there.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from dosplan.api import Planner
from dosplan.geometry import ReferencePath, StopRules, StopSettings
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
BRAKING: Final = 1.5  # m/s2; with which the desired velocity falls before a stop.
WALL: Final = (0.5, 12.0)  # Length and width of the wall at a stop, m: no sample goes round it.


@dataclass(frozen=True)
class PeerSettings:
    """The options that all peers share.

    Attributes:
        rules: Whether it stops for lights, signs and crosswalks; the published planners do not.
        stops: When it does so.
    """

    rules: bool = True
    stops: StopSettings = StopSettings()


@dataclass(frozen=True)
class Stop:
    """A place that the ego must not pass now.

    Attributes:
        velocity: Largest velocity to be desired now, m/s.
        centre: (2,) centre of a wall across the road whose face is at the place, m.
        heading: Heading of the path there, rad.
    """

    velocity: float
    centre: FloatArray
    heading: float


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
    """A third-party planner.

    A subclass assigns ``look_ahead`` and ``plan_steps``: how far it checks for collisions, and how
    long its trajectories are.

    Attributes:
        delay: How long after a desired velocity it has it, s: it begins to brake earlier by so
            much where it has to stop.
    """

    settings = PeerSettings
    delay: ClassVar[float]

    def __init__(self, *, seed: int = 0, settings: Any = PeerSettings()) -> None:
        """Keeps the settings.

        Args:
            seed: Seed of the run; no peer draws anything at random.
            settings: The options, a ``PeerSettings``.
        """
        super().__init__(seed=seed, settings=settings)
        self._settings: PeerSettings = settings

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Forgets the last trajectory and prepares the peer."""
        self._vehicle = vehicle
        self._last: Trajectory | None = None
        self._last_step = task.start_step
        self._path = ReferencePath.of(task.route)
        self._place = self._path.locate_first(vehicle.centre(task.start))
        self._rules = StopRules(task, self._settings.stops) if self._settings.rules else None
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
            if np.hypot(*(self._last.position[now] - observation.ego[:2])) < ON_PLAN:
                acceleration, frenet = float(self._last.acceleration[now]), self._last.frenet[now]
            else:
                before, after = observation.ego_history[-2:, EGO_VELOCITY]
                acceleration = float(after - before) / observation.dt
        wait, stop = None, None
        if self._rules is not None:
            self._place = self._path.track(self._vehicle.centre(observation.ego), self._place)
            front = self._place + 0.5 * self._vehicle.length
            wait = self._rules.wait(observation, occupancy, front)
            if wait is not None:
                way = wait.place - front - self.delay * float(observation.ego[EGO_VELOCITY])
                stop = self._stop(wait.place, way)
        found = self.find(observation, occupancy, acceleration, frenet, stop)
        self._last, self._last_step = found, observation.step
        plan = follow(observation.ego, found, self._vehicle, observation.dt)
        if wait is None:
            return plan
        return replace(plan, report=replace(plan.report, waits_for=wait.reason))

    def _stop(self, place: float, way: float) -> Stop:
        """A stop at an arc length of the route, m, with so much way left to brake in, m."""
        s, points = self._path.arclength, self._path.points
        heading = float(self._path.heading_at(place))
        face = np.array([np.interp(place, s, points[:, axis]) for axis in (0, 1)])
        ahead = np.array([np.cos(heading), np.sin(heading)])
        velocity = float(np.sqrt(2.0 * BRAKING * max(way, 0.0)))
        return Stop(velocity, face + 0.5 * WALL[0] * ahead, heading)

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
        stop: Stop | None,
    ) -> Trajectory:
        """Searches a trajectory.

        Args:
            observation: What is known now.
            occupancy: The sets to keep out of.
            acceleration: The ego's acceleration now, m/s2.
            frenet: (6,) the ego's state in the Frenet frame by the last trajectory, see
                ``Trajectory``, or None where it has to be projected.
            stop: Where a rule asks for a stop, or None.

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
