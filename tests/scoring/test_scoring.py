"""Scores of small scenes: metrics with known values, and what a row always satisfies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.scoring import score as scoring
from dosplan.scoring.score import failed_score, min_time_to_collision
from dosplan.simulation.traffic import Replay
from dosplan.types import (
    Arm,
    CollisionClass,
    Episode,
    EpisodeEnd,
    EpisodeKey,
    FloatArray,
    Occupancy,
    Outcome,
    Plan,
    Scenario,
    Score,
    SolveReport,
)
from dosplan.vehicle import VehicleParameters
from tests.support.traffic import ShyTraffic, braking_before, followed

VEHICLE = VehicleParameters()
DT = 0.1


def drive(inputs: FloatArray, velocity: float = 10.0) -> FloatArray:
    """(K + 1, 5) states of an ego whose rear axle starts in the origin."""
    states = [np.array([0.0, 0.0, 0.0, velocity, 0.0])]
    for u in inputs:
        states.append(VEHICLE.step(states[-1], u, DT))
    return np.array(states)


def episode(
    inputs: FloatArray, end: EpisodeEnd = EpisodeEnd.TIME_OVER, velocity: float = 10.0
) -> Episode:
    return Episode(
        scenario_id="straight",
        arm=Arm.WITHOUT_DOS,
        start_step=0,
        states=drive(inputs, velocity),
        inputs=inputs,
        tracks=steady_tracks(),
        end=end,
        predict_seconds=np.zeros(0),
        plan_seconds=np.zeros(0),
        plans=(),
        occupancies=(),
        cycle_steps=np.zeros(0, dtype=np.int64),
    )


def score(scenario: Scenario, driven: Episode) -> Score:
    """Scores a drive among the scenario's road users."""
    return scoring.score(scenario, replace(driven, tracks=scenario.tracks))


def holding(steps: int, acceleration: float = 0.0) -> FloatArray:
    return np.tile([0.0, acceleration], (steps, 1))


def plan(fallback: str | None = None) -> Plan:
    return Plan(np.zeros((2, 5)), np.zeros((1, 2)), SolveReport(fallback=fallback))


NOBODY = Occupancy(
    ids=np.zeros(0, dtype=np.int64),
    centre=np.zeros((0, 1, 2)),
    semi_axes=np.zeros((0, 1, 2)),
    angle=np.zeros((0, 1)),
    valid=np.zeros((0, 1), dtype=np.bool_),
    footprint=np.zeros((0, 2)),
    heading=np.zeros((0, 1)),
)


def test_a_clean_drive() -> None:
    row = score(straight_scenario(), episode(holding(50, 1.0)))
    # 10 t + t^2 / 2 after 5 s are 62.5 m, so 12.5 m/s on average.
    assert row.outcome is Outcome.SUCCESS
    assert row.goal_step == 50
    assert row.velocity == pytest.approx(12.5)
    assert row.progress == pytest.approx(62.5)
    assert row.max_abs_acceleration == pytest.approx(1.0)
    assert row.arm is Arm.WITHOUT_DOS
    assert row.scenario == "straight"


def test_metrics_end_with_the_first_contact() -> None:
    # A parked car 30 m ahead (centre to centre): front to rear 30 - 2.254 - 2.25 = 25.496 m, which
    # at 10 m/s is 2.55 s. The full braking afterwards is not driven any more.
    x = VEHICLE.rear_to_centre + 30.0
    scenario = straight_scenario(steady_tracks([[x, 0.0, 0.0, 0.0]]))
    row = score(scenario, episode(np.concatenate([holding(26), holding(10, -9.0)])))
    assert row.outcome is Outcome.COLLISION
    assert row.collision_class is CollisionClass.STOPPED_TRACK
    assert row.collision_with == 100
    assert row.collision_step == 26
    assert row.steps == 26
    assert row.velocity == pytest.approx(10.0)
    assert row.progress == pytest.approx(26.0)
    assert row.comfortable
    assert row.at_fault
    assert not row.safe


def test_the_tasks_own_vehicle_is_scored() -> None:
    # Its front is 20.5 m ahead of the start's rear axle after 20 steps; a van's is 1 m further.
    ahead = VEHICLE.rear_to_centre + 0.5 * VEHICLE.length + 20.5 + 2.25
    scenario = straight_scenario(steady_tracks([[ahead, 0.0, 0.0, 0.0]]))
    van = replace(VEHICLE, length=VEHICLE.length + 2.0)
    assert score(scenario, episode(holding(20))).collision_step is None
    scenario = replace(scenario, task=replace(scenario.task, vehicle=van))
    assert score(scenario, episode(holding(20))).collision_step == 20


def test_the_road_users_of_the_episode_are_scored_and_not_those_of_the_recording() -> None:
    scenario = followed()
    replayed = scoring.score(scenario, braking_before(Replay()))
    assert (replayed.outcome, replayed.collision_with) == (Outcome.COLLISION, 100)
    assert replayed.traffic == "replay"
    shy = scoring.score(scenario, braking_before(ShyTraffic()))
    assert (shy.outcome, shy.collision_step) == (Outcome.SUCCESS, None)
    assert shy.traffic == "shy-v1"


def test_a_collision_that_the_ego_is_to_blame_for_is_reported_before_an_earlier_one() -> None:
    # Both touch on the way to step 1. A car at 30 m/s from behind (2 m per step relative, gap
    # 0.2 m: at a tenth of the step), and one that stands ahead (1 m per step, gap 0.8 m).
    centre = VEHICLE.rear_to_centre
    reach = 2.254 + 2.25
    rear = [centre - reach - 0.2, 0.0, 0.0, 30.0]
    ahead = [centre + reach + 0.8, 0.0, 0.0, 0.0]
    both = score(straight_scenario(steady_tracks([rear, ahead])), episode(holding(9)))
    assert (both.collision_with, both.collision_class) == (101, CollisionClass.STOPPED_TRACK)
    assert both.at_fault
    # With one that drives off ahead, only the rear one is left, and it is not to blame.
    alone = score(straight_scenario(steady_tracks([rear])), episode(holding(9)))
    assert (alone.collision_with, alone.collision_class) == (100, CollisionClass.ACTIVE_REAR)
    assert not alone.at_fault
    assert alone.collision_step == both.collision_step == 1


def test_the_earliest_is_reported_where_nobody_is_to_blame() -> None:
    # Two motorcycles' worth of cars from behind: gaps of 1.5 and 0.5 m at 2 m per step.
    back = VEHICLE.rear_to_centre - 2.254 - 2.25
    rear = [[back - 1.5, 0.9, 0.0, 30.0], [back - 0.5, -0.9, 0.0, 30.0]]
    row = score(straight_scenario(steady_tracks(rear)), episode(holding(9)))
    assert row.collision_with == 101
    assert not row.at_fault


def test_cycle_times_and_fallbacks() -> None:
    drive_ = replace(
        episode(holding(50)),
        predict_seconds=np.array([0.010, 0.020, 0.030]),
        plan_seconds=np.array([0.010, 0.010, 0.070]),
        plans=(plan(), plan("brake"), plan("previous")),
        occupancies=(NOBODY,) * 3,
        cycle_steps=np.arange(3),
    )
    row = score(straight_scenario(), drive_)
    # Cycles of 20, 30 and 100 ms; the 99th percentile is 0.98 of the way from 30 to 100.
    assert row.cycle_ms_p50 == pytest.approx(30.0)
    assert row.cycle_ms_p99 == pytest.approx(98.6)
    assert row.fallback_cycles == 2
    empty = score(straight_scenario(), episode(holding(50)))
    assert empty.cycle_ms_p50 is None
    assert empty.cycle_ms_p99 is None


def test_cycles_after_a_contact_and_what_failed_then_are_not_of_the_drive() -> None:
    # As above, the contact is on the way to step 26: cycles 0 to 25 led to it.
    x = VEHICLE.rear_to_centre + 30.0
    late = np.where(np.arange(30) < 26, 0.010, 5.0)
    drive_ = replace(
        episode(holding(30), EpisodeEnd.PLANNER_FAILURE),
        predict_seconds=np.zeros(30),
        plan_seconds=late,
        plans=(plan("previous"), *(plan() for _ in range(25)), *(plan("brake") for _ in range(4))),
        occupancies=(NOBODY,) * 30,
        cycle_steps=np.arange(30),
        error="planner x: ValueError",
    )
    hit = score(straight_scenario(steady_tracks([[x, 0.0, 0.0, 0.0]])), drive_)
    assert hit.collision_step == 26
    assert (hit.fallback_cycles, hit.error) == (1, None)
    assert hit.cycle_ms_p99 == pytest.approx(10.0)
    free = score(straight_scenario(), drive_)
    assert (free.fallback_cycles, free.error) == (5, "planner x: ValueError")
    assert free.cycle_ms_p99 == pytest.approx(5000.0)


def test_an_error_is_kept() -> None:
    failed = replace(episode(holding(5), EpisodeEnd.PLANNER_FAILURE), error="no plan")
    row = score(straight_scenario(), failed)
    assert row.outcome is Outcome.PLANNER_FAILURE
    assert row.error == "no plan"
    assert row.steps == 5


def test_the_row_of_an_episode_that_never_was() -> None:
    row = failed_score(EpisodeKey("DEU_A-1", Arm.WITH_DOS), "cannot be read")
    assert (row.scenario, row.arm, row.error) == ("DEU_A-1", Arm.WITH_DOS, "cannot be read")
    assert row.outcome is Outcome.PLANNER_FAILURE
    assert (row.steps, row.velocity) == (0, 0.0)
    # The same as an episode whose planner failed before the first step.
    at_once = score(
        straight_scenario(),
        replace(episode(holding(0), EpisodeEnd.PLANNER_FAILURE), error="x"),
    )
    assert replace(at_once, error="cannot be read", scenario="DEU_A-1", arm=Arm.WITH_DOS) == row


@pytest.mark.parametrize(
    ("ahead", "seconds"),
    [
        # 10 m/s towards a standing car: gap / 10 s, at step 0 alone.
        (12.0, 1.2),
        (29.9, 2.99),
        (30.1, None),
        (-12.0, None),
    ],
)
def test_time_to_collision_with_a_standing_car(ahead: float, seconds: float | None) -> None:
    reach = np.sign(ahead) * (2.254 + 2.25) + ahead
    ego = np.array([[0.0, 0.0, 0.0, 10.0]])
    tracks = steady_tracks([[reach, 0.0, 0.0, 0.0]])
    found = min_time_to_collision(ego, VEHICLE, tracks, 0)
    assert found == (seconds if seconds is None else pytest.approx(seconds))


def test_time_to_collision_is_of_closing_speeds() -> None:
    ego = np.array([[0.0, 0.0, 0.0, 10.0]])

    def to(*user: float) -> float | None:
        return min_time_to_collision(ego, VEHICLE, steady_tracks([list(user)]), 0)

    gap = 2.254 + 2.25 + 20.0
    assert to(gap, 0.0, np.pi, 10.0) == pytest.approx(1.0)
    assert to(gap, 0.0, 0.0, 2.0) == pytest.approx(2.5)
    assert to(gap, 0.0, 0.0, 10.0) is None
    assert to(gap, 3.5, np.pi, 10.0) is None
    # Crossing from the right at 5 m/s, its front 5 m below the ego's side: there after 1 s, when
    # the ego, 10 m further, covers x = 7.746 .. 12.254; from x = 13.2 - 0.9 on it is in time.
    below = -0.805 - 2.25 - 5.0
    assert to(10.0, below, np.pi / 2, 5.0) == pytest.approx(1.0)
    # Behind a faster car it is the other's concern; standing, everyone's but the ego's.
    assert to(-gap, 0.0, 0.0, 30.0) is None
    still = np.array([[0.0, 0.0, 0.0, 0.05]])
    assert (
        min_time_to_collision(still, VEHICLE, steady_tracks([[gap, 0.0, np.pi, 20.0]]), 0) is None
    )


def test_time_to_collision_is_the_smallest_of_the_drive_and_of_who_is_there() -> None:
    ego = np.array([[x, 0.0, 0.0, 10.0] for x in (0.0, 1.0, 2.0)])
    tracks = steady_tracks([[2.254 + 2.25 + 20.0, 0.0, 0.0, 0.0]], steps=2)
    # 20 m, then 19 m; at the third step the recording is over.
    assert min_time_to_collision(ego, VEHICLE, tracks, 0) == pytest.approx(1.9)
    assert min_time_to_collision(ego, VEHICLE, tracks, 5) is None
    assert min_time_to_collision(ego, VEHICLE, steady_tracks(), 0) is None


@given(
    acceleration=st.floats(-6.0, 4.0),
    rate=st.floats(-0.1, 0.1),
    users=st.lists(
        st.tuples(
            st.floats(-20.0, 60.0), st.floats(-4.0, 6.0), st.floats(-3.0, 3.0), st.floats(0.0, 20.0)
        ),
        max_size=3,
    ),
    end=st.sampled_from(EpisodeEnd),
)
@settings(max_examples=60, deadline=None)
def test_what_every_row_satisfies(
    acceleration: float,
    rate: float,
    users: list[tuple[float, float, float, float]],
    end: EpisodeEnd,
) -> None:
    scenario = straight_scenario(steady_tracks(users))
    inputs = np.tile([rate, 0.0], (30, 1))
    inputs[:, 1] = np.maximum(acceleration, -3.0)
    driven = episode(inputs, end)
    before = driven.states.copy()
    row = score(scenario, driven)
    assert np.array_equal(before, driven.states)
    assert row == score(scenario, driven)
    assert row.safe == (row.outcome in (Outcome.SUCCESS, Outcome.GOAL_MISSED))
    assert (row.outcome is Outcome.COLLISION) == (row.collision_step is not None)
    assert (row.collision_class is None) == (row.collision_step is None)
    assert (row.collision_with is None) == (row.collision_step is None)
    assert not row.at_fault or row.outcome is Outcome.COLLISION
    assert row.outcome is not Outcome.SUCCESS or row.goal_step is not None
    for step in (row.collision_step, row.out_of_bounds_step, row.goal_step):
        assert step is None or 0 <= step <= row.steps
    assert 0 <= row.steps <= 30
    assert np.isfinite([row.velocity, row.progress, row.max_abs_jerk]).all()
