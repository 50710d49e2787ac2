"""The planners without optimisation: steering, the driver model's equilibria, whom it follows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from dosplan_baseline.brake import BrakePlanner, BrakeSettings
from dosplan_baseline.cruise import CruisePlanner
from dosplan_baseline.idm import (
    IdmEpisode,
    IdmPlanner,
    IdmSettings,
    find_leaders,
    idm_acceleration,
    set_corners,
)
from dosplan_baseline.tracking import bend_speed
from dosplan_simple.predictors import ConstantVelocityPredictor, NonePredictor
from dosplan_simple.sets import GrowingCirclePredictor, GrowingCircleSettings
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon, box

from dosplan.api import Planner
from dosplan.geometry import PathFollower, ReferencePath, extended_path
from dosplan.scenario.synthetic import (
    LANE_WIDTH,
    growing_sets,
    steady_tracks,
    straight_route,
    straight_scenario,
)
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import LoopSettings
from dosplan.simulation.world import World
from dosplan.types import (
    EGO_HEADING,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    Arm,
    FloatArray,
    GoalState,
    Occupancy,
    Scenario,
)
from dosplan.vehicle import VehicleParameters
from tests.support.factories import arc_route, occupancy_at, union_of

VEHICLE = VehicleParameters()
FRONT = VEHICLE.rear_to_centre + 0.5 * VEHICLE.length
EGO_PLACE = 20.0 + VEHICLE.rear_to_centre  # Of the straight scenario's ego on its path.


def ego(x: float, y: float, velocity: float, heading: float = 0.0) -> FloatArray:
    return np.array([x, y, 0.0, velocity, heading])


def follow(path: ReferencePath, state: FloatArray, steps: int) -> FloatArray:
    return PathFollower(path, VEHICLE, 0.1).roll_out(state, lambda step, s, v: 0.0, steps).states


def test_path_projects_and_goes_on_straight_past_its_ends() -> None:
    path = extended_path(straight_route())  # From x = -20 m to 400 m.
    points = np.array([[0.0, 1.5], [-50.0, -2.0], [450.0, 0.0]])
    s = path.locate(points)
    np.testing.assert_allclose(s, [20.0, -30.0, 470.0])
    np.testing.assert_allclose(path.offset(points, s), [1.5, -2.0, 0.0])


@given(angle=st.floats(0.2, 3.0), offset=st.floats(-5.0, 5.0))
def test_projection_on_an_arc_is_polar(angle: float, offset: float) -> None:
    radius = 30.0
    path = extended_path(arc_route(radius, length=100.0))
    away = radius - offset  # Left of a left bend is nearer to its centre.
    point = np.array([away * math.sin(angle), radius - away * math.cos(angle)])
    s = path.locate(point)
    # Chords that sag 5 mm are sqrt(8 * 30 * 0.005) = 1.1 m long: at 5 m to the side, half a
    # chord's angle shifts the nearest point by up to 5 * 1.1 / 30 / 2 = 0.09 m.
    assert float(s) == pytest.approx(radius * angle, abs=0.1)
    assert float(path.offset(point, s)) == pytest.approx(offset, abs=0.02)
    assert float(path.heading_at(s)) == pytest.approx(angle, abs=0.01)


@pytest.mark.parametrize("velocity", [3.0, 10.0, 30.0])
@pytest.mark.parametrize("start", [(1.5, 0.0), (-1.0, -0.05)])
def test_steering_returns_to_the_path_without_swinging(
    velocity: float, start: tuple[float, float]
) -> None:
    state = ego(0.0, start[0], velocity, start[1])
    states = follow(extended_path(straight_route()), state, 100)
    side = states[:, EGO_Y] * math.copysign(1.0, start[0])
    assert abs(side[-1]) < 0.02
    assert abs(states[-1, EGO_HEADING]) < 0.01
    assert side.min() > -0.15


@pytest.mark.parametrize(("radius", "velocity"), [(12.0, 5.0), (40.0, 10.0)])
def test_steering_holds_a_bend(radius: float, velocity: float) -> None:
    steering = math.atan(VEHICLE.wheelbase / radius)
    state = np.array([0.0, 0.0, steering, velocity, 0.0])
    states = follow(extended_path(arc_route(radius)), state, 60)
    from_centre = np.hypot(states[:, EGO_X], states[:, EGO_Y] - radius)
    assert np.abs(from_centre - radius).max() < 0.05


def test_speed_profile_brakes_before_the_bend() -> None:
    # A bend of 20 m at 3 m/s2 allows sqrt(60) = 7.746 m/s, and
    # 10 m before it sqrt(60 + 2 * 1.5 * 10) = 9.487 m/s.
    route = straight_route()
    curvature = np.where(route.arclength >= 100.0, 1.0 / 20.0, 0.0)
    s, velocity = bend_speed(extended_path(replace(route, curvature=curvature)), 3.0, 1.5)
    assert np.interp(100.0, s, velocity) == pytest.approx(math.sqrt(60.0))
    assert np.interp(90.0, s, velocity) == pytest.approx(math.sqrt(90.0))


def test_brake_stops_in_the_shortest_way() -> None:
    # v^2 / 2 a = 100 / 16 = 6.25 m; the discrete end adds less than v dt.
    scenario = straight_scenario(velocity=10.0)
    episode = run_episode(scenario, BrakePlanner(), NonePredictor(), Arm.WITH_DOS)
    assert episode.states[-1, EGO_X] == pytest.approx(6.25, abs=0.05)
    assert episode.states[-1, EGO_VELOCITY] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("velocity", [0.0, 10.0])
def test_cruise_keeps_its_speed_whoever_is_in_the_way(velocity: float) -> None:
    scenario = straight_scenario(steady_tracks([[20.0, 0.0, 0.0, 0.0]]), velocity=velocity)
    episode = run_episode(scenario, CruisePlanner(), ConstantVelocityPredictor(), Arm.WITH_DOS)
    np.testing.assert_allclose(episode.states[:, EGO_VELOCITY], velocity, atol=1e-9)
    assert episode.states[-1, EGO_X] == pytest.approx(5.0 * velocity)


NOBODY = np.empty(0)
IDM = IdmSettings()
SELDOM = LoopSettings(period=0.5)  # For speed: the model sees its leader in the plan.


def test_idm_has_its_free_roads_and_its_queues_equilibrium() -> None:
    assert idm_acceleration(15.0, 15.0, NOBODY, NOBODY, IDM) == 0.0
    assert idm_acceleration(0.0, 15.0, NOBODY, NOBODY, IDM) == 1.0  # a, from standstill.
    assert idm_acceleration(20.0, 15.0, NOBODY, NOBODY, IDM) < 0.0
    # Standing 2 m (the least gap) behind a standing car: 1 - (2 / 2)^2 = 0.
    assert idm_acceleration(0.0, 15.0, np.array([2.0]), np.zeros(1), IDM) == pytest.approx(0.0)
    # At 10 m/s behind as fast a leader the gap is (s0 + v T) / sqrt(1 - (v / v0)^4).
    gap = np.array([12.0 / math.sqrt(1.0 - (10.0 / 15.0) ** 4)])
    assert idm_acceleration(10.0, 15.0, gap, np.array([10.0]), IDM) == pytest.approx(0.0, abs=1e-9)


@given(
    velocity=st.floats(0.0, 40.0),
    gap=st.floats(-5.0, 100.0),
    leader=st.floats(-10.0, 40.0),
    more=st.floats(0.0, 20.0),
)
def test_idm_is_bounded_and_brakes_no_less_for_less_room(
    velocity: float, gap: float, leader: float, more: float
) -> None:
    near = idm_acceleration(velocity, 15.0, np.array([gap]), np.array([leader]), IDM)
    far = idm_acceleration(velocity, 15.0, np.array([gap + more]), np.array([leader]), IDM)
    assert -IDM.full_braking <= near <= far <= 1.0


def leaders_of(scenario: Scenario, occupancy: Occupancy | None = None) -> tuple[float, float]:
    """Gap and velocity of the nearest leader; NaN without one."""
    seen = World(scenario, first_step=0, history=5).observation()
    sets = ConstantVelocityPredictor().predict(seen) if occupancy is None else occupancy
    path = extended_path(scenario.task.route)
    ego = float(path.locate(VEHICLE.centre(seen.ego)))
    found = find_leaders(path, ego, seen, sets, VEHICLE, IDM)
    if not len(found.rear):
        return math.nan, math.nan
    nearest = int(np.argmin(found.rear))
    return float(found.rear[nearest] - 20.0 - FRONT), float(found.velocity[nearest])


def test_leader_is_the_nearest_car_ahead_on_the_path() -> None:
    cars = [[30.0, 0.0, 0.0, 8.0], [60.0, 0.0, 0.0, 3.0], [-15.0, 0.0, 0.0, 20.0]]
    gap, velocity = leaders_of(straight_scenario(steady_tracks(cars)))
    assert gap == pytest.approx(30.0 - 2.25 - FRONT)
    assert velocity == pytest.approx(8.0)


@pytest.mark.parametrize(("y", "blocks"), [(LANE_WIDTH, False), (1.95, False), (1.85, True)])
def test_only_what_reaches_into_the_corridor_is_a_leader(y: float, blocks: bool) -> None:
    # Half widths 0.805 and 0.9 m and the margin of 0.2 m: the limit is y = 1.905 m.
    gap, _ = leaders_of(straight_scenario(steady_tracks([[30.0, y, 0.0, 8.0]])))
    assert math.isfinite(gap) == blocks


def test_who_cuts_in_within_the_time_gap_is_a_leader() -> None:
    # Moving right at 2 m/s: y falls from 3 to 1 m within a second; at 0.5 m/s only to 2.5 m.
    for sideways, blocks in ((-2.0, True), (-0.5, False)):
        car = [30.0, 3.0, math.atan2(sideways, 8.0), math.hypot(8.0, sideways)]
        gap, _ = leaders_of(straight_scenario(steady_tracks([car])))
        assert math.isfinite(gap) == blocks


def test_a_component_of_a_union_that_cuts_in_is_a_leader() -> None:
    scenario = straight_scenario(steady_tracks([[30.0, 3.5, 0.0, 8.0]]))
    seen = World(scenario, first_step=0, history=5).observation()
    stays = ConstantVelocityPredictor().predict(seen)
    aside = np.minimum(0.25 * np.arange(1, stays.horizon + 1), 3.5)
    cuts_in, leaves = (
        replace(stays, centre=stays.centre + side * np.stack([0.0 * aside, aside], axis=-1))
        for side in (-1.0, 1.0)
    )
    gap, velocity = leaders_of(scenario, union_of([0.9, 0.1], stays, cuts_in))
    assert gap == pytest.approx(30.0 - 2.25 - FRONT)
    assert velocity == pytest.approx(8.0)
    assert math.isnan(leaders_of(scenario, union_of([0.9, 0.1], stays, leaves))[0])


def test_sets_widen_what_blocks() -> None:
    scenario = straight_scenario(steady_tracks([[30.0, 2.5, 0.0, 8.0]]))
    seen = World(scenario, first_step=0, history=5).observation()
    grown = GrowingCirclePredictor(settings=GrowingCircleSettings(z=1.0)).predict(seen)
    gap, velocity = leaders_of(scenario, grown)
    assert math.isnan(leaders_of(scenario, grown.without_sets())[0])
    # In the corridor from a radius of 0.6 m on; after 1 s the set reaches 1 m to the rear.
    assert gap == pytest.approx(30.0 - 2.25 - 1.0 - FRONT)
    assert velocity == pytest.approx(8.0)


@settings(deadline=None)
@given(heading=st.floats(-4.0, 4.0), angle=st.floats(-4.0, 4.0), seed=st.integers(0, 99))
def test_set_corners_hold_the_footprint_anywhere_in_the_set(
    heading: float, angle: float, seed: int
) -> None:
    sets = occupancy_at(np.array([[3.0, -2.0]]), 1)
    sets = replace(
        sets,
        semi_axes=np.array([[[2.0, 0.5]]]),
        angle=np.array([[angle]]),
        heading=np.array([[heading]]),
    )
    corners = set_corners(sets, 1)[0, 0]
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, 2.0 * np.pi, 200)
    edge = np.stack([2.0 * np.cos(turn), 0.5 * np.sin(turn)], axis=-1)
    cos, sin = math.cos(angle), math.sin(angle)
    edge = edge @ np.array([[cos, sin], [-sin, cos]])  # To the world.
    cos, sin = math.cos(heading), math.sin(heading)
    body = np.array([[cos, -sin], [sin, cos]])  # From the world to the body frame.
    reach = np.abs(edge @ body).max(axis=0) + 0.5 * sets.footprint[0]
    limit = np.abs((corners - sets.centre[0, 0]) @ body).max(axis=0)
    assert np.all(reach <= limit + 1e-9)
    assert np.all(reach >= limit - 0.02)  # And it is no larger than it must be.


def test_idm_stops_behind_a_standing_car() -> None:
    scenario = straight_scenario(steady_tracks([[60.0, 0.0, 0.0, 0.0]], steps=301), final_step=300)
    episode = run_episode(scenario, IdmPlanner(), ConstantVelocityPredictor(), Arm.WITH_DOS, SELDOM)
    gap = 60.0 - 2.25 - FRONT - episode.states[:, EGO_X]
    assert gap.min() == pytest.approx(2.0, abs=0.5)
    assert episode.states[-1, EGO_VELOCITY] < 0.2
    assert np.diff(episode.states[:, EGO_VELOCITY]).min() / 0.1 > -4.0


def test_idm_keeps_its_distance_to_a_slower_car() -> None:
    scenario = straight_scenario(steady_tracks([[40.0, 0.0, 0.0, 6.0]], steps=401), final_step=400)
    episode = run_episode(scenario, IdmPlanner(), ConstantVelocityPredictor(), Arm.WITH_DOS, SELDOM)
    gap = 40.0 + 6.0 * 40.0 - 2.25 - FRONT - episode.states[-1, EGO_X]
    assert episode.states[-1, EGO_VELOCITY] == pytest.approx(6.0, abs=0.1)
    assert gap == pytest.approx(8.0 / math.sqrt(1.0 - 0.6**4), abs=0.3)


@pytest.mark.parametrize(
    ("region", "velocity", "expected"),
    [
        (None, None, 10.0),  # Nothing asks for a change.
        (box(-20.0, -2.0, 300.0, 2.0), None, 10.0),  # The way at 10 m/s ends in it anyway.
        (box(80.0, -2.0, 100.0, 2.0), None, (82.0 - 1.4227) / 5.0),  # Further on.
        (box(10.0, -2.0, 20.0, 2.0), None, (18.0 - 1.4227) / 5.0),  # Nearer.
        (None, (12.0, 14.0), 12.0),
    ],
)
def test_idm_desires_the_speed_that_the_goal_asks_for(
    region: Polygon | None, velocity: tuple[float, float] | None, expected: float
) -> None:
    goal = GoalState(first_step=50, last_step=50, region=region, velocity=velocity)
    scenario = straight_scenario(goals=[goal])
    found = IdmEpisode(IDM, scenario.task, VEHICLE).desired_velocity(0, EGO_PLACE)
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("velocity", [10.0, 18.0])
def test_idm_is_slow_enough_when_a_bend_begins(velocity: float) -> None:
    radius, spacing = 15.0, 0.5
    s = np.arange(0.0, 300.0, spacing)
    curvature = np.where((s > 100.0) & (s < 100.0 + 0.5 * np.pi * radius), 1.0 / radius, 0.0)
    heading = np.append(0.0, np.cumsum(0.5 * spacing * (curvature[1:] + curvature[:-1])))
    middle = 0.5 * (heading[1:] + heading[:-1])
    steps = spacing * np.stack([np.cos(middle), np.sin(middle)], axis=1)
    points = np.array([-20.0, 0.0]) + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    straight = straight_scenario(velocity=velocity, final_step=120)
    wide = np.full(len(s), 5.0)
    route = replace(
        straight.task.route,
        arclength=s,
        path=points,
        heading=heading,
        curvature=curvature,
        left=wide,
        right=-wide,
        outer_left=wide,
        outer_right=-wide,
        speed_limit=np.full(len(s), np.inf),
    )
    everywhere = box(-500.0, -500.0, 500.0, 500.0)
    task = replace(straight.task, route=route, goals=(GoalState(120, 120, everywhere),))
    road_map = replace(straight.road_map, drivable=everywhere)
    drive = run_episode(
        replace(straight, task=task, road_map=road_map), IdmPlanner(), NonePredictor(), Arm.WITH_DOS
    )
    lateral = drive.states[:, EGO_VELOCITY] ** 2 * np.tan(drive.states[:, 2]) / VEHICLE.wheelbase
    assert 2.0 < np.abs(lateral).max() < 1.2 * IDM.lateral_acceleration


def test_idm_is_within_a_lower_limit_where_that_begins() -> None:
    scenario = straight_scenario(velocity=13.0, final_step=100)
    x = scenario.task.route.path[:, 0]
    route = replace(scenario.task.route, speed_limit=np.where(x < 80.0, 13.9, 8.3))
    scenario = replace(scenario, task=replace(scenario.task, route=route))
    drive = run_episode(scenario, IdmPlanner(), NonePredictor(), Arm.WITH_DOS)
    centre = VEHICLE.centre(drive.states)[:, 0]
    assert drive.states[centre >= 80.0, EGO_VELOCITY].max() < 8.3 + 0.05
    assert drive.states[centre < 60.0, EGO_VELOCITY].min() > 8.5
    assert np.diff(drive.states[:, EGO_VELOCITY]).min() > -0.1 * (IDM.deceleration + 0.1)


def test_idm_goes_to_the_goal_that_it_can_reach() -> None:
    far, near = (
        GoalState(0, 50, box(280.0, -2.0, 290.0, 2.0)),
        GoalState(0, 50, box(15.0, -2.0, 25.0, 2.0)),
    )
    aside = GoalState(0, 50, box(15.0, 60.0, 25.0, 70.0))
    for goals in ([far, near], [near, far], [aside, near]):
        scenario = straight_scenario(goals=goals)
        episode = IdmEpisode(IDM, scenario.task, VEHICLE)
        needed = episode.needed_velocity(0, EGO_PLACE)
        assert needed == pytest.approx((17.0 - 1.4227) / 5.0, abs=1e-3)


def test_idm_takes_any_exponent_at_a_stop() -> None:
    # Rounding leaves a little below zero when the vehicle has braked to a stop.
    found = idm_acceleration(-1e-16, 10.0, np.zeros(0), np.zeros(0), IdmSettings(exponent=3.5))
    assert found == pytest.approx(IDM.acceleration)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_numbers_that_are_none_are_refused(value: float) -> None:
    for make in (
        lambda: IdmSettings(time_gap=value),
        lambda: IdmSettings(acceleration=value),
        lambda: BrakeSettings(deceleration=value),
    ):
        with pytest.raises(ValueError, match="and finite"):
            make()


@pytest.mark.parametrize("planner", [IdmPlanner(), BrakePlanner(), CruisePlanner()])
def test_plans_are_what_the_vehicle_drives(planner: Planner) -> None:
    scenario = straight_scenario(steady_tracks([[25.0, 0.0, 0.0, 5.0]]))
    planner.reset(scenario.task, scenario.road_map, VEHICLE)
    seen = World(scenario, first_step=0, history=5).observation()
    plan = planner.plan(seen, growing_sets(seen))
    assert plan.inputs.shape == (30, 2)
    np.testing.assert_array_equal(plan.states[0], seen.ego)
    for state, u, after in zip(plan.states[:-1], plan.inputs, plan.states[1:], strict=True):
        np.testing.assert_allclose(VEHICLE.clip_input(state, u, 0.1), u, atol=1e-9)
        np.testing.assert_allclose(VEHICLE.step(state, u, 0.1), after, atol=1e-12)
