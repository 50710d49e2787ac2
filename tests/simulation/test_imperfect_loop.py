"""The loop as on a car: late plans, lagging actuators, and what the sensors make of the world."""

from __future__ import annotations

import gc
import math
import re
import time
from dataclasses import replace
from functools import partial
from types import FunctionType, ModuleType
from typing import Any, ClassVar

import numpy as np
import pytest
from dosplan_baseline.brake import BrakePlanner
from dosplan_baseline.cruise import CruisePlanner
from dosplan_simple.predictors import (
    ConstantVelocityPredictor,
    GroundTruthPredictor,
    NonePredictor,
)

from dosplan.api import Planner
from dosplan.scenario.synthetic import (
    LANE_WIDTH,
    busy_scenario,
    crowded_scenario,
    steady_tracks,
    straight_scenario,
)
from dosplan.simulation.actuators import Actuators
from dosplan.simulation.loop import run_episode
from dosplan.simulation.sensing import Sensors, gaps_of, gauss_markov
from dosplan.simulation.settings import (
    IDEAL,
    REALISTIC,
    ActuatorSettings,
    LoopSettings,
    SensingSettings,
    loop_name,
)
from dosplan.simulation.sight import visible
from dosplan.simulation.traffic import Replay, RoadUsers, users_at
from dosplan.simulation.world import World
from dosplan.types import (
    EGO_STEERING,
    EGO_VELOCITY,
    EGO_X,
    STEP_SECONDS,
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    Arm,
    EpisodeEnd,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    RoadUserKind,
    Scenario,
)
from dosplan.vehicle import VehicleParameters
from tests.support.sensors import leave_unfiltered
from tests.support.traffic import ShyTraffic

LATE = LoopSettings(latency=0.3)


class CountingPlanner(Planner):
    """Asks for 0.1 m/s2 more in each plan: an applied acceleration tells its plan."""

    name = "counting-v1"
    steps: ClassVar[int] = 30

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        self.shown: list[tuple[Observation, Occupancy]] = []
        self.vehicle = vehicle

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        inputs = np.tile([0.0, 0.1 * len(self.shown)], (self.steps, 1))
        self.shown.append((observation, occupancy))
        return Plan(np.repeat(observation.ego[None], self.steps + 1, axis=0), inputs)


class SlowPlanner(CountingPlanner):
    """Says that a plan took 0.15 s."""

    name = "slow-v1"
    took = 0.15

    @property
    def last_seconds(self) -> float:
        return self.took

    @last_seconds.setter
    def last_seconds(self, value: float) -> None:
        pass


def drive(
    loop: LoopSettings, scenario: Scenario | None = None, planner: Planner | None = None, **how: Any
) -> Any:
    return run_episode(
        busy_scenario() if scenario is None else scenario,
        CountingPlanner() if planner is None else planner,
        how.pop("predictor", None) or ConstantVelocityPredictor(),
        how.pop("arm", Arm.WITH_DOS),
        loop,
        **how,
    )


# Latency.


def test_a_plan_acts_late_by_the_latency_but_the_first_one() -> None:
    """Plans of steps 0, 1, 2, ... act from 0, 4, 5, ...: the first one until the second acts."""
    episode = drive(LATE, straight_scenario(final_step=10))
    np.testing.assert_allclose(
        episode.inputs[:, 1], [0.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    )
    np.testing.assert_array_equal(episode.cycle_steps, [0, 4, 5, 6, 7, 8, 9])
    np.testing.assert_array_equal(episode.sightings.steps, [0, 1, 2, 3, 4, 5, 6])


def test_period_and_latency_together() -> None:
    """Observed at 0, 2, 4, ...; acting from 0, 5, 7, 9 on."""
    episode = drive(LoopSettings(period=0.2, latency=0.3), straight_scenario(final_step=10))
    np.testing.assert_allclose(
        episode.inputs[:, 1], [0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.2, 0.2, 0.3]
    )
    np.testing.assert_array_equal(episode.cycle_steps, [0, 5, 7, 9])
    np.testing.assert_array_equal(episode.sightings.steps, [0, 2, 4, 6])


@pytest.mark.parametrize(
    "loop",
    [LATE, replace(LATE, actuators=ActuatorSettings(acceleration=0.2, steering=0.3))],
    ids=["exact", "lagging"],
)
def test_the_planner_knows_where_the_ego_will_be_when_its_plan_acts(loop: LoopSettings) -> None:
    planner = CountingPlanner()
    episode = drive(loop, planner=planner)
    for observation, _ in planner.shown:
        if observation.step < episode.start_step + len(episode.states):
            driven = episode.states[observation.step - episode.start_step]
            np.testing.assert_array_equal(observation.ego, driven)
            np.testing.assert_array_equal(observation.ego_history[-1], driven)
    later, _ = planner.shown[5]
    begin = later.step - 40
    np.testing.assert_array_equal(
        later.ego_history[-begin - 1 :], episode.states[: begin + 1], "the whole way"
    )


def test_what_is_seen_is_old_and_what_is_predicted_is_for_the_steps_after_acting() -> None:
    """The first car of the scene drives at 8 m/s from x = 30 m on."""
    planner = CountingPlanner()
    drive(LATE, planner=planner)
    first, second = planner.shown[:2]
    assert {sets.horizon for _, sets in planner.shown} == {37}
    assert (first[0].step, first[0].seen_step, first[0].delay) == (40, 40, 0)
    observation, occupancy = second
    assert (observation.step, observation.seen_step, observation.delay) == (44, 41, 3)
    seen = 30.0 + 0.8 * 41
    assert observation.states[0, -1, USER_X] == pytest.approx(seen)
    assert observation.present[0, USER_X] == pytest.approx(seen + 3 * 0.8)
    assert occupancy.horizon == ConstantVelocityPredictor().horizon - 3
    np.testing.assert_allclose(
        occupancy.centre[0, :, 0], 30.0 + 0.8 * (45 + np.arange(occupancy.horizon))
    )


def test_the_true_future_is_shifted_likewise() -> None:
    planner = CountingPlanner()
    drive(LATE, crowded_scenario(), planner, predictor=GroundTruthPredictor())
    tracks = crowded_scenario().tracks
    for observation, occupancy in planner.shown:
        rows = np.searchsorted(tracks.ids, occupancy.ids)
        truth = tracks.states[rows, observation.step + 1 : observation.step + 11, :2]
        np.testing.assert_array_equal(occupancy.centre[:, : truth.shape[1]][:, :10], truth)


def test_no_plan_is_made_that_could_not_act_any_more() -> None:
    planner = CountingPlanner()
    drive(LATE, straight_scenario(final_step=10), planner)
    assert [observation.step for observation, _ in planner.shown] == [0, 4, 5, 6, 7, 8, 9]


def test_the_ideal_loop_keeps_nothing_of_what_was_seen() -> None:
    episode = drive(IDEAL)
    assert episode.sightings is None
    assert episode.loop == "ideal"
    assert drive(LATE).loop == "ideal, latency=0.3"


# Real time.


def test_the_time_that_a_plan_takes_is_charged_as_latency() -> None:
    """0.15 s are two steps: from the second one on, plans come every two steps, two late."""
    loop = LoopSettings(real_time=True)
    episode = drive(
        loop, straight_scenario(final_step=10), SlowPlanner(), predictor=NonePredictor()
    )
    np.testing.assert_allclose(
        episode.inputs[:, 1], [0.0, 0.0, 0.0, 0.1, 0.1, 0.2, 0.2, 0.3, 0.3, 0.4]
    )
    np.testing.assert_array_equal(episode.sightings.steps, [0, 1, 3, 5, 7, 9])


def test_a_plan_that_comes_too_late_is_a_failure_of_the_planner() -> None:
    class LatestPlanner(SlowPlanner):
        took = 3.05

    episode = drive(LoopSettings(real_time=True), straight_scenario(), LatestPlanner())
    assert episode.end is EpisodeEnd.PLANNER_FAILURE
    assert re.search(r"before this one is there, which took [3-9]\.\d\d s", episode.error)


# Actuators.


@pytest.mark.parametrize("lag", [0.05, 0.2, 1.0])
def test_the_actuators_answer_a_step_as_a_first_order_lag(lag: float) -> None:
    """v(t) = v0 + a (t - T (1 - exp(-t / T))), and the steering angle likewise."""
    loop = LoopSettings(actuators=ActuatorSettings(acceleration=lag, steering=2.0 * lag))
    world = World(straight_scenario(), loop=loop)
    for _ in range(20):
        world.step(np.array([0.02, 1.5]))
    t = STEP_SECONDS * np.arange(21)
    answer = 10.0 + 1.5 * (t - lag * -np.expm1(-t / lag))
    np.testing.assert_allclose(world.driven[:, EGO_VELOCITY], answer, atol=1e-12)
    angle = 0.02 * (t - 2.0 * lag * -np.expm1(-t / (2.0 * lag)))
    np.testing.assert_allclose(world.driven[:, EGO_STEERING], angle, atol=1e-12)


def test_wheels_reach_the_largest_rate_sooner_where_more_is_asked_for_and_no_more_than_it() -> None:
    """As in Autoware's simulator, what is cut is the rate of the wheels."""
    vehicle, most = VehicleParameters(), VehicleParameters().max_steering_rate
    actuators = Actuators(ActuatorSettings(steering=0.27), vehicle, 0.1)
    ego = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    asked, more = np.array([most, 0.0]), np.array([10.0 * most, 0.0])
    assert actuators.follow(ego, asked, np.zeros(2))[0][0] < 0.3 * most
    applied, output = actuators.follow(ego, more, np.zeros(2))
    assert (applied[0], output[0]) == (most, most)
    # What could not be had is not kept: the wheels turn back at once.
    back, _ = actuators.follow(ego, -more, output)
    assert -most <= back[0] < -0.5 * most


def test_lagging_actuators_keep_to_the_vehicles_limits() -> None:
    loop = LoopSettings(actuators=ActuatorSettings(acceleration=0.5, steering=0.5))
    episode = drive(loop, straight_scenario(final_step=40), BrakePlanner())
    assert episode.states[:, EGO_VELOCITY].min() >= 0.0
    assert np.abs(episode.inputs[:, 1]).max() <= VehicleParameters().max_acceleration
    assert episode.states[-1, EGO_VELOCITY] == pytest.approx(0.0, abs=1e-9)
    assert (
        episode.states[-1, EGO_X] > drive(IDEAL, straight_scenario(), BrakePlanner()).states[-1, 0]
    )


# Noise.


def test_errors_have_the_deviation_and_the_correlation_that_are_set() -> None:
    rng = np.random.default_rng(0)
    process = gauss_markov(rng.standard_normal((400, 300, 6)), 0.1, 0.5)
    assert process.std() == pytest.approx(1.0, abs=0.01)
    np.testing.assert_allclose(process.std(axis=(0, 2)), 1.0, atol=0.06)  # From the first step on.
    for lag in (1, 5, 10):
        found = np.mean(process[:, lag:] * process[:, :-lag])
        assert found == pytest.approx(np.exp(-lag * 0.1 / 0.5), abs=0.02), lag
    assert abs(np.mean(process[..., 0] * process[..., 1])) < 0.02


def test_what_is_measured_errs_as_set(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_unfiltered(monkeypatch)
    sensing = SensingSettings(position=0.2, speed=0.3, heading=0.05, size=0.1, correlation=0.2)
    first = [[0.0, 0.0, 0.3, 5.0]] * 200
    tracks = steady_tracks(first, steps=120)
    sensors = Sensors(sensing, 0.1, 120, scenario="noise")
    sizes = []
    for step in range(120):
        sensors.look(step, np.zeros(2), users_at(tracks, step))
        sizes.append(sensors.seen(step, 1)[2] / tracks.size)
    _, _, _, states, valid = sensors.seen(119, 120)
    assert valid.all()
    errors = states - tracks.states
    wanted = [0.2, 0.2, 0.05, 0.3]
    np.testing.assert_allclose(errors.std(axis=(0, 1)), wanted, rtol=0.05)
    np.testing.assert_allclose(errors.mean(axis=(0, 1)), 0.0, atol=0.02)
    assert np.std(sizes[0]) == pytest.approx(0.1, rel=0.1)
    assert np.std(sizes[-1]) < 0.03  # Of what was measured in 12 s.
    lagged = np.mean(errors[:, 2:, 0] * errors[:, :-2, 0]) / 0.2**2
    assert lagged == pytest.approx(np.exp(-1.0), abs=0.05)


def test_what_cannot_move_has_no_speed() -> None:
    kinds = (RoadUserKind.PARKED, RoadUserKind.CAR)
    tracks = steady_tracks([[9.0, 0.0, 0.0, 0.0], [30.0, 0.0, 0.0, 0.0]], kinds=kinds, steps=5)
    sensors = Sensors(SensingSettings(speed=1.0), 0.1, 5, scenario="x")
    sensors.look(0, np.zeros(2), users_at(tracks, 0))
    speeds = sensors.seen(0, 1)[3][:, -1, USER_VELOCITY]
    assert speeds[0] == 0.0
    assert speeds[1] != 0.0


def test_scenery_is_where_it_is() -> None:
    kinds = (RoadUserKind.STATIC, RoadUserKind.PARKED)
    tracks = steady_tracks([[9.0, 0.0, 0.1, 0.0], [30.0, 0.0, 0.1, 0.0]], kinds=kinds, steps=300)
    sensing = replace(REALISTIC.sensing, dropout_rate=1.0, memory=0.0)
    sensors = Sensors(sensing, 0.1, 300, scenario="x")
    for step in range(300):
        sensors.look(step, np.zeros(2), users_at(tracks, step))
        ids, _, size, states, _ = sensors.seen(step, 1)
        assert ids[0] == 100
        np.testing.assert_array_equal(states[0, -1], tracks.states[0, step])
        np.testing.assert_array_equal(size[0], tracks.size[0])


def _errors_seen(
    scenario: Scenario, episode: Any, tracks: Any
) -> dict[tuple[int, int], FloatArray]:
    """Error of each sighting by road user and step."""
    seen = episode.sightings
    rows = {name: row for row, name in enumerate(tracks.ids.tolist())}
    return {
        (user, int(seen.steps[cycle])): state - tracks.states[rows[user], seen.steps[cycle]]
        for cycle, user, state in zip(seen.cycle, seen.ids.tolist(), seen.states, strict=True)
    }


NOISY = LoopSettings(
    latency=0.2, sensing=SensingSettings(position=0.2, speed=0.2, heading=0.05, dropout_rate=0.0)
)


def test_both_arms_and_all_planners_meet_the_same_errors_and_gaps() -> None:
    scenario = crowded_scenario()
    lossy = replace(NOISY, sensing=replace(NOISY.sensing, dropout_rate=0.5, memory=0.0))
    drives = [
        drive(lossy, scenario, planner, arm=arm)
        for planner in (CountingPlanner(), BrakePlanner(), CruisePlanner())
        for arm in Arm
    ]
    one, *others = [_errors_seen(scenario, episode, episode.tracks) for episode in drives]
    assert len(one) > 1000
    for other in others:
        common = one.keys() & other.keys()
        assert common == {key for key in one if key[1] in {k[1] for k in other}}
        for key in common:
            np.testing.assert_array_equal(one[key], other[key])


def test_another_seed_scenario_or_future_has_other_errors() -> None:
    scenario = busy_scenario()
    scenario = replace(scenario, futures=(scenario.tracks,))
    variants = [
        drive(NOISY, scenario, traffic=Replay()),
        drive(NOISY, scenario, traffic=Replay(seed=1)),
        drive(NOISY, scenario, traffic=Replay(future=1)),
        drive(NOISY, replace(scenario, id="another"), traffic=Replay()),
    ]
    errors = [_errors_seen(scenario, e, scenario.tracks)[100, 50][0] for e in variants]
    assert len(set(np.round(errors, 6))) == 4


def test_errors_do_not_depend_on_the_traffic_nor_on_who_came_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The shy traffic has its road users elsewhere, and one more from the third step on."""
    leave_unfiltered(monkeypatch)
    scenario = busy_scenario()
    one, other = drive(NOISY, scenario), drive(NOISY, scenario, traffic=ShyTraffic())
    first = _errors_seen(scenario, one, one.tracks)
    second = _errors_seen(scenario, other, other.tracks)
    assert first.keys() < second.keys()
    for key in first:
        np.testing.assert_allclose(first[key], second[key], atol=1e-9)


# Gaps.


def test_gaps_come_at_their_rate_and_last_as_long_as_set() -> None:
    lost = gaps_of(np.random.default_rng(1).random((300, 2000)), 0.1, 0.2, 0.8)
    begins = np.sum(lost[:, 1:] & ~lost[:, :-1])
    assert begins / (0.1 * np.sum(~lost)) == pytest.approx(0.2, rel=0.05)
    assert 0.1 * np.sum(lost[:, 1:]) / begins == pytest.approx(0.8, rel=0.05)
    assert np.mean(lost[:, 0]) == pytest.approx(0.16 / 1.16, abs=0.04)
    assert not gaps_of(np.random.default_rng(1).random((9, 99)), 0.1, 0.0, 0.5).any()


class Blinking(Sensors):
    """Loses everybody at given steps."""

    def hide(self, steps: slice) -> None:
        self._lost[:, steps] = True


def test_who_is_lost_is_carried_on_for_a_while_and_then_gone() -> None:
    """A car that brakes while it is not seen: the tracker has it go on as it was."""
    tracks = steady_tracks([[10.0, 2.0, 0.0, 8.0]], steps=20)
    states = np.array(tracks.states)
    states[0, 6:, USER_X] = states[0, 5, USER_X]
    states[0, 6:, USER_VELOCITY] = 0.0
    tracks = replace(tracks, states=states)
    sensors = Blinking(SensingSettings(memory=0.3, dropout_rate=0.1), 0.1, 20, scenario="x")
    seen: list[float | None] = []
    for step in range(14):
        if step == 0:
            sensors._add([100], [RoadUserKind.CAR])
            sensors._rows = {100: 0}
            sensors._lost[:] = False
            sensors.hide(slice(6, 12))
        sensors.look(step, np.zeros(2), users_at(tracks, step))
        ids, _, _, shown, _ = sensors.seen(step, 5)
        seen.append(float(shown[0, -1, USER_X]) if len(ids) else None)
    carried = [14.8, 15.6, 16.4]  # Steps 6, 7 and 8: 0.3 s at 8 m/s.
    assert seen[:6] == pytest.approx([10.0, 10.8, 11.6, 12.4, 13.2, 14.0])
    assert seen[6:9] == pytest.approx(carried)
    assert seen[9:12] == [None] * 3
    assert seen[12:] == pytest.approx([14.0, 14.0])
    np.testing.assert_array_equal(sensors.seen(13, 5)[4], [[False, False, False, True, True]])


# Range and sight.


def test_only_who_is_in_range_is_seen() -> None:
    tracks = steady_tracks([[50.0, 0.0, 0.0, 0.0], [51.5, 3.0, 0.0, 0.0]], steps=3)
    sensors = Sensors(SensingSettings(range=51.0, memory=0.0), 0.1, 3, scenario="x")
    for step, x in enumerate((0.0, 2.0, -2.0)):
        sensors.look(step, np.array([x, 0.0]), users_at(tracks, step))
    ids = [sensors.seen(step, 1)[0].tolist() for step in range(3)]
    assert ids == [[100], [100, 101], []]


def _users(*poses: tuple[float, ...], outlines: tuple[FloatArray | None, ...] = ()) -> RoadUsers:
    """Rectangles (x, y, heading, length, width)."""
    table = np.array(poses)
    return RoadUsers(
        ids=np.arange(len(table)),
        kinds=(RoadUserKind.CAR,) * len(table),
        size=table[:, 3:],
        states=np.column_stack([table[:, :3], np.zeros(len(table))]),
        outlines=outlines,
    )


def test_a_truck_hides_the_pedestrian_behind_it() -> None:
    """Truck 10 m ahead, 2.5 m wide: at 20 m, its shadow is a little over 2 x 1.25 m wide."""
    truck = (10.0, 0.0, 0.0, 8.0, 2.5)
    half = 1.25 / 6.0 * 20.0  # The rear corners at 6 m bound the shadow.
    for y, seen in ((0.0, False), (half - 0.4, False), (half + 0.4, True), (-half - 0.4, True)):
        users = _users(truck, (20.0, y, 0.0, 0.5, 0.5))
        np.testing.assert_array_equal(visible(np.zeros(2), users), [True, seen], str(y))


def test_somebody_appears_at_the_corner_of_a_building() -> None:
    """A house at x from 10 to 12 m, y from 4 m on: y > x / 3 beyond is hidden."""
    outline = np.array([[-5.0, -10.0], [-3.0, -10.0], [-3.0, 10.0], [-5.0, 10.0]])
    house = (15.0, 14.0, 0.0, 20.0, 20.0)
    hidden, half, out = (24.0, 9.0), (24.0, 8.1), (24.0, 7.0)
    for (x, y), seen in ((hidden, False), (half, True), (out, True)):
        users = _users(house, (x, y, 0.0, 0.5, 0.5), outlines=(outline, None))
        assert visible(np.zeros(2), users)[1] == seen, (x, y)


def test_whoever_stands_around_the_eye_hides_nobody() -> None:
    users = _users((0.0, 0.0, 0.2, 9.0, 9.0), (20.0, 0.0, 0.0, 4.0, 2.0))
    np.testing.assert_array_equal(visible(np.zeros(2), users), [True, True])
    assert visible(np.zeros(2), _users((0.0, 0.0, 0.0, 4.0, 2.0))).all()


def test_sight_agrees_with_a_plain_search() -> None:
    """Against shapely: seen if some ray's first body is it, ray by ray."""
    import shapely

    from dosplan.geometry import rectangle_corners

    rng = np.random.default_rng(3)
    table = np.column_stack(
        [rng.uniform(-40, 40, (25, 2)), rng.uniform(-3, 3, 25), np.tile([4.5, 1.8], (25, 1))]
    )
    table = table[np.linalg.norm(table[:, :2], axis=1) > 5.0]
    bodies = shapely.polygons(rectangle_corners(table[:, :3], table[:, 3:]))
    angles = np.arange(3600) * 2.0 * np.pi / 3600
    ends = 100.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    rays = shapely.linestrings(np.stack([np.zeros_like(ends), ends], axis=1))
    distance = np.array(
        [shapely.distance(shapely.intersection(rays, b), shapely.Point(0, 0)) for b in bodies]
    )
    first = np.nanargmin(np.where(np.isnan(distance), np.inf, distance), axis=0)
    hit = np.isfinite(np.where(np.isnan(distance), np.inf, distance)).any(axis=0)
    wanted = np.isin(np.arange(len(table)), first[hit])
    np.testing.assert_array_equal(visible(np.zeros(2), _users(*map(tuple, table))), wanted)
    assert 5 < wanted.sum() < len(table)


def test_sight_costs_little() -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack(
        [rng.uniform(-80, 80, (100, 2)), rng.uniform(-3, 3, 100), np.tile([4.5, 1.8], (100, 1))]
    )
    users = _users(*map(tuple, table))
    times = []
    for _ in range(20):
        begin = time.perf_counter()
        visible(np.zeros(2), users)
        times.append(time.perf_counter() - begin)
    assert min(times) < 0.01


def test_an_ego_does_not_see_who_is_behind_a_truck() -> None:
    """A pedestrian walks out from behind a standing truck, in a whole episode."""
    first = [[30.0, LANE_WIDTH, 0.0, 0.0], [37.0, LANE_WIDTH + 1.5, -np.pi / 2.0, 1.0]]
    kinds = (RoadUserKind.TRUCK, RoadUserKind.PEDESTRIAN)
    tracks = replace(steady_tracks(first, kinds=kinds), size=np.array([[12.0, 3.0], [0.5, 0.5]]))
    scenario = straight_scenario(tracks, velocity=2.0)
    loop = LoopSettings(sensing=SensingSettings(occlusion=True))
    seen = drive(loop, scenario).sightings
    steps = seen.steps[seen.cycle[seen.ids == 101]]
    assert steps[0] > 5
    np.testing.assert_array_equal(steps, np.arange(steps[0], 50))  # From then on always.
    assert set(seen.steps[seen.cycle[seen.ids == 100]]) == set(range(50))


# What plug-ins can reach.


def uneven_scenario() -> Scenario:
    """The busy scene, off every round number: what is equal to a true value is that value."""
    plain, rng = busy_scenario(), np.random.default_rng(11)
    tracks = plain.tracks
    off = rng.uniform(0.01, 0.09, (len(tracks.ids), 4))
    off[:, USER_VELOCITY] *= [kind.moves for kind in tracks.kinds]  # Who is parked stands.
    first = tracks.states[:, 0] + off
    size = tracks.size + rng.uniform(0.01, 0.09, tracks.size.shape)
    moved = steady_tracks(first, kinds=tracks.kinds)
    return replace(plain, tracks=replace(moved, size=size))


def reachable(start: Any) -> list[Any]:
    """All that can be got at from an object: its parts, theirs, and what arrays are views of."""
    found: dict[int, Any] = {}
    todo = [start]
    while todo:
        value = todo.pop()
        if id(value) in found or isinstance(value, type | ModuleType):
            continue
        found[id(value)] = value
        if isinstance(value, np.ndarray):
            todo.append(value.base)
            todo.extend(value.ravel().tolist() if value.dtype == object else [])
        elif isinstance(value, FunctionType):  # Not by its globals: they lead to everything.
            todo.extend([value.__closure__, value.__defaults__, value.__kwdefaults__, vars(value)])
        else:
            todo.extend(gc.get_referents(value))
    return list(found.values())


def true_values_in(start: Any, scenario: Scenario) -> set[float]:
    """The true states and sizes of road users that can be got at, in arrays or as numbers."""
    tracks = scenario.tracks
    truth = np.concatenate([tracks.states.ravel(), tracks.size.ravel()])
    known = set(np.round(truth, 9).tolist()) - {0.0}
    reached: set[float] = set()
    for value in reachable(start):
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            reached |= known & set(np.round(value.ravel(), 9).tolist())
        elif isinstance(value, float):
            reached |= known & {round(value, 9)}
    return reached


class NotingPredictor(ConstantVelocityPredictor):
    """Keeps what it is shown."""

    name = "noting-v1"

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:
        self.shown: list[Observation] = []

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        self.shown.append(observation)
        return super().compute_occupancy(observation)


def test_exact_states_and_sizes_cannot_be_reached_from_an_observation() -> None:
    """No array that it holds, and none behind those, has a true value in it.

    What a planner is shown is made of what its predictor is, for the step at which its plan acts.
    """
    scenario = uneven_scenario()
    planner, predictor = CountingPlanner(), NotingPredictor()
    drive(replace(REALISTIC, latency=0.2), scenario, planner, predictor=predictor)
    planned = [observation for observation, _ in planner.shown[5:7]]
    assert len(predictor.shown) > 7
    for observation in (*planned, *predictor.shown[5:7]):
        assert len(observation.ids) >= 3
        held = [id(value) for value in reachable(observation)]
        for part in (observation.states, observation.size, observation.task.route.path):
            assert id(part) in held
        assert true_values_in(observation, scenario) == set()


def test_the_search_for_true_values_finds_them_where_they_are_shown() -> None:
    """In the ideal loop, an observation has the past and the present of all, and their sizes."""
    scenario = uneven_scenario()
    planner = CountingPlanner()
    drive(IDEAL, scenario, planner)
    tracks = scenario.tracks
    shown = np.concatenate([tracks.states[:, 15:46].ravel(), tracks.size.ravel()])
    wanted = set(np.round(shown, 9).tolist()) - {0.0}
    found = true_values_in(planner.shown[5][0], scenario)  # Of step 45, from 30 steps before on.
    assert found == wanted
    # A view leads to all that it is cut from, wherever it is kept.
    hidden = [{"later": partial(max, tracks.size[0, 1:])}]
    assert true_values_in(hidden, scenario) == set(np.round(tracks.size.ravel(), 9).tolist())


# Settings.


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: LoopSettings(period=0.0), "period is 0.0 s, expected 0.1 or more"),
        (lambda: LoopSettings(period=0.25), "period is 0.25 s, expected a multiple of the step"),
        (lambda: LoopSettings(latency=0.05), "latency is 0.05 s, expected a multiple"),
        (lambda: LoopSettings(latency=-0.1), "latency is -0.1 s, expected 0 or more"),
        (lambda: LoopSettings(latency=math.nan), "latency is nan s, expected a multiple"),
        (lambda: SensingSettings(position=-1.0), "position is -1.0, expected 0 or more"),
        (lambda: SensingSettings(dropout_rate=11.0), "dropout_rate is 11.0 a second, expected 0"),
        (lambda: SensingSettings(dropout_duration=0.0), "dropout_duration is 0.0, expected 0.1"),
        (lambda: SensingSettings(range=0.0), "range is 0.0, expected more than 0"),
        (lambda: ActuatorSettings(steering=-1.0), "steering is -1.0, expected 0 or more"),
        (lambda: SensingSettings(position=math.nan), "position is nan, expected 0 or more"),
        (lambda: SensingSettings(speed=math.inf), "speed is inf, expected 0 or more"),
        (lambda: SensingSettings(range=math.nan), "range is nan, expected more than 0"),
        (lambda: SensingSettings(dropout_duration=math.inf), "dropout_duration is inf, expected"),
        (lambda: ActuatorSettings(steering=math.nan), "steering is nan, expected 0 or more"),
    ],
)
def test_settings_out_of_range_are_refused(make: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        make()


def test_a_loop_is_named_by_what_is_changed_of_it() -> None:
    assert loop_name(IDEAL) == "ideal"
    assert loop_name(REALISTIC) == "realistic"
    assert loop_name(LATE) == "ideal, latency=0.3"
    changed = replace(REALISTIC, sensing=replace(REALISTIC.sensing, range=None))
    assert loop_name(changed) == "realistic, sensing.range=None"


def test_headings_of_road_users_err_too() -> None:
    planner = CountingPlanner()
    drive(NOISY, planner=planner)
    headings = planner.shown[0][0].states[0, -1, USER_HEADING]
    assert headings != 0.0
