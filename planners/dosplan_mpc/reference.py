"""The reference path as a table: interpolation and projection, vectorised."""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dosplan.types import FloatArray, Route

X: Final = 0
Y: Final = 1
HEADING: Final = 2
CURVATURE: Final = 3
RIGHT: Final = 4
LEFT: Final = 5

_REACH = 0.55  # m; an edge counts this far along the path, for a corner between two stations.
# In a bend a car may swing out into a lane against it: a front that is l ahead of the rear axle
# runs kappa l^2 / 2 further out.
_SWING = 10.0  # m2
_SWING_REACH = 8.0  # m before and after the bend.
_WIDEST_SWING = 1.5  # m
_NEWTON_STEPS = 4
_LONGEST_STEP = 12.0  # m; keeps Newton's method on its branch where the path turns back.


class ReferencePath:
    """Linear interpolation in a table of the route, equally spaced in arc length."""

    def __init__(self, route: Route) -> None:
        """Lays out the table.

        Args:
            route: The route of the episode.
        """
        self.length = float(route.arclength[-1])
        self._spacing = self.length / (len(route.arclength) - 1)
        swing = np.minimum(
            _SWING * maximum_filter1d(np.abs(route.curvature), self._samples(_SWING_REACH)),
            _WIDEST_SWING,
        )
        right = np.maximum(route.outer_right, route.right - swing)
        left = np.minimum(route.outer_left, route.left + swing)
        narrow = self._samples(_REACH)
        self.table: FloatArray = np.column_stack(
            [
                route.path,
                route.heading,
                route.curvature,
                maximum_filter1d(right, narrow),
                minimum_filter1d(left, narrow),
            ]
        )
        self._line = shapely.LineString(route.path)

    def _samples(self, reach: float) -> int:
        """Samples of the table within a distance to both sides."""
        return 2 * int(np.ceil(reach / self._spacing)) + 1

    def at(self, arclength: FloatArray) -> FloatArray:
        """Rows of the table.

        Args:
            arclength: Arc lengths, m, any shape; clipped to the path.

        Returns:
            (..., 6) x, y, m; heading, rad, unwrapped; curvature, 1/m; right and left edge, m,
            where they are narrowest within ``_REACH``.
        """
        position = np.clip(arclength / self._spacing, 0.0, len(self.table) - 1.000001)
        low = position.astype(np.int64)
        part = (position - low)[..., None]
        return np.asarray(self.table[low] * (1.0 - part) + self.table[low + 1] * part)

    def locate(self, points: FloatArray) -> FloatArray:
        """Arc lengths of the nearest points of the whole path.

        Args:
            points: (..., 2) m.

        Returns:
            (...) m.
        """
        return np.asarray(shapely.line_locate_point(self._line, shapely.points(points)))

    def project(
        self, points: FloatArray, guess: FloatArray, iterations: int = _NEWTON_STEPS
    ) -> tuple[FloatArray, FloatArray]:
        """Projects points near a guess, by Newton's method on the table.

        Args:
            points: (..., 2) m.
            guess: (...) arc lengths to begin with, m.
            iterations: Newton steps; one is enough next to a guess within a metre.

        Returns:
            (...) arc lengths, m, and (...) signed offsets, m, left positive.
        """
        s = np.array(guess, dtype=np.float64)
        for _ in range(iterations):
            along, across, curvature = self._frame(points, s)
            shrink = np.maximum(1.0 - curvature * across, 0.3)
            s = np.clip(
                s + np.clip(along / shrink, -_LONGEST_STEP, _LONGEST_STEP), 0.0, self.length
            )
        return s, self._frame(points, s)[1]

    def _frame(
        self, points: FloatArray, s: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        row = self.at(s)
        dx, dy = points[..., 0] - row[..., X], points[..., 1] - row[..., Y]
        cos, sin = np.cos(row[..., HEADING]), np.sin(row[..., HEADING])
        return cos * dx + sin * dy, cos * dy - sin * dx, row[..., CURVATURE]
