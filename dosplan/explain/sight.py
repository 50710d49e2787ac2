"""How late the ego saw a road user, in a loop in which it does not see all at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dosplan.results.drive import Drive


@dataclass(frozen=True)
class SightFacts:
    """What the ego had seen of a road user before a step, by the plans that were driven until then.

    Attributes:
        first: How long before the step a driven plan's observation had it first, s; None where
            none did.
        unseen: How long it had been on the scene by then, s, since the ego's start at most; up to
            the step where it was never seen.
        age: How long before the step was seen what the last of these plans was made from, s.
        known: Whether that plan knew of it.
        error: How far from its true place the ego took it to be in that plan's observation, m;
            None where it did not know of it.
    """

    first: float | None
    unseen: float
    age: float
    known: bool
    error: float | None

    def lines(self) -> list[str]:
        """The facts in plain words."""
        if self.first is None:
            return [
                f"the ego never saw it, in the {self.unseen:.1f} s for which it was on the scene: "
                "no plan that was driven knew of it"
            ]
        late = "as soon as it was on the scene"
        if self.unseen > 0.0:
            late = f"{self.unseen:.1f} s after it had come onto the scene"
        known = "did not know of it any more"
        if self.error is not None:
            known = f"took it to be {self.error:.1f} m off its place then"
        return [
            f"the ego saw it first {self.first:.1f} s before, {late}",
            f"the plan that was driven last was made from what was seen {self.age:.1f} s before, "
            f"and {known}",
        ]


def sight_facts(drive: Drive, user: int, step: int, on_scene: int) -> SightFacts | None:
    """Finds out since when the ego knew of a road user.

    Args:
        drive: The drive.
        user: Row of the road user in the drive's tracks.
        step: Step up to which it is asked.
        on_scene: Step since which it has been on the scene.

    Returns:
        The facts; None where the ego saw everybody at once, or nothing was planned.
    """
    recording, tracks, dt = drive.recording, drive.tracks, drive.scenario.dt
    seen = recording.sightings
    driven = np.flatnonzero(recording.cycle_steps < step)
    if seen is None or not len(driven):
        return None
    of_user = seen.ids == tracks.ids[user]
    cycles = np.intersect1d(seen.cycle[of_user], driven)
    last = int(driven[-1])
    seen_last = int(seen.steps[last])
    known, error = bool(last in cycles), None
    if known:
        place = seen.states[of_user & (seen.cycle == last)][0, :2]
        error = float(np.hypot(*(place - tracks.states[user, seen_last, :2])))
    first = int(seen.steps[cycles[0]]) if len(cycles) else None
    return SightFacts(
        first=None if first is None else (step - first) * dt,
        unseen=max((step if first is None else first) - on_scene, 0) * dt,
        age=(step - seen_last) * dt,
        known=known,
        error=error,
    )
