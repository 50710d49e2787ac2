"""Calibration: the coverage that sets reach over the coverage that they were asked for.

A Gaussian's ellipse at z standard deviations holds 1 - exp(-z^2 / 2) of it, so the method PR has a
nominal coverage as well; it is drawn beside the calibrated sets.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dosplan.report.figures import style
from dosplan.report.figures.sources import Evaluation, Published
from dosplan.report.film.layers import SET_RAMP
from dosplan.report.palette import INK, RULE
from dosplan.system.files import FileError
from dosplan.types import FloatArray

_CALIBRATED: Final = {"marker": "o", "linestyle": "-"}
_GAUSSIAN: Final = {"marker": "x", "linestyle": ":"}


def sources(published: Published) -> list[Path]:
    """The files that the figure shows."""
    return [published.evaluation_file(part) for part in ("calibration", "prediction")]


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a column's width.

    Raises:
        FileError: An evaluation is missing or holds no level.
    """
    calibrated, others = (published.evaluation(part) for part in ("calibration", "prediction"))
    levels = {
        100.0 * options["coverage"]: label
        for label, options in calibrated.options.items()
        if "coverage" in options and not options.get("simultaneous", False)
    }
    gaussian = {
        100.0 * (1.0 - float(np.exp(-0.5 * options["scale"] ** 2))): label
        for label, options in others.options.items()
        if options.get("sets") == "pr" and "scale" in options
    }
    for evaluation, found in ((calibrated, levels), (others, gaussian)):
        if not found:
            raise FileError(f"{evaluation.path} holds no level to draw")
    figure = style.new_figure(style.COLUMN, 3.3)
    axes = figure.add_subplot()
    axes.plot([0.0, 100.0], [0.0, 100.0], color=RULE, linewidth=1.0, zorder=1)
    _curves(axes, calibrated, levels, **_CALIBRATED)
    _curves(axes, others, gaussian, **_GAUSSIAN)
    axes.set(
        xlabel="coverage asked for, %",
        ylabel="coverage reached, %",
        xlim=(0.0, 101.0),
        ylim=(0.0, 101.0),
        aspect="equal",
    )
    horizons = calibrated.of(next(iter(levels.values()))).horizon
    axes.legend(handles=_keys(horizons), loc="lower right")
    return figure


def _curves(axes: Axes, evaluation: Evaluation, levels: dict[float, str], **look: str) -> None:
    """One curve for each horizon."""
    asked = np.array(sorted(levels))
    sets = [evaluation.of(levels[level]) for level in asked.tolist()]
    horizons = sets[0].horizon
    for h, colour in enumerate(SET_RAMP(horizons / horizons[-1])):
        coverage = np.array([one.coverage[h] for one in sets])
        half = np.array([one.half[h] for one in sets])
        style.plot_interval(axes, asked, coverage, half, color=colour, **look)


def _keys(horizons: FloatArray) -> list[Line2D]:
    return [
        Line2D([], [], color=INK, label="DOS, calibrated", **_CALIBRATED),  # type: ignore[arg-type]
        Line2D([], [], color=INK, label="PR, as Gaussian", **_GAUSSIAN),  # type: ignore[arg-type]
        *(
            Line2D([], [], color=colour, linewidth=3.0, label=f"{horizon:g} s ahead")
            for horizon, colour in zip(horizons, SET_RAMP(horizons / horizons[-1]), strict=True)
        ),
    ]
