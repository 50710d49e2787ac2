"""Small plane geometry shared by the benchmark and its plug-ins; everything else is shapely's."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely
from shapely.geometry import MultiPolygon, Polygon

from dosplan.types import BoolArray, FloatArray, Lanelet, RoadMap

SEAM: Final = 0.1
"""Half the width of the gaps between lanelets that count as road, m.

Neighbouring lanelets of recorded maps do not share their bounds exactly, and where several meet
there are narrow gaps. Of the published solutions (71 looked at), 13 leave the plain union of
lanelets and none the union with gaps of up to 0.04 m closed. A gap of 0.2 m is narrower than a
car's tyre, so it is no edge of the road.
"""
_UNIT_CORNERS = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])


def wrap_angle(angle: npt.ArrayLike) -> FloatArray:
    """Wraps angles to [-pi, pi).

    Args:
        angle: rad, any shape.

    Returns:
        rad, same shape.
    """
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi)


def to_world(points: FloatArray, poses: FloatArray) -> FloatArray:
    """Moves body-frame points to poses.

    Args:
        points: (..., V, 2) points in the body frame, m.
        poses: (..., 3) x, y, m, and heading, rad.

    Returns:
        (..., V, 2) points in the scenario frame, m.
    """
    cos, sin = np.cos(poses[..., None, 2]), np.sin(poses[..., None, 2])
    x, y = points[..., 0], points[..., 1]
    return np.stack(
        [poses[..., None, 0] + cos * x - sin * y, poses[..., None, 1] + sin * x + cos * y], axis=-1
    )


def to_body(points: FloatArray, poses: FloatArray) -> FloatArray:
    """Moves scenario-frame points into the frames of poses; the inverse of ``to_world``.

    Args:
        points: (..., V, 2) points in the scenario frame, m.
        poses: (..., 3) x, y, m, and heading, rad.

    Returns:
        (..., V, 2) points in the body frame, m.
    """
    cos, sin = np.cos(poses[..., None, 2]), np.sin(poses[..., None, 2])
    x, y = points[..., 0] - poses[..., None, 0], points[..., 1] - poses[..., None, 1]
    return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """How far pairs of vectors turn from the first to the second: positive to the left.

    Args:
        a: (..., 2) vectors.
        b: (..., 2) vectors.

    Returns:
        (...) products of their lengths and the sine of the angle between them.
    """
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def rectangle_corners(poses: FloatArray, size: npt.ArrayLike) -> FloatArray:
    """Corners of rectangles, counter-clockwise from the front left.

    Args:
        poses: (..., 3) centre x, y, m, and heading, rad.
        size: (..., 2) length and width, m.

    Returns:
        (..., 4, 2) m.
    """
    return to_world(_UNIT_CORNERS * np.asarray(size, dtype=np.float64)[..., None, :], poses)


def rectangles_overlap(
    pose_a: FloatArray, size_a: npt.ArrayLike, pose_b: FloatArray, size_b: npt.ArrayLike
) -> BoolArray:
    """Whether rectangles overlap, for many pairs at once (separating-axis theorem).

    Leading shapes are broadcast: a plan of T steps against N road users at these steps is
    ``pose_a`` of (T, 3) against ``pose_b`` of (N, T, 3). Rectangles that touch without an area in
    common do not overlap, nor does anything with one whose pose or size is NaN.

    Args:
        pose_a: (..., 3 or more) centre x, y, m, and heading, rad; further columns are not read.
        size_a: (..., 2) length and width, m.
        pose_b: (..., 3 or more) the same of the other one.
        size_b: (..., 2) likewise.

    Returns:
        (...) whether they do.
    """
    size_a, size_b = np.asarray(size_a, dtype=np.float64), np.asarray(size_b, dtype=np.float64)
    turn = pose_b[..., 2] - pose_a[..., 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    x, y = pose_b[..., 0] - pose_a[..., 0], pose_b[..., 1] - pose_a[..., 1]
    meets: BoolArray = np.asarray(True)
    for pose, own, other in ((pose_a, size_a, size_b), (pose_b, size_b, size_a)):
        c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        along, across = np.abs(x * c + y * s), np.abs(y * c - x * s)
        length = own[..., 0] + other[..., 0] * cos + other[..., 1] * sin
        width = own[..., 1] + other[..., 0] * sin + other[..., 1] * cos
        meets = meets & (along < 0.5 * length) & (across < 0.5 * width)
    return np.asarray(meets)


def lanelet_cells(left: FloatArray, right: FloatArray) -> FloatArray:
    """Quadrilaterals between consecutive pairs of a lanelet's bound points.

    Args:
        left: (P, 2) left bound, m.
        right: (P, 2) right bound, m, point by point beside ``left``.

    Returns:
        (P - 1, 4, 2) corners: left, next left, next right, right, m.
    """
    return np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)


def lanelet_polygon(left: FloatArray, right: FloatArray) -> Polygon | MultiPolygon:
    """Area of a lanelet.

    A lanelet whose bounds cross or fold back has no valid outline; its area is then the union of
    the convex hulls of its cells.

    Args:
        left: (P, 2) left bound, m.
        right: (P, 2) right bound, m, point by point beside ``left``.

    Returns:
        A valid polygon, m.
    """
    outline = Polygon(np.concatenate([left, right[::-1]]))
    if outline.is_valid and outline.area > 0:
        return outline
    cells = shapely.polygons(lanelet_cells(left, right))
    return areas(shapely.union_all(shapely.convex_hull(cells)))


def lanelet_union(lanelets: Iterable[Lanelet]) -> Polygon | MultiPolygon:
    """Union of lanelets, with the seams between them closed (see ``SEAM``).

    Args:
        lanelets: The lanelets.

    Returns:
        Their area, m.
    """
    return close_seams(shapely.union_all([lanelet_polygon(x.left, x.right) for x in lanelets]))


def close_seams(shape: shapely.Geometry) -> Polygon | MultiPolygon:
    """Closes the gaps in an area that are narrower than two ``SEAM``.

    Args:
        shape: The area, m.

    Returns:
        The area without these gaps, m.
    """
    grown = shapely.buffer(shape, SEAM, join_style="mitre")
    return areas(shapely.buffer(grown, -SEAM, join_style="mitre"))


def lanelets_off_road(road_map: RoadMap) -> Polygon | MultiPolygon:
    """Area of the lanelets that are no road for a car: sidewalks, bicycle lanes and the like.

    Args:
        road_map: The map.

    Returns:
        Their area without what is road as well, such as a crossing on a lane, m; often empty.
    """
    others = lanelet_union(x for x in road_map.lanelets if not x.is_road)
    return areas(shapely.difference(others, road_map.drivable))


def areas(shape: shapely.Geometry) -> Polygon | MultiPolygon:
    """The polygons of a geometry, without the points and lines that overlays leave behind.

    Args:
        shape: Any geometry.

    Returns:
        One polygon, or several as a MultiPolygon (empty where there is none).
    """
    parts = [p for p in shapely.get_parts(shape) if isinstance(p, Polygon) and not p.is_empty]
    return parts[0] if len(parts) == 1 else MultiPolygon(parts)
