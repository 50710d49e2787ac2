"""Upper limits: the least mean area with which a set of each shape touches the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from dosplan.report.figures import style
from dosplan.report.figures.sources import Published
from dosplan.report.palette import CIRCLE, PR, SERIES
from dosplan.system.files import FileError

MODEL: Final = "trajectory network"
BESIDE: Final = "PR z=1.0"
# Shapes of `dosplan.evaluation.limits`: title, colour, marker, line.
SHAPES: Final = {
    "circle": ("circle", CIRCLE, "o", "-"),
    "theta=pi/4": (r"ellipse, $\theta$ = $\pi$/4", SERIES[3], "D", "-"),
    "theta=0": (r"ellipse, $\theta$ = 0", SERIES[1], "s", "-"),
    "v1": ("ellipse, v1", SERIES[2], "^", "--"),
    "v2": ("ellipse, v2", SERIES[5], "v", ":"),
    "free": (r"ellipse, $\theta$ free", SERIES[0], "P", "-"),
}


def sources(published: Published) -> list[Path]:
    """The files that the figure shows."""
    return [published.evaluation_file("prediction")]


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a column's width.

    Raises:
        FileError: The evaluation is missing or lacks the limits.
    """
    evaluation = published.evaluation("prediction")
    beside = evaluation.of(BESIDE)
    figure = style.new_figure(style.COLUMN, 3.2)
    axes = figure.add_subplot()
    axes.plot(beside.horizon, beside.area, "x-.", color=PR, label="PR, z = 1 (as predicted)")
    for shape, (title, colour, marker, line) in SHAPES.items():
        if (MODEL, "all", shape) not in evaluation.limits:
            raise FileError(f"{evaluation.path} has no upper limits {shape!r} of {MODEL!r}")
        axes.plot(
            beside.horizon,
            evaluation.limits[MODEL, "all", shape],
            marker=marker,
            linestyle=line,
            color=colour,
            label=title,
        )
    axes.set_yscale("log")
    style.mark_decades(axes.yaxis)
    axes.set(xlabel="prediction horizon, s", ylabel="mean area, m²", xticks=beside.horizon)
    figure.legend(loc="outside lower center", ncols=2)
    return figure
