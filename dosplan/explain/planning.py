"""The planner's reports in the last seconds before an episode was decided."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

import numpy as np

from dosplan.results.drive import Drive
from dosplan.scoring.metrics import SLACK_SEEN
from dosplan.types import SolveStatus

WINDOW: Final = 2.0
"""Length of the time that is summed up, s."""

_STATUSES: Final = {status.word: status for status in SolveStatus}


@dataclass(frozen=True)
class PlanningFacts:
    """The planning cycles of the last ``WINDOW`` seconds.

    Attributes:
        window: Their span, s.
        cycles: Number of cycles.
        slack_cycles: Cycles whose plan enters a set.
        max_slack: Largest slack of a set constraint, in normalised set distance.
        slack_since: How long before the end every plan has entered a set, s; None where the last
            one does not.
        max_road_slack: How far a plan leaves the road at most, m; None where the run did not keep
            it.
        statuses: Number of cycles by what the solver said.
        iterations_max: The most iterations of a cycle.
        fallbacks: Number of cycles by the fallback that was driven.
        pressing: Number of cycles by the road user whose set touched the plan.
    """

    window: float
    cycles: int
    slack_cycles: int
    max_slack: float
    slack_since: float | None
    max_road_slack: float | None
    statuses: dict[str, int]
    iterations_max: int
    fallbacks: dict[str, int]
    pressing: dict[int, int]

    def lines(self) -> list[str]:
        """How planning went, in plain words."""
        slack = f"none of {self.cycles} plans enters a set"
        if self.slack_cycles:
            share = f"{self.slack_cycles} of {self.cycles}"
            slack = f"{share} plans enter a set, slack up to {self.max_slack:.2f}"
        if self.slack_since is not None:
            slack += f", all of them since {self.slack_since:.1f} s before the end"
        road = "road slack was not recorded"
        if self.max_road_slack is not None:
            road = f"road slack up to {self.max_road_slack:.2f} m"
        said = ", ".join(f"{word} {count}" for word, count in self.statuses.items())
        driven = ", ".join(f"{name} in {count} cycles" for name, count in self.fallbacks.items())
        out = [
            f"planning, last {self.window:.1f} s: {slack}; {road}",
            f"solver: {said}; at most {self.iterations_max} iterations; "
            f"fallback: {driven or 'never'}",
        ]
        if self.pressing:
            users = ", ".join(f"{user} ({count})" for user, count in self.pressing.items())
            out.append(f"road users whose sets touched the plan (cycles): {users}")
        known = [_STATUSES[word] for word in self.statuses if word in _STATUSES]
        return out + [f"{status.word}: {status.advice}" for status in known if status.failed]


def planning_facts(drive: Drive) -> PlanningFacts | None:
    """Sums up the planning cycles before the decisive step.

    Args:
        drive: The drive.

    Returns:
        The facts; None where no cycle ran in that time.
    """
    recording, dt, end = drive.recording, drive.scenario.dt, drive.decisive_step
    steps = recording.cycle_steps
    (chosen,) = np.nonzero((steps < end) & (steps >= end - round(WINDOW / dt)))
    if not len(chosen):
        return None
    slack, road_slack = recording.slack[chosen], recording.road_slack[chosen]
    entering = [int(step) for step, s in zip(steps[chosen], slack, strict=True) if s > SLACK_SEEN]
    unbroken = list(takewhile(lambda i: recording.slack[i] > SLACK_SEEN, chosen[::-1]))
    return PlanningFacts(
        window=(end - int(steps[chosen[0]])) * dt,
        cycles=len(chosen),
        slack_cycles=len(entering),
        max_slack=float(slack.max()),
        slack_since=(end - int(steps[unbroken[-1]])) * dt if unbroken else None,
        max_road_slack=float(road_slack.max()) if np.isfinite(road_slack).all() else None,
        statuses=dict(Counter(recording.status[i] for i in chosen).most_common()),
        iterations_max=int(recording.iterations[chosen].max()),
        fallbacks=dict(
            Counter(name for i in chosen if (name := recording.fallback[i])).most_common()
        ),
        pressing=dict(
            Counter(user for i in chosen for user in recording.active_ids[i]).most_common()
        ),
    )
