"""Trains the trajectory network, and predicts its training recordings by cross-fitting.

The shipped network is trained on every recording, so that its errors on them are smaller than on
new ones. The occupancy sets are trained on the errors to expect on new recordings. Therefore the
recordings are split into folds, by map; for each fold, one more network is trained on the other
folds and then predicts this one. Maps of one place, such as ``USA_US101-1`` and ``USA_US101-10``,
may lie in different folds: a fold's network has not seen its recordings, but perhaps their place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from dosplan.simulation.settings import REALISTIC
from dosplan.system.files import atomic_file
from dosplan_net.build import MODEL, build_network, load_network
from dosplan_net.features import HORIZON
from dosplan_net.network import NetworkConfig, Prediction, TrajectoryNetwork
from dosplan_net.training.batches import (
    RawBatch,
    Selection,
    cut_histories,
    disturbed,
    in_order,
    mirrored,
    read_scenes,
    retimed,
)
from dosplan_net.training.cache import CacheError, WindowCache
from dosplan_net.training.losses import TrajectoryLoss, best_of, displacements
from dosplan_net.training.made_from import (
    MADE_FROM,
    MadeFrom,
    describe_training,
    file_digest,
    require_same,
    trained_already,
)
from dosplan_net.training.optimise import FitSettings, fit
from dosplan_net.weights import WeightsError, begin_from, load_weights, save_weights

NET = "net"


@dataclass(frozen=True)
class NetTraining:
    """What ``dosplan train net`` reads from its configuration.

    Attributes:
        network: Sizes of the network.
        fit: How each network is trained.
        folds: Number of networks for cross-fitting; may be 0.
        batch: Windows in a batch, about.
        recorded_weight: Weight of a recorded scene in the draw; a simulated one has 1.
        shares: Share of the drawn scenes that comes from each cache, in the order of ``--data``;
            they need not sum to 1. None: as many as it holds.
        standing_share: Share of the windows of standing road users that is trained on.
        forgetting: Share of the histories that are cut short.
        retiming: How much faster or slower, as a share, the time of a scene goes at most.
        disturbed: Share of the scenes that are seen with the errors of the realistic loop.
        loss: What the trajectories are trained for.
    """

    network: NetworkConfig = field(default_factory=NetworkConfig)
    fit: FitSettings = field(default_factory=FitSettings)
    folds: int = 3
    batch: int = 768
    recorded_weight: float = 2.0
    shares: list[float] = field(default_factory=list)
    standing_share: float = 0.2
    forgetting: float = 0.3
    retiming: float = 0.0
    disturbed: float = 0.0
    loss: TrajectoryLoss = field(default_factory=TrajectoryLoss)


def stages(config: NetTraining) -> list[str]:
    """Names the parts of a training, in order.

    Args:
        config: The training.

    Returns:
        ``net``, ``fold-0``, ``fold-1``, ...
    """
    return [NET, *(f"fold-{k}" for k in range(config.folds))]


def train_stage(
    stage: str,
    config: NetTraining,
    caches: Sequence[Path],
    validation: Sequence[Path],
    out: Path,
    report: Callable[[str], None] = print,
    device: str = "cpu",
    init: Path | None = None,
) -> dict[str, float]:
    """Trains one part; goes on where it was interrupted, does nothing where it is done.

    Args:
        stage: One of ``stages(config)``: ``net`` is trained on all recordings, ``fold-k`` on all
            but those of fold k.
        config: The training.
        caches: Caches of training windows.
        validation: Caches of validation windows; their figures count the same.
        out: Folder of the training; ``STAGE.safetensors`` is written there.
        report: Called with each line of progress.
        device: Where to train, as torch names it.
        init: Weights to begin from, for ``net`` alone; None for random ones.

    Returns:
        The figures of the best validation.

    Raises:
        CacheError: A cache cannot be read, or ``config.shares`` are not one for each.
        WeightsError: ``init`` cannot be read, has other sizes, or is given for a fold; or what is
            there was made from other settings, caches or weights.
    """
    if init is not None and stage != NET:
        raise WeightsError(
            f"{init}: {stage} cannot begin from them, they have seen the recordings that it is to "
            "foretell; train with --only net, or with folds: 0"
        )
    opened = [WindowCache.open(path) for path in caches]
    held_out = [WindowCache.open(path) for path in validation]
    target = out / f"{stage}.safetensors"
    made_from = _made_from(stage, config, opened, held_out, init)
    done = trained_already(target, MODEL, made_from, out / stage)
    if done is not None:
        return done
    if stage == NET:
        own = config.folds
        scenes = [np.arange(cache.scenes) for cache in opened]
    else:
        own = int(stage.removeprefix("fold-"))
        folds = assign_folds(opened, config.folds)
        scenes = [
            np.flatnonzero(fold[cache.scene_recording] != own)
            for cache, fold in zip(opened, folds, strict=True)
        ]
    torch.manual_seed(config.fit.seed * 7919 + own)
    network = build_network(config.network)
    if init is not None:
        begin_from(network, init, MODEL)
    network.to(device)
    source = _Source(opened, scenes, config, device)
    figures = fit(
        network,
        lambda step: source.loss(network, step),
        lambda model: mean_figures(
            displacement(model, cache, device)  # type: ignore[arg-type]
            for cache in held_out
        ),
        config.fit,
        out / stage,
        made_from,
        lambda line: report(f"{stage}: {line}"),
    )
    about = {"model": MODEL, "network": asdict(config.network), "validation": figures}
    save_weights(target, network.state_dict(), about | {MADE_FROM: made_from})
    return figures


def _made_from(
    stage: str,
    config: NetTraining,
    caches: Sequence[WindowCache],
    validation: Sequence[WindowCache],
    init: Path | None,
) -> MadeFrom:
    settings = asdict(config)
    if stage == NET:
        del settings["folds"]  # It learns from all of them, however many there are.
    return describe_training(
        part=stage,
        **settings,
        data=digests(caches),
        validation=digests(validation),
        init=None if init is None else file_digest(init),
    )


def digests(caches: Sequence[WindowCache]) -> list[str]:
    """Digests of caches.

    Args:
        caches: The caches.

    Returns:
        That of each, in order.
    """
    return [cache.digest for cache in caches]


def mean_figures(figures: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Averages the figures of several validations, each of which counts the same.

    Args:
        figures: Those of each, by the same names.

    Returns:
        Their means, in the order of the first.
    """
    first, *others = figures
    return {
        name: sum((other[name] for other in others), value) / (1 + len(others))
        for name, value in first.items()
    }


def shares_of(
    caches: Sequence[WindowCache],
    weights: Sequence[npt.NDArray[np.float64]],
    shares: Sequence[float],
) -> list[npt.NDArray[np.float64]]:
    """Scales weights so that each cache has its share of their sum.

    Args:
        caches: The caches.
        weights: Weights of what is drawn from each.
        shares: The share of each, > 0; none: the weights stay.

    Returns:
        The scaled weights of each; the sum of all is as before.

    Raises:
        CacheError: There are not as many shares as caches.
    """
    if not shares:
        return list(weights)
    if len(shares) != len(caches) or not all(share > 0.0 for share in shares):
        raise CacheError(
            f"shares has {len(shares)} entries for {len(caches)} caches of windows; name a "
            "positive one for each"
        )
    total = sum(weight.sum() for weight in weights)
    return [
        weight * (share / sum(shares) * total / weight.sum())
        for weight, share in zip(weights, shares, strict=True)
    ]


def assign_folds(caches: Sequence[WindowCache], folds: int) -> list[npt.NDArray[np.int64]]:
    """Splits recordings into folds of about as many windows; those of one map stay together.

    Args:
        caches: The caches.
        folds: Number K of folds.

    Returns:
        For each cache, (R,) the fold of each recording.
    """
    windows: dict[str, int] = {}
    for cache in caches:
        lengths = np.diff(cache.scene_start)
        counts = np.bincount(cache.scene_recording, lengths, minlength=len(cache.recordings))
        for group, count in zip(cache.groups, counts, strict=True):
            windows[group] = windows.get(group, 0) + int(count)
    load = np.zeros(folds)
    fold_of: dict[str, int] = {}
    for group in sorted(windows, key=lambda name: (-windows[name], name)):
        fold_of[group] = int(np.argmin(load))
        load[fold_of[group]] += windows[group]
    return [np.array([fold_of[group] for group in cache.groups]) for cache in caches]


@dataclass(frozen=True)
class Foretold:
    """What was foretold of the windows of a cache. W windows, M trajectories each.

    Attributes:
        trajectory: (W, M, HORIZON, 2) in each road user's frame, m.
        log_weight: (W, M) logarithms of how likely each is.
    """

    trajectory: npt.NDArray[np.float32]
    log_weight: npt.NDArray[np.float32]


def cross_fitted_trajectories(
    caches: Sequence[Path], folder: Path, device: str = "cpu"
) -> list[Foretold]:
    """Predicts each training recording with the network of its fold, which was not trained on it.

    Args:
        caches: The caches that the networks were trained on, in that order.
        folder: Folder of the training; the trajectories are kept there.
        device: Where to predict.

    Returns:
        For each cache, the trajectories.

    Raises:
        CacheError: A cache cannot be read.
        WeightsError: See ``fold_weights``.
    """
    opened = [WindowCache.open(path) for path in caches]
    weights = fold_weights(opened, folder)
    return [
        _cross_fitted(cache, fold, weights, folder / f"cross-fitted-{number}-{path.name}", device)
        for number, (cache, fold, path) in enumerate(
            zip(opened, assign_folds(opened, len(weights)), caches, strict=True)
        )
    ]


def fold_weights(caches: Sequence[WindowCache], folder: Path) -> list[Path]:
    """Finds the networks of a cross-fitting.

    Which recordings each has not seen follows from their number and from all caches: with another
    of either, recordings would be foretold by networks that were trained on them.

    Args:
        caches: The caches of ``--data``, in order.
        folder: Folder of the training.

    Returns:
        The weights of each fold.

    Raises:
        WeightsError: One is not there, or was trained with other caches or for another number of
            folds.
    """
    first = folder / "fold-0.safetensors"
    if not first.is_file():
        raise WeightsError(
            f"{folder}: holds no fold-0.safetensors ...; train them with dosplan train net"
        )
    folds = load_weights(first, MODEL)[1].get(MADE_FROM, {}).get("folds", 1)
    weights = [folder / f"fold-{k}.safetensors" for k in range(folds)]
    for path in weights:
        wanted = {"part": path.stem, "folds": folds, "data": digests(caches)}
        remedy = "name the --data that dosplan train net had, in its order, or train all folds anew"
        require_same(path, load_weights(path, MODEL)[1], wanted, remedy)
    return weights


def _cross_fitted(
    cache: WindowCache,
    fold: npt.NDArray[np.int64],
    weights: Sequence[Path],
    beginning: Path,
    device: str,
) -> Foretold:
    """What each fold's network foretells of it; kept in files whose names have this beginning."""
    made_from = " ".join([cache.digest, *map(file_digest, weights)])
    name = f"{beginning.name}-{sha256(made_from.encode()).hexdigest()[:16]}"
    kept = [beginning.with_name(f"{name}-{part}.npy") for part in ("trajectory", "log_weight")]
    if all(path.is_file() for path in kept):
        return Foretold(*(np.load(path, mmap_mode="r", allow_pickle=False) for path in kept))
    parts: list[npt.NDArray[np.float32]] = []
    for k, path in enumerate(weights):
        network = load_network(path).to(device)
        modes = network.config.modes
        if not parts:
            shapes = ((len(cache.pose), modes, HORIZON, 2), (len(cache.pose), modes))
            parts = [np.zeros(shape, dtype=np.float32) for shape in shapes]
        scenes = np.flatnonzero(fold[cache.scene_recording] == k)
        for batch, found in run_over(network, Selection(cache, scenes, device)):
            for part, values in zip(parts, (found.trajectory, found.log_weight), strict=True):
                part[batch.windows.cpu().numpy()] = values.cpu().numpy()
    for path, part in zip(kept, parts, strict=True):
        with atomic_file(path) as file:
            np.save(file, part)
    return Foretold(*parts)


def run_over(
    network: TrajectoryNetwork, selection: Selection, size: int = 4096
) -> Iterator[tuple[RawBatch, Prediction]]:
    """Runs a network over every window of some scenes.

    Args:
        network: The network.
        selection: The scenes.
        size: Windows in a batch, about.

    Yields:
        A batch, and what the network says of its windows.
    """
    network.eval()
    with torch.no_grad():
        for batch in in_order(selection, size):
            everyone = torch.arange(len(batch.pose), device=batch.pose.device)
            yield batch, network(batch.scene(network.map_encoder, everyone))


def displacement(
    network: TrajectoryNetwork, cache: WindowCache, device: str = "cpu"
) -> dict[str, float]:
    """Displacement errors of those that move or are about to.

    Args:
        network: The network.
        cache: Windows with their true futures.
        device: Where the network is.

    Returns:
        In m, of the most likely trajectory: ``ade``, the mean over every recorded step, ``fde``, at
        the last step, and ``at_1``, at 1 s; of the best trajectory: ``best_ade`` and ``best_fde``.
        Before them ``score``, the mean of ``ade`` and ``best_ade``, which selects the weights.
    """
    total = torch.zeros(2, HORIZON, device=device)
    count = torch.zeros(HORIZON, device=device)
    for batch, found in run_over(network, Selection(cache, np.arange(cache.scenes), device)):
        error = displacements(found.trajectory, batch.future)
        counted = (batch.future_valid & batch.instructive[:, None]) * batch.weight[:, None]
        rows = torch.arange(len(error), device=error.device)
        chosen = (found.log_weight.argmax(1), best_of(error, batch.future_valid))
        for number, which in enumerate(chosen):
            total[number] += (error[rows, which] * counted).sum(0)
        count += counted.sum(0)
    mean = (total.sum(1) / count.sum().clamp(min=1)).tolist()
    at = (total / count.clamp(min=1)).tolist()
    return {
        "score": 0.5 * (mean[0] + mean[1]),
        "ade": mean[0],
        "fde": at[0][-1],
        "at_1": at[0][9],
        "best_ade": mean[1],
        "best_fde": at[1][-1],
    }


class _Source:
    """Draws batches; what is drawn at a step follows from the seed and the step alone."""

    def __init__(
        self,
        caches: Sequence[WindowCache],
        scenes: Sequence[npt.NDArray[np.int64]],
        config: NetTraining,
        device: str,
    ) -> None:
        self._caches = caches
        self._device = device
        self._config = config
        # Every scene of every cache in one list, so that one draw mixes them by their weights.
        self._cache_of = np.repeat(np.arange(len(caches)), [len(s) for s in scenes])
        self._scenes = np.concatenate(scenes)
        weight = [
            np.where(np.array(c.simulated)[c.scene_recording[s]], 1.0, config.recorded_weight)
            * c.scene_weight[s].astype(np.float64)
            for c, s in zip(caches, scenes, strict=True)
        ]
        self._ends = np.cumsum(np.concatenate(shares_of(caches, weight, config.shares)))
        self._mean_windows = np.mean(
            np.concatenate([np.diff(c.scene_start)[s] for c, s in zip(caches, scenes, strict=True)])
        )

    def loss(self, network: TrajectoryNetwork, step: int) -> Tensor:
        random = np.random.default_rng((self._config.fit.seed, step))
        drawn = np.searchsorted(
            self._ends,
            random.random(max(int(self._config.batch / self._mean_windows), 1)) * self._ends[-1],
        )
        parts = [
            self._part(
                network, int(which), self._scenes[drawn[self._cache_of[drawn] == which]], random
            )
            for which in np.unique(self._cache_of[drawn])
        ]
        total, count = (torch.stack(column).sum() for column in zip(*parts, strict=True))
        return total / count.clamp(min=1)

    def _part(
        self,
        network: TrajectoryNetwork,
        which: int,
        scenes: npt.NDArray[np.int64],
        random: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        """Summed loss, m, and number of steps, of scenes of one cache."""
        config = self._config
        batch = read_scenes(self._caches[which], scenes, self._device)
        targets = self._targets(batch, random)
        if random.random() < 0.5:
            batch = mirrored(batch)
        if config.retiming:
            batch = retimed(batch, config.retiming, random)
        batch = cut_histories(batch, config.forgetting, random)
        if config.disturbed:
            batch = disturbed(batch, config.disturbed, REALISTIC.sensing, random)
        found = network(batch.scene(network.map_encoder, targets))
        valid = batch.future_valid[targets]
        return config.loss.total(found, batch.future[targets], valid)

    def _targets(self, batch: RawBatch, random: np.random.Generator) -> Tensor:
        drawn = torch.from_numpy(random.random(len(batch.pose)) < self._config.standing_share)
        drawn = drawn.to(batch.pose.device)
        return torch.where(batch.instructive | (drawn & batch.moves & batch.future_valid[:, 0]))[0]
