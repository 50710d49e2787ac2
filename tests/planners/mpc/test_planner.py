"""The optimisation planner in closed loop on made-up scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dosplan_mpc import effort
from dosplan_mpc.arrival import Arrival, Arrivals
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.nlp import Guess, MpcProblem, Solution
from dosplan_mpc.planner import MpcPlanner
from dosplan_simple.predictors import ConstantVelocityPredictor
from dosplan_simple.sets import ErrorCirclePredictor
from shapely import contains_xy
from shapely.geometry import box

from dosplan.api import PredictorSettings
from dosplan.scenario import load_scenario
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.world import World
from dosplan.types import (
    Arm,
    CollisionClass,
    Episode,
    EpisodeEnd,
    FloatArray,
    GoalState,
    Outcome,
    Scenario,
    Score,
    SolveReport,
    SolveStatus,
)
from dosplan.vehicle import VehicleParameters
from tests.support import scenes

VEHICLE = VehicleParameters()


def drive(
    users: Sequence[Sequence[float]],
    velocity: float,
    goals: Sequence[GoalState],
    arm: Arm = Arm.WITH_DOS,
    config: MpcConfig = MpcConfig(),
) -> tuple[Scenario, Episode]:
    last = max(goal.last_step for goal in goals)
    scenario = straight_scenario(
        steady_tracks(users), velocity=velocity, goals=goals, final_step=last
    )
    planner = MpcPlanner(settings=config)
    return scenario, run_episode(scenario, planner, ErrorCirclePredictor(), arm)


@pytest.mark.parametrize("arm", list(Arm))
@pytest.mark.parametrize(
    ("users", "velocity", "goal"),
    [
        pytest.param([], 10.0, GoalState(40, 50, box(38, -1, 60, 1)), id="free road"),
        pytest.param(
            [[45.0, 0.0, 0.0, 0.0], [20.0, 3.5, 0.0, 9.0], [0.0, 3.5, 0.0, 9.0]],
            10.0,
            GoalState(50, 50),
            id="stopped leader, busy left lane",
        ),
        pytest.param([[-14.0, 0.0, 0.0, 13.0]], 9.0, GoalState(50, 50), id="follower that hurries"),
        pytest.param(
            [], 10.0, GoalState(25, 45, box(25, -1, 45, 1), velocity=(4.0, 5.0)), id="slow goal"
        ),
        pytest.param([], 10.0, GoalState(55, 60, box(20, -1, 32, 1)), id="wait for the opening"),
        pytest.param([], 8.0, GoalState(35, 50, box(40, 2.2, 60, 4.8)), id="goal in the left lane"),
    ],
)
def test_scene_is_solved(
    users: Sequence[Sequence[float]], velocity: float, goal: GoalState, arm: Arm
) -> None:
    scenario, episode = drive(users, velocity, [goal], arm)
    row = score(scenario, episode)
    assert row.outcome is Outcome.SUCCESS, row
    assert row.fallback_cycles == 0


@pytest.mark.parametrize(
    ("velocity", "goal"),
    [
        pytest.param(6.0, GoalState(70, 100, box(95, -1, 140, 1)), id="speed up"),
        pytest.param(12.0, GoalState(60, 60, box(35, -1, 50, 1)), id="slow down"),
    ],
)
def test_a_goal_that_leaves_time_is_reached_in_comfort(velocity: float, goal: GoalState) -> None:
    row = score(*drive([], velocity, [goal]))
    assert row.outcome is Outcome.SUCCESS
    assert row.comfortable


@pytest.mark.parametrize("arm", list(Arm))
def test_a_slow_leader_is_passed(arm: Arm) -> None:
    """Two lanes of 3.5 m: room to pass a car, and the set around it."""
    goal = GoalState(50, 60, box(55, -2, 90, 5))
    scenario, episode = drive([[30.0, 0.0, 0.0, 4.0]], 12.0, [goal], arm)
    assert score(scenario, episode).outcome is Outcome.SUCCESS
    assert np.abs(episode.states[:, 1]).max() > 1.75


@pytest.mark.parametrize("arm", list(Arm))
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right-hand traffic", "left-hand traffic"])
@pytest.mark.parametrize("beside", [0.0, 3.5], ids=["own lane", "oncoming lane"])
def test_an_ego_in_the_middle_of_overtaking_does_not_turn_into_the_car_beside_it(
    tmp_path: Path, beside: float, side: float, arm: Arm
) -> None:
    lanes = scenes.straight_road(lanes=1, oncoming=1, length=350.0)
    goal = scenes.rectangle(30.0, 3.4, 200.0, side * beside)
    path = scenes.write_scenario_xml(
        tmp_path / "abeam.xml",
        lanes if side > 0.0 else scenes.mirrored(lanes),
        [scenes.User(500, scenes.driving(55.0, 0.0, 10.0, 161))],
        [scenes.Problem(start=(53.0, side * 3.5, 0.0, 14.0), goals=(scenes.Goal(0, 160, goal),))],
    )
    scenario = load_scenario(path)
    row = score(scenario, run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), arm))
    assert row.outcome is Outcome.SUCCESS, row


@pytest.mark.parametrize("arm", list(Arm))
@pytest.mark.parametrize(
    ("velocity", "ahead", "behind", "following"),
    [(8.0, 25.0, 14.0, 12.0), (10.0, 40.0, 20.0, 15.0), (6.0, 25.0, 12.0, 9.0)],
)
def test_nobody_in_front_is_hit_to_get_away_from_a_follower_that_does_not_brake(
    tmp_path: Path, velocity: float, ahead: float, behind: float, following: float, arm: Arm
) -> None:
    """One lane, a standing car, and a follower that hits the ego or pushes it into that car."""
    goal = scenes.rectangle(30.0, 3.4, 250.0)
    path = scenes.write_scenario_xml(
        tmp_path / "pushed.xml",
        scenes.straight_road(lanes=1, length=350.0),
        [
            scenes.User(500, scenes.driving(60.0 - behind, 0.0, following, 101)),
            scenes.User(501, scenes.driving(60.0 + ahead, 0.0, 0.0, 101)),
        ],
        [scenes.Problem(start=(60.0, 0.0, 0.0, velocity), goals=(scenes.Goal(0, 100, goal),))],
    )
    scenario = load_scenario(path)
    row = score(scenario, run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), arm))
    assert row.collision_class is CollisionClass.ACTIVE_REAR, row
    assert row.at_fault is False


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 2], ids=["left", "right"])
def test_a_corner_that_the_car_just_fits_through_is_driven(tmp_path: Path, angle: float) -> None:
    """A lane of 3.2 m, inner radius 2 m: steered as far as it goes, 0.2 m of it are left."""
    lanes = scenes.curve(radius=3.6, angle=angle, width=3.2, approach=30.0)
    y = np.sign(angle) * 18.0
    goal = scenes.rectangle(2.8, 10.0, 33.6, y)
    start = (14.0, 0.0, 0.0, 1.0)
    row = driven(tmp_path, lanes, scenes.Problem(start=start, goals=(scenes.Goal(1, 400, goal),)))
    assert row.outcome is Outcome.SUCCESS, row
    assert row.out_of_bounds_step is None


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize(
    ("x", "offset", "heading", "velocity", "yaw_rate"),
    [(50.906, 0.825, 0.2103, 5.39, 0.5759), (50.936, 0.889, 0.2618, 7.5, 0.0)],
    ids=["wheels turned", "no yaw rate"],
)
def test_a_bend_is_cut_without_leaving_the_road(
    tmp_path: Path,
    side: float,
    x: float,
    offset: float,
    heading: float,
    velocity: float,
    yaw_rate: float,
) -> None:
    """The ego is beside the inner edge of a bend of 4.5 m inner radius, at its beginning.

    There is another lane on the outer side.
    """
    inner = scenes.curve(radius=6.25, angle=side * np.pi / 2)
    turned = side * np.pi / 2
    outer = (
        scenes.straight_lane(11, (0.0, -side * 3.5, 0.0), 50.0, successors=(12,)),
        scenes.arc_lane(12, (50.0, -side * 3.5, 0.0), 9.75, turned, successors=(13,)),
        scenes.straight_lane(13, (59.75, side * 6.25, turned), 100.0, predecessors=(12,)),
    )
    lanes = (*inner, *outer)
    goal = scenes.rectangle(3.0, 16.0, 56.25, side * 29.0)
    problem = scenes.Problem(
        start=(x, side * offset, side * heading, velocity),
        goals=(scenes.Goal(1, 60, goal),),
        yaw_rate=side * yaw_rate,
    )
    row = driven(tmp_path, lanes, problem)
    assert row.outcome is Outcome.SUCCESS, row


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize(
    ("velocity", "distance", "window", "heading"),
    [(3.7, 3.2, (6, 10), (0.28, 0.46)), (4.0, 4.0, (8, 16), (0.35, 0.5))],
)
def test_a_goal_turned_from_the_lane_is_met(
    tmp_path: Path,
    side: float,
    velocity: float,
    distance: float,
    window: tuple[int, int],
    heading: tuple[float, float],
) -> None:
    low, high = sorted(side * bound for bound in heading)
    lanes = scenes.straight_road(lanes=3)
    start = (20.0, 3.5, 0.0, velocity)
    goal = scenes.Goal(
        *window,
        position=scenes.rectangle(4.0, 3.0, 20.0 + distance, 3.5 + side * 0.4),
        heading=(low, high),
    )
    row = driven(tmp_path, lanes, scenes.Problem(start=start, goals=(goal,)))
    assert row.outcome is Outcome.SUCCESS, row


def test_an_arrival_is_not_reported_to_enter_what_the_plan_entered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def planned() -> SolveReport:
        scenario = straight_scenario(steady_tracks([[8.0, 0.0, 0.0, 0.0]]), velocity=10.0)
        planner = MpcPlanner()
        planner.reset(scenario.task, scenario.road_map, scenario.task.vehicle)
        seen = World(scenario).observation()
        return planner.plan(seen, ConstantVelocityPredictor().predict(seen)).report

    assert planned().active_ids

    def arrive(self: Arrivals, plan: FloatArray, *rest: object) -> Arrival:
        return Arrival(plan, np.zeros((len(plan) - 1, 2)), 1)

    monkeypatch.setattr(Arrivals, "instead", arrive)
    report = planned()
    assert (report.active_ids, report.slack, report.road_slack) == ((), 0.0, 0.0)


def test_after_an_arrival_the_solver_goes_on_from_what_is_driven(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An arrival may turn or brake as no plan before it did."""
    guesses: list[Guess] = []
    solve = MpcProblem.solve

    def note(
        self: MpcProblem, start: FloatArray, stages: Any, guess: Guess, slack: Any
    ) -> Solution:
        guesses.append(guess)
        return solve(self, start, stages, guess, slack)

    def brake(self: Arrivals, plan: FloatArray, *rest: object) -> Arrival:
        states, inputs = [plan[0]], np.tile([0.0, -3.0], (len(plan) - 1, 1))
        for row in inputs:
            states.append(np.append(VEHICLE.step(states[-1][:5], row, 0.1), row[1]))
        return Arrival(np.array(states), inputs, 5)

    monkeypatch.setattr(MpcProblem, "solve", note)
    monkeypatch.setattr(Arrivals, "instead", brake)
    scenario = straight_scenario(velocity=10.0, goals=[GoalState(9, 9)], final_step=9)
    episode = run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), Arm.WITH_DOS)
    driven = episode.plans[0].states
    np.testing.assert_allclose(guesses[1].states[:-1, :5], driven[1:], atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
@pytest.mark.parametrize(
    ("lanes", "velocity", "distance", "heading"),
    [
        (1, 4.0, 30.0, (0.28, 0.45)),
        (1, 9.0, 12.0, (0.28, 0.45)),
        (3, 4.0, 12.0, (0.7, 0.9)),
        (3, 9.0, 30.0, (0.7, 0.9)),
    ],
)
def test_a_turned_goal_is_driven_into_while_there_is_time(
    tmp_path: Path,
    side: float,
    lanes: int,
    velocity: float,
    distance: float,
    heading: tuple[float, float],
) -> None:
    """Long before the deadline, the lane's path leads through the region with another heading."""
    low, high = sorted(side * bound for bound in heading)
    y = 3.5 * (lanes - 1) / 2
    region = scenes.rectangle(5.0, 3.0, 20.0 + distance, y)
    problem = scenes.Problem(
        start=(20.0, y, 0.0, velocity),
        goals=(scenes.Goal(5, 60, position=region, heading=(low, high)),),
    )
    row = driven(tmp_path, scenes.straight_road(lanes=lanes), problem)
    assert row.outcome is Outcome.SUCCESS, row


@pytest.mark.parametrize("wanted", [(14.0, 15.0), (4.0, 5.0)])
def test_a_goal_without_a_place_still_has_its_velocity(wanted: tuple[float, float]) -> None:
    goal = GoalState(60, 80, velocity=wanted)
    scenario = straight_scenario(velocity=10.0, goals=[goal], final_step=80)
    episode = run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), Arm.WITH_DOS)
    assert score(scenario, episode).outcome is Outcome.SUCCESS
    # It is met on the way, not in a last moment's braking or hurry.
    assert np.abs(np.diff(episode.states[:, 3])).max() < 0.4


def test_a_goal_that_is_out_of_reach_is_said_so(tmp_path: Path) -> None:
    region = scenes.rectangle(5.0, 3.0, 40.0, 0.0)
    turned = scenes.Goal(0, 20, position=region, heading=(2.9, 3.1))
    path = scenes.write_scenario_xml(
        tmp_path / "scene.xml",
        scenes.straight_road(),
        problems=[scenes.Problem(start=(20.0, 0.0, 0.0, 8.0), goals=(turned,))],
    )
    episode = run_episode(load_scenario(path), MpcPlanner(), ErrorCirclePredictor(), Arm.WITH_DOS)
    assert {plan.report.unreachable for plan in episode.plans} == {
        "its heading is 166 degrees off the route's"
    }


def driven(folder: Path, lanes: Sequence[scenes.Lane], problem: scenes.Problem) -> Score:
    """The row of an empty road that the planner drives."""
    path = scenes.write_scenario_xml(folder / "scene.xml", lanes, problems=[problem])
    scenario = load_scenario(path)
    episode = run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), Arm.WITH_DOS)
    return score(scenario, episode)


def test_reports_tell_about_the_solve() -> None:
    _, episode = drive([[25.0, 0.0, 0.0, 3.0]], 12.0, [GoalState(20, 20)])
    reports = [plan.report for plan in episode.plans]
    assert all(report.status is SolveStatus.SOLVED for report in reports)
    assert all(report.iterations > 0 and report.seconds > 0.0 for report in reports)


def test_fallback_is_declared_and_drives_on() -> None:
    """A solver that is given one iteration never converges: the fallback has to drive."""
    config = replace(MpcConfig(), max_iterations=1, accept_residual=1e-12)
    scenario, episode = drive([[60.0, 0.0, 0.0, 6.0]], 10.0, [GoalState(30, 30)], config=config)
    assert episode.end is EpisodeEnd.GOAL_REACHED
    fallbacks = [plan for plan in episode.plans if plan.report.fallback == "sampled"]
    assert len(fallbacks) > 10
    assert all(plan.report.status is not SolveStatus.SOLVED for plan in fallbacks)
    for plan in fallbacks[:3]:
        state = plan.states[0]
        for k, u in enumerate(plan.inputs):
            state = VEHICLE.step(state, u, 0.1)
            np.testing.assert_allclose(state, plan.states[k + 1], atol=1e-9)
    assert score(scenario, episode).outcome is Outcome.SUCCESS


def test_a_solution_off_the_road_is_not_driven_where_a_sample_keeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edges beside a guess that is astray tell the solver nothing of the road where it goes."""
    solve = MpcProblem.solve

    def go_straight_on(self: MpcProblem, start: FloatArray, *rest: Any) -> Solution:
        found = solve(self, start, *rest)
        states = np.tile(start, (len(found.states), 1))
        states[:, 0] += 0.1 * start[3] * np.arange(len(states))
        nothing = np.zeros_like
        return replace(
            found,
            states=states,
            inputs=nothing(found.inputs),
            set_slack=nothing(found.set_slack),
            road_slack=nothing(found.road_slack),
            cost=0.0,
            status=SolveStatus.SOLVED,
        )

    path = scenes.write_scenario_xml(
        tmp_path / "bend.xml",
        scenes.curve(radius=15.0, angle=np.pi / 2, approach=40.0),
        problems=[scenes.Problem(start=(30.0, 0.0, 0.0, 6.0), goals=(scenes.Goal(60, 60),))],
    )
    scenario = load_scenario(path)
    planner = MpcPlanner()
    planner.reset(scenario.task, scenario.road_map, scenario.task.vehicle)
    monkeypatch.setattr(MpcProblem, "solve", go_straight_on)
    seen = World(scenario).observation()
    plan = planner.plan(seen, ConstantVelocityPredictor().predict(seen))
    assert plan.report.status is SolveStatus.SOLVED
    assert plan.report.fallback == "sampled"
    assert contains_xy(scenario.road_map.drivable, plan.states[:, 0], plan.states[:, 1]).all()


def test_short_sets_are_a_named_failure() -> None:
    scenario = straight_scenario(velocity=10.0)
    short = ConstantVelocityPredictor(settings=PredictorSettings(horizon=10))
    episode = run_episode(scenario, MpcPlanner(), short, Arm.WITH_DOS)
    assert episode.end is EpisodeEnd.PLANNER_FAILURE
    assert episode.error is not None
    assert "raise the predictor's horizon" in episode.error


def test_an_episode_leaves_no_trace_in_the_next() -> None:
    goal = [GoalState(15, 15)]
    users = [[25.0, 0.0, 0.0, 3.0]]
    scenario = straight_scenario(steady_tracks(users), velocity=12.0, goals=goal, final_step=15)
    planner, predictor = MpcPlanner(), ErrorCirclePredictor()
    first = run_episode(scenario, planner, predictor, Arm.WITH_DOS)
    run_episode(straight_scenario(velocity=3.0), planner, predictor, Arm.WITH_DOS)
    again = run_episode(scenario, planner, predictor, Arm.WITH_DOS)
    np.testing.assert_array_equal(first.states, again.states)


def test_two_hundred_road_users_fit() -> None:
    users = [[20.0 + 4.0 * i, 3.5 + 30.0 * (i % 2), 0.0, 5.0] for i in range(200)]
    _, episode = drive(users, 8.0, [GoalState(5, 5)])
    assert episode.end is EpisodeEnd.GOAL_REACHED


def crowd(seed: int, n: int = 30) -> Scenario:
    """Road users all over the road ahead, in all directions, whose sets leave no room."""
    rng = np.random.default_rng(seed)
    columns = [rng.uniform(*ends, n) for ends in ((5, 60), (-6, 6), (-3, 3), (0, 8))]
    return straight_scenario(
        steady_tracks(np.column_stack(columns)),
        velocity=14.0,
        goals=[GoalState(25, 25)],
        final_step=25,
    )


@pytest.mark.parametrize("seed", [0, 4])
def test_the_work_of_a_cycle_is_bounded(seed: int) -> None:
    config = MpcConfig()
    planner = MpcPlanner(settings=config)
    episode = run_episode(crowd(seed), planner, ErrorCirclePredictor(), Arm.WITH_DOS)
    assert episode.error is None
    iterations = [plan.report.iterations for plan in episode.plans]
    # The scene is hard: a cycle runs out of the first solve's iterations and begins another one.
    assert max(iterations) > config.max_iterations + 1
    assert max(iterations) <= config.cycle_iterations + config.max_iterations
    # Where no solution is usable, it says so and drives what it has.
    driven = {plan.report.fallback for plan in episode.plans if plan.report.status.failed}
    assert driven <= {"last plan", "sampled"}


def test_no_solve_begins_after_the_iterations_of_a_cycle() -> None:
    config = MpcConfig(cycle_iterations=1)
    planner = MpcPlanner(settings=config)
    episode = run_episode(crowd(0), planner, ErrorCirclePredictor(), Arm.WITH_DOS)
    assert episode.error is None
    most = max(plan.report.iterations for plan in episode.plans)
    assert most <= config.max_iterations + 1  # Those of one solve; the last counts as another.


@pytest.fixture
def slow_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that stands still, but for a second in each solve."""
    now = 0.0
    solve = MpcProblem.solve

    def take_a_second(self: MpcProblem, *arguments: Any) -> Solution:
        nonlocal now
        now += 1.0
        return replace(solve(self, *arguments), seconds=1.0)

    monkeypatch.setattr(effort, "time", SimpleNamespace(perf_counter=lambda: now))
    monkeypatch.setattr(MpcProblem, "solve", take_a_second)


@pytest.mark.usefixtures("slow_solver")
def test_what_the_deadline_cuts_short_is_declared() -> None:
    goal = GoalState(40, 50, box(38, -1, 60, 1))
    scenario, episode = drive([], 10.0, [goal], config=MpcConfig(deadline=0.5))
    row = score(scenario, episode)
    assert row.outcome is Outcome.SUCCESS, row
    said = [plan.report.fallback for plan in episode.plans]
    # A solve that has begun goes on. After it was late, the last plan is driven for a while.
    assert said[:3] == ["solved at the deadline", *["last plan at the deadline"] * 2]
    assert said[3:].count("solved at the deadline") >= 2
    assert row.fallback_cycles == len(said)
    solved = [plan.report.status is SolveStatus.SOLVED for plan in episode.plans]
    assert solved == [text == "solved at the deadline" for text in said]


@pytest.mark.usefixtures("slow_solver")
def test_without_a_deadline_the_clock_decides_nothing() -> None:
    goal = GoalState(40, 50, box(38, -1, 60, 1))
    _, episode = drive([], 10.0, [goal])
    assert all(plan.report.fallback is None for plan in episode.plans)
    assert all(plan.report.status is SolveStatus.SOLVED for plan in episode.plans)


def test_a_deadline_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"deadline is 0.0, expected more than 0, or None"):
        MpcConfig(deadline=0.0)
