"""Paired comparison of two runs, or of the two arms of one, scenario by scenario.

Both sides drove the same scenarios and met the same futures of them, so what is compared is the
difference within each pair of episodes of one scenario and future, of every metric of
``dosplan.scoring.metrics``. Intervals and tests are those of ``dosplan.results.paired``: they take
into account that several futures are of one scenario, and several scenarios of one place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dosplan.results.paired import Difference, mean_difference, share_difference
from dosplan.results.power import smallest_difference
from dosplan.results.rows import read_run
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Metric
from dosplan.simulation.settings import REAL_TIME
from dosplan.system.errors import DosplanError
from dosplan.system.typed import plain
from dosplan.types import Arm, Outcome, Score, place_of


class CompareError(DosplanError, ValueError):
    """Two runs that cannot be compared; the message is one line."""


@dataclass(frozen=True)
class Change:
    """A scenario whose outcome differs, in one of its futures.

    Attributes:
        scenario: Its id.
        a: Outcome on side A.
        b: Outcome on side B.
        future: Which continuation of the scenario's past.
    """

    scenario: str
    a: Outcome
    b: Outcome
    future: int = 0


@dataclass(frozen=True)
class Comparison:
    """Side B against side A.

    Attributes:
        a: Name of side A.
        b: Name of side B.
        n: Number of pairs of episodes that are compared: scenarios times futures.
        futures: Number of futures of each scenario.
        scenarios: Number of scenarios that the pairs are of; 0 in an older file.
        detectable: Smallest difference of the share of collisions that so many pairs would show
            with a probability of 80 % (``dosplan.results.power``); None where none is.
        places: Number of places the scenarios are of.
        unusable: Number of pairs that are left out, since they are unusable, or the traffic failed,
            on a side.
        differences: The difference of each metric by its name, over the pairs in which both
            sides have a value; a metric is left out where there is none, as of what is largest
            over a run and of cycle times.
        changes: Scenarios and futures whose outcome differs, in the run's order.
    """

    a: str
    b: str
    n: int
    futures: int = field(kw_only=True, default=1)
    scenarios: int = field(kw_only=True, default=0)
    detectable: float | None = field(kw_only=True, default=None)
    places: int
    unusable: int = field(kw_only=True, default=0)
    differences: Mapping[str, Difference]
    changes: tuple[Change, ...]

    def content(self) -> dict[str, Any]:
        """What JSON holds of it: a key for each metric, None where there is no difference."""
        own = {name: value for name, value in vars(self).items() if name != "differences"}
        found: dict[str, Any] = plain(
            own | {m.name: self.differences.get(m.name) for m in metrics.METRICS}
        )
        return found

    @staticmethod
    def content_kind() -> type[Any]:
        """A dataclass of the keys of ``content``; a metric may be absent in an older file."""
        return make_dataclass(
            "ComparisonContent",
            [
                ("a", str),
                ("b", str),
                ("n", int),
                ("places", int),
                ("changes", tuple[Change, ...]),
                ("unusable", int, field(default=0)),
                ("futures", int, field(default=1)),
                ("scenarios", int, field(default=0)),
                ("detectable", float | None, field(default=None)),
                *((m.name, Difference | None, field(default=None)) for m in metrics.METRICS),
            ],
        )

    @classmethod
    def of_content(cls, content: Any) -> Comparison:
        """The comparison that an object of ``content_kind`` holds."""
        found = {m.name: getattr(content, m.name) for m in metrics.METRICS}
        return cls(
            a=content.a,
            b=content.b,
            n=content.n,
            places=content.places,
            unusable=content.unusable,
            futures=content.futures,
            scenarios=content.scenarios,
            detectable=content.detectable,
            differences={name: one for name, one in found.items() if one is not None},
            changes=content.changes,
        )


def compare_rows(
    a: Sequence[Score], b: Sequence[Score], name_a: str = "A", name_b: str = "B"
) -> Comparison:
    """Compares the rows of two arms over the same scenarios, where both are of the planner.

    Args:
        a: Rows of side A, one for each scenario and future.
        b: Rows of side B.
        name_a: Name of side A.
        name_b: Name of side B.

    Returns:
        The comparison, ``b - a``.

    Raises:
        CompareError: The sides did not drive the same scenarios and futures, or none.
    """
    others = {row.scenario_future: row for row in b}
    here = {row.scenario_future for row in a}
    for only, lacks, odd in (
        (name_b, name_a, others.keys() - here),
        (name_a, name_b, here - others.keys()),
    ):
        if odd:
            are, them = (f" and {len(odd) - 1} more are", "them") if len(odd) > 1 else (" is", "it")
            raise CompareError(
                f"{name_a} and {name_b} did not drive the same scenarios and futures: "
                f"{min(odd).title}{are} in {only} alone; drive {them} "
                f"in {lacks} too: the same command without --limit, or with more --futures"
            )
    if not a:
        raise CompareError(f"{name_a} and {name_b} hold no scenario")
    every = [(row, others[row.scenario_future]) for row in a]
    pairs = [pair for pair in every if all(row.outcome.of_planner for row in pair)]
    # What is largest over all episodes is no mean, whose difference pairs would tell.
    means = (metric for metric in metrics.METRICS if metric.aggregate.is_mean)
    found = {metric.name: _compare(metric, pairs) for metric in means}
    return Comparison(
        a=name_a,
        b=name_b,
        n=len(pairs),
        futures=len({row.future for row in a}),
        scenarios=len({row.scenario for row, _ in pairs}),
        detectable=_detectable(pairs),
        places=len({place_of(row.scenario) for row, _ in pairs}),
        unusable=len(every) - len(pairs),
        differences={name: one for name, one in found.items() if one is not None},
        changes=tuple(
            Change(x.scenario, x.outcome, y.outcome, x.future)
            for x, y in pairs
            if x.outcome is not y.outcome
        ),
    )


def compare_runs(specs: Sequence[str]) -> list[Comparison]:
    """Compares two runs, or the two arms of one.

    Args:
        specs: One or two run folders, each optionally with ``:with_dos`` or ``:without_dos``.

    Returns:
        For one folder: its arm with sets against its arm without. For two: the second against
        the first, once for each arm that both hold, or once for the arms that are named.

    Raises:
        CompareError: The sides do not match.
        FileError: A folder is not that of a finished run.
    """
    pairs = paired_sides(specs)
    return [compare_rows(a.rows, b.rows, a.name, b.name) for a, b in pairs]


def world_lines(specs: Sequence[str]) -> list[str]:
    """Says what compared runs do not have in common of their worlds.

    Args:
        specs: As for ``compare_runs``.

    Returns:
        A line for the traffic and for the loop where the runs differ in it, and one where a run
        cannot be repeated; none for the arms of one run, unless it is such a run.

    Raises:
        CompareError: The sides do not match.
        FileError: A folder is not that of a finished run.
    """
    lines = []
    for a, b in paired_sides(specs):
        for column in ("traffic", "loop"):
            one, other = (sorted({getattr(x, column) for x in side.rows}) for side in (a, b))
            if one != other:
                both = f"{'; '.join(one)} in {a.path}, {'; '.join(other)} in {b.path}"
                lines.append(f"the {column} differs: {both}")
        for side in (a, b):
            if any(REAL_TIME in row.loop for row in side.rows):
                lines.append(
                    f"{side.path} cannot be repeated, as the time that its plans took is charged "
                    "as latency: no ranked comparison"
                )
    return list(dict.fromkeys(lines))


@dataclass(frozen=True)
class Side:
    """One arm of a run.

    Attributes:
        path: The run folder.
        arm: The arm.
        rows: Its rows.
    """

    path: Path
    arm: Arm
    rows: tuple[Score, ...]

    @property
    def name(self) -> str:
        """Its name: ``RUN:arm``."""
        return f"{self.path}:{self.arm.value}"


def paired_sides(specs: Sequence[str]) -> list[tuple[Side, Side]]:
    """Finds what ``compare_runs`` compares.

    Args:
        specs: As for ``compare_runs``.

    Returns:
        Sides A and B of each comparison.

    Raises:
        CompareError: The sides do not match.
        FileError: A folder is not that of a finished run.
    """
    sides = [_read_sides(spec) for spec in specs]
    if len(sides) == 1:
        (arms,) = sides
        if len(arms) < len(Arm):
            raise CompareError(f"{specs[0]} holds one arm: name a second run to compare it with")
        return [(arms[Arm.WITHOUT_DOS], arms[Arm.WITH_DOS])]
    first, second = sides
    if len(first) == len(second) == 1:
        return list(zip(first.values(), second.values(), strict=True))
    return [(first[arm], second[arm]) for arm in Arm if arm in first and arm in second]


def named_arm(spec: str) -> tuple[Path, Arm | None]:
    """Takes ``RUN`` or ``RUN:arm`` apart.

    Args:
        spec: A run folder, with an arm or without.

    Returns:
        The folder, and the arm that is asked for.
    """
    folder, _, wanted = spec.rpartition(":")
    for arm in Arm:
        if folder and arm.value == wanted:
            return Path(folder), arm
    return Path(spec), None


def _read_sides(spec: str) -> dict[Arm, Side]:
    """Reads ``RUN`` or ``RUN:arm``: each arm that is asked for."""
    path, named = named_arm(spec)
    _, rows = read_run(path)
    arms = {
        arm: Side(path, arm, tuple(row for row in rows if row.arm is arm))
        for arm in ([named] if named else Arm)
    }
    held = {arm: side for arm, side in arms.items() if side.rows}
    if not held:
        raise CompareError(f"{path} holds no episode of the arm {named}")
    return held


def _detectable(pairs: Sequence[tuple[Score, Score]]) -> float | None:
    """The smallest difference of collisions that pairs would show; None where there is none."""
    collides = [[row.outcome is Outcome.COLLISION for row in pair] for pair in pairs]
    a, b = np.array(collides, dtype=np.float64).reshape(-1, 2).T
    return smallest_difference(b - a, [row.scenario for row, _ in pairs])


def _compare(metric: Metric, pairs: Sequence[tuple[Score, Score]]) -> Difference | None:
    """Compares a metric over those pairs in which both rows have a value; None without any."""
    found = [
        (left, right, x.scenario)
        for x, y in pairs
        if (left := metric.value(x)) is not None and (right := metric.value(y)) is not None
    ]
    if not found:
        return None
    a, b = (np.array([pair[side] for pair in found], dtype=np.float64) for side in (0, 1))
    compare = share_difference if metric.is_share else mean_difference
    return compare(a, b, [scenario for *_, scenario in found])
