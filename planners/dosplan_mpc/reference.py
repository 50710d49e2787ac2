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
LANE_RIGHT: Final = PATH_SIZE + 2
LANE_LEFT: Final = PATH_SIZE + 3
"""The same where the edge is that of a lane against the path, which is road; else ``NO_EDGE``."""
NO_EDGE: Final = 100.0
"""Distance of an edge that is none, m."""


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


class LanePath(EvenPath):
    """A reference path beside which the lanes against it can be opened along a stretch.

    Its table has the columns ``PATH_RIGHT``, ``PATH_LEFT``, ``LANE_RIGHT`` and ``LANE_LEFT``.
    """

    def __init__(self, route: Route, settings: PathSettings, turn: float = 0.0) -> None:
        """Finds the edges of a route.

        Args:
            route: The route of the episode.
            settings: Settings of the edges.
            turn: Angle that is added to its heading, rad: full turns, so that it is continuous
                with another heading.
        """
        right, left = _edges(route, settings)
        lanes = (
            np.where(route.right > route.outer_right + _SAME_EDGE, right, -NO_EDGE),
            np.where(route.left < route.outer_left - _SAME_EDGE, left, NO_EDGE),
        )
        super().__init__(
            route.arclength,
            route.path,
            route.heading + turn,
            route.curvature,
            (right, left, *lanes),
        )
        self._closed = self.table.copy()
        self._outer = (route.outer_right, route.outer_left)

    def close(self) -> None:
        """Has the lanes against the path closed again."""
        self.table[:, PATH_SIZE:] = self._closed[:, PATH_SIZE:]

    def open(self, begin: float, end: float, side: float) -> None:
        """Lets the ego use the lane against the path along a stretch.

        Args:
            begin: Arc length of its begin, m.
            end: Arc length of its end, m.
            side: 1 for the lane on the left, -1 for one on the right.
        """
        self.close()
        inside = (self.arclength >= begin) & (self.arclength <= end)
        edge, lane = (PATH_LEFT, LANE_LEFT) if side > 0.0 else (PATH_RIGHT, LANE_RIGHT)
        self.table[inside, edge] = self._outer[int(side > 0.0)][inside]
        self.table[inside, lane] = side * NO_EDGE


def aligned_path(task: PlanningTask, settings: PathSettings) -> LanePath:
    """The reference path with its heading on the same turn as the ego's.

    Args:
        task: Start, goal and route.
        settings: Settings of the edges.

    Returns:
        The path.
    """
    path = LanePath(task.route, settings)
    heading = path.at(np.array(path.locate_first(task.start[:2])))[PATH_HEADING]
    turns = np.round((task.start[EGO_HEADING] - heading) / (2.0 * np.pi))
    return LanePath(task.route, settings, 2.0 * np.pi * turns) if turns else path


_SAME_EDGE: Final = 0.05


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
