"""What SUMO's traffic lights show, by the lights of the map."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from dosplan.types import FloatArray, LightColour, LightStates, Scenario
from dosplan_sumo.lanes import Lanes

_COLOURS: Final = {
    "r": LightColour.RED,
    "u": LightColour.RED_YELLOW,
    "y": LightColour.YELLOW,
    "Y": LightColour.YELLOW,
    "g": LightColour.GREEN,
    "G": LightColour.GREEN,
    "s": LightColour.RED,  # With a green arrow, at which one stops first.
    "o": LightColour.INACTIVE,
    "O": LightColour.INACTIVE,
}
"""Colours by SUMO's letters."""
_TURNS: Final = {
    "l": "left",
    "L": "left",
    "t": "left",  # A turn back where one drives on the right,
    "T": "right",  # and on the left.
    "r": "right",
    "R": "right",
    "s": "straight",
}
"""Ways through an intersection by SUMO's letters."""
_NO_WAY: Final = "no way that is known"
"""For any other letter: only a light for all ways holds."""
_BEFORE_THE_LINE: Final = 1.0
"""How far before the end of its lanelets a light's lane of SUMO is looked for, m."""


class Lights:
    """The lights of a map in the running simulation.

    A light that no lane of SUMO has shows what the scenario's file says.
    """

    def __init__(
        self, sumo: Any, lanes: Lanes, scenario: Scenario, offset: FloatArray, first_step: int
    ) -> None:
        """Finds each light of the map in SUMO.

        Args:
            sumo: The library, at the ego's start.
            lanes: SUMO's lanes.
            scenario: The scenario.
            offset: (2,) what is added to the map's coordinates to get SUMO's, m.
            first_step: The step at which the ego starts.
        """
        self._sumo, self._scenario = sumo, scenario
        self._places = _places(sumo, lanes, scenario, offset)
        at_start = scenario.signals.at(first_step)
        shown = {light: self._shown(light) for light in self._places}
        self._since = {
            # A change before the start is known to the file alone.
            light: at_start.seconds(light) if at_start.colour(light) is colour else 0.0
            for light, colour in shown.items()
        }
        self._before, self._step = shown, first_step

    def at(self, step: int) -> LightStates | None:
        """What the lights show.

        Args:
            step: The present step.

        Returns:
            Their states; None where SUMO has none of the map's lights.
        """
        if not self._places:
            return None
        recorded = self._scenario.signals.at(step)
        if step != self._step:
            for light, before in self._before.items():
                now = self._shown(light)
                passed = (step - self._step) * self._scenario.dt
                self._since[light] = self._since[light] + passed if now is before else 0.0
                self._before[light] = now
            self._step = step
        ids = [light.id for light in self._scenario.road_map.lights]
        return LightStates(
            ids=np.array(ids, dtype=np.int64),
            colours=tuple(self._before.get(light, recorded.colour(light)) for light in ids),
            since=np.array([self._since.get(light, recorded.seconds(light)) for light in ids]),
        )

    def _shown(self, light: int) -> LightColour:
        """The strictest that SUMO shows on the ways for which a light holds."""
        program = self._sumo.trafficlight
        colours = {
            _COLOURS.get(program.getRedYellowGreenState(logic)[index], LightColour.INACTIVE)
            for logic, index in self._places[light]
        }
        ordered = (
            LightColour.RED,
            LightColour.RED_YELLOW,
            LightColour.YELLOW,
            LightColour.GREEN,
        )
        return next((colour for colour in ordered if colour in colours), LightColour.INACTIVE)


def _places(
    sumo: Any, lanes: Lanes, scenario: Scenario, offset: FloatArray
) -> dict[int, tuple[tuple[str, int], ...]]:
    """Of each light that SUMO has: its programs, and the places of its letters in their states."""
    signals: dict[tuple[str, str], tuple[str, int]] = {}
    for logic in sumo.trafficlight.getIDList():
        for index, links in enumerate(sumo.trafficlight.getControlledLinks(logic)):
            for source, target, _ in links:
                signals[source, target] = (logic, index)
    lanelets = {lanelet.id: lanelet for lanelet in scenario.road_map.lanelets}
    found = {}
    for light in scenario.road_map.lights:
        places = []
        for name in light.lanelets:
            way = lanelets[name].centre[-2:] if name in lanelets else np.zeros((0, 2))
            along = np.diff(way, axis=0).reshape(-1)
            if len(along) != 2 or not along.any():
                continue
            before = way[-1] - along * (_BEFORE_THE_LINE / np.hypot(*along))
            lane = lanes.at(before + offset, float(np.arctan2(along[1], along[0])))
            if lane is None:
                continue
            for target, *_, turn, _ in sumo.lane.getLinks(lane):
                if (lane, target) in signals and light.holds_for(_TURNS.get(turn, _NO_WAY)):
                    places.append(signals[lane, target])
        if places:
            found[light.id] = tuple(dict.fromkeys(places))
    return found
