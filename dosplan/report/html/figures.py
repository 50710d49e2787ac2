"""The static plots, drawn by matplotlib into SVG that takes its colours from the page.

matplotlib is used, and no library in the page: the project draws with it anyway, it is well
maintained, its SVG needs no script, and a plot takes some ten kilobytes. Colours are drawn as
placeholders and then replaced by the page's CSS variables, so that plots follow light and dark.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from dosplan.report.figures import frontier
from dosplan.report.html.coverage import Coverage
from dosplan.report.palette import FAINT, INK, SERIES, WHITE
from dosplan.results.table import Table
from dosplan.types import STEP_SECONDS, Arm, FloatArray

Series = Mapping[str, FloatArray]
"""Values by the name of the side, in the page's order of sides."""

_INK: Final = "#010203"
_FAINT: Final = "#040506"
MOST_SIDES: Final = len(Arm) + len(SERIES)
"""So many sides have a colour, in ``static/style.css``: the arms of a run, and others."""

_SIDES: Final = tuple(f"#0708{side:02x}" for side in range(MOST_SIDES))
_VARIABLES: Final = {
    _INK: "var(--ink)",
    _FAINT: "var(--faint)",
    **{colour: f"var(--side-{side})" for side, colour in enumerate(_SIDES)},
    # Of the figures for paper, which are drawn on white.
    INK: "var(--ink)",
    FAINT: "var(--faint)",
    WHITE: "var(--paper)",
    **{colour: f"var(--side-{side})" for side, colour in enumerate(SERIES, len(Arm))},
}
_STYLE: Final = {
    "svg.fonttype": "none",
    "svg.hashsalt": "dosplan",
    "font.size": 9,
    "font.family": "sans-serif",
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _FAINT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "legend.frameon": False,
}
_BINS: Final = 24
_SIZE: Final = (4.2, 2.4)


def histogram(
    series: Series, label: str, *, bounds: Sequence[float] = (), log: bool = False
) -> str:
    """Draws distributions over each other.

    Args:
        series: The values; those of an empty side are left out.
        label: What the x axis shows.
        bounds: Values to be marked by a line.
        log: Whether the x axis is logarithmic; the values are positive then.

    Returns:
        An ``svg`` element.
    """
    with mpl.rc_context(_STYLE):
        figure, axes = _empty(label, "episodes" if not log else "cycles")
        shown = {name: values for name, values in series.items() if len(values)}
        pooled = np.concatenate([np.empty(0), *shown.values(), np.asarray(bounds)])
        edges = _edges(pooled, log)
        for colour, (name, values) in zip(_SIDES, series.items(), strict=False):
            if name not in shown:
                continue
            counts, _ = np.histogram(np.clip(values, edges[0], edges[-1]), edges)
            axes.stairs(counts, edges, color=colour, fill=True, alpha=0.25)
            axes.stairs(counts, edges, color=colour, linewidth=1.4, label=name)
        for bound in bounds:
            axes.axvline(bound, color=_INK, linewidth=1.0, linestyle=(0, (4, 3)))
        if log:
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
        _explain(axes)
        return _svg(figure)


def coverage_plot(coverages: Mapping[str, Sequence[Coverage]]) -> str:
    """Draws the coverage of the sets over how far they look ahead.

    Args:
        coverages: By the name of the side.

    Returns:
        An ``svg`` element.
    """
    with mpl.rc_context(_STYLE):
        figure, axes = _empty("seconds ahead", "share held, %")
        for colour, (name, coverage) in zip(_SIDES, coverages.items(), strict=False):
            time = [STEP_SECONDS * one.offset for one in coverage]
            for who, line, hits in (
                ("moving", "o-", [(one.inside, one.counted) for one in coverage]),
                ("all", ":", [(one.all_inside, one.all_counted) for one in coverage]),
            ):
                share = [100.0 * inside / n if n else np.nan for inside, n in hits]
                label = f"{name}: {who} road users" if coverage else None
                axes.plot(time, share, line, color=colour, markersize=3, linewidth=1.4, label=label)
        axes.set_ylim(0.0, 101.0)
        axes.set_xlim(left=0.0)
        _explain(axes)
        return _svg(figure)


def frontier_plot(table: Table, sides: Mapping[str, int]) -> str:
    """Draws collisions over velocity and success of all arms: what sets cost and prevent.

    Args:
        table: The arms, in one block.
        sides: Which of them are sides of the page: index by ``RUN:arm``.

    Returns:
        An ``svg`` element.
    """
    with mpl.rc_context(_STYLE):
        figure = frontier.draw(table, {spec: _SIDES[side] for spec, side in sides.items()})
        for patch in (figure.patch, *(axes.patch for axes in figure.axes)):
            patch.set_alpha(0.0)
        return _svg(figure)


def _empty(xlabel: str, ylabel: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    figure.patch.set_alpha(0.0)
    axes = figure.add_subplot()
    axes.patch.set_alpha(0.0)
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    return figure, axes


def _edges(pooled: FloatArray, log: bool) -> FloatArray:
    if not len(pooled):
        return np.array([0.0, 1.0]) if not log else np.array([1.0, 10.0])
    low, high = float(pooled.min()), float(pooled.max())
    if log:
        low = max(low, 1e-3)
        return np.geomspace(low, max(high, 1.01 * low), 2 * _BINS + 1)
    low = min(low, 0.0)
    return np.linspace(low, max(high, low + 1e-3), _BINS + 1)


def _explain(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best")


def _svg(figure: Figure) -> str:
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = re.sub(r"<(metadata|style)\b.*?</\1>", "", text[text.index("<svg") :], flags=re.DOTALL)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, variable)
    return text
