"""Exact and uncertain values of commonroad-io states, and its shapes."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import shapely

from dosplan.geometry import areas, rectangle_corners, to_world
from dosplan.types import FloatArray

CIRCLE_VERTICES: Final = 32


def exact(value: Any) -> float:
    """A number, or the middle of an interval.

    Args:
        value: A number or a commonroad-io interval.

    Returns:
        The number.
    """
    if hasattr(value, "start") and hasattr(value, "end"):
        return 0.5 * (float(value.start) + float(value.end))
    return float(value)


def position(value: Any) -> FloatArray:
    """A point, or the centre of an area in which the position is known to be.

    Args:
        value: A coordinate array or a commonroad-io shape.

    Returns:
        (2,) m.
    """
    if isinstance(value, np.ndarray):
        return np.asarray(value[:2], dtype=np.float64)
    return np.asarray(shapely.get_coordinates(shapely.centroid(region(value)))[0])


def outlines(shape: Any) -> list[FloatArray]:
    """Vertices of the parts of a shape, in the shape's own frame.

    A circle becomes a regular polygon of 32 vertices around it (larger by at most 0.5 % of the
    radius). commonroad-io's own polygons are not used: a circle's there has half its radius.

    Args:
        shape: A commonroad-io shape.

    Returns:
        Polygons (V, 2), m; several for a group.
    """
    if hasattr(shape, "shapes"):
        return [outline for part in shape.shapes for outline in outlines(part)]
    if hasattr(shape, "radius"):
        angle = 2.0 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        radius = float(shape.radius) / np.cos(np.pi / CIRCLE_VERTICES)
        return [np.asarray(shape.center[:2] + radius * circle)]
    if hasattr(shape, "length"):
        pose = np.array([*shape.center[:2], shape.orientation], dtype=np.float64)
        return [rectangle_corners(pose, (shape.length, shape.width))]
    return [np.asarray(shape.vertices, dtype=np.float64)[:-1, :2]]


def region(shape: Any) -> shapely.Polygon | shapely.MultiPolygon:
    """Area of a shape that stands in the scenario frame.

    Args:
        shape: A commonroad-io shape.

    Returns:
        A valid polygon, m.
    """
    parts = [shapely.make_valid(shapely.Polygon(outline)) for outline in outlines(shape)]
    return areas(shapely.union_all(parts))


def body(shape: Any) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Body of a road user relative to the point that its states describe.

    A rectangle stays one, wherever it is and however it is turned. Any other shape becomes its
    convex hull, and ``size`` the box around that.

    Args:
        shape: A commonroad-io shape in the road user's frame.

    Returns:
        ``(pose, size, outline)``: (3,) x, y, m, and heading, rad, of the body's centre in the
        frame of the states; (2,) length and width, m; (V, 2) vertices around the centre, m, or
        None for a rectangle.
    """
    if hasattr(shape, "length"):
        pose = np.array([*shape.center[:2], shape.orientation], dtype=np.float64)
        return pose, np.array([shape.length, shape.width], dtype=np.float64), None
    points = np.concatenate(outlines(shape))
    hull = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(points)))[:-1]
    low, high = hull.min(axis=0), hull.max(axis=0)
    middle = 0.5 * (low + high)
    return np.array([*middle, 0.0]), high - low, hull - middle


def moved(pose: FloatArray, states: FloatArray) -> FloatArray:
    """Centres of a body whose reference points are given.

    Args:
        pose: (3,) pose of the body in the frame of the states.
        states: (K, 3) x, y, m, and heading, rad, of the reference point.

    Returns:
        (K, 3) x, y and heading of the body.
    """
    centre = to_world(pose[None, :2], states)[:, 0]
    return np.column_stack([centre, states[:, 2] + pose[2]])
