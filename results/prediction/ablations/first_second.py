"""Where the displacement of the first second comes from, on windows of road users that move.

    python results/prediction/ablations/first_second.py CACHE NETWORK.safetensors ...

Prints a Markdown table: what share of the windows are of a kind, and the mean displacement at 0.5 s
and at 1 s of each network's most likely trajectory, m. Only windows with a second of history and of
future count.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import torch
from dosplan_net.build import load_network
from dosplan_net.training.batches import RawBatch, Selection
from dosplan_net.training.cache import WindowCache
from dosplan_net.training.train import run_over

from dosplan.types import STEP_SECONDS

Array = npt.NDArray[np.float64]
SECOND: Final = 10  # Steps.
AT: Final = (SECOND // 2 - 1, SECOND - 1)
_TIMES: Final = STEP_SECONDS * np.arange(-SECOND, 1)
_PAST: Final = np.stack([np.ones(SECOND + 1), _TIMES, _TIMES**2], axis=1)
_AHEAD: Final = np.stack([-_TIMES[:-1], _TIMES[:-1] ** 2], axis=1)[::-1]


def main() -> None:
    """Prints the table."""
    torch.set_num_threads(1)
    folder, *files = map(Path, sys.argv[1:])
    cache = WindowCache.open(folder)
    everything = Selection(cache, np.arange(cache.scenes))
    errors: list[list[Array]] = [[] for _ in files]
    kinds: list[dict[str, npt.NDArray[np.bool_]]] = []
    own: list[Array] = []
    for runs in zip(*(run_over(load_network(file), everything) for file in files), strict=True):
        batch = runs[0][0]
        rows = torch.where(_whole(batch))[0]
        for part, (_, found) in zip(errors, runs, strict=True):
            off = found.likeliest()[rows] - batch.future[rows, :, :2]
            part.append(off[:, AT].norm(dim=-1).double().numpy())
        kinds.append(_kinds(batch, rows, cache))
        own.append(_own(batch, rows))
    chosen = {name: np.concatenate([part[name] for part in kinds]) for name in kinds[0]}
    found = [np.concatenate(part) for part in errors]
    smooth = np.concatenate(own)
    heads = [f"{file.parent.name}/{file.stem}: 0.5 s, 1 s" for file in files]
    print(f"| windows | share, % | {' | '.join(heads)} |\n|{'--|' * (len(files) + 2)}")
    for name, rows in chosen.items():
        cells = [" / ".join(f"{e:.3f}" for e in error[rows].mean(0)) for error in found]
        print(f"| {name} | {100 * rows.mean():.1f} | {' | '.join(cells)} |")
    off = " / ".join(f"{e:.3f}" for e in smooth.mean(0))
    print(f"\nThe truth against its own parabola over the second, m: {off}")


def _whole(batch: RawBatch) -> torch.Tensor:
    """(B,) windows with a second of history and of future, of road users that move."""
    past = batch.history[:, -SECOND - 1 :, 5].all(1)
    return batch.instructive & past & batch.future_valid[:, :SECOND].all(1)


def _kinds(
    batch: RawBatch, rows: torch.Tensor, cache: WindowCache
) -> dict[str, npt.NDArray[np.bool_]]:
    past = batch.history[rows, -SECOND - 1 :].double().numpy()
    ahead = batch.future[rows, :SECOND, :2].double().numpy()
    fit = np.linalg.pinv(_PAST) @ past[..., :2]
    rough = np.linalg.norm(past[..., :2] - _PAST @ fit, axis=-1).mean(axis=1)
    speed = past[:, -1, 4]
    before = 2.0 * fit[:, 2, 0]
    after = 2.0 * (ahead[:, -1, 0] - speed)
    change = after - before
    turn = np.abs(np.arctan2(ahead[:, -1, 1], np.maximum(ahead[:, -1, 0], 0.3)))
    simulated = np.array(cache.simulated)[batch.recording[rows].numpy()]
    found = {"all": np.ones(len(rows), dtype=np.bool_)}
    found |= {"recorded": ~simulated, "simulated": simulated}
    for low, high in ((0.0, 0.01), (0.01, 0.03), (0.03, 0.06), (0.06, np.inf)):
        found[f"history off its parabola by {low:g} to {high:g} m"] = (rough >= low) & (
            rough < high
        )
    found["goes on as before: acceleration changes by less than 0.5 m/s2"] = np.abs(change) < 0.5
    found["brakes: changes by -2 m/s2 or more"] = change <= -2.0
    found["speeds up: changes by 2 m/s2 or more"] = change >= 2.0
    found["turns: 0.1 rad or more over the second"] = turn >= 0.1
    for low, high in ((0.0, 2.0), (2.0, 8.0), (8.0, 16.0), (16.0, np.inf)):
        found[f"{low:g} to {high:g} m/s"] = (np.abs(speed) >= low) & (np.abs(speed) < high)
    return found


def _own(batch: RawBatch, rows: torch.Tensor) -> Array:
    """(W, 2) distance of the truth from the parabola through where it is that fits it best."""
    ahead = batch.future[rows, :SECOND, :2].double().numpy()
    off = ahead - _AHEAD @ (np.linalg.pinv(_AHEAD) @ ahead)
    return np.asarray(np.linalg.norm(off, axis=-1)[:, AT])


if __name__ == "__main__":
    main()
