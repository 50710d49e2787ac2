"""What the ego asks of others: the blame for a cut-in, and how hard others brake for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dosplan.scenario.synthetic import CAR_SIZE, LANE_WIDTH, steady_tracks, straight_scenario
from dosplan.scoring.imposed import CUT_IN_BRAKING, imposed_braking
from dosplan.scoring.score import score
from dosplan.simulation.traffic import Replay
from dosplan.types import (
    Arm,
    CollisionClass,
    Episode,
    EpisodeEnd,
    FloatArray,
    Scenario,
    Score,
    Tracks,
)
from dosplan.vehicle import VehicleParameters
from tests.support.traffic import ShyTraffic, braking_before, followed

VEHICLE = VehicleParameters()
DT = 0.1
STEPS = 60
REACH = 0.5 * (CAR_SIZE[0] + VEHICLE.length)


def ego_states(x: FloatArray, y: FloatArray, velocity: float) -> FloatArray:
    """(K + 1, 5) states of an ego whose centre is there, heading along +x."""
    states = np.zeros((len(x), 5))
    states[:, 0], states[:, 1], states[:, 3] = x - VEHICLE.rear_to_centre, y, velocity
    return states


def driven(states: FloatArray, tracks: Tracks) -> Episode:
    return Episode(
        scenario_id="straight",
        arm=Arm.WITHOUT_DOS,
        start_step=0,
        states=states,
        inputs=np.zeros((len(states) - 1, 2)),
        tracks=tracks,
        end=EpisodeEnd.TIME_OVER,
        predict_seconds=np.zeros(0),
        plan_seconds=np.zeros(0),
        plans=(),
        occupancies=(),
        cycle_steps=np.zeros(0, dtype=np.int64),
    )


def struck(gap: float, *, enters: int = 10, replayed: bool = False) -> Score:
    """The ego at 15 m/s is struck by a car at 20 m/s, ``gap`` metres ahead of which it cut in.

    It comes from the lane on the left within a step, and is in the way from the step ``enters`` on.
    """
    tracks = steady_tracks([[0.0, 0.0, 0.0, 20.0]], steps=STEPS)
    scenario = straight_scenario(tracks, velocity=15.0)
    centre = tracks.states[0, enters, 0] + REACH + gap
    x = centre + 15.0 * DT * (np.arange(STEPS) - enters)
    y = np.where(np.arange(STEPS) < enters, LANE_WIDTH, 0.0)
    reacting = tracks if replayed else replace(tracks, states=np.array(tracks.states))
    return score(scenario, driven(ego_states(x, y, 15.0), reacting))


def asked(gap: float) -> float:
    """Closing at 5 m/s, what is left after 0.4 s: 25 / (2 (gap - 2))."""
    return 25.0 / (2.0 * (gap - 2.0))


@pytest.mark.parametrize("gap", [4.2, 4.45, 4.55, 6.0])
def test_whoever_cuts_in_too_closely_is_to_blame_for_being_struck(gap: float) -> None:
    row = struck(gap)
    assert row.collision_class is CollisionClass.ACTIVE_REAR
    assert row.at_fault is (asked(gap) > CUT_IN_BRAKING)


def test_there_is_no_cut_in_that_leaves_no_room_at_all_without_blame() -> None:
    assert struck(1.0).at_fault


def test_a_recording_does_not_react_so_nobody_is_to_blame_for_being_struck_by_it() -> None:
    row = struck(4.0, replayed=True)
    assert row.collision_class is CollisionClass.ACTIVE_REAR
    assert not row.at_fault


def test_an_ego_that_was_ahead_from_the_start_did_not_cut_in() -> None:
    assert not struck(4.0, enters=0).at_fault


def test_an_ego_that_brakes_in_its_lane_did_not_cut_in() -> None:
    tracks = steady_tracks([[0.0, 0.0, 0.0, 20.0]], steps=STEPS)
    scenario = straight_scenario(tracks, velocity=20.0)
    x = REACH + 10.0 + 20.0 * DT * np.minimum(np.arange(STEPS), 10.0)  # It stops dead.
    reacting = replace(tracks, states=np.array(tracks.states))
    row = score(scenario, driven(ego_states(x, np.zeros(STEPS), 20.0), reacting))
    assert row.collision_class is CollisionClass.ACTIVE_REAR
    assert not row.at_fault


def slowed(scenario: Scenario, from_step: int, braking: float) -> Tracks:
    """The recording's first road user, which brakes from a step on."""
    tracks = scenario.tracks
    states = np.array(tracks.states)
    time = DT * np.maximum(np.arange(tracks.steps) - from_step, 0)
    time = np.minimum(time, states[0, 0, 3] / braking)
    states[0, :, 3] -= braking * time
    states[0, 1:, 0] = states[0, 0, 0] + np.cumsum(DT * states[0, 1:, 3])
    return replace(tracks, states=states)


def test_braking_that_is_not_recorded_is_imposed() -> None:
    scenario = straight_scenario(steady_tracks([[-20.0, 0.0, 0.0, 10.0]], steps=STEPS))
    tracks = slowed(scenario, 10, 3.0)
    assert imposed_braking(scenario.tracks, tracks, 0, STEPS - 1, DT) == pytest.approx(3.0)
    assert imposed_braking(scenario.tracks, tracks, 0, 9, DT) == 0.0


def test_what_is_recorded_to_brake_at_a_place_is_not_imposed_there() -> None:
    free = straight_scenario(steady_tracks([[-20.0, 0.0, 0.0, 10.0]], steps=STEPS))
    recorded = slowed(free, 10, 3.0)
    scenario = replace(free, tracks=recorded)
    # It stands for two seconds before it brakes, and is late from then on.
    states = np.array(recorded.states)
    states[0, 25:] = recorded.states[0, 5:-20]
    states[0, 5:25] = recorded.states[0, 5]
    late = replace(recorded, states=states)
    assert imposed_braking(scenario.tracks, late, 0, STEPS - 1, DT) == pytest.approx(0.0, abs=1e-9)


def test_there_is_none_where_it_cannot_be_told() -> None:
    scenario = straight_scenario(steady_tracks([[-20.0, 0.0, 0.0, 10.0]], steps=STEPS))
    assert imposed_braking(scenario.tracks, scenario.tracks, 0, 20, DT) is None
    tracks = slowed(scenario, 0, 1.0)  # It is off the recording at once, before it can have seen.
    assert imposed_braking(scenario.tracks, tracks, 0, 20, DT) is None
    others = replace(scenario.tracks, ids=scenario.tracks.ids + 50)
    assert imposed_braking(scenario.tracks, others, 0, 20, DT) is None
    assert imposed_braking(scenario.tracks, slowed(scenario, 10, 1.0), 0, 0, DT) is None


def test_rows_say_it_of_traffic_that_reacts_and_of_no_other() -> None:
    scenario = followed()
    assert score(scenario, braking_before(Replay())).measures["imposed_braking"] is None
    shy = score(scenario, braking_before(ShyTraffic())).measures["imposed_braking"]
    assert shy is not None
    assert shy > 5.0  # It stands from one step to the next.
