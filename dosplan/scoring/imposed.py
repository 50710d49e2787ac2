"""What the ego's presence asks of others: how hard they brake for it, and who cuts in.

Both need road users that react. Where all drive as recorded, nobody brakes for the ego.

Imposed braking is what a vehicle loses of its speed over 0.5 s, without what its recording loses
over the same way, divided by that time. The largest value over all vehicles and steps counts.

A cut-in is judged at the last step at which the ego enters the way of who then runs into it, a
distance ``gap`` ahead. The follower keeps its speed for ``t = 0.4 s`` and then brakes evenly to the
ego's speed. With the difference ``dv`` of their speeds it needs

    dv^2 / (2 (gap - dv t))

and the ego is to blame where that is more than 5 m/s2 or nothing would do. Sources: UN Regulation
157 (5 m/s2 and more is an emergency manoeuvre); UN Regulation 79, 5.6.4.7 (0.4 s).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import shapely

from dosplan.geometry import rectangle_corners, wrap_angle
from dosplan.scoring.collision import Contact
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    FloatArray,
    RoadUserKind,
    Tracks,
)
from dosplan.vehicle import VehicleParameters

CUT_IN_BRAKING: Final = 5.0
"""Braking of a follower beyond which an ego that enters its way is to blame for being hit, m/s2.

UN Regulation 157 (automated lane keeping systems) calls what needs more than 5.0 m/s2 an emergency
manoeuvre. Nobody may be made to do one by a lane change: UN Regulation 79, 5.6.4.7, allows a lane
change to ask 3 m/s2 of an approaching vehicle. Between the two, the follower shares the blame.
"""

CUT_IN_REACTION: Final = 0.4
"""Time that the follower has before it brakes, s (UN Regulation 79, 5.6.4.7)."""

SIDE: Final = 0.2
"""What is added to each side of a road user to give its corridor, m."""

WINDOW: Final = 5
"""Steps over which braking is measured; recorded velocities shake from one step to the next."""

ON_PATH: Final = 2.0
"""How far from its recorded path a road user may be to be compared with the recording, m."""

_ALIGNED: Final = np.deg2rad(60.0)
_VEHICLES: Final = frozenset(
    (RoadUserKind.CAR, RoadUserKind.TRUCK, RoadUserKind.BUS, RoadUserKind.MOTORCYCLE)
)


def cut_in_demand(
    contact: Contact,
    tracks: Tracks,
    ego: FloatArray,
    vehicle: VehicleParameters,
    start: int,
    dt: float,
) -> float | None:
    """How hard a follower would have had to brake when the ego entered its way.

    Its way is what it drove until the contact, as wide as it is and ``SIDE`` more on both sides.
    The ego enters it at the last step at which it was beside it the step before. From then on, the
    follower keeps its speed for ``CUT_IN_REACTION`` and brakes evenly to the ego's speed.

    Args:
        contact: The moment at which ego and road user touch.
        tracks: The road users as they were driven.
        ego: (K + 1, 4) x, y, heading, velocity of the ego's centre.
        vehicle: The ego's parameters.
        start: Step of ``ego[0]``.
        dt: Step, s.

    Returns:
        The deceleration, m/s2, infinite where none would have been enough; None where it is no
        follower, or the ego was in its way from the beginning.
    """
    user = contact.user
    turn = float(wrap_angle(contact.ego_state[USER_HEADING] - contact.user_state[USER_HEADING]))
    if abs(turn) > _ALIGNED or tracks.kinds[user] not in _VEHICLES:
        return None
    last = contact.step - 1
    seen = np.flatnonzero(tracks.valid[user, start : last + 1])
    if not len(seen) or seen[-1] != last - start:
        return None
    gaps = np.flatnonzero(np.diff(seen) > 1)
    first = start + int(seen[gaps[-1] + 1] if len(gaps) else seen[0])
    length, width = tracks.size[user]
    driven = np.vstack([tracks.states[user, first : last + 1, :2], contact.user_state[None, :2]])
    heading = contact.user_state[USER_HEADING]
    reach = 0.5 * float(length) * np.array([np.cos(heading), np.sin(heading)])
    line = np.vstack([driven, driven[-1] + reach])
    for step in range(last, first - 1, -1):
        way = shapely.LineString(line[step - first :])
        body = shapely.Polygon(rectangle_corners(ego[step - start, :3], vehicle.size))
        corridor = way.buffer(0.5 * float(width) + SIDE, cap_style="flat")
        if corridor.intersects(body):
            continue
        if step == last:  # It came from the side at the very end.
            return np.inf
        own = tracks.states[user, step + 1]
        other = ego[step + 1 - start]
        ahead = shapely.LineString(line[step + 1 - first :])
        near = min(
            ahead.project(shapely.Point(*c)) for c in rectangle_corners(other[:3], vehicle.size)
        )
        gap = near - 0.5 * float(length)
        angle = other[USER_HEADING] - own[USER_HEADING]
        closing = float(own[USER_VELOCITY] - other[USER_VELOCITY] * np.cos(angle))
        if closing <= 0.0:
            return 0.0 if gap > 0.0 else np.inf
        left = gap - closing * CUT_IN_REACTION
        return closing**2 / (2.0 * left) if left > 0.0 else np.inf
    return None


def imposed_braking(
    recorded: Tracks, tracks: Tracks, start: int, last: int, dt: float
) -> float | None:
    """The hardest braking that the ego's presence asked of anybody.

    A road user that drives along its recorded path is slowed over half a second; what it was
    recorded to slow down over the same way is taken off. Road users that are where they were
    recorded to be are not slowed.

    Args:
        recorded: The recorded future that they began with.
        tracks: The road users as they were driven.
        start: First step that is looked at.
        last: Last step that is looked at.
        dt: Step, s.

    Returns:
        m/s2, 0 where nobody was slowed. None where it cannot be told from other things: all drive
        as recorded whatever comes, no step was driven, no vehicle is there as long as the recording
        lasts, or most are off it at once, as they have intentions of their own.
    """
    if tracks is recorded or last <= start:
        return None
    rows = {int(name): row for row, name in enumerate(recorded.ids)}
    own = [i for i, name in enumerate(tracks.ids.tolist()) if name in rows]
    own = [i for i in own if tracks.kinds[i] in _VEHICLES]
    was = np.array([rows[int(tracks.ids[i])] for i in own], dtype=np.int64)
    ahead = slice(start + 1, min(last + 1, tracks.steps, recorded.steps))
    there = tracks.valid[own, ahead] & recorded.valid[was, ahead]
    if not there.any():
        return None
    first = int(np.argmax(there.any(axis=0)))
    at, seen = start + 1 + first, there[:, first]
    same = np.all(tracks.states[own, at] == recorded.states[was, at], axis=1)
    if np.mean(same[seen]) < 0.5:
        return None
    pairs = zip(own, was.tolist(), strict=True)
    return max(
        (_slowed(tracks, i, recorded, j, start, last, dt) for i, j in pairs),
        default=0.0,
    )


def _slowed(
    tracks: Tracks, row: int, recorded: Tracks, was: int, start: int, last: int, dt: float
) -> float:
    """The most that one road user is slowed beyond its recording, m/s2."""
    steps = start + np.flatnonzero(tracks.valid[row, start : last + 1])
    if not len(steps):
        return 0.0
    driven = tracks.states[row, steps]
    known = steps[steps < recorded.steps]
    as_recorded = np.zeros(len(steps), dtype=np.bool_)
    as_recorded[: len(known)] = np.all(driven[: len(known)] == recorded.states[was, known], axis=1)
    if as_recorded.all():
        return 0.0
    places = recorded.states[was, recorded.valid[was]]
    apart = np.hypot(*(driven[:, None, :2] - places[:, :2]).transpose(2, 0, 1))
    nearest = np.argmin(apart, axis=1)
    close = apart[np.arange(len(steps)), nearest] < ON_PATH
    before, after = np.arange(len(steps) - WINDOW), np.arange(WINDOW, len(steps))
    counts = ~as_recorded[after] & close[before] & close[after]
    counts &= steps[after] - steps[before] == WINDOW
    lost = driven[before, USER_VELOCITY] - driven[after, USER_VELOCITY]
    speed = places[nearest, USER_VELOCITY]
    meant = np.maximum(speed[before] - speed[after], 0.0)
    braking = (lost - meant)[counts] / (WINDOW * dt)
    return float(braking.max(initial=0.0))
