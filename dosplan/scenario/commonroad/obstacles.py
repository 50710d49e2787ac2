"""Recorded road users: commonroad-io obstacles to ``Tracks``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dosplan.geometry import wrap_angle
from dosplan.scenario.commonroad.states import body, exact, moved, position
from dosplan.types import (
    STEP_SECONDS,
    USER_HEADING,
    USER_SIZE,
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
"""Distance, m, below which a displacement says nothing about the heading."""


@dataclass(frozen=True)
class Resampling:
    """How the steps of a file become steps of 0.1 s: ``times`` new for ``every`` old.

    One of the two is 1, so that no new step lies between two old ones without being an exact
    share of the way.
    """

    times: int = 1
    every: int = 1

    @classmethod
    def of(cls, dt: float) -> Resampling:
        """The resampling for a file's step.

        Args:
            dt: Step of the file, s.

        Returns:
            The resampling.

        Raises:
            ValueError: Neither of ``dt`` and 0.1 s is a multiple of the other.
        """
        for ratio, name in ((dt / STEP_SECONDS, "times"), (STEP_SECONDS / max(dt, 1e-9), "every")):
            if np.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-6:
                return cls(**{name: round(ratio)})
        raise ValueError(
            f"has a step of {dt} s, of which 0.1 s is neither a multiple nor a whole share; "
            "resample it to 0.1 s"
        )

    def instant(self, step: int) -> int:
        """New number of an old step.

        Args:
            step: Old step.

        Returns:
            New step.

        Raises:
            ValueError: The step is one of those left out.
        """
        if step * self.times % self.every:
            raise ValueError(
                f"begins at step {step}, which no multiple of 0.1 s meets; resample it"
            )
        return step * self.times // self.every

    def window(self, first: int, last: int) -> tuple[int, int]:
        """New steps within a window of old ones.

        Args:
            first: First old step.
            last: Last old step.

        Returns:
            First and last new step.

        Raises:
            ValueError: There is none.
        """
        start, end = -(-first * self.times // self.every), last * self.times // self.every
        if start > end:
            raise ValueError(
                f"has a goal at steps {first} to {last} only, between two steps of 0.1 s; widen it"
            )
        return start, end

    def tracks(self, states: FloatArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Resampled tracks.

        Args:
            states: (N, K, 4) road-user states; NaN where not ``valid``.
            valid: (N, K).

        Returns:
            (N, K', 4) and (N, K'): linear between two neighbouring valid steps, headings the
            short way round; a step between a valid one and one that is not is not valid.
        """
        grid = np.arange(0, (states.shape[1] - 1) * self.times + 1, self.every)
        low, share = grid // self.times, (grid % self.times) / self.times
        high = np.where(share > 0, low + 1, low)
        change = states[:, high] - states[:, low]
        change[..., USER_HEADING] = wrap_angle(change[..., USER_HEADING])
        return states[:, low] + share[:, None] * change, valid[:, low] & valid[:, high]


def read_tracks(
    scenario: Any,
    derived: Mapping[int, frozenset[str]],
    resampling: Resampling,
    last_step: int,
) -> Tracks:
    """The road users of a commonroad-io scenario.

    Args:
        scenario: The commonroad-io scenario.
        derived: Fields that each obstacle's initial state leaves out; they are derived from the
            positions.
        resampling: From the file's steps to steps of 0.1 s.
        last_step: The tracks cover the steps up to here at least, in steps of 0.1 s.

    Returns:
        The tracks. A static obstacle is there at every step, at rest.

    Raises:
        ValueError: A road user has no size or one beyond ``MAX_SIZE``, or there are more than
            ``MAX_STATES`` states.
    """
    dt = STEP_SECONDS * resampling.times / resampling.every
    moving = [_recorded(o, derived.get(o.obstacle_id, frozenset()), dt) for o in _dynamic(scenario)]
    needed = -(-last_step * resampling.every // resampling.times) + 1
    length = max([needed, *(int(steps[-1]) + 1 for steps, _ in moving)])
    obstacles = [*_dynamic(scenario), *_static(scenario)]
    if length * resampling.times * max(len(obstacles), 1) > MAX_STATES:
        raise ValueError(
            f"has {len(obstacles)} obstacles at up to {length} steps, more than {MAX_STATES} "
            "states; split it"
        )
    bodies = [body(o.obstacle_shape) for o in obstacles]
    for obstacle, (_, size, _) in zip(obstacles, bodies, strict=True):
        if not np.all((size > 0.0) & (size <= MAX_SIZE)):
            raise ValueError(
                f"obstacle {obstacle.obstacle_id} is {size[0]:g} m by {size[1]:g} m; correct it"
            )
    dynamic = [_on_grid(steps, rows, length) for steps, rows in moving]
    static = [np.tile(_at_rest(o), (length, 1)) for o in _static(scenario)]
    states = np.array([*dynamic, *static]).reshape(len(obstacles), length, USER_SIZE)
    for row, (pose, _, _) in zip(states, bodies, strict=True):
        row[:, :3] = moved(pose, row[:, :3])
    states, valid = resampling.tracks(states, ~np.isnan(states[..., 0]))
    return Tracks(
        ids=np.array([o.obstacle_id for o in obstacles], dtype=np.int64),
        kinds=tuple(
            [_kind(o) for o in _dynamic(scenario)] + [_kind_at_rest(o) for o in _static(scenario)]
        ),
        size=np.array([size for _, size, _ in bodies]).reshape(-1, 2),
        states=states,
        valid=valid,
        outlines=tuple(outline for _, _, outline in bodies),
    )


def _dynamic(scenario: Any) -> Sequence[Any]:
    return list(scenario.dynamic_obstacles)


def _static(scenario: Any) -> Sequence[Any]:
    return [*scenario.static_obstacles, *scenario.environment_obstacle]


def _kind(obstacle: Any) -> RoadUserKind:
    return _KINDS.get(obstacle.obstacle_type.value, RoadUserKind.UNKNOWN)


def _kind_at_rest(obstacle: Any) -> RoadUserKind:
    return RoadUserKind.PARKED if _kind(obstacle) in _VEHICLES else RoadUserKind.STATIC


def _at_rest(obstacle: Any) -> FloatArray:
    state = getattr(obstacle, "initial_state", None)
    if state is None:  # an environment obstacle's shape stands in the scenario frame
        return np.zeros(USER_SIZE)
    return np.array([*position(state.position), exact(state.orientation), 0.0])


def _recorded(obstacle: Any, absent: frozenset[str], dt: float) -> tuple[IntArray, FloatArray]:
    """Steps and states (M, 4) of a dynamic obstacle, gaps in heading and velocity filled."""
    first = obstacle.initial_state
    later = [] if obstacle.prediction is None else obstacle.prediction.trajectory.state_list
    states = [first, *(s for s in later if _step(s) > _step(first))]
    steps = np.array([_step(state) for state in states], dtype=np.int64)
    if np.any(np.diff(steps) <= 0) or steps[0] < 0:
        raise ValueError(
            f"lists the states of obstacle {obstacle.obstacle_id} out of order; sort them by time"
        )
    rows = np.array([_row(state) for state in states])
    if "orientation" in absent:
        rows[0, 2] = np.nan
    if "velocity" in absent:
        rows[0, 3] = np.nan
    return steps, _derived(rows, steps.astype(np.float64) * dt)


def _step(state: Any) -> int:
    return int(exact(state.time_step))


def _row(state: Any) -> list[float]:
    heading = getattr(state, "orientation", None)
    along = getattr(state, "velocity", None)
    speed = np.nan if along is None else exact(along)
    # commonroad-io answers `velocity_y` for a state that has none: with the speed's share along
    # the y axis. Only where the file holds one is it the velocity across the body.
    if "velocity_y" in state.used_attributes:
        speed = float(np.hypot(speed, exact(state.velocity_y)))
    return [*position(state.position), np.nan if heading is None else exact(heading), speed]


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


def _on_grid(steps: IntArray, rows: FloatArray, length: int) -> FloatArray:
    grid = np.full((length, USER_SIZE), np.nan)
    grid[steps] = rows
    return grid
