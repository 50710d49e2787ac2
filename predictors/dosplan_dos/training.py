"""Trains occupancy-set modules on the errors of a frozen trajectory network."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from dosplan_net.build import load_network
from dosplan_net.features import kinds_of
from dosplan_net.network import Prediction, constant_velocity
from dosplan_net.training.batches import RawBatch, Selection
from dosplan_net.training.cache import CacheError, WindowCache
from dosplan_net.training.made_from import (
    MADE_FROM,
    describe_training,
    file_digest,
    trained_already,
)
from dosplan_net.training.optimise import FitSettings, fit
from dosplan_net.training.train import (
    NET,
    Foretold,
    cross_fitted_trajectories,
    digests,
    fold_weights,
    mean_figures,
    run_over,
    shares_of,
)
from dosplan_net.weights import begin_from, load_model, save_weights
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
from dosplan_dos.losses import CoverageLoss, LossConfig
from dosplan_dos.module import CONSTANT_VELOCITY, OccupancyModule, SetConfig, UnionModule
from dosplan_dos.shapes import Ellipses, Unions, Variant, grid_steps

SetModule = OccupancyModule | UnionModule
Sets = Ellipses | Unions
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
        shares: Share of the loss that the windows of each cache have, in the order of ``--data``,
            then of ``--unseen``; they need not sum to 1. None: as many as it holds.
    """

    modules: dict[str, SetConfig] = field(default_factory=dict)
    fit: FitSettings = field(default_factory=FitSettings)
    batch: int = 1024
    standing_share: float = 0.5
    calibrated: list[str] = field(default_factory=list)
    cross_fitted: bool = True
    shares: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Windows:
    """What a module is trained on. W windows.

    Attributes:
        features: (W, hidden) features H.
        trajectory: (W, M, HORIZON, 2) predicted centres in each road user's frame, m.
        log_weight: (W, M) logarithms of how likely each is.
        velocity: (W,) m/s.
        history: (W, HISTORY, 6) see ``dosplan_net.features.SceneFeatures``.
        future: (W, HORIZON, 2) true centres, m.
        valid: (W, HORIZON) whether they are recorded.
        static: (W, STATIC_SIZE) see ``dosplan_net.features.SceneFeatures``.
        instructive: (W,) whether the road user moves or is about to.
        recording: (W,) recording.
        weight: (W,) how much each counts: the weight of its scene, see ``WindowCache``.
        covariates: (W, F) see ``covariates.covariates``; always on the CPU.
        places: The place of each recording.
    """

    features: Tensor
    trajectory: Tensor
    log_weight: Tensor
    velocity: Tensor
    history: Tensor
    future: Tensor
    valid: Tensor
    static: Tensor
    instructive: Tensor
    recording: Tensor
    weight: Tensor
    covariates: Tensor
    places: tuple[str, ...]

    def drawn(self, seed: int) -> Windows:
        """Draws windows with their weights as probabilities: of one past one outcome, about.

        Args:
            seed: Seed of the draw.

        Returns:
            These, which all count the same; everyone where only one future is known.
        """
        generator = torch.Generator().manual_seed(seed)
        chance = torch.rand(len(self.weight), generator=generator).to(self.weight.device)
        kept = chance < self.weight
        # Covariates stay on the CPU, wherever the others are.
        parts = {
            name: part[kept.to(part.device)]
            for name, part in vars(self).items()
            if name != "places"
        }
        return replace(self, **parts | {"weight": torch.ones_like(parts["weight"])})

    def sets(self, module: SetModule, rows: Tensor) -> tuple[Sets, Tensor, Tensor]:
        """A module's sets for some windows.

        Args:
            module: The module.
            rows: (B,) the windows.

        Returns:
            The sets, (B, G, 2) the true centres as their ``distance`` takes them, m, and (B, G) 1
            where they are recorded, 0 elsewhere.
        """
        steps = grid_steps()
        truth, valid = self.future[rows][:, steps], self.valid[rows][:, steps].float()
        features, trajectory, weight = (
            self.features[rows],
            self.trajectory[rows],
            self.log_weight[rows],
        )
        velocity, history = self.velocity[rows], self.history[rows]
        if isinstance(module, UnionModule):
            return module(features, trajectory, weight, velocity, history), truth, valid
        likeliest = Prediction(trajectory, weight, features).likeliest()
        sets: Ellipses = module(features, likeliest, velocity, history)
        return sets, truth - likeliest[:, steps], valid


def encode_windows(
    caches: Sequence[WindowCache],
    network: Path,
    base: str,
    cross_fitted: Sequence[Foretold | None] | None = None,
    device: str = "cpu",
) -> Windows:
    """Runs the frozen network over caches.

    Args:
        caches: The windows.
        network: Weights of the trajectory network.
        base: Whose trajectories the sets are for: ``net`` or ``constant-velocity``.
        cross_fitted: For each cache, trajectories to use instead of the network's, if any.
        device: Where to run it; the windows stay there.

    Returns:
        Windows of road users that can move and whose next step is recorded.
    """
    encoder = load_network(network).to(device)
    parts: list[tuple[Tensor, ...]] = []
    first = 0
    for number, cache in enumerate(caches):
        everything = Selection(cache, np.arange(cache.scenes), device)
        for batch, found in run_over(encoder, everything):
            velocity = batch.pose[:, 3]
            path, weight = found.trajectory, found.log_weight
            if base == CONSTANT_VELOCITY:
                path, weight = constant_velocity(velocity)[:, None], torch.zeros_like(weight[:, :1])
            elif cross_fitted is not None and (foretold := cross_fitted[number]) is not None:
                rows = batch.windows.cpu().numpy()
                path, weight = (
                    torch.from_numpy(part[rows]).to(device)
                    for part in (foretold.trajectory, foretold.log_weight)
                )
            values = (
                found.features,
                path,
                weight,
                velocity,
                batch.history,
                batch.future[..., :2],
                batch.future_valid,
                batch.static,
                batch.instructive,
                batch.recording + first,
                batch.weight,
            )
            keep = batch.moves & batch.future_valid[:, 0]
            parts.append((*(value[keep] for value in values), _known(batch, keep)))
        first += len(cache.recordings)
    places = tuple(place_of(Path(name).name) for cache in caches for name in cache.recordings)
    columns: list[Any] = [*(torch.cat(column) for column in zip(*parts, strict=True)), places]
    return Windows(*columns)


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
    held_out: Sequence[Windows],
    sources: Mapping[str, Any],
    out: Path,
    report: Callable[[str], None] = print,
    init: Path | None = None,
) -> dict[str, float]:
    """Trains one module, where the windows are; does nothing where it is done.

    It goes on where it was interrupted. Calibrations that lie beside the weights that it writes are
    removed: they were made for others.

    Args:
        name: Its name.
        config: The module.
        training: How to train.
        windows: What to train on.
        held_out: What to validate on; the figures of each count the same.
        sources: Digests of what the windows are from, by names of one's own; JSON can hold them.
        out: Folder of the training; ``NAME.safetensors`` is written there.
        report: Called with each line of progress.
        init: Weights to begin from; None for random ones.

    Returns:
        The figures of the best validation.

    Raises:
        WeightsError: ``init`` cannot be read, or has other sizes; or what is there was made from
            other settings, sources or weights.
    """
    config = replace(config, features=windows.features.shape[1])
    settings = asdict(training)
    del settings["modules"], settings["calibrated"]  # They say what else is made.
    made_from = describe_training(
        part=name,
        module=describe_config(config),
        **settings,
        **sources,
        init=None if init is None else file_digest(init),
    )
    target = out / f"{name}.safetensors"
    done = trained_already(target, MODEL, made_from, out / name)
    if done is not None:
        return done
    torch.manual_seed(training.fit.seed)
    device = windows.features.device
    learner = _Learner(config)
    if init is not None:
        begin_from(learner.module, init, MODEL)
    learner.to(device)
    drawn = torch.rand(len(windows.features)) < training.standing_share
    pool = torch.where(windows.instructive | drawn.to(device))[0]

    def batch(size: int) -> tuple[Sets, Tensor, Tensor]:
        rows = pool[torch.randint(0, len(pool), (size,)).to(device)]
        sets, truth, valid = windows.sets(learner.module, rows)
        return sets, truth, valid * windows.weight[rows, None]

    def loss_at(step: int) -> Tensor:
        return learner.loss(*batch(training.batch))  # type: ignore[no-any-return]

    if init is not None and isinstance(learner.loss, CoverageLoss):
        with torch.no_grad():
            learner.loss.balance(*batch(8192))

    figures = fit(
        learner,
        loss_at,
        lambda model: mean_figures(
            coverage_figures(model.module, part)  # type: ignore[arg-type]
            for part in held_out
        ),
        training.fit,
        out / name,
        made_from,
        lambda line: report(f"{name}: {line}"),
    )
    about = {"model": MODEL, "module": describe_config(config), "validation": figures}
    for loop in CalibratedFor:
        calibration_file(target, loop).unlink(missing_ok=True)
    save_weights(target, learner.module.state_dict(), about | {MADE_FROM: made_from})
    return figures


def coverage_figures(module: SetModule, windows: Windows) -> dict[str, float]:
    """How small a module's sets are at a common coverage, and what they cover as they are.

    Args:
        module: The module.
        windows: Windows with their true futures.

    Returns:
        ``osa90``: geometric mean over 1, 2, 3 and 4 s of the mean area after scaling the sets of
        each horizon to cover 90 %, m2; ``cr_1`` ... ``cr_4`` and ``osa_1`` ... ``osa_4``.
    """
    parts: list[Sets] = []
    held: list[tuple[Tensor, Tensor]] = []
    everyone = torch.arange(len(windows.features), device=windows.features.device)
    for rows in torch.split(everyone, 8192):
        made, point, valid = windows.sets(module, rows)
        parts.append(made.at(SECONDS))
        held.append((parts[-1].distance(point[:, SECONDS]), valid[:, SECONDS] > 0))
    distance, known = (torch.cat(column) for column in zip(*held, strict=True))
    columns = range(len(SECONDS))
    scale = torch.stack([torch.quantile(distance[known[:, k], k], WANTED) for k in columns])
    area = torch.cat([sets.area for sets in parts])
    scaled = torch.cat([sets.area_scaled(scale) for sets in parts])
    areas, figures = [], {}
    for k in columns:
        rows = known[:, k]
        areas.append(float(scaled[rows, k].mean()))
        figures[f"cr_{k + 1}"] = float((distance[rows, k] <= 1).float().mean())
        figures[f"osa_{k + 1}"] = float(area[rows, k].mean())
        figures[f"osa90_{k + 1}"] = areas[-1]
    return {"osa90": float(np.exp(np.mean(np.log(areas))))} | figures


def train_sets(
    names: Sequence[str],
    training: SetTraining,
    caches: Sequence[Path],
    validation: Sequence[Path],
    network: Path,
    out: Path,
    report: Callable[[str], None] = print,
    device: str = "cpu",
    *,
    unseen: Sequence[Path] = (),
    init: Path | None = None,
) -> Iterator[tuple[str, dict[str, float]]]:
    """Trains and calibrates modules, one after another.

    Args:
        names: Which of ``training.modules``.
        training: What to train, and how.
        caches: Caches of training windows.
        validation: Caches of validation windows.
        network: Folder of the trajectory network's training.
        out: Folder of the training.
        report: Called with each line of progress.
        device: Where to train, as torch names it.
        unseen: Caches of more training windows, of recordings that the network was not trained on:
            its own errors on them are those to expect.
        init: Folder of the weights to begin from, ``NAME.safetensors``; None for random ones.

    Yields:
        Each module's name and the figures of its best validation.

    Raises:
        CacheError: A cache cannot be read, ``training.shares`` are not one for each, or a module
            is to be calibrated on errors of a network that has learned from the windows.
        WeightsError: Weights cannot be read, those to begin from have other sizes, the folds are of
            other caches (see ``fold_weights``), or what is there was made from anything else.
    """
    calibrated = [name for name in names if name in training.calibrated]
    if calibrated and caches and not training.cross_fitted:
        raise CacheError(
            f"{caches[0]}: {calibrated[0]} cannot be calibrated on it, the network has learned "
            "from it; set cross_fitted: true, or take it out of calibrated"
        )
    opened = [WindowCache.open(path) for path in (*caches, *unseen)]
    held_out = [WindowCache.open(path) for path in validation]
    loop = _loop_of([*opened, *held_out])
    weights = network / f"{NET}.safetensors"
    trajectories: list[Foretold | None] = [None] * len(opened)
    folds: list[Path] = []
    if caches and training.cross_fitted:
        trajectories[: len(caches)] = cross_fitted_trajectories(caches, network, device)
        folds = fold_weights(opened[: len(caches)], network)
    sources = {
        "data": digests(opened[: len(caches)]),
        "unseen": digests(opened[len(caches) :]),
        "validation": digests(held_out),
        "network": file_digest(weights),
        "fold_networks": [file_digest(path) for path in folds],
    }
    for base in dict.fromkeys(training.modules[name].base for name in names):
        windows = encode_windows(opened, weights, base, trajectories, device)
        # Pasts that are validated and calibrated on have one outcome each.
        validating = [
            encode_windows([cache], weights, base, device=device).drawn(training.fit.seed)
            for cache in held_out
        ]
        shared = _shared(windows, opened, training.shares)
        for name in (name for name in names if training.modules[name].base == base):
            config = training.modules[name]
            begin = None if init is None else init / f"{name}.safetensors"
            figures = train_module(
                name, config, training, shared, validating, sources, out, report, begin
            )
            yield name, figures
            if name in training.calibrated:
                target = out / f"{name}.safetensors"
                parts = [windows.drawn(training.fit.seed), *validating]
                scored = score_windows(load_module(target).to(device), parts)
                save_calibrations(calibration_file(target, loop), calibrate(scored))


def _shared(windows: Windows, caches: Sequence[WindowCache], shares: Sequence[float]) -> Windows:
    """The windows of some caches, weighted so that each cache has its share."""
    cache_of = np.repeat(np.arange(len(caches)), [len(cache.recordings) for cache in caches])
    of = cache_of[windows.recording.cpu().numpy()]
    weight = windows.weight.double().cpu().numpy()
    parts = shares_of(caches, [weight[of == k] for k in range(len(caches))], shares)
    for k, part in enumerate(parts):
        weight[of == k] = part
    return replace(windows, weight=torch.from_numpy(weight).to(windows.weight))


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
        windows = encode_windows(opened, network / f"{NET}.safetensors", module.config.base).drawn(
            0
        )
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


def score_windows(module: SetModule, parts: Sequence[Windows]) -> Scored:
    """Scores windows whose trajectories are of networks that were not trained on the recordings.

    Those are the validation recordings and, by cross-fitting, the training recordings as well; of
    these, the module and the features H that it reads have seen the windows.

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


def make_module(config: SetConfig) -> SetModule:
    """Makes an untrained module.

    Args:
        config: What it is to be.

    Returns:
        The module.
    """
    return UnionModule(config) if config.modes > 1 else OccupancyModule(config)


def load_module(path: Path) -> SetModule:
    """Builds a module from its weights.

    Args:
        path: The weights.

    Returns:
        The module, ready to be used.

    Raises:
        WeightsError: The file is not such weights.
    """
    return load_model(path, MODEL, lambda about: make_module(read_config(about["module"])))


def scores(
    module: SetModule, windows: Windows
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
        everyone = torch.arange(len(windows.features), device=windows.features.device)
        for rows in torch.split(everyone, 8192):
            sets, point, valid = windows.sets(module, rows)
            distance = sets.distance(point)
            distances.append(torch.where(valid > 0, distance, torch.full_like(distance, torch.nan)))
            areas.append(sets.area)
    return torch.cat(distances).double().cpu().numpy(), torch.cat(areas).double().cpu().numpy()


class _Learner(nn.Module):
    """A module with its loss, so that multipliers of the loss are kept in checkpoints."""

    def __init__(self, config: SetConfig) -> None:
        super().__init__()
        self.module = make_module(config)
        self.loss = config.loss.make()
