"""The embedded suite asks for decisions, and can be solved."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from baselines import PLANNERS, drive_baselines
from suitegen.verdict import VEHICLE, recorded_episode

from dosplan.scenario import load_scenario
from dosplan.scoring.score import score
from dosplan.types import Outcome
from tests.support.suite import ROWS, SUITE, Row, baselines, drives, each

SUCCESS = Outcome.SUCCESS.value


def test_there_are_a_hundred_and_fifty() -> None:
    assert len(ROWS) == 150
    assert list(drives()) == [row["id"] for row in ROWS]


def test_constant_speed_is_defeated() -> None:
    outcomes = [row["cruise"] for row in baselines()]
    assert len(outcomes) == len(ROWS)
    assert sum(outcome != SUCCESS for outcome in outcomes) >= 120


@pytest.mark.parametrize("planner", PLANNERS)
def test_no_baseline_solves_most_of_it(planner: str) -> None:
    outcomes = Counter(row[planner] for row in baselines())
    assert outcomes[SUCCESS] <= 0.6 * len(ROWS)
    assert outcomes[Outcome.PLANNER_FAILURE.value] == 0


@pytest.mark.parametrize("row", each())
def test_recorded_drive_succeeds(row: Row) -> None:
    """The vehicle that was taken out solved its own task, and drove as a car can."""
    scenario = load_scenario(SUITE / row["file"], cached=True)
    drive = drives()[row["id"]]
    # The first state is the planning problem's; 0.6 mm and 0.06 mrad is rounding.
    start = VEHICLE.poses(scenario.task.start[None])[0]
    np.testing.assert_allclose(drive[0, :2], start[:2], atol=1.2e-3)
    assert score(scenario, recorded_episode(scenario, drive)).outcome == SUCCESS
    assert np.abs(np.diff(drive[:, 3])).max() <= 9.0 * scenario.dt + 2e-3


@pytest.mark.slow
def test_baselines_still_do_what_the_table_says() -> None:
    assert drive_baselines(SUITE, ROWS) == baselines()
