"""Forbidden sets: a road user's occupancy, widened by its footprint and by the ego's discs.

The centre of a covering disc of radius r has to stay out of the Minkowski sum of the road user's
rectangle, its occupancy ellipse and the disc. That sum S is bounded by a superellipse of order
four along the road user's heading, ``(x/A)^4 + (y/B)^4 <= 1``: it is smooth and fits a rectangle
with a disc within a few per cent, whereas an ellipse would be 41 % too wide.

A and B are the sum's extents times the smallest scale at which the support function of the
superellipse, ``(|A n_x|^(4/3) + |B n_y|^(4/3))^(3/4)``, is nowhere below that of S,
``h_x |n_x| + h_y |n_y| + sqrt(n' Q n) + r``: then the superellipse holds S (Rockafellar, "Convex
Analysis", theorem 13.1). The scale is found on a fan of directions; ``_FAN_MARGIN`` covers what
lies between them.

A set that is a union of ellipses is forbidden component by component (``components``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from dosplan.geometry import ellipse_extent
from dosplan.types import BoolArray, FloatArray, IntArray, Occupancy
from dosplan_mpc.config import SetSettings
from dosplan_mpc.stage import EMPTY_SLOT, Slot

_FAN = np.linspace(0.0, np.pi, 32, endpoint=False)
_FAN_BOUND = (np.abs(np.cos(_FAN)) ** (4.0 / 3.0) + np.abs(np.sin(_FAN)) ** (4.0 / 3.0)) ** 0.75
_FAN_MARGIN = 1.005


@dataclass(frozen=True)
class ForbiddenSets:
    """Superellipses that the centres of the ego's discs have to stay out of.

    A point p is inside where ``z1^4 + z2^4 < 1`` with ``z = M (p - c)``. Column t stands for t + 1
    steps from now.

    Attributes:
        ids: (n,) ids of the road users.
        centre: (n, T, 2) c, m.
        matrix: (n, T, 2, 2) M, 1/m; its rows are along and across the road user.
        penalty: (n, T) penalty on a unit of normalised distance inside the set.
    """

    ids: IntArray
    centre: FloatArray
    matrix: FloatArray
    penalty: FloatArray

    def distance(self, points: FloatArray) -> FloatArray:
        """Normalised distance: below one inside a set.

        Args:
            points: (..., T, D, 2) centres of D discs at the T steps, m.

        Returns:
            (..., n, T) smallest distance over the discs.
        """
        n, lead = len(self.ids), points.shape[:-3]
        steps, discs = points.shape[-3:-1]
        origin = points.reshape(-1, 2)[0]  # Map coordinates are large: precision would be lost.
        shift = (self.matrix @ (self.centre - origin)[..., None])[..., 0]
        # z of all sets is one product per step: (T, D C, 2) @ (T, 2, 2 n).
        near = (points - origin).reshape(-1, steps, discs, 2).transpose(1, 2, 0, 3)
        z = near.reshape(steps, -1, 2) @ self.matrix.transpose(1, 3, 2, 0).reshape(steps, 2, 2 * n)
        z -= shift.transpose(1, 2, 0).reshape(steps, 1, 2 * n)
        z *= z
        z *= z
        fourth = (z[..., :n] + z[..., n:]).reshape(steps, discs, -1, n).min(axis=1)
        return np.asarray(np.sqrt(np.sqrt(fourth)).transpose(1, 2, 0).reshape(*lead, n, steps))

    def choose(
        self, points: FloatArray, sizes: Sequence[int], within: float, first: IntArray | None = None
    ) -> ChosenSets:
        """The sets that matter beside a trajectory, at each step of it by itself.

        Who is far off at a step constrains nothing there: a few sets at each step are all that a
        scene with many road users needs.

        Args:
            points: (T, D, 2) centres of the discs along the trajectory, m.
            sizes: Numbers of sets at a step that there is a problem for, increasing.
            within: Normalised distance below which a set matters; the smallest size is taken that
                holds those that do, and filled up with the next ones.
            first: Ids of sets that, where they matter, are never left out for the sake of others.

        Returns:
            The nearest sets at each step.
        """
        n, steps = self.penalty.shape
        if n == 0:
            return ChosenSets(sizes[0], np.zeros((0, steps), dtype=np.int64), self, points)
        distance = self.distance(points)
        matters = distance < within
        size = next((s for s in sizes if s >= matters.sum(axis=0).max()), sizes[-1])
        if first is not None:
            distance[np.isin(self.ids, first)[:, None] & matters] = -1.0
        rows = np.argsort(distance, axis=0, kind="stable")[:size]
        at = np.arange(steps)
        held = ForbiddenSets(
            np.arange(len(rows)),
            self.centre[rows, at],
            self.matrix[rows, at],
            self.penalty[rows, at],
        )
        return ChosenSets(size, self.ids[rows], held, points)

    def at(self, columns: IntArray | slice) -> ForbiddenSets:
        """The sets of some steps.

        Args:
            columns: Which.

        Returns:
            The same sets, at these steps alone.
        """
        return ForbiddenSets(
            self.ids, self.centre[:, columns], self.matrix[:, columns], self.penalty[:, columns]
        )

    def joined(self, other: ForbiddenSets | None) -> ForbiddenSets:
        """These sets and others.

        Args:
            other: Sets for the same steps, or None.

        Returns:
            All of them, these first.
        """
        if other is None:
            return self
        parts = ("ids", "centre", "matrix", "penalty")
        return ForbiddenSets(
            *(np.concatenate([getattr(self, name), getattr(other, name)]) for name in parts)
        )

    def fill(self, count: int) -> Slot:
        """The sets as the stages of the problem take them.

        Args:
            count: Number of slots M of a stage, at least that of the sets.

        Returns:
            Parts that begin with (T + 1, M); slots that are left over, and all of the first
            stage, hold sets out of reach.
        """

        def filled(part: FloatArray, empty: npt.ArrayLike) -> FloatArray:
            slots = np.empty((part.shape[1] + 1, count, *part.shape[2:]))
            slots[:] = empty
            slots[1:, : len(part)] = np.swapaxes(part, 0, 1)
            return slots

        return Slot(
            centre=filled(self.centre, EMPTY_SLOT.centre),
            first_row=filled(self.matrix[:, :, 0], EMPTY_SLOT.first_row),
            second_row=filled(self.matrix[:, :, 1], EMPTY_SLOT.second_row),
            penalty=filled(self.penalty, EMPTY_SLOT.penalty),
        )


class ChosenSets:
    """The sets that the slots of a problem hold: at each step others.

    Attributes:
        slots: Number M of slots.
        ids: (m, T) ids of the road users of the first m slots; the others are empty.
    """

    def __init__(self, slots: int, ids: IntArray, sets: ForbiddenSets, points: FloatArray) -> None:
        """Keeps them.

        Args:
            slots: Number M of slots.
            ids: (m, T) ids of the road users.
            sets: Their m sets, by slot and step.
            points: (T, D, 2) centres of the discs of the trajectory beside which they are, m.
        """
        self.slots = slots
        self.ids = ids
        self._sets = sets
        self._points = points

    def fill(self) -> Slot:
        """The sets as the stages of the problem take them; see ``ForbiddenSets.fill``."""
        return self._sets.fill(self.slots)

    def slack(self) -> FloatArray:
        """(T, M) how far the trajectory is inside each set, in normalised distance."""
        slack = np.zeros((self.ids.shape[1], self.slots))
        if len(self.ids):
            inside = np.maximum(1.0 - self._sets.distance(self._points).T, 0.0)
            slack[:, : len(self.ids)] = inside
        return slack

    def price(self, slack: FloatArray) -> FloatArray:
        """What slacks cost at each step.

        Args:
            slack: (T, M) slacks of a plan.

        Returns:
            (T,) costs.
        """
        return np.asarray((slack[:, : len(self.ids)] * self._sets.penalty.T).sum(axis=1))

    def touched(self, slack: FloatArray, least: float) -> tuple[int, ...]:
        """Ids of the road users whose sets a plan enters.

        Args:
            slack: (T, M) slacks of the plan.
            least: Slack from which on a set counts.

        Returns:
            Their ids, each once.
        """
        inside = least < slack[:, : len(self.ids)].T
        return tuple(dict.fromkeys(self.ids[inside].tolist()))


def superellipse_axes(
    footprint: FloatArray, semi_axes: FloatArray, turn: FloatArray, radius: float
) -> FloatArray:
    """Semi-axes of a superellipse of order four that holds rectangle + ellipse + disc.

    Args:
        footprint: (..., 2) length and width of the rectangle, m.
        semi_axes: (..., 2) semi-axes of the ellipse, m.
        turn: (...) angle of the ellipse's first axis in the rectangle's frame, rad.
        radius: Radius of the disc, m.

    Returns:
        (..., 2) semi-axes along and across the rectangle, m.
    """
    half = footprint / 2.0
    a, b = semi_axes[..., 0], semi_axes[..., 1]
    axes = half + ellipse_extent(semi_axes, turn) + radius
    # Directions of the fan are even in coordinates in which the superellipse is as long as wide.
    nx, ny = np.cos(_FAN) / axes[..., 0, None], np.sin(_FAN) / axes[..., 1, None]
    cos, sin = np.cos(turn)[..., None], np.sin(turn)[..., None]
    support = (
        half[..., 0, None] * np.abs(nx)
        + half[..., 1, None] * np.abs(ny)
        + np.hypot(a[..., None] * (cos * nx + sin * ny), b[..., None] * (cos * ny - sin * nx))
        + radius * np.hypot(nx, ny)
    )
    return np.asarray(axes * (_FAN_MARGIN * (support / _FAN_BOUND).max(axis=-1))[..., None])


def forbidden_sets(
    occupancy: Occupancy,
    radius: float,
    keep: IntArray,
    penalty: FloatArray,
    extended: int,
) -> ForbiddenSets:
    """Widens the sets of some road users.

    Args:
        occupancy: Predicted sets.
        radius: Radius of the ego's discs, m.
        keep: (n,) rows of the road users that matter.
        penalty: (T,) penalty at each step that is wanted, or (n, T) of each of them.
        extended: Number of steps with sets; after them the predicted positions alone count.

    Returns:
        Their forbidden sets; where a road user is not predicted, its set is out of reach.
    """
    horizon = penalty.shape[-1]
    valid = occupancy.valid[keep, :horizon]
    heading = np.where(valid, occupancy.heading[keep, :horizon], 0.0)
    centre = np.where(valid[..., None], occupancy.centre[keep, :horizon], 0.0)
    widened = valid & (np.arange(horizon) < extended)
    semi_axes = np.where(widened[..., None], occupancy.semi_axes[keep, :horizon], 0.0)
    turn = np.where(valid, occupancy.angle[keep, :horizon], 0.0) - heading
    footprint = np.broadcast_to(occupancy.footprint[keep, None], semi_axes.shape)
    axes = superellipse_axes(footprint, semi_axes, turn, radius)
    cos, sin = np.cos(heading), np.sin(heading)
    along, across = axes[..., 0], axes[..., 1]
    matrix = np.stack([cos / along, sin / along, -sin / across, cos / across], axis=-1)
    empty = np.array([EMPTY_SLOT.first_row, EMPTY_SLOT.second_row])
    return ForbiddenSets(
        ids=occupancy.ids[keep],
        centre=np.where(valid[..., None], centre, EMPTY_SLOT.centre),
        matrix=np.where(valid[..., None, None], matrix.reshape(*heading.shape, 2, 2), empty),
        penalty=np.where(valid, penalty, EMPTY_SLOT.penalty),
    )


def release(
    sets: ForbiddenSets, points: FloatArray, dt: float, settings: SetSettings
) -> ForbiddenSets:
    """Shrinks sets that hold the ego already, so that it need not jump out of them.

    The ego cannot leave such a set at once, and the full set would cause a violent evasion. It
    begins at the size at which the ego is just outside and grows back to its full size over
    ``release_seconds``.

    Args:
        sets: Forbidden sets.
        points: (D, 2) centres of the ego's discs now, m.
        dt: Step, s.
        settings: How small the sets become, and for how long.

    Returns:
        Sets of which none holds the ego by more than the smallest share allows.
    """
    if len(sets.ids) == 0:
        return sets
    now = sets.at(slice(1)).distance(points[None])[:, 0]
    share = np.clip(now / settings.release_distance, settings.smallest_release, 1.0)
    time = dt * np.arange(sets.centre.shape[1]) / settings.release_seconds
    factor = share[:, None] + (1.0 - share[:, None]) * np.minimum(time, 1.0)
    return replace(sets, matrix=sets.matrix / factor[..., None, None])


def stretch_back(sets: ForbiddenSets, rows: BoolArray, length: float) -> ForbiddenSets:
    """Lengthens sets towards their rear; their front edges stay where they are.

    The ego should leave the set of a follower that overlaps it by driving on, not by braking: with
    a longer rear part, the shortest way out of the set is ahead.

    Args:
        sets: Forbidden sets.
        rows: (n,) which of them to lengthen.
        length: By how much, m.

    Returns:
        The sets.
    """
    centre, matrix = sets.centre.copy(), sets.matrix.copy()
    axis = matrix[rows, :, 0]
    inverse = np.linalg.norm(axis, axis=-1, keepdims=True)
    direction = axis / inverse
    centre[rows] -= 0.5 * length * direction
    matrix[rows, :, 0] = direction / (1.0 / inverse + 0.5 * length)
    return replace(sets, centre=centre, matrix=matrix)
