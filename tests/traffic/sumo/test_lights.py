"""Which of SUMO's signals a light of the map shows; a stand-in takes the place of SUMO."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dosplan_sumo.lights import Lights

from dosplan.scenario.synthetic import straight_scenario
from dosplan.types import LightColour, TrafficLight


def network(turn: str) -> Any:
    """One lane from which links lead straight on, at green, and another way, at red."""
    links = [[("lane", "on", "")], [("lane", "other", "")]]
    ways = [
        ("on", True, True, False, "", "G", "s", 1.0),
        ("other", True, True, False, "", "r", turn, 1.0),
    ]
    return SimpleNamespace(
        trafficlight=SimpleNamespace(
            getIDList=lambda: ["logic"],
            getControlledLinks=lambda logic: links,
            getRedYellowGreenState=lambda logic: "Gr",
        ),
        lane=SimpleNamespace(getLinks=lambda lane: ways),
    )


@pytest.mark.parametrize(
    ("turn", "direction", "shown"),
    [
        ("r", "right", LightColour.RED),
        ("r", "straight", LightColour.GREEN),
        ("r", "all", LightColour.RED),
        ("t", "leftStraight", LightColour.RED),
        ("T", "straightRight", LightColour.RED),  # A turn back in left-hand traffic.
        ("T", "straight", LightColour.GREEN),
        ("T", "leftStraight", LightColour.GREEN),
        ("?", "straight", LightColour.GREEN),
        ("?", "all", LightColour.RED),
    ],
)
def test_a_light_shows_the_signals_of_the_ways_for_which_it_holds(
    turn: str, direction: str, shown: LightColour
) -> None:
    scenario = straight_scenario()
    own = scenario.road_map.lanelets[0].id
    light = TrafficLight(7, direction, lanelets=(own,))
    scenario = replace(scenario, road_map=replace(scenario.road_map, lights=(light,)))
    lanes: Any = SimpleNamespace(at=lambda place, heading: "lane")
    lights = Lights(network(turn), lanes, scenario, np.zeros(2), 0)
    seen = lights.at(0)
    assert seen is not None
    assert seen.colours == (shown,)
