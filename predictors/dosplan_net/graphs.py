"""The network as graphs of plain tensors, and torch as what runs them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from dosplan_net.features import (
    HISTORY,
    HISTORY_SIZE,
    HORIZON,
    NEIGHBOURS,
    PIECE_ATTRIBUTES,
    PIECE_CHANNELS,
    PIECE_POINTS,
    PIECES,
    POSE_SIZE,
    STATIC_SIZE,
    Float32Array,
)
from dosplan_net.light_network import LightResponse
from dosplan_net.lights import LIGHT_SIZE
from dosplan_net.network import Prediction, Scene, TrajectoryNetwork


class Graph(nn.Module, ABC):
    """A module whose inputs and outputs are tensors, none of which is optional.

    Attributes:
        inputs: Names of the inputs, in order, each with names for the lengths of its first axes,
            which may differ from call to call: axes of the same name are equally long.
        outputs: Names of the outputs, in order.
    """

    inputs: ClassVar[Mapping[str, tuple[str, ...]]]
    outputs: ClassVar[Sequence[str]]

    @abstractmethod
    def example(self) -> tuple[Tensor, ...]:
        """Inputs of the right shape, to trace the graph with."""


class MapGraph(Graph):
    """Map pieces in, what the network keeps of them out; see ``network.MapEncoder``."""

    inputs: ClassVar = {"shape": ("pieces",), "attributes": ("pieces",)}
    outputs: ClassVar = ("code",)

    def __init__(self, network: TrajectoryNetwork) -> None:
        super().__init__()
        self.encoder = network.map_encoder
        self.eval()

    def forward(self, shape: Tensor, attributes: Tensor) -> tuple[Tensor]:
        """(P, points, 3) pieces and (P, attributes) -> (P, width)."""
        return (self.encoder(shape, attributes),)

    def example(self) -> tuple[Tensor, ...]:
        """Three pieces."""
        return torch.zeros(3, PIECE_POINTS, PIECE_CHANNELS), torch.zeros(3, PIECE_ATTRIBUTES)


class SceneGraph(Graph):
    """The fields of ``network.Scene`` in, those of ``network.Prediction`` out."""

    inputs: ClassVar = {
        "pose": ("users",),
        "history": ("users",),
        "static": ("users",),
        "targets": ("targets",),
        "neighbours": ("targets",),
        "pieces": ("targets",),
        "piece_code": ("map",),
        "piece_pose": ("map",),
    }
    outputs: ClassVar = ("trajectory", "log_weight", "features")

    def __init__(self, network: TrajectoryNetwork) -> None:
        super().__init__()
        self.network = network
        self.eval()

    def forward(self, *fields: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """See ``network.TrajectoryNetwork.forward``."""
        found: Prediction = self.network(Scene(*fields))
        return found.trajectory, found.log_weight, found.features

    def example(self) -> tuple[Tensor, ...]:
        """Five road users, three of which are targets, among seven pieces."""
        return (
            torch.zeros(5, POSE_SIZE),
            torch.zeros(5, HISTORY, HISTORY_SIZE),
            torch.zeros(5, STATIC_SIZE),
            torch.arange(3),
            torch.zeros(3, NEIGHBOURS, dtype=torch.int64),
            torch.zeros(3, PIECES, dtype=torch.int64),
            self.network.map_encoder(
                torch.zeros(7, PIECE_POINTS, PIECE_CHANNELS), torch.zeros(7, PIECE_ATTRIBUTES)
            ),
            torch.zeros(7, 3),
        )


class LightGraph(Graph):
    """Trajectories in, those of road users with a light ahead out; see ``LightResponse``."""

    inputs: ClassVar = dict.fromkeys(("features", "trajectory", "velocity", "lights"), ("users",))
    outputs: ClassVar = ("answer",)

    def __init__(self, response: LightResponse) -> None:
        super().__init__()
        self.response = response
        self.eval()

    def forward(self, *fields: Tensor) -> tuple[Tensor]:
        """See ``light_network.LightResponse.forward``."""
        return (self.response(*fields),)

    def example(self) -> tuple[Tensor, ...]:
        """Three road users."""
        features = self.response.config.features
        return (
            torch.zeros(3, features),
            torch.zeros(3, self.response.config.modes, HORIZON, 2),
            torch.zeros(3),
            torch.zeros(3, LIGHT_SIZE),
        )


class TorchFunction:
    """A graph that torch runs; see ``engine.Function``."""

    def __init__(self, graph: Graph, threads: int) -> None:
        self._graph = graph
        self._threads = threads

    def __call__(self, **arrays: npt.NDArray[Any]) -> list[Float32Array]:
        """Runs the graph with its number of threads, which torch keeps for the whole process."""
        torch.set_num_threads(self._threads)
        with torch.inference_mode():
            found = self._graph(*(torch.from_numpy(arrays[name]) for name in self._graph.inputs))
        return [np.asarray(tensor.numpy(), dtype=np.float32) for tensor in found]
