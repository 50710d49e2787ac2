"""What each colour means, in films, pages and figures alike.

A colour has one meaning. Two of them are told twice: blue is driving with DOS and the DOS sets
that are driven with, green is the goal and having reached it. Lights and signs have the colours
that they have on a road. Arms, methods and series are from the palette of Okabe and Ito ("Color
Universal Design", 2008), or apart from it in lightness; no figure tells two things apart by colour
alone. A page has the same hues, lighter where it is dark (``static/style.css``).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from dosplan.types import COLOURS, Arm, LightColour, Outcome, RoadUserKind

INK: Final = "#222222"
"""Text, outlines, and what has no colour of its own."""
FAINT: Final = "#626b76"
"""Text beside the matter, and help lines."""
RULE: Final = "#c9ced4"
"""Frames, and lines that only guide the eye."""
GRID: Final = "#e4e4e4"
WHITE: Final = "#ffffff"

ARM_COLOURS: Final[Mapping[Arm, str]] = MappingProxyType(
    {Arm.WITHOUT_DOS: "#d55e00", Arm.WITH_DOS: "#0072b2"}
)
"""Each arm, and the ego in it."""
EGO_COLOUR: Final = "#00b4c8"
"""The ego where nobody drove it, in either arm."""

KIND_COLOURS: Final[Mapping[RoadUserKind, str]] = MappingProxyType(
    {
        RoadUserKind.CAR: "#98a3af",
        RoadUserKind.TRUCK: "#717c88",
        RoadUserKind.BUS: "#535e69",
        RoadUserKind.TRAIN: "#394048",
        RoadUserKind.MOTORCYCLE: "#a98fd0",
        RoadUserKind.BICYCLE: "#6a3d9a",
        RoadUserKind.PEDESTRIAN: "#f0c800",
        RoadUserKind.PARKED: "#bdbcb6",
        RoadUserKind.STATIC: "#77736a",
        RoadUserKind.UNKNOWN: "#d3d5d8",
    }
)
"""Road users. Slate drives, the darker the larger; violet has two wheels; yellow walks; a warm
grey stands. All but those on foot and on two wheels are muted, so that the ego stands out."""

SET_COLOURS: Final = ("#00876c", "#e0a030", "#c2347a")
"""Time ahead, of a predicted set or of what is measured of it: from soon over half to far."""

GOAL_COLOUR: Final = "#2e8b3d"
"""The goal, and the way to it."""
OUTCOME_COLOURS: Final[Mapping[Outcome, str]] = MappingProxyType(
    {
        Outcome.SUCCESS: GOAL_COLOUR,
        Outcome.GOAL_MISSED: "#b8b02c",
        Outcome.OUT_OF_BOUNDS: "#8c5a2b",
        Outcome.COLLISION: "#c4161c",
        Outcome.PLANNER_FAILURE: "#4d4d4d",
        Outcome.TRAFFIC_FAILURE: "#c4b8a0",
        Outcome.UNUSABLE: RULE,
    }
)

ROAD: Final = "#dfe1e0"
OFF_ROAD: Final = ("#f3f4f2", "#c4c6c1")
"""Lanelets that are no road for a car: their area and its hatching."""
KERB: Final = "#9b9b95"
"""The edge of the road."""

LAMP_RIM: Final = "#15181c"
"""Around every lamp, on a light page and on a dark one."""
_RED, _YELLOW, _GREEN = "#e8132b", "#ffcc00", "#00c17a"  # Far apart in brightness, too.
_LAMPS: Final = {
    LightColour.RED: (_RED, _RED),
    LightColour.YELLOW: (_YELLOW, _YELLOW),
    LightColour.RED_YELLOW: (_RED, _YELLOW),
    LightColour.GREEN: (_GREEN, _GREEN),
    LightColour.INACTIVE: ("#8a929b", "#8a929b"),
}
LAMP_COLOURS: Final = tuple(_LAMPS[colour] for colour in COLOURS)
"""Of a lamp, by its colour's index in ``COLOURS``: its disc, and the smaller one inside."""
SIGN_RED: Final = "#c1121f"
SIGN_YELLOW: Final = _YELLOW

DOS: Final = ARM_COLOURS[Arm.WITH_DOS]
"""DOS sets of the kind that is driven with: trained for coverage."""
DOS_PAPER: Final = "#56b4e9"
"""DOS sets trained with the paper's loss."""
PR: Final = INK
"""Ellipses of a Gaussian, at a number of standard deviations."""
SA: Final = "#cc79a7"
"""Circles of a size that is regressed."""
CIRCLE: Final = "#e69f00"
"""Circles of a size that is specified."""

SERIES: Final = ("#2f4b3a", "#009e73", "#8c6bb1", "#a3742a", "#7d8471", "#b39bc8")
"""What has no colour of its own: parts of a time, methods of a sweep, shapes of a set."""
