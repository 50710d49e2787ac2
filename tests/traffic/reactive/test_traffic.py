"""Traffic that keeps to the recording and reacts to the ego."""

from __future__ import annotations

import numpy as np
from dosplan_reactive.traffic import ReactiveTraffic

from dosplan.simulation.world import World
from dosplan.types import USER_VELOCITY
from tests.support.traffic import braking_before, followed


def test_whoever_is_behind_a_standing_ego_stands_behind_it() -> None:
    episode = braking_before(ReactiveTraffic())
    follower, ego = episode.tracks.states[0, -1], episode.states[-1]
    assert follower[USER_VELOCITY] == 0.0
    assert follower[0] < ego[0] < followed().tracks.states[0, episode.tracks.steps - 1, 0]


def test_with_no_ego_in_the_way_the_recording_comes_back_bit_by_bit() -> None:
    scenario = followed()
    world = World(scenario, ReactiveTraffic())
    ego = np.tile([-500.0, 0.0, 0.0, 0.0, 0.0], (2, 1))
    for step in range(1, scenario.tracks.steps):
        users = world.traffic.step(step, ego)
        np.testing.assert_array_equal(users.states, scenario.tracks.states[:, step])
