"""Who is in whose corridor: rectangles beside paths, and where the corridors of two paths meet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from dosplan.geometry import rectangles_overlap
from dosplan.types import BoolArray, FloatArray, IntArray
from dosplan_reactive.paths import SPACING, Paths

_SIGHT: Final = 130  # Points of a path that are looked at for the ego.
_NEVER: Final = -2
_UNKNOWN: Final = -1


@dataclass(frozen=True)
class Beside:
    """Where rectangles are beside paths; R pairs.

    Attributes:
        inside: (R,) whether part of the rectangle is in the corridor.
        low: (R,) arc length of its nearer end, m.
        high: (R,) arc length of its farther end, m.
        lateral: (R,) lateral offset of its centre, m, left positive.
        half: (R,) half of its extent across the path, m.
        turn: (R,) its heading against the path's, rad.
    """

    inside: BoolArray
    low: FloatArray
    high: FloatArray
    lateral: FloatArray
    half: FloatArray
    turn: FloatArray


def beside(
    points: FloatArray,
    heading: FloatArray,
    first: FloatArray,
    pose: FloatArray,
    size: FloatArray,
    half_width: FloatArray,
) -> Beside:
    """Projects rectangles onto paths.

    Args:
        points: (R, M, 2) points of the paths, ``SPACING`` apart, m.
        heading: (R, M) headings there, rad.
        first: (R,) arc length of the first point, m.
        pose: (R, 3) centres, m, and headings, rad, of the rectangles.
        size: (R, 2) their length and width, m.
        half_width: (R, M) half widths of the corridors there, m.

    Returns:
        Where they are.
    """
    offset = pose[:, None, :2] - points
    nearest = np.argmin(offset[..., 0] ** 2 + offset[..., 1] ** 2, axis=1)
    each = np.arange(len(pose))
    offset, angle = offset[each, nearest], heading[each, nearest]
    cos, sin = np.cos(angle), np.sin(angle)
    along = offset[:, 0] * cos + offset[:, 1] * sin
    lateral = offset[:, 1] * cos - offset[:, 0] * sin
    turn = pose[:, 2] - angle
    turned, across = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    reach = 0.5 * (size[:, 0] * turned + size[:, 1] * across)
    half = 0.5 * (size[:, 0] * across + size[:, 1] * turned)
    centre = first + SPACING * nearest + along
    inside = (np.abs(lateral) < half_width[each, nearest] + half) & (
        np.abs(along) < SPACING + reach
    )
    return Beside(inside, centre - reach, centre + reach, lateral, half, turn)


def ego_beside(
    paths: Paths, rows: IntArray, way: FloatArray, pose: FloatArray, size: FloatArray, side: float
) -> Beside:
    """Projects the ego onto the ways ahead of road users.

    Args:
        paths: The paths.
        rows: (R,) road users.
        way: (R,) where they are, m.
        pose: (3,) centre, m, and heading, rad, of the ego; or (R, 3).
        size: (2,) its length and width, m.
        side: What is added to each side of a road user to give its corridor, m.

    Returns:
        Where the ego is.
    """
    start = np.maximum(np.floor(way / SPACING).astype(np.int64) - 2, 0)
    index = np.minimum(start[:, None] + np.arange(_SIGHT), paths.count[rows, None] - 1)
    points, heading = paths.points[rows[:, None], index], paths.heading[rows[:, None], index]
    poses = np.broadcast_to(pose, (len(rows), 3))
    sizes = np.broadcast_to(size, (len(rows), 2))
    found = beside(
        points,
        heading,
        SPACING * start,
        poses,
        sizes,
        paths.half_width(rows[:, None], index, side),
    )
    # In bends the rectangles themselves are tried, point by point.
    own = paths.tracks.size[rows] + np.array([0.0, 2.0 * side])
    reach = 0.5 * (np.hypot(own[:, 0], own[:, 1]) + np.hypot(sizes[:, 0], sizes[:, 1]))
    offset = points - poses[:, None, :2]
    near = offset[..., 0] ** 2 + offset[..., 1] ** 2 < reach[:, None] ** 2
    near &= SPACING * (start[:, None] + np.arange(_SIGHT)) > way[:, None]
    row, point = np.nonzero(near)
    if not len(row):
        return found
    there = np.column_stack([points[row, point], heading[row, point]])
    hits = rectangles_overlap(there, own[row], poses[row], sizes[row])
    row, point = row[hits], point[hits]
    inside, low, high = np.array(found.inside), np.array(found.low), np.array(found.high)
    fresh = ~inside[row]  # What the projection has found it knows more exactly.
    row, point = row[fresh], point[fresh]
    front = SPACING * (start[row] + point - 1) + 0.5 * own[row, 0]
    low[row], high[row] = np.inf, -np.inf
    np.minimum.at(low, row, front)
    np.maximum.at(high, row, front)
    inside[row] = True
    return replace(found, inside=inside, low=low, high=np.maximum(high, found.high))


class Meetings:
    """Where paths meet, in tables over the points of the one who is met; made when first needed.

    The columns of ``table``: whether it is in the corridor at that point; its nearer and farther
    end there, m; cosine of its heading against the path's; the next point at which it is in the
    corridor, and the one at which it has left again; nearest and farthest end on the way between.
    """

    def __init__(self, paths: Paths, side: float) -> None:
        """Makes no table yet.

        Args:
            paths: The paths.
            side: What is added to each side of a road user to give its corridor, m.
        """
        self._paths, self._side = paths, side
        n, self._width = paths.points.shape[:2]
        self._index = np.full((n, n), _UNKNOWN)
        self._tables = np.empty((0, 8, self._width), dtype=np.float32)
        self._used = 0
        reach = paths.tracks.size.max(axis=1, initial=0.0)[:, None]
        self._low = paths.points.min(axis=1) - reach if n else np.empty((0, 2))
        self._high = paths.points.max(axis=1) + reach if n else np.empty((0, 2))

    def of(self, owner: IntArray, other: IntArray) -> tuple[IntArray, BoolArray]:
        """Finds the tables of pairs.

        Args:
            owner: (P,) whose corridors they are.
            other: (P,) who is met.

        Returns:
            (P,) indices of ``table``, and (P,) whether the paths meet at all.
        """
        index = self._index[owner, other]
        for pair in np.flatnonzero(index == _UNKNOWN):
            index[pair] = self._make(int(owner[pair]), int(other[pair]))
        return index, index >= 0

    def known(self, one: IntArray, other: IntArray) -> BoolArray:
        """Which pairs have been looked at already, both ways."""
        index = self._index
        return np.asarray((index[one, other] != _UNKNOWN) & (index[other, one] != _UNKNOWN))

    def never(self, one: IntArray, other: IntArray) -> BoolArray:
        """Which pairs are known not to meet, either way."""
        index = self._index
        return np.asarray((index[one, other] == _NEVER) & (index[other, one] == _NEVER))

    def look_up(self, index: IntArray, point: IntArray) -> FloatArray:
        """Reads tables.

        Args:
            index: (P,) indices from ``of``.
            point: (P,) points of the one who is met.

        Returns:
            (P, 8) the columns.
        """
        return np.asarray(self._tables[index, :, point], dtype=np.float64)

    def _make(self, owner: int, other: int) -> int:
        paths = self._paths
        apart = self._low[owner] > self._high[other]
        apart |= self._low[other] > self._high[owner]
        if apart.any():
            self._index[owner, other] = _NEVER
            return _NEVER
        count, met = int(paths.count[owner]), int(paths.count[other])
        size = paths.tracks.size
        half_width = paths.half_width(np.array([owner]), np.arange(count), self._side)
        pose = np.column_stack([paths.points[other, :met], paths.heading[other, :met]])
        seen = beside(
            np.broadcast_to(paths.points[owner, :count], (met, count, 2)),
            np.broadcast_to(paths.heading[owner, :count], (met, count)),
            np.zeros(met),
            pose,
            np.broadcast_to(size[other], (met, 2)),
            np.broadcast_to(half_width, (met, count)),
        )
        if not seen.inside.any():
            self._index[owner, other] = _NEVER
            return _NEVER
        table = np.empty((8, self._width), dtype=np.float32)
        table[:, met:] = 0.0
        table[4:6, met:] = np.inf
        table[0, :met], table[1, :met], table[2, :met] = seen.inside, seen.low, seen.high
        table[3, :met] = np.cos(seen.turn)
        table[4:, :met] = _runs(seen)
        if self._used == len(self._tables):
            grown = np.empty((max(64, 2 * self._used), 8, self._width), dtype=np.float32)
            grown[: self._used] = self._tables
            self._tables = grown
        self._tables[self._used] = table
        self._index[owner, other] = self._used
        self._used += 1
        return self._used - 1


def _runs(seen: Beside) -> FloatArray:
    """For each point the run of points inside that comes next, or that it is part of."""
    edges = np.diff(np.concatenate([[False], seen.inside, [False]]).astype(np.int8))
    begin, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    bounds = np.column_stack([begin, end]).reshape(-1)
    low = np.minimum.reduceat(np.append(seen.low, np.inf), bounds)[::2]
    high = np.maximum.reduceat(np.append(seen.high, -np.inf), bounds)[::2]
    # Who leaves the corridor nowhere before its path ends, stays in it.
    leaves = np.where(end < len(seen.inside), end, np.inf)
    run = np.searchsorted(end, np.arange(len(seen.inside)), side="right")
    columns = np.full((4, len(seen.inside)), np.inf)
    there = run < len(begin)
    for row, value in enumerate((begin, leaves, low, high)):
        columns[row, there] = value[run[there]]
    return columns
