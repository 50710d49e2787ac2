"""Exact overlap of the ego's rectangle with road users, at the steps and swept between them.

Two phases. A broad phase in numpy treats every shape as its bounding rectangle and solves the
separating-axis test of every road user and step at once; it tells between which fractions of a
step a contact is possible at all. A narrow phase places the exact shapes in that window, at most
``RESOLUTION`` (1 cm) of relative motion apart, and asks fcl. A contact is therefore always a true
overlap of recorded or interpolated poses. Between steps an overlap counts from ``SWEPT_TOUCH``
(2.5 cm) on, because interpolated poses are no more exact than that, and is missed only if it ends
within ``RESOLUTION``.

The ego is described here like a road user: a row ``(x, y, heading, velocity)`` of its rectangle's
centre.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import fcl
import numpy as np
import numpy.typing as npt
import shapely

from dosplan.geometry import rectangle_corners, to_world
from dosplan.types import USER_HEADING, FloatArray, IntArray, Tracks

TOUCH: Final = 1e-3
"""How deep shapes overlap at a step to collide, m: the ego is smaller by it on each side."""

SWEPT_TOUCH: Final = 0.025
"""The same between two steps, m. A straight line between two poses is off the true path by up to
a dt^2 / 8: at 0.1 s, 0.0144 m for the ego's largest acceleration, 11.5 m/s2, and 0.01 m for 8 m/s2,
a road user's hardest braking."""

RESOLUTION: Final = 0.01
"""Relative motion between two poses that are tried within a step, m."""


_TURN: Final = 2.0 * np.pi


@dataclass(frozen=True)
class Contact:
    """The ego and a road user overlap.

    Attributes:
        step: The step at which, or on the way to which, they touch.
        fraction: When, as a share of the way from the step before (1 is at ``step``).
        user: Row of the road user in ``Tracks``.
        ego_state: (4,) x, y, heading, velocity of the ego's centre at that moment.
        user_state: (4,) the same of the road user.
    """

    step: int
    fraction: float
    user: int
    ego_state: FloatArray
    user_state: FloatArray


def shape_at(tracks: Tracks, user: int, state: FloatArray) -> shapely.Polygon:
    """The exact shape of a road user at a pose.

    Args:
        tracks: The road users as they were driven.
        user: Row of the road user.
        state: (4,) road-user state.

    Returns:
        Its polygon in the scenario frame, m.
    """
    outline, pose = tracks.outlines[user], state[: USER_HEADING + 1]
    corners = (
        rectangle_corners(pose, tracks.size[user]) if outline is None else to_world(outline, pose)
    )
    return shapely.Polygon(corners)


def overlap_window(
    pose_a: FloatArray,
    size_a: FloatArray,
    pose_b: FloatArray,
    size_b: FloatArray,
    velocity: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """When two rectangles overlap that move along straight lines and do not turn.

    On each of the four axes of the two rectangles, the distance of the centres changes linearly
    and must be less than the sum of the projected half sizes; two convex shapes overlap exactly
    while that holds on every axis (separating-axis theorem).

    Args:
        pose_a: (..., 3) centre, m, and heading, rad, at time 0.
        size_a: (..., 2) length and width, m.
        pose_b: (..., 3) the same of the other one.
        size_b: (..., 2) the same.
        velocity: (..., 2) velocity of b relative to a, m per unit of time.

    Returns:
        (...) begin and (...) end of the overlap, begin not before 0; both are infinite where
        there is none, or where an argument is NaN.
    """
    a, b = pose_a[..., 2, None], pose_b[..., 2, None]
    quarter = np.array([0.0, 0.5 * np.pi])
    angles = np.concatenate(np.broadcast_arrays(a + quarter, b + quarter), axis=-1)
    cos, sin = np.cos(angles), np.sin(angles)
    offset = pose_b[..., :2] - pose_a[..., :2]
    place = cos * offset[..., 0, None] + sin * offset[..., 1, None]
    speed = cos * velocity[..., 0, None] + sin * velocity[..., 1, None]
    reach = np.zeros_like(place)
    for heading, size in ((a, size_a), (b, size_b)):
        reach += 0.5 * size[..., 0, None] * np.abs(np.cos(angles - heading))
        reach += 0.5 * size[..., 1, None] * np.abs(np.sin(angles - heading))
    # A speed of zero gives the right infinities: always inside, or never.
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-reach - place) / speed, (reach - place) / speed
        begin = np.maximum(np.minimum(first, second).max(axis=-1), 0.0)
        end = np.maximum(first, second).min(axis=-1)
        meets = begin < end
    return np.where(meets, begin, np.inf), np.where(meets, end, np.inf)


def contacts(
    ego: FloatArray, size: npt.ArrayLike, tracks: Tracks, start_step: int
) -> Iterator[Contact]:
    """Every contact of a drive, one at most for each step and road user.

    Between two steps both centres move along straight lines and both headings turn the shorter
    way; a rectangle's heading counts modulo a half turn, which leaves its shape the same. Of a
    road user that is not on the scene at the step before, only the later pose is tested; at the
    first step, this holds for all. No road user is on the scene after the end of the tracks.

    Args:
        ego: (K + 1, 4) x, y, heading, velocity of the ego's centre at consecutive steps.
        size: (2,) length and width of the ego, m.
        tracks: The road users as they were driven.
        start_step: Step of ``ego[0]``.

    Yields:
        Contacts in the order of their steps. They are found as they are asked for.
    """
    ego_size = np.asarray(size, dtype=np.float64) - 2.0 * TOUCH
    swept_size = np.asarray(size, dtype=np.float64) - 2.0 * SWEPT_TOUCH
    at_step = fcl.CollisionObject(fcl.Box(*ego_size, 1.0))
    between = fcl.CollisionObject(fcl.Box(*swept_size, 1.0))
    user_objects: dict[int, fcl.CollisionObject] = {}
    sweeps = _broad_phase(ego, ego_size, tracks, start_step)
    for row in np.flatnonzero(sweeps.begin <= 1.0):
        user = int(sweeps.user[row])
        if user not in user_objects:
            user_objects[user] = fcl.CollisionObject(_geometry(tracks, user))
        # Backwards from the end: a single try is the later pose, where nothing may have moved.
        fractions = np.linspace(sweeps.end[row], sweeps.begin[row], sweeps.tries[row])[::-1]
        for fraction in fractions:
            ego_state = sweeps.ego_from[row] + fraction * sweeps.ego_motion[row]
            user_state = sweeps.user_from[row] + fraction * sweeps.user_motion[row]
            ego_object = between if fraction < 1.0 else at_step
            ego_object.setTransform(_transform(ego_state))
            user_objects[user].setTransform(_transform(user_state))
            if fcl.collide(ego_object, user_objects[user]):
                step = start_step + int(sweeps.step[row])
                yield Contact(step, float(fraction), user, ego_state, user_state)
                break


def first_contacts(
    ego: FloatArray, size: npt.ArrayLike, tracks: Tracks, start_step: int
) -> tuple[Contact, ...]:
    """The contacts of the first step that has any.

    Args:
        ego: (K + 1, 4) x, y, heading, velocity of the ego's centre at consecutive steps.
        size: (2,) length and width of the ego, m.
        tracks: The road users as they were driven.
        start_step: Step of ``ego[0]``.

    Returns:
        Those contacts by fraction, the earliest first; empty for a drive without a contact.
    """
    for _, group in groupby(contacts(ego, size, tracks, start_step), lambda hit: hit.step):
        return tuple(sorted(group, key=lambda hit: hit.fraction))
    return ()


@dataclass(frozen=True)
class _Sweeps:
    """M pairs of a step and a road user that may touch, by step.

    Attributes:
        step: (M,) index of the later step.
        user: (M,) row of the road user.
        ego_from: (M, 4) state of the ego at the earlier step.
        ego_motion: (M, 4) what is added to it on the way to the later step.
        user_from: (M, 4) the same of the road user.
        user_motion: (M, 4) the same.
        begin: (M,) fraction from which a contact is possible; infinite where it never is.
        end: (M,) fraction until which it is.
        tries: (M,) number of poses to try in between.
    """

    step: IntArray
    user: IntArray
    ego_from: FloatArray
    ego_motion: FloatArray
    user_from: FloatArray
    user_motion: FloatArray
    begin: FloatArray
    end: FloatArray
    tries: IntArray


def _broad_phase(ego: FloatArray, ego_size: FloatArray, tracks: Tracks, start_step: int) -> _Sweeps:
    window = slice(start_step, start_step + len(ego))
    present = tracks.valid[:, window].T
    users = np.swapaxes(tracks.states[:, window], 0, 1)
    ego = ego[: len(present), None]
    user_sizes = np.array(
        [
            size if outline is None else 2.0 * np.abs(outline).max(axis=0)
            for size, outline in zip(tracks.size, tracks.outlines, strict=True)
        ]
    ).reshape(-1, 2)
    symmetry = np.array([np.pi if outline is None else _TURN for outline in tracks.outlines])
    ego_radius, user_radii = 0.5 * np.hypot(*ego_size), 0.5 * np.hypot(*user_sizes.T)

    swept = present & np.roll(present, 1, axis=0)
    swept[:1] = False
    ego_from = np.where(swept[..., None], np.roll(ego, 1, axis=0), ego)
    user_from = np.where(swept[..., None], np.roll(users, 1, axis=0), users)
    ego_motion, user_motion = ego - ego_from, users - user_from
    shift = user_motion[..., :2] - ego_motion[..., :2]
    travel = np.hypot(shift[..., 0], shift[..., 1])
    gap = users[..., :2] - ego[..., :2]
    near = np.hypot(gap[..., 0], gap[..., 1]) < ego_radius + user_radii + travel

    # From here on one row for each step and road user whose bounding circles may meet.
    step, user = np.nonzero(present & near)
    ego_from, ego_motion = ego_from[step, user], ego_motion[step, user]
    user_from, user_motion = user_from[step, user], user_motion[step, user]
    shift, travel = shift[step, user], travel[step, user]
    ego_motion[:, USER_HEADING] = _shorter_turn(ego_motion[:, USER_HEADING], _TURN)
    user_motion[:, USER_HEADING] = _shorter_turn(user_motion[:, USER_HEADING], symmetry[user])
    # Turning by an angle moves no point of a shape further than the angle times its radius.
    turning = np.abs(ego_motion[:, USER_HEADING]) * ego_radius
    turning += np.abs(user_motion[:, USER_HEADING]) * user_radii[user]
    begin, end = overlap_window(
        ego_from[:, :3],
        ego_size + 2.0 * turning[:, None],
        user_from[:, :3],
        user_sizes[user],
        shift,
    )
    end = np.minimum(end, 1.0)
    length = np.where(begin <= 1.0, end - begin, 0.0) * (travel + turning)
    tries = 1 + np.ceil(length / RESOLUTION).astype(np.int64)
    return _Sweeps(step, user, ego_from, ego_motion, user_from, user_motion, begin, end, tries)


def _shorter_turn(turn: FloatArray, symmetry: FloatArray | float) -> FloatArray:
    """The turn of least size that ends in the same shape, which repeats every ``symmetry`` rad."""
    return np.asarray((turn + 0.5 * symmetry) % symmetry - 0.5 * symmetry)


def _geometry(tracks: Tracks, user: int) -> fcl.CollisionGeometry:
    """The exact shape of a road user in its body frame, for fcl.

    Every solid stands upright on the plane. An outline becomes a flat mesh in the middle of the
    ego's height, so that a mesh, which is hollow to fcl, is met wherever the ego covers it.
    """
    outline = tracks.outlines[user]
    if outline is None:
        return fcl.Box(*tracks.size[user], 1.0)
    triangles = shapely.constrained_delaunay_triangles(shapely.Polygon(outline))
    corners = np.concatenate([shapely.get_coordinates(part)[:3] for part in triangles.geoms])
    mesh = fcl.BVHModel()
    faces = np.arange(len(corners)).reshape(-1, 3)
    mesh.beginModel(len(corners), len(faces))
    mesh.addSubModel(np.column_stack([corners, np.zeros(len(corners))]), faces)
    mesh.endModel()
    return mesh


def _transform(state: FloatArray) -> fcl.Transform:
    cos, sin = np.cos(state[USER_HEADING]), np.sin(state[USER_HEADING])
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return fcl.Transform(rotation, np.array([state[0], state[1], 0.0]))
