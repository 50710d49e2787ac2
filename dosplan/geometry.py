"""Small plane geometry shared by the benchmark and its plug-ins; everything else is shapely's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dosplan.types import FloatArray

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


def rectangle_corners(poses: FloatArray, size: npt.ArrayLike) -> FloatArray:
    """Corners of rectangles, counter-clockwise from the front left.

    Args:
        poses: (..., 3) centre x, y, m, and heading, rad.
        size: (..., 2) length and width, m.

    Returns:
        (..., 4, 2) m.
    """
    return to_world(_UNIT_CORNERS * np.asarray(size, dtype=np.float64)[..., None, :], poses)
