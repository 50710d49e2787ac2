"""The world: what traffic hands over is what is observed, driven and kept, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from dosplan_baseline.cruise import CruisePlanner
from dosplan_dos.predictor import DosPredictor
from dosplan_mpc.planner import MpcPlanner
from dosplan_simple.predictors import (
    ConstantTurnRatePredictor,
    GroundTruthPredictor,
    NonePredictor,
)

from dosplan.api import PluginError, Predictor
from dosplan.scenario.synthetic import busy_scenario, steady_tracks, straight_scenario
from dosplan.simulation.loop import run_episode
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic
from dosplan.simulation.world import World, watch
from dosplan.types import (
    EGO_SIZE,
    Arm,
    Episode,
    EpisodeEnd,
    FloatArray,
    Scenario,
    ShapeError,
    Tracks,
)
from tests.support.traffic import LostTraffic, ShyTraffic, braking_before, followed

COAST = np.zeros(2)


def with_comings_and_goings(scenario: Scenario, seed: int = 0) -> Scenario:
    """The same recording with gaps in it, and NaN there."""
    tracks = scenario.tracks
    valid = np.random.default_rng(seed).random(tracks.valid.shape) < 0.8
    states = np.where(valid[..., None], tracks.states, np.nan)
    return replace(scenario, tracks=replace(tracks, states=states, valid=valid))


def assert_tracks_equal(one: Tracks, other: Tracks) -> None:
    for name in ("ids", "size", "states", "valid"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.kinds == other.kinds


class _Handed(Replay):
    """A replay that does not say that it is one."""

    name = "handed-v1"


def test_what_a_replay_hands_over_step_by_step_is_the_recording() -> None:
    scenario = with_comings_and_goings(busy_scenario())
    world = World(scenario, _Handed(), first_step=2)
    while world.now < scenario.tracks.steps - 1:
        world.wait()
    driven, recorded = world.tracks, scenario.tracks
    order = [driven.ids.tolist().index(name) for name in recorded.ids]
    np.testing.assert_array_equal(driven.states[order], recorded.states)
    np.testing.assert_array_equal(driven.valid[order], recorded.valid)


def test_who_builds_on_a_replay_is_not_taken_for_one() -> None:
    assert Replay.as_recorded
    assert not _Handed.as_recorded
    scenario = busy_scenario()
    world = World(scenario, _Handed())
    world.step(COAST)
    assert world.tracks.steps == world.now + 1 < scenario.tracks.steps


def test_an_observation_is_the_recordings_past_in_the_recordings_order() -> None:
    scenario = with_comings_and_goings(busy_scenario())
    tracks = scenario.tracks
    for seen in watch(scenario, 7, history=5):
        present = np.flatnonzero(tracks.valid[:, seen.step])
        np.testing.assert_array_equal(seen.ids, tracks.ids[present])
        first = max(seen.step - 4, 0)
        np.testing.assert_array_equal(
            seen.states[:, first - seen.step - 1 :], tracks.states[present, first : seen.step + 1]
        )
        assert not seen.valid[:, : first - seen.step - 1].any()
        assert np.isnan(seen.ego_history[:-1]).all()
        np.testing.assert_array_equal(seen.ego, scenario.task.start)


def test_watching_walks_the_whole_recording() -> None:
    scenario = straight_scenario(steady_tracks([[30.0, 0.0, 0.0, 8.0]], steps=120))
    assert [seen.step for seen in watch(scenario, 50)] == [0, 50, 100]


def test_a_world_begins_at_any_step_and_nobody_is_there_after_the_recording() -> None:
    scenario = straight_scenario(steady_tracks([[30.0, 0.0, 0.0, 8.0]], steps=20))
    assert World(scenario, first_step=19).observation().ids.tolist() == [100]
    late = World(scenario, first_step=30)
    assert late.observation().ids.size == 0
    late.step(COAST)
    assert (late.now, late.observation().ids.size) == (31, 0)


def test_the_ego_moves_by_the_tasks_vehicle() -> None:
    scenario = straight_scenario(velocity=5.0)
    slow = replace(scenario.task.vehicle, max_acceleration=2.0)
    world = World(replace(scenario, task=replace(scenario.task, vehicle=slow)))
    world.step(np.array([0.0, 100.0]))
    np.testing.assert_allclose(world.inputs, [[0.0, 2.0]])
    assert world.ego[3] == pytest.approx(5.2)
    assert world.driven.shape == (2, EGO_SIZE)


def test_traffic_may_add_road_users_and_the_past_of_a_new_one_is_empty() -> None:
    world = World(straight_scenario(steady_tracks([[60.0, 0.0, 0.0, 8.0]])), ShyTraffic())
    ids = []
    for _ in range(5):
        ids.append(world.observation().ids.tolist())
        world.step(COAST)
    assert ids == [[100]] * 3 + [[100, 900]] * 2
    seen = world.observation()
    np.testing.assert_array_equal(seen.valid[1, -4:], [False, True, True, True])
    assert np.isnan(seen.states[1, :-3]).all()
    tracks = world.tracks
    assert (tracks.steps, tracks.ids.tolist()) == (6, [100, 900])
    np.testing.assert_array_equal(tracks.valid[1], [False, False, False, True, True, True])
    np.testing.assert_allclose(tracks.states[1, 3:, 0], [33.0, 34.0, 35.0])


def test_a_replay_is_the_recording_itself_in_the_episode() -> None:
    scenario = busy_scenario()
    episode = run_episode(scenario, CruisePlanner(), NonePredictor(), Arm.WITH_DOS)
    assert episode.tracks is scenario.tracks
    assert episode.traffic == "replay"


def test_who_reacts_is_in_the_episode_as_it_was_driven() -> None:
    # The ego brakes hard; who follows it at 10 m/s stands when it comes near.
    scenario, episode = followed(), braking_before(ShyTraffic())
    assert episode.traffic == "shy-v1"
    assert episode.tracks.steps == len(episode.states) == 51
    follower = episode.tracks.states[0]
    np.testing.assert_array_equal(follower[0], scenario.tracks.states[0, 0])
    centre = scenario.task.vehicle.centre(episode.states[-1])
    assert follower[-1, 3] == 0.0
    assert centre[0] - follower[-1, 0] > 10.0
    assert scenario.tracks.states[0, 50, 0] > centre[0]  # As recorded, it drives through the ego.


@pytest.mark.parametrize("moment", [0, 2, 4])
def test_the_future_of_traffic_is_not_in_what_was_handed_over(moment: int) -> None:
    world = World(busy_scenario(), ShyTraffic())
    for _ in range(moment):
        world.step(COAST)
    assert world.tracks.steps == world.now + 1
    observation = world.observation()
    for name in ("states", "valid", "ids", "size"):
        array: Any = getattr(observation, name)
        while array is not None:
            assert array.size <= 6 * 31 * 4
            array = array.base


def test_traffic_that_raises_ends_the_episode_and_is_named() -> None:
    caught: list[BaseException] = []
    episode = run_episode(
        busy_scenario(),
        CruisePlanner(),
        NonePredictor(),
        Arm.WITH_DOS,
        traffic=LostTraffic(),
        on_failure=caught.append,
    )
    assert episode.end is EpisodeEnd.TRAFFIC_FAILURE
    assert (episode.error or "").startswith("traffic lost-v1: KeyError: 'way' (traffic.py:")
    assert len(episode.inputs) == 1
    assert episode.tracks.steps == 42
    assert isinstance(caught[0], KeyError)


class _Away(ShyTraffic):
    """From the second step on everyone is at one place, far away."""

    name = "away-v1"
    place = 1e9

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        states = np.array(users.states)
        if len(ego) > 2:
            states[:, :2] = self.place
        return replace(users, states=states)


class _Beyond(_Away):
    name = "beyond-v1"
    place = 1e200


@pytest.mark.parametrize(
    ("predictor", "arm"),
    [(DosPredictor(), Arm.WITH_DOS), (ConstantTurnRatePredictor(), Arm.WITHOUT_DOS)],
)
def test_places_whose_squares_are_no_numbers_are_blamed_on_the_traffic(
    predictor: Predictor, arm: Arm
) -> None:
    def drive(traffic: Traffic) -> Episode:
        return run_episode(busy_scenario(), MpcPlanner(), predictor, arm, traffic=traffic)

    episode = drive(_Beyond())
    assert episode.end is EpisodeEnd.TRAFFIC_FAILURE
    assert "ShapeError: RoadUsers.states holds a number beyond 1e+09" in (episode.error or "")
    assert drive(_Away()).error is None


class _Unbegun(ShyTraffic):
    name = "unbegun-v1"

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        return scenario.tracks  # The future with it.


class _Shifting(ShyTraffic):
    name = "shifting-v1"

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        users = super().step(step, ego)
        return replace(users, size=users.size + step)


class _Talking(ShyTraffic):
    name = "talking-v1"

    def step(self, step: int, ego: FloatArray) -> Any:
        return "all quiet"


@pytest.mark.parametrize(
    ("traffic", "message"),
    [
        (_Unbegun, "begin must return Tracks of the steps 0 to 40"),
        (_Shifting, "road user 100 has another kind, size or outline than before"),
        (_Talking, "step returned str, not RoadUsers"),
    ],
)
def test_traffic_that_breaks_its_contract_is_told_so(
    traffic: type[ShyTraffic], message: str
) -> None:
    with pytest.raises(PluginError, match=message):
        World(busy_scenario(), traffic()).step(COAST)
    episode = run_episode(
        busy_scenario(), CruisePlanner(), NonePredictor(), Arm.WITH_DOS, traffic=traffic()
    )
    assert f"traffic {traffic.name}: PluginError: {message}" in (episode.error or "")
    assert len(episode.states) == 1
    assert episode.tracks.steps == 41


def test_an_oracle_is_refused_where_the_recorded_future_does_not_come() -> None:
    episode = run_episode(
        busy_scenario(), CruisePlanner(), GroundTruthPredictor(), Arm.WITH_DOS, traffic=ShyTraffic()
    )
    assert "predictor ground-truth" in (episode.error or "")
    assert "which the traffic shy-v1 departs from" in (episode.error or "")


def test_road_users_refuse_two_of_the_same_id() -> None:
    size, states = np.ones((2, 2)), np.zeros((2, 4))
    kinds = steady_tracks(states).kinds
    with pytest.raises(ShapeError, match="names a road user twice"):
        RoadUsers(np.array([5, 5]), kinds, size, states)
    with pytest.raises(ShapeError, match="kinds has 1 entries, expected 2"):
        RoadUsers(np.array([5, 6]), kinds[:1], size, states)
