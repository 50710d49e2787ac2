"""Lights by lane, on a hand-made road and on the suite, whose traffic keeps them (SUMO)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dosplan.geometry import NO_LIGHT, LightIndex, lights_at
from dosplan.scenario import load_scenario
from dosplan.scenario.synthetic import LANE_WIDTH
from dosplan.types import (
    COLOURS,
    FloatArray,
    Incoming,
    Intersection,
    Lanelet,
    LightColour,
    LightStates,
    RoadMap,
    RoadUserKind,
)
from tests.support.lights import AHEAD, LEFT, OTHER, STOP_X, TURNS_GREEN, regulated_scenario
from tests.support.suite import SUITE, Row, each

CAR = (4.0, 1.8)
RED, GREEN = COLOURS.index(LightColour.RED), COLOURS.index(LightColour.GREEN)
DRIVERS = (RoadUserKind.CAR, RoadUserKind.TRUCK, RoadUserKind.BUS, RoadUserKind.MOTORCYCLE)


def _sizes(states: FloatArray) -> FloatArray:
    return np.tile(CAR, (len(states), 1))


def _two_lanelets(road_map: RoadMap) -> RoadMap:
    """The map with another lanelet, 20 m long, before the ego's lane at x = -50 m."""
    own, *others = road_map.lanelets
    x, half = np.array([-70.0, -60.0, -50.0]), 0.5 * LANE_WIDTH
    before = Lanelet(
        id=7,
        left=np.stack([x, np.full(3, half)], axis=1),
        right=np.stack([x, np.full(3, -half)], axis=1),
        successors=(own.id,),
    )
    return replace(road_map, lanelets=(replace(own, predecessors=(7,)), before, *others))


def test_distance_is_from_the_front_to_the_line_of_the_own_lane() -> None:
    scenario = regulated_scenario()
    states = np.array(
        [
            [10.0, 0.3, 0.1, 5.0],  # The ego's lane: the left turn is red, which counts.
            [10.0, LANE_WIDTH, 0.0, 5.0],
            [29.0, LANE_WIDTH, 0.0, 0.0],  # Its front is over the line.
            [30.5, 0.0, 0.0, 5.0],  # Past it.
            [-30.0, 0.0, 0.0, 5.0],  # Too far away.
            [10.0, 0.0, np.pi, 5.0],  # Drives the other way.
            [10.0, 0.0, 0.5 * np.pi, 1.0],  # Crosses the road.
            [10.0, 20.0, 0.0, 5.0],  # Beside it.
        ]
    )
    index = LightIndex(scenario.road_map)
    found = index.ahead(states, _sizes(states), scenario.signals.at(5))
    np.testing.assert_allclose(found.distance, [18.0, 18.0, -1.0, *[np.inf] * 5])
    assert found.colour.tolist() == [RED, RED, RED, *[NO_LIGHT] * 5]
    np.testing.assert_allclose(found.seconds, [0.5, 0.5, 0.5, *[0.0] * 5])


def test_seconds_count_from_the_change() -> None:
    scenario = regulated_scenario()
    own, *others = scenario.road_map.lanelets
    own = replace(own, lights=(LEFT,), stop_line=None)
    road_map = replace(scenario.road_map, lanelets=(own, *others))
    # Without a line it is the lanelet's end that counts, at x = 400 m.
    states = np.array([[370.0, 0.0, 0.0, 5.0]])
    lights = scenario.signals.at(TURNS_GREEN + 3)
    found = LightIndex(road_map).ahead(states, _sizes(states), lights)
    assert found.colour.tolist() == [GREEN]
    np.testing.assert_allclose(found.distance, [400.0 - 370.0 - 2.0])
    np.testing.assert_allclose(found.seconds, [0.3])


def test_a_light_is_seen_from_the_lanelets_before() -> None:
    scenario = regulated_scenario()
    road_map = _two_lanelets(scenario.road_map)
    states = np.array([[-60.0, 0.0, 0.0, 5.0], [-50.0, 0.0, 0.0, 5.0]])
    far = LightIndex(road_map, reach=100.0).ahead(states, _sizes(states), scenario.signals.at(0))
    np.testing.assert_allclose(far.distance, STOP_X - states[:, 0] - 0.5 * CAR[0])
    near = LightIndex(road_map, reach=80.0).ahead(states, _sizes(states), scenario.signals.at(0))
    assert near.distance.tolist() == [np.inf, 78.0]


def test_a_line_where_its_lanelet_begins_holds_for_those_before() -> None:
    stop = -50.0
    scenario = regulated_scenario()
    road_map = _two_lanelets(scenario.road_map)
    own, *others = road_map.lanelets
    assert own.stop_line is not None
    line = np.stack([np.full(2, stop), [0.5 * LANE_WIDTH, -0.5 * LANE_WIDTH]], axis=1)
    own = replace(own, stop_line=replace(own.stop_line, ends=line))
    road_map = replace(road_map, lanelets=(own, *others))
    states = np.array([[-60.0, 0.0, 0.0, 5.0]])
    found = LightIndex(road_map).ahead(states, _sizes(states), scenario.signals.at(0))
    np.testing.assert_allclose(found.distance, stop - states[:, 0] - 0.5 * CAR[0])
    assert found.colour.tolist() == [RED]


def test_roads_without_lights_and_nobody_there() -> None:
    scenario = regulated_scenario()
    states = np.array([[10.0, 0.0, 0.0, 5.0]])
    dark = replace(scenario.road_map, lights=())
    found = LightIndex(dark).ahead(states, _sizes(states), LightStates())
    assert (found.distance.tolist(), found.colour.tolist()) == ([np.inf], [NO_LIGHT])
    nobody = np.empty((0, 4))
    found = LightIndex(scenario.road_map).ahead(nobody, np.empty((0, 2)), scenario.signals.at(0))
    assert found.distance.shape == (0,)


def test_a_light_that_is_off_is_inactive() -> None:
    scenario = regulated_scenario()
    states = np.array([[10.0, 0.0, 0.0, 5.0]])
    found = LightIndex(scenario.road_map).ahead(states, _sizes(states), LightStates())
    assert COLOURS[found.colour[0]] is LightColour.INACTIVE


def test_lights_for_ways_that_a_lane_does_not_have_do_not_hold() -> None:
    road_map = regulated_scenario().road_map
    own = replace(road_map.lanelets[0], successors=(20,))
    assert lights_at(road_map, own) == (LEFT, AHEAD)  # The map does not say where it goes.
    assert lights_at(road_map, road_map.lanelets[1]) == (OTHER,)
    straight = Intersection(1, (Incoming(1, (own.id,), left=(21,), straight=(20,)),))
    assert lights_at(replace(road_map, intersections=(straight,)), own) == (AHEAD,)


@pytest.mark.parametrize("row", each("signalised crossing"))
def test_sumo_stands_at_red_and_does_not_run_it(row: Row) -> None:
    scenario = load_scenario(SUITE / row["file"])
    tracks, index = scenario.tracks, LightIndex(scenario.road_map)
    drivers = np.array([kind in DRIVERS for kind in tracks.kinds])
    stood = 0
    before = np.full(len(tracks.ids), np.inf)
    for step in range(tracks.steps):
        here = np.flatnonzero(tracks.valid[:, step] & drivers)
        states = tracks.states[here, step]
        found = index.ahead(states, tracks.size[here], scenario.signals.at(step))
        red = found.colour == RED
        over = (before[here] > 0.0) & (found.distance <= 0.0)
        assert not np.any(over & red), f"somebody runs a red light at step {step}"
        stood += int(((states[:, 3] < 0.1) & (found.distance < 3.0) & red).sum())
        before[:] = np.inf
        before[here] = found.distance
    assert stood >= 20  # Steps at which somebody stands at the line, the light being red.
