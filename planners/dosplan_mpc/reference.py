"""The reference path: the route's path with the edges that the ego keeps, as a table."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dosplan.geometry import PATH_HEADING, PATH_SIZE, EvenPath
from dosplan.types import EGO_HEADING, FloatArray, PlanningTask, Route

PATH_RIGHT: Final = PATH_SIZE
PATH_LEFT: Final = PATH_SIZE + 1
"""Further columns of the path's table: right and left edge, m, where they are narrowest nearby."""

_REACH = 0.55  # m; an edge counts this far along the path, for a corner between two stations.
# In a bend a car may swing out into a lane against it: a front that is l ahead of the rear axle
# runs kappa l^2 / 2 further out.
_SWING = 10.0  # m2
_SWING_REACH = 8.0  # m before and after the bend.
_WIDEST_SWING = 1.5  # m


def reference_path(route: Route, turn: float = 0.0) -> EvenPath:
    """The path of a route with the edges beside it.

    Args:
        route: The route of the episode.
        turn: Angle that is added to its heading, rad: full turns, so that it is continuous with
            another heading.

    Returns:
        The path; its table has the columns ``PATH_RIGHT`` and ``PATH_LEFT`` as well.
    """
    right, left = _edges(route)
    return EvenPath(
        route.arclength, route.path, route.heading + turn, route.curvature, (right, left)
    )


def aligned_path(task: PlanningTask) -> EvenPath:
    """The reference path with its heading on the same turn as the ego's.

    Args:
        task: Start, goal and route.

    Returns:
        The path.
    """
    path = reference_path(task.route)
    heading = path.at(path.locate(task.start[:2]))[PATH_HEADING]
    turns = np.round((task.start[EGO_HEADING] - heading) / (2.0 * np.pi))
    return reference_path(task.route, 2.0 * np.pi * turns)


def _edges(route: Route) -> tuple[FloatArray, FloatArray]:
    """(P,) right and (P,) left edge beside the points of a route, m."""
    spacing = float(route.arclength[-1]) / (len(route.arclength) - 1)

    def samples(reach: float) -> int:
        """Points within a distance to both sides."""
        return 2 * int(np.ceil(reach / spacing)) + 1

    swing = np.minimum(
        _SWING * maximum_filter1d(np.abs(route.curvature), samples(_SWING_REACH)), _WIDEST_SWING
    )
    right = np.maximum(route.outer_right, route.right - swing)
    left = np.minimum(route.outer_left, route.left + swing)
    narrow = samples(_REACH)
    return maximum_filter1d(right, narrow), minimum_filter1d(left, narrow)
