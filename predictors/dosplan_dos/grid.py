"""The steps of the horizon at which the module makes sets, and those in between."""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.types import FloatArray

GRID: Final = 2  # Steps between two sets that the module makes: 0.2 s.


def every_step(on_grid: FloatArray) -> FloatArray:
    """Fills the steps between those of the grid.

    Args:
        on_grid: (B, G, C) values at 0.2 s, 0.4 s, ...

    Returns:
        (B, GRID G, C) values at 0.1 s, 0.2 s, ...; in between, the mean of the two neighbours;
        before the first, the first.
    """
    earlier = np.concatenate((on_grid[:, :1], on_grid[:, :-1]), axis=1)
    filled = np.repeat(on_grid, GRID, axis=1)
    filled[:, ::GRID] = 0.5 * (earlier + on_grid)
    return filled
