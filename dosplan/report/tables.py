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
    change_cells,
    comparison_cells,
    comparison_note,
    comparison_title,
    difference_lines,
    scenario_count,
    summary_cells,
    summary_title,
)
from dosplan.results.summary import Summary
from dosplan.results.table import Table as RunTable
from dosplan.results.table_text import block_cells, notes
from dosplan.results.unusable import unusable_lines
from dosplan.types import Outcome, Score

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
    changed: RenderableType = "No outcome differs."
    if comparison.changes:
        changed = table(*change_cells(comparison), numbers=False)
    return Group(
        comparison_title(comparison),
        table(*comparison_cells(comparison)),
        comparison_note(comparison),
        changed,
    )


def run_tables(found: RunTable) -> list[RenderableType]:
    """Lays a table of runs out for the terminal.

    Args:
        found: The table.

    Returns:
        For each block its title and tables; then the notes.
    """
    parts: list[RenderableType] = []
    for block in found.blocks:
        parts += [block.title, *(table(*cells) for cells in block_cells(found, block))]
    return [*parts, *notes(found)]


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
