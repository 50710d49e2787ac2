"""Interactive scenarios for tests, made of the suite's: a folder as CommonRoad ships them."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from dosplan.simulation.traffic import Traffic
from dosplan.simulation.world import World
from dosplan.types import FloatArray, Scenario, Tracks
from tests.support.suite import SUITE

ZEBRA = "ZAM_Zebra-2_2_T-1"
"""A scenario of the suite that is quickly driven up to its start; a street with a crosswalk."""


def suite_file(name: str) -> Path:
    """A scenario file of the suite."""
    return SUITE / "files" / f"{name}.xml.gz"


def interactive_folder(folder: Path, name: str = ZEBRA) -> Path:
    """Writes a folder without recorded trajectories, and without when the ego starts.

    Returns:
        The scenario file.
    """
    place = folder / name
    place.mkdir(parents=True)
    root = ElementTree.fromstring(gzip.decompress(suite_file(name).read_bytes()))
    _keep_starts_only(root)
    scene = place / f"{name}.cr.xml"
    ElementTree.ElementTree(root).write(scene, encoding="utf-8")
    geometry = name.partition("_T-")[0].rpartition("_")[0]
    net = gzip.decompress((SUITE / "sumo-files" / f"{geometry}.net.xml.gz").read_bytes())
    (place / f"{name}.net.xml").write_bytes(net)
    demand = gzip.decompress((SUITE / "sumo-files" / f"{name}.rou.xml.gz").read_bytes()).decode()
    demand = re.sub(r'<param key="dosplan.start"[^>]*/>', "", demand)
    (place / f"{name}.rou.xml").write_text(demand)
    configuration = (SUITE / "sumo-files" / f"{name}.sumo.cfg").read_text()
    configuration = configuration.replace(f"{geometry}.net.xml.gz", f"{name}.net.xml")
    (place / f"{name}.sumo.cfg").write_text(configuration.replace(".rou.xml.gz", ".rou.xml"))
    return scene


def driven_around(traffic: Traffic, scenario: Scenario, ego: FloatArray) -> Tracks:
    """The traffic around an ego with the states (K, 4) x, y, heading, velocity of its centre."""
    vehicle = scenario.task.vehicle
    world = World(scenario, traffic)
    states = [np.array(scenario.task.start)]
    for x, y, heading, velocity in ego:
        states.append(vehicle.state_at(np.array([x, y]), heading, velocity, 0.0))
        step = world.now + 1
        world._others.add(step, traffic.step(step, np.stack(states)))
        world._states = list(states)
    return world.tracks


def _keep_starts_only(root: ElementTree.Element) -> None:
    """Leaves of each road user its state where the ego starts, which becomes step 0."""
    problem = root.find("planningProblem")
    assert problem is not None
    start = int(problem.findtext("initialState/time/exact") or "")
    for time in problem.iter("time"):
        for number in time:
            number.text = str(int(number.text or "") - start)
    for user in root.findall("dynamicObstacle"):
        first, trajectory = user.find("initialState"), user.find("trajectory")
        assert first is not None
        assert trajectory is not None
        at_start = [s for s in (first, *trajectory) if s.findtext("time/exact") == str(start)]
        user.remove(first)
        user.remove(trajectory)
        if not at_start:
            root.remove(user)
            continue
        (state,) = at_start
        state.tag = "initialState"
        for number in state.iterfind("time/exact"):
            number.text = "0"
        user.append(state)
