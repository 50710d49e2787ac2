"""A goal that was missed: which of its conditions failed, and by how much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import to_body
from dosplan.geometry.goal import TOLERANCE, GoalMiss, goal_miss
from dosplan.results.drive import Drive
from dosplan.scoring.progress import MAKING_PROGRESS, needed_progress
from dosplan.types import USER_HEADING, USER_VELOCITY, FloatArray, GoalState

_DEGREE: Final = np.pi / 180.0
_STANDSTILL: Final = 0.01  # Whoever moves less from a step to the end stood there, m.
_PLACES: Final = {
    "ahead": "it lay ahead",
    "left": "the ego passed beside it, which lay to the left",
    "right": "the ego passed beside it, which lay to the right",
    "behind": "it lay behind",
}


@dataclass(frozen=True)
class GoalFacts:
    """One of the alternative goals at the step of the drive that came nearest to it.

    Nearest is by the distance to its region, then by the time outside its window, then by how far
    heading and velocity are off together, a degree counting as much as 0.1 m/s. Where the ego stood
    outside the region from then until the end, it is the last step.

    Attributes:
        goal: Which of the alternatives, from 1.
        failed: The conditions that failed there: ``position``, or ``time``, or ``heading`` and
            ``velocity``; the later ones are checked where the earlier hold. ``progress`` where all
            of them hold: the goal is a time alone, and the ego has hardly moved.
        seconds: Time of that step since the start, s.
        at_end: Whether it is the last step of the drive.
        distance: From the ego's centre to the region, m.
        side: Where the region is, as the ego sees it there: ``ahead``, ``left``, ``right`` or
            ``behind``; None where the ego is in it.
        late: Seconds after the goal's window; negative before it.
        heading_off: Turn beyond the heading's interval, rad, counter-clockwise positive.
        velocity: Of the ego, m/s.
        velocity_off: Beyond the velocity's interval, m/s; negative where too slow.
        window: First and last time at which the goal counts, s since the start.
        velocity_window: m/s, or None where the goal sets none.
        progress: Distance driven along the reference path, m.
        expected_progress: What is expected of that, m.
    """

    goal: int
    failed: tuple[str, ...]
    seconds: float
    at_end: bool
    distance: float
    side: str | None
    late: float
    heading_off: float
    velocity: float
    velocity_off: float
    window: tuple[float, float]
    velocity_window: tuple[float, float] | None
    progress: float
    expected_progress: float

    def lines(self) -> list[str]:
        """What failed, in plain words."""
        texts = {
            "position": self._position,
            "time": self._time,
            "heading": self._heading,
            "velocity": self._velocity,
            "progress": self._progress,
        }
        return [f"goal {self.goal}: {texts[name]()}" for name in self.failed]

    def _position(self) -> str:
        when = ", at the last step" if self.at_end else ""
        where = _PLACES.get(self.side or "", "the ego was in it")
        if self.side == "ahead" and self.at_end:
            where = "it still lay ahead: the ego would have come too late"
        elif self.side in ("left", "right") and self.at_end:
            where = f"it still lay to the {self.side} when the drive ended"
        return (
            f"position never reached: closest {self.distance:.2f} m, {self.seconds:.1f} s after "
            f"the start{when}, driving {self.velocity:.1f} m/s; {where}"
        )

    def _time(self) -> str:
        first, last = self.window
        side = "late" if self.late > 0.0 else "early"
        meant = "" if self.late > 0.0 else " (driving through it before that is a miss)"
        return (
            f"in place {self.seconds:.1f} s after the start at best, {abs(self.late):.1f} s too "
            f"{side}: it counts from {first:.1f} s to {last:.1f} s{meant}"
        )

    def _heading(self) -> str:
        side = "left" if self.heading_off > 0.0 else "right"
        return (
            f"in place and time, but the heading is {abs(self.heading_off) / _DEGREE:.1f} degrees "
            f"too far to the {side} at best, {self.seconds:.1f} s after the start"
        )

    def _velocity(self) -> str:
        side = "fast" if self.velocity_off > 0.0 else "slow"
        low, high = self.velocity_window or (-np.inf, np.inf)
        return (
            f"in place and time, but {abs(self.velocity_off):.2f} m/s too {side} at best: "
            f"{self.velocity:.2f} m/s, wanted {low:.2f} to {high:.2f}, {self.seconds:.1f} s after "
            "the start"
        )

    def _progress(self) -> str:
        least = MAKING_PROGRESS * self.expected_progress
        return (
            f"a time alone, which standing still does not reach: {self.progress:.1f} m along the "
            f"route until then, at least {least:.1f} m of the {self.expected_progress:.1f} m that "
            "are expected count as progress"
        )


def goal_facts(drive: Drive) -> tuple[GoalFacts, ...]:
    """Measures by how much each alternative goal was missed.

    Args:
        drive: A drive that reached none.

    Returns:
        The facts of each goal.
    """
    goals = enumerate(drive.scenario.task.goals, start=1)
    return tuple(_facts(drive, number, goal) for number, goal in goals)


def _facts(drive: Drive, number: int, goal: GoalState) -> GoalFacts:
    dt, ego = drive.scenario.dt, drive.ego
    misses = [
        goal_miss(goal, step, row[:2], float(row[USER_HEADING]), float(row[USER_VELOCITY]))
        for step, row in enumerate(ego, drive.start)
    ]
    best = min(range(len(misses)), key=lambda i: _rank(misses[i]))
    moved = np.hypot(*(ego[best:, :2] - ego[best, :2]).T)
    if misses[best].distance > TOLERANCE and moved.max() < _STANDSTILL:
        best = len(ego) - 1
    miss = misses[best]
    return GoalFacts(
        goal=number,
        failed=_failed(miss),
        seconds=best * dt,
        at_end=best == len(ego) - 1,
        distance=miss.distance,
        side=_side(goal, ego[best]),
        late=miss.steps * dt,
        heading_off=miss.heading,
        velocity=float(ego[best, USER_VELOCITY]),
        velocity_off=miss.velocity,
        window=(drive.seconds(goal.first_step), drive.seconds(goal.last_step)),
        velocity_window=goal.velocity,
        progress=drive.row.progress,
        expected_progress=needed_progress(drive.scenario, drive.tracks, drive.signals),
    )


def _side(goal: GoalState, row: FloatArray) -> str | None:
    """On which side of the ego the nearest point of a goal's region is."""
    if goal.region is None:
        return None
    near = shapely.shortest_line(shapely.Point(row[:2]), goal.region)
    if shapely.length(near) <= TOLERANCE:
        return None
    x, y = to_body(shapely.get_coordinates(near)[1:], row[:3])[0]
    if abs(y) > abs(x):
        return "left" if y > 0.0 else "right"
    return "ahead" if x > 0.0 else "behind"


def _rank(miss: GoalMiss) -> tuple[float, int, float]:
    off = abs(miss.heading) / _DEGREE + 10.0 * abs(miss.velocity)
    return miss.distance if miss.distance > TOLERANCE else 0.0, abs(miss.steps), off


def _failed(miss: GoalMiss) -> tuple[str, ...]:
    if miss.distance > TOLERANCE:
        return ("position",)
    if miss.steps:
        return ("time",)
    parts = {"heading": miss.heading, "velocity": miss.velocity}
    return tuple(name for name, off in parts.items() if abs(off) > TOLERANCE) or ("progress",)
