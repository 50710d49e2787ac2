"""``dos-v1``: dynamic occupancy sets around the trajectories of any predictor."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from dosplan_net.encoder import Encoded, shared_encoder, shipped_weights
from dosplan_net.engine import Engine, Function, Model, open_function
from dosplan_net.features import HORIZON, Float32Array
from dosplan_net.predictor import NetPredictor, check_horizon

from dosplan.api import Predictor
from dosplan.geometry import to_body
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
)
from dosplan_dos.calibration import Calibration, Mode, load_calibrations
from dosplan_dos.grid import every_step

if TYPE_CHECKING:
    from dosplan_dos.graph import SetsGraph

DEFAULT_SETS = "coverage"
DEFAULT_SCALE = 0.5


def _load_sets(weights: Path) -> SetsGraph:
    from dosplan_dos.graph import SetsGraph
    from dosplan_dos.training import load_module

    return SetsGraph(load_module(weights))


SETS: Final = Model(_load_sets, suffix=".onnx", option="--sets")


class DosPredictor(Predictor):
    """Ellipses that a trained module puts around predicted centres.

    The module was trained on the errors of one trajectory predictor, that of ``base`` by default.
    It takes the trajectories of any other as well; how much its sets then cover is for
    ``dosplan evaluate`` to say. Parked and static road users keep sets of zero.
    """

    name = "dos-v1"

    def __init__(
        self,
        *,
        seed: int = 0,
        horizon: int = HORIZON,
        sets: str | Path = DEFAULT_SETS,
        scale: float | None = None,
        coverage: float | None = None,
        simultaneous: bool = False,
        base: Predictor | None = None,
        network: Path | None = None,
        threads: int = 1,
        engine: str = Engine.TORCH,
    ) -> None:
        """Loads the network, the module and, where a coverage is asked for, its calibration.

        Args:
            seed: Seed of the run; nothing here is random.
            horizon: Number T of steps to predict, at most 40.
            sets: Name of a shipped module (``coverage``, ``free``, ``pr`` ...) or a weight file.
            scale: Factor on the semi-axes, such as the number of standard deviations of ``pr``; by
                default a half, which did best in closed loop on training and validation
                scenarios: sets that cover nine in ten block lanes that are free.
            coverage: Share of the true centres that the sets are to cover, in (0, 1); the sets
                are calibrated on recordings for it; not together with ``scale``.
            simultaneous: Whether to cover all steps of the horizon at once with that probability,
                instead of each step.
            base: Where the centres come from; the trained network by default.
            network: Weights of the trajectory network that the module was trained on; the shipped
                ones by default.
            threads: Threads that the network and the module may use.
            engine: Who runs them: ``torch``, or ``onnx``, which is quicker; its files are made
                with ``dosplan export``.

        Raises:
            EngineError: The engine is missing, or cannot run these weights.
            ValueError: The horizon is too long or not the base's, scale and coverage are both
                given, or there is no calibration for the coverage.
            WeightsError: The weights cannot be read.
        """
        super().__init__(seed=seed, horizon=horizon)
        check_horizon(self.name, horizon)
        self.base = base or NetPredictor(
            seed=seed, horizon=horizon, weights=network, threads=threads, engine=engine
        )
        if self.base.horizon != horizon:
            raise ValueError(
                f"{self.name}: base predicts {self.base.horizon} steps, horizon is {horizon}; "
                "make them equal"
            )
        if scale is not None and coverage is not None:
            raise ValueError(f"{self.name}: give a scale or a coverage, not both")
        self.coverage = coverage
        # Calibrated factors are for the sets as they were trained.
        self.scale = (1.0 if coverage is not None else DEFAULT_SCALE) if scale is None else scale
        self._module = shared_module(
            shipped_sets(sets) if isinstance(sets, str) else sets, Engine(engine), threads
        )
        self.encoder = shared_encoder(network or shipped_weights(), Engine(engine), threads)
        self._calibration = None
        if coverage is not None:
            mode = Mode.SIMULTANEOUS if simultaneous else Mode.PER_STEP
            self._calibration = shipped_calibration(sets, mode)
            # A level that no scene can have is refused here, not in the first episode.
            self._calibration.factors(coverage, np.zeros(0), [])

    @classmethod
    def weight_files(cls) -> tuple[Path, ...]:
        """The shipped network and the default module.

        Returns:
            Their files.
        """
        return (shipped_weights(), shipped_sets(DEFAULT_SETS))

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:
        """Begins an episode of the trajectory predictor and reads the map.

        Args:
            task: Start, goal and route of the ego.
            road_map: The map.
        """
        self.base.reset(task, road_map)
        self.encoder.prepare(road_map)

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Puts the sets around the base's centres.

        Args:
            observation: What is known now.

        Returns:
            The base's trajectories with ellipses.
        """
        trajectory = self.base.predict(observation)
        encoded = self.encoder.encode(observation)
        semi_axes = np.zeros((len(observation.ids), self.horizon, 2))
        angle = np.zeros((len(observation.ids), self.horizon))
        moving = encoded.moving
        if len(moving):
            path = self._local(observation, trajectory, encoded)
            made = self._module(
                features=encoded.features,
                trajectory=path,
                velocity=encoded.velocity,
                history=encoded.history,
            )
            lengths, turned = (array.astype(np.float64) for array in made)
            lengths *= self.scale
            if self._calibration is not None and self.coverage is not None:
                factors = self._calibration.factors(
                    self.coverage,
                    np.abs(observation.states[moving, -1, USER_VELOCITY]),
                    [observation.kinds[row] for row in moving],
                )
                lengths *= factors[..., None]
            semi_axes[moving] = every_step(lengths)[:, : self.horizon]
            double = every_step(turned)[:, : self.horizon]
            heading = observation.states[moving, -1, USER_HEADING, None]
            angle[moving] = heading + 0.5 * np.arctan2(double[..., 1], double[..., 0])
        return replace(trajectory, semi_axes=semi_axes, angle=angle)

    def _local(
        self, observation: Observation, trajectory: Occupancy, encoded: Encoded
    ) -> Float32Array:
        """(M, HORIZON, 2) the base's centres in each road user's frame, m.

        Where the base says nothing, beyond its horizon or about a step, its last word stands.
        """
        if isinstance(self.base, NetPredictor) and self.base.encoder is self.encoder:
            return encoded.trajectory
        now = observation.states[encoded.moving, -1]
        centre = trajectory.centre[encoded.moving]
        valid = trajectory.valid[encoded.moving]
        known = np.maximum.accumulate(np.where(valid, np.arange(centre.shape[1]), -1), axis=1)
        last = np.take_along_axis(centre, np.maximum(known, 0)[..., None], axis=1)
        last = np.where(known[..., None] < 0, now[:, None, :2], last)
        beyond = np.repeat(last[:, -1:], HORIZON - last.shape[1], axis=1)
        local = to_body(np.concatenate((last, beyond), axis=1), now[:, :3])
        return local.astype(np.float32)


def shipped_sets(name: str) -> Path:
    """The weights of a module that comes with the package.

    Args:
        name: Its name.

    Returns:
        The file.

    Raises:
        ValueError: There is none of that name.
    """
    folder = Path(str(resources.files("dosplan_dos") / "weights"))
    path = folder / f"{name}.safetensors"
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in folder.glob("*.safetensors")))
        raise ValueError(f"there are no sets called {name!r}; choose from {names}")
    return path


@lru_cache(maxsize=32)
def shared_module(weights: Path, engine: Engine, threads: int) -> Function:
    """One module for all predictors of a process that use the same weights in the same way.

    Args:
        weights: The weights.
        engine: Who runs it.
        threads: Threads it may use.

    Returns:
        The module.

    Raises:
        EngineError: The engine cannot run these weights.
        WeightsError: The weights cannot be read.
    """
    return open_function(SETS, weights, engine, threads)


@lru_cache(maxsize=8)
def shipped_calibration(sets: str | Path, mode: Mode) -> Calibration:
    """The calibration that lies beside a module's weights.

    Args:
        sets: As for ``DosPredictor``.
        mode: Per step or simultaneous.

    Returns:
        The calibration.

    Raises:
        ValueError: There is none.
    """
    weights = shipped_sets(sets) if isinstance(sets, str) else sets
    path = weights.with_suffix(".calibration.npz")
    if not path.is_file():
        raise ValueError(
            f"{path.name}: the sets {weights.stem!r} were never calibrated; "
            "leave coverage out or calibrate them with dosplan train dos"
        )
    return load_calibrations(path)[mode]
