"""Tables of figures for the terminal, with rich."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from dosplan.results.comparison import Comparison
from dosplan.results.markdown import (
    LINE,
    Cells,
    change_cells,
    comparison_cells,
    comparison_note,
    comparison_title,
    folded,
    parted,
    scenario_count,
    summary_cells,
    summary_notes,
    summary_title,
)
from dosplan.results.summary import Summary
from dosplan.results.table import Table as RunTable
from dosplan.results.table_text import block_cells, name_count, notes
from dosplan.results.unusable import unusable_lines
from dosplan.types import Outcome, Score

ERRORS_SHOWN: Final = 10


def summary_tables(summary: Summary) -> RenderableType:
    """Lays a summary out for the terminal.

    Args:
        summary: The summary of a run.

    Returns:
        The figures in one table with a section for each group of metrics, how to read the
        differences where both arms ran, and what is unusable.
    """
    figures = _Figures(summary_cells(summary))
    lines = [*summary_notes(summary), *unusable_lines(summary.unusable, scenario_count(summary))]
    return Group(Prose(summary_title(summary)), figures, *map(Prose, lines))


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
    changed: RenderableType = Prose("No outcome differs.")
    if comparison.changes:
        changed = table(*change_cells(comparison), numbers=False)
    return Group(
        Prose(comparison_title(comparison)),
        *(table(*cells) for cells in comparison_cells(comparison)),
        Prose(comparison_note(comparison)),
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
        names = name_count(block)
        parts.append(Prose(block.title))
        parts += [table(*cells, names=names) for cells in block_cells(found, block)]
    return [*parts, *map(Prose, notes(found))]


class Prose:
    """Text in lines of at most ``LINE`` characters, whatever rich takes for markup in it."""

    def __init__(self, text: str) -> None:
        """Takes the text.

        Args:
            text: It; words longer than a line, such as paths, stay whole.
        """
        self._text = text

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(folded(self._text, min(options.max_width, LINE)))


def table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], numbers: bool = True, names: int = 1
) -> RenderableType:
    """Builds a plain table, its first column to the left.

    Args:
        headings: Column headings.
        rows: Cells.
        numbers: Whether the other columns hold numbers and go to the right; it becomes several
            tables then where a line of the terminal, or ``LINE``, is too short for all.
        names: How many columns name the rows.

    Returns:
        The table.
    """
    cells = (list(headings), [list(row) for row in rows])
    return _Figures([cells], names) if numbers else _built([cells], numbers=False)


class _Figures:
    """Figures in as many tables as it takes for the lines not to be too long."""

    def __init__(self, sections: Sequence[Cells], names: int = 1) -> None:
        self._sections, self._names = sections, names

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        width = min(options.max_width, LINE) - 1
        for part in parted(self._sections, width, gap=3, names=self._names):
            yield _built(part)


def _built(sections: Sequence[Cells], numbers: bool = True) -> Table:
    built = Table(box=box.SIMPLE_HEAD)
    for index, heading in enumerate(sections[0][0]):
        built.add_column(heading, justify="right" if numbers and index > 0 else "left")
    for index, ((title, *_), rows) in enumerate(sections):
        if index:
            built.add_row()
            built.add_row(Text(title, style="table.header"))
        for row in rows:
            built.add_row(*row)
    return built
