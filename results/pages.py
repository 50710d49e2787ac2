"""Writes the tables of the pages from the published runs.

python results/pages.py      # README.md and the pages of results/, between their marks

A page has a table between ``<!-- KIND RUN: begin -->`` and ``<!-- KIND RUN: end -->``, the run a
folder below ``results/``. The kinds are ``MAKERS``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from dosplan.results.comparison import compare_runs
from dosplan.results.intervals import metric_interval
from dosplan.results.markdown import interval_text, markdown
from dosplan.results.rows import read_rows
from dosplan.results.table import make_table
from dosplan.results.table_text import block_cells
from dosplan.scoring.metrics import find_metric
from dosplan.system.files import write_text
from dosplan.types import Arm, Score

RESULTS: Final = Path(__file__).parent
MARKS: Final = re.compile(r"(<!-- (\w+) ([\w/-]+): begin -->\n).*?(<!-- \2 \3: end -->)", re.DOTALL)

COMPARED: Final = {
    "success": "success, %",
    "collision": "collision, %",
    "at_fault_collision": "at-fault collision, %",
    "out_of_bounds": "out of bounds, %",
    "goal_missed": "goal missed, %",
    "velocity": "velocity, m/s",
    "nuplan_score": "nuPlan's score, %",
    "comfortable": "comfortable, %",
    "time_over_limit": "time above the limit, %",
    "min_time_to_collision": "smallest time to collision, s",
    "max_abs_acceleration": "largest acceleration, m/s²",
    "max_abs_jerk": "largest jerk, m/s³",
}
"""Metrics of a comparison, and how they are called there."""

PAPER: Final = (
    ("the paper, its Table 4", "without", "150", "90.0", "10.0", "0.0", "5.47"),
    ("", "with", "150", "94.7", "5.3", "0.0", "5.71"),
)
PAPER_HEADER: Final = (
    "replay", "sets", "n", "success (safe), %", "collision, %", "out of bounds, %", "velocity, m/s",
)  # fmt: skip
PAPER_COLUMNS: Final = ("safe", "collision", "out_of_bounds", "velocity")
"""Metrics of the paper's columns."""
BESIDE_THE_PAPER: Final = {
    "suite, two futures each, ideal loop": "suite",
    "suite, two futures each, realistic loop": "suite/realistic",
    "[suite-1](../suite-1/README.md), ideal loop": "suite-1",
    "[recorded](../recorded/README.md), ideal loop": "recorded",
    "[recorded](../recorded/README.md), realistic loop": "recorded/realistic",
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


def summary(run: str) -> str:
    """The main figures of a run: the first table of its summary.

    Args:
        run: Its folder below ``results/``.

    Returns:
        The table, in Markdown.
    """
    blocks = (RESULTS / run / "summary.md").read_text(encoding="utf-8").split("\n\n")
    return next(block for block in blocks if block.startswith("|"))


def comparison(run: str) -> str:
    """A run's arm with sets against its arm without.

    Args:
        run: Its folder below ``results/``.

    Returns:
        The table, in Markdown.
    """
    (found,) = compare_runs([str(RESULTS / run)])
    lines = []
    for name, label in COMPARED.items():
        metric, one = find_metric(name), found.differences[name]
        figures = (metric.shown(one.a), metric.shown(one.b), metric.shown(one.difference, "+"))
        counts = "" if one.only_a is None else f"{one.only_b} / {one.only_a}"
        p = "" if one.p is None else _p(one.p)
        lines.append((label, *figures, interval_text(metric, one), counts, p))
    header = ("", "without", "with", "difference", "95 % interval", "only with / only without", "p")
    return markdown(header, lines)


def _p(p: float) -> str:
    for bound in (0.0001, 0.001):
        if p < bound:
            return f"< {bound:g}"
    return f"{p:.3f}" if p < 0.01 else f"{p:.2f}"


def paper(_: str) -> str:
    """The paper's Table 4 beside the published runs, in its columns, with 95 % intervals.

    Returns:
        The table, in Markdown.
    """
    lines: list[tuple[str, ...]] = list(PAPER)
    for label, folder in BESIDE_THE_PAPER.items():
        rows = read_rows(RESULTS / folder / "scenarios.jsonl")
        for arm, word in ((Arm.WITHOUT_DOS, "without"), (Arm.WITH_DOS, "with")):
            mine = [row for row in rows if row.arm is arm]
            name = label if arm is Arm.WITHOUT_DOS else ""
            lines.append((name, word, str(len(mine)), *_with_intervals(mine)))
    return markdown(PAPER_HEADER, lines)


def _with_intervals(rows: list[Score]) -> Iterator[str]:
    for name in PAPER_COLUMNS:
        metric = find_metric(name)
        found = metric_interval(metric, rows)
        assert found is not None
        value, low, high = (metric.shown(x) for x in (found.value, found.low, found.high))
        yield f"{value} [{low}, {high}]"


def frontier(runs: str) -> str:
    """The figures of every run of a sweep over methods and coverage.

    Args:
        runs: The sweep's folder below ``results/``.

    Returns:
        The table, in Markdown.
    """
    table = make_table([str(RESULTS / runs)], baseline="method=points")
    (block,) = table.blocks
    headings, rows = next(iter(block_cells(table, block)))
    named = [[re.sub(r"method=([\w-]+)(,coverage=)?", _method, row[0]), *row[1:]] for row in rows]
    return markdown(headings, named)


def proof(run: str) -> str:
    """The cells of the proof as ``proof.py`` judged them.

    Args:
        run: Its folder below ``results/``.

    Returns:
        The table, in Markdown.
    """
    return (RESULTS / run / "proof.md").read_text(encoding="utf-8").strip()


def _method(found: re.Match[str]) -> str:
    return found[1] + (" at " if found[2] else "")


MAKERS: Final[Mapping[str, Callable[[str], str]]] = {
    "summary": summary,
    "comparison": comparison,
    "paper": paper,
    "frontier": frontier,
    "proof": proof,
}
"""What makes the tables of each kind, from the name of a run."""


def written(text: str) -> str:
    """A page with its tables as the runs have them.

    Args:
        text: The page.

    Returns:
        The same with the text between its marks made anew.
    """
    return MARKS.sub(lambda m: m[1] + MAKERS[m[2]](m[3]) + "\n" + m[4], text)


def pages() -> list[Path]:
    """Those that have marks."""
    found = [RESULTS.parent / "README.md", *sorted(RESULTS.glob("*/README.md"))]
    return [page for page in found if MARKS.search(page.read_text(encoding="utf-8"))]


def main() -> None:
    """Writes them."""
    for page in pages():
        write_text(page, written(page.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
