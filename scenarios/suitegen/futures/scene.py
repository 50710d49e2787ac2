"""A scene as it was driven: its window, who is near the ego, and the stand-in's drives.

What no road user does is rejected here, and what is of no use as a task.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dosplan.types import FloatArray
from suitegen.commonroad_xml import AT_REST
from suitegen.futures.motion import motions
from suitegen.futures.simulate import RejectedError, Simulated
from suitegen.futures.staging import EGO, PARKED
from suitegen.motion import Motion
from suitegen.roads import Rng
from suitegen.selection import HISTORY, leaps, near, overlapping, spins

LATEST_ARRIVAL = 5
"""Steps at least between the stand-in's arrival and the end of the recording."""


@dataclass(frozen=True)
class Scene:
    """A scene.

    Attributes:
        futures: Motions of each future, by name: of the stand-in and of all who are near it in
            some future. All have the same past.
        resting: Names of parked vehicles that stay where they are in every future.
        drives: (K, 4) states of the stand-in in each future, from its start until it is in the
            goal: centre x, y, m, heading, rad, velocity, m/s.
        first: Step of the simulation that becomes step 0.
        start: Step at which the ego starts.
        last: Last step.
    """

    futures: tuple[Mapping[str, Motion], ...]
    resting: frozenset[str]
    drives: tuple[FloatArray, ...]
    first: int
    start: int
    last: int

    def window(self, motion: Motion) -> tuple[int, FloatArray] | None:
        """First step and states of who is there; None where it never is."""
        begin = max(motion.first, self.first)
        end = min(motion.last, self.first + self.last)
        return (begin - self.first, motion.window(begin, end)) if begin <= end else None


def scene_of(simulated: Simulated, goal_size: tuple[float, float], rng: Rng) -> Scene:
    """Makes a scene of what was driven.

    Args:
        simulated: What was driven.
        goal_size: Length and width of the goal, m.
        rng: Draws the length of the past.

    Returns:
        The scene.

    Raises:
        RejectedError: It is of no use.
    """
    first = simulated.start - int(rng.integers(HISTORY[0], HISTORY[1] + 1))
    if first < 0:
        raise RejectedError("the moment came before there was a past")
    driven = [motions(traces) for traces in simulated.futures]
    kept = {
        name
        for future in driven
        for name, motion in future.items()
        # The stand-in may leave the network once it has been in the goal.
        if name == EGO or near(motion, future[EGO], first, min(future[EGO].last, simulated.last))
    }
    futures = tuple(
        {name: motion for name, motion in future.items() if name in kept} for future in driven
    )
    for future in futures:
        _check(future, first, simulated.last)
    drives = tuple(_drive(future[EGO], simulated, goal_size) for future in futures)
    resting = frozenset(
        name
        for name in kept
        if all(name in f and _rests(f[name], first, simulated.last) for f in futures)
    )
    return Scene(futures, resting, drives, first, simulated.start - first, simulated.last - first)


def _check(future: Mapping[str, Motion], first: int, last: int) -> None:
    """Rejects what no road user does."""
    users = [m for m in future.values() if m.first < last and m.last > first]
    for user in users:
        who = "the stand-in" if user.trace.id == EGO else f"a {user.trace.kind}"
        if leaps(user, first, last):
            raise RejectedError(f"{who} leaps, or brakes as none can")
        if spins(user, first, last):
            raise RejectedError(f"{who} spins")
    pair = overlapping(users, first, last)
    if pair is not None:
        ego = EGO in (pair[0].trace.id, pair[1].trace.id)
        raise RejectedError("the stand-in collides" if ego else "two others overlap")


def _rests(motion: Motion, first: int, last: int) -> bool:
    if motion.trace.kind != PARKED or motion.first > first or motion.last < last:
        return False
    return bool(np.ptp(motion.window(first, last)[:, :2], axis=0).max() < AT_REST)


def _drive(ego: Motion, simulated: Simulated, goal_size: tuple[float, float]) -> FloatArray:
    """States of the stand-in until it is in the goal."""
    last = min(ego.last, simulated.last - LATEST_ARRIVAL)
    states = ego.window(simulated.start, last)
    x, y, heading = simulated.goal
    ahead = np.array([np.cos(heading), np.sin(heading)])
    gap = states[:, :2] - (x, y)
    along, aside = gap @ ahead, gap @ np.array([-ahead[1], ahead[0]])
    inside = (np.abs(along) < 0.5 * goal_size[0]) & (np.abs(aside) < 0.5 * goal_size[1])
    if not inside.any():
        raise RejectedError("the stand-in does not reach the goal in every future")
    if inside[0]:
        raise RejectedError("the ego starts in the goal")
    return states[: int(np.argmax(inside)) + 1]
