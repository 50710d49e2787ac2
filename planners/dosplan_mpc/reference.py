"""The reference path: the route's path with the edges that the ego keeps, as a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dosplan.geometry import PATH_HEADING, PATH_SIZE, EvenPath
from dosplan.types import EGO_HEADING, FloatArray, PlanningTask, Route
from dosplan_mpc.config import PathSettings

PATH_RIGHT: Final = PATH_SIZE
PATH_LEFT: Final = PATH_SIZE + 1
"""Further columns of the path's table: right and left edge, m, where they are narrowest nearby."""


@dataclass(frozen=True)
class EgoOnPath:
    """Where the ego is on its reference path.

    Attributes:
        step: Present step.
        arclength: Arc length of the rear axle, m.
        offset: Its lateral offset, m, left positive.
        position: Arc length of the rectangle's centre, m.
        velocity: m/s.
    """

    step: int
    arclength: float
    offset: float
    position: float
    velocity: float


def reference_path(route: Route, settings: PathSettings, turn: float = 0.0) -> EvenPath:
    """The path of a route with the edges beside it.

    Args:
        route: The route of the episode.
        settings: Settings of the edges.
        turn: Angle that is added to its heading, rad: full turns, so that it is continuous with
            another heading.

    Returns:
        The path; its table has the columns ``PATH_RIGHT`` and ``PATH_LEFT`` as well.
    """
    right, left = _edges(route, settings)
    return EvenPath(
        route.arclength, route.path, route.heading + turn, route.curvature, (right, left)
    )


def aligned_path(task: PlanningTask, settings: PathSettings) -> EvenPath:
    """The reference path with its heading on the same turn as the ego's.

    Args:
        task: Start, goal and route.
        settings: Settings of the edges.

    Returns:
        The path.
    """
    path = reference_path(task.route, settings)
    heading = path.at(path.locate(task.start[:2]))[PATH_HEADING]
    turns = np.round((task.start[EGO_HEADING] - heading) / (2.0 * np.pi))
    return reference_path(task.route, settings, 2.0 * np.pi * turns)


def _edges(route: Route, settings: PathSettings) -> tuple[FloatArray, FloatArray]:
    """(P,) right and (P,) left edge beside the points of a route, m."""
    spacing = float(route.arclength[-1]) / (len(route.arclength) - 1)

    def samples(reach: float) -> int:
        """Points within a distance to both sides."""
        return 2 * int(np.ceil(reach / spacing)) + 1

    bend = maximum_filter1d(np.abs(route.curvature), samples(settings.swing_reach))
    swing = np.minimum(settings.swing * bend, settings.widest_swing)
    right = np.maximum(route.outer_right, route.right - swing)
    left = np.minimum(route.outer_left, route.left + swing)
    narrow = samples(settings.edge_reach)
    return maximum_filter1d(right, narrow), minimum_filter1d(left, narrow)
