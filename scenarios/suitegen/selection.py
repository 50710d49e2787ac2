"""Which vehicle becomes the ego, and when: interactive moments of a recording.

These checks are quick and conservative; ``verdict`` makes the final check.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from dosplan.convert.windows import asks_for_driving
from dosplan.geometry import rectangle_corners, wrap_angle
from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters

from .motion import Motion
from .plain import Point
from .traffic import EGO_KIND, STEP
from .verdict import FIRST_CONTACT

HISTORY = (10, 15)
"""Steps recorded before the ego starts."""
DRIVE = (45, 100)
"""Steps of the ego's recorded drive."""
SLACK = (20, 30)
"""Steps for which recording and goal last after the recorded arrival."""
EARLY = (15, 25)
"""Steps before the recorded arrival from which the goal counts."""
START_STRIDE = 7
SIGHT = 90.0
"""Road users that never come this close to the ego's recorded drive are left out, m."""
FOCUS_RADIUS = 25.0
"""The ego's recorded drive comes this close to what its road kind is named after, m."""
CLEARANCE = 0.15
"""Least distance of the recorded ego from all road users, m."""
CROSSING_ANGLE = 0.6
"""Difference of headings, rad, from which on a conflict is a crossing one."""
MERGING_OFFSET = 1.7
"""Distance, m, from the ego's path at which a road user that merges into it begins."""
EGO_SIZE = VehicleParameters().size
MAX_ACCELERATION = 9.0
MAX_YAW_RATE = 1.5


@dataclass(frozen=True)
class Moment:
    """A vehicle and a window that make an interactive scenario.

    Attributes:
        ego: The vehicle that is taken out.
        others: The other road users near it.
        conflict: The road user that constant speed hits: one ``crossing`` its path, ``merging``
            into it from the side, or ``leading`` on it from the start.
        first: Step of the recording that becomes step 0.
        start: Step of the scenario at which the ego starts.
        arrival: Step of the scenario at which its recorded drive ends.
        last: Last step of the scenario.
        goal_first: First step of the scenario at which the goal counts.
    """

    ego: Motion
    others: tuple[Motion, ...]
    conflict: str
    first: int
    start: int
    arrival: int
    last: int
    goal_first: int

    def drive(self) -> FloatArray:
        """(K, 4) states of the recorded drive from start to arrival."""
        return self.ego.window(self.first + self.start, self.first + self.arrival)


def moments(
    motions: Sequence[Motion],
    focus: Sequence[Point],
    conflicts: Container[str],
    rng: np.random.Generator,
) -> Iterator[Moment]:
    """Interactive moments of a recording, in random order.

    Args:
        motions: All road users of the recording.
        focus: See ``Road``.
        conflicts: The conflicts that are wanted, see ``Moment``.
        rng: Draws windows and their order.

    Yields:
        Moments that pass every quick check.
    """
    egos = [motion for motion in motions if motion.trace.kind == EGO_KIND]
    spots = [
        (ego, start)
        for ego in egos
        for start in range(ego.first + HISTORY[1], ego.last, START_STRIDE)
    ]
    for index in rng.permutation(len(spots)):
        ego, start = spots[index]
        history, drive, slack, early = (
            int(rng.integers(low, high + 1)) for low, high in (HISTORY, DRIVE, SLACK, EARLY)
        )
        if start + drive + slack > ego.last:
            continue
        states = ego.window(start, start + drive)
        if not (asks_for_driving(states) and _reaches(states, focus)):
            continue
        first, last = start - history, start + drive + slack
        others = tuple(m for m in motions if m is not ego and near(m, ego, first, last))
        conflict = _conflict(ego, start, start + drive, others)
        if conflict in conflicts and plausible((ego, *others), first, last):
            yield Moment(
                ego,
                others,
                conflict,
                first,
                start=history,
                arrival=history + drive,
                last=last - first,
                goal_first=history + drive - early,
            )


def _reaches(states: FloatArray, focus: Sequence[Point]) -> bool:
    gaps = states[:, None, :2] - np.asarray(focus)
    return bool(np.hypot(gaps[..., 0], gaps[..., 1]).min() < FOCUS_RADIUS)


def near(motion: Motion, ego: Motion, first: int, last: int) -> bool:
    """Whether a road user comes as near to the ego as ``SIGHT`` in a window."""
    begin, end = max(motion.first, first), min(motion.last, last)
    if end - begin < 1:
        return False
    gap = motion.window(begin, end)[:, :2] - ego.window(begin, end)[:, :2]
    return bool(np.hypot(gap[:, 0], gap[:, 1]).min() < SIGHT)


def _boxes(motion: Motion, first: int, last: int) -> FloatArray:
    """Polygons at the steps that the motion covers."""
    states = motion.window(first, last)
    return np.asarray(shapely.polygons(rectangle_corners(states[:, :3], motion.trace.size)))


def _held(states: FloatArray) -> FloatArray:
    """(K, 3) poses of an ego that drives the recorded path at its initial speed."""
    along = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1))]
    )
    way = states[0, 3] * STEP * np.arange(len(states))
    poses = np.column_stack([np.interp(way, along, column) for column in states[:, :3].T])
    beyond = np.clip(way - along[-1], 0.0, None)[:, None]
    poses[:, :2] += beyond * np.array([np.cos(states[-1, 2]), np.sin(states[-1, 2])])
    return poses


def _conflict(ego: Motion, start: int, arrival: int, others: Sequence[Motion]) -> str:
    """The conflict of constant speed, see ``Moment``; empty where there is no usable one.

    That is where the recorded drive itself comes too close to a road user, or where constant speed
    has no collision, one that is too soon to react, or one with a road user behind the ego.
    """
    states = ego.window(start, arrival)
    held = _held(states)
    recorded = shapely.polygons(rectangle_corners(states[:, :3], EGO_SIZE))
    holding = shapely.polygons(rectangle_corners(held, EGO_SIZE))
    contact, hit = len(states), None
    for other in others:
        begin, end = max(other.first, start), min(other.last, arrival)
        if end < begin:
            continue
        part = slice(begin - start, end - start + 1)
        boxes = _boxes(other, begin, end)
        if np.any(shapely.dwithin(recorded[part], boxes, CLEARANCE)):
            return ""
        hits = np.flatnonzero(shapely.intersects(holding[part], boxes))
        if hits.size and part.start + hits[0] < contact:
            contact, hit = part.start + int(hits[0]), other
    if hit is None or contact < FIRST_CONTACT:
        return ""
    there, here = hit.window(start + contact, start + contact)[0], held[contact]
    if (there[:2] - here[:2]) @ np.array([np.cos(here[2]), np.sin(here[2])]) <= 0.0:
        return ""
    if abs(wrap_angle(there[2] - here[2])) > CROSSING_ANGLE:
        return "crossing"
    origin = hit.window(*[max(hit.first, start)] * 2)[0, :2]
    aside = shapely.distance(shapely.LineString(ego.states[:, :2]), shapely.Point(origin))
    return "merging" if aside > MERGING_OFFSET else "leading"


def plausible(users: Sequence[Motion], first: int, last: int) -> bool:
    """Whether no road user overlaps another one, jumps or spins in a window.

    Args:
        users: Road users who are there in a part of it.
        first: Its first step.
        last: Its last step.

    Returns:
        Whether they drive as road users do.
    """
    odd = any(leaps(user, first, last) or spins(user, first, last) for user in users)
    return not odd and overlapping(users, first, last) is None


def leaps(user: Motion, first: int, last: int) -> bool:
    """Whether a road user changes its speed in a window as none can."""
    states = user.window(max(user.first, first), min(user.last, last))
    return bool(np.abs(np.diff(states[:, 3])).max(initial=0.0) > MAX_ACCELERATION * STEP)


def spins(user: Motion, first: int, last: int) -> bool:
    """Whether a vehicle turns in a window as none can."""
    states = user.window(max(user.first, first), min(user.last, last))
    turn = np.abs(np.diff(states[:, 2])).max(initial=0.0)
    return bool(user.trace.kind != "pedestrian" and turn > MAX_YAW_RATE * STEP)


def overlapping(users: Sequence[Motion], first: int, last: int) -> tuple[Motion, Motion] | None:
    """Two road users who are in the same place at a step of a window; None where nobody is."""
    present = [(u, _boxes(u, max(u.first, first), min(u.last, last))) for u in users]
    for step in range(first, last + 1):
        here = [
            (user, boxes[step - max(user.first, first)])
            for user, boxes in present
            if user.first <= step <= user.last
        ]
        shapes = [shape for _, shape in here]
        one, other = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        for a, b in zip(one, other, strict=True):
            if a != b:
                return here[a][0], here[b][0]
    return None
