"""The verdict on a scenario with several futures: solvable, and decided by what is not told.

No planner or predictor that is trained or that optimises has a say: what decides is a search with
the true future, dosplan's own scorer, and three planners in a few lines, ``brake``, ``cruise`` and
``idm``, who take everybody to keep their velocity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from dosplan_baseline.brake import BrakePlanner
from dosplan_baseline.cruise import CruisePlanner
from dosplan_baseline.idm import IdmPlanner
from dosplan_simple.predictors import ConstantVelocityPredictor, NonePredictor

from dosplan.api import Planner, Predictor
from dosplan.scoring.fault import STRUCK
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import IDEAL, LoopSettings
from dosplan.types import Arm, FloatArray, Outcome, Scenario, Score
from suitegen.futures.search import find_drive, scored

FIRST_CONTACT = 12
"""Steps at least between the start and a collision of ``idm``: time to react."""
LATE: Final = replace(IDEAL, latency=0.3)
"""The loop in which ``idm`` is driven where it is defeated in no future in the ideal one: what is
seen acts 0.3 s later, and is exact."""
DECISIVE: Final = ("idm", "idm late")
"""Whose defeat decides, see ``baseline_rows``; ``cruise`` looks at nobody and is told beside."""
AT_ONCE = "idm collides at once"
UNDEFEATED = "no future defeats idm"
HARMFUL = "no future is harmless"
BRAKING = "braking at once succeeds in every future"
UNSOLVED = "no drive is found that solves a future"


@dataclass(frozen=True)
class Rejected:
    """A scenario that is not taken.

    Attributes:
        reason: Why, one of the phrases above.
    """

    reason: str


@dataclass(frozen=True)
class Accepted:
    """A scenario that is taken.

    Attributes:
        defeats: See ``defeat_words``.
        drives: K drives that solve the futures, see ``find_drive``.
    """

    defeats: str
    drives: tuple[FloatArray, ...]


class ShortIdmPlanner(IdmPlanner):
    """``idm``, whose plans end after what the loops here drive of them: the same drives, sooner."""

    plan_steps = 6


def in_future(scenario: Scenario, future: int) -> Scenario:
    """The scenario with one of its futures as the only recording.

    Args:
        scenario: The scenario.
        future: Number of the future.

    Returns:
        The same past, start and goal.
    """
    return replace(scenario, tracks=scenario.recorded(future), futures=())


def baseline_rows(scenario: Scenario) -> dict[str, list[Score]]:
    """Drives ``idm`` through every future, and ``cruise`` where that is defeated.

    Args:
        scenario: The scenario with its K futures.

    Returns:
        K rows each: ``idm`` in the ideal loop; ``idm late`` in a loop that is ``LATE``, only where
        it is defeated in no future before; ``cruise``, only where either is defeated in one.
    """
    futures = [in_future(scenario, k) for k in range(1 + len(scenario.futures))]
    predictor = ConstantVelocityPredictor()
    rows = {"idm": [_driven(future, ShortIdmPlanner(), predictor) for future in futures]}
    if not any(map(defeats, rows["idm"])):
        rows["idm late"] = [
            _driven(future, ShortIdmPlanner(), predictor, LATE) for future in futures
        ]
    if any(map(defeats, [*rows["idm"], *rows.get("idm late", ())])):
        rows["cruise"] = [_driven(future, CruisePlanner(), predictor) for future in futures]
    return rows


def _driven(
    scenario: Scenario, planner: Planner, predictor: Predictor, loop: LoopSettings = IDEAL
) -> Score:
    return score(scenario, run_episode(scenario, planner, predictor, Arm.WITHOUT_DOS, loop))


def defeats(row: Score) -> bool:
    """Whether a drive is a defeat: a collision in which the ego is not struck from behind.

    Args:
        row: Its row.

    Returns:
        Whether it is. A recording does not see the ego, so being struck by it tells nothing.
    """
    return row.outcome is Outcome.COLLISION and row.collision_class not in STRUCK


def defeat_words(scenario: Scenario, rows: Mapping[str, Sequence[Score]]) -> str:
    """Says which baseline is defeated in which futures, and the first of these collisions.

    Args:
        scenario: The scenario.
        rows: See ``baseline_rows``.

    Returns:
        Such as ``idm late:2 cruise:2,4 (car after 3.1 s, active_front)``, which is the collision of
        ``idm``; empty where there is none.
    """
    found = {name: [k for k, row in enumerate(each) if defeats(row)] for name, each in rows.items()}
    parts = [f"{name}:{','.join(map(str, numbers))}" for name, numbers in found.items() if numbers]
    hits = [(rows[name][k].steps, k, name) for name in DECISIVE for k in found.get(name, ())]
    if not hits:
        return ""
    steps, future, name = min(hits)
    row, tracks = rows[name][future], scenario.recorded(future)
    kind = tracks.kinds[int(np.flatnonzero(tracks.ids == row.collision_with)[0])]
    return f"{' '.join(parts)} ({kind} after {steps * scenario.dt:.1f} s, {row.collision_class})"


def judge(scenario: Scenario, stand_ins: Sequence[FloatArray]) -> Accepted | Rejected:
    """Judges a scenario.

    Args:
        scenario: The scenario with its K futures.
        stand_ins: The K drives of the vehicle that drove in the ego's place, (n, 4) centre x, y,
            heading and velocity from the start step on.

    Returns:
        Accepted where ``idm`` is defeated in at least one future, in the ideal loop or in a late
        one, collides in none within ``FIRST_CONTACT`` steps of the start, ``idm`` or the stand-in
        succeeds in at least one, braking to a stop at once does not succeed in all, and a drive is
        found that solves each of them.
    """
    rows = baseline_rows(scenario)
    reason = _too_easy_or_hard(scenario, rows, stand_ins)
    if reason is not None:
        return Rejected(reason)
    drives = []
    for number in range(1 + len(scenario.futures)):
        others = [drive for k, drive in enumerate(stand_ins) if k != number]
        drive = find_drive(in_future(scenario, number), (stand_ins[number], *others))
        if drive is None:
            return Rejected(UNSOLVED)
        drives.append(drive)
    return Accepted(defeat_words(scenario, rows), tuple(drives))


def _too_easy_or_hard(
    scenario: Scenario, rows: Mapping[str, Sequence[Score]], stand_ins: Sequence[FloatArray]
) -> str | None:
    """Why the baselines' drives speak against a scenario; None where they do not."""
    every = [row for name in DECISIVE for row in rows.get(name, ())]
    if any(row.outcome is Outcome.COLLISION and row.steps < FIRST_CONTACT for row in every):
        return AT_ONCE
    if not any(map(defeats, every)):
        return UNDEFEATED
    futures = [in_future(scenario, k) for k in range(1 + len(scenario.futures))]
    harmless = any(row.outcome is Outcome.SUCCESS for row in rows["idm"]) or any(
        stand_in_succeeds(future, drive) for future, drive in zip(futures, stand_ins, strict=True)
    )
    if not harmless:
        return HARMFUL
    brakes = (_driven(future, BrakePlanner(), NonePredictor()) for future in futures)
    if all(row.outcome is Outcome.SUCCESS for row in brakes):
        return BRAKING
    return None


def stand_in_succeeds(future: Scenario, drive: FloatArray) -> bool:
    """Whether the vehicle that drove in the ego's place succeeds by dosplan's scorer.

    Args:
        future: The scenario in that future, see ``in_future``.
        drive: (n, 4) its drive.

    Returns:
        Whether it does.
    """
    return scored(future, drive).outcome is Outcome.SUCCESS
