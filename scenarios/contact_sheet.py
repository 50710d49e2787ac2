"""Draws one scenario of each road kind: ``python scenarios/contact_sheet.py``."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from dosplan.report.film.paint import LAMP_HANDLER
from dosplan.report.film.scene import draw_scene, legend_handles
from dosplan.scenario import load_scenario

HERE = Path(__file__).resolve().parent
CONFLICTS = ("crossing", "merging", "leading")
COLUMNS = 4
SIDE = 3.2


def main() -> None:
    """Runs the command."""
    parser = argparse.ArgumentParser(description="Draw one scenario of each road kind.")
    parser.add_argument(
        "--suite", type=Path, default=HERE, help="folder of manifest.csv (default: here)"
    )
    parser.add_argument("--out", type=Path, default=HERE / "contact_sheet.png", help="picture")
    options = parser.parse_args()
    draw_sheet(options.suite, options.out)


def draw_sheet(suite: Path, out: Path) -> None:
    """Draws a contact sheet.

    Args:
        suite: Folder of ``manifest.csv``.
        out: The picture.
    """
    with (suite / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    kinds = list(dict.fromkeys(row["road_kind"] for row in rows))
    chosen = [_shown([row for row in rows if row["road_kind"] == kind]) for kind in kinds]
    scenarios = [load_scenario(suite / row["file"]) for row in chosen]
    lines = -(-len(chosen) // COLUMNS)
    figure = Figure(figsize=(SIDE * COLUMNS, (SIDE + 0.35) * lines + 0.4), layout="constrained")
    grid = figure.subplots(lines, COLUMNS, squeeze=False)
    for axes, row, scenario in zip(grid.flat, chosen, scenarios, strict=False):
        draw_scene(axes, scenario, scenario.task.start_step)
        axes.set_title(f"{row['road_kind']}\n{row['id']}", fontsize=8)
    figure.legend(
        handles=legend_handles(*scenarios),
        handler_map=dict(LAMP_HANDLER),
        loc="outside lower center",
        ncols=7,
    )
    figure.savefig(out, dpi=110)


def _shown(rows: Sequence[Mapping[str, str]]) -> Mapping[str, str]:
    """The first of the scenarios with the conflict that has most of the road in it."""
    return min(rows, key=lambda row: CONFLICTS.index(row["defeats_constant_speed"].split()[0]))


if __name__ == "__main__":
    main()
