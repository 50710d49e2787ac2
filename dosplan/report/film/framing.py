"""The view of a scene that a picture shows, and the layout of its parts, in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.types import FloatArray

_MARGIN: Final = 18.0  # m around the drives.
_LEAST: Final = 55.0  # m; the longer side of a panel shows at least this.
_COARSEST: Final = 4.0  # Pixels for a metre; where a drive needs fewer, the view follows the ego
_FOLLOWED: Final = 6.0  # with this many.
_ONE: Final = 800
_TWO: Final = 960
_GAP: Final = 8
_TITLE: Final = 20
_HEADING: Final = 24
_LEGEND: Final = 44
_LONG: Final = (
    1.7  # Drives whose width is more than this times their height are shown above each other.
)


@dataclass(frozen=True)
class Framing:
    """The layout of a picture.

    Attributes:
        size: Width and height of the picture, pixels; both even.
        panels: Left, bottom, width and height of each panel, pixels.
        centre: (2,) middle of the view, m.
        reach: (2,) half of its width and height, m.
        follows: Whether the view goes with the ego.
        left: Left edge of everything, pixels.
        title: Middle of the line above, pixels from below.
        legend: Upper edge of the legend, likewise.
    """

    size: tuple[int, int]
    panels: tuple[tuple[float, float, float, float], ...]
    centre: FloatArray
    reach: FloatArray
    follows: bool
    left: float
    title: float
    legend: float


def frame_scene(shown: Sequence[FloatArray], may_follow: bool = True) -> Framing:
    """Finds the view that shows some drives from beginning to end.

    Two panels stand side by side, or above each other where the drives are long and flat. A view
    that would have to be too coarse follows the ego instead.

    Args:
        shown: (M, 2) points that have to be in view, m, such as the centres of an ego; one array
            for each panel.
        may_follow: Whether there is an ego to be followed; if not, the view is as coarse as it has
            to be.

    Returns:
        The framing.
    """
    points = np.concatenate(shown)
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    wide, tall = high - low
    panels, size = _arrange(len(shown), float(wide / tall))
    box = np.array(panels[0][2:])
    scale = min(float(np.min(box / (wide, tall))), float(np.max(box)) / _LEAST)
    follows = may_follow and scale < _COARSEST
    return Framing(
        size=size,
        panels=tuple(panels),
        centre=0.5 * (low + high),
        reach=0.5 * box / (_FOLLOWED if follows else scale),
        follows=follows,
        left=_GAP,
        title=size[1] - 0.6 * _TITLE,
        legend=_LEGEND,
    )


def _arrange(
    count: int, aspect: float
) -> tuple[list[tuple[float, float, float, float]], tuple[int, int]]:
    """Places of the panels, and size of the picture."""
    if count == 1:
        columns, width, shape = 1, _ONE, np.clip(aspect, 1.2, 2.6)
    elif aspect > _LONG:
        columns, width, shape = 1, _TWO, np.clip(aspect, 2.2, 4.0)
    else:
        columns, width, shape = 2, _TWO, np.clip(aspect, 0.85, 1.5)
    rows = count // columns
    wide = (width - (columns + 1) * _GAP) // columns
    high = 2 * int(wide / shape / 2.0)
    panels = [
        (
            _GAP + float(index % columns) * (wide + _GAP),
            _LEGEND + float(rows - 1 - index // columns) * (high + _HEADING) + 4.0,
            float(wide),
            float(high),
        )
        for index in range(count)
    ]
    return panels, (width, _LEGEND + 4 + rows * (high + _HEADING) + _TITLE)
