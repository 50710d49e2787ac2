"""Who can be seen from a point: rays in all directions, each of which ends at the first body."""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import cross, rectangle_corners, to_world, wrap_angle
from dosplan.simulation.traffic import RoadUsers
from dosplan.types import USER_HEADING, BoolArray, FloatArray, IntArray

RAYS: Final = 3600
"""Rays all around, one every 0.1 degrees: as fine as a lidar's. A pedestrian at 100 m has three."""
_SAME: Final = 1e-6  # Bodies that a ray meets at the same distance, m, are both seen.


def visible(eye: FloatArray, users: RoadUsers) -> BoolArray:
    """Finds those of whom at least one ray meets some part first.

    Seen from above, everybody hides what is behind, low or high. Who stands around the eye hides
    nobody.

    Args:
        eye: (2,) where the rays begin, m.
        users: N road users, obstacles included.

    Returns:
        (N,) whether each is seen.
    """
    first, second, owner = _edges(users)
    count = len(users.ids)
    a, b = first - eye, second - eye
    begin = np.arctan2(a[:, 1], a[:, 0])
    span = wrap_angle(np.arctan2(b[:, 1], b[:, 0]) - begin)
    around = np.abs(np.bincount(owner, weights=span, minlength=count)) > np.pi
    # The rays between the ends of each edge, edge after edge.
    ray = 2.0 * np.pi / RAYS
    low = np.ceil(np.minimum(begin, begin + span) / ray).astype(np.int64)
    high = np.floor(np.maximum(begin, begin + span) / ray).astype(np.int64)
    each = np.where(around[owner], 0, np.maximum(high - low + 1, 0))
    edge = np.repeat(np.arange(len(each)), each)
    number = low[edge] + np.arange(len(edge)) - np.repeat(np.cumsum(each) - each, each)
    way = np.stack([np.cos(number * ray), np.sin(number * ray)], axis=-1)
    along = (b - a)[edge]
    sine = cross(way, along)
    met = np.abs(sine) > 0.0  # Not along the edge itself: its neighbours are met there.
    distance = np.where(met, cross(a[edge], along) / np.where(met, sine, 1.0), np.inf)
    nearest = np.full(RAYS, np.inf)
    np.minimum.at(nearest, number % RAYS, distance)
    reached = distance <= nearest[number % RAYS] + _SAME
    seen = np.array(around)
    seen[owner[edge[reached & met]]] = True
    return seen


def _edges(users: RoadUsers) -> tuple[FloatArray, FloatArray, IntArray]:
    """The edges of all outlines: (E, 2) ends, and (E,) whose each is."""
    poses = users.states[:, : USER_HEADING + 1]
    corners = rectangle_corners(poses, users.size)
    shapes = [
        corners[i] if outline is None else to_world(outline, poses[i])
        for i, outline in enumerate(users.outlines)
    ]
    if not shapes:
        return np.empty((0, 2)), np.empty((0, 2)), np.empty(0, dtype=np.int64)
    owner = np.repeat(np.arange(len(shapes)), [len(shape) for shape in shapes])
    following = [np.roll(shape, -1, axis=0) for shape in shapes]
    return np.concatenate(shapes), np.concatenate(following), owner
