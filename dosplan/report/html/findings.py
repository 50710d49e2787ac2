"""The tables of a page: headline with intervals, outcome by group, coverage beside collisions.

Intervals are those of ``dosplan.results.intervals``, differences those of
``dosplan.results.paired``. All are at 95 %.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np

from dosplan.report.html.cases import OUTCOME_WORDS, Case, change_of
from dosplan.report.html.coverage import Coverage, total
from dosplan.report.html.sides import Pairing, Side, View
from dosplan.results.intervals import metric_interval
from dosplan.results.markdown import ARM_TITLES, interval_text, test_name
from dosplan.results.paired import Difference
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Group, Metric, find_metric
from dosplan.types import STEP_SECONDS, FloatArray, Outcome, Score

_LOOK_AHEAD: Final = (1.0, 2.0, 3.0)  # s; where coverage is given.
_SIGNIFICANT: Final = 0.05


def headline(pairing: Pairing, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Lays the metrics out.

    Args:
        pairing: What is set beside what.
        cases: Its cases; percentiles of cycle times are of those that were read.

    Returns:
        Rows of ``title``, ``sides`` (a value and its interval each) and ``differences`` (for each
        view its cells, empty where there is none). Left out are a metric without a value on any
        side, and what of the solver is zero on all of them.
    """
    cycles = [pooled_cycle_ms(cases, side) for side in range(len(pairing.sides))]
    rows = []
    for metric in metrics.METRICS:
        held = [tuple(side.rows.values()) for side in pairing.sides]
        figures = [metric.summarise(*side) for side in zip(held, cycles, strict=True)]
        absent = (None, 0.0) if metric.group is Group.SOLVER else (None,)
        if any(figure not in absent for figure in figures):
            rows.append(
                {
                    "title": metric.long_heading,
                    "sides": [_cell(metric, *side) for side in zip(held, figures, strict=True)],
                    "differences": [_difference(metric, pairing, view) for view in pairing.views],
                }
            )
    return rows


def pooled_cycle_ms(cases: Iterable[Case], side: int) -> FloatArray:
    """Times of all planning cycles of a side.

    Args:
        cases: The cases.
        side: Index of the side.

    Returns:
        (C,) ms.
    """
    return np.concatenate([np.empty(0), *(case.cycle_ms[side] for case in cases)])


def answer(pairing: Pairing, view: View) -> str:
    """Says in a sentence whether the second side of a view is better than the first.

    Args:
        pairing: What is set beside what.
        view: Which of its sides.

    Returns:
        Text.
    """
    sides = [pairing.sides[index] for index in view]
    last = sides[-1]
    if not pairing.driven:
        return "Nothing was driven."
    if view not in pairing.comparisons:
        counted = _of_planner(last.rows.values())
        reached = sum(outcome is Outcome.SUCCESS for outcome in counted)
        return f"Success {_name(last.name)} in {reached} of {len(counted)} {pairing.unit}."
    success = pairing.comparisons[view].differences.get("success")
    if success is None:
        return "Nothing can be compared: the traffic failed."
    found = "No clear difference"
    if _beyond_chance(success):
        found = f"{'Better' if success.difference > 0.0 else 'Worse'} {_name(last.name)}"
    return (
        f"{found}: success in {round(success.b * success.n)} of {success.n} {pairing.unit} "
        f"{_name(last.name)}, in {round(success.a * success.n)} {_name(sides[0].name)}."
    )


def grounds(pairing: Pairing, view: View) -> list[str]:
    """Gives the grounds of the answer, and what failed.

    Args:
        pairing: What is set beside what.
        view: Which of its sides.

    Returns:
        Sentences.
    """
    if not pairing.driven:
        return ["No scenario is usable."]
    sentences = []
    comparison = pairing.comparisons.get(view)
    if comparison is not None and "success" in comparison.differences:
        metric, success = find_metric("success"), comparison.differences["success"]
        verdict = "more than chance brings about" if _beyond_chance(success) else "may be chance"
        sentences.append(
            f"The difference in success is {metric.shown(success.difference, '+')} points (95 % "
            f"interval {interval_text(metric, success)}; {test_name(comparison)} "
            f"p = {success.p:.2g}): {verdict}."
        )
    return sentences + [
        f"Failed {_name(side.name)}: {_failures(side)}."
        for side in (pairing.sides[index] for index in view[::-1])
    ]


def held(cases: Sequence[Case], names: Sequence[str]) -> list[str]:
    """Says how often the sets of each side held whom they were of.

    Args:
        cases: The cases.
        names: Names of the sides.

    Returns:
        A sentence for each side that met sets.
    """
    sentences = []
    for side, name in enumerate(names):
        shares = [
            f"{share} % {time:g} s ahead"
            for time, share in zip(_LOOK_AHEAD, held_cells(cases, side), strict=True)
            if share != "-"
        ]
        if shares:
            sentences.append(
                f"Of moving road users near the ego, the sets {_name(name)} held the true centre "
                f"of {', '.join(shares)}."
            )
    return sentences


def held_cells(cases: Iterable[Case], side: int) -> list[str]:
    """Share of the sets of moving road users that held the true centre.

    Args:
        cases: The cases.
        side: Index of the side.

    Returns:
        In %, at each of the times looked ahead; ``-`` where none was met.
    """
    coverage = coverage_of(cases, side)
    return [_covered(coverage, time) for time in _LOOK_AHEAD]


def _of_planner(rows: Iterable[Score]) -> list[Outcome]:
    """The outcomes that a planner is judged by."""
    return [row.outcome for row in rows if row.outcome.of_planner]


def _beyond_chance(figure: Difference) -> bool:
    return figure.p is not None and figure.p < _SIGNIFICANT


def _failures(side: Side) -> str:
    """How often each outcome other than success occurred, the worst ones first."""
    counts = Counter(row.outcome for row in side.rows.values())
    at_fault = sum(row.at_fault for row in side.rows.values())
    words = []
    for outcome, word in reversed(OUTCOME_WORDS.items()):
        if outcome is not Outcome.SUCCESS and counts[outcome]:
            blame = f" ({at_fault} at fault)" if outcome is Outcome.COLLISION else ""
            words.append(f"{word} {counts[outcome]}{blame}")
    return ", ".join(words) or "none"


def shortcuts(pairing: Pairing, cases: Sequence[Case], view: View) -> list[tuple[str, str]]:
    """Filters from the result to the scenarios behind it.

    Args:
        pairing: What is set beside what.
        cases: Its cases.
        view: Which of its sides.

    Returns:
        Filters of the list of scenarios that find something, and what to call them.
    """
    counts = Counter(change_of([case.rows[index] for index in view]) for case in cases)
    first, last = (_name(pairing.sides[index].name) for index in (view[0], view[-1]))
    texts = {
        "fixed": f"succeeded only {last}",
        "broken": f"succeeded only {first}",
        "both failed": "failed in both",
        "failed": "failed",
    }
    return [(key, f"{counts[key]} {text}") for key, text in texts.items() if counts[key]]


def _name(side: str) -> str:
    """A side's name inside a sentence: ``with DOS``, but ``on A``."""
    return side if side in ARM_TITLES.values() else f"on {side}"


def groups(cases: Sequence[Case], key: Callable[[Case], str], sides: int) -> list[dict[str, Any]]:
    """Breaks the outcomes down.

    Args:
        cases: The cases.
        key: Names a case's group.
        sides: Number of sides.

    Returns:
        For each group, the one that failed most often first and then the largest: ``name``, ``n``,
        and ``sides`` with counts of each outcome, and coverage at the times looked ahead.
    """
    members: dict[str, list[Case]] = {}
    for case in cases:
        members.setdefault(key(case), []).append(case)

    def failures(part: Sequence[Case]) -> int:
        return sum(row.outcome is not Outcome.SUCCESS for case in part for row in case.rows)

    ranked = sorted(members.items(), key=lambda item: (-failures(item[1]), -len(item[1])))
    return [_group(name, part, sides) for name, part in ranked]


def coverage_rows(cases: Sequence[Case], side: int) -> list[dict[str, Any]]:
    """Tabulates the coverage that a side met beside its collisions.

    Args:
        cases: The cases.
        side: Index of the side.

    Returns:
        Rows for all episodes, those with a collision and those without: ``title``, ``n``,
        ``collisions``, ``cells``; none where no set was met.
    """
    collided = [case for case in cases if case.rows[side].outcome is Outcome.COLLISION]
    others = [case for case in cases if case.rows[side].outcome is not Outcome.COLLISION]
    parts = (("all episodes", cases), ("with a collision", collided), ("without one", others))
    rows = [
        {
            "title": title,
            "n": len(part),
            "collisions": sum(c.rows[side].outcome is Outcome.COLLISION for c in part),
            "cells": held_cells(part, side),
        }
        for title, part in parts
    ]
    return rows if coverage_of(cases, side) else []


def coverage_of(cases: Iterable[Case], side: int) -> list[Coverage]:
    """Coverage of the sets that a side met.

    Args:
        cases: The cases.
        side: Index of the side.

    Returns:
        One entry for each horizon.
    """
    return total(met for case in cases if (met := case.met[side]) is not None)


def _group(name: str, cases: Sequence[Case], sides: int) -> dict[str, Any]:
    counts = [Counter(case.rows[side].outcome for case in cases) for side in range(sides)]
    judged = [len(_of_planner(case.rows[side] for case in cases)) for side in range(sides)]
    return {
        "name": name,
        "n": len(cases),
        "sides": [
            {
                "counts": [
                    {"word": word, "outcome": outcome.value, "n": count[outcome]}
                    for outcome, word in OUTCOME_WORDS.items()
                    if count[outcome]
                ],
                "success": _percent(count[Outcome.SUCCESS], judged[side]),
                "collision": _percent(count[Outcome.COLLISION], judged[side]),
                "cells": held_cells(cases, side),
            }
            for side, count in enumerate(counts)
        ],
    }


def _percent(count: int, total: int) -> str:
    return f"{100.0 * count / total:.0f}" if total else "-"


def _covered(coverage: Iterable[Coverage], seconds: float) -> str:
    """Share of the sets of moving road users so far ahead that held the true centre."""
    offset = round(seconds / STEP_SECONDS)
    found = next((one for one in coverage if one.offset == offset), None)
    if found is None or not found.counted:
        return "-"
    return f"{100.0 * found.inside / found.counted:.1f}"


def _cell(metric: Metric, rows: Sequence[Score], figure: float | None) -> dict[str, str]:
    """A metric on one side: its figure, and the 95 % interval of a share or a mean."""
    interval = metric_interval(metric, rows)
    return {
        "value": metric.shown(figure),
        "interval": ""
        if interval is None or math.isnan(interval.low)
        else f"{metric.shown(interval.low)} to {metric.shown(interval.high)}",
    }


def _difference(metric: Metric, pairing: Pairing, view: View) -> list[str]:
    """Cells of what the sides differ by; none for one side, or where nothing is compared."""
    comparison = pairing.comparisons.get(view)
    if comparison is None or metric.name not in comparison.differences:
        return []
    figure = comparison.differences[metric.name]
    return [
        metric.shown(figure.difference, "+"),
        interval_text(metric, figure),
        "" if figure.only_a is None else str(figure.only_a),
        "" if figure.only_b is None else str(figure.only_b),
        "" if figure.p is None else f"{figure.p:.2g}",
    ]
