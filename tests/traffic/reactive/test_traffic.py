"""Traffic that keeps to the recording: who brakes, who does not, and what it comes back to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dosplan_reactive.settings import Manner, ReactiveSettings
from dosplan_reactive.traffic import ReactiveTraffic

from dosplan.scenario.synthetic import CAR_SIZE, LANE_WIDTH, steady_tracks, straight_scenario
from dosplan.types import COLOURS, LightColour, RoadUserKind, Scenario
from tests.support.lights import STOP_X, regulated_scenario
from tests.support.traffic import braking_before, followed
from tests.traffic.reactive.scenes import DT, along, driven, scene, standing, state


def test_with_nobody_in_the_way_the_recording_comes_back_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    speeds = np.clip(8.0 + np.cumsum(rng.normal(0.0, 0.3, 101)), 0.0, 20.0)
    shaky = along(speeds, start=20.0)
    shaky[:, :3] += rng.normal(0.0, 0.01, (101, 3))
    late = along(np.full(101, 9.0), y=LANE_WIDTH)
    late[:40] = np.nan
    scenario = scene(shaky, late, along(np.zeros(101), start=60.0, y=-6.0))
    for step, users in enumerate(driven(scenario, standing(-300.0)), 1):
        there = scenario.tracks.valid[:, step]
        np.testing.assert_array_equal(users.ids, scenario.tracks.ids[there])
        np.testing.assert_array_equal(users.states, scenario.tracks.states[there, step])


def test_whoever_follows_an_ego_that_brakes_stops_behind_it() -> None:
    episode = braking_before(ReactiveTraffic())
    follower, ego = episode.tracks.states[0], episode.states[-1]
    gap = ego[0] - follower[-1, 0] - 0.5 * CAR_SIZE[0]
    assert 0.0 < gap < 6.0
    assert follower[-1, 3] < 0.5
    assert follower[-1, 0] < followed().tracks.states[0, episode.tracks.steps - 1, 0]
    assert np.diff(follower[:, 3]).min() >= -8.0 * DT - 1e-9  # It brakes as a car can.


def test_nobody_brakes_before_the_reaction_time_is_over() -> None:
    scenario = scene(along(np.full(101, 10.0)))
    ego = standing(30.0)
    begun = {}
    for time in (0.3, 1.2):
        traffic = ReactiveTraffic(settings=ReactiveSettings(reaction_time=time))
        users = driven(scenario, ego, traffic)
        off = [state(u, 100)[0] != scenario.tracks.states[0, i, 0] for i, u in enumerate(users, 1)]
        begun[time] = int(np.argmax(off)) + 1
    assert begun[1.2] - begun[0.3] == 9


def test_what_the_ego_does_in_a_step_is_not_known_before_it_is_over() -> None:
    scenario = scene(along(np.full(101, 10.0)))
    one, other = standing(200.0, steps=4), standing(200.0, steps=4)
    other[-1, 0] = 12.0
    for users, same in zip(driven(scenario, one), driven(scenario, other), strict=True):
        np.testing.assert_array_equal(users.states, same.states)


def test_a_delay_is_passed_on_and_who_has_a_free_lane_is_exactly_on_time() -> None:
    follower, second = along(np.full(101, 10.0)), along(np.full(101, 10.0), start=-14.0)
    beside = along(np.full(101, 10.0), start=-5.0, y=LANE_WIDTH)
    scenario = scene(follower, second, beside)
    users = driven(scenario, standing(40.0))
    for step, seen in enumerate(users, 1):
        np.testing.assert_array_equal(state(seen, 102), scenario.tracks.states[2, step])
        gap = state(seen, 100)[0] - state(seen, 101)[0]
        assert gap > CAR_SIZE[0], step
    assert state(users[-1], 100)[0] < 40.0 - CAR_SIZE[0]
    assert state(users[-1], 101)[0] < 40.0 - 2.0 * CAR_SIZE[0]


def test_a_tight_recorded_gap_is_no_reason_to_brake() -> None:
    # 4 m behind the ego at 15 m/s, both at the same speed: a gap of 0.27 s.
    scenario = scene(along(np.full(60, 15.0), start=-8.5))
    ego = np.column_stack([15.0 * DT * np.arange(60), *np.zeros((2, 60)), np.full(60, 15.0)])
    for step, users in enumerate(driven(scenario, ego), 1):
        np.testing.assert_array_equal(users.states, scenario.tracks.states[:, step])


def crossing() -> Scenario:
    """Somebody comes from the right at 10 m/s, and is at x = 30 m, y = 0 after 4 s."""
    return scene(along(np.full(101, 10.0), start=-40.0, y=-30.0, heading=np.pi / 2.0))


def test_who_finds_the_ego_standing_on_a_crossing_stops_before_it() -> None:
    users = driven(crossing(), standing(30.0))
    assert state(users[-1], 100)[1] < -0.5 * (CAR_SIZE[0] + 1.61)
    assert state(users[-1], 100)[1] > -8.0


def test_who_crosses_does_not_wait_for_an_ego_that_is_gone_by_then() -> None:
    scenario = crossing()
    speed = 12.0
    ego = np.column_stack([speed * DT * np.arange(101), *np.zeros((2, 101)), np.full(101, speed)])
    for step, users in enumerate(driven(scenario, ego), 1):
        np.testing.assert_array_equal(users.states, scenario.tracks.states[:, step])


def test_only_the_courteous_give_way_to_an_ego_that_has_yet_to_cross() -> None:
    scenario = crossing()
    ego = np.column_stack([8.0 * DT * np.arange(101), *np.zeros((2, 101)), np.full(101, 8.0)])
    away = ego[:38]  # Up to 30.4 m: the ego enters the corridor of who crosses at the end.
    late = {}
    for manner in Manner:
        traffic = ReactiveTraffic(settings=ReactiveSettings(manner=manner))
        users = driven(scenario, away[:33], traffic)
        late[manner] = scenario.tracks.states[0, 32, 1] - state(users[-1], 100)[1]
    assert late[Manner.STRICT] == 0.0
    assert late[Manner.COURTEOUS] > 0.2


def test_two_who_are_late_do_not_drive_through_one_another() -> None:
    # Recorded, the first is across before the second comes; held up by the ego, it comes with it.
    first = along(np.full(101, 10.0), start=-10.0)
    second = along(np.full(101, 10.0), start=-48.0, y=-40.0, heading=np.pi / 2.0)
    scenario = scene(first, second)
    ego = standing(18.0)
    ego[16:, 1] = 20.0  # It is lifted out of the way.
    users = driven(scenario, ego)
    one = np.array([state(u, 100)[:2] for u in users])
    other = np.array([state(u, 101)[:2] for u in users])
    assert one[-1, 0] < scenario.tracks.states[0, -1, 0] - 5.0
    assert np.hypot(*(one - other).T).min() > 3.0
    assert max(one[-1, 0] - 40.0, other[-1, 1]) > 5.0  # They do not wait for one another.


def test_who_is_held_up_before_a_red_light_starts_when_it_is_recorded_to() -> None:
    speeds = np.concatenate([np.full(30, 10.0), np.linspace(10.0, 0.0, 15), np.zeros(30)])
    speeds = np.concatenate([speeds, np.linspace(0.0, 10.0, 26)])
    scenario = scene(along(speeds))
    ego = standing(30.0)
    ego[25:, 1] = 20.0
    users = driven(scenario, ego)
    assert state(users[25], 100)[0] < scenario.tracks.states[0, 26, 0] - 0.5
    for step in range(75, 101):
        np.testing.assert_array_equal(users[step - 1].states, scenario.tracks.states[:, step])


def test_who_comes_onto_the_scene_waits_until_the_place_is_free() -> None:
    comes = along(np.full(101, 10.0), start=-10.0)
    comes[:20] = np.nan
    scenario = scene(comes)
    place = scenario.tracks.states[0, 20, :2]
    ego = standing(place[0] + 2.0)
    ego[50:, 1] = 20.0
    ids = [users.ids.tolist() for users in driven(scenario, ego)]
    assert ids[:19] == [[]] * 19
    assert ids[19:50] == [[]] * 31
    assert ids[51:] == [[100]] * 49


def test_people_bicycles_and_who_drives_backwards_are_replayed() -> None:
    walk, ride = along(np.full(101, 1.5), start=20.0), along(np.full(101, 5.0))
    back = along(np.full(101, -3.0), start=60.0)
    kinds = (RoadUserKind.PEDESTRIAN, RoadUserKind.BICYCLE, RoadUserKind.CAR)
    scenario = scene(walk, ride, back, kinds=kinds)
    for step, users in enumerate(driven(scenario, standing(30.0)), 1):
        np.testing.assert_array_equal(users.states, scenario.tracks.states[:, step])


def test_after_its_last_recorded_step_somebody_leaves_the_scene_even_if_late() -> None:
    scenario = scene(along(np.full(60, 10.0)))
    ego = standing(40.0, steps=140)
    ego[50:, 1] = 20.0
    users = driven(scenario, ego)
    there = [len(u.ids) for u in users]
    assert there[60] == 1  # Late, it has some way left when the recording is over.
    assert there[-1] == 0
    free = driven(scenario, standing(-300.0, steps=63))
    assert [len(u.ids) for u in free[57:]] == [1, 1, 0, 0, 0]


def test_who_is_late_stops_at_a_light_that_its_recording_passed_while_it_was_green() -> None:
    # The light of the other lane turns red when the recording is just over the line.
    passing = along(np.full(101, 10.0), start=-5.0, y=LANE_WIDTH)
    plain = regulated_scenario(scene(passing).tracks)
    signals = plain.signals
    colours = np.array(signals.colours)
    colours[2] = COLOURS.index(LightColour.GREEN)
    colours[2, 36:] = COLOURS.index(LightColour.RED)
    scenario = replace(plain, signals=replace(signals, colours=colours))
    for step, users in enumerate(driven(scenario, standing(-300.0)), 1):
        np.testing.assert_array_equal(users.states, scenario.tracks.states[:, step])
    ego = standing(14.0, LANE_WIDTH)
    ego[18:, 1] = -30.0
    late = driven(scenario, ego)
    front = state(late[-1], 100)[0] + 0.5 * CAR_SIZE[0]
    assert 26.0 < front < STOP_X
    assert state(late[-1], 100)[3] < 0.3
    always = np.full_like(colours, COLOURS.index(LightColour.GREEN))
    green = replace(plain, signals=replace(signals, colours=always))
    assert state(driven(green, ego)[-1], 100)[0] > STOP_X + 10.0


def test_who_is_recorded_to_run_a_red_light_runs_it_when_it_is_late_too() -> None:
    # The light of the other lane is red throughout; recorded, the car drives over its line.
    passing = along(np.full(101, 10.0), start=-5.0, y=LANE_WIDTH)
    scenario = regulated_scenario(scene(passing).tracks)
    ego = standing(14.0, LANE_WIDTH)
    ego[18:, 1] = -30.0
    late = driven(scenario, ego)
    # Held up well before the line, by more than what others react to: 0.5 m are 0.05 s.
    before = state(late[24], 100)[0]
    assert before + 0.5 * CAR_SIZE[0] < STOP_X - 5.0
    assert before < scenario.tracks.states[0, 25, 0] - 0.5
    assert state(late[-1], 100)[0] > STOP_X + 10.0


def test_an_episode_leaves_nothing_behind() -> None:
    scenario, traffic = followed(), ReactiveTraffic()
    first = driven(scenario, standing(20.0), traffic)
    driven(crossing(), standing(30.0), traffic)
    for users, again in zip(first, driven(scenario, standing(20.0), traffic), strict=True):
        np.testing.assert_array_equal(users.states, again.states)


def test_a_scene_without_anybody_is_driven() -> None:
    empty = straight_scenario(steady_tracks())
    assert [len(u.ids) for u in driven(empty, standing(0.0, steps=4))] == [0, 0, 0]
    short = replace(empty, tracks=steady_tracks(steps=0))
    assert [len(u.ids) for u in driven(short, standing(0.0, steps=4))] == [0, 0, 0]


@pytest.mark.parametrize(
    "wrong", [{"time_gap": -1.0}, {"deceleration": 0.0}, {"reaction_time": float("nan")}]
)
def test_settings_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ReactiveSettings(**wrong)  # type: ignore[arg-type]
