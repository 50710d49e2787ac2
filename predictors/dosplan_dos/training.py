"""Trains occupancy-set modules on the errors of a frozen trajectory network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from dosplan_net.build import load_network
from dosplan_net.features import kinds_of
from dosplan_net.network import constant_velocity
from dosplan_net.training.batches import RawBatch, Selection
from dosplan_net.training.cache import CacheError, WindowCache
from dosplan_net.training.optimise import FitSettings, fit
from dosplan_net.training.train import NET, cross_fitted_trajectories, run_over
from dosplan_net.weights import load_model, load_weights, save_weights
from torch import Tensor, nn

from dosplan.types import place_of
from dosplan_dos.calibrating import SECONDS, WANTED, Scored, calibrate, left_out
from dosplan_dos.calibration import (
    CalibratedFor,
    Mode,
    calibration_file,
    load_calibrations,
    save_calibrations,
)
from dosplan_dos.covariates import covariates
from dosplan_dos.losses import LossConfig
from dosplan_dos.module import CONSTANT_VELOCITY, OccupancyModule, SetConfig
from dosplan_dos.shapes import Ellipses, Variant, grid_steps

MODEL = "occupancy-sets"


@dataclass(frozen=True)
class SetTraining:
    """What ``dosplan train dos`` reads from its configuration.

    Attributes:
        modules: The modules to train, by name.
        fit: How each is trained.
        batch: Windows in a batch.
        standing_share: Share of the windows of standing road users that is trained on.
        calibrated: Names of the modules that are calibrated.
        cross_fitted: Whether the errors on the training recordings are those of networks that were
            not trained on them; else the network's own, which are too small.
    """

    modules: dict[str, SetConfig] = field(default_factory=dict)
    fit: FitSettings = field(default_factory=FitSettings)
    batch: int = 1024
    standing_share: float = 0.5
    calibrated: list[str] = field(default_factory=list)
    cross_fitted: bool = True


@dataclass(frozen=True)
class Windows:
    """What a module is trained on. W windows.

    Attributes:
        features: (W, hidden) features H.
        trajectory: (W, HORIZON, 2) predicted centres in each road user's frame, m.
        velocity: (W,) m/s.
        history: (W, HISTORY, 6) see ``dosplan_net.features.SceneFeatures``.
        future: (W, HORIZON, 2) true centres, m.
        valid: (W, HORIZON) whether they are recorded.
        static: (W, STATIC_SIZE) see ``dosplan_net.features.SceneFeatures``.
        instructive: (W,) whether the road user moves or is about to.
        recording: (W,) recording.
        covariates: (W, F) see ``covariates.covariates``.
        places: The place of each recording.
    """

    features: Tensor
    trajectory: Tensor
    velocity: Tensor
    history: Tensor
    future: Tensor
    valid: Tensor
    static: Tensor
    instructive: Tensor
    recording: Tensor
    covariates: Tensor
    places: tuple[str, ...]

    def sets(self, module: OccupancyModule, rows: Tensor) -> tuple[Ellipses, Tensor, Tensor]:
        """A module's sets for some windows, the errors (B, G, 2) and whether they are known."""
        steps = grid_steps()
        sets = module(
            self.features[rows], self.trajectory[rows], self.velocity[rows], self.history[rows]
        )
        trajectory, future = self.trajectory[rows], self.future[rows]
        return sets, (future - trajectory)[:, steps], self.valid[rows][:, steps].float()


def encode_windows(
    caches: Sequence[WindowCache],
    network: Path,
    base: str,
    cross_fitted: Sequence[npt.NDArray[np.float32]] | None = None,
) -> Windows:
    """Runs the frozen network over caches.

    Args:
        caches: The windows.
        network: Weights of the trajectory network.
        base: Whose trajectories the sets are for: ``net`` or ``constant-velocity``.
        cross_fitted: For each cache, (W, HORIZON, 2) trajectories to use instead of the network's.

    Returns:
        Windows of road users that can move and whose next step is recorded.
    """
    encoder = load_network(network)
    parts: list[tuple[Tensor, ...]] = []
    first = 0
    for number, cache in enumerate(caches):
        for batch, own, features in run_over(encoder, Selection(cache, np.arange(cache.scenes))):
            velocity = batch.pose[:, 3]
            if base == CONSTANT_VELOCITY:
                path = constant_velocity(velocity)
            elif cross_fitted is None:
                path = own
            else:
                path = torch.from_numpy(cross_fitted[number][batch.windows.numpy()])
            values = (
                features,
                path,
                velocity,
                batch.history,
                batch.future[..., :2],
                batch.future_valid,
                batch.static,
                batch.instructive,
                batch.recording + first,
            )
            keep = batch.moves & batch.future_valid[:, 0]
            parts.append((*(value[keep] for value in values), _known(batch, keep)))
        first += len(cache.recordings)
    places = tuple(place_of(Path(name).name) for cache in caches for name in cache.recordings)
    columns: list[Any] = [torch.cat(column) for column in zip(*parts, strict=True)]
    return Windows(*columns, *[places])


def _known(batch: RawBatch, keep: Tensor) -> Tensor:
    """(K, F) covariates of the windows of a batch that are kept."""
    rows = np.flatnonzero(keep.cpu().numpy())
    found = covariates(
        batch.pose.double().cpu().numpy(),
        batch.history.cpu().numpy(),
        batch.static.cpu().numpy(),
        batch.neighbours.cpu().numpy(),
        batch.pieces.cpu().numpy(),
        batch.piece_pose.double().cpu().numpy(),
        rows,
    )
    return torch.from_numpy(found)


def train_module(
    name: str,
    config: SetConfig,
    training: SetTraining,
    windows: Windows,
    held_out: Windows,
    out: Path,
    report: Callable[[str], None] = print,
) -> dict[str, float]:
    """Trains one module; does nothing where it is done.

    Args:
        name: Its name.
        config: The module.
        training: How to train.
        windows: What to train on.
        held_out: What to validate on.
        out: Folder of the training; ``NAME.safetensors`` is written there.
        report: Called with each line of progress.

    Returns:
        The figures of the best validation.
    """
    target = out / f"{name}.safetensors"
    if target.is_file():
        done: dict[str, float] = load_weights(target, MODEL)[1]["validation"]
        return done
    torch.manual_seed(training.fit.seed)
    learner = _Learner(OccupancyModule(config), config.loss)
    drawn = torch.rand(len(windows.features)) < training.standing_share
    pool = torch.where(windows.instructive | drawn)[0]

    def loss_at(step: int) -> Tensor:
        rows = pool[torch.randint(0, len(pool), (training.batch,))]
        return learner.loss(*windows.sets(learner.module, rows))  # type: ignore[no-any-return]

    figures = fit(
        learner,
        loss_at,
        lambda model: coverage_figures(model.module, held_out),  # type: ignore[arg-type]
        training.fit,
        out / name,
        lambda line: report(f"{name}: {line}"),
    )
    about = {"model": MODEL, "module": describe_config(config), "validation": figures}
    save_weights(target, learner.module.state_dict(), about)
    return figures


def coverage_figures(module: OccupancyModule, windows: Windows) -> dict[str, float]:
    """How small a module's sets are at a common coverage, and what they cover as they are.

    Args:
        module: The module.
        windows: Windows with their true futures.

    Returns:
        ``osa90``: geometric mean over 1, 2, 3 and 4 s of the mean area after scaling the sets of
        each horizon to cover 90 %, m2; ``cr_1`` ... ``cr_4`` and ``osa_1`` ... ``osa_4``.
    """
    parts = []
    for rows in torch.split(torch.arange(len(windows.features)), 8192):
        sets, error, valid = windows.sets(module, rows)
        parts.append((sets.distance(error)[:, SECONDS], sets.area[:, SECONDS], valid[:, SECONDS]))
    distance, area, valid = (torch.cat(column) for column in zip(*parts, strict=True))
    known = valid > 0
    areas, figures = [], {}
    for column, second in enumerate((1, 2, 3, 4)):
        d, a = distance[known[:, column], column], area[known[:, column], column]
        areas.append(float(torch.quantile(d, WANTED) ** 2 * a.mean()))
        figures[f"cr_{second}"] = float((d <= 1).float().mean())
        figures[f"osa_{second}"] = float(a.mean())
        figures[f"osa90_{second}"] = areas[-1]
    return {"osa90": float(np.exp(np.mean(np.log(areas))))} | figures


def train_sets(
    names: Sequence[str],
    training: SetTraining,
    caches: Sequence[Path],
    validation: Path,
    network: Path,
    out: Path,
    report: Callable[[str], None] = print,
) -> Iterator[tuple[str, dict[str, float]]]:
    """Trains and calibrates modules, one after another.

    Args:
        names: Which of ``training.modules``.
        training: What to train, and how.
        caches: Caches of training windows.
        validation: Cache of validation windows.
        network: Folder of the trajectory network's training.
        out: Folder of the training.
        report: Called with each line of progress.

    Yields:
        Each module's name and the figures of its best validation.
    """
    opened = [WindowCache.open(path) for path in caches]
    held_out = [WindowCache.open(validation)]
    loop = _loop_of([*opened, *held_out])
    weights = network / f"{NET}.safetensors"
    trajectories = cross_fitted_trajectories(caches, network) if training.cross_fitted else None
    for base in dict.fromkeys(training.modules[name].base for name in names):
        windows = encode_windows(opened, weights, base, trajectories)
        validating = encode_windows(held_out, weights, base)
        for name in (name for name in names if training.modules[name].base == base):
            config = training.modules[name]
            yield name, train_module(name, config, training, windows, validating, out, report)
            if name in training.calibrated:
                target = out / f"{name}.safetensors"
                scored = score_windows(load_module(target), [windows, validating])
                save_calibrations(calibration_file(target, loop), calibrate(scored))


def calibrate_sets(
    names: Sequence[str], caches: Sequence[Path], network: Path, out: Path
) -> Iterator[str]:
    """Calibrates trained modules anew, for the loop that their windows were seen through.

    Args:
        names: The modules.
        caches: Caches of recordings that the network was not trained on.
        network: Folder of the trajectory network's training.
        out: Folder of the modules' weights; the calibrations are written there.

    Yields:
        For each module, tables of what it covers of recordings that were left out, in Markdown.

    Raises:
        CacheError: The windows are of several loops, of one that has no name, or too few.
        WeightsError: A module is not trained yet.
    """
    opened = [WindowCache.open(path) for path in caches]
    loop = _loop_of(opened)
    for name in names:
        weights = out / f"{name}.safetensors"
        module = load_module(weights)
        windows = encode_windows(opened, network / f"{NET}.safetensors", module.config.base)
        try:
            scored = score_windows(module, [windows])
            ideal = calibration_file(weights, CalibratedFor.IDEAL)
            beside = loop is not CalibratedFor.IDEAL and ideal.is_file()
            told = left_out(scored, load_calibrations(ideal)[Mode.PER_STEP] if beside else None)
            save_calibrations(calibration_file(weights, loop), calibrate(scored))
        except ValueError as error:
            raise CacheError(f"{name} cannot be calibrated on these windows: {error}") from None
        yield f"{name}, for the loop {loop}\n\n{told}"


def _loop_of(caches: Sequence[WindowCache]) -> CalibratedFor:
    """The loop that windows were seen through."""
    found = {cache.loop for cache in caches}
    known = [str(loop) for loop in CalibratedFor if loop is not CalibratedFor.AUTO]
    if len(found) > 1 or not found <= set(known):
        raise CacheError(
            f"the windows were seen through {' and '.join(sorted(found))}; sets are calibrated for "
            f"one of {', '.join(known)}: build the caches with dosplan data build --loop NAME"
        )
    return CalibratedFor(found.pop())


def score_windows(module: OccupancyModule, parts: Sequence[Windows]) -> Scored:
    """Scores windows of recordings that the predicting network was not trained on.

    Those are the validation recordings and, by cross-fitting, the training recordings as well.

    Args:
        module: The module.
        parts: Windows; the recordings of each part are its own.

    Returns:
        What a calibration is made from.
    """
    before = np.cumsum([0, *(len(windows.places) for windows in parts)])
    recording = np.concatenate(
        [w.recording.cpu().numpy() + n for w, n in zip(parts, before, strict=False)]
    )
    names = [name for windows in parts for name in windows.places]
    places, place = np.unique(names, return_inverse=True)
    scored, areas = zip(*(scores(module, windows) for windows in parts), strict=True)
    kinds = [kind for windows in parts for kind in kinds_of(windows.static.cpu())]
    return Scored(
        score=np.concatenate(scored),
        area=np.concatenate(areas),
        speed=np.concatenate([w.velocity.abs().double().cpu().numpy() for w in parts]),
        kinds=np.array(kinds, dtype=object),
        recording=recording,
        covariates=np.concatenate([w.covariates.numpy() for w in parts]),
        place=place[recording],
        places=tuple(places.tolist()),
    )


def describe_config(config: SetConfig) -> dict[str, Any]:
    """A module's configuration as values that JSON can hold.

    Args:
        config: The configuration.

    Returns:
        What ``read_config`` reads.
    """
    return asdict(config) | {"variant": config.variant.value}


def read_config(values: dict[str, Any]) -> SetConfig:
    """The configuration that ``describe_config`` wrote.

    Args:
        values: Its values.

    Returns:
        The configuration.
    """
    parts = dict(values)
    loss = LossConfig(**parts.pop("loss", {}))
    variant = Variant(parts.pop("variant", Variant.FREE))
    return SetConfig(variant=variant, loss=loss, **parts)


def load_module(path: Path) -> OccupancyModule:
    """Builds a module from its weights.

    Args:
        path: The weights.

    Returns:
        The module, ready to be used.

    Raises:
        WeightsError: The file is not such weights.
    """
    return load_model(path, MODEL, lambda about: OccupancyModule(read_config(about["module"])))


def scores(
    module: OccupancyModule, windows: Windows
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Distances of the truth to a module's sets, and their areas.

    Args:
        module: The module.
        windows: Windows with their true futures.

    Returns:
        (W, G) Mahalanobis distances, NaN where the truth is not recorded, and (W, G) areas, m2.
    """
    distances, areas = [], []
    with torch.no_grad():
        for rows in torch.split(torch.arange(len(windows.features)), 8192):
            sets, error, valid = windows.sets(module, rows)
            distance = sets.distance(error)
            distances.append(torch.where(valid > 0, distance, torch.full_like(distance, torch.nan)))
            areas.append(sets.area)
    found = (torch.cat(parts).double().cpu().numpy() for parts in (distances, areas))
    return next(found), next(found)


class _Learner(nn.Module):
    """A module with its loss, so that multipliers of the loss are kept in checkpoints."""

    def __init__(self, module: OccupancyModule, loss: LossConfig) -> None:
        super().__init__()
        self.module = module
        self.loss = loss.make()
