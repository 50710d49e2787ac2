"""The suite of several futures: each can be solved, and which one comes decides.

That its files are whole and its futures have one past is held by ``test_recorded_futures``.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from baselines import PLANNERS, drive_baselines
from suitegen.futures.search import ACCELERATIONS, SEGMENT, scored, solved
from suitegen.futures.verdict import (
    DECISIVE,
    FIRST_CONTACT,
    baseline_rows,
    defeat_words,
    in_future,
)

from dosplan.scenario import load_scenario
from dosplan.types import Outcome, Scenario
from tests.support.suite import FUTURES_SUITE, Row, baselines, drives_by_future, manifest

ROWS = manifest(FUTURES_SUITE)
HARDEST = -float(ACCELERATIONS[0])
"""Deceleration of the drives that are found, m/s2, ..."""
ONTO_GRID = 0.5
"""... and what their first segment may add to it to end on the grid of velocities, m/s2."""


def each(quick: int) -> list[Any]:
    """Parameters of a test of every scenario; all but the first of a number of kinds are slow."""
    first = list({row["kind"]: row["id"] for row in reversed(ROWS)}.values())[-quick:]
    return [
        pytest.param(row, id=row["id"], marks=() if row["id"] in first else pytest.mark.slow)
        for row in ROWS
    ]


@cache
def loaded(file: str) -> Scenario:
    return load_scenario(FUTURES_SUITE / file)


def test_there_is_a_drive_for_each_future() -> None:
    named = {(row["id"], future) for row in ROWS for future in range(int(row["futures"]))}
    assert set(drives_by_future(FUTURES_SUITE)) == named


def test_the_manifest_names_who_is_defeated() -> None:
    for row in ROWS:
        assert re.match(r"idm( late)?:\d", row["defeats"]), row["id"]


@pytest.mark.parametrize("row", each(quick=100))
def test_every_future_is_solved_by_the_drive_that_ships(row: Row) -> None:
    scenario = loaded(row["file"])
    start = scenario.task.vehicle.poses(scenario.task.start)
    for future in range(int(row["futures"])):
        drive = drives_by_future(FUTURES_SUITE)[row["id"], future]
        np.testing.assert_allclose(drive[0, :3], start, atol=1e-3)
        change = np.abs(np.diff(drive[:, 3])) / scenario.dt
        assert change.max() <= HARDEST + ONTO_GRID + 0.02
        assert change[SEGMENT:].max() <= HARDEST + 0.02
        found = scored(in_future(scenario, future), drive)
        assert solved(found, scenario.task)
        assert not found.at_fault


@pytest.mark.parametrize("row", each(quick=2))
def test_baselines_are_defeated_as_the_manifest_says(row: Row) -> None:
    scenario = loaded(row["file"])
    rows = baseline_rows(scenario)
    assert defeat_words(scenario, rows) == row["defeats"]
    for found in (found for name in DECISIVE for found in rows.get(name, ())):
        assert found.outcome is not Outcome.PLANNER_FAILURE
        assert found.outcome is not Outcome.COLLISION or found.steps >= FIRST_CONTACT


def test_no_baseline_was_left_out_or_broke_down() -> None:
    rows = baselines(FUTURES_SUITE)
    assert set(rows[0]) == {"id", "future", *PLANNERS}
    assert len(rows) == sum(int(row["futures"]) for row in ROWS)
    for row in rows:
        assert Outcome.PLANNER_FAILURE not in (row[planner] for planner in PLANNERS)


def test_the_table_agrees_with_the_manifest() -> None:
    """Where ``idm`` collides in the ideal loop; to be struck from behind is no defeat."""
    table = {(row["id"], int(row["future"])): row["idm"] for row in baselines(FUTURES_SUITE)}
    for row in ROWS:
        named = re.match(r"idm:([\d,]+)", row["defeats"])
        for future in named[1].split(",") if named else ():
            assert table[row["id"], int(future)] == Outcome.COLLISION


@pytest.mark.slow
def test_baselines_still_do_what_the_table_says() -> None:
    assert drive_baselines(FUTURES_SUITE, ROWS) == baselines(FUTURES_SUITE)
