"""Recorded road users: the obstacles of a scenario file as ``Tracks``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, Self
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from dosplan.geometry import wrap_angle
from dosplan.scenario.commonroad.elements import (
    FaultError,
    child,
    identity,
    label,
    middle,
    naming,
    step,
)
from dosplan.scenario.commonroad.states import Body, bodies, fitted, moved, position, read_shape
from dosplan.types import (
    STEP_SECONDS,
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    RoadUserKind,
    Tracks,
)

_KINDS: Final = {
    "car": RoadUserKind.CAR,
    "taxi": RoadUserKind.CAR,
    "priorityVehicle": RoadUserKind.CAR,
    "truck": RoadUserKind.TRUCK,
    "bus": RoadUserKind.BUS,
    "train": RoadUserKind.TRAIN,
    "motorcycle": RoadUserKind.MOTORCYCLE,
    "bicycle": RoadUserKind.BICYCLE,
    "pedestrian": RoadUserKind.PEDESTRIAN,
    "parkedVehicle": RoadUserKind.PARKED,
    "constructionZone": RoadUserKind.STATIC,
    "roadBoundary": RoadUserKind.STATIC,
    "building": RoadUserKind.STATIC,
    "pillar": RoadUserKind.STATIC,
    "median_strip": RoadUserKind.STATIC,
}
_VEHICLES: Final = frozenset(
    {
        RoadUserKind.CAR,
        RoadUserKind.TRUCK,
        RoadUserKind.BUS,
        RoadUserKind.MOTORCYCLE,
        RoadUserKind.PARKED,
    }
)
MAX_STATES: Final = 10_000_000
"""Most states, steps times road users, of a recording: 277 road users for an hour."""
MAX_SIZE: Final = 10_000.0
"""Largest length and width of a road user, m."""
_MOVED: Final = 0.05
"""Distance, m, below which a displacement gives no heading."""


STANDING: Final = 0.1
"""Speed, m/s, up to which a road user without a trajectory is taken to stand."""
_ALIKE: Final = 1e-3
"""Difference, m, rad and m/s, up to which two states of one step count as the same."""
STEPS: Final = (1e-3, 10.0)
"""Shortest and longest step that a file may have, s."""


@dataclass(frozen=True)
class Resampling:
    """How the steps of a file become steps of 0.1 s: ``times`` new for ``every`` old.

    Both kinds of step are whole numbers of ticks: an old one of ``times``, a new one of ``every``.
    A new step at the time of an old one has its state; one between two is interpolated.

    Attributes:
        times: Ticks of an old step.
        every: Ticks of a new step.
        begin: Tick of new step 0, such that the ego starts at a new step; 0 <= begin < every.
    """

    times: int = 1
    every: int = 1
    begin: int = 0

    @classmethod
    def of(cls, dt: float, start: int = 0) -> Self:
        """The resampling for a file's step.

        Args:
            dt: Step of the file, s.
            start: Old step at which the ego starts.

        Returns:
            The resampling.

        Raises:
            FaultError: The step is too short or too long.
        """
        if not STEPS[0] <= dt <= STEPS[1]:
            raise FaultError(
                f"its timeStepSize is {dt:g} s; give it a length from {STEPS[0]:g} s to "
                f"{STEPS[1]:g} s"
            )
        ratio = Fraction(dt / STEP_SECONDS).limit_denominator(1000)
        times, every = ratio.numerator, ratio.denominator
        return cls(times, every, start * times % every)

    @property
    def file_seconds(self) -> float:
        """Step of the file, s."""
        return STEP_SECONDS * self.times / self.every

    def instant(self, old: int) -> int:
        """The last new step that is not after an old one.

        Args:
            old: Old step.

        Returns:
            New step.
        """
        return (old * self.times - self.begin) // self.every

    def window(self, first: int, last: int) -> tuple[int, int]:
        """New steps within a window of old ones, or the nearest one where none lies within.

        Args:
            first: First old step.
            last: Last old step.

        Returns:
            First and last new step.
        """
        begin, end = (old * self.times - self.begin for old in (first, last))
        start, stop = -(-begin // self.every), end // self.every
        if start > stop:
            start = stop = round(Fraction(begin + end, 2 * self.every))
        return start, stop

    def old_steps(self, last: int) -> int:
        """Number of old steps that are needed to know the new ones up to one.

        Args:
            last: The last new step that is needed.

        Returns:
            How many, from old step 0 on.
        """
        return -(-(last * self.every + self.begin) // self.times) + 1

    def tracks(self, states: FloatArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Resampled tracks.

        Args:
            states: (N, K, 4) road-user states; NaN where not ``valid``.
            valid: (N, K).

        Returns:
            (N, K', 4) and (N, K'): linear between two neighbouring valid steps, headings the
            short way round; a step between a valid one and one that is not is not valid.
        """
        grid = np.arange(self.begin, (states.shape[1] - 1) * self.times + 1, self.every)
        low, share = grid // self.times, (grid % self.times) / self.times
        high = np.where(share > 0, low + 1, low)
        change = states[:, high] - states[:, low]
        change[..., USER_HEADING] = wrap_angle(change[..., USER_HEADING])
        return states[:, low] + share[:, None] * change, valid[:, low] & valid[:, high]


@dataclass(frozen=True)
class _Obstacle:
    """An obstacle of the file.

    Attributes:
        id: Its id.
        kind: What it is.
        bodies: Its convex bodies.
        steps: (M,) steps of its states in the file.
        rows: (M, 4) its states; a single one at step 0 where it is fixed.
        stays: Whether it stays where its last state is.
    """

    id: int
    kind: RoadUserKind
    bodies: list[Body]
    steps: IntArray
    rows: FloatArray
    stays: bool


def read_tracks(
    root: Element,
    resampling: Resampling,
    last_step: int,
    road: shapely.Geometry,
) -> tuple[Tracks, tuple[str, ...]]:
    """The road users of a scenario file.

    A road user whose shapes are not convex becomes several, one for each convex piece, which move
    together. The first has its id, the others ids that nothing in the file has.

    One without a trajectory that stands stays where it is. One that moves has left the scene after
    its only state.

    Args:
        root: The file's root element.
        resampling: From the file's steps to steps of 0.1 s.
        last_step: The tracks cover the steps up to here at least, in steps of 0.1 s.
        road: Where cars drive, m.

    Returns:
        The tracks, and what was corrected, a line each. A static obstacle is there at every step,
        at rest.

    Raises:
        FaultError: A road user cannot be read, has no size or one beyond ``MAX_SIZE``, or there
            are more than ``MAX_STATES`` states.
    """
    dynamic, static = _listed(root)
    read: list[_Obstacle] = []
    for elements, make in ((dynamic, _dynamic), (static, _static)):
        for element in elements:
            with naming(label(element)):
                read.append(make(element, resampling, road))
    ends = [int(o.steps[-1]) + 1 for o in read]
    length = max([resampling.old_steps(last_step), *ends])
    count = sum(len(o.bodies) for o in read)
    if length * resampling.times / resampling.every * max(count, 1) > MAX_STATES or (
        length * max(count, 1) > MAX_STATES
    ):
        raise FaultError(
            f"has {count} obstacles at up to {length} steps, more than {MAX_STATES} states; "
            "split it"
        )
    return _tracks(read, _free_ids(root, read), length, resampling)


def _listed(root: Element) -> tuple[list[Element], list[Element]]:
    """The dynamic obstacles, and those that never move."""
    dynamic, static = root.findall("dynamicObstacle"), root.findall("staticObstacle")
    for element in root.iterfind("obstacle"):  # of version 2018b
        role = (element.findtext("role") or "").strip()
        if role not in ("static", "dynamic"):
            raise FaultError(f"{label(element)} has the role '{role}'; make it static or dynamic")
        (dynamic if role == "dynamic" else static).append(element)
    static += root.findall("environmentObstacle")
    known: set[int] = set()
    for element in (*dynamic, *static):
        name = identity(element)
        if name in known:
            raise FaultError(f"names obstacle {name} twice; give one of them another id")
        known.add(name)
    return dynamic, static


def interactive(root: Element) -> bool:
    """Whether a file leaves it to a simulator to move its road users.

    Args:
        root: The file's root element.

    Returns:
        Whether somebody moves, and nobody has a trajectory.

    Raises:
        FaultError: A road user cannot be read.
    """
    dynamic, _ = _listed(root)
    if any(element.find("trajectory/state") is not None for element in dynamic):
        return False
    for element in dynamic:
        with naming(label(element)):
            speed = child(element, "initialState").find("velocity")
            if speed is not None and abs(middle(speed)) > STANDING:
                return True
    return False


def _dynamic(element: Element, resampling: Resampling, _: shapely.Geometry) -> _Obstacle:
    steps, rows = recorded(element, resampling.file_seconds)
    alone = element.find("trajectory/state") is None
    return _Obstacle(
        id=identity(element),
        kind=_kind(element),
        bodies=_bodies(element, fixed=False),
        steps=steps,
        rows=rows,
        stays=alone and abs(float(rows[0, USER_VELOCITY])) <= STANDING,
    )


def _static(element: Element, _: Resampling, road: shapely.Geometry) -> _Obstacle:
    place = np.zeros(USER_SIZE)
    if element.tag != "environmentObstacle":  # whose shape stands in the scenario frame
        state = child(element, "initialState")
        place[:2] = position(state)
        turned = state.find("orientation")
        place[2] = 0.0 if turned is None else middle(turned)
    kind = _kind(element)
    pieces = _bodies(element, fixed=True)
    return _Obstacle(
        id=identity(element),
        kind=RoadUserKind.PARKED if kind in _VEHICLES else RoadUserKind.STATIC,
        bodies=[part for piece in pieces for part in fitted(piece, place[:3], road)],
        steps=np.zeros(1, dtype=np.int64),
        rows=place[None],
        stays=True,
    )


def _kind(element: Element) -> RoadUserKind:
    return _KINDS.get((element.findtext("type") or "").strip(), RoadUserKind.UNKNOWN)


def _bodies(element: Element, *, fixed: bool) -> list[Body]:
    found = bodies(read_shape(child(element, "shape")), fixed=fixed)
    for body in found:
        if not np.all((body.size > 0.0) & (body.size <= MAX_SIZE)):
            raise FaultError(f"it is {body.size[0]:g} m by {body.size[1]:g} m; correct it")
    return found


def _tracks(
    read: Sequence[_Obstacle], free_ids: Iterable[int], length: int, resampling: Resampling
) -> tuple[Tracks, tuple[str, ...]]:
    fresh, notes = iter(free_ids), []
    ids: list[int] = []
    owners: list[_Obstacle] = []
    for obstacle in read:
        own = [obstacle.id, *(next(fresh) for _ in obstacle.bodies[1:])]
        if len(own) > 1:
            others = str(own[1]) if len(own) == 2 else f"{own[1]} to {own[-1]}"
            notes.append(
                f"obstacle {obstacle.id}: its shape is taken in pieces, the road users "
                f"{obstacle.id} and {others}"
            )
        ids += own
        owners += [obstacle] * len(own)
    parts = [body for obstacle in read for body in obstacle.bodies]
    states = np.array([_on_grid(o, length) for o in owners]).reshape(-1, length, USER_SIZE)
    for row, body in zip(states, parts, strict=True):
        row[:, :3] = moved(body.pose, row[:, :3])
    states, valid = resampling.tracks(states, ~np.isnan(states[..., 0]))
    tracks = Tracks(
        ids=np.array(ids, dtype=np.int64),
        kinds=tuple(obstacle.kind for obstacle in owners),
        size=np.array([body.size for body in parts]).reshape(-1, 2),
        states=states,
        valid=valid,
        outlines=tuple(body.outline for body in parts),
    )
    return tracks, tuple(notes)


def _free_ids(root: Element, read: Sequence[_Obstacle]) -> Iterable[int]:
    """Ids that nothing in the file has."""
    first = max([0, *(o.id for o in read)])
    for element in root.iter():
        text = element.get("id", "")
        if text.isdecimal():
            first = max(first, int(text))
    return range(first + 1, first + 1 + sum(len(o.bodies) for o in read))


def recorded(element: Element, dt: float) -> tuple[IntArray, FloatArray]:
    """What was recorded of a dynamic obstacle.

    Args:
        element: The obstacle.
        dt: Step of the file, s.

    Returns:
        (M,) steps of the file in order, and (M, 4) states at them; headings and velocities that
        the file leaves out are derived from the positions.

    Raises:
        FaultError: A state cannot be read, or two of one step contradict each other.
    """
    first = child(element, "initialState")
    with naming("its initial state"):
        begin = step(first)
        known = {begin: _row(first)}
    if begin < 0:
        raise FaultError(f"it begins at step {begin}; steps count from 0")
    for count, state in enumerate(element.iterfind("trajectory/state"), start=1):
        with naming(f"state {count} of its trajectory"):
            at = step(state)
            row = _row(state) if at > begin else []
        if not row:
            continue
        if at in known and not np.allclose(known[at], row, rtol=0.0, atol=_ALIKE, equal_nan=True):
            raise FaultError(f"it has two different states at step {at}; remove one of them")
        known.setdefault(at, row)
    steps = np.array(sorted(known), dtype=np.int64)
    rows = np.array([known[int(at)] for at in steps])
    return steps, _derived(rows, steps.astype(np.float64) * dt)


def _row(state: Element) -> list[float]:
    """x, y, heading and speed of a state; NaN for a heading or a speed that it leaves out."""
    turned, along, across = (state.find(tag) for tag in ("orientation", "velocity", "velocityY"))
    speed = np.nan if along is None else middle(along)
    if across is not None:
        speed = float(np.hypot(speed, middle(across)))
    return [*position(state), np.nan if turned is None else middle(turned), speed]


def _derived(rows: FloatArray, time: FloatArray) -> FloatArray:
    """States with missing headings and velocities derived from the positions."""
    unknown_heading, unknown_velocity = np.isnan(rows[:, 2]), np.isnan(rows[:, 3])
    if not np.any(unknown_heading | unknown_velocity):
        return rows
    rate = np.gradient(rows[:, :2], time, axis=0) if len(rows) > 1 else np.zeros((1, 2))
    step = np.hypot(*rate.T) * (time[1] - time[0] if len(time) > 1 else 0.0)
    seen = np.where(
        unknown_heading & (step > _MOVED), np.arctan2(rate[:, 1], rate[:, 0]), rows[:, 2]
    )
    known = np.flatnonzero(~np.isnan(seen))
    if len(known) == 0:
        seen, known = np.zeros(len(rows)), np.arange(len(rows))
    nearest = np.interp(np.arange(len(rows)), known, np.unwrap(seen[known]))
    heading = np.where(unknown_heading, nearest, rows[:, 2])
    along = rate[:, 0] * np.cos(heading) + rate[:, 1] * np.sin(heading)
    velocity = np.where(unknown_velocity, along, rows[:, 3])
    return np.column_stack([rows[:, :2], heading, velocity])


def _on_grid(obstacle: _Obstacle, length: int) -> FloatArray:
    grid = np.full((length, USER_SIZE), np.nan)
    grid[obstacle.steps] = obstacle.rows
    if obstacle.stays:
        grid[obstacle.steps[-1] :] = [*obstacle.rows[-1, :3], 0.0]
    return grid
