"""Displacement errors of trained networks, and of the mean of their trajectories, on a cache.

    python results/prediction/ablations/displacement.py CACHE WEIGHTS...

Road users that move or are about to, recorded and simulated apart.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from dosplan_net.build import load_network
from dosplan_net.features import HORIZON
from dosplan_net.training.batches import Selection
from dosplan_net.training.cache import WindowCache
from dosplan_net.training.train import run_over
from torch import Tensor


def main() -> None:
    """Prints a line for each network and for their mean."""
    torch.set_num_threads(1)
    folder, *files = map(Path, sys.argv[1:])
    cache = WindowCache.open(folder)
    simulated = torch.tensor(cache.simulated)
    everything = Selection(cache, np.arange(cache.scenes))
    groups = ("all", "recorded", "simulated")
    total = torch.zeros(len(files) + 1, len(groups), HORIZON)
    count = torch.zeros(len(groups), HORIZON)
    for runs in zip(*(run_over(load_network(file), everything) for file in files), strict=True):
        batch = runs[0][0]
        trajectories = torch.stack([found.likeliest() for _, found in runs])
        trajectories = torch.cat([trajectories, trajectories.mean(0, keepdim=True)])
        error = (trajectories - batch.future[..., :2]).norm(dim=-1)
        artificial = simulated[batch.recording]
        member = torch.stack([torch.ones_like(artificial), ~artificial, artificial])
        counted = member[:, :, None] & batch.instructive[:, None] & batch.future_valid
        total += torch.einsum("mbt,gbt->mgt", error, counted.float())
        count += counted.sum(1)
    for name, errors in zip([*map(str, files), "mean of them"], total, strict=True):
        print(name, *map(_figures, groups, errors, count), sep="  ")


def _figures(group: str, total: Tensor, count: Tensor) -> str:
    ade = float(total.sum() / count.sum())
    return f"{group}: ADE {ade:.3f} FDE {float(total[-1] / count[-1]):.3f} m"


if __name__ == "__main__":
    main()
