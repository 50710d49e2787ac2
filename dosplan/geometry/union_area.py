"""Areas of sets, unions of ellipses among them: what components have in common counts once.

The area inside a closed curve is half the integral of x dy - y dx along it, and the boundary of a
union is the part of its components' boundaries that is in no other component. At points all around
each boundary it is asked whether another component is there. Where a boundary enters another
component between two of these points is found by the secant method; a tip that comes out and goes
back in between two of them is missed.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry.ellipse import ellipse_area
from dosplan.types import FloatArray, Occupancy

_AROUND: Final = 64  # Pieces of each boundary: areas are within 3 %, and 0.1 % in the mean.
_SECANTS: Final = 2
_TOUCHING: Final = 1e-9  # Of boundaries that lie on each other, the first counts.

_ANGLES: Final = np.linspace(0.0, 2.0 * np.pi, _AROUND + 1)
_CIRCLE: Final = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def set_area(occupancy: Occupancy, scale: float = 1.0) -> FloatArray:
    """Areas of sets.

    Args:
        occupancy: Sets of N road users at T steps.
        scale: Factor on all semi-axes.

    Returns:
        (N, T) m2; 0 where the occupancy is not valid.
    """
    union = occupancy.components
    known = np.moveaxis(union.present[:, :, None] & occupancy.valid[:, None], 1, -1)
    centre = np.where(known[..., None], np.moveaxis(union.centre, 1, -2), 0.0)
    semi_axes = np.where(known[..., None], scale * np.moveaxis(union.semi_axes, 1, -2), 0.0)
    angle = np.where(known, np.moveaxis(union.angle, 1, -1), 0.0)
    semi_axes[(semi_axes == 0.0).any(axis=-1)] = 0.0
    many = (semi_axes[..., 0] > 0.0).sum(axis=-1) > 1
    total = np.asarray(ellipse_area(semi_axes).sum(axis=-1))
    total[many] = _area_of_many(centre[many], semi_axes[many], angle[many])
    return total


def _area_of_many(centre: FloatArray, semi_axes: FloatArray, angle: FloatArray) -> FloatArray:
    """(n,) areas of the unions of (n, M) ellipses; an ellipse of size zero counts nothing."""
    count = centre.shape[1]
    centre = centre - centre[:, :1]  # Map coordinates are large: precision would be lost.
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    ellipse = turned * semi_axes[..., None, :]  # From the unit circle to each ellipse.
    there = semi_axes[..., 0] > 0.0
    back = np.zeros_like(turned)
    np.divide(turned.swapaxes(-1, -2), semi_axes[..., None], out=back, where=there[..., None, None])
    area = np.zeros(len(centre))
    for m in range(count):
        others = np.delete(np.arange(count), m)
        # A point of this boundary, in the coordinates in which another ellipse is the unit circle.
        offset = (back[:, others] @ (centre[:, m, None] - centre[:, others])[..., None])[..., 0]
        offset[~there[:, others]] = np.inf  # Nobody is in a set without area.
        maps = back[:, others] @ ellipse[:, m, None]
        first = np.where(others > m, _TOUCHING, -_TOUCHING)
        area += _swept(centre[:, m], ellipse[:, m], offset, maps, first)
    return area


def _swept(
    centre: FloatArray, ellipse: FloatArray, offset: FloatArray, maps: FloatArray, first: FloatArray
) -> FloatArray:
    """Half the integral of x dy - y dx along the part of a boundary that is in no other ellipse.

    Args:
        centre: (n, 2) centres of the ellipses, m.
        ellipse: (n, 2, 2) their maps from the unit circle.
        offset: (n, M, 2) and
        maps: (n, M, 2, 2) from the unit circle to where another ellipse is the unit circle.
        first: (M,) what is added to the squared distance to each.

    Returns:
        (n,) m2.
    """
    outside = _outside(offset, maps, first, _CIRCLE)
    begin, end = outside[:, :-1], outside[:, 1:]
    row, piece = np.nonzero((begin > 0.0) != (end > 0.0))
    low, high = _ANGLES[piece], _ANGLES[piece + 1]
    at_low, at_high = begin[row, piece], end[row, piece]
    enters = at_low > 0.0
    offset, maps = offset[row], maps[row]
    for _ in range(_SECANTS):
        middle = low + (high - low) * at_low / (at_low - at_high)
        circle = _on_circle(middle)[:, None, :, None]
        found = _outside(offset, maps, first, circle)[:, 0]
        before = (found > 0.0) == enters
        low, at_low = np.where(before, middle, low), np.where(before, found, at_low)
        high, at_high = np.where(before, high, middle), np.where(before, at_high, found)
    edge = low + (high - low) * at_low / (at_low - at_high)
    # The integral from 0 to the edge: counted where the boundary enters, taken off where it leaves.
    size = ellipse[:, 0, 0] * ellipse[:, 1, 1] - ellipse[:, 0, 1] * ellipse[:, 1, 0]
    x, y = np.moveaxis((ellipse[row] @ _on_circle(edge)[..., None])[..., 0], -1, 0)
    across = centre[row, 0] * y - centre[row, 1] * x
    start = centre[row, 0] * ellipse[row, 1, 0] - centre[row, 1] * ellipse[row, 0, 0]
    parts = np.where(enters, 0.5, -0.5) * (size[row] * edge + across - start)
    whole = np.where(outside[:, 0] > 0.0, np.pi * size, 0.0)
    return np.asarray(whole + np.bincount(row, weights=parts, minlength=len(whole)))


def _outside(
    offset: FloatArray, maps: FloatArray, first: FloatArray, circle: FloatArray
) -> FloatArray:
    """(..., P) how far points are from being in any of M ellipses; below 0 in one."""
    at = offset[..., None] + maps @ circle
    squared = np.sum(at * at, axis=-2) + first[:, None]
    return np.asarray(squared.min(axis=-2, initial=np.inf) - 1.0)


def _on_circle(turn: FloatArray) -> FloatArray:
    """(..., 2) points of the unit circle."""
    return np.stack([np.cos(turn), np.sin(turn)], axis=-1)
