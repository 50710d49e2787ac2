"""The embedded suite beside CommonRoad's own definition and reader."""

from __future__ import annotations

import csv
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

SUITE = Path(__file__).resolve().parents[2] / "scenarios"
SCHEMA = (
    Path(commonroad.__file__).parent
    / "scenario_definition/xml_definition_files/XML_commonRoad_XSD.xsd"
)
with (SUITE / "manifest.csv").open(newline="", encoding="utf-8") as stream:
    FILES = [SUITE / row["file"] for row in csv.DictReader(stream)]
SIGNALISED = [path for path in FILES if path.name.startswith(("ZAM_Signal", "ZAM_Arterial"))]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.name))
def test_file_obeys_the_schema(path: Path) -> None:
    etree = pytest.importorskip("lxml.etree", reason="lxml validates the schema")
    if not SCHEMA.exists():
        pytest.skip("this commonroad-io does not ship the schema")
    text = SCHEMA.read_text(encoding="utf-8")
    # The schema lets everyone begin at step 0 only, which recorded traffic cannot; the reader,
    # and CommonRoad's own recorded scenarios, do not insist.
    relaxed = text.replace('<xs:maxInclusive value="0"/>', "", 1)
    assert relaxed != text
    schema = etree.XMLSchema(etree.fromstring(relaxed.encode()))
    schema.assertValid(etree.fromstring(gzip.decompress(path.read_bytes())))


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.name))
def test_commonroad_io_reads_everything_back(path: Path) -> None:
    data = gzip.decompress(path.read_bytes())
    root = ElementTree.fromstring(data)
    scenario, problems = CommonRoadFileReader(data, FileFormat.XML).open()
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


def _passages(path: Path) -> Iterator[tuple[Any, int]]:
    """Signals that moving traffic passes, with the step at which it does."""
    scenario, _ = CommonRoadFileReader(gzip.decompress(path.read_bytes()), FileFormat.XML).open()
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


def test_nobody_passes_a_red_signal() -> None:
    states = [
        light.get_state_at_time_step(step) for path in SIGNALISED for light, step in _passages(path)
    ]
    assert TrafficLightState.GREEN in states
    assert TrafficLightState.RED not in states
