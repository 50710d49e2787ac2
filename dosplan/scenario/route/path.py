"""The reference path: centre lines, joined, blended at lane changes, and smoothed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise, takewhile
from typing import Final

import numpy as np
import shapely
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded

from dosplan.geometry import side_by_side
from dosplan.types import FloatArray, Lanelet

SPACING: Final = 0.5
"""Distance between path points, m."""
BEHIND: Final = 30.0
"""Length of path behind the ego's start, m."""
BEYOND: Final = 100.0
"""Length of path after ``ahead``, straight on where the road has ended, m."""
CHANGE_SECONDS: Final = 3.0
CHANGE_LENGTH: Final = (15.0, 60.0)
"""Time a lane change takes where there is room, s, and the limits of its length, m."""
MARGIN: Final = 0.25
"""Distance that smoothing leaves between the ego's side and the corridor's edge, m."""
SMOOTHING: Final = 4.0
"""Length scale below which the path has no detail, m."""
_DEVIATION: Final = (0.05, 1.0)
_PASSES: Final = 8
_COINCIDENT: Final = 1e-3


def raw_path(
    chain: Sequence[Lanelet],
    lanelets: Mapping[int, Lanelet],
    *,
    centre: FloatArray,
    velocity: float,
    ahead: float,
    to_goal: int,
) -> FloatArray:
    """Centre lines of a route, joined, with lane changes blended in.

    Args:
        chain: The lanelets of the route.
        lanelets: Every lanelet of the map by id.
        centre: (2,) where the ego starts, m.
        velocity: Of the ego, m/s.
        ahead: Length of path that is needed ahead of the ego, m.
        to_goal: Number of lanelets up to the goal; the rest only goes on from there.

    Returns:
        (P, 2) points ``SPACING`` apart from ``BEHIND`` behind the ego to ``ahead`` before it,
        and ``BEYOND`` past the end of the road, m.
    """
    line = _with_lane_changes(_runs(chain), lanelets, centre, velocity, to_goal)
    begun = float(shapely.line_locate_point(shapely.LineString(line), shapely.Point(centre)))
    end = begun + max(ahead, min(_length(line) - begun, ahead) + BEYOND)
    s = np.arange(begun - BEHIND, end + 3.0 * SPACING, SPACING)
    return _at(line, s)


def begun_beside(
    raw: FloatArray, centre: FloatArray, velocity: float, goals: Sequence[shapely.Geometry]
) -> tuple[FloatArray, int]:
    """A path that begins where the ego is, beside its lane, and then comes back to the lane.

    It comes back as in a lane change, at once, or after the goal where only the road beside the
    lane leads over one.

    Args:
        raw: (P, 2) the path in the lane, points ``SPACING`` apart from ``BEHIND`` behind the ego.
        centre: (2,) where the ego starts, m.
        velocity: Of the ego, m/s.
        goals: Areas of the goals.

    Returns:
        (P, 2) m, and the number of its points up to where it is back in the lane.
    """
    start = round(BEHIND / SPACING)
    along = np.gradient(raw, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    beside = ((centre - raw[start]) @ normal[start]) * normal
    leaves = start + SMOOTHING / SPACING  # so that smoothing does not move the path at the ego
    if not any(shapely.intersects_xy(goal, raw[start:]).any() for goal in goals):
        for goal in goals:
            there = np.flatnonzero(shapely.intersects_xy(goal, (raw + beside)[start:]))
            leaves = max(leaves, start + float(there.max(initial=0)))
    length = float(np.clip(CHANGE_SECONDS * velocity, *CHANGE_LENGTH)) / SPACING
    share = 1.0 - _change((np.arange(len(raw)) - leaves).clip(0.0, length) / length)
    return raw + share[:, None] * beside, int(np.count_nonzero(share))


def finished_path(
    raw: FloatArray, clearance: FloatArray, width: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smooths a path without leaving the corridor.

    Whittaker's smoother with third differences (P. Eilers, "A perfect smoother", Anal. Chem. 75,
    2003): the path that minimises its change of curvature and its distance from ``raw``. A point
    may move by what its clearance leaves beside the ego's width and ``MARGIN``; where one would
    move further, its weight is raised and the path solved again.

    Args:
        raw: (P, 2) points ``SPACING`` apart, m.
        clearance: (P,) distance of each to the corridor's edge, m.
        width: Of the ego, m.

    Returns:
        (Q, 2) points ``SPACING`` apart, m; (Q,) heading, rad, continuous; (Q,) curvature, 1/m.
    """
    room = clearance - 0.5 * width - MARGIN
    allowed = np.where(clearance < 0.0, _DEVIATION[1], np.clip(room, *_DEVIATION))
    weight = np.ones(len(raw))
    for _ in range(_PASSES):
        smooth = _whittaker(raw, weight)
        excess = np.hypot(*(smooth - raw).T) / allowed
        if np.all(excess <= 1.0):
            break
        weight *= np.maximum(excess, 1.0) ** 2
    return _resampled(smooth)


def _whittaker(points: FloatArray, weight: FloatArray) -> FloatArray:
    """Solves (W + c D'D) z = W y with D the third differences, in banded form."""
    n = len(points)
    stencil = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for row in range(4):
        for other in range(row, 4):
            bands[other - row, row : n - 3 + row] += stencil[row] * stencil[other]
    bands *= (SMOOTHING / SPACING) ** 6
    bands[0] += weight
    return np.asarray(solveh_banded(bands, weight[:, None] * points, lower=True))


def _resampled(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A cubic spline through the points, taken at equal arc lengths."""
    spline = CubicSpline(_chords(points), points)
    fine = np.linspace(0.0, spline.x[-1], 8 * len(points))
    s = _chords(spline(fine))
    u = np.interp(SPACING * np.arange(int(s[-1] / SPACING) + 1), s, fine)
    first, second = spline(u, 1), spline(u, 2)
    heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return spline(u), heading, turn / np.hypot(*first.T) ** 3


def _runs(chain: Sequence[Lanelet]) -> list[list[Lanelet]]:
    """The lanelets between changes of lane."""
    runs = [[chain[0]]]
    for before, after in pairwise(chain):
        if after.id in before.successors:
            runs[-1].append(after)
        else:
            runs.append([after])
    return runs


def _with_lane_changes(
    runs: list[list[Lanelet]],
    lanelets: Mapping[int, Lanelet],
    centre: FloatArray,
    velocity: float,
    to_goal: int,
) -> FloatArray:
    """One line over all runs; each change is blended over the stretch both lanes share.

    Changes on the way to the goal begin as soon as they can, those after it as late as they can.
    """
    line = _joined([*_before(runs[0][0], lanelets, centre), *runs[0]])
    begun = float(shapely.line_locate_point(shapely.LineString(line), shapely.Point(centre)))
    free_from = begun + SMOOTHING  # so that smoothing does not move the path at the ego
    driven = 0
    for i, (run, following) in enumerate(pairwise(runs)):
        driven += len(run)
        shared, _ = side_by_side(run, following, lanelets)
        line = _joined([line, *(a for a, _ in shared if a not in run)])
        end = _length(line)
        begin = max(end - sum(_length(a.centre) for a, _ in shared), free_from)
        more = 1 + sum(1 for _ in takewhile(lambda r: len(r) == 1, runs[i + 1 : -1]))
        wanted = min(np.clip(CHANGE_SECONDS * velocity, *CHANGE_LENGTH), (end - begin) / more)
        length = max(float(wanted), CHANGE_LENGTH[0])
        if driven >= to_goal:
            begin = max(end - length, begin)
        u = np.linspace(0.0, 1.0, max(int(length / SPACING), 2))
        here = _at(line, begin + u * length)
        target = _joined([*(b for _, b in shared if b not in following), *following])
        beside = shapely.line_locate_point(shapely.LineString(target), shapely.points(here))
        share = _change(u)[:, None]
        blend = (1.0 - share) * here + share * _at(target, beside)
        line = _joined([_part(line, 0.0, begin), blend, _part(target, float(beside[-1]), np.inf)])
        free_from = begin + _length(blend)
    return line


def _change(u: FloatArray) -> FloatArray:
    """Share of a lane change that is done: 10 u^3 - 15 u^4 + 6 u^5.

    Its first and second derivatives vanish at both ends.
    """
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))


def _before(first: Lanelet, lanelets: Mapping[int, Lanelet], centre: FloatArray) -> list[Lanelet]:
    """Lanelets that lead to the first one, straightest first choice, for ``BEHIND`` m."""
    behind = float(
        shapely.line_locate_point(shapely.LineString(first.centre), shapely.Point(centre))
    )
    out: list[Lanelet] = []
    here = first
    while behind < BEHIND and here.predecessors:
        ahead = here.centre[1] - here.centre[0]
        earlier = [lanelets[name] for name in here.predecessors]
        here = max(earlier, key=lambda lane: _alignment(lane.centre[-1] - lane.centre[-2], ahead))
        if here is first or here in out:
            break
        out.insert(0, here)
        behind += _length(here.centre)
    return out


def _alignment(a: FloatArray, b: FloatArray) -> float:
    return float(a @ b / (np.hypot(*a) * np.hypot(*b) + 1e-12))


def _joined(parts: Sequence[Lanelet | FloatArray]) -> FloatArray:
    """Lines one after the other, points that repeat left out."""
    lines = [part.centre if isinstance(part, Lanelet) else part for part in parts]
    points = np.concatenate(lines)
    fresh = np.hypot(*np.diff(points, axis=0).T) > _COINCIDENT
    return np.asarray(points[np.concatenate([[True], fresh])])


def _chords(points: FloatArray) -> FloatArray:
    """(P,) arc length of a line's points, m."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def _length(points: FloatArray) -> float:
    return float(_chords(points)[-1])


def _part(line: FloatArray, start: float, end: float) -> FloatArray:
    """The part of a line between two arc lengths."""
    s = _chords(line)
    cuts = np.clip([start, end], 0.0, s[-1])
    inner = (s > cuts[0]) & (s < cuts[1])
    ends = _at(line, cuts)
    return np.concatenate([ends[:1], line[inner], ends[1:]])


def _at(line: FloatArray, s: FloatArray) -> FloatArray:
    """Points of a line at arc lengths; it goes on straight at both ends."""
    known = _chords(line)
    i = np.clip(np.searchsorted(known, s, side="right") - 1, 0, len(known) - 2)
    share = (s - known[i]) / (known[i + 1] - known[i])
    return np.asarray(line[i] + share[:, None] * (line[i + 1] - line[i]))
