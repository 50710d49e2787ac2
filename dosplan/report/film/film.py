"""An episode as a film: a panel for each drive, every step a picture.

What stands still (road, goal, frame, legend) is drawn once; a picture is a copy of that with what
moves drawn on top. Everything is placed in pixels, so that a picture has a known size.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dosplan.report.film.drives import Take
from dosplan.report.film.framing import Framing, frame_scene
from dosplan.report.film.layers import SEEN_DOTS, SET_RAMP, START_DASHES, Dashes
from dosplan.report.film.paint import LAMP_HANDLER, paint_keys
from dosplan.report.film.panel import Panel
from dosplan.report.film.scene import off_road_key
from dosplan.report.palette import FAINT, GOAL_COLOUR, INK, KIND_COLOURS, WHITE
from dosplan.types import STEP_SECONDS, Outcome

Picture = npt.NDArray[np.uint8]
"""(height, width, 3) red, green and blue."""

_RAMP: Final = 110.0  # Pixels; width of the scale of colours.
_TEXT: Final = 9.0  # Points.
_BESIDE_TITLE: Final = 290.0  # Pixels; the scale with its text, and the margins.
_LETTER: Final = 6.2  # Pixels; mean width of a letter of the title.
_KEY: Final = 112.0  # Pixels; about the width of a key of the legend.


class Film:
    """The pictures of an episode.

    Attributes:
        size: Width and height of a picture, pixels.
        steps: The step of each picture.
        moment: Step of the outcome: the first that went wrong, else the last.
        panels: One for each take.
    """

    def __init__(self, takes: Sequence[Take], title: str, scale: float = 1.0) -> None:
        """Draws what stands still.

        Args:
            takes: What is shown, side by side: one take or two of one scenario.
            title: A line above it all.
            scale: Factor on the number of pixels along each side.
        """
        framing = frame_scene([take.in_view for take in takes], takes[0].has_task)
        width, height = framing.size
        self._figure = Figure(figsize=(width / 100.0, height / 100.0), dpi=100.0 * scale)
        self._figure.set_facecolor(WHITE)
        self._canvas: Any = FigureCanvasAgg(self._figure)  # Its methods have no types.
        self.size = self._canvas.get_width_height()
        self.steps = range(min(t.start for t in takes), max(t.end for t in takes) + 1)
        failed = [t.moment for t in takes if t.row and t.row.outcome is not Outcome.SUCCESS]
        self.moment = min(failed) if failed else max(take.moment for take in takes)
        self.panels = [
            Panel(self._figure, take, framing, index) for index, take in enumerate(takes)
        ]
        self._figure.text(
            framing.left / width,
            framing.title / height,
            title,
            size=_TEXT * min((width - _BESIDE_TITLE) / (_LETTER * max(len(title), 1)), 1.0),
            color=FAINT,
            va="center",
        )
        self._draw_legend(framing, takes)
        self._draw_ramp(framing, takes)
        self._still: Any = None

    def picture(self, step: int) -> Picture:
        """Draws a step.

        Args:
            step: One of ``steps``.

        Returns:
            The picture.
        """
        moved = [panel.aim(step) for panel in self.panels]
        if self._still is None or any(moved):
            self._canvas.draw()
            self._still = self._canvas.copy_from_bbox(self._figure.bbox)
        self._canvas.restore_region(self._still)
        for panel in self.panels:
            panel.show(step)
            for artist in panel.moving:
                panel.axes.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba())[..., :3]

    def _draw_legend(self, framing: Framing, takes: Sequence[Take]) -> None:
        width, height = framing.size
        kinds = {kind for panel in self.panels for kind in panel.kinds_in_view()}
        keys: list[Any] = [
            Patch(
                facecolor=take.colour,
                edgecolor=INK,
                linewidth=0.6,
                label=f"ego {take.name}",
            )
            for take in takes
            if take.row is not None
        ]
        if takes[0].has_task:
            alone = takes[0].row is None
            keys.append(
                _ghost_key("ego's start", START_DASHES, takes[0].colour, 0.35)
                if alone
                else _ghost_key("ego's start", START_DASHES, INK)
            )
        if any(take.drive is not None for take in takes):
            keys += [
                Line2D([], [], color=INK, linewidth=2.2, label="driven"),
                Line2D([], [], color=INK, linewidth=1.2, marker="o", markersize=2.5, label="plan"),
            ]
        if takes[0].has_task:
            keys += [
                Line2D([], [], color=GOAL_COLOUR, linewidth=1.2, alpha=0.6, label="route"),
                Patch(facecolor=GOAL_COLOUR, alpha=0.35, label="goal"),
            ]
        if any(len(panel.seen_elsewhere(step)[1]) for panel in self.panels for step in self.steps):
            keys.append(_ghost_key("where it was seen", SEEN_DOTS, INK))
        if any(panel.unseen(step) for panel in self.panels for step in self.steps):
            keys.append(Patch(facecolor=INK, edgecolor=INK, alpha=0.25, label="not seen (faint)"))
        keys += off_road_key(takes[0].scenario)
        keys += paint_keys(
            [lamp for panel in self.panels for lamp in panel.lamps_in_view()],
            [plate for panel in self.panels for plate in panel.plates_in_view()],
        )
        keys += [
            Patch(facecolor=colour, edgecolor=INK, linewidth=0.4, label=kind.value)
            for kind, colour in KIND_COLOURS.items()
            if kind in kinds
        ]
        self._figure.legend(
            handles=keys,
            handler_map=dict(LAMP_HANDLER),
            loc="upper left",
            bbox_to_anchor=(framing.left / width, framing.legend / height),
            ncols=int(width // _KEY),
            frameon=False,
            fontsize=_TEXT,
            handlelength=1.5,
            columnspacing=1.4,
            borderaxespad=0.0,
            borderpad=0.1,
        )

    def _draw_ramp(self, framing: Framing, takes: Sequence[Take]) -> None:
        """The scale of the sets' colours, in the upper right corner."""
        offsets = [take.drive.recording.set_offsets for take in takes if take.drive is not None]
        ahead = STEP_SECONDS * np.concatenate([np.empty(0), *offsets])
        if not len(ahead):
            return
        width, height = framing.size
        left, low = width - framing.left - _RAMP - 28.0, framing.title - 4.0
        axes = self._figure.add_axes((left / width, low / height, _RAMP / width, 8.0 / height))
        axes.imshow(np.linspace(0.0, 1.0, 64)[None], cmap=SET_RAMP, aspect="auto")
        axes.set_axis_off()
        first = f"predicted, ahead by  {ahead.min():g}"
        for x, text, align in ((-0.04, first, "right"), (1.04, f"{ahead.max():g} s", "left")):
            axes.text(
                x, 0.45, text, ha=align, va="center", size=_TEXT, color=FAINT,
                transform=axes.transAxes,
            )  # fmt: skip


def _ghost_key(label: str, dashes: Dashes, colour: str, fill: float = 0.0) -> Patch:
    return Patch(facecolor=to_rgba(colour, fill), edgecolor=colour, linestyle=dashes, label=label)
