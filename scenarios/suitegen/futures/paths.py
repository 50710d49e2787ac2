"""Paths along which a drive is looked for: the route, beside it, around who stands, as driven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dosplan.geometry import ReferencePath, extended_path, rectangle_corners
from dosplan.types import EGO_VELOCITY, USER_VELOCITY, FloatArray, IntArray, Scenario
from dosplan.vehicle import VehicleParameters

OFFSETS = (0.4, -0.4, 0.8, -0.8, 1.3, -1.3)
"""Lateral offsets from the route that are tried, m, left positive."""
SPACING = 0.5
"""Distance between the points of a path, m."""
STANDING = 0.3
"""Speed up to which a road user stands, m/s."""
STANDS_FOR = 3.0
"""Time that somebody has to stand to be passed, s."""
BESIDE = 0.4
"""Distance at which one who stands is passed, m."""
AHEAD = 5.0
"""The ego's axle is fully aside this far before and behind one who stands, m."""
RAMP = (10.0, 1.2)
"""Way to move aside: at least, m, and time at the speed of the start, s."""


def paths(scenario: Scenario, driven: Sequence[FloatArray]) -> Iterator[ReferencePath]:
    """The paths to try, the plainest first.

    Args:
        scenario: The scenario; its recording is the future.
        driven: Drives of others for the same task, (K, 4) each; their paths are tried too.

    Yields:
        Paths for the rear axle, 100 m longer at both ends.
    """
    task = scenario.task
    route = extended_path(task.route)
    yield route
    yield from (_driven_path(drive, task.vehicle) for drive in driven)
    yield from _around(scenario, route)
    steps = np.arange(route.arclength[0], route.arclength[-1], SPACING)
    for offset in OFFSETS:
        yield _beside(route, steps, np.full(len(steps), offset))


def _driven_path(drive: FloatArray, vehicle: VehicleParameters) -> ReferencePath:
    """The path of the rear axle of a drive, which goes on straight at both ends."""
    forward = np.column_stack([np.cos(drive[:, 2]), np.sin(drive[:, 2])])
    points = drive[:, :2] - vehicle.rear_to_centre * forward
    moved = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 0.02])
    points, forward = points[moved], forward[moved]
    points = np.vstack([points[0] - 100.0 * forward[0], points, points[-1] + 100.0 * forward[-1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    steps = np.arange(0.0, along[-1], SPACING)
    return _path(np.column_stack([np.interp(steps, along, points[:, i]) for i in (0, 1)]))


def _around(scenario: Scenario, route: ReferencePath) -> Iterator[ReferencePath]:
    """Paths that pass who stands in the way: on the nearer side, all on the left, on the right."""
    task = scenario.task
    corners = rectangle_corners(*_standing(scenario))
    if not len(corners):
        return
    along = route.locate(corners)
    across = route.offset(corners, along)
    half = 0.5 * task.vehicle.width
    low, high = across.min(axis=1), across.max(axis=1)
    ahead = along.max(axis=1) > route.locate(task.start[:2])
    in_way = ahead & (low < half + BESIDE) & (high > -half - BESIDE)
    if not in_way.any():
        return
    low, high, along = low[in_way], high[in_way], along[in_way]
    leftwards = high + half + BESIDE
    rightwards = low - half - BESIDE
    nearer = np.where(leftwards < -rightwards, leftwards, rightwards)
    ramp = max(RAMP[0], RAMP[1] * float(task.start[EGO_VELOCITY]))
    steps = np.arange(route.arclength[0], route.arclength[-1], SPACING)
    kernel = np.hanning(int(ramp / SPACING) + 2)
    kernel /= kernel.sum()
    for wanted in (nearer, leftwards, rightwards):
        most, least = np.zeros(len(steps)), np.zeros(len(steps))
        for offset, places in zip(wanted, along, strict=True):
            reach = AHEAD + 0.5 * ramp
            there = (steps > places.min() - reach) & (steps < places.max() + reach)
            most[there] = np.maximum(most[there], offset)
            least[there] = np.minimum(least[there], offset)
        yield _beside(route, steps, np.convolve(most + least, kernel, mode="same"))


def _standing(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Poses and sizes of those who stand for long: (M, 3) and (M, 2)."""
    tracks, start = scenario.tracks, scenario.task.start_step
    stands = tracks.valid[:, start:] & (np.abs(tracks.states[:, start:, USER_VELOCITY]) < STANDING)
    rows: IntArray = np.flatnonzero(stands.sum(axis=1) * scenario.dt >= STANDS_FOR)
    last = stands.shape[1] - 1 - np.argmax(stands[rows, ::-1], axis=1)
    return tracks.states[rows, start + last, :3], tracks.size[rows]


def _beside(route: ReferencePath, steps: FloatArray, offset: FloatArray) -> ReferencePath:
    """The path with an offset to the left at each of some arc lengths."""
    heading = route.heading_at(steps)
    x = np.interp(steps, route.arclength, route.points[:, 0]) - offset * np.sin(heading)
    y = np.interp(steps, route.arclength, route.points[:, 1]) + offset * np.cos(heading)
    return _path(np.column_stack([x, y]))


def _path(points: FloatArray) -> ReferencePath:
    """A path through points about ``SPACING`` apart."""
    pieces = np.diff(points, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*pieces.T))])
    turns = np.unwrap(np.arctan2(pieces[:, 1], pieces[:, 0]))
    middles = 0.5 * (along[1:] + along[:-1])
    heading = np.interp(along, middles, turns)
    bend = np.gradient(heading, along)
    kernel = np.hanning(7) / np.hanning(7).sum()
    return ReferencePath(along, points, heading, np.convolve(bend, kernel, mode="same"))
