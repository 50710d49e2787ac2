"""Draws what is painted on a road and what stands beside it; import it only to draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.path import Path as Outline

from dosplan.report.palette import (
    KERB,
    LAMP_COLOURS,
    LAMP_RIM,
    SIGN_RED,
    SIGN_YELLOW,
    WHITE,
)
from dosplan.report.road_paint import (
    Crosswalk,
    Lamp,
    Look,
    Plate,
    crosswalks,
    lines,
    plates,
    stop_lines,
    units,
)
from dosplan.types import COLOURS, FloatArray, LightColour, RoadMap, SignRule

_STYLES: Final[Mapping[Look, Mapping[str, Any]]] = MappingProxyType(
    {
        Look.BOUND: {"colors": WHITE, "linewidths": 0.5, "alpha": 0.6},
        Look.KERB: {"colors": KERB, "linewidths": 0.8},
        Look.DASHED: {"colors": WHITE, "linewidths": 1.1, "linestyles": [(0.0, (5.0, 4.0))]},
        Look.BROAD_DASHED: {"colors": WHITE, "linewidths": 2.0, "linestyles": [(0.0, (3.0, 2.0))]},
        Look.SOLID: {"colors": WHITE, "linewidths": 1.1},
        Look.BROAD_SOLID: {"colors": WHITE, "linewidths": 2.0},
    }
)
_STOP: Final = 2.6  # Points; width of a stop line.
_STRIPE: Final = 0.5  # m; width of a stripe of a crosswalk, and of the gap beside it.

_OCTAGON: Final = Outline.unit_regular_polygon(8).deepcopy()
_OCTAGON.vertices = _OCTAGON.vertices @ np.array(
    [[np.cos(np.pi / 8), np.sin(np.pi / 8)], [-np.sin(np.pi / 8), np.cos(np.pi / 8)]]
)
_SIGNS: Final[Mapping[SignRule, Mapping[str, Any]]] = MappingProxyType(
    {
        SignRule.STOP: {"marker": _OCTAGON, "color": SIGN_RED, "markeredgecolor": WHITE},
        SignRule.GIVE_WAY: {"marker": "v", "color": WHITE, "markeredgecolor": SIGN_RED},
        SignRule.PRIORITY: {"marker": "D", "color": SIGN_YELLOW, "markeredgecolor": WHITE},
        SignRule.SPEED_LIMIT: {"marker": "o", "color": WHITE, "markeredgecolor": SIGN_RED},
        SignRule.SPEED_ZONE: {"marker": "o", "color": WHITE, "markeredgecolor": SIGN_RED},
    }
)
"""Pictographs of the Vienna Convention on Road Signs and Signals (1968)."""

_SIZES: Final = MappingProxyType({SignRule.PRIORITY: 6.0, SignRule.GIVE_WAY: 9.0})  # Points.
_SIZE: Final = 10.5
_NUMBER: Final = 5.5  # Points.


def draw_paint(axes: Axes, road_map: RoadMap, zorder: float) -> None:
    """Draws lines, crosswalks, stop lines and signs.

    Args:
        axes: Where to draw.
        road_map: The map.
        zorder: Height among the layers.
    """
    found = lines(road_map)
    for look, style in _STYLES.items():
        if alike := [line.points for line in found if line.look is look]:
            axes.add_collection(LineCollection(alike, zorder=zorder, label=look.value, **style))
    if stripes := [stripe for walk in crosswalks(road_map) for stripe in _stripes(walk)]:
        axes.add_collection(
            PolyCollection(stripes, facecolors=WHITE, alpha=0.9, zorder=zorder, label="crosswalk")
        )
    if stops := stop_lines(road_map):
        axes.add_collection(
            LineCollection(
                stops, colors=WHITE, linewidths=_STOP, zorder=zorder, label="stop line",
                capstyle="butt",
            )
        )  # fmt: skip
    for plate in plates(road_map):
        _draw_plate(axes, plate, zorder)


def paint_keys(lights: Sequence[Lamp], signs: Iterable[Plate]) -> list[Any]:
    """Keys for a legend of what does not explain itself.

    Args:
        lights: The lights that are drawn.
        signs: The signs that are drawn.

    Returns:
        Traffic lights, whose key needs ``LAMP_HANDLER``, and speed limits with their unit, each
        where there are any.
    """
    keys: list[Any] = [_lamp_key()] if lights else []
    if unit := units(signs):
        style = {**_SIGNS[SignRule.SPEED_LIMIT], "markersize": 7.0, "markeredgewidth": 1.6}
        keys.append(Line2D([], [], linestyle="none", label=f"limit, {unit}", **style))
    return keys


class LampKey(tuple[Line2D, ...]):
    """A red, a yellow and a green lamp as one key of a legend."""

    __slots__ = ()

    def get_label(self) -> str:
        """The text beside the key."""
        return "traffic light"


LAMP_HANDLER: Final = MappingProxyType({LampKey: HandlerTuple(ndivide=None, pad=0.1)})
"""For ``handler_map`` of a legend with the keys of ``paint_keys``."""


def _lamp_key() -> LampKey:
    shown = (LightColour.RED, LightColour.YELLOW, LightColour.GREEN)
    return LampKey(
        Line2D(
            [], [], linestyle="none", marker="o", markersize=5.5, markeredgewidth=0.9,
            markeredgecolor=LAMP_RIM, color=LAMP_COLOURS[COLOURS.index(colour)][0],
        )
        for colour in shown
    )  # fmt: skip


def _stripes(walk: Crosswalk) -> Iterable[FloatArray]:
    """(4, 2) corners of each stripe of a crosswalk, m."""
    line = shapely.LineString(walk.centre)
    count = int(line.length // (2.0 * _STRIPE))
    first = 0.5 * (line.length - (2 * count - 1) * _STRIPE)
    for index in range(count):
        ends = first + 2.0 * index * _STRIPE + np.array([0.0, _STRIPE])
        piece = shapely.get_coordinates(shapely.line_interpolate_point(line, ends))
        way = (piece[1] - piece[0]) / np.linalg.norm(piece[1] - piece[0])
        aside = 0.5 * walk.width * np.array([-way[1], way[0]])
        yield np.array([piece[0] + aside, piece[1] + aside, piece[1] - aside, piece[0] - aside])


def _draw_plate(axes: Axes, plate: Plate, zorder: float) -> None:
    style = _SIGNS[plate.rule]
    axes.plot(
        *plate.place[:, None], linestyle="none", markersize=_SIZES.get(plate.rule, _SIZE),
        markeredgewidth=1.0 if style["markeredgecolor"] == WHITE else 1.6, zorder=zorder,
        label=plate.rule.value, **style,
    )  # fmt: skip
    if plate.text:
        axes.annotate(
            plate.text,
            (plate.place[0], plate.place[1]),
            ha="center",
            va="center_baseline",
            size=_NUMBER - (len(plate.text) > 2),
            weight="bold",
            color=LAMP_RIM,
            zorder=zorder,
            annotation_clip=True,
            clip_on=True,
        )
