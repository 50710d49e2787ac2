"""Goals that cannot be reached are named, and no others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import shapely
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.goal_window import locate_goal
from dosplan_mpc.reach import Reach
from dosplan_mpc.reference import LanePath

from dosplan.scenario.synthetic import straight_route, straight_scenario
from dosplan.types import FloatArray, GoalState
from dosplan.vehicle import VehicleParameters

EGO = VehicleParameters()
CONFIG = MpcConfig()
PATH = LanePath(straight_route(), CONFIG.path)
ORIGIN = float(PATH.locate(np.zeros(2)))
END = float(PATH.points[-1, 0])


def region(x: float, y: float = 0.0, length: float = 6.0, width: float = 3.0) -> shapely.Polygon:
    return shapely.box(x - length / 2, y - width / 2, x + length / 2, y + width / 2)


def unreachable(
    goals: Sequence[GoalState], x: float = 0.0, velocity: float = 10.0, step: int = 0
) -> str | None:
    """Of an ego whose centre is at (x, 0) and heads along the path."""
    task = straight_scenario(goals=tuple(goals)).task
    found = [locate_goal(goal, PATH, CONFIG.goal) for goal in task.goals]
    state: FloatArray = EGO.state_at(np.array([x, 0.0]), 0.0, velocity)
    return Reach(task, found, EGO).unreachable(step, state, ORIGIN + x)


def test_a_goal_ahead_is_none_of_them() -> None:
    assert unreachable([GoalState(0, 50, region=region(40.0))]) is None
    assert unreachable([GoalState(0, 50)]) is None


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (GoalState(0, 5), "time is over"),
        # 3 s at 10 m/s, and 11.5 m/s2 besides: 81.75 m.
        (GoalState(0, 40, region=region(100.0)), "15.2 m too far for 3.0 s"),
        (GoalState(0, 40, region=region(-10.0)), "7.0 m behind"),
        (GoalState(0, 12, velocity=(15.0, 16.0)), "2.7 m/s too far off for 0.2 s"),
        (GoalState(0, 90, region=region(20.0, 30.0)), "28.5 m beside the route"),
        (GoalState(0, 90, region=region(20.0), heading=(2.9, 3.1)), "166 degrees off the route"),
        # Beside the path, where the ego could go: what is missing is the heading.
        (GoalState(0, 90, region=region(20.0, 4.0), heading=(2.9, 3.1)), "166 degrees off the"),
        # Behind the end of the path, where the heading would do.
        (GoalState(0, 90, region=region(END + 8.0), heading=(-0.1, 0.1)), "5.0 m beside the route"),
    ],
)
def test_what_is_missing_is_said(goal: GoalState, words: str) -> None:
    assert words in str(unreachable([goal], step=10))


def test_each_of_several_goals_is_named_and_one_that_is_left_silences_them() -> None:
    lost = [GoalState(0, 5), GoalState(0, 40, region=region(-10.0))]
    said = unreachable(lost, step=10)
    assert said == "goal 1: its time is over; goal 2: its region is 7.0 m behind"
    assert unreachable([*lost, GoalState(0, 40, region=region(20.0))], step=10) is None


def test_the_region_that_holds_the_ego_is_not_behind_it() -> None:
    assert unreachable([GoalState(0, 40, region=region(20.0))], x=22.9, velocity=0.0) is None
