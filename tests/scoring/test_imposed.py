"""What the ego asks of others: the blame for a cut-in, and how hard others brake for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dosplan.geometry import wrap_angle
from dosplan.scenario.synthetic import CAR_SIZE, LANE_WIDTH, steady_tracks, straight_scenario
from dosplan.scoring.collision import Contact
from dosplan.scoring.imposed import CUT_IN_BRAKING, cut_in_demand, imposed_braking
from dosplan.scoring.score import score
from dosplan.simulation.traffic import Replay
from dosplan.types import (
    Arm,
    CollisionClass,
    Episode,
    EpisodeEnd,
    FloatArray,
    RoadUserKind,
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


@pytest.mark.parametrize(("gap", "fault"), [(48.0 - 0.1, True), (48.0 + 0.1, False)])
def test_whoever_cuts_in_and_stands_is_to_blame_for_being_struck_too(
    gap: float, fault: bool
) -> None:
    """Closing at 20 m/s, what is left after 0.4 s: 400 / (2 (gap - 8)), 5 m/s2 at 48 m."""
    tracks = steady_tracks([[0.0, 0.0, 0.0, 20.0]], steps=STEPS)
    y = np.where(np.arange(STEPS) < 10, LANE_WIDTH, 0.0)
    x = np.full(STEPS, tracks.states[0, 10, 0] + REACH + gap)
    reacting = replace(tracks, states=np.array(tracks.states))
    row = score(straight_scenario(tracks), driven(ego_states(x, y, 0.0), reacting))
    assert row.collision_class is CollisionClass.STOPPED_EGO
    assert row.at_fault is fault


def demand(
    gap: float,
    *,
    enters: int = 10,
    contact: int = 20,
    beside: float = LANE_WIDTH,
    velocity: float = 15.0,
    heading: float = 0.0,
    struck_at: float = 0.0,
    turned: float = 0.0,
    kind: RoadUserKind = RoadUserKind.CAR,
    unseen: tuple[int, ...] = (),
) -> float | None:
    """What a follower at 20 m/s needs that an ego cuts in before, ``gap`` metres ahead.

    The ego gets on by 1.5 m a step all the time, so that the follower closes 4.5 m in 9 steps.

    Args:
        gap: From the follower's front to the ego's centre, less half its length, m.
        enters: First step at which the ego is in the follower's way.
        contact: Step of the contact.
        beside: How far to the left of the follower's way the ego is until it enters, m.
        velocity: Speed of the ego as its states say, m/s.
        heading: Heading of the ego, rad.
        struck_at: Its heading at the contact, rad.
        turned: By what all is turned about the origin, rad.
        kind: What the follower is.
        unseen: Steps at which the follower is not on the scene.
    """
    steps = np.arange(contact + 1)
    tracks = steady_tracks([[0.0, 0.0, 0.0, 20.0]], steps=len(steps), kinds=[kind])
    ego = np.zeros((len(steps), 4))
    ego[:, 0] = 20.0 * DT * enters + REACH + gap + 1.5 * (steps - enters)
    ego[:, 1] = np.where(steps < enters, beside, 0.0)
    ego[:, 2], ego[:, 3] = heading, velocity
    states = np.array(tracks.states)
    cos, sin = np.cos(turned), np.sin(turned)
    for rows in (ego, states[0]):
        rows[:, :2] = rows[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        rows[:, 2] = wrap_angle(rows[:, 2] + turned)
    valid = ~np.isin(steps, unseen)
    states[0, ~valid] = np.nan
    tracks = replace(tracks, states=states, valid=valid[None])
    there = np.array(ego[contact])
    there[2] = wrap_angle(struck_at + turned)
    touch = Contact(contact, 1.0, 0, there, states[0, contact])
    return cut_in_demand(touch, tracks, ego, VEHICLE, 0, DT)


@pytest.mark.parametrize("turned", [0.0, 2.0, np.pi])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_follower_is_whoever_drives_the_same_way_within_60_degrees(
    side: float, turned: float
) -> None:
    within, beyond = side * np.deg2rad(59.0), side * np.deg2rad(61.0)
    assert demand(4.5, struck_at=within, turned=turned) == pytest.approx(asked(4.5))
    assert demand(4.5, struck_at=beyond, turned=turned) is None


@pytest.mark.parametrize("kind", list(RoadUserKind))
def test_a_follower_is_a_motor_vehicle(kind: RoadUserKind) -> None:
    motor = ("car", "truck", "bus", "motorcycle")
    assert demand(4.5, kind=kind) == (pytest.approx(5.0) if kind in motor else None)


def test_whoever_comes_from_the_side_at_the_last_step_leaves_nothing_to_be_done() -> None:
    assert demand(0.01, enters=20, velocity=20.0) == np.inf
    assert demand(0.01, enters=19, velocity=20.0) == 0.0  # As fast as the follower.


@pytest.mark.parametrize("velocity", [20.0, 25.0])
def test_an_ego_that_is_no_slower_asks_for_nothing_unless_it_is_there_already(
    velocity: float,
) -> None:
    assert demand(0.01, velocity=velocity) == 0.0
    assert demand(-0.01, velocity=velocity) == np.inf


def test_an_ego_that_enters_slantwise_is_as_slow_as_its_way_along() -> None:
    # At 45 degrees its nearest corner is sqrt(1/2) (half length + half width) before its centre:
    # there are 10.1 m between them, which the follower closes in 21 steps.
    part = np.sqrt(0.5)
    room = 10.0 + 0.5 * VEHICLE.length - part * 0.5 * (VEHICLE.length + VEHICLE.width)
    closing = 20.0 - 15.0 * part
    expected = closing**2 / (2.0 * (room - 0.4 * closing))
    struck = demand(10.0, contact=31, heading=np.pi / 4.0)
    assert struck == pytest.approx(expected)


def test_an_ego_that_enters_within_the_reaction_leaves_no_room_to_brake() -> None:
    # Closing at 5 m/s, 0.4 s take 2 m.
    assert demand(2.0 + 1e-3) == pytest.approx(asked(2.0 + 1e-3))
    assert demand(2.0 - 1e-3) == np.inf


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_ego_closer_than_20_cm_to_the_side_was_in_the_way_before(side: float) -> None:
    touching = 0.5 * (CAR_SIZE[1] + VEHICLE.width)
    assert demand(4.5, beside=side * (touching + 0.21)) == pytest.approx(5.0)
    assert demand(4.5, beside=side * (touching + 0.19)) is None


@pytest.mark.parametrize(
    ("unseen", "expected"),
    [
        ((3, 4), 5.0),  # It was there when the ego entered.
        (tuple(range(10)), None),  # When it came, the ego was in its way.
        ((14,), None),  # What it did before it was lost from sight is not looked at.
        ((19,), None),  # It was not there to react before it struck.
        (tuple(range(20)), None),
    ],
)
def test_a_follower_is_on_the_scene_from_the_entry_to_the_contact(
    unseen: tuple[int, ...], expected: float | None
) -> None:
    assert demand(4.5, unseen=unseen) == (expected and pytest.approx(expected))


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


@pytest.mark.parametrize(("aside", "imposed"), [(1.9, 3.0), (2.05, 0.0)])
def test_whoever_is_2_m_off_its_recorded_path_is_not_compared(aside: float, imposed: float) -> None:
    # Recorded places are 1 m apart: the nearest is at most 1.97 m away, or at least 2.05 m.
    scenario = straight_scenario(steady_tracks([[-20.0, 0.0, 0.0, 10.0]], steps=STEPS))
    tracks = slowed(scenario, 10, 3.0)
    states = np.array(tracks.states)
    states[0, 10:, 1] += aside
    tracks = replace(tracks, states=states)
    assert imposed_braking(scenario.tracks, tracks, 0, STEPS - 1, DT) == pytest.approx(imposed)


def test_braking_is_imposed_on_motor_vehicles_alone() -> None:
    first = [[-20.0, 0.0, 0.0, 10.0], [-20.0, LANE_WIDTH, 0.0, 10.0]]
    kinds = (RoadUserKind.BICYCLE, RoadUserKind.CAR)
    scenario = straight_scenario(steady_tracks(first, steps=STEPS, kinds=kinds))
    tracks = slowed(scenario, 10, 3.0)  # The bicycle alone.
    assert imposed_braking(scenario.tracks, tracks, 0, STEPS - 1, DT) == 0.0


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


def test_braking_of_who_comes_later_is_imposed_too() -> None:
    """Nobody is there a step after the start."""
    scenario = straight_scenario(steady_tracks([[-20.0, 0.0, 0.0, 10.0]], steps=STEPS))
    valid = np.array(scenario.tracks.valid)
    valid[:, :5] = False
    recorded = replace(scenario.tracks, valid=valid)
    braked = replace(slowed(scenario, 10, 3.0), valid=valid)
    assert imposed_braking(recorded, braked, 0, STEPS - 1, DT) == pytest.approx(3.0)
    assert imposed_braking(recorded, replace(recorded), 0, STEPS - 1, DT) == 0.0
