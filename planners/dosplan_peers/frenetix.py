"""``frenetix-v3``: Frenetix, a sampling planner in a Frenet frame with a core in C++.

Trauth, Moller, Wuersching, Betz, "FRENETIX: A High-Performance and Modular Motion Planning
Framework for Autonomous Driving", IEEE Access 12, 2024.

The core (``frenetix`` on PyPI) samples trajectories, weighs them and checks that they are feasible.
The rest of the planner is not on PyPI; it is written anew here after
https://github.com/TUM-AVS/Frenetix-Motion-Planner, with the figures of its configuration: the
sampled grid, the desired velocity for the goal's place and time, the costs, the check of each
trajectory, cheapest first, against the swept rectangles of the road users and the road's edge, and
the fallback where none passes: the one that stops soonest. Where none is even feasible, the run
ends.

The sets enter the check. To the cost of a collision's probability, the predicted positions have
the covariance that Frenetix gives to exact predictions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from heapq import heapify, heappop, heappush
from itertools import islice, product
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from shapely.geometry import LineString, Point

from dosplan.api import NoPlanError
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    STEP_SECONDS,
    FloatArray,
    GoalState,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
)
from dosplan.vehicle import VehicleParameters
from dosplan_peers import INSTALL
from dosplan_peers.peer import Peer, Stop, Trajectory
from dosplan_peers.world import (
    commonroad_scenario,
    goal_on_way,
    moving_rectangles,
    reference_path,
    swept,
    time_variant,
    wall,
)

try:
    import frenetix
    from commonroad_dc.boundary.boundary import create_road_boundary_obstacle
    from commonroad_dc.collision.trajectory_queries import trajectory_queries
    from frenetix.trajectory_functions import FillCoordinates
    from frenetix.trajectory_functions import cost_functions as costs
    from frenetix.trajectory_functions import feasability_functions as checks
except ImportError as error:
    raise ImportError(f"{error}; {INSTALL}") from error

HORIZON: Final = 3.0  # s
LOW_VELOCITY: Final = 2.0  # m/s; below it, the way sideways is a function of the way ahead.
STANDSTILL: Final = 0.1  # m/s
DURATIONS: Final = np.append(np.arange(1.1, HORIZON, 0.3), HORIZON)  # s
OFFSETS: Final = np.linspace(-3.0, 3.0, 9)  # m
VELOCITIES: Final = 9  # Number of them, between what these shares of the greatest acceleration
BRAKING_SHARE: Final = 0.5  # reach within the horizon.
DRIVING_SHARE: Final = 1.0 / 7.0
VELOCITY_LIMITS: Final = (0.01, 36.0)  # m/s
DESIRED_RANGE: Final = 5.0  # m/s; how far the desired velocity may be from the present one.
DESIRED_LIMIT: Final = 50.0  # m/s; the largest desired velocity.
COVARIANCE: Final = 0.1  # m2
GRID: Final = {"method": "grid", "num_cells": 32}  # Narrows down what may collide.
WEIGHTS: Final[Mapping[str, float]] = MappingProxyType(
    {
        "lateral_jerk": 1.0,
        "longitudinal_jerk": 1.0,
        "distance_to_reference_path": 3.0,
        "velocity_offset": 1.0,
        "prediction": 200.0,
    }
)
STOP_WEIGHT: Final = 5.0
"""How many times as much the velocity counts where it has to stop. Planned anew at every step, its
trajectories of 1.1 s and more brake late for a wall."""

# Columns of a row of samples.
_DURATION, _END_VELOCITY, _END_OFFSET = 1, 5, 10


class FrenetixPlanner(Peer):
    """Frenetix."""

    name = "frenetix-v3"
    delay = 2.0
    look_ahead = plan_steps = round(HORIZON / STEP_SECONDS)

    def build(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Prepares the Frenet frame, the road's edge and the way to the goal.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """
        path = reference_path(task.route)
        self._goal = goal_on_way(task)
        self._line = LineString(path)
        self._frame = frenetix.CoordinateSystemWrapper(path)
        _, self._road = create_road_boundary_obstacle(
            commonroad_scenario(road_map, task.dt), method="aligned_triangulation", axis=2
        )

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
            The trajectory; where all collide, the one that stops soonest.

        Raises:
            NoPlanError: None is feasible.
        """
        ego = observation.ego
        velocity = float(ego[EGO_VELOCITY])
        slow = velocity < LOW_VELOCITY
        state = frenetix.CartesianPlannerState(
            np.array(ego[:2]), ego[EGO_HEADING], velocity, acceleration, ego[EGO_STEERING]
        )
        if frenet is None:
            wheelbase = self._vehicle.wheelbase
            start = frenetix.compute_initial_state(self._frame, state, wheelbase, slow)
        else:
            start = frenetix.CurvilinearPlannerState(frenet[:3].copy(), frenet[3:].copy())

        handler = self._handler(observation, slow, stop)
        handler.generate_trajectories(_samples(start, velocity, self._vehicle), slow)
        handler.evaluate_all_current_functions(False)
        feasible = [sample for sample in handler.get_sorted_trajectories() if sample.feasible]

        steps = round(HORIZON / observation.dt)
        obstacles = [swept(o) for o in moving_rectangles(occupancy, observation.step, steps)]
        if stop is not None:
            obstacles.append(wall(stop, observation.step, steps))
        ranked = _cheapest_first(feasible, self._risk(occupancy))
        if (best := self._first_free(ranked, observation.step, obstacles)) is not None:
            return self._trajectory(best)
        if velocity <= STANDSTILL:
            whole = frenetix.PlannerState(state, start, self._vehicle.wheelbase)
            standing = frenetix.TrajectorySample.compute_standstill_trajectory(
                self._frame, whole, observation.dt, HORIZON
            )
            return self._trajectory(standing, "standstill")
        if not feasible:
            raise NoPlanError("no sampled trajectory is feasible")
        offset = float(np.asarray(start.x0_lat)[0])
        return self._trajectory(min(feasible, key=lambda s: _stopping(s, offset)), "stopping")

    def _handler(self, observation: Observation, slow: bool, stop: Stop | None) -> Any:
        """A handler with the checks and costs of this cycle, but for the risk."""
        vehicle, ego = self._vehicle, observation.ego
        handler = frenetix.TrajectoryHandler(observation.dt)
        turning = {"deltaMax": vehicle.max_steering, "wheelbase": vehicle.wheelbase}
        for check in (
            checks.CheckYawRateConstraint(**turning, wholeTrajectory=False),
            checks.CheckAccelerationConstraint(
                switchingVelocity=vehicle.switching_velocity,
                maxAcceleration=vehicle.max_acceleration,
                wholeTrajectory=False,
            ),
            checks.CheckCurvatureConstraint(**turning, wholeTrajectory=False),
            checks.CheckCurvatureRateConstraint(
                wheelbase=vehicle.wheelbase,
                velocityDeltaMax=vehicle.max_steering_rate,
                wholeTrajectory=False,
            ),
        ):
            handler.add_feasability_function(check)
        handler.add_function(FillCoordinates(slow, ego[EGO_HEADING], self._frame, HORIZON))
        desired = self._desired_velocity(observation)
        weights = dict(WEIGHTS)
        if stop is not None:
            desired = min(desired, stop.velocity)
            weights["velocity_offset"] *= STOP_WEIGHT
        for name, kind, arguments in (
            ("lateral_jerk", costs.CalculateLateralJerkCost, ()),
            ("longitudinal_jerk", costs.CalculateLongitudinalJerkCost, ()),
            ("distance_to_reference_path", costs.CalculateDistanceToReferencePathCost, ()),
            (
                "velocity_offset",
                costs.CalculateVelocityOffsetCost,
                (desired, observation.dt, float(DURATIONS[0]), False, 2),
            ),
        ):
            handler.add_cost_function(kind(name, weights[name], *arguments))
        return handler

    def _risk(self, occupancy: Occupancy) -> Any:
        """The cost of a collision's probability."""
        name = "prediction"
        size = self._vehicle.length, self._vehicle.width
        return costs.CalculateCollisionProbabilityFast(
            name, WEIGHTS[name], _predictions(occupancy), *size
        )

    def _desired_velocity(self, observation: Observation) -> float:
        """The velocity that reaches the middle of the goal in the middle of its time."""
        goal, velocity = self._goal, float(observation.ego[EGO_VELOCITY])
        centre = self._vehicle.centre(observation.ego)
        if goal.region is None or goal.region.contains(Point(centre)):
            return _near(_goal_velocity(goal, velocity), velocity)
        middle = (goal.first_step + goal.last_step) // 2
        time = (middle - observation.step) * observation.dt
        if time <= 0.0:
            return _near(_goal_velocity(goal, velocity), velocity)
        way = self._line.project(goal.region.centroid) - self._line.project(Point(centre))
        return _near(way / time, velocity)

    def _first_free(self, samples: Iterator[Any], step: int, obstacles: list[Any]) -> Any | None:
        """The first trajectory that clears the obstacles and the road's edge, or None.

        Mostly it is the very first, or all have to be tried: each time twice as many are.
        """
        count = 1
        while batch := list(islice(samples, count)):
            count *= 2
            egos = [self._swept(sample, step) for sample in batch]
            hits = trajectory_queries.trajectories_collision_dynamic_obstacles(
                egos, obstacles, **GRID
            )
            struck = {i for i, hit in enumerate(hits) if hit != -1}  # No hits without obstacles.
            clear = [i for i in range(len(batch)) if i not in struck]
            leaves = trajectory_queries.trajectories_collision_static_obstacles(
                [egos[i] for i in clear], self._road, **GRID, auto_orientation=True
            )
            for i, leaf in zip(clear, leaves, strict=True):
                if leaf == -1:
                    return batch[i]
        return None

    def _swept(self, sample: Any, step: int) -> Any:
        """What the ego sweeps on a trajectory, as an object of CommonRoad's collision checker."""
        heading = sample.cartesian.theta
        rear = np.stack([sample.cartesian.x, sample.cartesian.y], axis=-1)
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        centre = rear + self._vehicle.rear_to_centre * ahead
        size = np.broadcast_to(self._vehicle.size, centre.shape)
        return swept(time_variant(centre, heading, size, step))

    def _trajectory(self, sample: Any, fallback: str | None = None) -> Trajectory:
        found, along = sample.cartesian, sample.curvilinear
        return Trajectory(
            steering=np.arctan(self._vehicle.wheelbase * np.array(found.kappa)),
            velocity=np.array(found.v),
            acceleration=np.array(found.a),
            position=np.stack([found.x, found.y], axis=1),
            frenet=np.stack(
                [along.s, along.s_dot, along.s_ddot, along.d, along.d_dot, along.d_ddot], axis=1
            ),
            fallback=fallback,
        )


def _samples(start: Any, velocity: float, vehicle: VehicleParameters) -> FloatArray:
    """Rows of start and end conditions, one for each trajectory.

    A row holds start and end time, s; position, m, velocity and acceleration along the path at
    the start, velocity and acceleration at the end; and position, velocity and acceleration
    across it, at the start and at the end.
    """
    most = vehicle.max_acceleration * HORIZON
    low = max(velocity - BRAKING_SHARE * most, VELOCITY_LIMITS[0])
    high = min(velocity + DRIVING_SHARE * most, VELOCITY_LIMITS[1], vehicle.max_velocity)
    along, across = start.x0_lon, start.x0_lat
    velocities = np.union1d(np.linspace(low, high, VELOCITIES), along[1])
    offsets = np.union1d(OFFSETS, across[0])
    return np.array(
        [
            (0.0, duration, *along, end, 0.0, *across, offset, 0.0, 0.0)
            for duration, end, offset in product(DURATIONS, velocities, offsets)
        ]
    )


def _cheapest_first(samples: list[Any], risk: Any) -> Iterator[Any]:
    """Sorts trajectories by their costs, which lack that of the risk so far.

    The risk takes nearly all of a cycle's time and is never negative: a trajectory's is only asked
    for where no other is cheaper with its own.
    """
    queue = [(sample.cost, i, False) for i, sample in enumerate(samples)]
    heapify(queue)
    while queue:
        _, i, whole = heappop(queue)
        if whole:
            yield samples[i]
        else:
            risk.evaluate_trajectory(samples[i])
            heappush(queue, (samples[i].cost, i, True))


def _stopping(sample: Any, offset: float) -> tuple[float, float, float]:
    """Sorts the slowest, soonest and straightest trajectories first."""
    row = sample.sampling_parameters
    return row[_END_VELOCITY], row[_DURATION], abs(row[_END_OFFSET] - offset)


def _near(desired: float, velocity: float) -> float:
    """The desired velocity, limited to a range around the present one."""
    low, high = max(velocity - DESIRED_RANGE, 0.0), min(velocity + DESIRED_RANGE, DESIRED_LIMIT)
    return float(np.clip(desired, low, high))


def _goal_velocity(goal: GoalState, velocity: float) -> float:
    return velocity if goal.velocity is None else 0.5 * sum(goal.velocity)


def _predictions(occupancy: Occupancy) -> dict[int, Any]:
    """The predicted positions for as long as each road user stays on the scene.

    Of a union, these are of the most likely component: the cost that they are for knows no weights.
    """
    occupancy = occupancy.likeliest()
    covariance = np.zeros((6, 6), order="F")
    covariance[:2, :2] = COVARIANCE * np.eye(2)
    half = 0.5 * occupancy.heading
    found = {}
    for i, stays in enumerate(occupancy.valid.cumprod(axis=1).sum(axis=1)):
        poses = [
            frenetix.PoseWithCovariance(
                np.append(occupancy.centre[i, t], 0.0),
                np.array([0.0, 0.0, np.sin(half[i, t]), np.cos(half[i, t])]),
                covariance,
            )
            for t in range(stays)
        ]
        length, width = occupancy.footprint[i]
        user = int(occupancy.ids[i])
        found[user] = frenetix.PredictedObject(user, poses, length, width)
    return found
