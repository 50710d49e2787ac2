"""``dos-v2``: dynamic occupancy sets around the trajectories of any predictor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from dosplan_net.encoder import Encoded, shared_encoder, shipped_weights
from dosplan_net.engine import Engine, Function, Model, open_function
from dosplan_net.features import HORIZON, Float32Array
from dosplan_net.predictor import NetPredictor, NetSettings, check_file, check_horizon

from dosplan.api import PluginSpec, Predictor, PredictorSettings
from dosplan.geometry import to_body
from dosplan.types import (
    USER_HEADING,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
)
from dosplan_dos.adaptation import Adaptation
from dosplan_dos.calibration import (
    CalibratedFor,
    Calibration,
    Mode,
    calibration_file,
    load_calibrations,
)
from dosplan_dos.grid import every_step
from dosplan_dos.sizes import ConditionalSizes, FixedSizes, GroupSizes, Sizes

if TYPE_CHECKING:
    from dosplan_dos.graph import SetsGraph

DEFAULT_SETS = "coverage"
DEFAULT_SCALE = 0.5
WEIGHTS: Final = ".safetensors"
"""End of the name of a weight file."""


def _load_sets(weights: Path) -> SetsGraph:
    from dosplan_dos.graph import SetsGraph
    from dosplan_dos.training import load_module

    return SetsGraph(load_module(weights))


SETS: Final = Model(_load_sets, suffix=".onnx", option="--sets")


@dataclass(frozen=True)
class DosSettings(PredictorSettings):
    """The options of dynamic occupancy sets.

    Attributes:
        horizon: Number T of steps to predict, at most 40.
        sets: Name of a shipped module (``coverage``, ``free``, ``pr`` ...) or a weight file, whose
            name ends with ``.safetensors``.
        scale: Factor on the semi-axes, such as the number of standard deviations of ``pr``; by
            default a half, which did best in closed loop on training and validation scenarios:
            sets that cover nine in ten block lanes that are free. Not used with ``coverage``.
        coverage: Share of the true centres that the sets are to cover, in (0, 1), in place of
            ``scale``; the sets are calibrated on recordings for it.
        calibration: The loop that the sets are calibrated for: ``ideal``, where road users are
            seen exactly, or ``realistic``, as its sensors see them. A ``scale`` then stands for
            the coverage that it has in the ideal loop, so that the sets know of the errors of
            what is seen. ``auto`` follows the run: ``realistic`` where its sensors err, unless
            only a scale is asked for and the module is not calibrated for it.
        conditional: Whether the factors of a coverage follow what is known of each road user (the
            noise of its track, whether it brakes or turns, the road ahead, its leader), instead of
            its kind and speed alone.
        adaptation: How fast the sets of a road user grow, in an episode, where it leaves earlier
            ones, for a coverage; 0.2 makes them a fifth larger at a step at which all failed. By
            default they do not; ``adaptation`` says what it guarantees.
        simultaneous: Whether to cover all steps of the horizon at once with that probability,
            instead of each step.
        base: Where the centres come from; by default the network of ``network``.
        network: Weights of the trajectory network that the module was trained on; the shipped
            ones by default.
        threads: Threads that the network and the module may use.
        engine: What runs them: ``torch``, or ``onnx``, which is quicker; its files are made with
            ``dosplan export``.
        lights: Whether the network looks at traffic lights, where its weights have a response to
            them.
    """

    sets: str = DEFAULT_SETS
    scale: float = DEFAULT_SCALE
    coverage: float | None = None
    calibration: CalibratedFor = CalibratedFor.AUTO
    conditional: bool = False
    adaptation: float = 0.0
    simultaneous: bool = False
    base: PluginSpec[Predictor] | None = None
    network: Path | None = None
    threads: int = 1
    engine: Engine = Engine.TORCH
    lights: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_horizon(self.horizon)
        if self.coverage is not None and self.scale != DEFAULT_SCALE:
            raise ValueError("give a scale or a coverage, not both")
        if self.scale < 0.0:
            raise ValueError(f"scale is {self.scale}, expected 0 or more")
        if not 0.0 <= self.adaptation <= 1.0:
            raise ValueError(f"adaptation is {self.adaptation}, expected 0 to 1")
        for name in ("conditional", "adaptation"):
            if getattr(self, name) and self.coverage is None:
                raise ValueError(f"{name} goes with a coverage only")
        if self.coverage is not None and not 0.0 < self.coverage < 1.0:
            raise ValueError(f"coverage is {self.coverage}, expected a share between 0 and 1")
        if self.base is not None:
            self.check_reach(self.base)
        check_file("network", self.network)
        if self.sets.endswith(WEIGHTS):
            check_file("sets", Path(self.sets))
        if self.threads < 1:
            raise ValueError(f"threads is {self.threads}, expected 1 or more")

    @property
    def sets_file(self) -> Path:
        """The weights of the module.

        Raises:
            ValueError: There is no shipped module of that name.
        """
        return Path(self.sets) if self.sets.endswith(WEIGHTS) else shipped_sets(self.sets)

    def seen_by(self, *, exact: bool) -> Self:
        """Chooses the calibration that is left to the loop."""
        if self.calibration is not CalibratedFor.AUTO:
            return self
        chosen = CalibratedFor.IDEAL
        if not exact:
            there = calibration_file(self.sets_file, CalibratedFor.REALISTIC).is_file()
            if there or self.coverage is not None:
                chosen = CalibratedFor.REALISTIC
        return replace(self, calibration=chosen)


class DosPredictor(Predictor):
    """Ellipses that a trained module puts around predicted centres.

    The module was trained on the errors of one trajectory predictor, that of ``base`` by default.
    It takes the trajectories of any other as well; how much its sets then cover has to be
    measured with ``dosplan evaluate``. Parked and static road users keep sets of zero.
    """

    name = "dos-v2"
    settings = DosSettings

    def __init__(self, *, seed: int = 0, settings: DosSettings = DosSettings()) -> None:
        """Loads the network, the module and, where it is used, its calibration.

        Args:
            seed: Seed of the run, for the trajectory predictor; nothing here is random.
            settings: The options.

        Raises:
            EngineError: The engine is missing, or cannot run these weights.
            ValueError: There is no calibration for the coverage or the loop.
            WeightsError: The weights cannot be read.
        """
        super().__init__(seed=seed, settings=settings)
        own = PluginSpec(
            NetPredictor,
            NetSettings(
                horizon=settings.horizon,
                weights=settings.network,
                threads=settings.threads,
                engine=settings.engine,
                lights=settings.lights,
            ),
        )
        self.base: Predictor = (settings.base or own).build(seed)
        network, sets = settings.network or shipped_weights(), settings.sets_file
        self._sizes, calibrations = _sizes(settings)
        self._rate, self._coverage = settings.adaptation, settings.coverage
        self._adaptation = self._new_adaptation()
        self._files = (network, sets, *calibrations)
        self._module = shared_module(sets, settings.engine, settings.threads)
        self.encoder = shared_encoder(network, settings.engine, settings.threads, settings.lights)

    def weight_files(self) -> tuple[Path, ...]:
        """The network, the module, its calibrations where it uses any, and what the base uses."""
        return tuple(dict.fromkeys((*self._files, *self.base.weight_files())))

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:
        """Begins an episode of the trajectory predictor and reads the map."""
        self._adaptation = self._new_adaptation()
        self.base.reset(task, road_map)
        self.encoder.prepare(road_map)

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Puts the sets around the base's centres.

        Returns:
            The base's trajectories with ellipses.
        """
        trajectory = self.base.predict(observation).likeliest()
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
            lengths *= self._sizes.factors(observation, encoded)[..., None]
            if self._adaptation is not None:
                lengths *= self._adaptation.observe(observation)[moving, None, None]
            semi_axes[moving] = every_step(lengths)[:, : self.horizon]
            double = every_step(turned)[:, : self.horizon]
            heading = observation.states[moving, -1, USER_HEADING, None]
            angle[moving] = heading + 0.5 * np.arctan2(double[..., 1], double[..., 0])
        sets = replace(trajectory.first_steps(self.horizon), semi_axes=semi_axes, angle=angle)
        if self._adaptation is not None:
            self._adaptation.remember(observation, sets)
        return sets

    def _new_adaptation(self) -> Adaptation | None:
        """What is learned in an episode, at its beginning; None where nothing is."""
        if not self._rate or self._coverage is None:
            return None
        return Adaptation(self._rate, self._coverage)

    def _local(
        self, observation: Observation, trajectory: Occupancy, encoded: Encoded
    ) -> Float32Array:
        """(M, HORIZON, 2) the base's centres in each road user's frame, m.

        Where the base has no prediction, at a step that is not valid or beyond its horizon, the
        last predicted position before it is repeated.
        """
        if isinstance(self.base, NetPredictor) and self.base.encoder is self.encoder:
            return encoded.trajectory
        now = observation.states[encoded.moving, -1]
        centre = trajectory.centre[encoded.moving, :HORIZON]
        valid = trajectory.valid[encoded.moving, :HORIZON]
        known = np.maximum.accumulate(np.where(valid, np.arange(centre.shape[1]), -1), axis=1)
        last = np.take_along_axis(centre, np.maximum(known, 0)[..., None], axis=1)
        last = np.where(known[..., None] < 0, now[:, None, :2], last)
        beyond = np.repeat(last[:, -1:], HORIZON - last.shape[1], axis=1)
        local = to_body(np.concatenate((last, beyond), axis=1), now[:, :3])
        return local.astype(np.float32)


def _sizes(settings: DosSettings) -> tuple[Sizes, tuple[Path, ...]]:
    """The factors on the sets as they were trained, and the files that they come from.

    Outside of a run, ``AUTO`` is the ideal loop.
    """
    sets, loop = settings.sets_file, settings.calibration
    if loop is CalibratedFor.AUTO:
        loop = CalibratedFor.IDEAL
    if (level := settings.coverage) is not None:
        mode = Mode.SIMULTANEOUS if settings.simultaneous else Mode.PER_STEP
        made = shipped_calibration(sets, mode, loop, settings.conditional)
        # A level that is too high is refused here, not in the first episode.
        table = made.table(level)
        sizes = ConditionalSizes(made, level) if settings.conditional else GroupSizes(table)
        return sizes, (calibration_file(sets, loop),)
    if loop is CalibratedFor.IDEAL:
        return FixedSizes(settings.scale), ()
    loops = (loop, CalibratedFor.IDEAL)
    own, ideal = (shipped_calibration(sets, Mode.PER_STEP, of) for of in loops)
    files = tuple(calibration_file(sets, of) for of in loops)
    return GroupSizes(own.table_like(ideal, settings.scale)), files


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
        engine: What runs it.
        threads: Threads it may use.

    Returns:
        The module.

    Raises:
        EngineError: The engine cannot run these weights.
        WeightsError: The weights cannot be read.
    """
    return open_function(SETS, weights, engine, threads)


@lru_cache(maxsize=8)
def shipped_calibration(
    weights: Path, mode: Mode, loop: CalibratedFor, conditional: bool = False
) -> Calibration:
    """The calibration in the folder of a module's weights.

    Args:
        weights: The weights.
        mode: Per step or simultaneous.
        loop: The loop that it is for.
        conditional: Whether it is to depend on what is known of each road user.

    Returns:
        The calibration.

    Raises:
        ValueError: There is none.
    """
    path = calibration_file(weights, loop)
    if not path.is_file():
        raise ValueError(
            f"{path.name}: the sets {weights.stem!r} were never calibrated for the loop {loop}; "
            "calibrate them with dosplan train calibration, or leave coverage and calibration out"
        )
    return load_calibrations(path, conditional=conditional)[mode]
