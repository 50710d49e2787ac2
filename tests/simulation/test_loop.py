"""The closed loop: where it lands, why it ends, what it lets a plug-in see, who is to blame."""

from __future__ import annotations

import argparse
import traceback
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest
from dosplan_baseline.brake import BrakePlanner
from dosplan_baseline.cruise import CruisePlanner
from dosplan_baseline.idm import IdmPlanner
from dosplan_simple.predictors import (
    ConstantTurnRatePredictor,
    ConstantVelocityPredictor,
    GroundTruthPredictor,
    NonePredictor,
)
from dosplan_simple.sets import ErrorCirclePredictor, FixedCirclePredictor, GrowingCirclePredictor
from shapely.geometry import box

from dosplan.api import Planner, Predictor
from dosplan.scenario.synthetic import busy_scenario, steady_tracks, straight_scenario
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import LoopSettings
from dosplan.simulation.traffic import Replay
from dosplan.simulation.world import World
from dosplan.types import (
    EGO_VELOCITY,
    EGO_X,
    HISTORY_STEPS,
    Arm,
    EpisodeEnd,
    GoalState,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    Scenario,
)
from dosplan.vehicle import VehicleParameters

PREDICTORS: list[type[Predictor]] = [
    NonePredictor,
    ConstantVelocityPredictor,
    ConstantTurnRatePredictor,
    FixedCirclePredictor,
    GrowingCirclePredictor,
    ErrorCirclePredictor,
]


class ConstantPlanner(Planner):
    """Asks for the same input at all times and remembers what it was shown."""

    name = "constant-v1"
    asked: ClassVar[tuple[float, float]] = (0.0, 0.0)
    steps: ClassVar[int] = 30

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        self.seen: list[tuple[Observation, Occupancy]] = []

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        self.seen.append((observation, occupancy))
        states = np.repeat(observation.ego[None], self.steps + 1, axis=0)
        return Plan(states=states, inputs=np.tile(self.asked, (self.steps, 1)))


class FullThrottlePlanner(ConstantPlanner):
    name = "full-throttle-v1"
    asked = (0.0, 100.0)


class ShortPlanner(ConstantPlanner):
    name = "short-v1"
    steps = 2


class RaisingPlanner(ConstantPlanner):
    name = "raising-v1"
    at = 3
    error: ClassVar[BaseException] = RuntimeError("no way\nout")

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        if observation.step == self.at:
            raise self.error
        return super().compute_plan(observation, occupancy)


class ElsewherePlanner(ConstantPlanner):
    name = "elsewhere-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return Plan(states=np.tile(observation.ego + 1.0, (2, 1)), inputs=np.zeros((1, 2)))


class CentrePlanner(ConstantPlanner):
    name = "centre-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        centre = np.array(observation.ego)
        centre[:2] = observation.task.vehicle.centre(observation.ego)
        return Plan(states=np.tile(centre, (2, 1)), inputs=np.zeros((1, 2)))


class NotPlanningPlanner(ConstantPlanner):
    name = "not-planning-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Any:
        return observation.ego


class InterruptedPlanner(RaisingPlanner):
    name = "interrupted-v1"
    error = KeyboardInterrupt()


class UnpreparedPlanner(ConstantPlanner):
    name = "unprepared-v1"

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        raise KeyError("route")


class RaisingPredictor(ConstantVelocityPredictor):
    name = "raising-v2"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        raise ValueError("too foggy")


def test_constant_velocity_lands_where_it_must() -> None:
    # 10 m/s for 5 s from the origin: the rear axle is at 50 m.
    episode = run_episode(straight_scenario(), ConstantPlanner(), NonePredictor(), Arm.WITH_DOS)
    np.testing.assert_allclose(episode.states[-1], [50.0, 0.0, 0.0, 10.0, 0.0], atol=1e-9)
    assert episode.end is EpisodeEnd.GOAL_REACHED
    assert episode.error is None
    assert episode.inputs.shape == (50, 2)
    np.testing.assert_array_equal(episode.cycle_steps, np.arange(50))


def test_inputs_are_cut_to_what_the_actuators_deliver() -> None:
    # At 5 m/s full throttle is a_max = 11.5 m/s2: 6.15 m/s after a step.
    scenario = straight_scenario(velocity=5.0)
    episode = run_episode(scenario, FullThrottlePlanner(), NonePredictor(), Arm.WITH_DOS)
    np.testing.assert_allclose(episode.inputs[0], [0.0, 11.5])
    assert episode.states[1, EGO_VELOCITY] == pytest.approx(6.15)


def test_ends_at_the_first_step_at_which_the_goal_holds() -> None:
    # The centre starts at 1.42 m and makes 1 m a step: 21.42 m at step 20, the first past 21 m.
    goal = GoalState(first_step=0, last_step=50, region=box(21.0, -2.0, 30.0, 2.0))
    scenario = straight_scenario(goals=[goal])
    episode = run_episode(scenario, ConstantPlanner(), NonePredictor(), Arm.WITH_DOS)
    assert (episode.end, len(episode.inputs)) == (EpisodeEnd.GOAL_REACHED, 20)


def test_a_goal_that_holds_at_the_start_is_a_drive_of_no_steps() -> None:
    scenario = straight_scenario(goals=[GoalState(first_step=0, last_step=50)])
    episode = run_episode(scenario, ConstantPlanner(), NonePredictor(), Arm.WITH_DOS)
    assert episode.end is EpisodeEnd.GOAL_REACHED
    assert episode.states.shape == (1, 5)
    assert episode.plans == ()


def test_the_goal_counts_at_the_last_step_and_not_after() -> None:
    far = box(50.0 + 1.4, -2.0, 60.0, 2.0)  # Reached at step 50 and not before.
    for final_step, end in ((50, EpisodeEnd.GOAL_REACHED), (49, EpisodeEnd.TIME_OVER)):
        scenario = straight_scenario(
            goals=[GoalState(first_step=0, last_step=99, region=far)], final_step=final_step
        )
        episode = run_episode(scenario, ConstantPlanner(), NonePredictor(), Arm.WITH_DOS)
        assert (episode.end, len(episode.inputs)) == (end, final_step)


def test_start_step_is_the_recordings() -> None:
    planner = ConstantPlanner()
    episode = run_episode(busy_scenario(), planner, NonePredictor(), Arm.WITH_DOS)
    assert episode.start_step == 40
    assert planner.seen[0][0].step == 40
    # The first car drives 8 m/s from x = 30 m on: at step 40 it is at 62 m.
    assert planner.seen[0][0].states[0, -1, 0] == pytest.approx(62.0)


def test_history_before_the_start_and_before_the_recording_is_empty() -> None:
    scenario = straight_scenario(steady_tracks([[30.0, 0.0, 0.0, 8.0]]), start_step=2)
    planner = ConstantPlanner()
    run_episode(scenario, planner, NonePredictor(), Arm.WITH_DOS)
    first, second = planner.seen[0][0], planner.seen[1][0]
    before = HISTORY_STEPS - 3
    np.testing.assert_array_equal(first.valid, [[False] * before + [True] * 3])
    np.testing.assert_allclose(first.states[0, :, 0], [np.nan] * before + [30.0, 30.8, 31.6])
    np.testing.assert_allclose(first.ego_history[:, EGO_X], [np.nan] * (before + 2) + [0.0])
    np.testing.assert_allclose(second.ego_history[:, EGO_X], [np.nan] * (before + 1) + [0.0, 1.0])
    np.testing.assert_array_equal(second.ego, second.ego_history[-1])


def test_only_who_is_on_the_scene_is_seen_and_nobody_after_the_recording() -> None:
    tracks = steady_tracks([[30.0, 0.0, 0.0, 8.0], [60.0, 0.0, 0.0, 8.0]], steps=20)
    valid = np.array(tracks.valid)
    valid[0, 5:10] = False
    states = np.where(valid[..., None], tracks.states, np.nan)
    scenario = straight_scenario(replace(tracks, states=states, valid=valid))
    planner = ConstantPlanner()
    run_episode(scenario, planner, ConstantVelocityPredictor(), Arm.WITH_DOS)
    ids = [list(observation.ids) for observation, _ in planner.seen]
    assert ids[:5] == [[100, 101]] * 5
    assert ids[5:10] == [[101]] * 5
    assert ids[10:20] == [[100, 101]] * 10
    assert ids[20:] == [[]] * 30
    assert list(planner.seen[12][0].valid[0, -8:]) == [False] * 5 + [True] * 3


def test_replanning_less_often_drives_the_plans_next_inputs() -> None:
    loop = LoopSettings(period=0.3)
    scenario = straight_scenario(final_step=10)
    episode = run_episode(scenario, ConstantPlanner(), NonePredictor(), Arm.WITH_DOS, loop)
    np.testing.assert_array_equal(episode.cycle_steps, [0, 3, 6, 9])
    assert len(episode.inputs) == 10
    for values in (episode.plans, episode.occupancies, episode.plan_seconds):
        assert len(values) == 4
    every = run_episode(scenario, BrakePlanner(), NonePredictor(), Arm.WITH_DOS)
    seldom = run_episode(scenario, BrakePlanner(), NonePredictor(), Arm.WITH_DOS, loop)
    np.testing.assert_allclose(seldom.states, every.states, atol=1e-12)


def test_a_plan_is_as_long_as_it_is_driven() -> None:
    scenario = straight_scenario(final_step=10)

    def drive(**loop: Any) -> Any:
        settings = LoopSettings(**loop)
        return run_episode(scenario, ShortPlanner(), NonePredictor(), Arm.WITH_DOS, settings)

    assert drive(period=0.2).error is None
    # The first plan has to last until the second one acts.
    for loop in ({"period": 0.3}, {"period": 0.1, "latency": 0.2}):
        failed = drive(**loop)
        assert failed.end is EpisodeEnd.PLANNER_FAILURE
        assert "planner short-v1: PluginError: the plan holds 2 inputs, but 3 steps" in failed.error
        assert "\n" not in failed.error


def test_a_planner_that_raises_ends_the_episode_and_keeps_what_was_driven() -> None:
    episode = run_episode(straight_scenario(), RaisingPlanner(), NonePredictor(), Arm.WITH_DOS)
    assert episode.end is EpisodeEnd.PLANNER_FAILURE
    assert len(episode.inputs) == len(episode.plans) == len(episode.occupancies) == 3
    assert episode.error is not None
    assert episode.error.startswith("planner raising-v1: RuntimeError: no way out (")
    assert "(test_loop.py:" in episode.error
    assert "\n" not in episode.error


class _ExitingPlanner(ConstantPlanner):
    """Calls something that wants to end the process."""

    name = "exiting-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        argparse.ArgumentParser().error("no such option")


def test_a_plugin_that_exits_is_blamed_at_its_own_line_and_its_traceback_is_handed_on() -> None:
    caught: list[BaseException] = []
    episode = run_episode(
        straight_scenario(),
        _ExitingPlanner(),
        NonePredictor(),
        Arm.WITH_DOS,
        on_failure=caught.append,
    )
    assert episode.end is EpisodeEnd.PLANNER_FAILURE
    line = _ExitingPlanner.compute_plan.__code__.co_firstlineno + 1
    assert episode.error == f"planner exiting-v1: SystemExit: 2 (test_loop.py:{line})"
    (error,) = caught
    assert isinstance(error, SystemExit)
    assert "argparse.py" in "".join(traceback.format_exception(error))


@pytest.mark.parametrize(
    ("planner", "predictor", "message"),
    [
        (ElsewherePlanner, NonePredictor, "planner elsewhere-v1: PluginError: .* starts 1 away"),
        (CentrePlanner, NonePredictor, "starts at the ego's centre, not at its rear axle"),
        (NotPlanningPlanner, NonePredictor, "planner not-planning-v1: .* returned ndarray"),
        (UnpreparedPlanner, NonePredictor, "planner unprepared-v1: KeyError: 'route'"),
        (ConstantPlanner, RaisingPredictor, "predictor raising-v2: ValueError: too foggy"),
    ],
)
def test_the_culprit_is_named(
    planner: type[Planner], predictor: type[Predictor], message: str
) -> None:
    episode = run_episode(straight_scenario(), planner(), predictor(), Arm.WITH_DOS)
    assert episode.end is EpisodeEnd.PLANNER_FAILURE
    assert len(episode.inputs) == 0
    with pytest.raises(RuntimeError, match=message):
        raise RuntimeError(episode.error)


def test_an_interrupt_passes() -> None:
    with pytest.raises(KeyboardInterrupt):
        run_episode(straight_scenario(), InterruptedPlanner(), NonePredictor(), Arm.WITH_DOS)


def test_the_arms_differ_in_the_semi_axes_alone() -> None:
    seen = {}
    for arm in Arm:
        planner = ConstantPlanner()
        run_episode(busy_scenario(), planner, GrowingCirclePredictor(), arm)
        seen[arm] = planner.seen
    for (_, with_sets), (_, without) in zip(seen[Arm.WITH_DOS], seen[Arm.WITHOUT_DOS], strict=True):
        np.testing.assert_array_equal(with_sets.centre, without.centre)
        assert with_sets.semi_axes[:2].min() > 0.0
        assert not without.semi_axes.any()


def test_an_oracle_is_shown_the_recording() -> None:
    planner = ConstantPlanner()
    run_episode(busy_scenario(), planner, GroundTruthPredictor(), Arm.WITH_DOS)
    # The car that is at 62 m drives 8 m/s on: 94 m after 40 steps.
    assert planner.seen[0][1].centre[0, 39, 0] == pytest.approx(94.0)


def with_another_future(scenario: Scenario, step: int) -> Scenario:
    """The same recording up to ``step``; after it everybody is elsewhere or gone."""
    tracks = scenario.tracks
    states, valid = np.array(tracks.states), np.array(tracks.valid)
    rng = np.random.default_rng(5)
    states[:, step + 1 :] = rng.uniform(-20.0, 20.0, states[:, step + 1 :].shape)
    valid[: len(valid) // 2, step + 1 :] = False
    return replace(scenario, tracks=replace(tracks, states=states, valid=valid))


@pytest.mark.parametrize("planner", [IdmPlanner, BrakePlanner, CruisePlanner])
@pytest.mark.parametrize("predictor", PREDICTORS)
def test_the_future_does_not_change_the_present(
    planner: type[Planner], predictor: type[Predictor]
) -> None:
    scenario, now = busy_scenario(), 44
    # The cycle at step 44 is the last one: up to there both recordings are the same.
    episodes = [
        run_episode(
            replace(recording, task=replace(recording.task, final_step=now + 1)),
            planner(),
            predictor(),
            Arm.WITH_DOS,
        )
        for recording in (scenario, with_another_future(scenario, now))
    ]
    one, other = episodes
    assert len(one.plans) == 5
    np.testing.assert_array_equal(one.states, other.states)
    for a, b in zip(one.plans, other.plans, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
    for c, d in zip(one.occupancies, other.occupancies, strict=True):
        for field in ("ids", "centre", "semi_axes", "valid"):
            np.testing.assert_array_equal(getattr(c, field), getattr(d, field))


def test_the_ground_truth_is_the_one_that_sees_the_future() -> None:
    scenario = busy_scenario()
    futures = (scenario, with_another_future(scenario, 40))
    one, other = (
        run_episode(s, CruisePlanner(), GroundTruthPredictor(), Arm.WITH_DOS).occupancies[0].valid
        for s in futures
    )
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("step", [0, 40, 99])
def test_no_array_of_an_observation_owns_the_future(step: int) -> None:
    scenario = busy_scenario()
    tracks = scenario.tracks
    observation = World(scenario, first_step=step, history=31).observation()
    for field in ("ego", "ego_history", "ids", "size", "states", "valid"):
        array = getattr(observation, field)
        while array is not None:
            assert array.size <= len(tracks.ids) * 31 * 5
            for owned in (tracks.states, tracks.valid, tracks.size, tracks.ids):
                assert not np.shares_memory(array, owned)
            array = array.base


def test_an_episode_is_the_same_twice() -> None:
    first, second = (
        run_episode(busy_scenario(), IdmPlanner(), GrowingCirclePredictor(), Arm.WITH_DOS)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.states, second.states)


class _Counted(Replay):
    """Counts how often it is closed."""

    name = "counted-v1"
    closed = 0

    def close(self) -> None:
        self.closed += 1


@pytest.mark.parametrize("planner", [CruisePlanner(), RaisingPlanner()])
def test_traffic_is_closed_once_when_an_episode_has_ended(planner: Planner) -> None:
    traffic = _Counted()
    run_episode(straight_scenario(), planner, NonePredictor(), Arm.WITH_DOS, traffic=traffic)
    assert traffic.closed == 1


def test_a_traffic_that_cannot_be_closed_is_named_unless_something_failed_before() -> None:
    class Stuck(Replay):
        name = "stuck-v1"

        def close(self) -> None:
            raise OSError("still busy")

    scenario = straight_scenario()
    stuck = run_episode(scenario, CruisePlanner(), NonePredictor(), Arm.WITH_DOS, traffic=Stuck())
    assert stuck.end is EpisodeEnd.TRAFFIC_FAILURE
    assert str(stuck.error).startswith("traffic stuck-v1: OSError: still busy")
    both = run_episode(scenario, RaisingPlanner(), NonePredictor(), Arm.WITH_DOS, traffic=Stuck())
    assert str(both.error).startswith("planner ")
