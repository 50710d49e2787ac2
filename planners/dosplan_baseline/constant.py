"""Planners that follow the path with one acceleration, whatever happens."""

from __future__ import annotations

from dosplan.api import Planner
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_baseline.tracking import extended_path, roll_out


class ConstantAccelerationPlanner(Planner):
    """One acceleration along the route, down to a standstill where it is negative.

    Attributes:
        acceleration: m/s2; constant velocity by default.
    """

    acceleration: float = 0.0

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Prepares the path.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """
        self._path = extended_path(task.route)
        self._vehicle = vehicle

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Rolls the acceleration out.

        Args:
            observation: What is known now.
            occupancy: Not looked at.

        Returns:
            The plan.
        """
        return roll_out(
            self._path,
            observation.ego,
            lambda step, s, velocity: self.acceleration,
            self._vehicle,
            observation.dt,
        )
