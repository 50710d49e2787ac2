"""What is known of a road user beside its kind that tells how far a prediction may miss.

Nothing here names a place: what a recording's noise does to a prediction is seen in the track
itself. All of it is read from what the predictor sees, so that in a loop whose sensors err it is
the noise of the sensors that shows.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from dosplan_net.features import KINDS

from dosplan.geometry import to_body, wrap_angle
from dosplan.types import STEP_SECONDS, BoolArray, FloatArray, RoadUserKind

Reals = npt.NDArray[np.floating[Any]]
Rows = npt.NDArray[np.integer[Any]]

NAMES: Final = (
    "moves",
    "speed",
    "speed above 4 m/s",
    "speed above 12 m/s",
    "noise of position, along",
    "noise of position, across",
    "noise of heading",
    "speed against motion",
    "heading against motion",
    "acceleration",
    "braking",
    "turning",
    "steps seen",
    "road ahead turns",
    "across its lane",
    "gap to leader",
    "road users near",
    "long vehicle",
)
"""Names of the columns of ``covariates``."""

WINDOW: Final = 11
"""Steps of the past, the present one included, in which noise is looked for: 1 s."""

MIN_SEEN: Final = 4
"""Steps of that window that have to be seen; a parabola goes through any three."""

_SPAN: Final = (WINDOW - 1) * STEP_SECONDS  # s
_TIMES: Final = np.linspace(-1.0, 0.0, WINDOW)
_BASIS: Final = np.stack((np.ones(WINDOW), _TIMES, _TIMES**2), axis=1)
_PRODUCTS: Final = (_BASIS[:, :, None] * _BASIS[:, None, :]).reshape(WINDOW, 9)
_TINY: Final = 1e-6  # So that steps that are too few have a solution as well; it is not looked at.
_KNEES: Final = (4.0, 12.0)  # m/s
_STARTS: Final = 0.5  # m/s; from here on a road user counts as moving.
_RANGE: Final = 60.0  # m; further away nobody leads.
_NEAR: Final = 20.0  # m
_LANE: Final = 2.0  # m to the side within which somebody leads.
_SECONDS_AHEAD: Final = 2.0
_LONG: Final = (RoadUserKind.TRUCK, RoadUserKind.BUS)
_SLOW: Final = 1.0  # m/s; below, the direction of a motion is noise.


def covariates(
    pose: Reals,
    history: Reals,
    static: Reals,
    neighbours: Rows,
    pieces: Rows,
    piece_pose: Reals,
    rows: Rows,
) -> FloatArray:
    """Describes M of N road users, of one scene or of several one after the other.

    Args:
        pose: (N, 4) x, y, m, heading, rad, and velocity, m/s.
        history: (N, HISTORY, 6) see ``dosplan_net.features.SceneFeatures``.
        static: (N, STATIC_SIZE) see there.
        neighbours: (N, K) rows of the nearest others, -1 for none.
        pieces: (N, L) rows of the pieces of the road that are near, -1 for none.
        piece_pose: (P, 3) see ``dosplan_net.features.MapPieces``, in the frame of ``pose``.
        rows: (M,) the road users.

    Returns:
        (M, F) the columns ``NAMES``, all finite and of the order of one.
    """
    own, known = pose[rows], static[rows]
    speed = np.abs(own[:, 3])
    past = np.asarray(history[rows, -WINDOW:], dtype=np.float64)
    seen = past[..., 5] > 0.5
    turned = np.arctan2(past[..., 3], past[..., 2])
    values = np.stack((past[..., 0], past[..., 1], past[..., 4], turned), axis=-1)
    fast = np.log1p(speed)
    noise, slope = _around_parabola(values, seen)
    motion, speed_motion = np.hypot(slope[:, 0], slope[:, 1]), np.abs(past[:, -1, 4])
    course = np.where(
        np.minimum(motion, speed_motion) > _SLOW,
        np.abs(np.sin(np.arctan2(slope[:, 1], slope[:, 0]))),
        0.0,
    )
    turns, across = _road(own, speed, pieces[rows], piece_pose)
    gap, near = _leader(own, pose, neighbours[rows])
    long = known[:, [KINDS.index(kind) for kind in _LONG]] > 0.5
    columns = (
        np.minimum(speed, _STARTS) / _STARTS,
        fast,
        *(np.maximum(fast - np.log1p(knee), 0.0) for knee in _KNEES),
        _resolved(noise[:, 0]),
        _resolved(noise[:, 1]),
        _resolved(noise[:, 3]),
        _resolved(motion - speed_motion),
        _resolved(course),
        _resolved(slope[:, 2]),
        np.clip(-slope[:, 2], 0.0, 6.0) / 3.0,
        _resolved(slope[:, 3]),
        seen.mean(axis=1) + known[:, -1],
        turns,
        across,
        gap,
        near,
        np.any(long, axis=1),
    )
    return np.stack([np.asarray(column, dtype=np.float64) for column in columns], axis=1)


def track_noise(values: FloatArray) -> FloatArray:
    """Reads the noise of tracks back.

    Args:
        values: (M, F) what ``covariates`` found.

    Returns:
        (M,) deviation of the positions of the last second from a parabola, along or across,
        whichever is larger, m.
    """
    columns = [NAMES.index(f"noise of position, {axis}") for axis in ("along", "across")]
    return np.asarray(10.0 ** (values[:, columns].max(axis=1) - 2.0) - 0.01)


def _resolved(value: FloatArray) -> FloatArray:
    """Number of decades of a size above 0.01; zero, too, has a value."""
    return np.asarray(np.log10(np.minimum(np.abs(value), 10.0) + 0.01) + 2.0)


def _around_parabola(values: FloatArray, seen: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(N, V) deviation of (N, W, V) values from a parabola, and its slope at the last step, 1/s.

    Weighted least squares in closed form, of the steps that were seen; zero where they are fewer
    than ``MIN_SEEN``.
    """
    weight = seen.astype(np.float64)
    count = weight.sum(axis=1)
    enough = (count >= MIN_SEEN)[:, None]
    normal = (weight @ _PRODUCTS).reshape(-1, 3, 3) + _TINY * np.eye(3)
    solution = np.linalg.solve(normal, _BASIS.T @ (values * weight[..., None]))
    residual = (values - _BASIS @ solution) * weight[..., None]
    square = np.sum(residual * residual, axis=1) / np.maximum(count - 3.0, 1.0)[:, None]
    return np.sqrt(square) * enough, solution[:, 1] * (enough / _SPAN)


def _road(pose: Reals, speed: Reals, pieces: Rows, piece_pose: Reals) -> tuple[FloatArray, ...]:
    """(N,) turn of the road over the next two seconds, and angle to it here, rad."""
    n = len(pose)
    if not len(piece_pose) or not pieces.shape[1]:
        return np.zeros(n), np.zeros(n)
    at = piece_pose[np.maximum(pieces, 0)]
    local = to_body(np.asarray(at[..., :2], dtype=np.float64), np.asarray(pose[:, :3]))
    angle = wrap_angle(at[..., 2] - pose[:, 2, None])
    along = (pieces >= 0) & (np.abs(angle) < np.pi / 2)
    rows = np.arange(n)

    def nearest(reach: Reals) -> tuple[FloatArray, BoolArray]:
        # Pieces are up to 20 m long, so that their middles are far ahead sooner than aside.
        far = np.hypot(0.5 * (local[..., 0] - reach[:, None]), local[..., 1])
        far = np.where(along, far, np.inf)
        best = np.argmin(far, axis=1)
        return angle[rows, best], np.isfinite(far[rows, best])

    here, found = nearest(np.zeros(n))
    there, _ = nearest(_SECONDS_AHEAD * speed)
    turns = np.minimum(np.abs(wrap_angle(there - here)), 1.5) * found
    return turns, np.minimum(np.abs(here), 1.0) * found


def _leader(pose: Reals, others: Reals, neighbours: Rows) -> tuple[FloatArray, FloatArray]:
    """(N,) nearness of who is ahead, 1 / (1 + headway in s), and tenths of road users near."""
    known = neighbours >= 0
    other = others[np.maximum(neighbours, 0)]
    local = to_body(np.asarray(other[..., :2], dtype=np.float64), np.asarray(pose[:, :3]))
    ahead = known & (local[..., 0] > 1.0) & (np.abs(local[..., 1]) < _LANE)
    ahead &= np.cos(other[..., 2] - pose[:, 2, None]) > 0.5
    gap = np.min(np.where(ahead, local[..., 0], np.inf), axis=1, initial=np.inf)
    headway = gap / np.maximum(np.abs(pose[:, 3]), 1.0)
    near = np.sum(known & (np.hypot(local[..., 0], local[..., 1]) < _NEAR), axis=1)
    return np.where(gap < _RANGE, 1.0 / (1.0 + headway), 0.0), near / 10.0
