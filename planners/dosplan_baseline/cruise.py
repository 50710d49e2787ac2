"""``cruise-v1``: keeps its speed along the route and sees nobody.

A scenario that this planner solves asks for no interaction.
"""

from __future__ import annotations

from dosplan.api import Planner
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_baseline.tracking import ReferencePath, roll_out


class CruisePlanner(Planner):
    """Constant velocity along the route."""

    name = "cruise-v1"

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Prepares the path.

        Args:
            task: Start, goal and route.
            road_map: The map.
            vehicle: The ego's parameters.
        """
        self._path = ReferencePath(task.route)
        self._vehicle = vehicle

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Goes on.

        Args:
            observation: What is known now.
            occupancy: Not looked at.

        Returns:
            The plan.
        """
        return roll_out(
            self._path,
            observation.ego,
            lambda step, s, velocity: 0.0,
            self._vehicle,
            observation.dt,
        )
