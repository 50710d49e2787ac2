"""Tiny networks of a cross-fitting, without training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from dosplan_net.build import MODEL
from dosplan_net.training.cache import WindowCache
from dosplan_net.training.made_from import MADE_FROM
from dosplan_net.training.train import digests
from dosplan_net.weights import save_weights

from tests.support.models import TINY, tiny_network


def save_folds(folder: Path, caches: Sequence[Path], seeds: Sequence[int] = (0, 1)) -> list[Path]:
    """Writes a network for each fold of some caches as training would; each has its own seed."""
    data = digests([WindowCache.open(path) for path in caches])
    weights = [folder / f"fold-{k}.safetensors" for k in range(len(seeds))]
    for path, seed in zip(weights, seeds, strict=True):
        made_from = {"part": path.stem, "folds": len(seeds), "data": data}
        about = {"model": MODEL, "network": asdict(TINY), MADE_FROM: made_from}
        save_weights(path, tiny_network(seed).state_dict(), about)
    return weights
