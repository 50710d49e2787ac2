"""One style for all figures: sized for the columns of a paper, and safe for the colour-blind.

What a colour means is said in ``dosplan.report.palette``; no figure distinguishes two things by
colour alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from dosplan.report.palette import GRID, INK
from dosplan.system.files import atomic_file
from dosplan.types import Arm, FloatArray

COLUMN: Final = 3.5
"""Width of a column, inches."""
PAGE: Final = 7.16
"""Width of a page of two columns, inches."""

ARM_MARKERS: Final = MappingProxyType({Arm.WITH_DOS: "o", Arm.WITHOUT_DOS: "s"})

_STYLE: Final = {
    "figure.dpi": 150,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # Fonts that a publisher's checks accept, and text that can be searched.
    "font.family": "sans-serif",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "errorbar.capsize": 1.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
}


@contextmanager
def styled() -> Iterator[None]:
    """Gives all figures that are drawn and saved in the block the same style.

    Yields:
        Nothing.
    """
    with mpl.rc_context(_STYLE):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Makes an empty figure, without a window or a display.

    Args:
        width: ``COLUMN`` or ``PAGE``, inches.
        height: Inches.

    Returns:
        The figure.
    """
    return Figure(figsize=(width, height), layout="constrained")


def plot_interval(
    axes: Axes, x: FloatArray, y: FloatArray, half: FloatArray, **look: Any
) -> ErrorbarContainer:
    """Draws a line of values with their intervals, these fainter than what they belong to.

    Args:
        axes: Where to draw.
        x: (P,) abscissae.
        y: (P,) values.
        half: (P,) half the width of each interval, or (2, P) what is below and above the value;
            NaN where there is none.
        look: Further arguments of ``Axes.errorbar``.

    Returns:
        What was drawn.
    """
    drawn = axes.errorbar(x, y, yerr=half, elinewidth=0.7, capthick=0.7, **look)
    for part in drawn.lines[1] + drawn.lines[2]:
        part.set_alpha(0.6)
    return drawn


def mark_decades(axis: Axis, marks: Sequence[float] = (1.0,)) -> None:
    """Marks a logarithmic axis by plain numbers.

    Args:
        axis: The axis; its scale is set already, since that puts marks of its own.
        marks: What is marked in each decade; 1, 2 and 5 where there are few decades.
    """
    axis.set_major_locator(LogLocator(subs=marks))
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter(NullFormatter())


def save(figure: Figure, out: Path, name: str, description: str | None = None) -> tuple[Path, Path]:
    """Writes a figure as PNG and as PDF; the same figure makes the same bytes.

    Args:
        figure: The figure.
        out: The folder; it is made.
        name: Name of the files.
        description: What the files hold as their description.

    Returns:
        The PNG and the PDF.

    Raises:
        FileError: A file cannot be written.
    """
    png, pdf = out / f"{name}.png", out / f"{name}.pdf"
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:  # The layout's last digits differ from one drawing to the next.
        axes.set_position(np.round(axes.get_position(original=True).bounds, 6).tolist())
    with atomic_file(png) as file:
        figure.savefig(file, format="png", metadata={"Software": None, "Description": description})
    with atomic_file(pdf) as file:
        figure.savefig(
            file,
            format="pdf",
            metadata={"CreationDate": None, "Producer": None, "Subject": description},
        )
    return png, pdf
