"""The training loop that every model here shares: resumable, averaged, logged."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from dosplan.system.files import atomic_file
from dosplan_net.training.made_from import MADE_FROM, MadeFrom, require_same


@dataclass(frozen=True)
class FitSettings:
    """How a model is trained.

    Attributes:
        steps: Optimisation steps.
        learning_rate: At its peak; it rises over the first tenth and falls as a cosine.
        weight_decay: AdamW's.
        average: Decay per step of the running average of the weights, which is what is kept.
        clip: Largest norm of a gradient.
        validate_every: Steps between two validations.
        patience: Validations without a better one after which training ends.
        seed: Seed of every random choice; a resumed training makes the same ones.
    """

    steps: int = 4000
    learning_rate: float = 2e-3
    weight_decay: float = 1e-3
    average: float = 0.998
    clip: float = 1.0
    validate_every: int = 500
    patience: int = 8
    seed: int = 1


def fit(
    model: nn.Module,
    loss_at: Callable[[int], Tensor],
    validate: Callable[[nn.Module], Mapping[str, float]],
    settings: FitSettings,
    folder: Path,
    made_from: MadeFrom,
    report: Callable[[str], None] = print,
) -> dict[str, float]:
    """Trains a model; begins where an interrupted call stopped.

    Writes ``log.csv``, a row for each validation, and ``checkpoint.pt`` into the folder.

    Args:
        model: The model; holds the best averaged weights afterwards.
        loss_at: Loss of ``model`` at a step; random choices must follow from the step alone.
        validate: Figures of a model, the first of which is to be small.
        settings: How to train.
        folder: Where the log and the checkpoint go.
        made_from: What decides the result; only a checkpoint of the same is gone on from.
        report: Called with a line after each validation.

    Returns:
        The best validation's figures.

    Raises:
        WeightsError: The checkpoint there is of another training.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / "checkpoint.pt"
    parameters = list(model.parameters())
    optimiser = torch.optim.AdamW(
        parameters, lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    average = {name: value.detach().clone() for name, value in model.state_dict().items()}
    state: dict[str, Any] = {"step": 0, "best": {}, "best_weights": average, "stale": 0}
    if checkpoint.is_file():
        saved = torch.load(checkpoint, weights_only=True, map_location=parameters[0].device)
        require_same(checkpoint, saved, made_from, f"name another --out, or delete {folder}")
        model.load_state_dict(saved["model"])
        optimiser.load_state_dict(saved["optimiser"])
        average, state = saved["average"], saved["state"]
    started = time.monotonic()
    while state["step"] < settings.steps and state["stale"] < settings.patience:
        step = state["step"]
        torch.manual_seed(settings.seed * 1_000_003 + step)
        for group in optimiser.param_groups:
            group["lr"] = settings.learning_rate * _schedule(step / settings.steps)
        model.train()
        optimiser.zero_grad()
        loss = loss_at(step)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(parameters, settings.clip)
        optimiser.step()
        # Early averages must not depend on the random initial weights.
        decay = min(settings.average, (1 + step) / (10 + step))
        with torch.no_grad():
            # One call for all tensors: on a GPU, a call each takes longer than the step.
            values = [value.detach() for value in model.state_dict().values()]
            torch._foreach_lerp_(list(average.values()), values, 1 - decay)
        state["step"] = step + 1
        if state["step"] % settings.validate_every == 0 or state["step"] == settings.steps:
            current = {name: value.detach().clone() for name, value in model.state_dict().items()}
            model.load_state_dict(average)
            model.eval()
            with torch.no_grad():
                figures = dict(validate(model))
            _keep_best(state, figures, average)
            model.load_state_dict(current)
            line = {"step": step + 1, "loss": float(loss.detach())} | figures
            _log(folder / "log.csv", line | {"seconds": time.monotonic() - started})
            report("  ".join(f"{name} {value:.4g}" for name, value in line.items()))
            with atomic_file(checkpoint) as file:
                torch.save(
                    {
                        "model": current,
                        "optimiser": optimiser.state_dict(),
                        "average": average,
                        "state": state,
                        MADE_FROM: made_from,
                    },
                    file,
                )
    model.load_state_dict(state["best_weights"])
    model.eval()
    best: dict[str, float] = state["best"]
    return best


def _keep_best(
    state: dict[str, Any], figures: dict[str, float], weights: dict[str, Tensor]
) -> None:
    criterion = next(iter(figures.values()))
    best = next(iter(state["best"].values()), math.inf)
    if criterion < best:
        state["best"], state["stale"] = figures, 0
        state["best_weights"] = {name: value.clone() for name, value in weights.items()}
    else:
        state["stale"] += 1


def _schedule(done: float) -> float:
    """Share of the peak learning rate: up over the first tenth, then down as a cosine."""
    if done < 0.1:
        return 0.1 + 0.9 * done / 0.1
    return 0.5 * (1 + math.cos(math.pi * (done - 0.1) / 0.9)) + 1e-3


def _log(path: Path, row: Mapping[str, float]) -> None:
    new = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(row))
        if new:
            writer.writeheader()
        writer.writerow(row)
