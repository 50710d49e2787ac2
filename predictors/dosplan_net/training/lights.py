"""Trains the response to lights on a network that stays as it is.

The network is run once over every window with a light ahead; the response learns from what it
said there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from dosplan_net.build import load_network
from dosplan_net.encoder import BESIDE
from dosplan_net.light_network import (
    MODEL,
    LightConfig,
    LightResponse,
    save_response,
)
from dosplan_net.lights import COLOUR_SIZE
from dosplan_net.network import Prediction
from dosplan_net.training.batches import Selection
from dosplan_net.training.cache import CacheError, WindowCache
from dosplan_net.training.losses import TrajectoryLoss, displacements
from dosplan_net.training.made_from import (
    MADE_FROM,
    describe_training,
    file_digest,
    trained_already,
)
from dosplan_net.training.optimise import FitSettings, fit
from dosplan_net.training.train import NET, digests, run_over


@dataclass(frozen=True)
class LightTraining:
    """What ``dosplan train lights`` reads from its configuration.

    Attributes:
        response: Sizes of the response; the width of the features is the network's.
        fit: How it is trained.
        batch: Windows in a batch.
        loss: What the answers are trained for; how likely each is stays as the network has it.
    """

    response: LightConfig = field(default_factory=LightConfig)
    fit: FitSettings = field(default_factory=FitSettings)
    batch: int = 1024
    loss: TrajectoryLoss = field(default_factory=TrajectoryLoss)


@dataclass(frozen=True)
class LitWindows:
    """The W windows of road users that can move and have a lit light ahead.

    Attributes:
        features: (W, hidden) features H.
        trajectory: (W, M, HORIZON, 2) what the network says, m.
        log_weight: (W, M) how likely it takes each to be.
        velocity: (W,) m/s.
        lights: (W, LIGHT_SIZE) see ``lights.describe_lights``.
        history: (W, HISTORY, 6) see ``features.SceneFeatures``.
        future: (W, HORIZON, 2) where they went, m.
        valid: (W, HORIZON) whether that is recorded.
        recording: (W,) recording of the cache.
        weight: (W,) weight of the window's scene, see ``cache.WindowCache``.
    """

    features: Tensor
    trajectory: Tensor
    log_weight: Tensor
    velocity: Tensor
    lights: Tensor
    history: Tensor
    future: Tensor
    valid: Tensor
    recording: Tensor
    weight: Tensor

    def part(self, rows: Tensor) -> LitWindows:
        """Some of the windows."""
        return LitWindows(*(value[rows] for value in vars(self).values()))

    def error(self, trajectory: Tensor) -> Tensor:
        """(W, HORIZON) displacement of the most likely of (W, M, HORIZON, 2) trajectories, m."""
        error = displacements(trajectory, self.future)
        return error[torch.arange(len(error)), self.log_weight.argmax(1)]


def lit_windows(network: Path, caches: Sequence[Path]) -> LitWindows:
    """Runs a network over the windows with a light ahead.

    Args:
        network: Its weights.
        caches: Caches of windows; the recordings are numbered on from one to the next.

    Returns:
        The windows, and what the network says of them.

    Raises:
        CacheError: A cache cannot be read, or nobody has a light ahead.
        WeightsError: The weights cannot be read.
    """
    found: list[tuple[Tensor, ...]] = []
    model, recordings = load_network(network), 0
    for path in caches:
        cache = WindowCache.open(path)
        for batch, foretold in run_over(model, Selection(cache, np.arange(cache.scenes))):
            lights = torch.from_numpy(cache.lights[batch.windows.numpy()])
            rows = lights[:, :COLOUR_SIZE].any(1) & batch.moves & batch.future_valid[:, 0]
            found.append(
                (
                    foretold.features[rows],
                    foretold.trajectory[rows],
                    foretold.log_weight[rows],
                    batch.pose[rows, 3],
                    lights[rows],
                    batch.history[rows],
                    batch.future[rows, :, :2],
                    batch.future_valid[rows],
                    batch.recording[rows] + recordings,
                    batch.weight[rows],
                )
            )
        recordings += len(cache.recordings)
    windows = LitWindows(*(torch.cat(parts) for parts in zip(*found, strict=True)))
    if not len(windows.velocity):
        raise CacheError(f"{caches[0]}: nobody has a traffic light ahead in it; name another cache")
    return windows


def train_lights(
    config: LightTraining,
    caches: Sequence[Path],
    validation: Sequence[Path],
    network: Path,
    out: Path,
    report: Callable[[str], None] = print,
) -> dict[str, float]:
    """Trains the response; goes on where it was interrupted, does nothing where it is done.

    Args:
        config: The training.
        caches: Caches of training windows.
        validation: Caches of windows that select the weights.
        network: Folder of the network's training; ``net.safetensors`` there is used.
        out: Folder of this training; ``net.lights.safetensors`` is written there.
        report: Called with each line of progress.

    Returns:
        The figures of the best validation: ``ade`` over every recorded step and ``fde`` at the
        last, m, of the most likely trajectories of windows with a light ahead.

    Raises:
        CacheError: A cache cannot be read, or nobody has a light ahead in it.
        WeightsError: The network cannot be read; or what is there was made from other settings,
            caches or weights.
    """
    weights, target = network / f"{NET}.safetensors", out / f"{NET}{BESIDE}"
    folder = out / "lights"
    made_from = describe_training(
        part="lights",
        **asdict(config),
        data=digests([WindowCache.open(path) for path in caches]),
        validation=digests([WindowCache.open(path) for path in validation]),
        network=file_digest(weights),
    )
    done = trained_already(target, MODEL, made_from, folder)
    if done is not None:
        return done
    windows, held_out = lit_windows(weights, caches), lit_windows(weights, validation)
    torch.manual_seed(config.fit.seed)
    modes = windows.trajectory.shape[1]
    response = LightResponse(
        replace(config.response, features=windows.features.shape[1], modes=modes)
    )

    def loss_at(step: int) -> Tensor:
        random = np.random.default_rng((config.fit.seed, step))
        rows = torch.from_numpy(random.integers(0, len(windows.velocity), config.batch))
        part = windows.part(rows)
        answer = respond(response, part)
        found = Prediction(answer, part.log_weight, part.features)
        total, count = config.loss.total(found, part.future, part.valid * part.weight[:, None])
        return total / count.clamp(min=1)

    figures = fit(
        response,
        loss_at,
        lambda model: displacement(respond(model, held_out), held_out),  # type: ignore[arg-type]
        config.fit,
        folder,
        made_from,
        report,
    )
    save_response(target, response, weights, figures, **{MADE_FROM: made_from})
    return figures


def respond(response: LightResponse, windows: LitWindows) -> Tensor:
    """(W, M, HORIZON, 2) trajectories with the response, m."""
    answer: Tensor = response(
        windows.features, windows.trajectory, windows.velocity, windows.lights
    )
    return answer


def displacement(trajectory: Tensor, windows: LitWindows) -> dict[str, float]:
    """Displacement errors.

    Args:
        trajectory: (W, M, HORIZON, 2) trajectories, m.
        windows: The windows.

    Returns:
        ``ade``: mean over every recorded step, m; ``fde``: at the last step, m.
    """
    error = windows.error(trajectory)
    valid = windows.valid * windows.weight[:, None]
    total, count = (error * valid).sum(0), valid.sum(0)
    ade = total.sum() / count.sum().clamp(min=1)
    return {"ade": float(ade), "fde": float(total[-1] / count[-1].clamp(min=1))}
