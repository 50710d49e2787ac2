"""The planner as the benchmark sees it; what it does in an episode is in ``episode``."""

from __future__ import annotations

from typing import ClassVar

from dosplan.api import Planner
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.episode import MpcEpisode


class MpcPlanner(Planner):
    """Model-predictive control that keeps out of occupancy sets."""

    name: ClassVar[str] = "mpc-v12"

    settings = MpcConfig

    def __init__(self, *, seed: int = 0, settings: MpcConfig = MpcConfig()) -> None:
        """Keeps the settings; the problem itself is built at the first episode.

        Args:
            seed: Seed of the run; the planner draws nothing at random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self.config = settings
        self.look_ahead = self.plan_steps = settings.horizon
        self._episode: MpcEpisode | None = None

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Begins an episode; nothing is left of the last one."""
        self._episode = MpcEpisode(self.config, task, road_map, vehicle)

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Plans one cycle.

        Args:
            observation: What is known now.
            occupancy: Sets to keep out of.

        Returns:
            The plan.

        Raises:
            RuntimeError: No episode has begun.
        """
        if self._episode is None:
            raise RuntimeError("no episode has begun: reset comes before plan")
        return self._episode.plan(observation, occupancy)
