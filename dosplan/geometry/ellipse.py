"""Ellipses: how far a point is from one, and how far one reaches along a direction."""

from __future__ import annotations

import numpy as np

from dosplan.types import BoolArray, FloatArray, Occupancy


def mahalanobis(
    point: FloatArray, centre: FloatArray, semi_axes: FloatArray, angle: FloatArray
) -> FloatArray:
    """Distance of a point to an ellipse's centre in multiples of the ellipse: 1 on its boundary.

    With (u, v) the point in the frame of the axes, d = sqrt((u / a)^2 + (v / b)^2). Along a
    semi-axis of zero there is the centre only: every other point is infinitely far.

    Args:
        point: (..., 2) points, m.
        centre: (..., 2) centres, m.
        semi_axes: (..., 2) semi-axes a and b, m, >= 0.
        angle: (...) direction of the first semi-axis, rad.

    Returns:
        (...) distances; NaN where a point or a centre is.
    """
    x, y = np.moveaxis(point - centre, -1, 0)
    cos, sin = np.cos(angle), np.sin(angle)
    local = np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)
    outside = np.where(local == 0.0, 0.0, np.inf)
    scaled = np.divide(np.abs(local), semi_axes, out=outside, where=semi_axes > 0.0)
    distance = np.hypot(scaled[..., 0], scaled[..., 1])
    return np.where(np.isnan(x) | np.isnan(y), np.nan, distance)


def inside_ellipse(
    point: FloatArray, centre: FloatArray, semi_axes: FloatArray, angle: FloatArray
) -> BoolArray:
    """Whether a point lies in an ellipse; its boundary belongs to it.

    Args:
        point: (..., 2) points, m.
        centre: (..., 2) centres, m.
        semi_axes: (..., 2) semi-axes, m, >= 0.
        angle: (...) direction of the first semi-axis, rad.

    Returns:
        (...) False where a point or a centre is NaN.
    """
    return np.asarray(mahalanobis(point, centre, semi_axes, angle) <= 1.0)


def ellipse_area(semi_axes: FloatArray) -> FloatArray:
    """Area of an ellipse, pi a b (the paper's pi/4 l w with l = 2 a and w = 2 b).

    Args:
        semi_axes: (..., 2) semi-axes, m.

    Returns:
        (...) m2.
    """
    return np.asarray(np.pi * semi_axes[..., 0] * semi_axes[..., 1])


def ellipse_extent(semi_axes: FloatArray, turn: FloatArray) -> FloatArray:
    """How far an ellipse reaches along a direction and across it.

    It is the support function: sqrt((a cos d)^2 + (b sin d)^2) in a direction that is d off the
    first semi-axis.

    Args:
        semi_axes: (..., 2) semi-axes a and b, m.
        turn: (...) angle between the direction and the first semi-axis, rad.

    Returns:
        (..., 2) from the centre along and across the direction, m.
    """
    cos, sin = np.cos(turn), np.sin(turn)
    first, second = semi_axes[..., 0], semi_axes[..., 1]
    return np.stack(
        [np.hypot(first * cos, second * sin), np.hypot(first * sin, second * cos)], axis=-1
    )


def ellipse_boundary(
    centre: FloatArray, semi_axes: FloatArray, angle: FloatArray, count: int
) -> FloatArray:
    """Points all around the boundary of an ellipse.

    Args:
        centre: (..., 2) centres, m.
        semi_axes: (..., 2) semi-axes, m.
        angle: (...) direction of the first semi-axis, rad.
        count: Number P of points, the first at the end of the first semi-axis.

    Returns:
        (..., P, 2) m.
    """
    around = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    local = semi_axes[..., None, :] * np.stack([np.cos(around), np.sin(around)], axis=-1)
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = local[..., 0], local[..., 1]
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return np.asarray(centre[..., None, :] + turned)


def set_sizes(occupancy: Occupancy, steps: int | None = None) -> FloatArray:
    """Rectangles along each road user's heading that hold its footprint anywhere in its set.

    Args:
        occupancy: The sets of N road users at T steps.
        steps: Number S of steps to look at; None for all T.

    Returns:
        (N, S, 2) length and width, m: those of the footprint where the semi-axes are zero or the
        occupancy is not valid.
    """
    turn = occupancy.heading[:, :steps] - occupancy.angle[:, :steps]
    reach = ellipse_extent(occupancy.semi_axes[:, :steps], turn)
    reach = np.where(occupancy.valid[:, :steps, None], reach, 0.0)
    return np.asarray(occupancy.footprint[:, None] + 2.0 * reach)
