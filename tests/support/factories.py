"""Small objects that several tests share, beside those of ``dosplan.scenario.synthetic``."""

from __future__ import annotations

import numpy as np

from dosplan.scenario.synthetic import CAR_SIZE
from dosplan.types import FloatArray, Occupancy, Route


def arc_route(radius: float, length: float = 200.0, spacing: float = 0.5) -> Route:
    """A left bend of constant radius that leaves the origin along +x; lanes 1.75 m to each side."""
    s = np.arange(0.0, length, spacing)
    angle = s / radius
    ones = np.ones_like(s)
    return Route(
        lanelet_ids=(1,),
        arclength=s,
        path=radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1),
        heading=angle,
        curvature=ones / radius,
        left=1.75 * ones,
        right=-1.75 * ones,
        outer_left=1.75 * ones,
        outer_right=-1.75 * ones,
        speed_limit=np.inf * ones,
    )


def occupancy_at(centres: FloatArray, horizon: int, semi_axis: float = 0.0) -> Occupancy:
    """Cars that stand at (N, 2) ``centres``, heading along +x, with circular sets."""
    n = len(centres)
    return Occupancy(
        ids=100 + np.arange(n),
        centre=np.repeat(centres[:, None, :], horizon, axis=1),
        semi_axes=np.full((n, horizon, 2), semi_axis),
        angle=np.zeros((n, horizon)),
        valid=np.ones((n, horizon), dtype=np.bool_),
        footprint=np.tile(CAR_SIZE, (n, 1)),
        heading=np.zeros((n, horizon)),
    )
