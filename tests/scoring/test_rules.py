"""The rules of the road by recordings that kept them, and by what must not change a verdict.

Both sides of every threshold are golden scenes (``tests/golden``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from suitegen.verdict import recorded_episode

from dosplan.geometry import lanelet_union
from dosplan.scenario import load_scenario
from dosplan.scenario.synthetic import straight_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import known_drive
from dosplan.types import (
    COLOURS,
    EGO_VELOCITY,
    EGO_X,
    Arm,
    Episode,
    FloatArray,
    GoalState,
    Lanelet,
    LightColour,
    LineMarking,
    RoadMap,
    RoadUserKind,
    Scenario,
    Signals,
    SignRule,
    StopLine,
    TrafficLight,
    TrafficSign,
)
from dosplan.vehicle import VehicleParameters
from tests.support.suite import SUITE, Row, drives, each

VEHICLES = (RoadUserKind.CAR, RoadUserKind.TRUCK, RoadUserKind.BUS, RoadUserKind.MOTORCYCLE)


def by_recorded_vehicles(scenario: Scenario) -> Iterator[tuple[Scenario, Episode]]:
    """Each recorded vehicle as the ego of a drive among nobody."""
    tracks = scenario.tracks
    for row, kind in enumerate(tracks.kinds):
        steps = np.flatnonzero(tracks.valid[row])
        if kind in VEHICLES and len(steps) > 1 and len(steps) == steps[-1] - steps[0] + 1:
            length, width = tracks.size[row]
            vehicle = replace(scenario.task.vehicle, length=float(length), width=float(width))
            task = replace(scenario.task, vehicle=vehicle, final_step=10_000)
            alone = replace(
                tracks,
                valid=np.zeros_like(tracks.valid),
                states=np.full_like(tracks.states, np.nan),
            )
            states = np.array(
                [vehicle.state_at(x[:2], x[2], x[3]) for x in tracks.states[row, steps]]
            )
            scene = replace(scenario, task=task, tracks=alone)
            yield scene, known_drive(scene, Arm.WITH_DOS, int(steps[0]), states)


def swapped(signals: Signals) -> Signals:
    """The lights with red for green and green for red."""
    red, green = COLOURS.index(LightColour.RED), COLOURS.index(LightColour.GREEN)
    other = {red: green, green: red}
    colours = np.array([[other.get(c, c) for c in row] for row in signals.colours.tolist()])
    return replace(signals, colours=colours.reshape(signals.colours.shape))


@pytest.mark.parametrize("row", each())
def test_recorded_drives_of_the_suite_keep_the_rules(row: Row) -> None:
    """SUMO moved them, and it obeys lights, stop signs and lanes."""
    scenario = load_scenario(SUITE / row["file"], cached=True)
    found = score(scenario, recorded_episode(scenario, drives()[row["id"]])).measures
    assert found["red_lights"] == (0 if scenario.road_map.lights else None)
    assert not found["stop_lines_ignored"]
    assert found["wrong_way"] == pytest.approx(0.0, abs=0.05)
    assert found["driving_direction_compliance"] == 1.0
    assert found["making_progress"]


@pytest.mark.parametrize("row", each("signalised crossing"))
def test_no_recorded_vehicle_runs_a_red_light(row: Row) -> None:
    """And with red for green, those that pass a line at green run one: the metric is not blind."""
    scenario = load_scenario(SUITE / row["file"], cached=True)
    runs = {"as it was": 0.0, "swapped": 0.0}
    for scene, episode in by_recorded_vehicles(scenario):
        runs["as it was"] += score(scene, episode).measures["red_lights"] or 0
        other = replace(scene, signals=swapped(scene.signals))
        runs["swapped"] += score(other, episode).measures["red_lights"] or 0
    assert runs["as it was"] == 0
    assert runs["swapped"] > 0


def scene(
    velocities: FloatArray, colours: list[int], heading: float, offset: FloatArray
) -> tuple[Scenario, Episode]:
    """A drive along a road with a light at x = 50 m and a solid line on its left, turned and moved.

    The limit is 8 m/s.
    """
    cos, sin = np.cos(heading), np.sin(heading)

    def placed(points: npt.ArrayLike) -> FloatArray:
        return np.asarray(np.asarray(points) @ np.array([[cos, sin], [-sin, cos]]) + offset)

    lanelets = tuple(
        Lanelet(
            name,
            placed([[begin, 1.75], [end, 1.75]]),
            placed([[begin, -1.75], [end, -1.75]]),
            successors,
            speed_limit=8.0,
            left_marking=LineMarking.SOLID,
            lights=lights,
        )
        for name, begin, end, successors, lights in (
            (1, 0.0, 50.0, (2,), (9,)),
            (2, 50.0, 200.0, (), ()),
        )
    )
    road_map = RoadMap(lanelets, lanelet_union(lanelets), lights=(TrafficLight(9, lanelets=(1,)),))
    numbers = np.array([colours])
    x = np.concatenate([[30.0], 30.0 + 0.1 * np.cumsum(velocities[:-1])])
    centres = placed(np.column_stack([x, 0.0 * x]))
    base = straight_scenario(final_step=500, goals=[GoalState(500, 500)])
    vehicle = base.task.vehicle
    states = np.array(
        [vehicle.state_at(c, heading, v) for c, v in zip(centres, velocities, strict=True)]
    )
    scenario = replace(
        base,
        road_map=road_map,
        task=replace(base.task, start=states[0]),
        signals=Signals(np.array([9]), numbers, np.zeros(numbers.shape)),
    )
    return scenario, known_drive(scenario, Arm.WITH_DOS, 0, states)


velocity = st.lists(st.floats(0.0, 15.0), min_size=2, max_size=60).map(np.array)
shown = st.lists(st.integers(0, len(COLOURS) - 1), min_size=60, max_size=60)
RED = COLOURS.index(LightColour.RED)


@given(
    velocities=velocity,
    colours=shown,
    heading=st.floats(-4.0, 4.0),
    offset=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(np.array),
)
@settings(max_examples=100, deadline=None)
def test_what_holds_for_any_drive_along_a_lane(
    velocities: FloatArray, colours: list[int], heading: float, offset: FloatArray
) -> None:
    x = np.concatenate([[0.0], 0.1 * np.cumsum(velocities[:-1])]) + 30.0
    assume(np.abs(x + 0.5 * VehicleParameters().length - 50.0).min() > 1e-6)
    origin = np.zeros(2)
    found: dict[str, Any] = dict(score(*scene(velocities, colours, heading, offset)).measures)
    there = score(*scene(velocities, colours, 0.0, origin)).measures
    always: dict[str, Any] = dict(score(*scene(velocities, [RED] * 60, 0.0, origin)).measures)
    green = [c if not COLOURS[c].forbids else COLOURS.index(LightColour.GREEN) for c in colours]
    never = score(*scene(velocities, green, 0.0, origin)).measures
    passes = x[-1] + 0.5 * VehicleParameters().length > 50.0
    assert always["red_lights"] == int(passes)
    assert never["red_lights"] == 0
    assert found["red_lights"] == there["red_lights"] <= always["red_lights"]
    assert found["solid_lines"] == 0
    assert found["wrong_way"] == pytest.approx(0.0, abs=1e-9)
    assert found["max_overspeed"] == pytest.approx(max(velocities.max() - 8.0, 0.0))
    assert 0.0 <= found["speed_limit_compliance"] <= 1.0
    assert 0.0 <= found["nuplan_score"] <= 1.0


def test_a_stop_line_is_passed_once_though_lanelets_overlap_there() -> None:
    """Two lanelets come together before the line, as where ways from a fork meet again."""
    straight = straight_scenario(velocity=10.0, final_step=50)
    x = np.arange(-50.0, 61.0, 10.0)
    side = np.full(len(x), 1.75)
    line = StopLine(np.array([[40.0, 1.75], [40.0, -1.75]]), signs=(9,))
    before = [
        Lanelet(
            id=name,
            left=np.stack([x, side], axis=1),
            right=np.stack([x, -side], axis=1),
            stop_line=line,
            signs=(9,),
        )
        for name in (1, 2)
    ]
    sign = TrafficSign(9, "206", SignRule.STOP, lanelets=(1, 2))
    road_map = replace(straight.road_map, lanelets=tuple(before), signs=(sign,))
    scenario = replace(straight, road_map=road_map)
    states = np.zeros((51, 5))
    states[:, EGO_X], states[:, EGO_VELOCITY] = np.arange(51.0), 10.0
    found = score(scenario, known_drive(scenario, Arm.WITH_DOS, 0, states))
    assert found.measures["stop_lines_ignored"] == 1
