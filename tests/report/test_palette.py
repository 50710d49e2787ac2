"""One meaning for each colour, and one place that says so."""

from __future__ import annotations

import colorsys
import re
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb

import dosplan.report
from dosplan.report import palette
from dosplan.results.markdown import ARMS_SIDE_BY_SIDE
from dosplan.types import Arm, FloatArray, Outcome, RoadUserKind

REPORT = Path(dosplan.report.__file__).parent
MEANINGS: dict[str, str] = {
    **{str(arm): colour for arm, colour in palette.ARM_COLOURS.items()},
    **{str(kind): colour for kind, colour in palette.KIND_COLOURS.items()},
    **{str(outcome): colour for outcome, colour in palette.OUTCOME_COLOURS.items()},
    "soon": palette.SET_COLOURS[0],
    "half": palette.SET_COLOURS[1],
    "far": palette.SET_COLOURS[2],
    "ego": palette.EGO_COLOUR,
}
"""What a film or a player may show at once; the goal has the colour of success."""
NEXT_TO_NOTHING = {Outcome.UNUSABLE, Outcome.PLANNER_FAILURE, Outcome.TRAFFIC_FAILURE}
"""These are never drawn in a scene."""


def _lab(colour: str) -> FloatArray:
    """CIELAB of a colour (CIE 15:2004, D65)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb > 0.04045, ((rgb + 0.055) / 1.055) ** 2.4, rgb / 12.92)
    matrix = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    x, y, z = (
        v ** (1 / 3) if v > 216 / 24389 else (24389 / 27 * v + 16) / 116
        for v in matrix @ linear / (0.9505, 1.0, 1.089)
    )
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_what_is_seen_at_once_differs_to_the_eye() -> None:
    shown = {name: _lab(colour) for name, colour in MEANINGS.items() if name not in NEXT_TO_NOTHING}
    apart = {
        (one, other): float(np.linalg.norm(shown[one] - shown[other]))
        for one, other in combinations(shown, 2)
    }
    # Vehicles of one family are told apart by their size as well.
    assert {pair: d for pair, d in apart.items() if d < 8.0} == {}
    arms = {pair: d for pair, d in apart.items() if {*pair} & set(Arm)}
    assert {pair: d for pair, d in arms.items() if d < 30.0} == {}


def test_methods_and_series_have_colours_of_their_own() -> None:
    methods = [palette.PR, palette.SA, palette.CIRCLE, palette.DOS, palette.DOS_PAPER]
    meant = [*methods, *palette.SERIES, palette.ARM_COLOURS[Arm.WITHOUT_DOS]]
    assert len(set(meant)) == len(meant)
    apart = [
        float(np.linalg.norm(_lab(one) - _lab(other))) for one, other in combinations(meant, 2)
    ]
    assert min(apart) > 20.0


def test_no_other_module_has_a_colour() -> None:
    """Placeholders of the page's plots, which it replaces by its own, are none."""
    placeholders = REPORT / "html" / "figures.py"
    for path in REPORT.rglob("*.py"):
        if path.name != "palette.py" and path != placeholders:
            found = re.findall(r"[\"'](#[0-9a-fA-F]{3,8})[\"']", path.read_text("utf-8"))
            assert found == [], path


def test_a_page_has_the_colours_of_films_and_their_hues_where_it_is_dark() -> None:
    css = (REPORT / "html" / "static" / "style.css").read_text("utf-8")
    light, dark = (
        dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block))
        for block in re.findall(r":root(?:\[[^]]*\])? \{(.*?)\}", css, re.DOTALL)[:2]
    )
    meant = {f"side-{i}": palette.ARM_COLOURS[arm] for i, arm in enumerate(ARMS_SIDE_BY_SIDE)}
    others = enumerate(palette.SERIES, len(ARMS_SIDE_BY_SIDE))
    meant |= {f"side-{i}": colour for i, colour in others}
    meant |= {
        outcome.value: colour
        for outcome, colour in palette.OUTCOME_COLOURS.items()
        if outcome is not Outcome.UNUSABLE
    }
    meant |= dict(zip(("near", "middle", "far"), palette.SET_COLOURS, strict=True))
    assert {name: light[name] for name in meant} == meant
    for name, colour in meant.items():
        hue, other = (colorsys.rgb_to_hls(*to_rgb(x)) for x in (colour, dark[name]))
        if min(hue[2], other[2]) > 0.15:  # Greys have no hue.
            assert abs((hue[0] - other[0] + 0.5) % 1.0 - 0.5) < 0.06, name


def test_every_kind_and_outcome_has_a_colour() -> None:
    assert set(palette.KIND_COLOURS) == set(RoadUserKind)
    assert set(palette.OUTCOME_COLOURS) == set(Outcome)
    assert set(palette.ARM_COLOURS) == set(Arm)
