"""Planners that follow the path with one acceleration and ignore the road users."""

from __future__ import annotations

from typing import Any

from dosplan.api import NoSettings, Planner
from dosplan.geometry import PathFollower, extended_path
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_baseline.tracking import PLAN_STEPS


class ConstantAccelerationPlanner(Planner):
    """One acceleration along the route, down to a standstill where it is negative.

    Attributes:
        acceleration: m/s2; constant velocity by default.
    """

    acceleration: float = 0.0
    plan_steps = PLAN_STEPS

    def __init__(self, *, seed: int = 0, settings: Any = NoSettings()) -> None:
        """Makes the planner; an episode begins with ``reset``.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self._follower: PathFollower | None = None

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Prepares the path."""
        self._follower = PathFollower(extended_path(task.route), vehicle, task.dt)

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Rolls the acceleration out.

        Args:
            observation: What is known now.
            occupancy: Not used.

        Returns:
            The plan.

        Raises:
            RuntimeError: No episode has begun.
        """
        if self._follower is None:
            raise RuntimeError("no episode has begun: reset comes before plan")
        return self._follower.roll_out(
            observation.ego, lambda step, s, v: self.acceleration, PLAN_STEPS
        )
