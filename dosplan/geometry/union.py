"""Unions of ellipses: the one ellipse that covers each, and the distance to one.

The covering ellipse has the centre and the shape of the components' moments: the mean of their
centres, and the mean of their shape matrices plus the scatter of their centres. It is then scaled
until it holds them all. With coordinates in which that shape is the unit disc, a component is the
set of d + A u over all |u| <= 1, and the scale is the largest |d + A u|. Lagrangian duality gives
a bound on its square for every multiplier m above the largest eigenvalue of A A',

    m + sum_i q_i^2 m / (m - s_i^2),

with s_i^2 the eigenvalues of A A' and q_i the part of d along their eigenvectors, and the smallest
of these bounds is exact (the trust-region problem; Boyd and Vandenberghe, "Convex Optimization",
appendix B.1). Whatever multiplier the search for the smallest ends at, the component is covered.

The means give each component the same share at first, and then a share by the scale that it needed,
as in the search for the smallest ellipse around points (Titterington, "Estimation of correlation
matrices by ellipsoidal trimming", 1978). After one such step, the cover is about an eighth larger
than the smallest there is.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry.ellipse import mahalanobis
from dosplan.types import BoolArray, FloatArray, Observation, Occupancy, SetUnion

_SEARCHED: Final = (0, 2)  # Newton steps for the multiplier; with two, the cover touches to 1e-4.
_LEAST_OVER: Final = 1e-9  # A multiplier is above the eigenvalue; these are of the order of 1.
_ROUNDING: Final = 1.0 + 1e-9  # So that boundaries that touch are inside in spite of rounding.
_THINNEST: Final = 1e-3  # m; by about this, ellipses that are covered are thickened first.


def occupancy_of_union(
    observation: Observation, union: SetUnion, valid: BoolArray | None = None
) -> Occupancy:
    """Sets that are unions of ellipses, for all road users that are on the scene now.

    Args:
        observation: What the prediction was made from; N road users.
        union: Their sets, for T steps.
        valid: (N, T) where there is a prediction; None for everywhere.

    Returns:
        The sets, with the ellipses that cover them.

    Raises:
        ShapeError: The shapes do not match, or a value is not finite where valid.
    """
    if valid is None:
        valid = np.ones((len(union.weight), union.horizon), dtype=np.bool_)
    centre, semi_axes, angle = covering_ellipse(union)
    heading = union.heading[np.arange(len(union.weight)), union.likeliest]
    return Occupancy(
        ids=observation.ids,
        centre=centre,
        semi_axes=semi_axes,
        angle=angle,
        valid=valid,
        footprint=observation.size,
        heading=heading,
        union=union,
    )


def covering_ellipse(union: SetUnion) -> tuple[FloatArray, FloatArray, FloatArray]:
    """An ellipse around the components of each union.

    Args:
        union: M ellipses for each of N road users and T steps.

    Returns:
        (N, T, 2) its centre, m, (N, T, 2) semi-axes, m, and (N, T) the direction of the first,
        rad. That of a road user with one component is this component. NaN where a component that
        is there has one.
    """
    present = union.present
    row = np.arange(len(present))
    centre, semi_axes, angle = (
        np.array(getattr(union, name)[row, union.likeliest])
        for name in ("centre", "semi_axes", "angle")
    )
    several = present.sum(axis=1) > 1
    if not np.any(several):
        return centre, semi_axes, angle
    there = present[several][:, :, None]
    with np.errstate(invalid="ignore"):
        found = _cover(
            present[several],
            np.where(there[..., None], union.centre[several], centre[several][:, None]),
            np.where(there[..., None], union.semi_axes[several], 0.0),
            np.where(there, union.angle[several], 0.0),
        )
    centre[several], semi_axes[several], angle[several] = found
    return centre, semi_axes, angle


def set_distance(point: FloatArray, occupancy: Occupancy) -> FloatArray:
    """Distance of points to sets, in multiples of the sets: 1 on the boundary of one.

    In a union it is that to the component that is nearest in this measure: it is the smallest
    factor on all semi-axes with which the union holds the point.

    Args:
        point: (..., N, T, 2) points, m.
        occupancy: Sets of N road users at T steps.

    Returns:
        (..., N, T) distances; infinite where the occupancy is not valid, NaN where a point is.
    """
    union = occupancy.components
    known = union.present[:, :, None] & occupancy.valid[:, None]
    distance = mahalanobis(
        point[..., :, None, :, :],
        np.where(known[..., None], union.centre, 0.0),
        np.where(known[..., None], union.semi_axes, 0.0),
        np.where(known, union.angle, 0.0),
    )
    nearest = np.where(known, distance, np.inf).min(axis=-2)
    return np.where(np.isnan(point).any(axis=-1), np.nan, nearest)


def _cover(
    present: BoolArray, centre: FloatArray, semi_axes: FloatArray, angle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The covering ellipses of (N, M, T) ellipses, of which (N, M) are there."""
    # Relative to a component, since map coordinates are large and precision would be lost.
    origin = centre[:, 0]
    east, north = (centre[..., axis] - origin[:, None, :, axis] for axis in (0, 1))
    a, b = semi_axes[..., 0], semi_axes[..., 1]
    half, lean = 0.5 * (a * a + b * b) + _THINNEST**2, 0.5 * (a * a - b * b)
    slope = np.tan(angle)  # Of twice the angle, cosine and sine follow, in a tenth of their time.
    lean /= 1.0 + slope * slope
    along, xy = lean * (1.0 - slope * slope), 2.0 * lean * slope
    xx, yy = half + along, half - along
    # What probability says is of no matter for what is to be covered: all begin with one share.
    share = np.repeat(present[:, :, None].astype(np.float64), angle.shape[2], axis=2)
    needed = np.empty_like(share)
    for searched in _SEARCHED:
        share /= share.sum(axis=1, keepdims=True)
        middle_x, middle_y = (share * east).sum(axis=1), (share * north).sum(axis=1)
        x, y = east - middle_x[:, None], north - middle_y[:, None]
        # The shape S, and its Cholesky factor (low, 0; skew, high).
        sxx = (share * (xx + x * x)).sum(axis=1)
        sxy = (share * (xy + x * y)).sum(axis=1)
        syy = (share * (yy + y * y)).sum(axis=1)
        low = np.sqrt(sxx)
        skew = sxy / low
        high = np.sqrt(np.maximum(syy - skew * skew, 0.25 * _THINNEST**2))
        for m in range(share.shape[1]):  # One after another: small arrays stay in the cache.
            # With z = L^-1 (p - c), the shape is the unit disc.
            u = x[:, m] / low
            v = (y[:, m] - skew * u) / high
            uu = xx[:, m] / sxx
            cross = xy[:, m] / low - skew * uu
            vv = (yy[:, m] - skew * (xy[:, m] / low + cross)) / (high * high)
            needed[:, m] = _reach(u, v, uu, cross / high, vv, searched)
        share *= needed
    scale = np.where(present[:, :, None], needed, 0.0).max(axis=1)
    across, along = low * skew, 0.5 * (sxx - skew * skew - high * high)
    longest = 0.5 * (sxx + skew * skew + high * high) + np.sqrt(along**2 + across**2)
    axes = np.sqrt(np.stack([longest, (low * high) ** 2 / longest], axis=-1) * scale[..., None])
    middle = origin + np.stack([middle_x, middle_y], axis=-1)
    return middle, axes * _ROUNDING, 0.5 * np.arctan2(across, along)


def _reach(
    u: FloatArray, v: FloatArray, uu: FloatArray, uv: FloatArray, vv: FloatArray, searched: int
) -> FloatArray:
    """Bound on the largest squared distance from the origin to a point of an ellipse.

    Args:
        u: Its centre's first coordinate.
        v: Its centre's second coordinate.
        uu: Its shape matrix: first entry,
        uv: the entry off the diagonal,
        vv: last entry.
        searched: Newton steps for the multiplier.

    Returns:
        The bounds; see the top of the module.
    """
    half, lean = 0.5 * (uu + vv), 0.5 * (uu - vv)
    spread = np.sqrt(lean * lean + uv * uv)
    s1, s2 = half + spread, np.maximum(half - spread, 0.0)
    square = u * u + v * v
    tilted = lean * (u * u - v * v) + 2.0 * uv * u * v
    q1 = 0.5 * (square + tilted / np.maximum(spread, np.finfo(np.float64).tiny))
    q1 = np.minimum(np.maximum(q1, 0.0), square)
    # With m = s1 + over, the slope of the bound is 1 - g(over). The search begins where the larger
    # of g's terms is 1, from where Newton's method on 1 / sqrt(g) does not pass the best.
    p1, p2, gap = q1 * s1, (square - q1) * s2, s1 - s2
    over = np.maximum(np.maximum(np.sqrt(p1), np.sqrt(p2) - gap), _LEAST_OVER)
    for _ in range(searched):
        both = over + gap
        a, b = p1 / (over * over), p2 / (both * both)
        g = np.maximum(a + b, 1.0)
        over = over + (g * np.sqrt(g) - g) / np.maximum(a / over + b / both, _LEAST_OVER)
    return np.asarray(s1 + over + square + p1 / over + p2 / (over + gap))
