"""Tables of figures for the terminal, with rich."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from dosplan.results.comparison import Comparison
from dosplan.results.markdown import (
    difference_lines,
    interval_text,
    scenario_count,
    size_text,
    summary_cells,
    summary_title,
    test_name,
)
from dosplan.results.paired import Difference
from dosplan.results.summary import Summary
from dosplan.results.unusable import unusable_lines
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Metric
from dosplan.types import Outcome, ScenarioFuture, Score

ERRORS_SHOWN: Final = 10


def summary_tables(summary: Summary) -> RenderableType:
    """Lays a summary out for the terminal.

    Args:
        summary: The summary of a run.

    Returns:
        The paper's columns, the further ones, a line on the paired difference where both arms ran,
        and what is unusable.
    """
    tables = [table(*cells) for cells in summary_cells(summary)]
    told = unusable_lines(summary.unusable, scenario_count(summary))
    lines = map(Text, told)  # Reasons may hold what rich takes for markup.
    return Group(summary_title(summary), *tables, *difference_lines(summary), *lines)


def error_lines(rows: Iterable[Score]) -> list[str]:
    """Lists what went wrong in the episodes of a run.

    Args:
        rows: Its rows; those that are unusable are told elsewhere.

    Returns:
        One line for each distinct error, the most frequent first, with its count and the first
        episode in which it occurred; after ``ERRORS_SHOWN`` of them, a line that counts the others.
    """
    rows_of: dict[str, list[Score]] = {}
    for row in rows:
        if row.error is not None and row.outcome is not Outcome.UNUSABLE:
            rows_of.setdefault(row.error, []).append(row)
    errors = sorted(rows_of.items(), key=lambda item: -len(item[1]))
    lines = [
        f"{len(failed)} x {error} [{failed[0].key.title}]"
        for error, failed in errors[:ERRORS_SHOWN]
    ]
    if len(errors) > ERRORS_SHOWN:
        lines.append(f"and {len(errors) - ERRORS_SHOWN} further errors; the rows hold them all")
    return lines


def comparison_tables(comparison: Comparison) -> RenderableType:
    """Lays a comparison out for the terminal.

    Args:
        comparison: The comparison.

    Returns:
        The differences, then the scenarios whose outcome differs.
    """
    differences = table(
        ["", "n", "A", "B", "B - A", "95 % interval", "A only", "B only", "p", "p, places"],
        [
            _difference_row(metric, comparison.differences[metric.name])
            for metric in metrics.METRICS
            if metric.name in comparison.differences
        ],
    )
    changes = table(
        ["Scenario whose outcome differs", "A", "B"],
        [[ScenarioFuture(c.scenario, c.future).title, c.a, c.b] for c in comparison.changes],
        numbers=False,
    )
    title = f"A = {comparison.a}\nB = {comparison.b}\n{size_text(comparison)}"
    if comparison.unusable:
        title += f"; left out as unusable or failed by the traffic: {comparison.unusable}"
    notes = (
        "Intervals take into account that several scenarios are of one place. p of a share: exact "
        f"{test_name(comparison)} test over scenarios, and sign-flip test over places; of a mean: "
        "t test over places."
    )
    changed = changes if comparison.changes else "No outcome differs."
    return Group(title, differences, notes, changed)


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], numbers: bool = True) -> Table:
    """Builds a plain table, its first column to the left.

    Args:
        headings: Column headings.
        rows: Cells.
        numbers: Whether the other columns hold numbers and go to the right.

    Returns:
        The table.
    """
    built = Table(box=box.SIMPLE_HEAD)
    for index, heading in enumerate(headings):
        built.add_column(heading, justify="right" if numbers and index > 0 else "left")
    for row in rows:
        built.add_row(*row)
    return built


def _difference_row(metric: Metric, figure: Difference) -> list[str]:
    return [
        metric.heading,
        str(figure.n),
        metric.shown(figure.a),
        metric.shown(figure.b),
        metric.shown(figure.difference, "+"),
        interval_text(metric, figure),
        *("-" if count is None else str(count) for count in (figure.only_a, figure.only_b)),
        *("-" if p is None else f"{p:.3g}" for p in (figure.p, figure.p_places)),
    ]
