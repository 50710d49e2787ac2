"""Tables of figures: for the terminal with rich, for files as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table

from dosplan.results.comparison import Comparison, Difference
from dosplan.results.summary import Summary
from dosplan.types import Arm, Score

ERRORS_SHOWN: Final = 10
ARM_TITLES: Final = {Arm.WITH_DOS: "with DOS", Arm.WITHOUT_DOS: "without DOS"}
ARMS_SIDE_BY_SIDE: Final = (Arm.WITHOUT_DOS, Arm.WITH_DOS)
"""The arms from left to right, as they are compared: with minus without."""

Column = tuple[str, str, Callable[[Any], str]]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f}"


def _decimal(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _milliseconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


# Heading, key of the summary, format. The first table is the one of the paper; TTC is the time
# to collision.
_MAIN: Final[Sequence[Column]] = (
    ("Success %", "success_rate", _percent),
    ("Collision %", "collision_rate", _percent),
    ("Out of bounds %", "out_of_bounds_rate", _percent),
    ("Velocity m/s", "velocity", _decimal),
    ("n", "n", str),
)
_MORE: Final[Sequence[Column]] = (
    ("Safe %", "safe_rate", _percent),
    ("At-fault collision %", "at_fault_collision_rate", _percent),
    ("Goal missed %", "goal_missed_rate", _percent),
    ("Planner failure %", "planner_failure_rate", _percent),
)
_RIDE: Final[Sequence[Column]] = (
    ("Progress m", "progress", _decimal),
    ("Comfortable %", "comfortable_rate", _percent),
    ("Min TTC s", "min_time_to_collision", _decimal),
    ("Cycle p50 ms", "cycle_ms_p50", _milliseconds),
    ("Cycle p99 ms", "cycle_ms_p99", _milliseconds),
)


def summary_tables(summary: Summary) -> RenderableType:
    """Lays a summary out for the terminal.

    Args:
        summary: The summary of a run.

    Returns:
        The paper's columns, the further ones, and a line on the paired difference where both
        arms ran.
    """
    tables = [table(*_cells(summary, columns)) for columns in (_MAIN, _MORE, _RIDE)]
    return Group(_title(summary), *tables, *_difference_lines(summary))


def summary_markdown(summary: Summary) -> str:
    """Writes a summary as Markdown.

    Args:
        summary: The summary of a run.

    Returns:
        The text of ``summary.md``.
    """
    blocks = [f"# {_title(summary)}"]
    blocks += [markdown(*_cells(summary, columns)) for columns in (_MAIN, _MORE, _RIDE)]
    blocks += _difference_lines(summary)
    return "\n\n".join(blocks) + "\n"


def error_lines(rows: Iterable[Score]) -> list[str]:
    """Lists what went wrong in a run.

    Args:
        rows: Its rows.

    Returns:
        One line for each distinct error, the most frequent first, with its count and the first
        episode it befell; after ``ERRORS_SHOWN`` of them, one line that counts the others.
    """
    befallen: dict[str, list[Score]] = {}
    for row in rows:
        if row.error is not None:
            befallen.setdefault(row.error, []).append(row)
    errors = sorted(befallen.items(), key=lambda item: -len(item[1]))
    lines = [
        f"{len(failed)} x {error} [{failed[0].scenario}, {failed[0].arm.value}]"
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
        ["", "n", "A", "B", "B - A", "95 % interval", "A only", "B only", "McNemar p"],
        [
            _difference_row("Success %", comparison.success, 100.0),
            _difference_row("Safe %", comparison.safe, 100.0),
            _difference_row("Collision %", comparison.collision, 100.0),
            _difference_row("At-fault collision %", comparison.at_fault_collision, 100.0),
            *(
                [_difference_row("Velocity m/s", comparison.velocity, 1.0)]
                if comparison.velocity is not None
                else []
            ),
        ],
    )
    changes = table(
        ["Scenario whose outcome differs", "A", "B"],
        [[c.scenario, c.a.value, c.b.value] for c in comparison.changes],
        numbers=False,
    )
    title = f"A = {comparison.a}\nB = {comparison.b}\nn = {comparison.n}"
    return Group(title, differences, changes if comparison.changes else "No outcome differs.")


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


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Writes a table as Markdown, columns as in a ``table`` of numbers.

    Args:
        headings: Column headings.
        rows: Cells.

    Returns:
        The table's lines.
    """
    rule = ["---", *["---:"] * (len(headings) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (headings, rule, *rows))


def _cells(summary: Summary, columns: Sequence[Column]) -> tuple[list[str], list[list[str]]]:
    rows = [
        [ARM_TITLES[arm], *(form(getattr(figures, key)) for _, key, form in columns)]
        for arm, figures in summary.arms.items()
    ]
    return ["Arm", *(heading for heading, _, _ in columns)], rows


def _title(summary: Summary) -> str:
    run = summary.run
    mark = "" if run.ranked else " (unranked: the predictor may see the future)"
    options = (
        f"{plugin}.{name}={value}"
        for plugin, chosen in (
            ("planner", run.planner_options),
            ("predictor", run.predictor_options),
        )
        for name, value in chosen.items()
    )
    told = ", ".join([f"seed {run.seed}", *options])
    return f"{run.planner} with {run.predictor} on {run.source}, {told}{mark}"


def _difference_lines(summary: Summary) -> list[str]:
    if summary.comparison is None:
        return []
    success = summary.comparison.success
    return [
        f"Success, with DOS minus without: {100.0 * success.difference:+.1f} points "
        f"(95 % interval {100.0 * success.low:+.1f} to {100.0 * success.high:+.1f}; "
        f"McNemar p = {success.p:.3g}, n = {summary.comparison.n})"
    ]


def _difference_row(title: str, figure: Difference, scale: float) -> list[str]:
    return [
        title,
        str(figure.n),
        f"{scale * figure.a:.2f}",
        f"{scale * figure.b:.2f}",
        f"{scale * figure.difference:+.2f}",
        f"{scale * figure.low:+.2f} to {scale * figure.high:+.2f}",
        *("-" if count is None else str(count) for count in (figure.only_a, figure.only_b)),
        "-" if figure.p is None else f"{figure.p:.3g}",
    ]
