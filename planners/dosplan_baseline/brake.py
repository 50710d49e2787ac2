"""``brake-v1``: brakes to a standstill on the path, whatever happens."""

from __future__ import annotations

from dosplan.api import Planner
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_baseline.tracking import ReferencePath, roll_out

FULL_BRAKING = 8.0  # m/s2: what tyres give on a dry road.


class BrakePlanner(Planner):
    """Full braking along the route; the lower bound of every comparison."""

    name = "brake-v1"

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
        """Brakes.

        Args:
            observation: What is known now.
            occupancy: Not looked at.

        Returns:
            The plan.
        """
        return roll_out(
            self._path,
            observation.ego,
            lambda step, s, velocity: -FULL_BRAKING,
            self._vehicle,
            observation.dt,
        )
