"""The embedded suite beside CommonRoad's own definition and reader."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import commonroad
import numpy as np
import pytest
import shapely
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.util import FileFormat
from commonroad.scenario.traffic_light import TrafficLightState

from dosplan.vehicle import VehicleParameters
from tests.support.suite import ROWS, SUITE, Row, drives, each

SCHEMA = (
    Path(commonroad.__file__).parent
    / "scenario_definition/xml_definition_files/XML_commonRoad_XSD.xsd"
)
SIGNALISED = ("signalised crossing", "urban arterial", "urban grid")
VEHICLE = VehicleParameters()


def _read(row: Row) -> Any:
    """Scenario and planning problems, by commonroad-io."""
    data = gzip.decompress((SUITE / row["file"]).read_bytes())
    return CommonRoadFileReader(data, FileFormat.XML).open()


@pytest.mark.parametrize("row", each())
def test_file_obeys_the_schema(row: Row) -> None:
    etree = pytest.importorskip("lxml.etree", reason="lxml validates the schema")
    if not SCHEMA.exists():
        pytest.skip("this commonroad-io does not ship the schema")
    text = SCHEMA.read_text(encoding="utf-8")
    # The schema lets everyone begin at step 0 only, which recorded traffic cannot; the reader,
    # and CommonRoad's own recorded scenarios, do not insist.
    relaxed = text.replace('<xs:maxInclusive value="0"/>', "", 1)
    assert relaxed != text
    schema = etree.XMLSchema(etree.fromstring(relaxed.encode()))
    schema.assertValid(etree.fromstring(gzip.decompress((SUITE / row["file"]).read_bytes())))


@pytest.mark.parametrize("row", each())
def test_commonroad_io_reads_everything_back(row: Row) -> None:
    root = ElementTree.fromstring(gzip.decompress((SUITE / row["file"]).read_bytes()))
    scenario, problems = _read(row)
    network = scenario.lanelet_network
    for tag, read in (
        ("lanelet", network.lanelets),
        ("trafficLight", network.traffic_lights),
        ("intersection", network.intersections),
        ("dynamicObstacle", scenario.dynamic_obstacles),
        ("staticObstacle", scenario.static_obstacles),
        ("planningProblem", problems.planning_problem_dict),
    ):
        assert len(read) == len(root.findall(tag)), tag
    assert all(not lanelet.polygon.shapely_object.is_empty for lanelet in network.lanelets)


def _passages(row: Row) -> Iterator[tuple[Any, int]]:
    """Signals that moving traffic passes, with the step at which it does."""
    scenario, _ = _read(row)
    network = scenario.lanelet_network
    inside = {
        lanelet: (incoming, direction)
        for crossing in network.intersections
        for incoming in crossing.incomings
        for direction in ("right", "straight", "left")
        for lanelet in getattr(incoming, f"successors_{direction}")
    }
    for obstacle in scenario.dynamic_obstacles:
        states = [obstacle.initial_state, *obstacle.prediction.trajectory.state_list]
        reach = 0.5 * obstacle.obstacle_shape.length
        noses = np.array(
            [
                s.position + reach * np.array([np.cos(s.orientation), np.sin(s.orientation)])
                for s in states
            ]
        )
        for lanelet in network.lanelets:
            if not lanelet.traffic_lights:
                continue
            line = shapely.LineString([lanelet.left_vertices[-1], lanelet.right_vertices[-1]])
            steps = shapely.linestrings(np.stack([noses[:-1], noses[1:]], axis=1))
            crossed = np.flatnonzero(shapely.intersects(steps, line))
            if not crossed.size or not lanelet.polygon.contains_point(noses[crossed[0]]):
                continue
            later = shapely.points(noses[crossed[0] :])
            directions = {
                inside[way][1]
                for way in lanelet.successor
                for exit_ in network.find_lanelet_by_id(way).successor
                if shapely.contains(
                    network.find_lanelet_by_id(exit_).polygon.shapely_object, later
                ).any()
            }
            if len(directions) != 1:
                continue
            (wanted,) = directions
            for light in map(network.find_traffic_light_by_id, lanelet.traffic_lights):
                if light.direction.value == wanted:
                    yield light, states[crossed[0]].time_step


def _colours(row: Row) -> set[TrafficLightState]:
    return {light.get_state_at_time_step(step) for light, step in _passages(row)}


@pytest.mark.parametrize("row", each(*SIGNALISED))
def test_nobody_passes_a_red_signal(row: Row) -> None:
    assert TrafficLightState.RED not in _colours(row)


def test_signals_are_passed_at_green() -> None:
    first = next(row for row in ROWS if row["road_kind"] == SIGNALISED[0])
    assert TrafficLightState.GREEN in _colours(first)


@pytest.mark.parametrize("row", each())
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # commonroad-io's protobuf
def test_drivability_checker_accepts_the_recorded_drive(row: Row) -> None:
    reason = "install the extra `oracle` to run this"
    crcc = pytest.importorskip("commonroad_dc.pycrcc", reason=reason)
    boundary = pytest.importorskip("commonroad_dc.boundary.boundary", reason=reason)
    dispatch = pytest.importorskip(
        "commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch", reason=reason
    )
    scenario, problems = _read(row)
    (problem,) = problems.planning_problem_dict.values()
    ego = crcc.TimeVariantCollisionObject(problem.initial_state.time_step)
    for x, y, heading, _ in drives()[row["id"]]:
        ego.append_obstacle(crcc.RectOBB(VEHICLE.length / 2, VEHICLE.width / 2, heading, x, y))
    assert not dispatch.create_collision_checker(scenario).collide(ego)
    _, edge = boundary.create_road_boundary_obstacle(scenario, method="aligned_triangulation")
    assert not edge.collide(ego)
