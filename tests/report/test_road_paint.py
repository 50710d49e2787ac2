"""What is drawn of a road besides its surface, before anybody draws it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dosplan.report.palette import LAMP_COLOURS
from dosplan.report.road_paint import (
    Look,
    crosswalks,
    lamps,
    lines,
    plates,
    stop_lines,
    units,
)
from dosplan.scenario.synthetic import LANE_WIDTH
from dosplan.types import (
    COLOURS,
    Incoming,
    Intersection,
    LightColour,
    LineMarking,
    RoadMap,
    SignRule,
    TrafficSign,
)
from tests.support.lights import STOP_X, TURNS_GREEN, regulated_scenario


@pytest.fixture
def road_map() -> RoadMap:
    return regulated_scenario().road_map


def test_a_bound_of_two_lanelets_is_one_line_and_the_painted_one_counts(road_map: RoadMap) -> None:
    # The other lane does not say what its right bound is, and it may be listed first.
    swapped = replace(road_map, lanelets=road_map.lanelets[::-1])
    for one in (road_map, swapped):
        found = {(line.points[0, 1], line.look) for line in lines(one)}
        assert found == {
            (-0.5 * LANE_WIDTH, Look.SOLID),
            (0.5 * LANE_WIDTH, Look.DASHED),
            (1.5 * LANE_WIDTH, Look.BOUND),
        }


def test_two_lines_that_differ_lie_on_their_sides(road_map: RoadMap) -> None:
    own = replace(road_map.lanelets[0], left_marking=LineMarking.SOLID_DASHED)
    y = {
        line.look: line.points[:, 1].mean()
        for line in lines(replace(road_map, lanelets=(own,)))
        if line.points[:, 1].mean() > 0.0
    }
    assert y[Look.SOLID] > 0.5 * LANE_WIDTH > y[Look.DASHED]
    assert y[Look.SOLID] - y[Look.DASHED] == pytest.approx(0.3)


def test_every_marking_has_a_look(road_map: RoadMap) -> None:
    for marking in LineMarking:
        own = replace(road_map.lanelets[0], left_marking=marking)
        assert lines(replace(road_map, lanelets=(own,)))


def test_a_crosswalk_is_drawn_where_it_is_on_the_road(road_map: RoadMap) -> None:
    (walk,) = crosswalks(road_map)
    assert walk.width == pytest.approx(4.0)
    assert sorted(walk.centre[:, 1]) == pytest.approx([-0.5 * LANE_WIDTH, 1.5 * LANE_WIDTH])
    assert len(stop_lines(road_map)) == 2


def test_lights_that_differ_are_lamps_from_left_to_right() -> None:
    scenario = regulated_scenario()
    left, ahead, other = lamps(scenario.road_map, scenario.signals)
    assert left.place == pytest.approx([STOP_X, LANE_WIDTH / 6.0])
    assert ahead.place == pytest.approx([STOP_X, -LANE_WIDTH / 6.0])
    assert other.place == pytest.approx([STOP_X, LANE_WIDTH])
    shown = [COLOURS[left.at(step)] for step in (0, TURNS_GREEN - 1, TURNS_GREEN, 999)]
    assert shown == [LightColour.RED, LightColour.RED, LightColour.GREEN, LightColour.GREEN]


def test_lights_that_always_agree_are_one_lamp() -> None:
    scenario = regulated_scenario()
    colours = scenario.signals.colours.copy()
    colours[0] = colours[1]
    own, _ = lamps(scenario.road_map, replace(scenario.signals, colours=colours))
    assert own.place == pytest.approx([STOP_X, 0.0])


def test_a_light_that_nobody_knows_anything_of_is_not_drawn() -> None:
    scenario = regulated_scenario()
    road_map = replace(scenario.road_map, lights=())
    assert lamps(road_map, scenario.signals) == []


def test_colours_of_lamps_differ_and_red_with_yellow_shows_both() -> None:
    by_name = dict(zip(COLOURS, LAMP_COLOURS, strict=True))
    assert len(set(LAMP_COLOURS)) == len(COLOURS)
    red, yellow = by_name[LightColour.RED][0], by_name[LightColour.YELLOW][0]
    assert by_name[LightColour.RED_YELLOW] == (red, yellow)


def test_a_sign_beside_each_lane_is_drawn_once(road_map: RoadMap) -> None:
    first = road_map.signs[0]
    beside = replace(first, id=60, position=np.array([10.0, 0.5 * LANE_WIDTH]))
    further = replace(first, id=61, position=np.array([60.0, -0.5 * LANE_WIDTH]))
    slower = replace(beside, id=62, speed=30.0 / 3.6)
    found = plates(replace(road_map, signs=(first, beside, further, slower)))
    assert [(plate.text, plate.place[0]) for plate in found] == [
        ("50", 10.0),
        ("50", 60.0),
        ("30", 10.0),
    ]
    assert units(found) == "km/h"


def test_limits_of_the_usa_are_in_miles_per_hour(road_map: RoadMap) -> None:
    sign = TrafficSign(1, "R2-1", SignRule.SPEED_LIMIT, 35.0 * 0.44704, lanelets=(1,))
    (plate,) = plates(replace(road_map, signs=(sign,)))
    assert (plate.text, plate.unit) == ("35", "mph")
    # It stands beside the beginning of its lanelet where the file names no place.
    np.testing.assert_array_equal(plate.place, road_map.lanelets[0].right[0])


def test_signs_that_say_nothing_of_speed_or_priority_are_left_out(road_map: RoadMap) -> None:
    sign = replace(road_map.signs[0], rule=SignRule.OTHER)
    assert plates(replace(road_map, signs=(sign,))) == []


def test_inside_an_intersection_only_paint_is_drawn(road_map: RoadMap) -> None:
    crossing = Intersection(1, (Incoming(1, (1,), straight=(2,)),))
    before, after = (
        [line.look for line in lines(replace(road_map, intersections=found))]
        for found in ((), (crossing,))
    )
    assert before.count(Look.BOUND) - after.count(Look.BOUND) == 1
    assert Look.DASHED in after
