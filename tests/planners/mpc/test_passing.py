"""What blocks the lane is passed over the lane against it, when that is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dosplan_mpc.config import MpcConfig, PassingSettings
from dosplan_mpc.passing import Pass, PassingDecision
from dosplan_mpc.planner import MpcPlanner
from dosplan_mpc.reference import EgoOnPath, aligned_path
from dosplan_mpc.sampler import Candidates, Sampler
from dosplan_simple.predictors import GroundTruthPredictor
from dosplan_simple.sets import ErrorCirclePredictor

from dosplan.api import Predictor
from dosplan.scenario import load_scenario
from dosplan.scenario.synthetic import growing_sets
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.world import World
from dosplan.types import Arm, Episode, FloatArray, Outcome, Scenario, Score
from tests.support import scenes

SECONDS = 16
HALF_WIDTH = 0.9
"""Distance that the ego's axis keeps from an edge, m, where a decision is made alone."""


def lorry(x: float, y: float = 0.0, length: float = 8.0) -> scenes.User:
    """A lorry that is parked on the road."""
    shape = f"<rectangle><length>{length}</length><width>2.5</width></rectangle>"
    return scenes.User(500, [(x, y, 0.0, 0.0)], kind="parkedVehicle", shape=shape, static=True)


def oncoming(x: float, velocity: float, name: int = 600) -> scenes.User:
    """A car on the lane against the ego's that is at x at the beginning."""
    states = scenes.driving(x, 3.5, velocity, 10 * SECONDS + 1, np.pi)
    return scenes.User(name, states)


def scene(
    folder: Path,
    road: Sequence[scenes.Lane],
    users: Sequence[scenes.User],
    side: float,
    velocity: float,
    goal: scenes.Goal,
) -> Scenario:
    """An ego at x = 20 m on a road along x; with the side -1 the road is the other way round."""
    path = scenes.write_scenario_xml(
        folder / "scene.xml",
        road if side > 0.0 else scenes.mirrored(road),
        users,
        [scenes.Problem(start=(20.0, 0.0, 0.0, velocity), goals=(goal,))],
    )
    return load_scenario(path)


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
    scenario = scene(folder, road, users, side, 10.0, goal)
    predictor = ErrorCirclePredictor() if predictor is None else predictor
    episode = run_episode(scenario, MpcPlanner(), predictor, arm)
    return score(scenario, episode), episode


def reasons(episode: Episode) -> list[str]:
    return [plan.report.waits_for for plan in episode.plans if plan.report.waits_for]


class Blocked:
    """A road with a lane against the ego's, on which lorries are parked; nothing is driven."""

    def __init__(self, folder: Path, *places: tuple[float, ...], side: float = 1.0) -> None:
        users = [replace(lorry(*place), id=500 + i) for i, place in enumerate(places)]
        road = scenes.straight_road(lanes=1, oncoming=1, length=350.0)
        goal = scenes.Goal(0, 100, scenes.rectangle(30.0, 3.4, 250.0, 0.0))
        scenario = scene(folder, road, users, side, 0.0, goal)
        self.vehicle = scenario.task.vehicle
        self.observation = World(scenario).observation()
        self.occupancy = growing_sets(self.observation)
        self.path = aligned_path(scenario.task, MpcConfig().path)
        self.decision = PassingDecision(
            PassingSettings(), self.path, scenario.task.route, self.vehicle, HALF_WIDTH
        )

    def along(self, x: float) -> float:
        """Arc length of a place in the middle of the ego's lane, m."""
        return float(self.path.locate(np.array([x, 0.0])))

    def passed(self, x: float = 20.0, velocity: float = 0.0) -> tuple[Pass, list[int]]:
        """The pass that an ego decides for that stands there, and the ids of whom it passes."""
        found = self.decided(x, velocity)
        assert found is not None
        assert found.waits_for is None  # Nobody comes.
        return found, self.observation.ids[found.users].tolist()

    def decided(self, x: float, velocity: float = 0.0) -> Pass | None:
        position = self.along(x)
        ego = EgoOnPath(0, position - self.vehicle.rear_to_centre, 0.0, position, velocity)
        return self.decision.decide(self.observation, self.occupancy, ego)


def expect(scene: Blocked, found: Pass, first: float, last: float, offset: float) -> None:
    """What is passed are the metres from ``first`` to ``last``, ``offset`` m aside.

    Beside them the whole ego is; before and after that, it has 9 m to go aside and back.
    """
    half, way = 0.5 * scene.vehicle.length, PassingSettings().shortest_way
    assert found.near == pytest.approx(scene.along(first) - half, abs=0.01)
    assert found.far == pytest.approx(scene.along(last) + half, abs=0.01)
    assert found.near - found.begin == pytest.approx(way)
    assert found.end - found.far == pytest.approx(way)
    assert found.offset == pytest.approx(offset, abs=0.01)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right-hand traffic", "left-hand traffic"])
def test_two_that_stand_10_m_apart_are_passed_as_one(tmp_path: Path, side: float) -> None:
    # They are 8 m long: from 36 to 44 m, and from 54 to 62 m. The second sticks out by 0.2 m more.
    scene = Blocked(tmp_path, (40.0, 0.0), (58.0, 0.2 * side), side=side)
    found, ids = scene.passed()
    assert ids == [500, 501]
    assert found.side == side
    expect(scene, found, 36.0, 62.0, side * (1.25 + 0.2 + 0.3 + HALF_WIDTH))


def test_two_that_stand_60_m_apart_are_passed_one_after_the_other(tmp_path: Path) -> None:
    # From 26 to 34 m, and from 94 to 102 m, which is 74 m ahead of the ego.
    scene = Blocked(tmp_path, (30.0, 0.0), (98.0, 0.2))
    found, ids = scene.passed()
    assert ids == [500]
    expect(scene, found, 26.0, 34.0, 1.25 + 0.3 + HALF_WIDTH)
    # The ego is back on its lane 9 m behind the first.
    found, ids = scene.passed(x=34.0 + 0.5 * scene.vehicle.length + 9.1)
    assert ids == [501]
    expect(scene, found, 94.0, 102.0, 1.25 + 0.2 + 0.3 + HALF_WIDTH)


@pytest.mark.parametrize(("apart", "ids"), [(22.4, [500, 501, 502]), (22.6, [500])])
def test_between_two_the_ego_goes_back_where_there_is_room_to_go_aside_again(
    tmp_path: Path, apart: float, ids: list[int]
) -> None:
    # It takes 9 m to go back, and 9 m to go aside, and the ego is 4.5 m long. The third is as close
    # to the second.
    places = [(30.0 + i * (8.0 + apart), 0.0) for i in range(3)]
    scene = Blocked(tmp_path, *places)
    found, passed = scene.passed()
    assert passed == ids
    last = 34.0 + (len(ids) - 1) * (8.0 + apart)
    expect(scene, found, 26.0, last, 1.25 + 0.3 + HALF_WIDTH)


def test_the_end_of_a_stretch_is_that_of_who_reaches_farthest(tmp_path: Path) -> None:
    # The second, 4 m long, ends at 42.5 m beside the first, which ends at 44 m. The third begins at
    # 66 m: close enough behind the first, too far behind the second.
    scene = Blocked(tmp_path, (40.0, 0.0), (40.5, 0.1, 4.0), (70.0, 0.0))
    found, ids = scene.passed()
    assert ids == [500, 501, 502]
    expect(scene, found, 36.0, 74.0, 1.25 + 0.1 + 0.3 + HALF_WIDTH)


def test_what_is_being_passed_is_so_until_the_ego_is_back_on_its_lane(tmp_path: Path) -> None:
    """Its rear is at 44 m; the ego is 4.5 m long, and needs 9 m to come back."""
    scene = Blocked(tmp_path, (40.0, 0.0))
    end = 44.0 + 0.5 * scene.vehicle.length
    assert scene.decided(end + 0.1) is None  # It was never passed: it lies behind the ego.
    for x in (20.0, end + 0.1, end + 8.9):
        assert scene.passed(x)[1] == [500]
    assert scene.decided(end + 9.1) is None
    assert scene.decided(end + 0.1) is None


def test_a_fast_ego_is_back_in_time_to_go_aside_again(tmp_path: Path) -> None:
    # At 20 m/s it has 30 m for each; there are 40 m in between, and it is 4.5 m long.
    scene = Blocked(tmp_path, (40.0, 0.0), (88.0, 0.0))
    found, ids = scene.passed(velocity=20.0)
    assert ids == [500]
    half, way = 0.5 * scene.vehicle.length, PassingSettings().shortest_way
    assert found.near - found.begin == pytest.approx(30.0)
    assert found.end == pytest.approx(scene.along(84.0) - half - way, abs=0.01)


@pytest.mark.parametrize("apart", [19.0, 21.0, 23.0, 26.0, 30.0])
def test_a_lorry_closely_behind_another_is_passed_as_well(tmp_path: Path, apart: float) -> None:
    row, episode = drive(tmp_path, [lorry(50.0), replace(lorry(58.0 + apart), id=501)])
    assert row.outcome is Outcome.SUCCESS, row
    assert not reasons(episode)


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
