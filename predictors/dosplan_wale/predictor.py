"""``wale-net-v3``: the pretrained Wale-Net, whose Gaussians become ellipses.

Geisslinger, Karle et al., https://github.com/TUMFTM/Wale-Net, as its class ``WaleNet`` drives it,
with two differences: road users go through the network together, and the last position it is shown
is the present one. ``WaleNet`` counts the states of an obstacle from the one after its first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from dosplan_net.predictor import placed

from dosplan.api import Predictor, PredictorSettings
from dosplan.types import (
    USER_HEADING,
    FloatArray,
    IntArray,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
)
from dosplan_wale.gaussians import ellipses
from dosplan_wale.network import open_network, read_config, shipped_weights
from dosplan_wale.roads import RoadCodes
from dosplan_wale.scene import describe


@dataclass(frozen=True)
class WaleNetSettings(PredictorSettings):
    """The options of Wale-Net.

    Attributes:
        horizon: Number T of steps to predict, at most 40.
        coverage: Probability, in (0, 1), that the Gaussian gives the ellipse at each step.
        threads: Threads that the network may use.
    """

    coverage: float = 0.9
    threads: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.coverage < 1.0:
            raise ValueError(f"coverage is {self.coverage}, expected a share between 0 and 1")
        if self.threads < 1:
            raise ValueError(f"threads is {self.threads}, expected 1 or more")


class WaleNetPredictor(Predictor):
    """Wale-Net; parked and static road users, which it does not know, stay where they are."""

    name = "wale-net-v3"
    settings = WaleNetSettings

    def __init__(self, *, seed: int = 0, settings: WaleNetSettings = WaleNetSettings()) -> None:
        """Loads the network.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.

        Raises:
            ValueError: The horizon is longer than the network's, or its weights cannot be read.
        """
        super().__init__(seed=seed, settings=settings)
        config = read_config()
        longest = config["out_length"]
        if self.horizon > longest:
            raise ValueError(f"horizon is {self.horizon}, expected {longest} or less")
        self._chosen = settings
        self._steps: int = config["in_length"]
        network = open_network(config, shipped_weights())
        self._network, self._roads = network.rest, RoadCodes(network.road, config["watch_radius"])

    def weight_files(self) -> tuple[Path, ...]:
        """The weights of Wale-Net's package."""
        return (shipped_weights(),)

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:
        """Reads the map."""
        self._roads.read(road_map)

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Runs the network.

        Returns:
            The means of the Gaussians, and ellipses that hold the chosen share of them.
        """
        moving = np.flatnonzero(observation.moves)
        heading = observation.states[moving, -1, USER_HEADING]
        gaussians = self._gaussians(observation, moving, heading)
        # Wale-Net looks along y, dosplan along x.
        forward = np.stack([gaussians[..., 1], -gaussians[..., 0]], axis=-1)
        trajectory = placed(observation, moving, forward)
        semi_axes, angle = np.array(trajectory.semi_axes), np.array(trajectory.angle)
        semi_axes[moving], direction = ellipses(gaussians[..., 2:], self._chosen.coverage)
        angle[moving] = direction + (heading - 0.5 * np.pi)[:, None]
        return replace(trajectory, semi_axes=semi_axes, angle=angle)

    def _gaussians(
        self, observation: Observation, moving: IntArray, heading: FloatArray
    ) -> FloatArray:
        """(M, T, 5) means, reciprocal standard deviations and correlation in Wale-Net's frames."""
        if not len(moving):
            return np.zeros((0, self.horizon, 5))
        seen = observation.states[moving, -self._steps :, :2]
        past = np.full((len(moving), self._steps, 2), np.nan)
        past[:, self._steps - seen.shape[1] :] = seen
        rotation = heading - 0.5 * np.pi
        torch.set_num_threads(self._chosen.threads)  # For the whole process.
        inputs = describe(past, rotation)
        history, neighbours = map(torch.from_numpy, (inputs.history, inputs.neighbours))
        with torch.inference_mode():
            found = self._network(history, neighbours, self._roads.codes(past[:, -1], rotation))
        return np.asarray(found[: self.horizon].transpose(0, 1).double().numpy())
