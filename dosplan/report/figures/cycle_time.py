"""How the planning cycle grows with the road users, the horizon and the map."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from dosplan.report.figures import style
from dosplan.report.figures.sources import Published
from dosplan.report.palette import INK, SERIES
from dosplan.system.files import FileError

# What grows: label of the axis, whether it is logarithmic, and what is left out: the horizon is
# measured with other predictions than the rest, since the trained ones end at 4 s.
PANELS: Final[dict[str, tuple[str, bool, frozenset[str]]]] = {
    "road_users": ("road users", True, frozenset()),
    "horizon_s": ("planning horizon, s", False, frozenset({"predict"})),
    "lanelets": ("lanelets of the map", True, frozenset()),
}
# Parts of a cycle: what the legend says, colour, marker, line.
PARTS: Final = {
    "cycle_p95": ("cycle, 95th percentile", INK, "o", ":"),
    "cycle": ("cycle", INK, "o", "-"),
    "solver": ("solver", SERIES[3], "s", "-"),
    "predict": ("prediction", SERIES[1], "^", "-"),
    "plan_rest": ("rest of the plan", SERIES[2], "D", "-"),
}


def sources(published: Published) -> list[Path]:
    """The files that the figure shows."""
    return [published.growth_file]


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a page's width: medians in ms.

    Raises:
        FileError: The timings are missing or lack a part.
    """
    growth = published.growth()
    figure = style.new_figure(style.PAGE, 2.4)
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for axes, (what, (label, log, left_out)) in zip(panels, PANELS.items(), strict=True):
        amounts = np.array(list(growth[what]))
        for part, (title, colour, marker, line) in PARTS.items():
            if part in left_out:
                continue
            if not all(part in times for times in growth[what].values()):
                raise FileError(f"{published.path / 'cycle'}: a time of {part!r} is missing")
            times = np.array([found[part] for found in growth[what].values()])
            look = {"color": colour, "marker": marker, "linestyle": line}
            axes.plot(amounts, times, label=title, **look)
        if log:
            axes.set_xscale("log")
            axes.minorticks_off()
        axes.set_xticks(amounts, [f"{amount:g}" for amount in amounts])
        axes.set_xlabel(label)
    panels[0].set_yscale("log")
    style.mark_decades(panels[0].yaxis, (1.0, 2.0, 5.0))
    panels[0].set_ylabel("time per cycle, ms")
    handles, titles = panels[0].get_legend_handles_labels()
    figure.legend(handles, titles, loc="outside upper center", ncols=len(PARTS))
    return figure
