"""The trained network in an episode: the map is encoded once, then one pass a step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from dosplan.geometry import LightIndex
from dosplan.types import FloatArray, IntArray, Observation, RoadMap
from dosplan_net.engine import Engine, Function, Model, open_function
from dosplan_net.features import HORIZON, Float32Array, MapPieces, SceneFeatures, cut_map, describe
from dosplan_net.lights import describe_lights, find_lights, lit

if TYPE_CHECKING:
    from dosplan_net.graphs import LightGraph, MapGraph, SceneGraph

SHIPPED = "net.safetensors"
BESIDE: Final = ".lights.safetensors"  # Ends the name of a network's response to lights.


def _load_map(weights: Path) -> MapGraph:
    from dosplan_net.build import load_network
    from dosplan_net.graphs import MapGraph

    return MapGraph(load_network(weights))


def _load_scene(weights: Path) -> SceneGraph:
    from dosplan_net.build import load_network
    from dosplan_net.graphs import SceneGraph

    return SceneGraph(load_network(weights))


def _load_lights(weights: Path) -> LightGraph:
    from dosplan_net.graphs import LightGraph
    from dosplan_net.light_network import load_response

    return LightGraph(load_response(weights.with_suffix(BESIDE), weights))


MAP: Final = Model(_load_map, suffix=".map.onnx", option="--network")
SCENE: Final = Model(_load_scene, suffix=".onnx", option="--network")
LIGHTS: Final = Model(_load_lights, ".lights.onnx", option="--network", beside=BESIDE)


@dataclass(frozen=True)
class Encoded:
    """The network's output for an observation; T of its road users can move, M courses each.

    Attributes:
        moving: (T,) rows of the observation's road users that can move.
        features: (T, hidden) features H; (0, 0) where T is 0.
        trajectory: (T, M, HORIZON, 2) x, y in each road user's frame, m.
        log_weight: (T, M) logarithms of how likely each trajectory is.
        history: (T, HISTORY, 6) see ``features.SceneFeatures``.
        velocity: (T,) m/s.
        seen: What the network was shown of all road users of the observation.
        piece_pose: (P, 3) see ``features.MapPieces``.
    """

    moving: IntArray
    features: Float32Array
    trajectory: Float32Array
    log_weight: Float32Array
    history: Float32Array
    velocity: Float32Array
    seen: SceneFeatures
    piece_pose: FloatArray

    @property
    def likeliest(self) -> Float32Array:
        """(T, HORIZON, 2) the most likely trajectory of each."""
        best = self.log_weight.argmax(axis=1)
        return np.asarray(self.trajectory[np.arange(len(self.moving)), best])


class SceneEncoder:
    """Runs the network on observations; keeps the last result, as several predictors share it."""

    def __init__(
        self, read_map: Function, read_scene: Function, read_lights: Function | None = None
    ) -> None:
        """Takes the network.

        Args:
            read_map: The ``MAP`` part of it.
            read_scene: The ``SCENE`` part of it.
            read_lights: Its response to lights, ``LIGHTS``; without it no light is looked at.
        """
        self._read_map = read_map
        self._read_scene = read_scene
        self._read_lights = read_lights
        self._lights: LightIndex | None = None
        self._map: tuple[RoadMap, MapPieces] | None = None
        self._code: Float32Array = np.zeros((0, 0), dtype=np.float32)
        self._piece_pose: Float32Array = np.zeros((0, 3), dtype=np.float32)
        self._origin = np.zeros(3)
        self._last: tuple[Observation, Encoded] | None = None

    def prepare(self, road_map: RoadMap) -> MapPieces:
        """Reads a map, unless it is the one that was read last.

        Args:
            road_map: The map of the episode.

        Returns:
            Its pieces.
        """
        if self._map is not None and self._map[0] is road_map:
            return self._map[1]
        pieces = cut_map(road_map)
        # One dummy piece is added, which no road user refers to: ONNX engines reject empty inputs.
        (self._code,) = self._read_map(
            shape=np.pad(pieces.shape, ((0, 1), (0, 0), (0, 0))),
            attributes=np.pad(pieces.attributes, ((0, 1), (0, 0))),
        )
        # Single precision resolves centimetres only within kilometres of the origin.
        self._origin = np.zeros(3)
        if len(pieces.pose):
            self._origin[:2] = pieces.pose[0, :2]
        self._piece_pose = np.pad(pieces.pose - self._origin, ((0, 1), (0, 0))).astype(np.float32)
        self._lights = find_lights(road_map) if self._read_lights else None
        self._map, self._last = (road_map, pieces), None
        return pieces

    def encode(self, observation: Observation) -> Encoded:
        """Runs the network.

        Args:
            observation: What is known now.

        Returns:
            Features and trajectories of all road users that can move.
        """
        if self._last is not None and self._last[0] is observation:
            return self._last[1]
        road = self.prepare(observation.road_map)
        seen = describe(observation, road)
        moving = np.flatnonzero(observation.moves)
        pose = seen.pose.astype(np.float32)
        pose[:, :2] = seen.pose[:, :2] - self._origin[:2]
        features = np.zeros((0, 0), dtype=np.float32)
        trajectory = np.zeros((0, 1, HORIZON, 2), dtype=np.float32)
        log_weight = np.zeros((0, 1), dtype=np.float32)
        if len(moving):
            trajectory, log_weight, features = self._read_scene(
                pose=pose,
                history=seen.history,
                static=seen.static,
                targets=moving,
                neighbours=seen.neighbours[moving],
                pieces=seen.pieces[moving],
                piece_code=self._code,
                piece_pose=self._piece_pose,
            )
        if self._read_lights and self._lights:
            lights = describe_lights(observation, self._lights)[moving]
            rows = np.flatnonzero(lit(lights))
            if len(rows):
                trajectory = np.array(trajectory)
                (trajectory[rows],) = self._read_lights(
                    features=features[rows],
                    trajectory=trajectory[rows],
                    velocity=pose[moving[rows], 3],
                    lights=lights[rows],
                )
        encoded = Encoded(
            moving,
            features,
            trajectory,
            log_weight,
            seen.history[moving],
            pose[moving, 3],
            seen,
            road.pose,
        )
        self._last = (observation, encoded)
        return encoded


def shipped_weights() -> Path:
    """The weights that come with the package.

    Returns:
        The file.
    """
    return Path(str(resources.files("dosplan_net") / "weights" / SHIPPED))


def lights_beside(weights: Path) -> Path | None:
    """The response to lights that was trained on a network.

    Args:
        weights: The network's weights.

    Returns:
        The response's weights, which lie beside them; None where there are none.
    """
    path = weights.with_suffix(BESIDE)
    return path if path.is_file() else None


@lru_cache(maxsize=4)
def shared_encoder(weights: Path, engine: Engine, threads: int, lights: bool) -> SceneEncoder:
    """One encoder for all predictors of a process that use the same weights in the same way.

    Args:
        weights: The weights.
        engine: What runs the network.
        threads: Threads it may use.
        lights: Whether traffic lights are looked at, where the weights have a response to them.

    Returns:
        The encoder.

    Raises:
        EngineError: The engine cannot run these weights.
        WeightsError: The weights cannot be read.
    """
    parts = [open_function(model, weights, engine, threads) for model in (MAP, SCENE)]
    if lights and lights_beside(weights) is not None:
        parts.append(open_function(LIGHTS, weights, engine, threads))
    return SceneEncoder(*parts)
