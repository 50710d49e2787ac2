"""Cuts shapes into convex pieces, and finds the rectangles around those."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import areas, rectangle_corners
from dosplan.types import FloatArray

DEPTH: Final = 0.01
"""Depth of a notch, m, that is ignored, and width of a piece, m, that is left out."""
MAX_NOTCHES: Final = 24
"""Corners that point inwards up to which a shape is cut along its own edges."""


def is_convex(shape: shapely.Geometry) -> bool:
    """Whether a shape fills its convex hull except for notches of ``DEPTH``.

    Args:
        shape: A polygon or several.

    Returns:
        Whether it does.
    """
    return _is_thin(shapely.difference(shapely.convex_hull(shape), shape))


def _is_thin(shape: shapely.Geometry) -> bool:
    return bool(shapely.is_empty(shapely.buffer(shape, -0.5 * DEPTH)))


def convex_pieces(shape: shapely.Polygon | shapely.MultiPolygon) -> list[shapely.Polygon]:
    """Cuts a shape into convex pieces that cover it.

    At each corner that points inwards the shape is cut along one of the two edges that meet there:
    the one that leaves less room in the rectangles around the pieces, so that an L becomes two
    rectangles. A shape with holes or very many such corners is cut into triangles.

    Args:
        shape: A valid polygon or several.

    Returns:
        The pieces; none of a shape that is thinner than ``DEPTH``.
    """
    return [piece for part in shapely.get_parts(shape) for piece in _cut(part, MAX_NOTCHES)]


def _cut(polygon: shapely.Polygon, budget: int) -> list[shapely.Polygon]:
    if _is_thin(polygon):
        return []
    if is_convex(polygon):
        return [shapely.convex_hull(polygon)]
    ring = shapely.get_coordinates(shapely.orient_polygons(polygon).exterior)[:-1]
    before, after = np.roll(ring, 1, axis=0) - ring, np.roll(ring, -1, axis=0) - ring
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    notches = np.flatnonzero(turn > 1e-9 * np.hypot(*before.T) * np.hypot(*after.T))
    if budget <= 0 or len(polygon.interiors) or not 0 < len(notches) <= MAX_NOTCHES:
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
        return [triangle for triangle in triangles if not _is_thin(triangle)]
    notch = notches[0]
    options = [
        _parted(polygon, ring[notch], float(np.arctan2(edge[1], edge[0])))
        for edge in (before[notch], after[notch])
    ]
    room = [sum(shapely.minimum_rotated_rectangle(p).area for p in parts) for parts in options]
    best = options[int(np.argmin(room))]
    return [piece for part in best for piece in _cut(part, budget - 1)]


def _parted(polygon: shapely.Polygon, at: FloatArray, heading: float) -> list[shapely.Polygon]:
    """The parts of a shape on both sides of a line."""
    reach = 2.0 * float(np.hypot(*np.ptp(shapely.get_coordinates(polygon), axis=0)))
    centre = at + reach * np.array([-np.sin(heading), np.cos(heading)])
    side = shapely.Polygon(rectangle_corners(np.array([*centre, heading]), (4 * reach, 2 * reach)))
    return [
        part
        for half in (shapely.intersection(polygon, side), shapely.difference(polygon, side))
        for part in shapely.get_parts(areas(half))
    ]


def enclosing_rectangles(piece: shapely.Polygon) -> Iterator[tuple[FloatArray, FloatArray]]:
    """The rectangles around a convex shape along each of its edges, the smallest first.

    Args:
        piece: The shape.

    Yields:
        (3,) x, y, m, and heading, rad, of the centre, along the longer side; (2,) length and
        width, m.
    """
    ring = shapely.get_coordinates(piece)
    edges = np.diff(ring, axis=0)
    found = []
    for heading in np.unique(np.round(np.arctan2(edges[:, 1], edges[:, 0]) % (0.5 * np.pi), 9)):
        cos, sin = np.cos(heading), np.sin(heading)
        seen = ring @ np.array([[cos, -sin], [sin, cos]])
        low, size = seen.min(axis=0), np.ptp(seen, axis=0)
        centre = np.array([[cos, -sin], [sin, cos]]) @ (low + 0.5 * size)
        turned = heading if size[0] >= size[1] else heading + 0.5 * np.pi
        found.append((np.array([*centre, turned]), np.sort(size)[::-1]))
    yield from sorted(found, key=lambda rectangle: float(np.prod(rectangle[1])))


def halves(piece: shapely.Polygon) -> list[shapely.Polygon]:
    """Cuts a convex shape across the longer side of the smallest rectangle around it.

    Args:
        piece: The shape.

    Returns:
        The two parts.
    """
    pose, _ = next(enclosing_rectangles(piece))
    return _parted(piece, pose[:2], pose[2] + 0.5 * np.pi)
