"""``net-v5``: the trained trajectory network as a predictor. Its sets are points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dosplan.api import Predictor, PredictorSettings
from dosplan.geometry import to_world
from dosplan.types import (
    USER_HEADING,
    FloatArray,
    IntArray,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
)
from dosplan_net.encoder import lights_beside, shared_encoder, shipped_weights
from dosplan_net.engine import Engine
from dosplan_net.features import HORIZON

HEADING_SPAN = 3  # Steps on either side whose chord gives the heading at a step.
REVERSING = 0.1  # m; shorter chords do not tell whether a road user goes backwards.
HEADING_MEMORY = 0.5  # m; on a chord much shorter than this, the present heading is kept.


def check_horizon(horizon: int) -> None:
    """Refuses a horizon that the network was not trained for.

    Args:
        horizon: Steps that are asked for.

    Raises:
        ValueError: They are more than ``HORIZON``.
    """
    if horizon > HORIZON:
        raise ValueError(f"horizon is {horizon}, expected {HORIZON} or less")


def check_file(option: str, path: Path | None) -> None:
    """Refuses a setting that names a file which is not there.

    Args:
        option: Name of the setting.
        path: Its value.

    Raises:
        ValueError: There is no such file.
    """
    if path is not None and not path.is_file():
        raise ValueError(f"{option} is {path}, and there is no such file")


@dataclass(frozen=True)
class NetSettings(PredictorSettings):
    """The options of the trajectory network.

    Attributes:
        horizon: Number T of steps to predict, at most 40.
        weights: Weights of another training; the shipped ones by default.
        threads: Threads that the network may use.
        engine: What runs the network: ``torch``, or ``onnx``, which is quicker; its files are made
            with ``dosplan export``.
        lights: Whether traffic lights are looked at, where the weights have a response to them.
    """

    weights: Path | None = None
    threads: int = 1
    engine: Engine = Engine.TORCH
    lights: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_horizon(self.horizon)
        check_file("weights", self.weights)
        if self.threads < 1:
            raise ValueError(f"threads is {self.threads}, expected 1 or more")


class NetPredictor(Predictor):
    """Trajectories of the trained network; parked and static road users stay where they are."""

    name = "net-v5"
    settings = NetSettings
    has_sets = False

    def __init__(self, *, seed: int = 0, settings: NetSettings = NetSettings()) -> None:
        """Loads the network.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.

        Raises:
            EngineError: The engine is missing, or cannot run these weights.
            WeightsError: The weights cannot be read.
        """
        super().__init__(seed=seed, settings=settings)
        self._weights = settings.weights or shipped_weights()
        self._lights = lights_beside(self._weights) if settings.lights else None
        self.encoder = shared_encoder(
            self._weights, settings.engine, settings.threads, settings.lights
        )

    def weight_files(self) -> tuple[Path, ...]:
        """The network, and its response to lights."""
        return tuple(path for path in (self._weights, self._lights) if path is not None)

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:
        """Reads the map."""
        self.encoder.prepare(road_map)

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Runs the network.

        Returns:
            The most likely trajectories, with points for sets.
        """
        encoded = self.encoder.encode(observation)
        local = encoded.likeliest[:, : self.horizon].astype(np.float64)
        return placed(observation, encoded.moving, local)


def placed(observation: Observation, moving: IntArray, local: FloatArray) -> Occupancy:
    """Trajectories in the scenario's frame, with headings along them.

    Args:
        observation: What is known now; N road users.
        moving: (M,) rows of those that can move; the others stay where they are.
        local: (M, T, 2) their trajectories, each in its road user's frame, m.

    Returns:
        Points for all N road users.
    """
    now = observation.states[:, -1]
    steps = local.shape[1]
    centre = np.repeat(now[:, None, :2], steps, axis=1)
    heading = np.repeat(now[:, USER_HEADING, None], steps, axis=1)
    centre[moving] = to_world(local, now[moving, :3])
    heading[moving] += turned(local)
    return Occupancy.from_trajectory(observation, centre, heading)


def turned(local: FloatArray) -> FloatArray:
    """Headings along trajectories.

    The direction of the chord around each step, blended with the present heading where the chord
    is short: the direction of a trajectory that hardly moves is noise. Where the first chord that
    is long enough to tell points backwards, the road user is taken to reverse.

    Args:
        local: (..., T, 2) trajectories, each in its road user's frame, m.

    Returns:
        (..., T) headings against the present one, rad.
    """
    with_start = np.concatenate((np.zeros_like(local[..., :1, :]), local), axis=-2)
    steps = np.arange(1, with_start.shape[-2])
    later = np.minimum(steps + HEADING_SPAN, with_start.shape[-2] - 1)
    earlier = np.maximum(steps - HEADING_SPAN, 0)
    chord = with_start[..., later, :] - with_start[..., earlier, :]
    ahead = chord[..., 0]
    first = np.argmax(np.abs(ahead) > REVERSING, axis=-1, keepdims=True)
    reverses = np.take_along_axis(ahead, first, axis=-1) < -REVERSING
    chord *= np.where(reverses, -1.0, 1.0)[..., None]
    angle = np.arctan2(chord[..., 1], chord[..., 0] + HEADING_MEMORY)
    return np.asarray(np.unwrap(angle, axis=-1), dtype=np.float64)
