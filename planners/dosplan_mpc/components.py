"""Which of the road users' sets the planner looks at, and what it costs to enter each.

Of a union of ellipses, each component is a set of its own, with a slot of its own where it is near.
What the road user is less likely to do costs less to be in the way of. Components that are never
near the ego's way are left out, and so is one that lies in another nearly as a whole: it would
take a slot and forbid nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from dosplan.geometry import ellipse_boundary, mahalanobis
from dosplan.types import FloatArray, IntArray, Occupancy
from dosplan_mpc.config import SetSettings

_LOOKED_AT: Final = 6  # Steps between two at which components are compared.
_POINTS: Final = 8  # On the boundary of a component that is compared,
_INSIDE: Final = 7  # of which so many are in the other one,
_ENLARGED: Final = 1.1  # made larger by a tenth, where it lies in it nearly as a whole
_SAME_HEADING: Final = 0.2  # and the footprints differ by less than this, rad.


@dataclass(frozen=True)
class Components:
    """Sets of road users, one ellipse each.

    Attributes:
        sets: All R of them; the id of a road user may be there several times.
        rows: (R,) rows of the road users in the occupancy.
        keep: (n,) rows of ``sets`` that are looked at, the nearest to the ego's way first.
        price: (n,) share of the penalty that entering each costs: 1 for the most likely one of its
            road user.
    """

    sets: Occupancy
    rows: IntArray
    keep: IntArray
    price: FloatArray

    @classmethod
    def near(cls, occupancy: Occupancy, way: FloatArray, settings: SetSettings) -> Self:
        """The sets of the road users that come closest to where the ego will be.

        Args:
            occupancy: The sets of all road users.
            way: (T, 2) where the ego is to be at the first T steps, m.
            settings: How many road users are looked at, and what is left out.

        Returns:
            Their sets.
        """
        sets, rows, weight = occupancy.by_component()
        valid = sets.valid[:, : len(way), None]
        delta = np.where(valid, sets.centre[:, : len(way)] - way, np.inf)
        away = np.sqrt((delta**2).sum(axis=-1)).min(axis=-1, initial=np.inf)
        order = np.argsort(away, kind="stable")
        order = order[np.isfinite(away[order])]
        users = list(dict.fromkeys(rows[order].tolist()))[: settings.watched]
        keep = order[np.isin(rows[order], users)]
        if occupancy.union is None:
            return cls(sets, rows, keep, np.ones(len(keep)))
        weight = _merged(sets.first_steps(len(way)), rows, weight, keep)
        largest = np.zeros(len(occupancy.ids))
        np.maximum.at(largest, rows, weight)
        share = weight / largest[rows]
        reach = np.where(valid, sets.semi_axes[:, : len(way)], 0.0).max(axis=(1, 2), initial=0.0)
        beside = (share == 1.0) | (away - reach < settings.aside)
        keep = keep[(beside & (share > 0.0))[keep]]
        return cls(sets, rows, keep, np.maximum(share[keep], settings.least_price))


def _merged(sets: Occupancy, rows: IntArray, weight: FloatArray, keep: IntArray) -> FloatArray:
    """(R,) weights after those of components that lie in another one have gone over to it."""
    first, second = np.nonzero(rows[keep][:, None] == rows[keep])
    inner, outer = keep[first], keep[second]
    inner, outer = inner[inner != outer], outer[inner != outer]
    if not len(inner):
        return weight
    looked = sets.of_steps(np.arange(0, sets.horizon, _LOOKED_AT))
    one, other = looked.of_users(inner), looked.of_users(outer)
    points = ellipse_boundary(one.centre, one.semi_axes, one.angle, _POINTS)
    distance = mahalanobis(
        points, other.centre[:, :, None], other.semi_axes[:, :, None], other.angle[:, :, None]
    )
    within = (distance <= _ENLARGED).sum(axis=-1) >= _INSIDE
    within &= np.cos(one.heading - other.heading) > np.cos(_SAME_HEADING)
    inside = (within | ~one.valid).all(axis=1)
    weight = weight.copy()
    for i, j in zip(inner[inside], outer[inside], strict=True):
        if weight[i] > 0.0 and weight[j] > 0.0:
            weight[j] += weight[i]
            weight[i] = 0.0
    return weight
