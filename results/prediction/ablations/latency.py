"""Times of trained networks on the same scenes, side by side, one thread.

    python results/prediction/ablations/latency.py CACHE WEIGHTS...

Scenes are taken in batches of some thirty road users; the map's pieces or images are made anew for
each, as in a planning cycle.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import torch
from dosplan_net.build import load_network
from dosplan_net.training.batches import Selection, in_order
from dosplan_net.training.cache import WindowCache

_BATCHES = 120
_ROAD_USERS = 30


def main() -> None:
    """Prints the median of each network, and how many times that of the first it is."""
    torch.set_num_threads(1)
    folder, *files = map(Path, sys.argv[1:])
    cache = WindowCache.open(folder)
    networks = [load_network(file).eval() for file in files]
    seconds: list[list[float]] = [[] for _ in networks]
    users = []
    batches = in_order(Selection(cache, np.arange(cache.scenes)), _ROAD_USERS)
    with torch.no_grad():
        for batch, _ in zip(batches, range(_BATCHES), strict=False):
            everyone = torch.arange(len(batch.pose))
            users.append(len(everyone))
            for network, times in zip(networks, seconds, strict=True):
                began = time.process_time()
                network(batch.scene(network.map_encoder, everyone))
                times.append(time.process_time() - began)
    print(f"{np.median(users):g} road users")
    medians = np.median(seconds, axis=1)
    for file, median in zip(files, medians, strict=True):
        print(f"{file}  {1e3 * median:.2f} ms  {median / medians[0]:.2f} times the first")


if __name__ == "__main__":
    main()
