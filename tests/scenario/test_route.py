from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point

from dosplan.geometry import lanelet_polygon, lanelet_union, rectangle_corners, wrap_angle
from dosplan.scenario import load_scenario
from dosplan.scenario.route.corridor import OFF_ROAD, Corridor
from dosplan.scenario.route.route import build_route
from dosplan.types import FloatArray, GoalState, IntArray, Lanelet, RoadMap, Route, Scenario
from dosplan.vehicle import VehicleParameters
from tests.support import scenes

VEHICLE = VehicleParameters()


def road_map(lanes: Sequence[scenes.Lane]) -> RoadMap:
    def same(neighbour: tuple[int, bool] | None) -> int | None:
        return neighbour[0] if neighbour and neighbour[1] else None

    lanelets = tuple(
        Lanelet(
            lane.id,
            lane.left,
            lane.right,
            lane.successors,
            lane.predecessors,
            same(lane.left_neighbour),
            same(lane.right_neighbour),
            speed_limit=lane.speed_limit,
        )
        for lane in lanes
    )
    return RoadMap(lanelets, lanelet_union(lanelets))


def route_to(
    lanes: Sequence[scenes.Lane],
    goal: shapely.Polygon | None = None,
    start: tuple[float, float, float, float] = (10.0, 0.0, 0.0, 10.0),
    seconds: float = 5.0,
    heading: tuple[float, float] | None = None,
) -> Route:
    x, y, direction, velocity = start
    return build_route(
        road_map(lanes),
        centre=np.array([x, y]),
        heading=direction,
        velocity=velocity,
        goals=(GoalState(0, round(10 * seconds), goal, heading),),
        seconds=seconds,
        vehicle=VEHICLE,
    )


def shifted(lane: scenes.Lane, x: float, y: float, name: int) -> scenes.Lane:
    by = np.array([x, y])
    return replace(lane, id=name, left=lane.left + by, right=lane.right + by)


def check_smooth(route: Route, largest_curvature: float, largest_rate: float) -> None:
    chord = np.hypot(*np.diff(route.path, axis=0).T)
    np.testing.assert_allclose(np.diff(route.arclength), 0.5)
    np.testing.assert_allclose(chord, 0.5, atol=2e-3)
    direction = np.diff(route.path, axis=0)
    between = np.arctan2(direction[:, 1], direction[:, 0])
    middle = 0.5 * (route.heading[1:] + route.heading[:-1])
    np.testing.assert_allclose(wrap_angle(between - middle), 0.0, atol=5e-3)
    # The heading is the integral of the curvature (trapezoidal rule).
    turned = 0.25 * (route.curvature[1:] + route.curvature[:-1])
    np.testing.assert_allclose(np.diff(route.heading), turned, atol=5e-3)
    assert np.abs(route.curvature).max() <= largest_curvature
    assert np.abs(np.diff(route.curvature)).max() / 0.5 <= largest_rate


def test_straight_road_gives_a_straight_path_with_exact_bounds() -> None:
    route = route_to(scenes.straight_road(lanes=3), start=(50.0, 3.5, 0.0, 10.0))
    assert route.lanelet_ids == (101,)
    check_smooth(route, 1e-9, 1e-9)
    np.testing.assert_allclose(route.path[:, 1], 3.5, atol=1e-9)
    assert route.path[0, 0] == pytest.approx(20.0)
    inside = (route.path[:, 0] > 0.5) & (route.path[:, 0] < 199.5)
    np.testing.assert_allclose(route.left[inside], 5.25, atol=1e-6)
    np.testing.assert_allclose(route.right[inside], -5.25, atol=1e-6)


@pytest.mark.parametrize("velocity", [0.0, 10.0, 30.0])
def test_path_is_long_enough_and_goes_on_past_the_map(velocity: float) -> None:
    start = (10.0, 0.0, 0.0, velocity)
    short, long = (
        route_to(scenes.straight_road(length=length), start=start, seconds=8.0)
        for length in (100.0, 2000.0)
    )
    needed = max(velocity, 15.0) * 8.0 + 60.0
    for route in (short, long):
        assert route.path[0, 0] <= 10.0 - 20.0
        assert route.path[-1, 0] >= 10.0 + needed
    assert short.path[-1, 0] >= 200.0
    off = short.path[:, 0] > 100.1
    np.testing.assert_array_equal(short.left[off], 1.75)
    np.testing.assert_array_equal(short.right[off], -1.75)


def test_oncoming_lane_is_not_free_but_lanes_in_the_same_direction_are() -> None:
    lanes = scenes.straight_road(lanes=2, oncoming=2)
    inside = slice(70, 300)
    route = route_to(lanes)
    np.testing.assert_allclose(route.left[inside], 5.25, atol=1e-6)
    np.testing.assert_allclose(route.right[inside], -1.75, atol=1e-6)
    free = build_route(
        road_map(lanes),
        centre=np.array([10.0, 0.0]),
        heading=0.0,
        velocity=10.0,
        goals=(GoalState(0, 50),),
        seconds=5.0,
        vehicle=VEHICLE,
        two_way=frozenset({102}),
    )
    np.testing.assert_allclose(free.left[inside], 8.75, atol=1e-6)


@pytest.mark.parametrize(
    ("special", "used"),
    [
        ({}, True),
        ({"kind": "busLane", "user": "car"}, True),
        ({"user": "vehicle"}, True),
        ({"user": "bicycle"}, False),
        ({"user": "pedestrian"}, False),
        ({"kind": "bicycleLane"}, False),
        ({"kind": "sidewalk"}, False),
        ({"kind": "crosswalk"}, False),
    ],
)
def test_no_route_leads_over_a_lane_that_is_not_for_cars(
    tmp_path: Path, special: dict[str, str], used: bool
) -> None:
    """Nearly all of the goal is in the right lane; the start is in the left one."""
    right, left = scenes.straight_road(lanes=2)
    lanes = [replace(right, **special), left]  # type: ignore[arg-type]
    goal = scenes.Goal(position=scenes.rectangle(10.0, 3.0, 60.0, 0.5))
    problem = scenes.Problem(start=(10.0, 3.5, 0.0, 10.0), goals=(goal,))
    path = scenes.write_scenario_xml(tmp_path / "a.xml", lanes, problems=[problem])
    scenario = load_scenario(path)
    assert scenario.task.route.lanelet_ids == ((101, 100) if used else (101,))
    by_id = {lanelet.id: lanelet for lanelet in scenario.road_map.lanelets}
    assert by_id[101].right_neighbour == (100 if used else None)
    assert by_id[100].left_neighbour == (101 if used else None)
    assert by_id[100].for_cars == used
    # Footways are no part of the drivable area either.
    assert scenario.road_map.drivable.area == pytest.approx(200.0 * (7.0 if used else 3.5))


def test_a_start_on_a_footway_takes_the_nearest_lane_for_cars(tmp_path: Path) -> None:
    right, left = scenes.straight_road(lanes=2)
    problem = scenes.Problem(start=(10.0, 0.0, 0.0, 10.0))
    lanes = [replace(right, kind="sidewalk"), left]
    path = scenes.write_scenario_xml(tmp_path / "a.xml", lanes, problems=[problem])
    assert load_scenario(path).task.route.lanelet_ids == (101,)


def test_bounds_do_not_pass_a_thin_median() -> None:
    lanes = scenes.straight_road(lanes=1)
    far = shifted(lanes[0], 0.0, 3.75, 900)
    np.testing.assert_allclose(route_to([*lanes, far]).left[70:300], 1.75, atol=1e-6)
    near = shifted(lanes[0], 0.0, 3.58, 900)
    np.testing.assert_allclose(route_to([*lanes, near]).left[70:300], 5.33, atol=1e-6)


@pytest.mark.parametrize("velocity", [5.0, 14.0, 30.0])
@pytest.mark.parametrize("changes", [1, 2])
@pytest.mark.parametrize("pieces", [1, 4])
def test_lane_change_to_the_goal(velocity: float, changes: int, pieces: int) -> None:
    lanes = scenes.straight_road(lanes=3, length=300.0, pieces=pieces)
    goal = shapely.box(180.0, 3.5 * changes - 1.5, 200.0, 3.5 * changes + 1.5)
    route = route_to(lanes, goal, (20.0, 0.0, 0.0, velocity), seconds=8.0)
    y = np.interp([20.0, 180.0, 250.0], route.path[:, 0], route.path[:, 1])
    np.testing.assert_allclose(y, [0.0, 3.5 * changes, 3.5 * changes], atol=0.15)
    assert np.all(np.diff(route.path[:, 1]) >= -0.03)
    # 3.5 m over L by the quintic peaks at 5.7735 * 3.5 / L^2; L is 15 m or more.
    check_smooth(route, 5.7735 * 3.5 / 15.0**2 * 1.1, 0.06)


def test_no_lane_change_without_need_and_no_goal_follows_the_lane() -> None:
    lanes = scenes.straight_road(lanes=3, pieces=3)
    assert route_to(lanes).lanelet_ids == (100, 200, 300)
    goal = shapely.box(150.0, -1.5, 170.0, 1.5)
    assert route_to(lanes, goal).lanelet_ids == (100, 200, 300)


def test_lane_that_ends_is_left_at_its_end() -> None:
    lanes = [lane for lane in scenes.straight_road(lanes=2, pieces=3) if lane.id not in (200, 300)]
    lanes[0] = replace(lanes[0], successors=())
    lanes = [replace(lane, right_neighbour=None) if lane.id > 200 else lane for lane in lanes]
    route = route_to(lanes)
    assert route.lanelet_ids == (100, 101, 201, 301)
    y = np.interp([30.0, 67.0], route.path[:, 0], route.path[:, 1])
    np.testing.assert_allclose(y, [0.0, 3.5], atol=0.1)


@pytest.mark.parametrize(
    ("goal", "ids", "end"),
    [
        (None, (1, 2, 5), (150.0, 0.0)),
        (Point(60.0, 60.0).buffer(2.0), (1, 3, 6), (60.0, 100.0)),
        (Point(56.0, -60.0).buffer(2.0), (1, 4, 7), (56.0, -100.0)),
    ],
)
def test_junction(
    goal: shapely.Polygon | None, ids: tuple[int, ...], end: tuple[float, float]
) -> None:
    route = route_to(scenes.junction(), goal, (20.0, 0.0, 0.0, 8.0))
    assert route.lanelet_ids == ids
    assert shapely.distance(LineString(route.path), Point(end)) < 0.01
    # Radii are 10 m and 6 m; a smooth path needs a little more than 1 / radius at its peak.
    check_smooth(route, 0.25, 0.1)
    middle = (route.path[:, 0] > 15.0) & (np.abs(route.path[:, 1]) < 80.0)
    room = np.minimum(route.left, -route.right)[middle]
    assert room.min() >= 0.5 * VEHICLE.width + 0.24


def test_unreachable_goal_and_wrong_way_start_still_give_a_route() -> None:
    lanes = scenes.straight_road(lanes=1, oncoming=1)
    behind_the_line = shapely.box(100.0, 2.0, 110.0, 5.0)
    assert route_to(lanes, behind_the_line).lanelet_ids == (100,)
    wrong = route_to(lanes, start=(100.0, 3.5, np.pi - 0.1, 5.0))
    assert wrong.lanelet_ids == (101,)
    assert wrong.path[-1, 0] < wrong.path[0, 0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("velocity", [3.0, 14.0])
def test_a_start_on_the_oncoming_lane_begins_there_and_comes_back(
    side: float, velocity: float
) -> None:
    lanes = scenes.straight_road(lanes=1, oncoming=2, length=300.0, pieces=3)
    if side < 0.0:
        lanes = scenes.mirrored(lanes)
    goal = shapely.box(180.0, -1.5, 200.0, 1.5)
    route = route_to(lanes, goal, (40.0, side * 3.2, 0.0, velocity), seconds=12.0)
    assert route.lanelet_ids == (100, 200, 300)
    back = 44.0 + np.clip(3.0 * velocity, 15.0, 60.0)
    x, y = route.path.T
    np.testing.assert_allclose(y[x <= 40.0], side * 3.2, atol=0.15)
    np.testing.assert_allclose(y[x >= back], 0.0, atol=0.15)
    assert np.all(side * np.diff(y) <= 0.03)
    check_smooth(route, 5.7735 * 3.2 / (back - 44.0) ** 2 * 1.1, 0.06)
    # The road is free to the far side of the lane that the ego is on, not to that of the next one;
    # where the ego is back and no longer on the lanelets that it used, only its lane is.
    upright = np.cos(route.heading)
    outward = y + upright * (route.left if side > 0.0 else route.right)
    inward = y + upright * (route.right if side > 0.0 else route.left)
    on_road = (x > 12.0) & (x < 290.0)
    np.testing.assert_allclose(inward[on_road], -side * 1.75, atol=0.01)
    np.testing.assert_allclose(outward[(x > 20.0) & (x < back)], side * 5.25, atol=0.03)
    np.testing.assert_allclose(outward[(x > 102.0) & on_road], side * 1.75, atol=0.01)


def test_the_ego_has_room_on_its_way_back_where_oncoming_lanelets_meet() -> None:
    lanes = scenes.straight_road(lanes=1, oncoming=1, length=300.0, pieces=3)
    route = route_to(lanes, start=(75.0, 3.2, 0.0, 14.0), seconds=12.0)
    crossing = (route.path[:, 0] > 99.0) & (np.abs(route.path[:, 1]) < 1.7)
    assert np.any(route.path[crossing, 1] > 1.0)  # It comes back over the line where they meet.
    assert route.left[crossing].min() >= 0.5 * VEHICLE.width


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_goal_on_the_oncoming_lane_is_reached_from_a_start_there(side: float) -> None:
    lanes = scenes.straight_road(lanes=1, oncoming=1, length=300.0, pieces=3)
    if side < 0.0:
        lanes = scenes.mirrored(lanes)
    goal = shapely.box(130.0, min(side * 2.0, side * 5.0), 150.0, max(side * 2.0, side * 5.0))
    route = route_to(lanes, goal, (40.0, side * 3.5, 0.0, 14.0), seconds=12.0)
    x, y = route.path.T
    np.testing.assert_allclose(y[x <= 150.0], side * 3.5, atol=0.05)
    np.testing.assert_allclose(y[x >= 200.0], 0.0, atol=0.05)
    outward = y + np.cos(route.heading) * (route.left if side > 0.0 else route.right)
    np.testing.assert_allclose(outward[(x > 12.0) & (x < 190.0)], side * 5.25, atol=0.01)


def test_a_start_beside_the_middle_of_its_own_lane_has_the_path_of_the_lane() -> None:
    lanes = scenes.straight_road(lanes=1, oncoming=1)
    aside, middle = (route_to(lanes, start=(40.0, y, 0.0, 14.0)) for y in (1.7, 0.0))
    np.testing.assert_array_equal(aside.path, middle.path)
    np.testing.assert_array_equal(aside.left, middle.left)


def test_goal_heading_decides_between_lanes_that_overlap() -> None:
    lanes = scenes.junction()
    goal = Point(50.0, 0.0).buffer(6.0)
    north = route_to(lanes, goal, (20.0, 0.0, 0.0, 8.0), heading=(1.2, 1.9))
    assert north.lanelet_ids[0] == 1


def test_the_road_that_lasts_is_preferred_to_a_straight_one_that_ends() -> None:
    lanes = list(scenes.junction())
    lanes = [
        replace(lane, successors=()) if lane.id == 2 else lane for lane in lanes if lane.id != 5
    ]
    assert route_to(lanes, start=(20.0, 0.0, 0.0, 12.0), seconds=10.0).lanelet_ids[1] != 2
    assert route_to(lanes, start=(20.0, 0.0, 0.0, 5.0), seconds=2.0).lanelet_ids[1] == 2


def test_a_loop_is_driven_again() -> None:
    quarter = [
        scenes.arc_lane(k, (20.0 * np.cos(a), 20.0 * np.sin(a), a + np.pi / 2), 20.0, np.pi / 2)
        for k, a in enumerate(np.pi / 2 * np.arange(4), start=1)
    ]
    ring = [replace(lane, successors=(lane.id % 4 + 1,)) for lane in quarter]
    route = route_to(ring, start=(20.0, 0.0, np.pi / 2, 10.0), seconds=20.0)
    assert route.lanelet_ids[:9] == (1, 2, 3, 4, 1, 2, 3, 4, 1)
    on_ring = slice(100, 620)  # 260 m, two laps.
    np.testing.assert_allclose(np.hypot(*route.path[on_ring].T), 20.0, atol=0.1)


@pytest.mark.parametrize("radius", [8.0, 30.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_curve_has_its_curvature(radius: float, side: float) -> None:
    route = route_to(scenes.curve(radius, side * np.pi / 2), start=(20.0, 0.0, 0.0, 8.0))
    check_smooth(route, 1.25 / radius, 0.06)
    turned = route.heading[-1] - route.heading[0]
    assert turned == pytest.approx(side * np.pi / 2, abs=1e-3)
    if radius == 30.0:
        s = route.arclength - 60.0  # the arc begins 50 m from x = 0, which is at 10 m
        arc = (s > 12.0) & (s < 35.0)
        np.testing.assert_allclose(route.curvature[arc], side / radius, rtol=0.15)


def test_seams_and_crossed_bounds() -> None:
    lanes = scenes.straight_road(lanes=1, pieces=2)
    apart = shifted(lanes[1], 0.08, 0.0, 200)
    closed = road_map([lanes[0], apart]).drivable
    assert closed.geom_type == "Polygon"
    assert closed.area == pytest.approx(3.5 * 200.08)
    wide = shifted(lanes[1], 0.22, 0.0, 200)
    assert road_map([lanes[0], wide]).drivable.geom_type == "MultiPolygon"
    x = np.array([0.0, 10.0, 20.0])
    crossed = Lanelet(1, np.stack([x, [2, 2, -1]], axis=1), np.stack([x, [0, 0, 1]], axis=1))
    area = lanelet_polygon(crossed.left, crossed.right)
    assert area.is_valid
    assert shapely.contains_xy(area, [5.0, 19.0], [1.0, 0.0]).all()


def brute_force_bounds(
    route: Route, chosen: Sequence[int], free: shapely.Geometry
) -> tuple[FloatArray, FloatArray]:
    """Length of the rays sideways; a corner of the area cuts that of the nearest path point."""
    out = []
    corners = shapely.get_coordinates(shapely.get_rings(shapely.get_parts(free)))
    away = np.linalg.norm(corners[:, None] - route.path, axis=2)
    nearest = away.argmin(axis=1)
    for i in chosen:
        normal = np.array([-np.sin(route.heading[i]), np.cos(route.heading[i])])
        row = []
        for side in (1.0, -1.0):
            ray = LineString([route.path[i], route.path[i] + side * 12.0 * normal])
            inside = shapely.intersection(ray, free)
            parts = [
                p for p in shapely.get_parts(inside) if p.distance(Point(ray.coords[0])) < 1e-9
            ]
            beside = [
                float(side * normal @ (corner - route.path[i]))
                for corner in corners[nearest == i]
                if np.linalg.norm(corner - route.path[i]) < 12.0
                and abs(np.cross(normal, corner - route.path[i])) <= 0.5
            ]
            reach = max((p.length for p in parts), default=0.0)
            row.append(side * min([reach, *(d for d in beside if d >= 0.0)]))
        out.append(row)
    rows = np.array(out)
    return rows[:, 0], rows[:, 1]


@pytest.mark.parametrize("lanes", [scenes.junction(), scenes.curve(12.0)])
def test_bounds_against_ray_casting(lanes: tuple[scenes.Lane, ...]) -> None:
    route = route_to(lanes, start=(20.0, 0.0, 0.0, 8.0))
    free = road_map(lanes).drivable
    chosen = [i for i in range(0, len(route.path), 3) if shapely.contains_xy(free, *route.path[i])]
    left, right = brute_force_bounds(route, chosen, free)
    np.testing.assert_allclose(route.left[chosen], left, atol=1e-6)
    np.testing.assert_allclose(route.right[chosen], right, atol=1e-6)
    assert np.all(route.outer_left >= route.left)
    assert np.all(route.outer_right <= route.right)


def test_a_post_between_two_path_points_bounds_both_sides() -> None:
    """A hole of 20 cm beside the path that no normal meets."""
    path = np.column_stack([np.arange(0.0, 40.0, 0.5), np.zeros(80)])
    post = shapely.box(10.15, 0.8, 10.35, 1.0)
    area = shapely.box(-1.0, -3.0, 41.0, 3.0).difference(post)
    roads = RoadMap((), area)
    left, right = Corridor.of_area(path, roads).bounds(path, np.zeros(80))
    np.testing.assert_allclose(left[[20, 21]], 0.8)
    np.testing.assert_allclose(np.delete(left, [20, 21]), 3.0)
    np.testing.assert_allclose(right, -3.0)


def recorded(step: int) -> list[Path]:
    root = os.environ.get("DOSPLAN_DATA")
    if root is None:
        pytest.skip("DOSPLAN_DATA is not set")
    folder = Path(root) / "commonroad"
    return sorted([*folder.glob("val/*.xml"), *folder.glob("train/*.xml")])[::step]


def check_recorded(files: Sequence[Path]) -> None:
    """Where the route is on the map, a car on the path is on the road and the bounds hold."""
    shares = []
    for file in files:
        scenario = load_scenario(file)
        route, area = scenario.task.route, scenario.road_map.drivable
        part = _in_the_corridor(scenario)
        poses = np.column_stack([route.path, route.heading])[part]
        shapely.prepare(area)
        inside = shapely.covers(area, shapely.polygons(rectangle_corners(poses, VEHICLE.size)))
        shares.append(inside.mean() if len(inside) else 1.0)
        chosen = part[::25].tolist()
        left, right = brute_force_bounds(route, chosen, area)
        assert np.all(route.left[chosen] <= left + 1e-6), file.name
        assert np.all(route.right[chosen] >= right - 1e-6), file.name
    # Some recorded maps have spots narrower than a car, or sharper than a car's length can turn.
    assert np.mean(shares) > 0.99
    assert min(shares) > 0.9


def _in_the_corridor(scenario: Scenario) -> IntArray:
    """Path points from the ego on to 6 m before the path leaves the corridor."""
    route, start = scenario.task.route, VEHICLE.centre(scenario.task.start)
    first = int(np.hypot(*(route.path - start).T).argmin())
    inside = shapely.contains_xy(scenario.road_map.drivable, route.path[first:])
    off_corridor = (route.left[first:] == OFF_ROAD) & (route.right[first:] == -OFF_ROAD)
    outside = np.flatnonzero(~inside | off_corridor)
    count = int(outside[0]) - 12 if len(outside) else len(route.path) - first
    return np.arange(first, first + max(count, 0))


@pytest.mark.parametrize("part", range(3))
def test_recorded_paths_stay_on_the_road(part: int) -> None:
    check_recorded(recorded(25)[part::3])


@pytest.mark.slow
def test_every_recorded_path_stays_on_the_road() -> None:
    check_recorded(recorded(1))


def test_clearance_is_signed() -> None:
    roads = road_map(scenes.straight_road(lanes=1))
    path = np.stack([np.linspace(0.0, 200.0, 401), np.zeros(401)], axis=1)
    corridor = Corridor.along(path, roads, [100], frozenset({100}))
    points = np.array([[50.0, 0.0], [50.0, 1.0], [50.0, 2.0]])
    np.testing.assert_allclose(corridor.clearance(points), [1.75, 0.75, -0.25], atol=1e-9)
