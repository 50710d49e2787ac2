"""Tables of figures as text: what the terminal and Markdown show of a summary."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import TextWrapper
from typing import Final

from dosplan.results.comparison import Comparison
from dosplan.results.manifest import named_options
from dosplan.results.paired import Difference
from dosplan.results.summary import Summary
from dosplan.results.unusable import unusable_title
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Group, Metric, find_metric
from dosplan.types import Arm, ScenarioFuture

ARM_TITLES: Final = {Arm.WITH_DOS: "with DOS", Arm.WITHOUT_DOS: "without DOS"}
ARMS_SIDE_BY_SIDE: Final = (Arm.WITHOUT_DOS, Arm.WITH_DOS)
"""The arms from left to right, as they are compared: with minus without."""

Cells = tuple[list[str], list[list[str]]]
"""Headings, and rows of cells."""

LINE: Final = 99
"""Characters of a line on a terminal, at most."""


def folded(text: str, width: int = LINE, indent: str = "") -> str:
    """Breaks lines that are too long, between words: a path stays whole.

    Args:
        text: The text.
        width: Characters of a line, at most.
        indent: What a line begins with that continues another, after the spaces that the other
            begins with.

    Returns:
        The text with more lines.
    """

    def fold(line: str) -> str:
        own = line[: len(line) - len(line.lstrip())]
        return TextWrapper(
            width,
            subsequent_indent=own + indent,
            break_long_words=False,
            break_on_hyphens=False,
        ).fill(line)

    return "\n".join(map(fold, text.split("\n")))


def parted(sections: Sequence[Cells], width: int, gap: int, names: int = 1) -> list[list[Cells]]:
    """Parts a table that has no room in a line; each part has the columns that name the rows.

    Args:
        sections: The table, in sections of the same columns.
        width: Characters of a line, at most.
        gap: How many of them a column takes beside its cells.
        names: How many columns name the rows.

    Returns:
        Tables with some of the columns each; the table itself where the names alone leave no room
        for one.
    """
    lines = (line for headings, rows in sections for line in (headings, *rows))
    widths = [max(map(len, column)) + gap for column in zip(*lines, strict=True)]
    room = width - sum(widths[:names])
    if max(widths[names:], default=0) > room:
        return [list(sections)]
    parts: list[list[int]] = [[]]
    left = room
    for column in range(names, len(widths)):
        if widths[column] > left:
            parts.append([])
            left = room
        parts[-1].append(column)
        left -= widths[column]
    columns = [[*range(names), *part] for part in parts]
    return [
        [
            ([headings[c] for c in own], [[row[c] for c in own] for row in rows])
            for headings, rows in sections
        ]
        for own in columns
    ]


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]], numbers: bool = True) -> str:
    """Writes a table as Markdown, its first column to the left.

    Args:
        headings: Column headings.
        rows: Cells.
        numbers: Whether the other columns hold numbers and go to the right.

    Returns:
        The table's lines.
    """
    rule = ["---", *["---:" if numbers else "---"] * (len(headings) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (headings, rule, *rows))


def aligned(cells: Cells, numbers: bool = True, names: int = 1) -> str:
    """Writes a table as text in columns, its first column to the left.

    Args:
        cells: The table.
        numbers: Whether the other columns hold numbers and go to the right.
        names: How many columns name the rows; they come again where the table is ``parted``.

    Returns:
        The table's lines.
    """
    gap = 2
    parts = parted([cells], LINE + gap, gap, names)
    return "\n\n".join(_aligned(*part, numbers) for (part,) in parts)


def _aligned(headings: Sequence[str], rows: Sequence[Sequence[str]], numbers: bool) -> str:
    lines = (headings, *rows)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    told = [
        "  ".join(
            cell.rjust(width) if numbers and column else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(cells, widths, strict=True))
        ).rstrip()
        for cells in lines
    ]
    return "\n".join([told[0], "-" * (sum(widths) + 2 * (len(widths) - 1)), *told[1:]])


def summary_markdown(summary: Summary) -> str:
    """Writes a summary as Markdown.

    Args:
        summary: The summary of a run.

    Returns:
        The text of ``summary.md``.
    """
    blocks = [f"# {summary_title(summary)}"]
    blocks += [markdown(*cells) for cells in summary_cells(summary)]
    blocks += summary_notes(summary)
    if summary.unusable:
        blocks.append(f"{unusable_title(summary.unusable, scenario_count(summary))}:")
        blocks.append("\n".join(f"- `{x.file}`: {escaped(x.reason)}" for x in summary.unusable))
    return "\n\n".join(blocks) + "\n"


def summary_cells(summary: Summary) -> list[Cells]:
    """Lays the figures of a summary out in tables, one for each group of metrics.

    Args:
        summary: The summary of a run.

    Returns:
        The tables, which have the same columns: the arms that ran and, where both did, their
        difference. They have a row for each metric; that of the solver only where a figure is not
        zero, as planners without a solver have none, and of the rules and costs those that have a
        figure. The first counts the episodes, and those of them that are usable where some are not.
    """
    arms = {arm: summary.arms[arm] for arm in ARMS_SIDE_BY_SIDE if arm in summary.arms}
    paired = summary.comparison
    columns = [*(ARM_TITLES[arm] for arm in arms), *([] if paired is None else _DIFFERENCE)]
    tables: list[Cells] = []
    for group in Group:
        rows = []
        found = [metric for metric in metrics.METRICS if metric.group is group]
        for metric in found:
            figures = [arm.get(metric.key) for arm in arms.values()]
            if group in _WHERE_KNOWN and all(figure is None for figure in figures):
                continue
            rows.append([metric.heading, *map(metric.shown, figures)])
            if paired is not None:
                rows[-1] += _difference_cells(metric, paired)
        if group is Group.SOLVER and not any(
            arm.get(metric.key) for metric in found for arm in arms.values()
        ):
            continue
        if group is Group.MAIN:
            counts = ["n"]
            if any(arm["usable"] != arm["n"] for arm in arms.values()):
                counts.append("usable")
            blank = [""] * (len(columns) - len(arms))
            rows += [[key, *(str(arm[key]) for arm in arms.values()), *blank] for key in counts]
        if rows:
            tables.append(([group.heading, *columns], rows))
    return tables


_DIFFERENCE: Final = ("difference", "95 % interval", "p")


def _difference_cells(metric: Metric, comparison: Comparison) -> list[str]:
    """The difference of a figure, its interval and p."""
    found = comparison.differences.get(metric.name)
    if found is None:
        return ["-"] * len(_DIFFERENCE)
    return [
        metric.shown(found.difference, "+"),
        interval_text(metric, found),
        _p_text(found.p),
    ]


_WHERE_KNOWN: Final = frozenset({Group.RULES, Group.NUPLAN, Group.COMMONROAD})
"""Tables that leave out what has no figure: not every map has lights, signs or markings."""


def scenario_count(summary: Summary) -> int:
    """Counts the scenarios of a run, usable or not."""
    episodes = max(int(figures["n"] or 0) for figures in summary.arms.values())
    return episodes // summary.run.futures


def summary_title(summary: Summary) -> str:
    """Describes the run in one line.

    Args:
        summary: The summary of a run.

    Returns:
        Planner, predictor, scenarios and settings.
    """
    run = summary.run
    mark = "" if run.ranked else f" (unranked: {unranked_reason(run.reproducible)})"
    options = (f"{name}={value}" for name, value in named_options(run).items())
    traffic = [] if run.traffic == "replay" else [f"traffic {run.traffic}"]
    if run.loop != "ideal":
        traffic.append(f"loop {run.loop}")
    if run.futures > 1:
        traffic.append(f"{run.futures} futures")
    settings = ", ".join([*traffic, f"seed {run.seed}", *options])
    return f"{run.planner} with {run.predictor} on {run.source}, {settings}{mark}"


def unranked_reason(reproducible: bool) -> str:
    """Says why a run may not be ranked.

    Args:
        reproducible: Whether it can be repeated.

    Returns:
        The reason in a few words.
    """
    if reproducible:
        return "the predictor may see the future"
    return "it depends on the time that plans took, so the run cannot be repeated"


def summary_notes(summary: Summary) -> list[str]:
    """Says how the differences of a summary are to be read.

    Args:
        summary: The summary of a run.

    Returns:
        Over what they are, and what so many pairs show; none where one arm ran or nothing is
        usable.
    """
    comparison = summary.comparison
    if comparison is None or not comparison.scenarios:
        return []
    return [
        "Difference: with DOS minus without, over the pairs in which both have a figure; "
        f"{size_text(comparison)}. {tests_text(comparison)}",
        power_line(comparison),
    ]


def power_line(comparison: Comparison) -> str:
    """Says what the pairs of a comparison would show of collisions.

    Args:
        comparison: The comparison.

    Returns:
        A line: how many pairs of how many scenarios, and the smallest difference.
    """
    smallest, collision = comparison.detectable, find_metric("collision")
    pairs = f"{comparison.n} pairs of {comparison.scenarios} scenarios"
    if smallest is None:
        return f"Power: {pairs} are too few to show any difference of collisions."
    halved = ""
    if 2.0 * smallest <= 1.0:
        halved = f", as {collision.shown(2.0 * smallest)} % halved"
    return (
        f"Power: with a probability of 80 %, {pairs} show a difference of collisions of "
        f"{collision.shown(smallest)} points or more{halved}."
    )


def test_name(comparison: Comparison) -> str:
    """Names the test of shares; the sign-flip test of single pairs has a name of its own."""
    return "McNemar" if comparison.futures == 1 else "sign-flip"


def tests_text(comparison: Comparison) -> str:
    """Names the tests behind the p of a comparison."""
    name = test_name(comparison)
    return f"p of a share: exact {name} test over scenarios; of a mean: t test over places."


def size_text(comparison: Comparison) -> str:
    """Says over what a comparison is: pairs, and of how many futures and places."""
    n, futures = comparison.n, comparison.futures
    parts = [f"n = {n}"]
    if futures > 1:
        parts.append(f"futures = {futures}")
    return ", ".join([*parts, f"places = {comparison.places}"])


def escaped(text: str) -> str:
    """Writes text of which Markdown takes nothing as a sign: the names of XML elements, say.

    Args:
        text: The text.

    Returns:
        It, with a backslash before each sign.
    """
    return "".join(f"\\{sign}" if sign in "\\`*_<>[]|" else sign for sign in text)


def interval_text(metric: Metric, figure: Difference) -> str:
    """Writes the interval of a difference.

    Args:
        metric: The metric.
        figure: Its difference.

    Returns:
        Both ends, or ``-`` where there is no interval.
    """
    if figure.low is None:
        return "-"
    return f"{metric.shown(figure.low, '+')} to {metric.shown(figure.high, '+')}"


def comparison_title(comparison: Comparison) -> str:
    """Says what is compared.

    Args:
        comparison: The comparison.

    Returns:
        Three lines: both sides, and over what they are compared.
    """
    title = f"A = {comparison.a}\nB = {comparison.b}\n{size_text(comparison)}"
    if comparison.unusable:
        title += f"; left out as unusable or failed by the traffic: {comparison.unusable}"
    return title


def comparison_cells(comparison: Comparison) -> list[Cells]:
    """Lays the differences of a comparison out.

    Args:
        comparison: The comparison.

    Returns:
        A table with a row for each metric that has a difference, and one with what else there is
        of shares.
    """
    found = [
        (metric, comparison.differences[metric.name])
        for metric in metrics.METRICS
        if metric.name in comparison.differences
    ]
    figures = [
        [
            metric.heading,
            str(one.n),
            metric.shown(one.a),
            metric.shown(one.b),
            metric.shown(one.difference, "+"),
            interval_text(metric, one),
            _p_text(one.p),
        ]
        for metric, one in found
    ]
    shares = [
        [metric.heading, str(one.only_a), str(one.only_b), _p_text(one.p), _p_text(one.p_places)]
        for metric, one in found
        if one.only_a is not None
    ]
    return [
        (["", "n", "A", "B", "B - A", "95 % interval", "p"], figures),
        (["", "A only", "B only", "p", "p, places"], shares),
    ]


def change_cells(comparison: Comparison) -> Cells:
    """Lists the scenarios whose outcome differs.

    Args:
        comparison: The comparison.

    Returns:
        A row for each, with both outcomes.
    """
    rows: list[list[str]] = [
        [ScenarioFuture(change.scenario, change.future).title, change.a, change.b]
        for change in comparison.changes
    ]
    return ["Scenario whose outcome differs", "A", "B"], rows


def comparison_note(comparison: Comparison) -> str:
    """Says how intervals and tests of a comparison are to be read, and what its pairs show."""
    note = (
        "Intervals take into account that several scenarios are of one place. "
        f"{tests_text(comparison)} Shares have the sign-flip test over places below."
    )
    return f"{note}\n{power_line(comparison)}"


def comparison_text(comparison: Comparison) -> str:
    """Writes a comparison as text in columns.

    Args:
        comparison: The comparison.

    Returns:
        What is compared, the differences, how to read them, and whose outcome differs.
    """
    changed = "No outcome differs."
    if comparison.changes:
        changed = aligned(change_cells(comparison), numbers=False)
    parts = (
        comparison_title(comparison),
        *map(aligned, comparison_cells(comparison)),
        folded(comparison_note(comparison)),
        changed,
    )
    return "\n\n".join(parts)


def _p_text(p: float | None) -> str:
    return "-" if p is None else f"{p:.3g}"
