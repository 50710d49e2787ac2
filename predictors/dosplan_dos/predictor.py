"""``dos-v6``: dynamic occupancy sets around the trajectories of any predictor."""

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
from dosplan_net.predictor import NetPredictor, NetSettings, check_file, check_horizon, turned

from dosplan.api import PluginSpec, Predictor, PredictorSettings
from dosplan.geometry import occupancy_of_union, to_body, to_world
from dosplan.types import (
    USER_HEADING,
    FloatArray,
    IntArray,
    Observation,
    Occupancy,
    PlanningTask,
    RoadMap,
    SetUnion,
)
from dosplan_dos.adaptation import Adaptation
from dosplan_dos.calibration import (
    CalibratedFor,
    Calibration,
    Mode,
    calibration_file,
    load_calibrations,
)
from dosplan_dos.grid import GRID, every_step
from dosplan_dos.sizes import ConditionalSizes, FixedSizes, GroupSizes, Sizes

if TYPE_CHECKING:
    from dosplan_net.graphs import Graph

DEFAULT_SETS: Final = {CalibratedFor.IDEAL: "union", CalibratedFor.REALISTIC: "union-realistic"}
"""The module that is used where none is named, by the loop that it is calibrated for."""
DEFAULT_COVERAGE: Final = {CalibratedFor.IDEAL: 0.9, CalibratedFor.REALISTIC: 0.8}
"""Share of the true centres that the sets cover where nothing else is asked for, by the loop that
they are calibrated for. Where sensors err, 90 % take so much room that the ego hardly gets past."""
WEIGHTS: Final = ".safetensors"
"""End of the name of a weight file."""


def _load_sets(weights: Path) -> Graph:
    from dosplan_dos.graph import SetsGraph, UnionGraph
    from dosplan_dos.module import UnionModule
    from dosplan_dos.training import load_module

    module = load_module(weights)
    return UnionGraph(module) if isinstance(module, UnionModule) else SetsGraph(module)


SETS: Final = Model(_load_sets, suffix=".onnx", option="--sets")


@dataclass(frozen=True)
class DosSettings(PredictorSettings):
    """The options of dynamic occupancy sets.

    Attributes:
        horizon: Number T of steps to predict, at most 40.
        sets: Name of a shipped module (``union``, ``coverage``, ``free``, ``pr`` ...) or a weight
            file, whose name ends with ``.safetensors``. By default ``union``, and
            ``union-realistic``, which was trained on what a realistic loop sees, where the sets are
            calibrated for that and no scale is given.
        scale: Factor on the semi-axes that were trained, such as the number of standard deviations
            of ``pr``, in place of a coverage; a module that has no calibration has 1 by default.
        coverage: Share of the true centres that the sets are to cover at each step, in (0, 1); the
            sets are calibrated on recordings for it. By default that of ``DEFAULT_COVERAGE``, which
            was chosen in closed loop on training and validation scenarios, unless there is a scale.
        calibration: The loop that the sets are calibrated for: ``ideal``, where road users are
            seen exactly, or ``realistic``, as its sensors see them. A ``scale`` then stands for
            the coverage that it has in the ideal loop, so that the sets know of the errors of
            what is seen. ``auto`` follows the run: ``realistic`` where its sensors err, unless
            no coverage is asked for and the module is not calibrated for it.
        conditional: Whether the factors of a coverage follow what is known of each road user (the
            noise of its track, whether it brakes or turns, the road ahead, its leader), instead of
            its kind and speed alone.
        adaptation: How fast the sets of a road user grow, in an episode, where it leaves earlier
            ones, for a coverage. At a step at which all failed, 0.2 makes them 20 % larger where
            90 % are to be covered, and 15 % where 70 % are. By default they do not grow; the
            module ``adaptation`` says what is guaranteed.
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

    sets: str | None = None
    scale: float | None = None
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
        if self.coverage is not None and self.scale is not None:
            raise ValueError("give a scale or a coverage, not both")
        if self.scale is not None and self.scale < 0.0:
            raise ValueError(f"scale is {self.scale}, expected 0 or more")
        if not 0.0 <= self.adaptation <= 1.0:
            raise ValueError(f"adaptation is {self.adaptation}, expected 0 to 1")
        for name in ("conditional", "adaptation", "simultaneous"):
            if getattr(self, name) and self.scale is not None:
                raise ValueError(f"{name} goes with a coverage, not with a scale")
        if self.coverage is not None and not 0.0 < self.coverage < 1.0:
            raise ValueError(f"coverage is {self.coverage}, expected a share between 0 and 1")
        if self.base is not None:
            self.check_reach(self.base)
        check_file("network", self.network)
        if self.sets is not None and self.sets.endswith(WEIGHTS):
            check_file("sets", Path(self.sets))
        if self.threads < 1:
            raise ValueError(f"threads is {self.threads}, expected 1 or more")

    @property
    def sets_file(self) -> Path:
        """The weights of the module.

        Raises:
            ValueError: There is no shipped module of that name.
        """
        name = self.sets
        if name is None:
            name = DEFAULT_SETS[CalibratedFor.IDEAL if self.scale is not None else self._loop]
        return Path(name) if name.endswith(WEIGHTS) else shipped_sets(name)

    @property
    def level(self) -> float | None:
        """The coverage that the sets are calibrated to; None where they have a scale."""
        if self.coverage is not None or self.scale is not None:
            return self.coverage
        loops = {CalibratedFor.IDEAL, self._loop}
        there = any(calibration_file(self.sets_file, one).is_file() for one in loops)
        asked = there or self.conditional or self.simultaneous or self.adaptation > 0.0
        return DEFAULT_COVERAGE[self._loop] if asked else None

    @property
    def _loop(self) -> CalibratedFor:
        """The loop that the sets are calibrated for; the ideal one where nobody has chosen yet."""
        left = self.calibration is CalibratedFor.AUTO
        return CalibratedFor.IDEAL if left else self.calibration

    def seen_by(self, *, exact: bool) -> Self:
        """Chooses the calibration that is left to the loop."""
        if self.calibration is not CalibratedFor.AUTO:
            return self
        realistic = replace(self, calibration=CalibratedFor.REALISTIC)
        there = calibration_file(realistic.sets_file, CalibratedFor.REALISTIC).is_file()
        if not exact and (there or self.coverage is not None):
            return realistic
        return replace(self, calibration=CalibratedFor.IDEAL)


class DosPredictor(Predictor):
    """Ellipses that a trained module puts around predicted centres.

    The module was trained on the errors of one trajectory predictor, that of ``base`` by default.
    It takes the trajectories of any other as well; how much its sets then cover has to be
    measured with ``dosplan evaluate``. Parked and static road users keep sets of zero.
    """

    name = "dos-v6"
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
        self._rate, self._coverage = settings.adaptation, settings.level
        self._adaptation = self._new_adaptation()
        self._files = (network, sets, *calibrations)
        self._module = shared_module(sets, settings.engine, settings.threads)
        self.encoder = shared_encoder(network, settings.engine, settings.threads, settings.lights)
        self._own_base = isinstance(self.base, NetPredictor) and self.base.encoder is self.encoder

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
            The base's trajectories with ellipses, or with a union of them, one for each course of
            events that the network foretells.
        """
        encoded = self.encoder.encode(observation)
        trajectory = None if self._own_base else self.base.predict(observation).likeliest()
        sets = self._sets(observation, encoded, trajectory)
        if self._adaptation is not None:
            self._adaptation.remember(observation, sets)
        return sets

    def _sets(
        self, observation: Observation, encoded: Encoded, trajectory: Occupancy | None
    ) -> Occupancy:
        """The sets around a trajectory; around the network's own where that is None."""
        grown = None if self._adaptation is None else self._adaptation.observe(observation)
        courses, log_weight = encoded.trajectory, encoded.log_weight
        if trajectory is not None:
            courses, log_weight = _only_course(observation, encoded, trajectory)
        if not len(encoded.moving):
            # The sets that a base may have are not what was asked for.
            whole = trajectory or self.base.predict(observation)
            return whole.first_steps(self.horizon).without_sets()
        likeliest = courses[np.arange(len(courses)), log_weight.argmax(axis=1)]
        semi_axes, double, *centre = (
            array.astype(np.float64)
            for array in self._module(
                features=encoded.features,
                trajectory=likeliest,
                trajectories=courses,
                log_weight=log_weight,
                velocity=encoded.velocity,
                history=encoded.history,
            )
        )
        factor = self._sizes.factors(observation, encoded)
        if grown is not None:
            factor = factor * grown[encoded.moving, None]
        if not centre:
            sets = _Sets(semi_axes[:, None], double[:, None], likeliest[:, None], None)
            lengths, angle, _ = sets.every_step(factor, self.horizon)
            angle = angle[:, 0] + observation.states[encoded.moving, -1, USER_HEADING, None]
            whole = (trajectory or self.base.predict(observation)).first_steps(self.horizon)
            return _around(whole, encoded, lengths[:, 0], angle)
        sets = _Sets(semi_axes, double, courses, centre[0])
        union = _union(
            observation,
            encoded.moving,
            log_weight,
            courses[:, :, : self.horizon],
            sets.every_step(factor, self.horizon),
        )
        valid = None if trajectory is None else trajectory.valid[:, : self.horizon]
        return occupancy_of_union(observation, union, valid)

    def _new_adaptation(self) -> Adaptation | None:
        """What is learned in an episode, at its beginning; None where nothing is."""
        if not self._rate or self._coverage is None:
            return None
        return Adaptation(self._rate, self._coverage)


def _only_course(
    observation: Observation, encoded: Encoded, trajectory: Occupancy
) -> tuple[Float32Array, Float32Array]:
    """(T, 1, HORIZON, 2) a trajectory in each road user's frame, m, and (T, 1) its log weight, 0.

    Where there is no prediction, at a step that is not valid or beyond the horizon, the last
    predicted position before it is repeated.
    """
    now = observation.states[encoded.moving, -1]
    centre = trajectory.centre[encoded.moving, :HORIZON]
    valid = trajectory.valid[encoded.moving, :HORIZON]
    known = np.maximum.accumulate(np.where(valid, np.arange(centre.shape[1]), -1), axis=1)
    last = np.take_along_axis(centre, np.maximum(known, 0)[..., None], axis=1)
    last = np.where(known[..., None] < 0, now[:, None, :2], last)
    beyond = np.repeat(last[:, -1:], HORIZON - last.shape[1], axis=1)
    local = to_body(np.concatenate((last, beyond), axis=1), now[:, :3])
    return local.astype(np.float32)[:, None], np.zeros((len(now), 1), dtype=np.float32)


@dataclass(frozen=True)
class _Sets:
    """What a module made: M ellipses for each of T road users at the G steps of its grid.

    Attributes:
        semi_axes: (T, M, G, 2) m.
        double_angle: (T, M, G, 2) see ``shapes.Ellipses``.
        courses: (T, M, HORIZON, 2) the trajectories they were made for, m.
        centre: (T, M, G, 2) their centres, m; None where these are the trajectories.
    """

    semi_axes: FloatArray
    double_angle: FloatArray
    courses: Float32Array
    centre: FloatArray | None

    def every_step(
        self, factor: FloatArray, horizon: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fills the steps between those of the grid.

        Args:
            factor: (T, G) on the semi-axes, or one for all.
            horizon: Steps H to keep.

        Returns:
            (T, M, H, 2) semi-axes, m, (T, M, H) angles and (T, M, H, 2) centres, m, in the frame of
            the road user.
        """
        lengths = self._filled(self.semi_axes * factor[:, None, :, None])[:, :, :horizon]
        double = self._filled(self.double_angle)[:, :, :horizon]
        centre = self.courses[:, :, :horizon].astype(np.float64)
        if self.centre is not None:
            beside = self.centre - self.courses[:, :, GRID - 1 :: GRID]
            centre = centre + self._filled(beside)[:, :, :horizon]
        return lengths, 0.5 * np.arctan2(double[..., 1], double[..., 0]), centre

    @staticmethod
    def _filled(values: FloatArray) -> FloatArray:
        users, modes, steps, size = values.shape
        flat = every_step(values.reshape(users * modes, steps, size))
        return flat.reshape(users, modes, -1, size)


def _around(
    trajectory: Occupancy, encoded: Encoded, lengths: FloatArray, angle: FloatArray
) -> Occupancy:
    """A trajectory with (T, H, 2) semi-axes and (T, H) angles around those that can move."""
    semi_axes, turned_by = np.zeros_like(trajectory.semi_axes), np.zeros_like(trajectory.angle)
    semi_axes[encoded.moving] = lengths
    turned_by[encoded.moving] = angle
    return replace(trajectory, semi_axes=semi_axes, angle=turned_by)


def _union(
    observation: Observation,
    moving: IntArray,
    log_weight: Float32Array,
    courses: Float32Array,
    sets: tuple[FloatArray, FloatArray, FloatArray],
) -> SetUnion:
    """The union of the ellipses around each course; those who cannot move keep points."""
    lengths, angle, local = sets
    now = observation.states[:, -1]
    shape = (len(now), *angle.shape[1:])
    weight = np.zeros(shape[:2])
    weight[:, 0] = 1.0
    own = np.exp(log_weight.astype(np.float64))
    weight[moving] = own / own.sum(axis=1, keepdims=True)
    centre = np.broadcast_to(now[:, None, None, :2], (*shape, 2)).copy()
    heading = np.broadcast_to(now[:, None, None, USER_HEADING], shape).copy()
    semi_axes, turned_by = np.zeros((*shape, 2)), np.zeros(shape)
    pose = np.repeat(now[moving, :3], shape[1], axis=0)
    centre[moving] = to_world(local.reshape(-1, shape[2], 2), pose).reshape(local.shape)
    heading[moving] += turned(courses.astype(np.float64))
    semi_axes[moving] = lengths
    turned_by[moving] = angle + now[moving, None, None, USER_HEADING]
    return SetUnion(weight, centre, semi_axes, turned_by, heading)


def _sizes(settings: DosSettings) -> tuple[Sizes, tuple[Path, ...]]:
    """The factors on the sets as they were trained, and the files that they come from.

    Outside of a run, ``AUTO`` is the ideal loop.
    """
    sets, loop = settings.sets_file, settings.calibration
    if loop is CalibratedFor.AUTO:
        loop = CalibratedFor.IDEAL
    if (level := settings.level) is not None:
        mode = Mode.SIMULTANEOUS if settings.simultaneous else Mode.PER_STEP
        made = shipped_calibration(sets, mode, loop, settings.conditional)
        # A level that is too high is refused here, not in the first episode.
        table = made.table(level)
        sizes = ConditionalSizes(made, level) if settings.conditional else GroupSizes(table)
        return sizes, (calibration_file(sets, loop),)
    scale = 1.0 if settings.scale is None else settings.scale
    if loop is CalibratedFor.IDEAL:
        return FixedSizes(scale), ()
    loops = (loop, CalibratedFor.IDEAL)
    own, ideal = (shipped_calibration(sets, Mode.PER_STEP, of) for of in loops)
    files = tuple(calibration_file(sets, of) for of in loops)
    return GroupSizes(own.table_like(ideal, scale)), files


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
