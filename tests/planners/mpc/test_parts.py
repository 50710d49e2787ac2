"""The parts of the optimisation planner: sets, path, goals, sampler, optimal control problem."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import shapely
from dosplan_mpc.arrival import Arrivals
from dosplan_mpc.config import MpcConfig, SamplerSettings, SetSettings, SpeedSettings
from dosplan_mpc.goal_window import GoalWindow, locate_goal
from dosplan_mpc.nlp import Guess, MpcProblem, Solution, problem, stage_steps
from dosplan_mpc.obstacles import (
    ForbiddenSets,
    forbidden_sets,
    release,
    stretch_back,
    superellipse_axes,
)
from dosplan_mpc.reference import PATH_LEFT, EgoOnPath, LanePath
from dosplan_mpc.road import Road
from dosplan_mpc.sampler import Sampler
from dosplan_mpc.shape import disc_offsets
from dosplan_mpc.speed_profile import (
    LegalSpeed,
    SpeedLimit,
    SpeedPlanner,
    SpeedProfile,
    curve_speed,
)
from dosplan_mpc.stage import StageParameters, stage_size, unpack_stage
from dosplan_mpc.traffic import Lane, Traffic
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Point, Polygon, box

from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, EvenPath, rectangle_corners
from dosplan.scenario.synthetic import steady_tracks, straight_route, straight_scenario
from dosplan.simulation.world import World
from dosplan.types import (
    FloatArray,
    GoalState,
    Occupancy,
    PlanningTask,
    RoadMap,
    Route,
    SolveStatus,
)
from dosplan.vehicle import VehicleParameters
from tests.planners.mpc.roads import straight_stages

VEHICLE = VehicleParameters()
DT = 0.1
CONFIG = MpcConfig()
HORIZON = CONFIG.horizon
PENALTY = np.full(HORIZON, 200.0)
FREE = Traffic(cruise=10.0, pressed=False, followers=np.zeros(0, dtype=np.bool_))


def path_of(route: Route) -> EvenPath:
    """The reference path of a route."""
    return LanePath(route, CONFIG.path)


def goals_of(
    task: PlanningTask, path: EvenPath, farthest: float = np.inf
) -> tuple[GoalWindow, ...]:
    found = (locate_goal(goal, path, CONFIG.goal, farthest) for goal in task.goals)
    return tuple(window for window in found if isinstance(window, GoalWindow))


def at(position: float, velocity: float, step: int = 0) -> EgoOnPath:
    """The ego on its path, with its centre at an arc length."""
    return EgoOnPath(step, position - VEHICLE.rear_to_centre, 0.0, position, velocity)


def speed_planner(
    path: EvenPath, *windows: GoalWindow, limit: float = np.inf, config: MpcConfig = CONFIG
) -> SpeedPlanner:
    """With a speed limit all along."""
    legal = LegalSpeed(np.zeros(1), np.full(1, min(limit, 100.0)))
    return SpeedPlanner(config, VEHICLE, path, windows, legal, DT)


def planned(planner: SpeedPlanner, ego: EgoOnPath, traffic: Traffic) -> SpeedProfile:
    """The reference for the next goal."""
    return planner.plan(ego, traffic, planner.next_goal(ego))[0]


def road_along(path: EvenPath) -> Road:
    """A road of 5 m to both sides of the path along +x."""
    low, high = path.points.min(axis=0) - 5.0, path.points.max(axis=0) + 5.0
    half = VEHICLE.width / 2.0 + CONFIG.road_margin
    return Road(RoadMap((), box(*low, *high)), path, VEHICLE, half, Polygon())


def free_profile(path: EvenPath) -> SpeedProfile:
    """The reference of an ego that drives at 10 m/s and meets nobody."""
    return planned(speed_planner(path), at(20.0, 10.0), FREE)


def the_set(occupancy: Occupancy, radius: float, penalty: FloatArray = PENALTY) -> ForbiddenSets:
    """The forbidden set of the first road user."""
    return forbidden_sets(occupancy, radius, np.array([0]), penalty, len(penalty))


def circle_route(radius: float, turn: float = np.pi) -> Route:
    """An arc to the left that begins in the origin along +x, four metres free on both sides."""
    s = np.arange(0.0, radius * turn, 0.5)
    angle = s / radius
    path = np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle))], axis=1)
    ones = np.ones_like(s)
    return Route(
        lanelet_ids=(1,),
        arclength=s,
        path=path,
        heading=angle,
        curvature=ones / radius,
        left=4.0 * ones,
        right=-4.0 * ones,
        outer_left=4.0 * ones,
        outer_right=-4.0 * ones,
        speed_limit=np.inf * ones,
    )


# Sets


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_discs_cover_the_ego(count: int) -> None:
    offsets, radius = disc_offsets(VEHICLE, count)
    state = VEHICLE.state_at(np.zeros(2), 0.0, 0.0)
    centres = np.stack([state[0] + offsets, np.full(count, state[1])], axis=1)
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 61), np.linspace(-0.5, 0.5, 41)), axis=-1)
    points = grid.reshape(-1, 2) * VEHICLE.size
    away = np.linalg.norm(points[:, None] - centres, axis=-1).min(axis=1)
    assert away.max() <= radius + 1e-9
    # The corners are the farthest points: a smaller radius would leave them out.
    assert away.max() == pytest.approx(radius)


@settings(max_examples=60, deadline=None)
@given(
    length=st.floats(0.3, 18.0),
    width=st.floats(0.3, 3.0),
    a=st.floats(0.0, 12.0),
    b=st.floats(0.0, 4.0),
    turn=st.floats(-np.pi, np.pi),
    radius=st.floats(0.2, 1.5),
    seed=st.integers(0, 2**31),
)
def test_superellipse_holds_the_minkowski_sum(
    length: float, width: float, a: float, b: float, turn: float, radius: float, seed: int
) -> None:
    """Points of rectangle + ellipse + disc, drawn on their edges, are never outside."""
    axes = superellipse_axes(np.array([length, width]), np.array([a, b]), np.array(turn), radius)
    rng = np.random.default_rng(seed)
    n = 4000
    corners = rectangle_corners(np.zeros(3), (length, width))
    t = rng.uniform(0.0, 2.0 * np.pi, (2, n))
    ellipse = np.stack([a * np.cos(t[0]), b * np.sin(t[0])], axis=1)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    disc = radius * np.stack([np.cos(t[1]), np.sin(t[1])], axis=1)
    points = corners[rng.integers(0, 4, n)] + ellipse @ rotation.T + disc
    assert (((points / axes) ** 4).sum(axis=1)).max() <= 1.0
    # Nor does it give lanes away: each half extent is at most 19 % (2^(1/4)) above the sum's.
    extent = np.array([length, width]) / 2.0 + np.hypot(*(np.diag([a, b]) @ rotation.T)) + radius
    assert np.all(axes <= extent * 2**0.25 * 1.006)


def occupancy_at(x: float, y: float, heading: float = 0.0, semi: float = 0.0) -> Occupancy:
    """A car that stands still, predicted for 40 steps."""
    ones = np.ones((1, 40))
    return Occupancy(
        ids=np.array([7]),
        centre=np.tile([x, y], (1, 40, 1)),
        semi_axes=semi * np.ones((1, 40, 2)),
        angle=0.3 * ones,
        valid=ones > 0,
        footprint=np.array([[4.5, 1.8]]),
        heading=heading * ones,
    )


def test_forbidden_set_follows_heading_and_grows_with_the_set() -> None:
    across = the_set(occupancy_at(10.0, 0.0, np.pi / 2), 1.0)
    wide = the_set(occupancy_at(10.0, 0.0, np.pi / 2, 1.0), 1.0)
    beside = np.array([[[[10.0, 3.3]]]] * 1).repeat(30, axis=1)[0]  # along the car's length
    ahead = np.array([[[[13.4, 0.0]]]] * 1).repeat(30, axis=1)[0]  # across it
    assert across.distance(beside)[0, 0] < across.distance(ahead)[0, 0]
    assert wide.distance(beside)[0, 0] < across.distance(beside)[0, 0]
    # Half the length, the disc, and at most 19 %: 2.25 + 1 = 3.25 m.
    assert across.distance(np.full((30, 1, 2), [10.0, 3.25])).max() <= 1.0
    assert across.distance(np.full((30, 1, 2), [10.0, 3.25 * 1.2])).min() > 1.0


def test_unpredicted_road_user_is_out_of_reach() -> None:
    gone = replace(occupancy_at(10.0, 0.0), valid=np.zeros((1, 40), dtype=np.bool_))
    sets = the_set(gone, 1.0)
    assert sets.distance(np.full((30, 1, 2), [10.0, 0.0])).min() > 100.0


def test_after_the_steps_with_sets_the_positions_alone_count() -> None:
    occupancy = occupancy_at(10.0, 0.0, 0.3, 1.0)
    sets = forbidden_sets(occupancy, 1.0, np.array([0]), PENALTY, 12)
    full, bare = the_set(occupancy, 1.0), the_set(occupancy.without_sets(), 1.0)
    np.testing.assert_array_equal(sets.matrix[:, :12], full.matrix[:, :12])
    np.testing.assert_array_equal(sets.matrix[:, 12:], bare.matrix[:, 12:])
    np.testing.assert_array_equal(sets.centre, bare.centre)


def test_release_lets_go_of_the_ego_and_comes_back() -> None:
    sets = the_set(occupancy_at(0.0, 2.0), 1.0)
    ego = np.array([[0.0, 0.3]])
    assert sets.distance(ego[None].repeat(30, axis=0))[0, 0] < 1.0
    released = release(sets, ego, DT, CONFIG.sets).distance(ego[None].repeat(30, axis=0))[0]
    assert released[0] >= 1.0
    assert np.all(np.diff(released) <= 1e-12)
    np.testing.assert_array_equal(
        release(sets, ego, DT, CONFIG.sets).matrix[:, 15:], sets.matrix[:, 15:]
    )  # full again after 1.5 s


def test_release_keeps_sets_that_do_not_hold_the_ego() -> None:
    sets = the_set(occupancy_at(0.0, 9.0), 1.0)
    released = release(sets, np.zeros((1, 2)), DT, CONFIG.sets)
    np.testing.assert_array_equal(released.matrix, sets.matrix)


def test_a_longer_release_is_asked_for_in_the_settings() -> None:
    sets, ego = the_set(occupancy_at(0.0, 2.0), 1.0), np.array([[0.0, 0.3]])
    slow = release(sets, ego, DT, SetSettings(release_seconds=2.0))
    assert np.all(slow.matrix[0, 19] != sets.matrix[0, 19], where=sets.matrix[0, 19] != 0.0)
    np.testing.assert_array_equal(slow.matrix[:, 20:], sets.matrix[:, 20:])


@pytest.mark.parametrize("away", [0.0, 5e5])
def test_distance_is_that_of_the_nearest_disc(away: float) -> None:
    """Against loops over everything; also where the map lies far from its origin."""
    rng = np.random.default_rng(3)
    n, steps, discs = 4, 6, 3
    centre, matrix = away + rng.normal(size=(n, steps, 2)), rng.normal(size=(n, steps, 2, 2))
    sets = ForbiddenSets(np.arange(n), centre, matrix, np.ones((n, steps)))
    points = away + rng.normal(size=(2, steps, discs, 2))
    found = sets.distance(points)
    assert found.shape == (2, n, steps)
    for c, i, t in np.ndindex(found.shape):
        z = [matrix[i, t] @ (points[c, t, d] - centre[i, t]) for d in range(discs)]
        wanted = min(float((zd**4).sum()) ** 0.25 for zd in z)
        assert found[c, i, t] == pytest.approx(wanted, rel=1e-6, abs=1e-9)


# Path and goals


@settings(max_examples=40, deadline=None)
@given(s=st.floats(3.0, 80.0), d=st.floats(-4.0, 4.0), error=st.floats(-3.0, 3.0))
def test_projection_inverts_the_frame(s: float, d: float, error: float) -> None:
    path = path_of(circle_route(30.0))
    row = path.at(np.array(s))
    point = row[:2] + d * np.array([-np.sin(row[PATH_HEADING]), np.cos(row[PATH_HEADING])])
    along, across = path.project(point, np.array(s + error))
    # The table is linear between points 0.5 m apart: its sagitta is 0.5^2 / (8 * 30) = 1 mm.
    assert float(along) == pytest.approx(s, abs=0.02)
    assert float(across) == pytest.approx(d, abs=0.005)
    assert path.at(np.array(s))[PATH_CURVATURE] == pytest.approx(1 / 30)


def goal_task(goal: GoalState) -> PlanningTask:
    return straight_scenario(goals=[goal], final_step=goal.last_step).task


def test_goal_region_is_found_along_the_path() -> None:
    # The path begins 20 m behind the origin; the region is kept 0.2 m from its edges.
    task = goal_task(GoalState(20, 30, box(40.0, -1.0, 60.0, 1.5), velocity=(3.0, 5.0)))
    (window,) = goals_of(task, path_of(task.route))
    assert window.begin == pytest.approx(60.2, abs=0.3)
    assert window.end == pytest.approx(79.8, abs=0.3)
    assert window.right == pytest.approx(-0.8, abs=0.11)
    assert window.left == pytest.approx(1.3, abs=0.11)
    assert window.offset == pytest.approx(0.0, abs=0.06)


def test_goal_beside_the_path_asks_for_an_offset() -> None:
    task = goal_task(GoalState(20, 30, box(40.0, 2.0, 60.0, 5.0)))
    (window,) = goals_of(task, path_of(task.route))
    assert 2.2 <= window.offset <= 4.8


def test_goal_with_a_foreign_heading_is_not_on_the_path() -> None:
    task = goal_task(GoalState(20, 30, box(40.0, -1.0, 60.0, 1.0), heading=(2.9, 3.0)))
    assert goals_of(task, path_of(task.route)) == ()


def test_a_heading_that_the_path_nearly_has_needs_no_way_of_its_own() -> None:
    for low, turn in ((0.14, 0.0), (0.16, 0.16)):
        goal = GoalState(0, 90, box(40.0, -1.5, 46.0, 1.5), heading=(low, 0.7))
        task = goal_task(goal)
        (window,) = goals_of(task, path_of(task.route))
        assert window.turn == pytest.approx(turn)


def test_a_goal_that_the_path_misses_by_a_turn_has_a_slower_reference_from_the_other_side() -> None:
    """It begins 8 m before it, at 6 m/s."""
    task = goal_task(GoalState(0, 90, box(40.0, -1.5, 46.0, 1.5), heading=(0.5, 0.7)))
    path = path_of(task.route)
    (window,) = goals_of(task, path)
    assert window.turn == pytest.approx(0.5)
    planner = SpeedPlanner(CONFIG, VEHICLE, path, (window,), LegalSpeed.of(task.route, 1.0), DT)
    profile = planned(planner, at(window.begin - 8.0, 6.0), replace(FREE, cruise=6.0))
    inside = profile.heading_weight > 0.0
    assert inside.any()
    assert profile.velocity[inside].max() < 4.5
    assert np.all(profile.arclength[inside] > window.begin - 1.0)
    assert np.all(profile.arclength[inside] < window.end)
    before = profile.offset[profile.arclength < window.begin - 2.0]
    assert before.min() < -0.2
    assert profile.offset[inside].max() > 0.0


def test_goal_without_a_region_has_no_window() -> None:
    task = goal_task(GoalState(20, 30))
    assert goals_of(task, path_of(task.route)) == ()


@pytest.mark.parametrize(
    ("first", "last", "begin", "cruise", "low", "high"),
    [
        pytest.param(0, 50, 0.0, 10.0, 10.0, 10.0, id="free: drive on"),
        # 50 m in 4.7 s at a steady 10.6 m/s and a little more for the run-up from 10.
        pytest.param(0, 50, 50.0, 10.0, 10.6, 13.0, id="deadline: faster"),
        # Not before 10 s, and the region ends after 70 m: at most 7 m/s.
        pytest.param(100, 120, 50.0, 10.0, 4.0, 7.2, id="opening: slower"),
    ],
)
def test_cruise_meets_the_window(
    first: int, last: int, begin: float, cruise: float, low: float, high: float
) -> None:
    task = goal_task(GoalState(first, last, box(begin, -1.0, begin + 20.0, 1.0)))
    (window,) = goals_of(task, path_of(task.route))
    grid = 20.0 + np.arange(0.0, 120.0, 1.0)
    limit = SpeedLimit(grid, np.full_like(grid, 40.0), CONFIG.calm, np.full_like(grid, 100.0))
    planner = speed_planner(path_of(task.route), window)
    met, speed = planner.cruise_for_goal(window, at(20.0, 10.0), cruise, limit)
    assert met
    assert low <= speed <= high


def test_profile_slows_down_for_a_curve() -> None:
    path = path_of(circle_route(10.0, turn=6.0))
    profile = planned(speed_planner(path), at(1.0, 12.0), replace(FREE, cruise=12.0))
    # sqrt(4 m/s2 * 10 m) = 6.3 m/s
    assert profile.velocity[-1] == pytest.approx(np.sqrt(40.0), abs=0.1)
    assert np.all(profile.velocity >= 0.0)


def test_a_curve_is_taken_no_faster_than_the_wheels_turn() -> None:
    """From straight to a radius of 10 m within 2 m: the steering's rate binds, not the tyres."""
    route = straight_route(100.0)
    along = route.arclength - 50.0
    curvature = 0.1 * np.clip(along / 2.0, 0.0, 1.0)
    path = path_of(replace(route, curvature=curvature))
    (speed,) = curve_speed(path, np.array([51.0]), 9.0, VEHICLE, SpeedSettings())
    # atan(wheelbase * 0.1) of steering over a window of 3 m.
    wanted = VEHICLE.max_steering_rate * 3.0 / np.arctan(VEHICLE.wheelbase * 0.1)
    assert speed == pytest.approx(wanted, rel=0.02)
    assert speed < np.sqrt(9.0 / 0.1)


def test_who_is_pressed_takes_a_curve_faster() -> None:
    path = path_of(circle_route(10.0, turn=6.0))
    calm, pressed = (
        planned(speed_planner(path), at(1.0, 12.0), replace(FREE, pressed=p)) for p in (False, True)
    )
    # sqrt(7 m/s2 * 10 m) = 8.4 m/s against 6.3 m/s
    assert calm.velocity[-1] == pytest.approx(np.sqrt(40.0), abs=0.1)
    assert pressed.velocity[-1] == pytest.approx(np.sqrt(70.0), abs=0.1)


def test_inside_a_goal_that_opens_later_the_ego_waits() -> None:
    task = goal_task(GoalState(100, 100, box(-10.0, -1.0, 2.0, 1.0)))
    path = path_of(task.route)
    planner = speed_planner(path, *goals_of(task, path))
    # The region ends at 22 m of path; the last metre is kept as a reserve.
    # Up to the edge itself, which the window with its margins falls short of, it is not too late.
    for position in (21.2, 21.9):
        profile = planned(planner, at(position, 2.0), FREE)
        assert profile.velocity[-1] == 0.0
        assert profile.station_weight[0] > MpcConfig().station_weight
    missed = planned(planner, at(23.0, 2.0), FREE)
    assert missed.velocity[-1] > 2.0
    late = planned(planner, at(21.2, 4.0, step=101), FREE)
    assert late.velocity[-1] == pytest.approx(FREE.cruise)


def test_a_goal_that_cannot_be_reached_gives_way_to_the_next_one() -> None:
    far = GoalState(0, 50, box(260.0, -1.0, 280.0, 1.0))
    near = GoalState(0, 50, box(20.0, -1.0, 30.0, 1.0), velocity=(0.0, 12.0))
    path = path_of(goal_task(near).route)
    first, second = (goals_of(goal_task(goal), path)[0] for goal in (far, near))
    planner = speed_planner(path, first, second)
    ego = at(20.0, 10.0)
    assert planner.next_goal(ego, [first]) is second
    assert planner.next_goal(ego) is first
    # Where none is left, the first one is still driven to.
    assert planner.next_goal(ego, [first, second]) is first


def test_a_line_that_does_not_bind_lets_the_ego_wait_in_its_goal() -> None:
    task = goal_task(GoalState(100, 100, box(-10.0, -1.0, 2.0, 1.0)))
    path = path_of(task.route)
    planner, ego = speed_planner(path, *goals_of(task, path)), at(21.2, 0.0)
    window = planner.next_goal(ego)
    alone, before_a_line = (planner.plan(ego, FREE, window, stop)[0] for stop in (None, 45.0))
    np.testing.assert_array_equal(before_a_line.station_weight, alone.station_weight)


def test_comfort_counts_less_for_who_stops_waits_or_is_late() -> None:
    path = path_of(straight_route())
    free = speed_planner(path).plan(at(20.0, 10.0), FREE, None)[0]
    assert np.all(free.comfort == 1.0)
    stopping = speed_planner(path).plan(at(20.0, 10.0), FREE, None, 40.0)[0]
    assert np.all(stopping.comfort == CONFIG.utmost.comfort)
    region = box(10.0, -1.0, 20.0, 1.0)
    for goal, share in (
        (GoalState(100, 100, region), CONFIG.speed.waiting_comfort),
        (GoalState(0, 5, box(60.0, -1.0, 80.0, 1.0)), CONFIG.utmost.comfort),
    ):
        task = goal_task(goal)
        path = path_of(task.route)
        profile = planned(speed_planner(path, *goals_of(task, path)), at(31.0, 3.0), FREE)
        assert np.all(profile.comfort == share)


def test_who_is_quicker_than_most_is_not_slowed_down_by_a_goal() -> None:
    task = goal_task(GoalState(30, 60, box(100.0, -2.0, 180.0, 2.0)))
    path = path_of(task.route)
    quick = replace(FREE, cruise=48.0)
    profile = planned(speed_planner(path, *goals_of(task, path)), at(20.0, 48.0), quick)
    assert profile.velocity.min() > 47.5


def test_before_a_gap_is_beside_the_ego_its_goal_asks_for_no_edge() -> None:
    task = goal_task(GoalState(0, 60, box(0.0, 1.0, 60.0, 4.0), heading=(-0.1, 0.1)))
    path = path_of(task.route)
    planner = speed_planner(path, *goals_of(task, path))
    ego = at(25.0, 8.0)
    window = planner.next_goal(ego)
    profile, _ = planner.plan(ego, FREE, window)
    assert np.all(np.isfinite(profile.right))
    led = planner.beside_goal(profile, window, 0, entry=1.05)
    assert np.all(led.right[:11] == -np.inf)
    assert np.all(led.left[:11] == np.inf)
    assert not led.heading_weight[:11].any()
    np.testing.assert_array_equal(led.right[11:], profile.right[11:])
    elsewhere = replace(profile, arclength=profile.arclength + 200.0)
    assert np.all(planner.beside_goal(elsewhere, window, 0).right == -np.inf)


@pytest.mark.parametrize("length", [0.42, 0.5, 0.6])
@pytest.mark.parametrize("x", [40.0, 40.1, 40.2])
def test_a_region_that_is_smaller_than_the_search_is_found(length: float, x: float) -> None:
    task = goal_task(GoalState(0, 60, box(x, -1.0, x + length, 1.0)))
    (window,) = goals_of(task, path_of(task.route))
    assert 20.0 + x <= window.begin <= window.end <= 20.0 + x + length


def test_a_region_between_which_the_path_turns_away_is_two() -> None:
    """A ring that is driven twice: its headings come again, far behind."""
    path = path_of(circle_route(20.0, turn=11.0))
    goal = GoalState(0, 90, Point(0.0, 20.0).buffer(25.0), heading=(1.0, 1.2))
    found = locate_goal(goal, path, CONFIG.goal)
    assert isinstance(found, GoalWindow)
    turned = path.heading_at(np.array([found.begin, found.end]))
    assert np.ptp(turned) < 2.0 * CONFIG.goal.turn + 0.25


def test_the_least_of_options_are_still_settings() -> None:
    goal = GoalState(0, 60, box(40.0, -1.0, 60.0, 1.0))
    settings = replace(CONFIG.goal, common_share=1.0)
    assert isinstance(locate_goal(goal, path_of(straight_route(200.0)), settings), GoalWindow)
    with pytest.raises(ValueError, match="slots is 0, expected more"):
        MpcConfig(slots=0)


def test_a_goal_ends_where_the_ego_has_to_stop() -> None:
    task = goal_task(GoalState(20, 30, box(40.0, -1.0, 60.0, 1.0)))
    (window,) = goals_of(task, path_of(task.route), farthest=70.0)
    assert window.end == 70.0
    (beyond,) = goals_of(task, path_of(task.route), farthest=10.0)
    assert beyond.end == beyond.begin


@pytest.mark.parametrize("lap", [0.0, 2.0 * np.pi, -2.0 * np.pi])
def test_heading_of_a_goal_is_on_the_turn_of_the_path(lap: float) -> None:
    task = goal_task(GoalState(0, 30, box(0.0, -1.0, 20.0, 1.0), heading=(0.1 + lap, 0.3 + lap)))
    path = path_of(task.route)
    (window,) = goals_of(task, path)
    assert window.heading == pytest.approx((0.1, 0.3))
    profile = planned(speed_planner(path, window), at(25.0, 5.0), FREE)
    # The path's own heading, 0, is 0.1 rad off: 0.06 rad within the window are asked for.
    np.testing.assert_allclose(profile.heading[:5], 0.16)
    assert np.all(profile.heading_weight[:5] > 0.0)


def test_a_bend_lends_room_of_the_lane_against() -> None:
    tight, wide = (
        replace(circle_route(radius), left=np.full(n, 1.5), outer_left=np.full(n, outer))
        for radius, outer in ((8.0, 6.0), (400.0, 6.0))
        for n in (len(circle_route(radius).arclength),)
    )
    assert path_of(tight).table[5, PATH_LEFT] == pytest.approx(1.5 + 10.0 / 8.0)
    assert path_of(wide).table[5, PATH_LEFT] == pytest.approx(1.5 + 10.0 / 400.0)
    # Never beyond the drivable area.
    walled = replace(tight, outer_left=tight.left)
    assert path_of(walled).table[5, PATH_LEFT] == 1.5


def seen(users: list[list[float]], velocity: float = 10.0) -> Traffic:
    """What the ego at x = 1.42 m sees of cars on a straight road."""
    scenario = straight_scenario(steady_tracks(users), velocity=velocity)
    observation = World(scenario, first_step=0, history=1).observation()
    path = path_of(scenario.task.route)
    position = 20.0 + VEHICLE.rear_to_centre
    return Lane(CONFIG.traffic, path, VEHICLE, velocity).look_around(
        observation, at(position, velocity), np.empty(0, dtype=np.int64)
    )


def test_traffic_is_sorted_into_leader_and_followers() -> None:
    free = seen([])
    assert free.cruise == 10.0
    # The follower at 14 m/s sets the pace; who comes the other way does not.
    behind = seen([[-9.1, 0.0, 0.0, 14.0], [60.0, 3.5, 0.0, 2.0], [50.0, 0.0, np.pi, 9.0]])
    assert behind.cruise == 14.0
    np.testing.assert_array_equal(behind.followers, [True, False, False])
    # 9.1 + 1.42 - 4.5 m of gap at 14 m/s are 0.4 s, 15.4 m at 9 m/s are 1.7.
    assert behind.pressed
    assert not seen([[-18.5, 0.0, 0.0, 9.0]]).pressed
    # Gap 16 - 4.5 m; wanted 2 + 0.8 * 10 m: 6 + 0.5 * (11.5 - 10).
    leader = seen([[17.42, 0.0, 0.0, 6.0]])
    assert leader.cruise == pytest.approx(6.75, abs=0.01)
    assert not leader.followers.any()


def test_a_stretched_set_keeps_its_front_and_reaches_back() -> None:
    sets = the_set(occupancy_at(0.0, 0.0), 1.0)
    longer = stretch_back(sets, np.array([True]), 10.0)
    front = 1.0 / sets.matrix[0, 0, 0, 0]
    for x, inside in ((front - 0.01, True), (front + 0.01, False), (-front - 9.9, True)):
        assert (longer.distance(np.full((30, 1, 2), [x, 0.0])).max() < 1.0) == inside
    same = stretch_back(sets, np.array([False]), 10.0)
    np.testing.assert_array_equal(same.matrix, sets.matrix)
    np.testing.assert_array_equal(same.centre, sets.centre)


def test_slots_that_are_left_over_are_out_of_reach() -> None:
    slots = the_set(occupancy_at(10.0, 1.0), 1.0).fill(3)
    assert slots.centre.shape == (HORIZON + 1, 3, 2)
    np.testing.assert_array_equal(slots.centre[1:, 0], np.tile([10.0, 1.0], (HORIZON, 1)))
    np.testing.assert_array_equal(slots.penalty[1:, 0], PENALTY)
    # The first stage is where the ego is now; it has no sets.
    assert slots.centre[0].min() == slots.centre[:, 1:].min() == 1e4


def sets_at(*places: float) -> ForbiddenSets:
    """Round sets of 2 m along the x axis, with ids from 100 on, that move on at 10 m/s."""
    x = np.array(places)[:, None] + 10.0 * DT * np.arange(HORIZON)
    return ForbiddenSets(
        ids=100 + np.arange(len(places)),
        centre=np.stack([x, np.zeros_like(x)], axis=-1),
        matrix=np.tile(0.5 * np.eye(2), (len(places), HORIZON, 1, 1)),
        penalty=np.tile(PENALTY, (len(places), 1)),
    )


def test_each_step_has_the_sets_that_are_near_there() -> None:
    """Who is passed one after the other takes one slot, not one each."""
    sets = sets_at(0.0, 20.0, 40.0)
    standing = np.tile([30.0, 0.0], (HORIZON, 1, 1))
    chosen = sets.choose(standing, sizes=(1, 2, 3), within=2.0)
    assert chosen.slots == 1
    assert chosen.ids[0, 0] == 101  # 20 m to go, and 40 m from it
    assert chosen.ids[0, -1] == 100
    slots, step = chosen.fill(), 10
    np.testing.assert_array_equal(slots.centre[1 + step, 0], sets.centre[1, step])
    slack = chosen.slack()
    assert slack.shape == (HORIZON, 1)
    assert slack[step] == 1.0
    assert chosen.touched(slack, 0.1) == (101, 100)
    assert chosen.touched(np.zeros_like(slack), 0.1) == ()


def test_as_many_slots_as_sets_are_near_at_once() -> None:
    sets = sets_at(0.0, 0.5, 1.0, 500.0)
    along = sets.centre[0][:, None]
    assert sets.choose(along, (1, 2, 3, 4), within=2.0).slots == 3
    few = sets.choose(along, (1, 2), within=2.0)
    assert few.slots == 2
    assert set(few.ids.ravel()) == {100, 101}


def test_a_set_that_goes_first_is_not_left_out() -> None:
    sets = sets_at(0.0, 0.5, 1.0)
    along = sets.centre[0][:, None]
    chosen = sets.choose(along, (1, 2), within=2.0, first=np.array([102]))
    assert set(chosen.ids.ravel()) == {100, 102}


def test_no_sets_leave_all_slots_empty() -> None:
    chosen = sets_at().choose(np.zeros((HORIZON, 1, 2)), (2, 4), within=2.0)
    assert chosen.fill().centre.min() == 1e4
    assert chosen.slack().shape == (HORIZON, 2)


def test_a_lane_beside_is_as_wide_as_the_settings_say() -> None:
    path = path_of(straight_route())
    start, ego = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), EgoOnPath(0, 20.0, 0.0, 21.42, 10.0)
    for lane in (2.0, 3.0):
        config = replace(CONFIG, sampler=SamplerSettings(lane=lane, accelerations=(0.0,)))
        sampler = Sampler(config, VEHICLE, path, road_along(path), DT)
        candidates = sampler.sample(start, ego, free_profile(path))
        # Two speeds, six targets, two lengths; the third target is the lane to the left, and the
        # longer way to it is 30 m.
        assert len(candidates.states) == 24
        assert candidates.offset[5, -1] == pytest.approx(lane, abs=0.1)


# Sampler


def test_candidates_start_at_the_ego_and_reach_their_offset() -> None:
    path = path_of(straight_route())
    sampler, profile = Sampler(CONFIG, VEHICLE, path, road_along(path), DT), free_profile(path)
    start = np.array([0.0, 0.2, 0.0, 10.0, 0.05, 0.0])
    candidates = sampler.sample(start, EgoOnPath(0, 20.0, 0.2, 21.42, 10.0), profile)
    assert np.all(candidates.states[:, 0] == start)
    assert np.all(np.isfinite(candidates.states))
    # Positions along a candidate move at its speed, give or take the way to the side.
    way = np.hypot(*np.moveaxis(np.diff(candidates.states[..., :2], axis=1), -1, 0))
    assert np.all(way <= candidates.states[:, :-1, 3] * DT * 1.2 + 0.1)
    ends = candidates.offset[candidates.states[:, -1, 3] > 5.0, -1]
    assert ends.min() < -0.3  # some go right,
    assert ends.max() > 3.0  # some to the left lane


def test_samples_that_are_led_go_aside_and_back() -> None:
    path = path_of(straight_route())
    sampler, profile = Sampler(CONFIG, VEHICLE, path, road_along(path), DT), free_profile(path)
    start = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    ego = EgoOnPath(0, 20.0, 0.0, 20.0 + VEHICLE.rear_to_centre, 10.0)
    steps = np.arange(CONFIG.horizon + 1)
    aside = 1.2 - 1.2 * np.cos(2.0 * np.pi * steps / CONFIG.horizon)
    bent = replace(
        profile,
        velocity=np.full(len(steps), 10.0),
        arclength=np.asarray(ego.position + 10.0 * DT * steps, dtype=np.float64),
        offset=aside,
    )
    led = sampler.led(start, ego, bent)
    assert np.abs(led.offset[-1] - aside).max() < 0.5  # The last one has the reference's speed.
    # None of those that go to one side and stay there is as near.
    others = sampler.sample(start, ego, bent)
    assert np.abs(others.offset - aside).max(axis=1).min() > 1.0
    # An ego that stands goes nowhere, whatever its reference asks for.
    stands = replace(bent, velocity=np.zeros(len(steps)), arclength=np.full(len(steps), 21.42))
    still = sampler.led(np.zeros(6), EgoOnPath(0, 20.0, 0.0, 21.42, 0.0), stands)
    assert np.all(np.isfinite(still.states))
    assert np.abs(still.offset[-1]).max() < 1e-9


def test_rating_prefers_the_free_side() -> None:
    path = path_of(straight_route())
    sampler, profile = Sampler(CONFIG, VEHICLE, path, road_along(path), DT), free_profile(path)
    start = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    candidates = sampler.sample(start, EgoOnPath(0, 20.0, 0.0, 21.42, 10.0), profile)
    _, radius = disc_offsets(VEHICLE, CONFIG.discs)
    blocked = the_set(occupancy_at(22.0, -0.5), radius)
    best = int(np.argmin(sampler.rate(candidates, blocked, profile)))
    distance = blocked.distance(sampler.disc_centres(candidates.states[best, 1:]))
    assert distance.min() > 0.95
    assert candidates.offset[best].max() > 1.5


@pytest.mark.parametrize("lateral", [-2.5, 0.0, 3.0])
@pytest.mark.parametrize("ahead", [12.0, 22.0, 200.0])
def test_the_best_candidate_is_the_cheapest_of_all(lateral: float, ahead: float) -> None:
    """Also beside the road's edge, where most candidates leave the road."""
    path = path_of(straight_route())
    sampler, profile = Sampler(CONFIG, VEHICLE, path, road_along(path), DT), free_profile(path)
    start = np.array([0.0, lateral, 0.0, 10.0, 0.2, 0.0])
    candidates = sampler.sample(start, EgoOnPath(0, 20.0, lateral, 21.42, 10.0), profile)
    _, radius = disc_offsets(VEHICLE, CONFIG.discs)
    blocked = the_set(occupancy_at(ahead, -0.5), radius)
    costs = sampler.rate(candidates, blocked, profile)
    best, cost = sampler.best(candidates, blocked, profile)
    assert cost == pytest.approx(costs.min(), rel=1e-9)
    assert costs[best] == pytest.approx(costs.min(), rel=1e-9)


# Optimal control problem


def stages_of(mpc: MpcProblem, guess: Guess, *sets: ForbiddenSets) -> StageParameters:
    """A straight road along +x with edges 5 m to both sides, and sets on it."""
    n, steps = mpc.config.horizon, stage_steps(mpc.config)
    together = ForbiddenSets(
        ids=np.arange(len(sets)),
        centre=np.concatenate([np.empty((0, n, 2)), *(s.centre for s in sets)]),
        matrix=np.concatenate([np.empty((0, n, 2, 2)), *(s.matrix for s in sets)]),
        penalty=np.concatenate([np.empty((0, n)), *(s.penalty for s in sets)]),
    ).at(steps[1:] - 1)
    return straight_stages(guess.states[steps, 0], mpc.config.slots, together)


def test_parameters_of_a_stage_have_their_place(mpc: MpcProblem) -> None:
    """Packed for all stages and unpacked for one, they have the same names."""
    stages = stages_of(mpc, straight_guess(mpc), the_set(occupancy_at(20.0, -0.4), 1.0))
    packed = stages.pack()
    assert packed.shape == (len(stage_steps(mpc.config)), stage_size(mpc.config))
    p = ca.SX.sym("p", packed.shape[1])
    reference, stations, slots = unpack_stage(p, mpc.config.slots)

    def value(expression: Any, step: int) -> FloatArray:
        return np.asarray(ca.Function("f", [p], [expression])(packed[step])).ravel()

    for step in (1, 17):
        for name, part in zip(reference._fields, reference, strict=True):
            wanted = np.ravel(getattr(stages.reference, name)[step])
            np.testing.assert_array_equal(value(part, step), wanted)
        for i, station in enumerate(stations):
            for side, edge in zip(station._fields, station, strict=True):
                for name, part in zip(edge._fields, edge, strict=True):
                    wanted = np.ravel(getattr(getattr(stages.stations, side), name)[step, i])
                    np.testing.assert_array_equal(value(part, step), wanted)
        for j, slot in enumerate(slots):
            for name, part in zip(slot._fields, slot, strict=True):
                wanted = np.ravel(getattr(stages.slots, name)[step, j])
                np.testing.assert_array_equal(value(part, step), wanted)


def straight_guess(mpc: MpcProblem, lateral: float = 0.0) -> Guess:
    n = mpc.config.horizon
    states = np.zeros((n + 1, 6))
    states[:, 0] = 10.0 * DT * np.arange(n + 1)
    states[1:, 1] = lateral
    states[:, 3] = 10.0
    return Guess(
        states,
        np.zeros((n, 2)),
        np.zeros(n),
        states[:, 0].copy(),
    )


def solved(mpc: MpcProblem, start: FloatArray, stages: StageParameters, guess: Guess) -> Solution:
    """The solution from a guess that enters no set."""
    slack = np.zeros((len(stage_steps(mpc.config)) - 1, mpc.config.slots))
    return mpc.solve(start, stages, guess, slack)


@pytest.fixture(scope="module")
def mpc() -> MpcProblem:
    return problem(MpcConfig(), VEHICLE, DT)


def test_problem_is_built_once(mpc: MpcProblem) -> None:
    assert problem(MpcConfig(), VEHICLE, DT) is mpc


@pytest.mark.parametrize(
    ("horizon", "fine", "steps"),
    [
        (6, 6, [0, 1, 2, 3, 4, 5, 6]),
        (6, 9, [0, 1, 2, 3, 4, 5, 6]),
        (8, 2, [0, 1, 2, 4, 6, 8]),
        (7, 2, [0, 1, 2, 4, 6, 7]),
        (5, 0, [0, 2, 4, 5]),
    ],
)
def test_later_stages_are_two_steps_apart(horizon: int, fine: int, steps: list[int]) -> None:
    config = replace(MpcConfig(), horizon=horizon, fine_steps=fine)
    np.testing.assert_array_equal(stage_steps(config), steps)


def test_wide_stages_plan_what_narrow_ones_do() -> None:
    """Two steps at once later on change a plan by little, and its first second by hardly anything.

    Their cost is that of the steps which they stand for.
    """
    start = np.array([0.0, 0.6, 0.02, 9.0, 0.05, 0.3])
    _, radius = disc_offsets(VEHICLE, CONFIG.discs)
    sets = the_set(occupancy_at(20.0, -0.4), radius, np.full(HORIZON, 2000.0))
    found = []
    for fine in (HORIZON, CONFIG.fine_steps):
        mpc = problem(replace(MpcConfig(), slots=2, fine_steps=fine), VEHICLE, DT)
        guess = straight_guess(mpc, lateral=2.5)
        found.append(solved(mpc, start, stages_of(mpc, guess, sets), guess))
    narrow, wide = found
    assert wide.usable
    assert wide.inputs.shape == narrow.inputs.shape
    assert wide.cost == pytest.approx(narrow.cost, rel=0.05)
    np.testing.assert_allclose(wide.states[:11, :5], narrow.states[:11, :5], atol=0.05)
    np.testing.assert_allclose(wide.states[:, :2], narrow.states[:, :2], atol=0.25)


def test_solution_obeys_the_vehicle_model(mpc: MpcProblem) -> None:
    start = np.array([0.0, 0.6, 0.02, 10.0, 0.05, 0.3])
    guess = straight_guess(mpc)
    solution = solved(mpc, start, stages_of(mpc, guess), guess)
    assert solution.status is SolveStatus.SOLVED
    state = start[:5]
    for k in range(mpc.config.horizon):
        state = VEHICLE.step(state, solution.inputs[k], DT)
        np.testing.assert_allclose(state, solution.states[k + 1, :5], atol=1e-3)
    assert abs(solution.states[-1, 1]) < 0.3  # it returns to the path
    assert np.all(np.abs(solution.inputs[:, 0]) <= VEHICLE.max_steering_rate + 1e-6)


def test_a_plan_that_has_time_speeds_up_more_gently(mpc: MpcProblem) -> None:
    """The path's velocity is 10 m/s; a style that is in a hurry pays less for discomfort."""
    start = np.array([0.0, 0.0, 0.0, 3.0, 0.0, 0.0])
    guess = straight_guess(mpc)
    stages = stages_of(mpc, guess)
    found = []
    for share in (CONFIG.calm.comfort, CONFIG.utmost.comfort):
        reference = stages.reference._replace(comfort=np.full(len(stages.reference.offset), share))
        solution = solved(mpc, start, replace(stages, reference=reference), guess)
        acceleration = np.concatenate([start[5:], solution.inputs[:, 1]])
        found.append((acceleration.max(), np.abs(np.diff(acceleration)).max() / DT))
    (calm, calm_jerk), (hurried, hurried_jerk) = found
    # nuPlan's bound is 2.4 m/s2.
    assert calm < 2.4 < hurried
    assert calm_jerk < 0.7 * hurried_jerk


def test_road_user_is_passed_outside_its_set(mpc: MpcProblem) -> None:
    _, radius = disc_offsets(VEHICLE, mpc.config.discs)
    sets = the_set(occupancy_at(20.0, -0.4), radius)
    guess = straight_guess(mpc, lateral=2.5)
    start = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    solution = solved(mpc, start, stages_of(mpc, guess, sets), guess)
    assert solution.usable
    discs, _ = disc_offsets(VEHICLE, mpc.config.discs)
    x = solution.states[1:]
    direction = np.stack([np.cos(x[:, 4]), np.sin(x[:, 4])], axis=-1)
    points = x[:, None, :2] + discs[:, None] * direction[:, None]
    assert sets.distance(points).min() >= 1.0 - 1e-2
    assert solution.set_slack.max() < 1e-3


def test_unavoidable_set_has_slack_of_its_own(mpc: MpcProblem) -> None:
    """One set the ego cannot leave must not loosen another."""
    _, radius = disc_offsets(VEHICLE, mpc.config.discs)
    here = the_set(occupancy_at(1.4, 0.0), radius)
    ahead = the_set(occupancy_at(22.0, -0.4), radius)
    guess = straight_guess(mpc, lateral=2.5)
    stages = stages_of(mpc, guess, here, ahead)
    start = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    solution = solved(mpc, start, stages, guess)
    assert solution.usable
    assert solution.set_slack[:, 0].max() > 0.3
    assert solution.set_slack[:, 1].max() < 0.01


def test_a_set_is_entered_where_it_costs_less_than_the_way_around(mpc: MpcProblem) -> None:
    """The penalty of a slot is its own: the same set is obeyed or not, as it is priced."""
    _, radius = disc_offsets(VEHICLE, mpc.config.discs)
    start = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    guess = straight_guess(mpc)
    slacks = []
    for price in (0.1, 2000.0):
        sets = the_set(occupancy_at(25.0, -0.8), radius, np.full(HORIZON, price))
        stages = stages_of(mpc, guess, sets)
        slacks.append(solved(mpc, start, stages, guess).set_slack.max())
    assert slacks[0] > 0.1
    assert slacks[1] < 0.01


def test_fatrop_agrees_with_ipopt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another solver finds the same optimum of the same problem."""
    config = replace(MpcConfig(), horizon=15, slots=2, tolerance=1e-6)
    ours = MpcProblem(config, VEHICLE, DT)
    build = ca.nlpsol

    def ipopt(name: str, _: str, nlp: Any, __: Any) -> Any:
        quiet: dict[str, Any] = {"print_level": 0, "sb": "yes", "tol": 1e-8}
        options: dict[str, Any] = {"print_time": False, "ipopt": quiet}
        return build(name, "ipopt", nlp, options)

    monkeypatch.setattr(ca, "nlpsol", ipopt)
    oracle = MpcProblem(config, VEHICLE, DT)
    _, radius = disc_offsets(VEHICLE, config.discs)
    sets = the_set(occupancy_at(12.0, -0.8), radius, PENALTY[:15])
    guess = straight_guess(ours, lateral=1.5)
    start = np.array([0.0, 0.4, 0.0, 9.0, 0.03, 0.0])
    stages = stages_of(ours, guess, sets)
    a, b = solved(ours, start, stages, guess), solved(oracle, start, stages, guess)
    assert a.status is b.status is SolveStatus.SOLVED
    assert a.cost == pytest.approx(b.cost, rel=1e-4)
    np.testing.assert_allclose(a.states, b.states, atol=5e-3)


def test_nan_is_a_status_not_an_exception(mpc: MpcProblem) -> None:
    guess = straight_guess(mpc)
    stages = stages_of(mpc, guess)
    stages.reference.velocity[5] = np.nan
    solution = solved(mpc, np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), stages, guess)
    assert not solution.usable
    assert solution.status is SolveStatus.SOLVER_ERROR


def test_no_candidate_is_quicker_than_the_vehicle() -> None:
    path = path_of(straight_route(600.0))
    sampler = Sampler(CONFIG, VEHICLE, path, road_along(path), DT)
    start = np.array([0.0, 0.0, 0.0, 50.0, 0.0, 0.0])
    ego = EgoOnPath(0, 20.0, 0.0, 21.42, 50.0)
    profile, _ = speed_planner(path).plan(ego, replace(FREE, cruise=60.0), None)
    found = sampler.sample(start, ego, profile).states[..., 3]
    assert found.max() > 50.5
    assert found.max() <= VEHICLE.max_velocity + 1e-9


def test_a_candidate_is_rated_where_its_centre_is() -> None:
    """An ego that is turned by 0.8 rad, with its centre just inside the edges of a goal."""
    path = path_of(straight_route())
    sampler, profile = Sampler(CONFIG, VEHICLE, path, road_along(path), DT), free_profile(path)
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.8, 0.0])
    ego = EgoOnPath(0, 20.0, 0.0, 21.42, 0.0)
    standing = sampler.at_speed(start, ego, profile, np.zeros(31)).some(np.array([0]))
    aside = VEHICLE.rear_to_centre * np.sin(0.8)

    def cost(left: float) -> float:
        edged = replace(profile, left=np.full(31, left))
        return float(sampler.rate(standing, nothing_forbidden(), edged)[0])

    assert cost(aside + 0.01) == cost(np.inf)
    assert cost(aside - 0.01) > cost(np.inf)


@pytest.mark.parametrize("passed", [1, 2, 4])
def test_an_arrival_that_was_begun_goes_on_after_any_number_of_steps(passed: int) -> None:
    goal = GoalState(18, 20, box(8.0, 0.5, 14.0, 4.0), heading=(0.3, 0.5))
    task = straight_scenario(goals=[goal], velocity=6.0, final_step=20).task
    path = path_of(task.route)
    sampler = Sampler(CONFIG, VEHICLE, path, road_along(path), DT)
    road = box(-50.0, -10.0, 50.0, 10.0)
    shapely.prepare(road)
    arrivals = Arrivals(CONFIG.arrival, task, [], road, VEHICLE, sampler)
    start = np.append(task.start, 0.0)
    straight_on = np.tile(start, (31, 1))
    sets = nothing_forbidden()
    first = arrivals.instead(straight_on, 0, start, sets, np.inf)
    assert first is not None
    now = first.states[passed]
    later = arrivals.instead(np.tile(now, (31, 1)), passed, now, sets, np.inf)
    assert later is not None
    until = 20 - passed
    np.testing.assert_allclose(later.states[:until], first.states[passed : passed + until])


def nothing_forbidden() -> ForbiddenSets:
    return ForbiddenSets(
        ids=np.empty(0, dtype=np.int64),
        centre=np.empty((0, 30, 2)),
        matrix=np.empty((0, 30, 2, 2)),
        penalty=np.empty((0, 30)),
    )


@pytest.mark.parametrize(("first", "fastest"), [(False, 12.0), (True, 8.0)])
def test_a_goal_may_ask_for_more_than_the_limit_unless_the_limit_comes_first(
    first: bool, fastest: float
) -> None:
    task = goal_task(GoalState(0, 60, box(0.0, -2.0, 60.0, 2.0), velocity=(12.0, 14.0)))
    path = path_of(task.route)
    config = replace(CONFIG, speed=replace(CONFIG.speed, limit_first=first))
    planner = speed_planner(path, *goals_of(task, path), limit=8.0, config=config)
    velocity = planned(planner, at(21.0, 8.0), FREE).velocity
    assert velocity.max() == pytest.approx(fastest, abs=1.0)
