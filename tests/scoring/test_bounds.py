"""The drivable area, and which lane the ego is in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.geometry import lanelet_polygon, lanelet_union, rectangle_corners
from dosplan.scoring.bounds import HAIRLINE, outside, outside_lanelets
from dosplan.scoring.fault import in_several_lanes
from dosplan.types import Lanelet, RoadMap

SIZE = (4.0, 2.0)


def lane(
    id_: int, x: tuple[float, float], y: tuple[float, float], successors: tuple[int, ...] = ()
) -> Lanelet:
    """A rectangular lanelet along +x."""
    left = np.array([[x[0], y[1]], [x[1], y[1]]])
    right = np.array([[x[0], y[0]], [x[1], y[0]]])
    return Lanelet(id_, left, right, successors)


def road(*lanelets: Lanelet) -> RoadMap:
    areas = [shapely.Polygon(np.concatenate([x.left, x.right[::-1]])) for x in lanelets]
    return RoadMap(lanelets, shapely.union_all(areas))


ROAD = road(lane(1, (0.0, 50.0), (-2.0, 2.0)))


@given(x=st.floats(-2.0, 52.0), y=st.floats(-3.0, 3.0), heading=st.floats(-4.0, 4.0))
@settings(max_examples=200, deadline=None)
def test_outside_is_what_sticks_out_by_more_than_a_hairline(
    x: float, y: float, heading: float
) -> None:
    pose = np.array([x, y, heading])
    corners = rectangle_corners(pose, SIZE)
    over = max(-corners[:, 0].min(), corners[:, 0].max() - 50.0, np.abs(corners[:, 1]).max() - 2.0)
    found = bool(outside(pose[None], SIZE, ROAD)[0])
    # A disc of diameter HAIRLINE cannot fit into less; it fits into a right corner that is out by
    # (1 + sqrt 2) / 2 times that.
    assert not (found and over < HAIRLINE - 1e-6)
    assert found or over < 1.21 * HAIRLINE


def test_poses_are_judged_one_by_one() -> None:
    poses = np.array([[10.0, 0.0, 0.0], [10.0, 1.5, 0.0], [10.0, 0.5, 0.0], [60.0, 0.0, 0.0]])
    assert outside(poses, SIZE, ROAD).tolist() == [False, True, False, True]


def test_a_hole_in_the_road_is_outside() -> None:
    holed = RoadMap(ROAD.lanelets, ROAD.drivable.difference(shapely.box(20.0, -0.1, 20.2, 0.1)))
    assert outside(np.array([[20.0, 0.0, 0.0]]), SIZE, holed)[0]
    assert not outside(np.array([[30.0, 0.0, 0.0]]), SIZE, holed)[0]


def test_commonroads_road_is_every_lanelet_and_ends_with_the_map() -> None:
    # A sidewalk on the left, 0.1 m beside the lane; the map is cut off at x = 50 m.
    lanelets = (
        lane(1, (0.0, 50.0), (-2.0, 2.0)),
        replace(lane(2, (0.0, 50.0), (2.1, 5.0)), is_road=False),
        lane(3, (900.0, 950.0), (-2.0, 2.0)),
    )
    drivable = lanelet_union(x for x in lanelets if x.is_road)
    road_map = RoadMap(lanelets, drivable, shapely.box(50.0, -2.0, 55.0, 2.0))
    poses = np.array(
        [
            [20.0, 0.0, 0.0],  # On the lane.
            [20.0, 2.0, 0.0],  # On the sidewalk with its left side.
            [20.0, 3.5, 0.0],
            [20.0, 4.5, 0.0],  # Beyond the sidewalk.
            [20.0, -1.5, 0.0],
            [49.0, 0.0, 0.0],  # A metre over the map's end.
        ]
    )
    ours, theirs = (judge(poses, SIZE, road_map).tolist() for judge in (outside, outside_lanelets))
    assert ours == [False, True, True, True, True, False]
    assert theirs == [False, False, False, True, True, True]


@pytest.mark.parametrize(("y", "several"), [(0.99, False), (1.01, True), (1.99, True)])
def test_two_lanes_side_by_side(y: float, several: bool) -> None:
    two = road(lane(1, (0.0, 50.0), (-2.0, 2.0)), lane(2, (0.0, 50.0), (2.0, 6.0)))
    assert in_several_lanes(np.array([20.0, y, 0.0]), SIZE, two) is several


def test_a_lanelet_and_its_successors_are_one_lane() -> None:
    # The middle one is shorter than the ego: no corner lies in it.
    chain = (
        lane(1, (0.0, 20.0), (-2.0, 2.0), (2,)),
        lane(2, (20.0, 21.0), (-2.0, 2.0), (3,)),
        lane(3, (21.0, 50.0), (-2.0, 2.0)),
    )
    pose = np.array([20.5, 0.0, 0.0])
    assert not in_several_lanes(pose, SIZE, road(*chain))
    cut = (lane(1, (0.0, 20.0), (-2.0, 2.0)), *chain[1:])
    assert in_several_lanes(pose, SIZE, road(*cut))


def test_a_ring_of_lanelets_ends() -> None:
    ring = (
        lane(1, (0.0, 20.0), (-2.0, 2.0), (2,)),
        lane(2, (20.0, 50.0), (-2.0, 2.0), (1,)),
        lane(3, (0.0, 50.0), (2.0, 6.0)),
    )
    assert not in_several_lanes(np.array([20.0, 0.0, 0.0]), SIZE, road(*ring))
    assert in_several_lanes(np.array([20.0, 1.5, 0.0]), SIZE, road(*ring))


def test_two_branches_of_a_fork_are_two_lanes() -> None:
    # Both follow lanelet 1; the front corners are in one branch each.
    fork = (
        lane(1, (0.0, 20.0), (-2.0, 2.0), (2, 3)),
        lane(2, (20.0, 50.0), (0.0, 4.0)),
        lane(3, (20.0, 50.0), (-4.0, 0.0)),
    )
    assert in_several_lanes(np.array([20.0, 0.0, 0.0]), SIZE, road(*fork))
    assert not in_several_lanes(np.array([20.0, 1.0, 0.0]), SIZE, road(*fork))


def test_a_crossing_lane_that_holds_the_ego_is_enough() -> None:
    crossing = road(lane(1, (0.0, 20.0), (-2.0, 2.0)), lane(2, (10.0, 40.0), (-9.0, 9.0)))
    assert not in_several_lanes(np.array([20.0, 0.0, 0.0]), SIZE, crossing)


def test_a_corner_beside_every_lane_is_left_out() -> None:
    assert not in_several_lanes(np.array([20.0, 1.01, 0.0]), SIZE, ROAD)
    assert not in_several_lanes(np.array([20.0, 30.0, 0.0]), SIZE, ROAD)


def test_a_lanelet_whose_bounds_cross_has_the_area_that_the_road_has() -> None:
    # Its second cell is 20 m long and its bounds cross in the middle, at x = 40; the outline is a
    # bow tie there, 0.8 m wide at the ego's front. The hull of the cell holds all of the ego.
    left = np.array([[0.0, 2.0], [30.0, 2.0], [50.0, -2.0]])
    crossed = Lanelet(1, left, left * [1.0, -1.0])
    area = lanelet_polygon(crossed.left, crossed.right)
    assert area.equals(shapely.box(0.0, -2.0, 50.0, 2.0))
    beside = lane(2, (37.0, 50.0), (-2.0, 2.0))
    roads = RoadMap((crossed, beside), area)
    assert not in_several_lanes(np.array([36.0, 0.0, 0.0]), SIZE, roads)
