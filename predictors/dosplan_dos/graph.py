"""The occupancy-set module as a graph of plain tensors: run by torch, or exported to ONNX."""

from __future__ import annotations

from typing import ClassVar

import torch
from dosplan_net.features import HISTORY, HISTORY_SIZE, HORIZON
from dosplan_net.graphs import Graph
from torch import Tensor

from dosplan_dos.module import OccupancyModule, UnionModule


class SetsGraph(Graph):
    """Features, trajectory, velocity and history in; semi-axes and double angle out."""

    inputs: ClassVar = dict.fromkeys(
        ("features", "trajectory", "velocity", "history"), ("targets",)
    )
    outputs: ClassVar = ("semi_axes", "double_angle")

    def __init__(self, module: OccupancyModule) -> None:
        super().__init__()
        self.module = module
        self.eval()

    def forward(
        self, features: Tensor, trajectory: Tensor, velocity: Tensor, history: Tensor
    ) -> tuple[Tensor, Tensor]:
        """See ``module.OccupancyModule.forward`` and ``shapes.Ellipses``."""
        sets = self.module(features, trajectory, velocity, history)
        return sets.semi_axes, sets.double_angle

    def example(self) -> tuple[Tensor, ...]:
        """Three road users."""
        return (
            torch.zeros(3, self.module.config.features),
            torch.zeros(3, HORIZON, 2),
            torch.zeros(3),
            torch.zeros(3, HISTORY, HISTORY_SIZE),
        )


class UnionGraph(Graph):
    """Features, M trajectories and their weights, velocity and history in; M ellipses out."""

    inputs: ClassVar = {
        "features": ("targets",),
        "trajectories": ("targets", "modes"),  # One, where they are those of another predictor.
        "log_weight": ("targets", "modes"),
        "velocity": ("targets",),
        "history": ("targets",),
    }
    outputs: ClassVar = ("semi_axes", "double_angle", "centre")

    def __init__(self, module: UnionModule) -> None:
        super().__init__()
        self.module = module
        self.eval()

    def forward(
        self,
        features: Tensor,
        trajectories: Tensor,
        log_weight: Tensor,
        velocity: Tensor,
        history: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """See ``module.UnionModule.forward`` and ``shapes.Unions``."""
        sets = self.module(features, trajectories, log_weight, velocity, history)
        return sets.semi_axes, sets.double_angle, sets.centre

    def example(self) -> tuple[Tensor, ...]:
        """Three road users."""
        modes = self.module.config.modes
        return (
            torch.zeros(3, self.module.config.features),
            torch.zeros(3, modes, HORIZON, 2),
            torch.zeros(3, modes),
            torch.zeros(3),
            torch.zeros(3, HISTORY, HISTORY_SIZE),
        )
