"""Paired comparison of two runs, or of the two arms of one, scenario by scenario.

Both sides drove the same scenarios, so what is compared is the difference within each scenario:
its mean with a percentile-bootstrap interval over scenarios and, for what either happens or not,
the exact McNemar test (McNemar, 1947: among the scenarios whose verdict differs, both directions
are equally likely).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from dosplan.results.intervals import mean_interval
from dosplan.results.rows import read_run
from dosplan.system.errors import DosplanError
from dosplan.types import Arm, FloatArray, Outcome, Score

_VERDICTS: Final[dict[str, Callable[[Score], bool]]] = {
    "success": lambda row: row.outcome is Outcome.SUCCESS,
    "safe": lambda row: row.safe,
    "collision": lambda row: row.outcome is Outcome.COLLISION,
    "at_fault_collision": lambda row: row.at_fault,
}


class CompareError(DosplanError, ValueError):
    """Two runs that cannot be compared; the message is one line."""


@dataclass(frozen=True)
class Difference:
    """A figure on both sides, and its mean paired difference.

    Attributes:
        n: Number of scenarios it is over.
        a: Mean over the scenarios of side A.
        b: Mean over the same scenarios of side B.
        difference: ``b - a``.
        low: Lower end of the 95 % interval of the difference.
        high: Upper end.
        only_a: Scenarios in which it is so on side A alone; None for velocity.
        only_b: The same for side B.
        p: Two-sided p of the exact McNemar test; None for velocity.
    """

    n: int
    a: float
    b: float
    difference: float
    low: float
    high: float
    only_a: int | None = None
    only_b: int | None = None
    p: float | None = None


@dataclass(frozen=True)
class Change:
    """A scenario whose outcome differs.

    Attributes:
        scenario: Its id.
        a: Outcome on side A.
        b: Outcome on side B.
    """

    scenario: str
    a: Outcome
    b: Outcome


@dataclass(frozen=True)
class Comparison:
    """Side B against side A.

    Attributes:
        a: Name of side A.
        b: Name of side B.
        n: Number of scenarios.
        success: Share of ``success``.
        safe: Share without collision and within bounds.
        collision: Share of ``collision``.
        at_fault_collision: Share with a collision that the ego is to blame for.
        velocity: Mean velocity, m/s, over the scenarios in which both sides drove a step; None
            where there is none.
        changes: Scenarios whose outcome differs, in the run's order.
    """

    a: str
    b: str
    n: int
    success: Difference
    safe: Difference
    collision: Difference
    at_fault_collision: Difference
    velocity: Difference | None
    changes: tuple[Change, ...]


def compare_rows(
    a: Sequence[Score], b: Sequence[Score], name_a: str = "A", name_b: str = "B"
) -> Comparison:
    """Compares the rows of two arms over the same scenarios.

    Args:
        a: Rows of side A, one for each scenario.
        b: Rows of side B.
        name_a: What side A is called.
        name_b: What side B is called.

    Returns:
        The comparison, ``b - a``.

    Raises:
        CompareError: The sides did not drive the same scenarios, or none.
    """
    by_scenario = {row.scenario: row for row in b}
    if {row.scenario for row in a} != by_scenario.keys():
        odd = min({row.scenario for row in a} ^ by_scenario.keys())
        raise CompareError(
            f"{name_a} and {name_b} did not drive the same scenarios: {odd} is in one alone"
        )
    if not a:
        raise CompareError(f"{name_a} and {name_b} hold no scenario")
    pairs = [(row, by_scenario[row.scenario]) for row in a]
    verdicts = {
        name: _compare_verdicts(
            np.array([verdict(left) for left, _ in pairs], dtype=np.float64),
            np.array([verdict(right) for _, right in pairs], dtype=np.float64),
        )
        for name, verdict in _VERDICTS.items()
    }
    driven = [(x.velocity, y.velocity) for x, y in pairs if x.steps > 0 and y.steps > 0]
    return Comparison(
        a=name_a,
        b=name_b,
        n=len(pairs),
        velocity=_compare_means(*np.array(driven).T) if driven else None,
        changes=tuple(
            Change(x.scenario, x.outcome, y.outcome) for x, y in pairs if x.outcome is not y.outcome
        ),
        **verdicts,
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
        """What it is called: ``RUN:arm``."""
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


def _read_sides(spec: str) -> dict[Arm, Side]:
    """Reads ``RUN`` or ``RUN:arm``: each arm that is asked for."""
    folder, _, wanted = spec.rpartition(":")
    named = [arm for arm in Arm if folder and arm.value == wanted]
    path = Path(folder if named else spec)
    _, rows = read_run(path)
    arms = {
        arm: Side(path, arm, tuple(row for row in rows if row.arm is arm)) for arm in named or Arm
    }
    held = {arm: side for arm, side in arms.items() if side.rows}
    if not held:
        raise CompareError(f"{path} holds no episode of the arm {wanted}")
    return held


def _compare_verdicts(a: FloatArray, b: FloatArray) -> Difference:
    from scipy.stats import binomtest  # A slow import that the rest of a run does without.

    only_a, only_b = int(np.sum(a > b)), int(np.sum(b > a))
    discordant = only_a + only_b
    p = float(binomtest(only_b, discordant).pvalue) if discordant else 1.0
    return replace(_compare_means(a, b), only_a=only_a, only_b=only_b, p=p)


def _compare_means(a: FloatArray, b: FloatArray) -> Difference:
    difference, low, high = mean_interval(b - a)
    return Difference(
        n=len(a),
        a=float(a.mean()),
        b=float(b.mean()),
        difference=difference,
        low=low,
        high=high,
    )
