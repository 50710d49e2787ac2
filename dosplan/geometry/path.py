"""Paths in the plane: their values at an arc length, and the projection of points onto them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Final, Self

import numpy as np
import shapely

from dosplan.types import FloatArray, Route

PATH_X: Final = 0
"""Column of a path: x, m."""
PATH_Y: Final = 1
"""Column of a path: y, m."""
PATH_HEADING: Final = 2
"""Column of a path: heading, rad."""
PATH_CURVATURE: Final = 3
"""Column of a path: curvature, 1/m, positive to the left."""
PATH_SIZE: Final = 4
"""Number of columns of a path."""

_AS_NEAR: Final = 0.5  # m; a lap that comes by no farther off than this is as near as another.
_NEAR_AGAIN: Final = 2.0  # m; a path comes by a place again where it is nearer than this.
_SHORTEST_LAP: Final = 20.0  # m
_ALONG: Final = 0.5  # Cosine between two laps' directions.
_BEHIND: Final = 0.3  # Shares of a lap that are looked at, behind and ahead.
_AHEAD: Final = 0.6
_AT_END: Final = 1e-6  # m
_STEP_REACH: Final = 3.0  # m; further than most drive in a step of 0.1 s.
_NEWTON_STEPS: Final = 4  # From a few metres off they end within a millimetre.
_LONGEST_STEP: Final = 12.0  # m; keeps Newton's method on its branch where the path turns back.


class ReferencePath:
    """A path with heading and curvature over arc length, linear between its points.

    Attributes:
        arclength: (P,) increasing, m.
        points: (P, 2) m.
        heading: (P,) rad, continuous.
        curvature: (P,) 1/m, left positive.
    """

    def __init__(
        self,
        arclength: FloatArray,
        points: FloatArray,
        heading: FloatArray,
        curvature: FloatArray,
        *,
        thinning: float = 0.0,
    ) -> None:
        """Prepares the look-ups.

        Args:
            arclength: (P,) increasing, m.
            points: (P, 2) m.
            heading: (P,) rad, continuous.
            curvature: (P,) 1/m, left positive.
            thinning: How far the line that points are located on may be off the path, m: a line
                of fewer points is searched quicker.
        """
        self.arclength = arclength
        self.points = points
        self.heading = heading
        self.curvature = curvature
        line = shapely.LineString(points)
        self._line = line.simplify(thinning, preserve_topology=False) if thinning else line

    @classmethod
    def of(cls, route: Route) -> Self:
        """The path of a route.

        Args:
            route: The route.

        Returns:
            Its path.
        """
        return cls(route.arclength, route.path, route.heading, route.curvature)

    def locate(self, points: FloatArray, around: FloatArray | float | None = None) -> FloatArray:
        """Arc lengths of the nearest points of the path.

        Args:
            points: (..., 2) m.
            around: On a path that comes by a place more than once, as round a ring, the arc length
                around which less than one lap is looked at, one for all or (...), m; None for the
                whole path.

        Returns:
            (...) m.
        """
        places = shapely.points(points)
        if around is None or not np.isfinite(self._lap):
            along = shapely.line_locate_point(self._line, places)
            return np.asarray(along + self.arclength[0])
        centres = np.broadcast_to(around, points.shape[:-1])
        found = np.empty(points.shape[:-1])
        behind, ahead = _BEHIND * self._lap, _AHEAD * self._lap
        for centre in np.unique(centres):
            line, first = self._stretch(centre - behind, centre + ahead)
            chosen = centres == centre
            found[chosen] = first + shapely.line_locate_point(line, np.asarray(places)[chosen])
        return found

    def track(self, point: FloatArray, last: float) -> float:
        """Arc length of somebody who was at a place of the path not long ago.

        Args:
            point: (2,) where it is, m.
            last: Arc length at which it was, m.

        Returns:
            m.
        """
        if not np.isfinite(self._returns):
            return float(self.locate(point))
        reach = _STEP_REACH
        while True:
            line, first = self._stretch(last - reach, last + reach)
            along = float(shapely.line_locate_point(line, shapely.Point(point)))
            further_back = along < _AT_END and last - reach > self.arclength[0]
            further_on = along > line.length - _AT_END and last + reach < self.arclength[-1]
            if not (further_back or further_on):
                return first + along
            reach *= 2.0

    def follow(self, points: FloatArray) -> FloatArray:
        """Arc lengths of somebody who drives along the path, from its first lap on.

        Args:
            points: (K, 2) where it is, step by step, m.

        Returns:
            (K,) m.
        """
        if not np.isfinite(self._returns):
            return self.locate(points)
        along = [self.locate_first(points[0])]
        for point in points[1:]:
            along.append(self.track(point, along[-1]))
        return np.array(along)

    def locate_first(self, point: FloatArray) -> float:
        """Arc length of the first place at which the path is as near to a point as anywhere.

        A path that goes round a ring comes by more than once.

        Args:
            point: (2,) m.

        Returns:
            m.
        """
        nearest = float(self.locate(point))
        away = np.hypot(*(self.points - point).T)
        near = away < away.min() + _AS_NEAR
        first = int(np.argmax(near))
        count = int(np.argmin(near[first:])) or len(near) - first
        if nearest <= self.arclength[first + count - 1] or count < 2:
            return nearest
        lap = shapely.LineString(self.points[first : first + count])
        along = shapely.line_locate_point(lap, shapely.Point(point))
        return float(self.arclength[first] + along)

    @cached_property
    def _lap(self) -> float:
        """Least way after which the path comes by a place again in the same direction, m."""
        return self._return(_ALONG)

    @cached_property
    def _returns(self) -> float:
        """Least way after which it comes by a place again, in whichever direction, m."""
        return self._return(-1.0)

    def _return(self, least: float) -> float:
        """The same with a least cosine of the directions; infinite if it never does."""
        spacing = float(np.median(np.diff(self.arclength)))
        every = slice(None, None, max(round(_NEAR_AGAIN / spacing), 1))
        points, along, heading = (x[every] for x in (self.points, self.arclength, self.heading))
        way = np.abs(along[:, None] - along)
        again = np.hypot(*(points[:, None] - points).T) < _NEAR_AGAIN
        again &= (way > _SHORTEST_LAP) & (np.cos(heading[:, None] - heading) >= least)
        return float(np.min(way, initial=np.inf, where=again))

    def _stretch(self, begin: float, end: float) -> tuple[shapely.LineString, float]:
        """The path between two arc lengths, and where that begins, m."""
        first, last = np.searchsorted(self.arclength, [begin, end])
        first = int(np.clip(first - 1, 0, len(self.points) - 2))
        part = slice(first, max(int(last) + 1, first + 2))
        return shapely.LineString(self.points[part]), float(self.arclength[first])

    def heading_at(self, arclength: FloatArray | float) -> FloatArray:
        """Heading of the path.

        Args:
            arclength: (...) m.

        Returns:
            (...) rad, continuous; beyond the ends that of the ends.
        """
        return np.asarray(np.interp(arclength, self.arclength, self.heading))

    def curvature_at(self, arclength: FloatArray | float) -> FloatArray:
        """Curvature of the path.

        Args:
            arclength: (...) m.

        Returns:
            (...) 1/m, left positive; beyond the ends that of the ends.
        """
        return np.asarray(np.interp(arclength, self.arclength, self.curvature))

    def offset(self, points: FloatArray, arclength: FloatArray | float) -> FloatArray:
        """Lateral distance from the path.

        Args:
            points: (..., 2) m.
            arclength: (...) their arc lengths, m.

        Returns:
            (...) m, left positive.
        """
        heading = self.heading_at(arclength)
        x = np.interp(arclength, self.arclength, self.points[:, 0])
        y = np.interp(arclength, self.arclength, self.points[:, 1])
        return np.asarray(
            np.cos(heading) * (points[..., 1] - y) - np.sin(heading) * (points[..., 0] - x)
        )


class EvenPath(ReferencePath):
    """A path whose points are equally spaced in arc length and begin at zero.

    Values at an arc length are found by a division instead of a search: for planners that need
    thousands of them in a cycle.

    Attributes:
        length: m.
        table: (P, 4 + more) x, y, m, heading, rad, curvature, 1/m, and the columns that were
            added; a row per point.
    """

    def __init__(
        self,
        arclength: FloatArray,
        points: FloatArray,
        heading: FloatArray,
        curvature: FloatArray,
        more: Sequence[FloatArray] = (),
    ) -> None:
        """Lays out the table.

        Args:
            arclength: (P,) equally spaced from zero on, m.
            points: (P, 2) m.
            heading: (P,) rad, continuous.
            curvature: (P,) 1/m, left positive.
            more: Columns of (P,) that are to be looked up as well.
        """
        super().__init__(arclength, points, heading, curvature)
        self.length = float(arclength[-1])
        self.table: FloatArray = np.column_stack([points, heading, curvature, *more])
        self._spacing = self.length / (len(arclength) - 1)
        self._last = len(arclength) - 1.000001  # Just before the last row, which has none after it.
        self._frames = np.ascontiguousarray(self.table[:, :PATH_SIZE])

    def at(self, arclength: FloatArray) -> FloatArray:
        """Rows of the table, linear between its points.

        Args:
            arclength: (...) m; clipped to the path.

        Returns:
            (..., 4 + more) as the columns of ``table``.
        """
        return self._rows(self.table, arclength)

    def project(
        self, points: FloatArray, guess: FloatArray, iterations: int = _NEWTON_STEPS
    ) -> tuple[FloatArray, FloatArray]:
        """Projects points near a guess, by Newton's method on the table.

        Args:
            points: (..., 2) m.
            guess: (...) arc lengths to begin with, m.
            iterations: Newton steps; one is enough next to a guess within a metre.

        Returns:
            (...) arc lengths, m, and (...) lateral distances, m, left positive.
        """
        s = np.array(guess, dtype=np.float64)
        for _ in range(iterations):
            along, across, curvature = self._frame(points, s)
            shrink = np.maximum(1.0 - curvature * across, 0.3)
            step = np.minimum(np.maximum(along / shrink, -_LONGEST_STEP), _LONGEST_STEP)
            s = np.minimum(np.maximum(s + step, 0.0), self.length)
        return s, self._frame(points, s)[1]

    def _rows(self, table: FloatArray, arclength: FloatArray) -> FloatArray:
        """(..., C) rows of a (P, C) table.

        ``np.clip`` and indexing by brackets would take twice as long for a few points.
        """
        position = np.minimum(np.maximum(arclength / self._spacing, 0.0), self._last)
        low = position.astype(np.int64)
        part = (position - low)[..., None]
        before, after = table.take(low, axis=0), table.take(low + 1, axis=0)
        return np.asarray(before * (1.0 - part) + after * part)

    def _frame(
        self, points: FloatArray, s: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distances of points along and across the tangents at arc lengths; the curvature there."""
        row = self._rows(self._frames, s)
        dx, dy = points[..., 0] - row[..., PATH_X], points[..., 1] - row[..., PATH_Y]
        cos, sin = np.cos(row[..., PATH_HEADING]), np.sin(row[..., PATH_HEADING])
        return cos * dx + sin * dy, cos * dy - sin * dx, row[..., PATH_CURVATURE]


def braking_envelope(
    squared_limit: FloatArray, arclength: FloatArray, deceleration: float
) -> FloatArray:
    """Largest speed from which every later limit can still be met by braking.

    Args:
        squared_limit: (P,) square of the speed limit, m2/s2.
        arclength: (P,) increasing, m.
        deceleration: m/s2.

    Returns:
        (P,) m/s: ``min over j >= i of sqrt(limit_j^2 + 2 a (s_j - s_i))``.
    """
    way = 2.0 * deceleration * arclength
    ahead = np.minimum.accumulate((squared_limit + way)[::-1])[::-1]
    return np.asarray(np.sqrt(np.maximum(ahead - way, 0.0)))
