"""The wedge of road in which a lane narrows to its end."""

from __future__ import annotations

import numpy as np

from dosplan.types import FloatArray

LENGTH = 45.0
"""Least length of the wedge, m; it ends at the next point of the lane beside it."""
END_WIDTH = 0.3
"""Width at its end, m: CommonRoad's lanelets have one everywhere."""


def taper(inner: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The two bounds of a wedge beside a lane that goes on.

    Args:
        inner: (P, 2) the bound of that lane at which the wedge lies, from the end of the lane
            that ends on, m.
        outer: (2,) where the other bound of the lane that ends stops, m.

    Returns:
        The inner bound as far as the wedge goes and its outer bound, (Q, 2) each, m.
    """
    steps = np.linalg.norm(np.diff(inner, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    count = min(int(np.searchsorted(along, LENGTH)) + 1, len(inner))
    inner, along = inner[:count], along[:count]
    across = outer - inner[0]
    width = float(np.linalg.norm(across))
    tangent = np.gradient(inner, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal *= np.sign(normal[0] @ across)
    widths = np.interp(along, [0.0, along[-1]], [width, END_WIDTH])
    edge = inner + widths[:, None] * normal
    edge[0] = outer
    return inner.copy(), edge
