"""What blocks the lane is passed over the lane against it, when that is free."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dosplan_mpc.planner import MpcPlanner
from dosplan_mpc.sampler import Candidates, Sampler
from dosplan_simple.predictors import GroundTruthPredictor
from dosplan_simple.sets import ErrorCirclePredictor

from dosplan.api import Predictor
from dosplan.scenario import load_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.types import Arm, Episode, FloatArray, Outcome, Score
from tests.support import scenes

LORRY = "<rectangle><length>8.0</length><width>2.5</width></rectangle>"
SECONDS = 16


def lorry(x: float, y: float = 0.0) -> scenes.User:
    """A lorry that is parked on the road."""
    return scenes.User(500, [(x, y, 0.0, 0.0)], kind="parkedVehicle", shape=LORRY, static=True)


def oncoming(x: float, velocity: float, name: int = 600) -> scenes.User:
    """A car on the lane against the ego's that is at x at the beginning."""
    states = scenes.driving(x, 3.5, velocity, 10 * SECONDS + 1, np.pi)
    return scenes.User(name, states)


def drive(
    folder: Path,
    users: Sequence[scenes.User],
    *,
    lanes: int = 1,
    against: int = 1,
    side: float = 1.0,
    arm: Arm = Arm.WITH_DOS,
    predictor: Predictor | None = None,
) -> tuple[Score, Episode]:
    """An ego at 10 m/s on a road along x, its goal 75 m behind the lorry's usual place."""
    road = scenes.straight_road(lanes=lanes, oncoming=against, length=350.0)
    goal = scenes.Goal(0, 10 * SECONDS, scenes.rectangle(30.0, 3.4, 145.0, 0.0))
    path = scenes.write_scenario_xml(
        folder / "scene.xml",
        road if side > 0.0 else scenes.mirrored(road),
        users,
        [scenes.Problem(start=(20.0, 0.0, 0.0, 10.0), goals=(goal,))],
    )
    scenario = load_scenario(path)
    predictor = ErrorCirclePredictor() if predictor is None else predictor
    episode = run_episode(scenario, MpcPlanner(), predictor, arm)
    return score(scenario, episode), episode


def reasons(episode: Episode) -> list[str]:
    return [plan.report.waits_for for plan in episode.plans if plan.report.waits_for]


@pytest.mark.parametrize("arm", list(Arm))
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right-hand traffic", "left-hand traffic"])
def test_a_lorry_on_the_lane_is_passed_while_nobody_comes(
    tmp_path: Path, side: float, arm: Arm
) -> None:
    row, episode = drive(tmp_path, [lorry(70.0)], side=side, arm=arm)
    assert row.outcome is Outcome.SUCCESS, row
    assert not reasons(episode)
    assert "pass 500" in {plan.report.decision for plan in episode.plans}
    beside = episode.states[np.abs(episode.states[:, 0] - 70.0) < 4.0]
    assert np.all(side * beside[:, 1] > 2.0)
    assert abs(episode.states[-1, 1]) < 0.5  # Back on its own lane.


def test_the_ego_waits_for_who_comes_and_passes_then(tmp_path: Path) -> None:
    # Both would meet beside the lorry.
    users = [lorry(70.0), oncoming(125.0, 10.0)]
    row, episode = drive(tmp_path, users, arm=Arm.WITHOUT_DOS)
    assert row.outcome is Outcome.SUCCESS, row
    assert "600, to pass 500" in reasons(episode)
    assert "wait for 600, to pass 500" in {plan.report.decision for plan in episode.plans}
    beside = np.flatnonzero(np.abs(episode.states[:, 0] - 70.0) < 4.0)
    comer = 125.0 - 10.0 * 0.1 * beside
    assert np.all(comer < 70.0)  # It is through before the ego is beside the lorry.


def test_plans_of_a_new_decision_begin_in_its_class(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plan that waits is no guess for one that goes round, nor the other way."""
    sampled: list[float] = []
    sample = Sampler.sample

    def note(self: Sampler, start: FloatArray, *rest: Any) -> Candidates:
        sampled.append(float(start[0]))
        return sample(self, start, *rest)

    monkeypatch.setattr(Sampler, "sample", note)
    _, episode = drive(tmp_path, [lorry(70.0), oncoming(125.0, 10.0)])
    words = [plan.report.decision for plan in episode.plans]
    new = [i for i in range(1, len(words)) if words[i] != words[i - 1]]
    assert len(new) == 2  # It waits, then it passes, then it goes on.
    assert {float(episode.states[i, 0]) for i in new} <= set(sampled)


def test_somebody_without_a_prediction_is_taken_to_keep_its_speed(tmp_path: Path) -> None:
    # The other car's recording ends while somebody comes: what is recorded of it ends as well.
    leaves = scenes.User(700, scenes.driving(60.0, -20.0, 1.0, 30, 0.0))
    users = [lorry(70.0), oncoming(125.0, 10.0), leaves]
    predictor = GroundTruthPredictor()
    row, episode = drive(tmp_path, users, arm=Arm.WITHOUT_DOS, predictor=predictor)
    assert episode.error is None
    assert row.outcome is Outcome.SUCCESS, row
    assert "600, to pass 500" in reasons(episode)


def test_who_comes_much_later_is_not_waited_for(tmp_path: Path) -> None:
    row, episode = drive(tmp_path, [lorry(70.0), oncoming(330.0, 8.0)])
    assert row.outcome is Outcome.SUCCESS, row
    assert not reasons(episode)


def test_what_leaves_room_in_the_lane_is_no_reason_to_leave_it(tmp_path: Path) -> None:
    # Its inner side is 0.35 m over the edge of the lane: 3.15 m are left.
    row, episode = drive(tmp_path, [lorry(70.0, -2.65), oncoming(125.0, 10.0)])
    assert row.outcome is Outcome.SUCCESS, row
    assert not reasons(episode)
    assert np.all(episode.states[:, 1] < 1.0)


def test_a_road_without_a_lane_against_it_is_not_passed_on(tmp_path: Path) -> None:
    row, episode = drive(tmp_path, [lorry(70.0)], against=0)
    assert row.outcome is Outcome.GOAL_MISSED, row
    assert row.out_of_bounds_step is None
    assert episode.states[-1, 0] < 66.0


def test_a_leader_that_stands_in_a_queue_is_not_passed(tmp_path: Path) -> None:
    """A car that has stood so far may drive on: it is no scenery."""
    queue = scenes.User(500, [(70.0, 0.0, 0.0, 0.0)] * (10 * SECONDS + 1))
    row, episode = drive(tmp_path, [queue])
    assert row.safe
    assert np.all(episode.states[:, 1] < 1.75)
