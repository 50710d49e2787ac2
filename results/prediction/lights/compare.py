"""What two responses to lights bring, on windows with a lit light ahead.

    python results/prediction/lights/compare.py --network predictors/dosplan_net/weights \
        --told lights/net.lights.safetensors --untold control/net.lights.safetensors \
        --data cache/lights-val --json lights.json --markdown lights.md

Intervals are of 95 %, from 2000 draws of recordings with replacement; each is of another road.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import torch
from dosplan_dos.grid import GRID
from dosplan_dos.predictor import shipped_sets
from dosplan_dos.training import load_module
from dosplan_net.light_network import load_response
from dosplan_net.lights import COLOUR_SIZE
from dosplan_net.network import Prediction
from dosplan_net.training.lights import LitWindows, lit_windows, respond
from torch import Tensor

from dosplan.evaluation.groups import MOVING
from dosplan.evaluation.metrics import covered, covering_scale, scaled_area
from dosplan.types import STEP_SECONDS

Array = npt.NDArray[np.float64]
DRAWS: Final = 2000
MISS: Final = 2.0  # m at 4 s
SECONDS: Final = (1, 2, 3, 4)
SETS: Final = "coverage"
PARTS: Final = 4096
NETWORK, UNTOLD, TOLD = "network", "light ahead, nothing of it", "with lights"


@dataclass(frozen=True)
class Method:
    """A method's figures for W windows.

    Attributes:
        error: (W, HORIZON) displacement, m.
        distance: (W, 4) Mahalanobis distance of the truth to the sets at ``SECONDS``.
        area: (W, 4) their areas, m2.
    """

    error: Array
    distance: Array
    area: Array


def main() -> None:
    """Writes the tables."""
    parser = argparse.ArgumentParser()
    for name in ("network", "told", "untold", "data", "json", "markdown"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    network = options.network / "net.safetensors"
    windows = lit_windows(network, [options.data])
    methods = {NETWORK: judge(windows, windows.trajectory)}
    for name, path in ((UNTOLD, options.untold), (TOLD, options.told)):
        with torch.no_grad():
            methods[name] = judge(windows, respond(load_response(path, network), windows))
    recording, valid = windows.recording.numpy(), windows.valid.numpy()
    found = {
        group: figures(methods, rows, recording, valid) for group, rows in groups(windows).items()
    }
    options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    options.markdown.write_text(tables(found), encoding="utf-8")


def judge(windows: LitWindows, trajectory: Tensor) -> Method:
    """Compares trajectories, and the sets of one ellipse around them, with the truth."""
    module = load_module(shipped_sets(SETS))
    at = [round(s / STEP_SECONDS) - 1 for s in SECONDS]
    on_grid = [(step + 1) // GRID - 1 for step in at]
    distances, areas = [], []
    with torch.no_grad():
        for rows in torch.arange(len(trajectory)).split(PARTS):
            features = windows.features[rows]
            found = Prediction(trajectory[rows], windows.log_weight[rows], features)
            likeliest = found.likeliest()
            sets = module(features, likeliest, windows.velocity[rows], windows.history[rows])
            off = (windows.future[rows] - likeliest)[:, GRID - 1 :: GRID]
            distances.append(sets.distance(off)[:, on_grid].numpy())
            areas.append(sets.area[:, on_grid].numpy())
    return Method(
        windows.error(trajectory).numpy().astype(np.float64),
        np.concatenate(distances).astype(np.float64),
        np.concatenate(areas).astype(np.float64),
    )


def groups(windows: LitWindows) -> dict[str, npt.NDArray[np.bool_]]:
    """Windows by what the light shows, and by whether the road user moves."""
    moving = windows.velocity.abs().numpy() >= MOVING
    shown = windows.lights[:, :COLOUR_SIZE].numpy() > 0.0
    found = {"all": np.ones(len(moving), dtype=np.bool_)}
    for column, colour in enumerate(("red", "yellow", "green")):
        found[colour] = shown[:, column]
    for name in tuple(found):
        found[f"{name}, moving"] = found[name] & moving
        found[f"{name}, standing"] = found[name] & ~moving
    return found


def figures(
    methods: dict[str, Method],
    rows: npt.NDArray[np.bool_],
    recording: npt.NDArray[np.int64],
    valid: npt.NDArray[np.bool_],
) -> dict[str, Any]:
    """The figures of each method in a group, and the differences of the last one."""
    ends = rows & valid[:, -1]
    found: dict[str, Any] = {
        "windows": int(rows.sum()),
        "windows at 4 s": int(ends.sum()),
        "recordings": len(np.unique(recording[rows])),
    }
    for name, method in methods.items():
        known = valid[rows]
        error = method.error[rows] * known
        found[name] = {
            "ade": float(error.sum() / known.sum()),
            "fde": float(method.error[ends, -1].mean()),
            "miss": float((method.error[ends, -1] > MISS).mean()),
            "sets": [_sets(method, rows, valid, index) for index in range(len(SECONDS))],
        }
    found["fde, difference"] = {
        name: difference(
            lambda m: np.where(ends, m.error[:, -1], 0.0), methods, name, recording, ends
        )
        for name in (NETWORK, UNTOLD)
    }
    return found


def _sets(
    method: Method, rows: npt.NDArray[np.bool_], valid: npt.NDArray[np.bool_], index: int
) -> dict[str, float | None]:
    chosen = rows & valid[:, round(SECONDS[index] / STEP_SECONDS) - 1]
    distance, area = method.distance[chosen, index], float(method.area[chosen, index].mean())
    scale = covering_scale(distance)
    return {
        "coverage": float(covered(distance).mean()),
        "area": area,
        "area at 90 %": scaled_area(area, scale),
    }


def difference(
    value: Callable[[Method], Array],
    methods: dict[str, Method],
    other: str,
    recording: npt.NDArray[np.int64],
    counted: npt.NDArray[np.bool_],
) -> dict[str, float]:
    """How much smaller the sum of a value is with lights than with another method, in per cent."""
    told = np.bincount(recording, value(methods[TOLD]))
    rest = np.bincount(recording, value(methods[other]))
    present = np.flatnonzero(np.bincount(recording, counted))
    told, rest = told[present], rest[present]
    drawn = np.random.default_rng(1).integers(0, len(present), (DRAWS, len(present)))
    ratio = 100.0 * (told[drawn].sum(1) / rest[drawn].sum(1) - 1.0)
    low, high = np.quantile(ratio, (0.025, 0.975))
    mean = 100.0 * (told.sum() / rest.sum() - 1.0)
    return {"per cent": float(mean), "low": float(low), "high": float(high)}


def tables(found: dict[str, Any]) -> str:
    """Both tables in Markdown."""
    names = (NETWORK, UNTOLD, TOLD)
    lines = [
        f"| light, road user | windows | {' | '.join(f'{n}: ADE, at 4 s, miss' for n in names)} | "
        "at 4 s against the network, % | against nothing of it, % |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for group, row in found.items():
        cells = [
            f"{row[n]['ade']:.2f} / {row[n]['fde']:.2f} / {100 * row[n]['miss']:.1f} %"
            for n in names
        ]
        cells += [
            f"{d['per cent']:+.1f} ({d['low']:+.1f} to {d['high']:+.1f})"
            for d in row["fde, difference"].values()
        ]
        lines.append(f"| {group} | {row['windows']} | {' | '.join(cells)} |")
    lines += [
        "",
        f"| light, road user | {' | '.join(f'{n}: CR %; OSA m2; OSA@90 m2' for n in names)} |",
        "|---|--:|--:|--:|",
    ]
    for group, row in found.items():
        cells = ["; ".join(_sizes(row[n]["sets"])) for n in names]
        lines.append(f"| {group} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _sizes(sets: list[dict[str, float | None]]) -> Iterator[str]:
    for key, factor, digits in (("coverage", 100, 1), ("area", 1, 2), ("area at 90 %", 1, 2)):
        values = [one[key] for one in sets]
        yield " / ".join("-" if v is None else f"{factor * v:.{digits}f}" for v in values)


if __name__ == "__main__":
    main()
