"""Draws one scenario of each kind of a suite: ``python scenarios/contact_sheet.py``."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dosplan.report.film.paint import LAMP_HANDLER
from dosplan.report.film.scene import draw_scene, legend_handles
from dosplan.scenario import load_scenario
from dosplan.types import FloatArray, Scenario

HERE = Path(__file__).resolve().parent
CONFLICTS = ("crossing", "merging", "leading")
COLUMNS = 4
SIDE = 3.2
LATER = 4.0
"""Time after the ego's start at which futures are compared, s."""
APART = 2.0
"""Distance from which on somebody is drawn as elsewhere, m."""


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description="Draw one scenario of each kind of a suite.")
    parser.add_argument("--suite", type=Path, default=HERE / "suite", help="folder of manifest.csv")
    parser.add_argument("--out", type=Path, help="picture (default: in that folder)")
    options = parser.parse_args()
    draw_sheet(options.suite, options.out or options.suite / "contact_sheet.png")


def draw_sheet(suite: Path, out: Path) -> None:
    """Draws a contact sheet.

    Args:
        suite: Folder of ``manifest.csv``.
        out: The picture.
    """
    with (suite / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    kinds = list(dict.fromkeys(_kind(row) for row in rows))
    chosen = [_shown([row for row in rows if _kind(row) == kind]) for kind in kinds]
    scenarios = [load_scenario(suite / row["file"]) for row in chosen]
    lines = -(-len(chosen) // COLUMNS)
    figure = Figure(figsize=(SIDE * COLUMNS, (SIDE + 0.35) * lines + 0.4), layout="constrained")
    grid = figure.subplots(lines, COLUMNS, squeeze=False)
    for axes, row, scenario in zip(grid.flat, chosen, scenarios, strict=False):
        draw_scene(axes, scenario, scenario.task.start_step)
        _draw_futures(axes, scenario)
        axes.set_title(f"{_kind(row)}\n{row['id']}", fontsize=8)
    for axes in grid.flat[len(chosen) :]:
        axes.set_visible(False)
    figure.legend(
        handles=legend_handles(*scenarios),
        handler_map=dict(LAMP_HANDLER),
        loc="outside lower center",
        ncols=7,
    )
    figure.savefig(out, dpi=110)


def _draw_futures(axes: Axes, scenario: Scenario) -> None:
    """Marks where those are after ``LATER`` who are elsewhere in some future, one for each future.

    Thin lines lead there.
    """
    start = scenario.task.start_step
    steps = slice(start, start + round(LATER / scenario.dt) + 1)
    ways: dict[int, list[FloatArray]] = {}
    for k in range(1 + len(scenario.futures) if scenario.futures else 0):
        tracks = scenario.recorded(k)
        for name, states, valid in zip(tracks.ids, tracks.states, tracks.valid, strict=True):
            ways.setdefault(int(name), []).append(states[steps, :2][valid[steps]])
    for lines in ways.values():
        ends = np.array([line[-1] for line in lines if len(line)])
        if len(ends) and np.ptp(ends, axis=0).max() > APART:
            for line in lines:
                axes.plot(*line.T, color="black", linewidth=0.5, zorder=7)
            axes.scatter(ends[:, 0], ends[:, 1], s=9, color="white", edgecolor="black", zorder=7)


def _kind(row: Mapping[str, str]) -> str:
    """The kind of a scenario, which in the first suite is one of roads."""
    return row.get("kind") or row["road_kind"]


def _shown(rows: Sequence[Mapping[str, str]]) -> Mapping[str, str]:
    """The first scenario; of the first suite, with the conflict that has most of the road in it."""
    if "defeats_constant_speed" not in rows[0]:
        return rows[0]
    return min(rows, key=lambda row: CONFLICTS.index(row["defeats_constant_speed"].split()[0]))


if __name__ == "__main__":
    main()
