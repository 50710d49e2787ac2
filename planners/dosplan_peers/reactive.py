"""``reactive-v3``: CommonRoad's reactive planner, a sampling planner in a Frenet frame.

Wuersching, Pek et al., https://github.com/CommonRoad/commonroad-reactive-planner, after Werling
et al., "Optimal trajectory generation for dynamic street scenarios in a Frenet frame", ICRA 2010.

It is used as in its ``run_planner.py``: the goal's mean velocity (or else the start's) is the
desired one, sampling gets denser until a trajectory is found that is feasible and free of
collisions, and where none is found the run ends. Three things differ: the map, the path and the
obstacles are dosplan's; it plans at every cycle and not at every third one; and it samples in one
process.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np

from dosplan.api import NoPlanError
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    FloatArray,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
)
from dosplan.vehicle import VehicleParameters
from dosplan_peers import INSTALL
from dosplan_peers.peer import Peer, PeerSettings, Stop, Trajectory
from dosplan_peers.world import (
    commonroad_scenario,
    goal_on_way,
    moving_rectangles,
    reference_path,
    wall,
)

try:
    from commonroad.common.util import Interval
    from commonroad.planning.goal import GoalRegion
    from commonroad.planning.planning_problem import PlanningProblem
    from commonroad.scenario.state import CustomState, InitialState
    from commonroad_rp.reactive_planner import ReactivePlanner
    from commonroad_rp.state import ReactivePlannerState
    from commonroad_rp.utility import config as rp
    from commonroad_rp.utility.general import retrieve_desired_velocity_from_pp
    from commonroad_rp.utility.utils_coordinate_system import create_coordinate_system
except ImportError as error:
    raise ImportError(f"{error}; {INSTALL}") from error


_OVER_LINE: Final = "over the line"
_MOVES: Final = 1e-6  # m/s


@dataclass(frozen=True)
class ReactiveSettings(PeerSettings):
    """The options of the reactive planner.

    Attributes:
        horizon: Steps to plan; 20 is that of the configurations it is published with.
    """

    horizon: int = 20

    def __post_init__(self) -> None:
        if self.horizon < 1:
            raise ValueError(f"horizon is {self.horizon}, expected 1 or more")


class CommonRoadReactivePlanner(Peer):
    """CommonRoad's reactive planner."""

    name = "reactive-v3"
    settings = ReactiveSettings
    delay = 0.5

    def __init__(self, *, seed: int = 0, settings: ReactiveSettings = ReactiveSettings()) -> None:
        """Keeps the horizon.

        Args:
            seed: Seed of the run; the planner draws nothing at random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self._horizon = self.look_ahead = self.plan_steps = settings.horizon

    def build(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Makes a planner with the road's edge as its only obstacle.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """
        config = rp.ReactivePlannerConfiguration(
            vehicle=_vehicle(vehicle),
            planning=rp.PlanningConfiguration(dt=task.dt, time_steps_computation=self._horizon),
            debug=rp.DebugConfiguration(multiproc=False, logging_level="CRITICAL"),
        )
        problem = _problem(task, vehicle)
        config.update(commonroad_scenario(road_map, task.dt), problem)
        self._planner = ReactivePlanner(config)
        self._road = self._planner.collision_checker
        with warnings.catch_warnings():  # It divides by the curvature of straight roads.
            warnings.simplefilter("ignore")
            self._frame = create_coordinate_system(reference_path(task.route))
        self._desired_velocity = float(retrieve_desired_velocity_from_pp(problem))

    def find(
        self,
        observation: Observation,
        occupancy: Occupancy,
        acceleration: float,
        frenet: FloatArray | None,
        stop: Stop | None,
    ) -> Trajectory:
        """Samples trajectories and takes the cheapest that is feasible and free of collisions.

        Args:
            observation: What is known now.
            occupancy: The sets to keep out of.
            acceleration: The ego's acceleration now, m/s2.
            frenet: (6,) the ego's state in the Frenet frame, or None where it is not known.
            stop: Where it has to stop, or None.

        Returns:
            The trajectory.

        Raises:
            NoPlanError: There is none.
        """
        checker = self._road.clone()
        for obstacle in moving_rectangles(occupancy, observation.step, self._horizon):
            checker.add_collision_object(obstacle)
        if stop is None:
            found, fallback = self._search(observation, checker, acceleration, frenet, np.inf), None
        else:
            walled = checker.clone()
            walled.add_collision_object(wall(stop, observation.step, self._horizon))
            given = acceleration, frenet, stop.velocity
            found, fallback = self._search(observation, walled, *given), None
            if found is None:
                # Its samples brake by 3 m/s at most, which may be too little for a wall: that is
                # no reason to give up, but one to brake as it can.
                found, fallback = self._search(observation, checker, *given), _OVER_LINE
        if found is None:
            raise NoPlanError("no sampled trajectory is feasible and free of collisions")
        states = found[0].state_list
        # Where it stands, the last step lacks; it is driven as the one before.
        rows = np.minimum(np.arange(self._horizon + 1), len(states) - 1)
        return Trajectory(
            steering=np.array([state.steering_angle for state in states])[rows],
            velocity=np.array([state.velocity for state in states])[rows],
            acceleration=np.array([state.acceleration for state in states])[rows],
            position=np.array([state.position for state in states])[rows],
            frenet=np.hstack(found[1:])[rows],
            fallback=fallback,
        )

    def _search(
        self,
        observation: Observation,
        checker: Any,
        acceleration: float,
        frenet: FloatArray | None,
        limit: float,
    ) -> Any:
        """What the planner finds among some obstacles, with a limit of the desired velocity."""
        ego = observation.ego
        self._planner.reset(
            initial_state_cart=_state(ego, observation.step, acceleration, self._vehicle),
            initial_state_curv=None if frenet is None else (frenet[:3], frenet[3:]),
            collision_checker=_Slices(checker),
            coordinate_system=self._frame,
        )
        # At a velocity of zero, it would take the one of the planning problem in place of this one.
        self._planner.set_desired_velocity(
            min(self._desired_velocity, limit), current_speed=max(float(ego[EGO_VELOCITY]), _MOVES)
        )
        return self._planner.plan()


class _Slices:
    """A collision checker that cuts each step once.

    The planner asks for the obstacles of a step anew for every pose of every sample, which takes
    more time than the check itself.
    """

    def __init__(self, checker: Any) -> None:
        self._at = cache(checker.time_slice)

    def time_slice(self, step: int) -> Any:
        """The obstacles at a step, as a ``pycrcc.CollisionChecker``."""
        return self._at(step)


def _vehicle(vehicle: VehicleParameters) -> rp.VehicleConfiguration:
    return rp.VehicleConfiguration(
        length=vehicle.length,
        width=vehicle.width,
        wb_front_axle=vehicle.wheelbase - vehicle.rear_to_centre,
        wb_rear_axle=vehicle.rear_to_centre,
        a_max=vehicle.max_acceleration,
        v_switch=vehicle.switching_velocity,
        delta_min=-vehicle.max_steering,
        delta_max=vehicle.max_steering,
        v_delta_min=-vehicle.max_steering_rate,
        v_delta_max=vehicle.max_steering_rate,
    )


def _problem(task: PlanningTask, vehicle: VehicleParameters) -> PlanningProblem:
    """What the planner reads of a planning problem: the start and the goal's velocity."""
    goal = goal_on_way(task)
    wanted = {"time_step": Interval(goal.first_step, goal.last_step)}
    if goal.velocity is not None:
        wanted["velocity"] = Interval(*goal.velocity)
    start = InitialState(
        position=vehicle.centre(task.start),
        orientation=float(task.start[EGO_HEADING]),
        velocity=float(task.start[EGO_VELOCITY]),
        acceleration=0.0,
        yaw_rate=0.0,
        slip_angle=0.0,
        time_step=task.start_step,
    )
    return PlanningProblem(1, start, GoalRegion([CustomState(**wanted)]))


def _state(
    ego: FloatArray, step: int, acceleration: float, vehicle: VehicleParameters
) -> ReactivePlannerState:
    turning = float(np.tan(ego[EGO_STEERING])) / vehicle.wheelbase
    return ReactivePlannerState(
        time_step=step,
        position=np.array(ego[:2]),
        steering_angle=float(ego[EGO_STEERING]),
        velocity=float(ego[EGO_VELOCITY]),
        orientation=float(ego[EGO_HEADING]),
        acceleration=acceleration,
        yaw_rate=float(ego[EGO_VELOCITY]) * turning,
    )
