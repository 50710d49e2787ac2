"""Where the road forks, the branch that the route does not take is no road to a plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import shapely
from dosplan_mpc.fork import other_branches
from dosplan_mpc.planner import MpcPlanner
from dosplan_simple.sets import ErrorCirclePredictor

from dosplan.scenario import load_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.types import Arm, Outcome, Scenario
from tests.support import scenes

RADIUS = 4.5
NORTH = 50.0 + RADIUS


def fork(
    folder: Path,
    users: Sequence[scenes.User] = (),
    *,
    start: float = 20.0,
    goal: str | None = None,
    more: Sequence[scenes.Lane] = (),
) -> Scenario:
    """The road along x forks at x = 50 m: straight on, and to the left, where the goal is."""
    left = np.pi / 2
    lanes = (
        scenes.straight_lane(1, (0.0, 0.0, 0.0), 50.0, successors=(2, 4)),
        scenes.arc_lane(2, (50.0, 0.0, 0.0), RADIUS, left, successors=(3,), predecessors=(1,)),
        scenes.straight_lane(3, (NORTH, RADIUS, left), 100.0, predecessors=(2,)),
        scenes.straight_lane(4, (50.0, 0.0, 0.0), 80.0, predecessors=(1,)),
        *more,
    )
    region = scenes.rectangle(6.0, 3.0, NORTH, 40.0, left) if goal is None else goal
    problem = scenes.Problem(start=(start, 0.0, 0.0, 8.0), goals=(scenes.Goal(0, 100, region),))
    return load_scenario(scenes.write_scenario_xml(folder / "fork.xml", lanes, users, [problem]))


def closed(scenario: Scenario) -> shapely.Geometry:
    return other_branches(scenario.task, scenario.road_map, 1.5, 1.0)


def test_the_other_branch_is_no_road_behind_its_mouth(tmp_path: Path) -> None:
    area = closed(fork(tmp_path))
    assert not shapely.contains_xy(area, [40.0, 50.0, 53.0, NORTH], [0.0, 0.0, -1.5, 20.0]).any()
    assert shapely.contains_xy(area, [64.0, 80.0, 120.0], [0.0, 1.0, -1.5]).all()


def test_a_branch_in_which_the_goal_or_the_ego_is_stays_road(tmp_path: Path) -> None:
    ahead = scenes.rectangle(6.0, 3.0, 100.0, 0.0)
    scenario = fork(tmp_path, goal=ahead)
    assert not shapely.contains_xy(closed(scenario), 80.0, 0.0)
    assert shapely.contains_xy(closed(scenario), NORTH, 20.0)  # Now it is that one.
    assert not shapely.contains_xy(closed(fork(tmp_path, start=80.0)), 80.0, 0.0)


def test_what_others_drive_over_too_stays_road(tmp_path: Path) -> None:
    across = scenes.straight_lane(9, (80.0, -30.0, np.pi / 2), 60.0)
    area = closed(fork(tmp_path, more=[across]))
    assert not shapely.contains_xy(area, 80.0, 0.0)
    assert shapely.contains_xy(area, 90.0, 0.0)


def test_a_road_that_does_not_fork_is_road(tmp_path: Path) -> None:
    path = scenes.write_scenario_xml(
        tmp_path / "lanes.xml",
        scenes.straight_road(lanes=2, pieces=3),
        problems=[scenes.Problem(start=(20.0, 0.0, 0.0, 8.0))],
    )
    assert closed(load_scenario(path)).is_empty


@pytest.mark.parametrize("arm", list(Arm))
def test_the_ego_gives_way_before_the_fork_and_not_into_the_other_branch(
    tmp_path: Path, arm: Arm
) -> None:
    """Somebody comes out of the ego's branch and cuts the corner."""
    down = [(NORTH - 1.0, 25.0 - 0.4 * i, -np.pi / 2, 4.0) for i in range(53)]
    away = [(NORTH - 1.0 - 0.4 * i, 3.4, np.pi, 4.0) for i in range(68)]
    scenario = fork(tmp_path, [scenes.User(500, [*down, *away])])
    row = score(scenario, run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), arm))
    assert row.outcome is Outcome.SUCCESS, row
