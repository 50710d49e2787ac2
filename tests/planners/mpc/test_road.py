"""The road beside the ego: an ego that is moved aside meets the edge where it is said to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from dosplan_mpc.config import PathSettings
from dosplan_mpc.reference import LanePath
from dosplan_mpc.road import REACH, Road
from dosplan_mpc.shape import STATIONS
from dosplan_mpc.stage import Edge, Station
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.geometry import rectangle_corners
from dosplan.types import FloatArray, RoadMap, Route
from dosplan.vehicle import VehicleParameters

EGO = VehicleParameters()
NONE = (np.full(1, -np.inf), np.full(1, np.inf))
CENTRE = STATIONS // 2


def straight_route(left: float = 3.0, outer_left: float = 3.0) -> Route:
    """A path along x from -50 m to 50 m, 3 m of road to its right."""
    s = np.arange(0.0, 100.5, 0.5)
    one = np.ones(len(s))
    return Route(
        lanelet_ids=(1,),
        arclength=s,
        path=np.column_stack([s - 50.0, 0.0 * s]),
        heading=0.0 * s,
        curvature=0.0 * s,
        left=left * one,
        right=-3.0 * one,
        outer_left=outer_left * one,
        outer_right=-3.0 * one,
        speed_limit=np.inf * one,
    )


def path_of(route: Route) -> LanePath:
    return LanePath(route, PathSettings())


def road_of(area: shapely.Geometry, path: LanePath | None = None) -> Road:
    path = path_of(straight_route()) if path is None else path
    return Road(RoadMap((), area), path, EGO, EGO.width / 2.0, shapely.Polygon())


def state_at(x: float, y: float, heading: float) -> FloatArray:
    """(1, 5) an ego whose centre is there."""
    return EGO.state_at(np.array([x, y]), heading, 5.0)[None]


def beside(road: Road, state: FloatArray) -> Station:
    return road.beside(state, state[:, 0] + 50.0, *NONE)


def room(state: FloatArray, edge: Edge, side: float) -> FloatArray:
    """(STATIONS,) how much of the way to an edge the optimal control problem leaves, m."""
    x, y, heading = (edge.line[0, :, k] for k in range(3))
    ahead = edge.ahead[0]
    along, across = np.cos(state[0, 4]), np.sin(state[0, 4])
    dx, dy = state[0, 0] + ahead * along - x, state[0, 1] + ahead * across - y
    offset = -np.sin(heading) * dx + np.cos(heading) * dy
    return np.asarray(side * (edge.bound[0] - offset) - EGO.width / 2.0)


def rooms(road: Road, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """To the right and to the left."""
    found = beside(road, state)
    return room(state, found.right, -1.0), room(state, found.left, 1.0)


HALF = EGO.width / 2.0
STRAIGHT = shapely.box(-50.0, -3.0, 50.0, 3.0)


def test_the_edges_of_a_straight_road_are_as_far_as_they_are() -> None:
    right, left = rooms(road_of(STRAIGHT), state_at(0.0, 1.0, 0.0))
    np.testing.assert_allclose(left, 2.0 - HALF, atol=1e-9)
    np.testing.assert_allclose(right, 4.0 - HALF, atol=1e-9)


def test_a_corner_between_two_stations_counts_where_it_is() -> None:
    # A wedge whose tip is at (0.3, -1.2): between the stations at 0 and at 1.1 m.
    wedge = shapely.Polygon([(0.3, -1.2), (0.5, -3.0), (0.1, -3.0)])
    state = state_at(0.0, 0.0, 0.0)
    found = beside(road_of(STRAIGHT - wedge), state)
    assert room(state, found.right, -1.0)[CENTRE] == pytest.approx(1.2 - HALF)
    assert found.right.ahead[0, CENTRE] == pytest.approx(EGO.rear_to_centre + 0.3)
    assert found.right.line[0, CENTRE, 2] == 0.0  # The corner is a point: along the ego's axis.
    assert room(state, found.right, -1.0)[0] == pytest.approx(3.0 - HALF)


def test_an_edge_is_a_line_of_its_own_direction() -> None:
    """A road that narrows: driven on, the ego's front comes nearer to an edge that is turned."""
    funnel = shapely.Polygon([(-50.0, -3.0), (0.0, -3.0), (6.0, 0.0), (6.0, 3.0), (-50.0, 3.0)])
    state = state_at(-1.0, 0.0, 0.0)
    found = beside(road_of(funnel), state)
    front = STATIONS - 1
    assert found.right.line[0, front, 2] == pytest.approx(np.arctan2(3.0, 6.0))
    corner = shapely.Point(-1.0 + EGO.length / 2.0, -HALF)
    edge = shapely.LineString([(0.0, -3.0), (6.0, 0.0)])
    assert room(state, found.right, -1.0)[front] == pytest.approx(edge.distance(corner), abs=1e-6)


def test_an_edge_that_no_part_of_the_ego_is_beside_does_not_count() -> None:
    ahead = shapely.box(3.0, -3.0, 50.0, -0.5)  # 0.75 m before the front bumper.
    right, _ = rooms(road_of(STRAIGHT - ahead), state_at(0.0, 0.0, 0.0))
    np.testing.assert_allclose(right, 3.0 - HALF, atol=1e-9)


def test_off_the_road_the_edges_beside_the_path_count() -> None:
    state = state_at(0.0, 5.0, 0.0)
    found = beside(road_of(STRAIGHT), state)
    np.testing.assert_allclose(room(state, found.left, 1.0), -2.0 - HALF, atol=1e-6)
    np.testing.assert_allclose(room(state, found.right, -1.0), 8.0 - HALF, atol=1e-6)
    np.testing.assert_allclose(found.left.line[..., 1], 0.0, atol=1e-6)  # Offsets from the path.


def test_a_lane_against_the_route_is_an_edge_although_it_is_road() -> None:
    route = straight_route(left=1.5, outer_left=6.0)
    area = shapely.box(-50.0, -3.0, 50.0, 6.0)
    road = road_of(area, path_of(route))
    right, left = rooms(road, state_at(0.0, 0.5, 0.0))
    np.testing.assert_allclose(left, 1.0 - HALF, atol=1e-6)
    np.testing.assert_allclose(right, 3.5 - HALF, atol=1e-6)


def test_a_lane_that_is_opened_is_no_edge() -> None:
    path = path_of(straight_route(left=1.5, outer_left=6.0))
    road = road_of(shapely.box(-50.0, -3.0, 50.0, 6.0), path)
    state = state_at(0.0, 0.5, 0.0)
    path.open(30.0, 70.0, 1.0)
    np.testing.assert_allclose(rooms(road, state)[1], 5.5 - HALF, atol=1e-6)
    path.open(80.0, 90.0, 1.0)
    np.testing.assert_allclose(rooms(road, state)[1], 1.0 - HALF, atol=1e-6)
    path.open(30.0, 70.0, -1.0)
    np.testing.assert_allclose(rooms(road, state)[1], 1.0 - HALF, atol=1e-6)
    path.close()
    np.testing.assert_allclose(rooms(road, state)[1], 1.0 - HALF, atol=1e-6)


def test_a_goal_bounds_the_middle_of_the_ego_alone() -> None:
    state = state_at(0.0, 0.5, 0.0)
    road = road_of(STRAIGHT)
    found = road.beside(state, state[:, 0] + 50.0, np.full(1, -0.7), np.full(1, np.inf))
    right = room(state, found.right, -1.0)
    assert right[CENTRE] == pytest.approx(1.2 - HALF)
    assert found.right.ahead[0, CENTRE] == pytest.approx(EGO.rear_to_centre)
    np.testing.assert_allclose(np.delete(right, CENTRE), 3.5 - HALF, atol=1e-9)
    np.testing.assert_allclose(room(state, found.left, 1.0), 2.5 - HALF, atol=1e-9)


@st.composite
def roads(draw: st.DrawFn) -> shapely.Geometry:
    """A road of 6 m with pieces cut out of both sides."""
    road = shapely.box(-50.0, -3.0, 50.0, 3.0)
    for side in (-1.0, 1.0):
        for _ in range(draw(st.integers(0, 3))):
            x, width = draw(st.floats(-4.0, 4.0)), draw(st.floats(0.2, 3.0))
            y = draw(st.floats(1.1, 2.9))
            tip = draw(st.floats(-0.5, 0.5)) * width
            road -= shapely.Polygon(
                [(x - width, 3.5 * side), (x + tip, y * side), (x + width, 3.5 * side)]
            )
    return road


@settings(max_examples=200, deadline=None)
@given(area=roads(), heading=st.floats(-0.15, 0.15), y=st.floats(-0.2, 0.2))
def test_the_room_is_positive_just_where_the_ego_is_on_the_road(
    area: shapely.Geometry, heading: float, y: float
) -> None:
    """Moved aside until no room is left, the ego is at the edge of the road."""
    state = state_at(0.0, y, heading)
    if not area.covers(outline(state)):
        return
    for side, index in ((1.0, 1), (-1.0, 0)):
        way = 0.0
        for _ in range(60):  # Newton's method of a road that is linear near its edge.
            left = float(np.min(rooms(road_of(area), moved(state, side * way))[index]))
            if abs(left) < 1e-3 or not 0.0 <= way < REACH:
                break
            way += 0.9 * left
        if abs(left) < 1e-3:
            assert area.buffer(0.02).covers(outline(moved(state, side * way)))
            assert not area.buffer(-0.02).covers(outline(moved(state, side * way)))


def outline(state: FloatArray) -> shapely.Polygon:
    return shapely.Polygon(rectangle_corners(EGO.poses(state), EGO.size)[0])


def moved(state: FloatArray, aside: float) -> FloatArray:
    heading = state[0, 4]
    shift = aside * np.array([-np.sin(heading), np.cos(heading), 0.0, 0.0, 0.0])
    return np.asarray(state + shift)


def test_a_map_without_an_edge_nearby_bounds_nothing() -> None:
    wide = replace(straight_route(left=100.0, outer_left=100.0), right=np.full(201, -100.0))
    wide = replace(wide, outer_right=wide.right)
    everywhere = shapely.box(-500.0, -500.0, 500.0, 500.0)
    for side in rooms(road_of(everywhere, path_of(wide)), state_at(0.0, 0.0, 0.0)):
        np.testing.assert_allclose(side, REACH - HALF)


def test_another_road_that_just_touches_the_stretch_that_is_looked_at_is_none_of_it() -> None:
    # Its edge lies on the border of what is cut out along the path.
    border = 2.0 * REACH
    along_path, other = shapely.box(-100.0, -3.0, 100.0, 3.0), (-50.0, border, 50.0, border + 3.0)
    road = road_of(shapely.MultiPolygon([along_path, shapely.box(*other)]))
    assert road.area.equals(road_of(along_path).area)


# How far the ego's outline reaches beyond the edges


def outside(road: Road, *states: FloatArray) -> FloatArray:
    """(C,) of egos at one time each, beside the path along y = 0 from x = -50 m on."""
    together = np.stack(states)
    return road.outside(together, together[..., 0] + 50.0, together[..., 1])[:, 0]


@settings(max_examples=300, deadline=None)
@given(
    area=roads(),
    heading=st.floats(-0.5, 0.5),
    y=st.floats(-3.5, 3.5),
    x=st.floats(-6.0, 6.0),
)
def test_outside_is_zero_just_where_the_road_covers_the_outline(
    area: shapely.Geometry, heading: float, x: float, y: float
) -> None:
    state = state_at(x, y, heading)
    reaches = float(outside(road_of(area), state)[0])
    ego = outline(state)
    if area.buffer(-0.02).covers(ego):
        assert reaches == 0.0
    if not area.buffer(0.02).covers(ego):
        assert reaches > 0.0


def test_outside_says_how_far_and_one_state_as_many() -> None:
    road = road_of(STRAIGHT)
    egos = [state_at(0.0, y, 0.0) for y in (0.0, 2.0, 2.6, -3.5, 7.0)]
    expected = [0.0, 0.0, 0.6 - (1.0 - HALF), 0.5 + HALF, 4.0 + HALF]
    np.testing.assert_allclose(outside(road, *egos), expected, atol=1e-6)
    for ego, reaches in zip(egos, expected, strict=True):
        np.testing.assert_allclose(outside(road, ego), reaches, atol=1e-6)


def test_a_corner_that_reaches_into_the_outline_between_its_ends_is_outside() -> None:
    wedge = shapely.Polygon([(0.3, -0.7), (0.5, -3.0), (0.1, -3.0)])
    reaches = outside(road_of(STRAIGHT - wedge), state_at(0.0, 0.0, 0.0), state_at(5.0, 0.0, 0.0))
    np.testing.assert_allclose(reaches, [HALF - 0.7, 0.0], atol=1e-6)


def test_the_end_of_the_road_across_the_path_is_none_of_its_sides() -> None:
    road = road_of(shapely.box(-50.0, -3.0, 10.0, 3.0))
    reaches = outside(road, state_at(10.0, 0.0, 0.0), state_at(14.0, 0.0, 0.0))
    np.testing.assert_array_equal(reaches, 0.0)


def test_a_lane_against_the_route_is_outside_until_it_is_opened() -> None:
    path = path_of(straight_route(left=1.5, outer_left=6.0))
    road = road_of(shapely.box(-50.0, -3.0, 50.0, 6.0), path)
    state = state_at(0.0, 1.5, 0.0)
    np.testing.assert_allclose(outside(road, state), HALF, atol=1e-6)
    path.open(30.0, 70.0, 1.0)
    np.testing.assert_array_equal(outside(road, state), 0.0)
