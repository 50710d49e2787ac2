"""The search that proves a future solvable, and the verdict on scenarios with several futures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dosplan_baseline.idm import IdmPlanner
from dosplan_simple.predictors import ConstantVelocityPredictor
from shapely.geometry import box
from suitegen.futures.search import CLEARANCE, find_drive, scored, solved
from suitegen.futures.verdict import (
    AT_ONCE,
    LATE,
    UNDEFEATED,
    UNSOLVED,
    Accepted,
    Rejected,
    ShortIdmPlanner,
    baseline_rows,
    defeats,
    in_future,
    judge,
)

from dosplan.scenario import load_scenario
from dosplan.scenario.synthetic import LANE_WIDTH
from dosplan.scoring.collision import first_contacts
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import IDEAL, LoopSettings
from dosplan.types import (
    Arm,
    CollisionClass,
    FloatArray,
    GoalState,
    LightColour,
    Scenario,
    StopCause,
)
from tests.support.factories import ruled_scenario, stop_at
from tests.support.futures import goal_at, leader_brakes, steps_out, stopped
from tests.support.suite import SUITE, Row, each

LENGTH = 4.508


def must_find(scenario: Scenario) -> FloatArray:
    drive = find_drive(scenario)
    assert drive is not None
    row = scored(scenario, drive)
    assert solved(row, scenario.task)
    assert not row.at_fault
    wide = np.add(scenario.task.vehicle.size, 1.5 * CLEARANCE)
    assert not first_contacts(drive, wide, scenario.tracks, scenario.task.start_step)
    assert np.abs(np.diff(drive[:, 3])).max() <= 0.1 * 8.0 + 2e-3
    np.testing.assert_allclose(
        drive[0, :3], scenario.task.vehicle.poses(scenario.task.start), atol=1e-3
    )
    return drive


def test_it_follows_a_leader_that_stops_for_a_while() -> None:
    scenario = ruled_scenario(
        users=[(25.0, 0.0, 0.0, 8.0), (25.0, LANE_WIDTH, 0.0, 8.0)], goals=[goal_at(60.0, 100)]
    )
    braking = stopped(stopped(scenario.tracks, 100, 10), 101, 10)
    states = np.array(braking.states)
    way = np.clip(np.arange(101) - 60, 0, None) * 0.8
    states[..., 0] += way
    states[:, 61:, 3] = 8.0
    scenario = replace(scenario, tracks=replace(braking, states=states))
    drive = must_find(scenario)
    assert drive[:, 3].min() < 5.0


def test_it_passes_somebody_who_stands_in_the_lane() -> None:
    scenario = ruled_scenario(users=[(35.0, 0.0, 0.0, 0.0)], goals=[goal_at(70.0, 100)])
    drive = must_find(scenario)
    assert drive[:, 1].max() > 1.5


def test_a_blocked_road_is_not_solved() -> None:
    wall = [(40.0, -0.2, 0.0, 0.0), (40.0, LANE_WIDTH / 2, 0.0, 0.0), (40.0, 3.7, 0.0, 0.0)]
    assert find_drive(ruled_scenario(users=wall, goals=[goal_at(70.0, 100)])) is None


def test_what_comes_too_fast_to_stop_is_not_solved() -> None:
    wall = [(20.0, -0.2, 0.0, 0.0), (20.0, LANE_WIDTH / 2, 0.0, 0.0), (20.0, 3.7, 0.0, 0.0)]
    goal = GoalState(0, 100, box(-50.0, -2.0, 400.0, 2.0))
    late = GoalState(60, 100, goal.region)
    assert find_drive(ruled_scenario(users=wall, velocity=20.0, goals=[late])) is None
    assert find_drive(ruled_scenario(users=wall, velocity=10.0, goals=[late])) is not None


def test_a_goal_that_cannot_be_reached_in_time_is_not_solved() -> None:
    assert find_drive(ruled_scenario(limit=10.0, goals=[goal_at(150.0, 100)])) is None
    assert find_drive(ruled_scenario(limit=30.0, goals=[goal_at(150.0, 100)])) is not None


def test_it_keeps_the_speed_limit() -> None:
    drive = must_find(ruled_scenario(limit=8.0, velocity=10.0, goals=[goal_at(60.0, 100)]))
    assert drive[20:, 3].max() <= 8.1
    assert drive[:, 3].max() == pytest.approx(10.0)


@pytest.mark.parametrize(("until", "solvable"), [(50, True), (101, False)])
def test_it_waits_at_a_red_light(until: int, solvable: bool) -> None:
    red, green = [LightColour.RED] * until, [LightColour.GREEN]
    scenario = ruled_scenario(
        stop_at(StopCause.LIGHT, 30.0, 45.0, lights=(7,)),
        lights={7: red + green},
        goals=[goal_at(60.0, 100)],
    )
    if not solvable:
        assert find_drive(scenario) is None
        return
    drive = must_find(scenario)
    front = drive[:, 0] + 0.5 * LENGTH
    assert front[until] <= 30.0


def test_it_stands_at_a_stop_sign() -> None:
    scenario = ruled_scenario(
        stop_at(StopCause.STOP_SIGN, 30.0, 45.0), goals=[goal_at(50.0, 120)], seconds=12.0
    )
    drive = must_find(scenario)
    front = drive[:, 0] + 0.5 * LENGTH
    before = (front <= 30.0) & (front > 27.0)
    assert drive[before, 3].min() <= 0.3


def test_it_gives_way() -> None:
    """A car crosses from the left; who goes on at 10 m/s would be in its way."""
    crossing = [(42.0, 40.0, -np.pi / 2, 9.0)]
    free = ruled_scenario(users=crossing, goals=[goal_at(80.0, 120)], seconds=12.0)
    area = box(40.0, -1.75, 44.0, 30.0)
    ruled = ruled_scenario(
        stop_at(StopCause.GIVE_WAY, 38.0, 46.0, conflict=area),
        users=crossing,
        goals=[goal_at(80.0, 120)],
        seconds=12.0,
    )
    assert passes(must_find(ruled)) > passes(must_find(free))


def passes(drive: FloatArray) -> int:
    return int(np.argmax(drive[:, 0] + 0.5 * LENGTH > 38.0))


@pytest.mark.parametrize("row", each())
def test_it_solves_the_suite_of_one_future(row: Row) -> None:
    must_find(load_scenario(SUITE / row["file"], cached=True))


def verdict_on(scenario: Scenario) -> Accepted | Rejected:
    drive = find_drive(in_future(scenario, 0))
    assert drive is not None
    return judge(scenario, [drive] * (1 + len(scenario.futures)))


@pytest.mark.parametrize(
    ("x", "defeats"),
    [
        (20.0, "idm:1 cruise:1 (pedestrian after 1.5 s, active_front)"),
        (25.0, "idm late:1 cruise:1 (pedestrian after 2.0 s, active_front)"),
    ],
)
def test_a_scenario_that_a_future_decides_is_accepted(x: float, defeats: str) -> None:
    scenario = steps_out(x)
    verdict = verdict_on(scenario)
    assert isinstance(verdict, Accepted)
    assert verdict.defeats == defeats
    assert len(verdict.drives) == 2
    for future, drive in enumerate(verdict.drives):
        assert solved(scored(in_future(scenario, future), drive), scenario.task)
    assert not solved(scored(in_future(scenario, 1), verdict.drives[0]), scenario.task)


@pytest.mark.parametrize(
    ("scenario", "reason"),
    [
        (replace(steps_out(20.0), futures=()), UNDEFEATED),
        (leader_brakes(15.0), UNDEFEATED),  # It defeats ``cruise`` alone.
        (steps_out(12.0, at=1), AT_ONCE),
    ],
    ids=["nobody", "cruise", "at-once"],
)
def test_a_scenario_is_rejected(scenario: Scenario, reason: str) -> None:
    assert verdict_on(scenario) == Rejected(reason)


def test_a_future_that_is_not_solved_rejects(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = steps_out(20.0)
    first = scenario.tracks
    monkeypatch.setattr(
        "suitegen.futures.verdict.find_drive",
        lambda future, driven: driven[0] if future.tracks is first else None,
    )
    assert verdict_on(scenario) == Rejected(UNSOLVED)


def test_to_be_struck_from_behind_is_no_defeat() -> None:
    """Who follows does not see the ego, whatever it brakes for."""
    row = baseline_rows(steps_out(20.0))["idm"][1]
    assert defeats(row)
    assert not defeats(replace(row, collision_class=CollisionClass.ACTIVE_REAR))


@pytest.mark.parametrize("loop", [IDEAL, LATE])
def test_plans_that_end_sooner_drive_the_same(loop: LoopSettings) -> None:
    future, predictor = in_future(leader_brakes(30.0), 1), ConstantVelocityPredictor()
    long, short = (
        run_episode(future, planner, predictor, Arm.WITHOUT_DOS, loop).states
        for planner in (IdmPlanner(), ShortIdmPlanner())
    )
    np.testing.assert_array_equal(long, short)
