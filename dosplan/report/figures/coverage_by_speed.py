"""Coverage by the speed of the road user now."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from dosplan.evaluation.groups import SPEED_BINS
from dosplan.report.figures import style
from dosplan.report.figures.sources import Published
from dosplan.report.palette import DOS, DOS_PAPER, INK, PR

# Label: what the legend says, colour, marker, how it is filled.
METHODS: Final = {
    "PR z=1.0": ("PR, z = 1", PR, "x", "none"),
    "DOS ellipse": ("DOS, the paper's loss", DOS_PAPER, "o", "full"),
    "DOS coverage": ("DOS, coverage loss", DOS, "D", "none"),
    "DOS coverage, calibrated at 90 %": ("the same, calibrated at 90 %", DOS, "s", "full"),
}
_APART: Final = 0.17  # Between the methods of a bin.
_LEVEL: Final = 90.0


def sources(published: Published) -> list[Path]:
    """The files that the figure shows."""
    return [published.evaluation_file("prediction")]


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a page's width, a panel for each horizon.

    Raises:
        FileError: The evaluation is missing or lacks a method.
    """
    evaluation = published.evaluation("prediction")
    bins = [name for name in SPEED_BINS if any(group == name for _, group in evaluation.sets)]
    places = np.arange(len(bins), dtype=np.float64)
    horizons = evaluation.of(next(iter(METHODS))).horizon
    figure = style.new_figure(style.PAGE, 2.3)
    panels = figure.subplots(1, len(horizons), sharey=True, squeeze=False)[0]
    for h, (axes, horizon) in enumerate(zip(panels, horizons, strict=True)):
        axes.axhline(_LEVEL, color=INK, linewidth=0.7, linestyle=(0, (4, 3)))
        for i, (label, (title, colour, marker, fill)) in enumerate(METHODS.items()):
            found = [evaluation.of(label, name) for name in bins]
            style.plot_interval(
                axes,
                places + _APART * (i - 0.5 * (len(METHODS) - 1)),
                np.array([sets.coverage[h] for sets in found]),
                np.array([sets.half[h] for sets in found]),
                color=colour,
                marker=marker,
                fillstyle=fill,
                linestyle="none",
                label=title,
            )
        names = [name.removesuffix(" m/s").replace(">=", "≥") for name in bins]
        axes.set_xticks(places, names)
        axes.grid(visible=False, axis="x")
        axes.set_title(f"{horizon:g} s ahead")
    panels[0].set_ylabel("CR, %")
    figure.supxlabel("speed of the road user, m/s", fontsize=8)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure
