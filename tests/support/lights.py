"""A straight road with what can regulate it: lights, lines, a crosswalk, signs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dosplan.scenario.synthetic import LANE_WIDTH, straight_scenario
from dosplan.types import (
    COLOURS,
    Lanelet,
    LightColour,
    LineMarking,
    Scenario,
    Signals,
    SignRule,
    StopLine,
    Tracks,
    TrafficLight,
    TrafficSign,
)

STOP_X = 30.0
TURNS_GREEN = 20
"""Step at which the light for those who turn left goes from red to green."""

LEFT, AHEAD, OTHER = 1, 2, 3
"""Lights: two of the ego's lane, for who turns left and for who does not, one of the other lane."""


def regulated_scenario(tracks: Tracks | None = None) -> Scenario:
    """Two lanes whose stop lines are at x = 30 m, and a crosswalk behind them.

    The ego's lane has a light to the left that is red for two seconds, then green, and one ahead
    and to the right that stays green; the light of the other lane is red throughout.

    Args:
        tracks: The road users; nobody by default.

    Returns:
        The scenario; the ego starts at the origin at step 0.
    """
    scenario = straight_scenario(tracks)
    own, other = scenario.road_map.lanelets
    half = 0.5 * LANE_WIDTH
    own = replace(
        own,
        left_marking=LineMarking.DASHED,
        right_marking=LineMarking.SOLID,
        stop_line=StopLine(np.array([[STOP_X, half], [STOP_X, -half]]), lights=(LEFT, AHEAD)),
        lights=(LEFT, AHEAD),
        signs=(51,),
    )
    other = replace(
        other,
        stop_line=StopLine(np.array([[STOP_X, half], [STOP_X, 3.0 * half]])),
        lights=(OTHER,),
    )
    crosswalk = Lanelet(
        id=9,
        left=np.array([[36.0, -8.0], [36.0, 8.0]]),
        right=np.array([[40.0, -8.0], [40.0, 8.0]]),
        kinds=frozenset({"crosswalk"}),
        is_road=False,
        for_cars=False,
    )
    limit = TrafficSign(
        51, "274", SignRule.SPEED_LIMIT, 50.0 / 3.6, np.array([10.0, -half]), lanelets=(1,)
    )
    red, green = COLOURS.index(LightColour.RED), COLOURS.index(LightColour.GREEN)
    steps = 2 * TURNS_GREEN
    colours = np.array(
        [[red] * TURNS_GREEN + [green] * TURNS_GREEN, [green] * steps, [red] * steps]
    )
    seconds = 0.1 * np.arange(steps)
    changed = np.where(np.arange(steps) < TURNS_GREEN, seconds, seconds - 0.1 * TURNS_GREEN)
    road_map = replace(
        scenario.road_map,
        lanelets=(own, other, crosswalk),
        signs=(limit, TrafficSign(52, "206", SignRule.STOP, None, np.array([STOP_X, -2.0]))),
        lights=(
            TrafficLight(LEFT, "left", lanelets=(1,)),
            TrafficLight(AHEAD, "straightRight", lanelets=(1,)),
            TrafficLight(OTHER, lanelets=(2,)),
        ),
    )
    signals = Signals(
        np.array([LEFT, AHEAD, OTHER]), colours, np.stack([changed, seconds, seconds])
    )
    return replace(scenario, road_map=road_map, signals=signals)
