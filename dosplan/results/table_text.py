"""A table of runs as text: for the terminal, Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from dosplan.results.markdown import ARM_TITLES, Cells, aligned, folded, markdown
from dosplan.results.paired import Difference
from dosplan.results.table import Block, Figure, Row, Table
from dosplan.scoring.metrics import Metric


def markdown_table(table: Table) -> str:
    """Writes a table as Markdown.

    Args:
        table: The table.

    Returns:
        For each block its title and tables, and the notes.
    """
    parts = []
    for block in table.blocks:
        parts.append(f"**{block.title}**")
        for headings, rows in block_cells(table, block):
            # A run's name is a path and may hold any sign; a bar would begin another cell.
            cells = [[cell.replace("|", r"\|") for cell in row] for row in (headings, *rows)]
            parts.append(markdown(cells[0], cells[1:]))
    return "\n\n".join([*parts, *notes(table)]) + "\n"


def plain_table(table: Table) -> str:
    """Writes a table as text in columns.

    Args:
        table: The table.

    Returns:
        For each block its title and tables, and the notes.
    """
    parts = []
    for block in table.blocks:
        parts.append(folded(block.title))
        parts += [aligned(x, names=name_count(block)) for x in block_cells(table, block)]
    return "\n\n".join([*parts, *map(folded, notes(table))])


def latex_table(table: Table) -> str:
    """Writes a table for LaTeX, with the package ``booktabs``.

    Args:
        table: The table.

    Returns:
        A ``tabular`` for each of a block's tables, the notes as comments.
    """
    parts = []
    for block in table.blocks:
        texts = name_count(block)
        for headings, rows in block_cells(table, block):
            columns = "l" * texts + "r" * (len(headings) - texts)
            lines = [" & ".join(map(_latex, cells)) + r" \\" for cells in (headings, *rows)]
            parts.append(
                "\n".join(
                    [
                        f"% {block.title}",
                        rf"\begin{{tabular}}{{{columns}}}",
                        r"\toprule",
                        lines[0],
                        r"\midrule",
                        *lines[1:],
                        r"\bottomrule",
                        r"\end{tabular}",
                    ]
                )
            )
    return "\n\n".join([*parts, *(f"% {note}" for note in notes(table))]) + "\n"


def csv_table(table: Table) -> str:
    """Writes a table as CSV, one line for each row; shares are between 0 and 1.

    Args:
        table: The table.

    Returns:
        A line of headings and the rows of all blocks. Of each metric there are the figure, the ends
        of its interval, and, against the baseline, difference, ends and both p.
    """
    told = ("planner", "predictor", "traffic", "loop", "futures", "seed", "ranked", "n", "places")
    axes = list(dict.fromkeys(a for block in table.blocks for r in block.rows for a in r.values))
    # An axis may be called as one of the others, as planner.
    headings = ["scenarios", "run", "arm", *(f"values.{axis}" for axis in axes), *told, "baseline"]
    for name in table.columns:
        headings += [name, f"{name}_low", f"{name}_high"]
        headings += [f"{name}_{part}" for part in _DIFFERENCE]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(headings)
    for block in table.blocks:
        for row in block.rows:
            cells: list[Any] = [block.title, row.run, row.arm.value]
            cells += [row.values.get(axis) for axis in axes]
            cells += [getattr(row, name) for name in told]
            cells.append(block.baseline)
            for name in table.columns:
                figure, found = row.figures[name], row.differences.get(name)
                cells += [figure.value, figure.low, figure.high]
                cells += [getattr(found, part, None) for part in _DIFFERENCE.values()]
            writer.writerow(cells)
    return file.getvalue()


_DIFFERENCE: Final = {
    "difference": "difference",
    "difference_low": "low",
    "difference_high": "high",
    "only_here": "only_b",
    "only_baseline": "only_a",
    "p": "p",
    "p_places": "p_places",
}

FORMATS: Final[Mapping[str, Callable[[Table], str]]] = MappingProxyType(
    {"markdown": markdown_table, "csv": csv_table, "latex": latex_table}
)
"""How to write a table, by name."""


def name_count(block: Block) -> int:
    """How many columns of a block's tables name its rows.

    Args:
        block: A block of a table.

    Returns:
        The number.
    """
    return 1 + len(_named(block))


def block_cells(table: Table, block: Block) -> list[Cells]:
    """Lays a block out in tables.

    Args:
        table: The table.
        block: One of its blocks.

    Returns:
        The figures of each row; and, where there is a baseline, the differences from it.
    """
    named, shown = _named(block), table.metrics
    figures = (
        ["Run", *named, "n", *(metric.heading for metric in shown)],
        [
            [
                _run(row),
                *(name(row) for name in named.values()),
                str(row.n),
                *(figure_text(m, row.figures[m.name]) for m in shown),
            ]
            for row in block.rows
        ],
    )
    compared = [row for row in block.rows if row.differences]
    if not compared:
        return [figures]
    differences = (
        [f"Minus {block.baseline}", *named, *(metric.heading for metric in shown)],
        [
            [
                _run(row),
                *(name(row) for name in named.values()),
                *(difference_text(m, row.differences.get(m.name)) for m in shown),
            ]
            for row in compared
        ],
    )
    return [figures, differences]


def _run(row: Row) -> str:
    return row.run if row.ranked else f"{row.run} *"


def _world(row: Row) -> str:
    several = f", {row.futures} futures" if row.futures > 1 else ""
    return f"{row.traffic}, {row.loop}{several}"


def _named(block: Block) -> dict[str, Callable[[Row], str]]:
    """What names a row beside its run, by heading: the arm, and wherein the rows differ."""
    differing: dict[str, Callable[[Row], str]] = {
        "World": _world,
        "Seed": lambda row: str(row.seed),
    }
    if not all(row.values for row in block.rows):  # The names of a sweep's runs say it.
        differing |= {"Planner": lambda row: row.planner, "Predictor": lambda row: row.predictor}
    return {"Arm": lambda row: ARM_TITLES[row.arm]} | {
        heading: name
        for heading, name in differing.items()
        if len({name(row) for row in block.rows}) > 1
    }


def cautions(table: Table) -> list[str]:
    """Says what is not as it looks: runs that are left out, and what speaks against comparing.

    Args:
        table: The table.

    Returns:
        The cautions, each a line.
    """
    lines = [warning for block in table.blocks for warning in block.warnings]
    if table.missing:
        more = f" and {len(table.missing) - 3} more" if len(table.missing) > 3 else ""
        lines.append(f"Not finished, so not here: {', '.join(table.missing[:3])}{more}.")
    return lines


def notes(table: Table) -> list[str]:
    """Says how a table is to be read.

    Args:
        table: The table.

    Returns:
        The notes, each a line.
    """
    lines = [
        "95 % intervals in brackets; they take into account which episodes are of one scenario and "
        "which scenarios of one place."
    ]
    compared = sum(bool(row.differences) for block in table.blocks for row in block.rows)
    if compared:
        lines.append(
            "Differences are over the same episodes; p of a share is that of the exact sign-flip "
            "test by scenarios, of a mean that of the t test by places."
        )
    if compared > 1:
        lines.append(f"{compared} rows are compared: one small p among many proves little.")
    if any(not row.ranked for block in table.blocks for row in block.rows):
        lines.append(
            "*: not ranked, as the predictor may see the future or the run cannot be repeated."
        )
    lines += cautions(table)
    if alone := [block.title for block in table.blocks if block.baseline is None]:
        lines.append(f"Without the baseline: {'; '.join(alone)}.")
    return lines


def figure_text(metric: Metric, figure: Figure) -> str:
    """Writes a figure with its interval.

    Args:
        metric: Its metric.
        figure: The figure.

    Returns:
        The figure, and in brackets the ends of the interval.
    """
    if figure.low is None:
        return metric.shown(figure.value)
    return f"{metric.shown(figure.value)} [{metric.shown(figure.low)}, {metric.shown(figure.high)}]"


def difference_text(metric: Metric, found: Difference | None) -> str:
    """Writes a paired difference with its interval and its p.

    Args:
        metric: Its metric.
        found: The difference; None where there is none.

    Returns:
        The difference, in brackets the ends of the interval, and p; ``-`` for none.
    """
    if found is None:
        return "-"
    text = metric.shown(found.difference, "+")
    if found.low is not None:
        text += f" [{metric.shown(found.low, '+')}, {metric.shown(found.high, '+')}]"
    return text if found.p is None else f"{text} p {found.p:.2g}"


_SIGNS: Final = {
    "\\": r"\textbackslash{}", "_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "$": r"\$",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "²": "$^2$", "³": "$^3$",
}  # fmt: skip


def _latex(text: str) -> str:
    return "".join(_SIGNS.get(sign, sign) for sign in text)
