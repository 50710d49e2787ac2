"""What sets cost and what they prevent: collisions over velocity and success, for each method.

A curve is a method, its points are coverages of its sets. What has no coverage, such as the arm
without sets, is a single point.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dosplan.report.figures import style
from dosplan.report.palette import FAINT, INK, SERIES
from dosplan.results.comparison import CompareError
from dosplan.results.markdown import ARM_TITLES
from dosplan.results.table import Row, Table
from dosplan.scoring.metrics import find_metric
from dosplan.types import Arm

COLUMNS: Final = ("collision", "at_fault_collision", "velocity", "success")
"""Metrics that the figure needs."""
BARS_AT: Final = 90.0
"""Coverage, %, of the point of a curve that has its intervals; otherwise the one next to it."""
_UP: Final = (("collision", "collisions, %"), ("at_fault_collision", "at-fault collisions, %"))
_ACROSS: Final = (("velocity", "velocity, m/s"), ("success", "success, %"))
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
_POINT_MARKERS: Final = ("s", "D", "p", "h", "8")
_NONE: Final[Mapping[str, str]] = MappingProxyType({})
_SMALLEST, _LARGEST = 2.0, 5.5  # Markers of the lowest and the highest coverage.


@dataclass(frozen=True)
class Method:
    """A method of predicting.

    Attributes:
        title: Its name.
        rows: Its rows, by rising coverage.
        levels: Their coverages, %; None where it has a single row without one.
    """

    title: str
    rows: tuple[Row, ...]
    levels: tuple[float, ...] | None

    @property
    def barred(self) -> Row:
        """The row that has its intervals."""
        levels = self.levels or (BARS_AT,)
        return min(zip(self.rows, levels, strict=True), key=lambda one: abs(one[1] - BARS_AT))[0]


def methods(table: Table) -> list[Method]:
    """Finds the methods in a table of runs.

    Args:
        table: The runs. Those of a sweep with an axis ``coverage`` (or one that ends so, as
            ``predictor.coverage``) make a curve for each combination of the others' values.

    Returns:
        The methods, in the order of the table.

    Raises:
        CompareError: The runs are not of one world and the same scenarios.
    """
    if len(table.blocks) > 1:
        titles = "; ".join(block.title for block in table.blocks)
        raise CompareError(
            f"the runs differ in world or scenarios ({titles}); draw those of one together"
        )
    rows = table.blocks[0].rows
    both = {row.run for row in rows if sum(other.run == row.run for other in rows) > 1}
    found: dict[str, list[tuple[float | None, Row]]] = {}
    for row in rows:
        levels = {axis: _percent(name) for axis, name in row.values.items() if _is_level(axis)}
        level = next((one for one in levels.values() if one is not None), None)
        # A coverage that is no number, as "none", is a method of its own.
        names = [name for axis, name in row.values.items() if levels.get(axis) is None]
        title = ", ".join(names) or (row.run if level is None else row.predictor)
        if row.run in both:
            title += f", {ARM_TITLES[row.arm]}"
            level = level if row.arm is Arm.WITH_DOS else None
        if row.run in both and level is None and title in found:
            continue  # The arm without sets is the same at each coverage.
        found.setdefault(title, []).append((level, row))
    return [one for title, points in found.items() for one in _called(title, points)]


def _called(title: str, points: Sequence[tuple[float | None, Row]]) -> Iterator[Method]:
    """The methods of one title: a curve, and what has no coverage by itself."""
    curve = sorted(
        ((level, row) for level, row in points if level is not None), key=lambda one: one[0]
    )
    if curve:
        yield Method(title, tuple(row for _, row in curve), tuple(level for level, _ in curve))
    single = [row for level, row in points if level is None]
    for number, row in enumerate(single):
        yield Method(row.run if curve or number else title, (row,), None)


def _is_level(axis: str) -> bool:
    return axis.rpartition(".")[2] == "coverage"


def _percent(name: str) -> float | None:
    """A coverage by the name of a value: 90 and 0.9 are the same; None for what is no number."""
    try:
        value = float(name)
    except ValueError:
        return None
    return value if value > 1.0 else 100.0 * value


def draw(table: Table, colours: Mapping[str, str] = _NONE) -> Figure:
    """Draws the figure.

    Args:
        table: The runs, with the ``COLUMNS``.
        colours: Of arms that have one elsewhere, by ``RUN:arm``, where they are single points.

    Returns:
        A figure of a page's width: a row for all collisions and one for those at fault.

    Raises:
        CompareError: The runs are not of one world and the same scenarios.
    """
    found = methods(table)
    (block,) = table.blocks
    base = next((row for row in block.rows if row.spec == block.baseline), None)
    levels = sorted({level for method in found for level in method.levels or ()})
    sizes = dict(zip(levels, np.linspace(_SMALLEST, _LARGEST, len(levels)), strict=True))
    figure = style.new_figure(style.PAGE, 5.6)
    panels = figure.subplots(len(_UP), len(_ACROSS), sharex="col", sharey="row", squeeze=False)
    looks = _looks(found, colours)
    for line, (up, y_title) in zip(panels, _UP, strict=True):
        for axes, (across, x_title) in zip(line, _ACROSS, strict=True):
            for method in found:
                _draw(axes, method, (across, up), looks[method.title], sizes)
            if base is not None:
                _mark(axes, base, (across, up))
            # Intervals of a difference may end beyond what a share can be.
            axes.set_ylim(bottom=-0.03 * axes.get_ylim()[1])
            if find_metric(across).is_share:
                axes.set_xlim(right=min(axes.get_xlim()[1], 101.0))
            axes.text(
                *(1.0, 1.01), "better: \N{SOUTH EAST ARROW}", transform=axes.transAxes,
                ha="right", va="bottom", color=FAINT, fontsize=7,
            )  # fmt: skip
            axes.set_xlabel(x_title if up == _UP[-1][0] else "")
            axes.set_ylabel(y_title if across == _ACROSS[0][0] else "")
    n = sorted({row.n for row in block.rows})
    figure.suptitle(
        f"{block.title}; n = {' to '.join(str(x) for x in dict.fromkeys((n[0], n[-1])))}",
        x=0.01, ha="left", fontsize=8, weight="bold",
    )  # fmt: skip
    handles, titles = panels[0, 0].get_legend_handles_labels()
    legend = figure.legend(
        handles, titles, loc="outside lower center", ncols=4, title=_caption(levels, base)
    )
    legend.get_title().set_fontsize(7)
    return figure


def _caption(levels: Sequence[float], base: Row | None) -> str:
    lines = []
    if levels:
        listed = ", ".join(f"{level:g}" for level in levels)
        lines.append(f"Coverage of the sets {listed} %: the larger the marker, the more.")
    if base is not None:
        at = f" at {BARS_AT:g} % coverage and of single points" if levels else ""
        name = ", ".join(base.values.values()) or base.spec
        lines.append(
            f"Bars{at}: 95 % interval of the paired difference from {name} (dashed lines)."
        )
    return "\n".join(lines)


def _looks(found: Sequence[Method], colours: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """How each method is drawn; no two of them differ by their colour alone."""
    curves = [method for method in found if method.levels]
    looks: dict[str, dict[str, Any]] = {
        method.title: {
            "color": SERIES[i % len(SERIES)],
            "marker": _MARKERS[i % len(_MARKERS)],
            "linestyle": ("-", "--", ":")[i // len(SERIES) % 3],
        }
        for i, method in enumerate(curves)
    }
    points = [method for method in found if not method.levels]
    for i, method in enumerate(points):
        ranked = method.rows[0].ranked
        looks[method.title] = {
            "color": colours.get(method.rows[0].spec, INK),
            "marker": _POINT_MARKERS[i % len(_POINT_MARKERS)] if ranked else "*",
            "linestyle": "none",
            "markerfacecolor": "white",
            "markersize": 5.0 if ranked else 8.0,
        }
    return looks


def _draw(
    axes: Axes,
    method: Method,
    names: tuple[str, str],
    look: Mapping[str, Any],
    sizes: Mapping[float, float],
) -> None:
    """Draws a method: its curve, larger markers for larger sets, and intervals at one point."""
    places = [_place(row, names) for row in method.rows]
    x, y = np.transpose(places)
    if method.levels is None:
        axes.plot(x, y, label=method.title, zorder=3.0, **look)
    else:
        line = {key: look[key] for key in ("color", "linestyle")}
        for (x0, y0), (x1, y1) in pairwise(places):
            axes.plot([x0, x1], [y0, y1], linewidth=0.9, **line)
        for place, level in zip(places, method.levels, strict=True):
            axes.plot(
                *place, color=look["color"], marker=look["marker"], markersize=sizes[level],
                markeredgewidth=0.0,
            )  # fmt: skip
        axes.plot([], [], label=method.title, **look)  # For the legend.
    row = method.barred
    at = _place(row, names)
    ends = [_ends(row, name) for name in names]
    axes.errorbar(
        *at, xerr=ends[0], yerr=ends[1], color=look["color"], linestyle="none", elinewidth=0.6,
        capthick=0.6, alpha=0.6, zorder=2.0,
    )  # fmt: skip


def _place(row: Row, names: tuple[str, str]) -> tuple[float, float]:
    x, y = (_scaled(name, row.figures[name].value) for name in names)
    return x, y


def _ends(row: Row, name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(2, 1) what the interval of a row's difference has below and above; NaN without one."""
    found = row.differences.get(name)
    if found is None or found.low is None:
        return np.full((2, 1), np.nan)
    low, high = (_scaled(name, end) for end in (found.low, found.high))
    middle = _scaled(name, found.difference)
    return np.array([[middle - low], [high - middle]])


def _mark(axes: Axes, base: Row, names: tuple[str, str]) -> None:
    """Draws lines through the baseline."""
    x, y = _place(base, names)
    for draw_line, at in ((axes.axvline, x), (axes.axhline, y)):
        draw_line(at, color=FAINT, linestyle="--", linewidth=0.6, zorder=1.0)


def _scaled(name: str, value: float | None) -> float:
    return np.nan if value is None else find_metric(name).scale * value
