"""Windows of a record: all of it in pieces, and the moments in which a vehicle becomes the ego.

Numbers of steps below are of 0.1 s; a record may have steps of any length.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.types import HISTORY_STEPS, STEP_SECONDS, FloatArray

PIECE: Final = 600
"""Steps of a piece of a record: a minute."""
DRIVE: Final = (45, 80)
"""Least and largest number of steps of the ego's recorded drive."""
SLACK: Final = 25
"""Steps for which recording and goal last after the recorded arrival."""
EARLY: Final = 20
"""Steps before the recorded arrival from which the goal counts."""
START_STRIDE: Final = 20
"""Steps between two starts of one vehicle that are tried."""
MIN_START_SPEED: Final = 3.0
"""Least speed at the ego's start, m/s."""
BRAKING: Final = 3.0
"""Deceleration of the stop that must end short of the arrival, m/s2, ..."""
MARGIN: Final = 12.0
"""... by this much, m."""
EGO_KIND: Final = "car"
"""The only CommonRoad obstacle type that dosplan's ego, a car, can stand in for."""


@dataclass(frozen=True)
class Track:
    """A road user, or a stretch of one whose track has a gap.

    Attributes:
        name: What the record calls it.
        label: What the record says it is.
        kind: CommonRoad obstacle type.
        size: Length and width, m.
        first: First step of the record.
        states: (K, 4) centre x, y, m, heading, rad, unwrapped, and velocity along it, m/s.
    """

    name: str
    label: str
    kind: str
    size: tuple[float, float]
    first: int
    states: FloatArray

    @property
    def last(self) -> int:
        """Last step."""
        return self.first + len(self.states) - 1

    def window(self, first: int, last: int) -> FloatArray:
        """States at the steps from ``first`` to ``last``, both of which it must cover."""
        return self.states[first - self.first : last - self.first + 1]


@dataclass(frozen=True)
class Moment:
    """A vehicle and a stretch of its drive that make a planning problem.

    Attributes:
        ego: The vehicle that is taken out.
        dt: Step of the record, s.
        first: Step of the record that becomes step 0.
        start: Step of the record at which the ego starts.
        arrival: Step of the record at which its recorded drive ends.
    """

    ego: Track
    dt: float
    first: int
    start: int
    arrival: int

    @property
    def last(self) -> int:
        """Last step of the record that belongs to the scenario."""
        return self.arrival + _steps(SLACK, self.dt)

    @property
    def goal_first(self) -> int:
        """First step of the record at which the goal counts."""
        return self.arrival - _steps(EARLY, self.dt)

    def drive(self) -> FloatArray:
        """(K, 4) states of the recorded drive from start to arrival."""
        return self.ego.window(self.start, self.arrival)


def pieces(tracks: Sequence[Track]) -> Iterator[tuple[int, int, int]]:
    """Cuts a record into pieces that do not overlap.

    Args:
        tracks: Everyone.

    Yields:
        Number from 1 on, first and last step of each piece that holds a road user.
    """
    end = max(track.last for track in tracks)
    for number, first in enumerate(range(0, end + 1, PIECE), start=1):
        last = min(first + PIECE - 1, end)
        if any(present(tracks, first, last)):
            yield number, first, last


def present(
    tracks: Sequence[Track], first: int, last: int
) -> Iterator[tuple[int, Track, int, FloatArray]]:
    """The road users that are in a window at two steps or more.

    Args:
        tracks: Everyone.
        first: First step of the window.
        last: Last step of it.

    Yields:
        Index of each, the track, the first step that lies in the window and the states there.
    """
    for index, track in enumerate(tracks):
        begin, end = max(track.first, first), min(track.last, last)
        if end > begin:
            yield index, track, begin, track.window(begin, end)


def moments(track: Track, dt: float) -> Iterator[Moment]:
    """Stretches of a vehicle's drive that an ego cannot solve by braking, in the order of time.

    Args:
        track: The vehicle, of ``EGO_KIND``.
        dt: Step of the record, s.

    Yields:
        A moment for each start at which the drive is long enough, moves, and goes further than
        braking would.
    """
    least, most = (_steps(count, dt) for count in DRIVE)
    # A whole history, where its first instant lies between two steps, too.
    before = math.ceil((HISTORY_STEPS - 1) * STEP_SECONDS / dt - 1e-6)
    stride = max(_steps(START_STRIDE, dt), 1)
    for start in range(max(track.first, 0), track.last - least + 1, stride):
        arrival = min(start + most, track.last)
        moment = Moment(track, dt, max(start - before, 0), start, arrival)
        if asks_for_driving(moment.drive()):
            yield moment


def _steps(count: int, dt: float) -> int:
    """Steps of ``dt`` that last as long as some of 0.1 s."""
    return round(count * STEP_SECONDS / dt)


def asks_for_driving(states: FloatArray) -> bool:
    """Whether a drive moves at its start, and goes further than braking to a stop would.

    Args:
        states: (K + 1, S) states from the start to the recorded arrival, in the order of
            ``USER_X`` to ``USER_VELOCITY``: m, m, rad, m/s.

    Returns:
        Whether a planner that only brakes would miss its end.
    """
    speed = states[0, 3]
    way = float(np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1).sum())
    return bool(speed >= MIN_START_SPEED and way >= speed**2 / (2.0 * BRAKING) + MARGIN)
