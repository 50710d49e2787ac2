"""The paper's Table 4 beside the published runs, in its columns, with 95 % intervals.

python results/suite/paper_table.py      # writes paper_table.md
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dosplan.results.intervals import metric_interval
from dosplan.results.markdown import markdown
from dosplan.results.rows import read_rows
from dosplan.scoring.metrics import find_metric
from dosplan.system.files import write_text
from dosplan.types import Arm, Score

RESULTS: Final = Path(__file__).parents[1]
PAPER: Final = (
    ["the paper, its Table 4", "without", "150", "90.0", "10.0", "0.0", "5.47"],
    ["", "with", "150", "94.7", "5.3", "0.0", "5.71"],
)
RUNS: Final = {
    "suite, two futures each, ideal loop": "suite",
    "[suite-1](../suite-1/README.md), ideal loop": "suite-1",
    "[recorded](../recorded/README.md), ideal loop": "recorded",
    **{
        f"{shown}, {world}": f"proof/runs/loop={loop},{kept}"
        for shown, kept in (
            (
                "[fresh suite](../proof/README.md), five futures each",
                "scenarios=fresh,traffic=replay",
            ),
            ("[recorded](../proof/README.md)", "scenarios=bench,traffic=replay"),
        )
        for world, loop in (("0.3 s late", "late"), ("realistic loop", "realistic"))
    },
}
COLUMNS: Final = {"safe": 1, "collision": 1, "out_of_bounds": 1, "velocity": 2}
"""Metrics of the paper's columns, and decimal places."""


def cells(rows: list[Score]) -> list[str]:
    """The figures of one arm.

    Args:
        rows: Its rows.

    Returns:
        Each column with its interval: shares in %, the velocity in m/s.
    """
    shown = []
    for name, digits in COLUMNS.items():
        found = metric_interval(find_metric(name), rows)
        assert found is not None
        scale = 1.0 if name == "velocity" else 100.0
        value, low, high = (f"{scale * x:.{digits}f}" for x in (found.value, found.low, found.high))
        shown.append(f"{value} [{low}, {high}]")
    return shown


def main() -> None:
    """Writes the table."""
    lines = list(PAPER)
    for label, folder in RUNS.items():
        rows = read_rows(RESULTS / folder / "scenarios.jsonl")
        for arm, word in ((Arm.WITHOUT_DOS, "without"), (Arm.WITH_DOS, "with")):
            mine = [row for row in rows if row.arm is arm]
            name = label if arm is Arm.WITHOUT_DOS else ""
            lines.append([name, word, str(len(mine)), *cells(mine)])
    header = ["replay", "sets", "n", "success (safe), %", "collision, %", "out of bounds, %"]
    write_text(
        Path(__file__).with_suffix(".md"), markdown([*header, "velocity, m/s"], lines) + "\n"
    )


if __name__ == "__main__":
    main()
