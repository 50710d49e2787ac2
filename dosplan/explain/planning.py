"""The planner's reports in the last seconds before an episode was decided."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import shapely

from dosplan.geometry import ellipse_boundary, rectangle_corners
from dosplan.results.drive import Drive
from dosplan.scoring.metrics import SLACK_SEEN
from dosplan.types import USER_HEADING, FloatArray, SolveStatus

WINDOW: Final = 2.0
"""Length of the time that is looked at, s."""

_STATUSES: Final = {status.word: status for status in SolveStatus}
_CORNERS: Final = 32  # Of the polygon in an ellipse.
_STILL: Final = 0.1  # m; a plan that moves less in a step has the heading it had before.


@dataclass(frozen=True)
class PlanningFacts:
    """The planning cycles of the last ``WINDOW`` seconds.

    A planner that optimises says itself by how much its plans enter the sets. Of one that does not,
    it is computed which plans enter the sets that the run keeps: those where, at a kept step, the
    planned rectangle comes nearer to the ellipse than half of the road user's smaller side. That
    much of the road user is there whichever way it points, so each of these does; others may, too.

    Attributes:
        window: Their span, s.
        cycles: Number of cycles.
        slack_cycles: Cycles whose plan enters a set.
        computed: Whether that was computed from plans and sets, since the planner does not say.
        max_slack: Largest slack of a set constraint, in normalised set distance; None where the
            planner does not say.
        slack_since: How long before the end every plan has entered a set, s; None where the last
            one does not.
        max_road_slack: How far a plan leaves the road at most, m; None where the planner does not
            say or the run did not keep it.
        statuses: Number of cycles by what the solver said.
        iterations_max: The most iterations of a cycle; None where there is no solver.
        fallbacks: Number of cycles by the fallback that was driven.
        pressing: Number of cycles by the road user whose set the plan touched, or enters where that
            was computed.
        waiting: Number of cycles by the reason why the ego stopped for a rule, in the planner's
            words; empty where it does not say.
        unreachable: Why no goal could be reached at the last cycle, in the planner's words; None
            where it does not say that.
        unreachable_since: How long before the end it has said so in every cycle, s; None as above.
        decided: Number of cycles by what the planner had decided, in its words; likewise.
    """

    window: float
    cycles: int
    slack_cycles: int
    computed: bool
    max_slack: float | None
    slack_since: float | None
    max_road_slack: float | None
    statuses: dict[str, int]
    iterations_max: int | None
    fallbacks: dict[str, int]
    pressing: dict[int, int]
    waiting: dict[str, int]
    unreachable: str | None
    unreachable_since: float | None
    decided: dict[str, int]

    def lines(self) -> list[str]:
        """How planning went, in plain words."""
        slack = f"none of {self.cycles} plans enters a set"
        if self.slack_cycles:
            slack = f"{self.slack_cycles} of {self.cycles} plans enter a set"
            if self.max_slack is not None:
                slack += f", slack up to {self.max_slack:.2f}"
        if self.slack_since is not None:
            slack += f", all of them since {self.slack_since:.1f} s before the end"
        if self.computed:
            slack += " (computed from the plans and the sets that are kept)"
        driven = ", ".join(f"{name} in {count} cycles" for name, count in self.fallbacks.items())
        out = [
            f"planning, last {self.window:.1f} s: {slack}; {self._road()}",
            f"{self._solver()}; fallback: {driven or 'never'}",
        ]
        if self.pressing:
            users = ", ".join(f"{user} ({count})" for user, count in self.pressing.items())
            verb = "the plan enters" if self.computed else "touched the plan"
            out.append(f"road users whose sets {verb} (cycles): {users}")
        if self.waiting:
            reasons = "; ".join(f"{reason} ({count})" for reason, count in self.waiting.items())
            out.append(f"rules for which the ego stopped (cycles): {reasons}")
        if self.unreachable is not None:
            out.append(
                "the planner says that no goal can be reached, all of the last "
                f"{self.unreachable_since:.1f} s: {self.unreachable}"
            )
        if self.decided:
            decisions = "; ".join(f"{words} ({count})" for words, count in self.decided.items())
            out.append(f"decisions (cycles): {decisions}")
        known = [_STATUSES[word] for word in self.statuses if word in _STATUSES]
        return out + [f"{status.word}: {status.advice}" for status in known if status.failed]

    def _road(self) -> str:
        if self.max_road_slack is not None:
            return f"road slack up to {self.max_road_slack:.2f} m"
        return "the planner reports no road slack" if self.computed else "road slack was not kept"

    def _solver(self) -> str:
        if self.iterations_max is None:
            return "no solver: the planner does not optimise"
        said = ", ".join(f"{word} {count}" for word, count in self.statuses.items())
        return f"solver: {said}; at most {self.iterations_max} iterations"


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
    waits = [recording.waits_for[i] for i in chosen] if recording.waits_for else []
    decisions = [recording.decisions[i] for i in chosen] if recording.decisions else []
    words = [recording.status[i] for i in chosen]
    computed = all(word == SolveStatus.NOT_OPTIMISED.word for word in words)
    if computed:
        touched = [_entered(drive, int(cycle)) for cycle in chosen]
        entering = [bool(users) for users in touched]
    else:
        touched = [recording.active_ids[i] for i in chosen]
        entering = [bool(recording.slack[i] > SLACK_SEEN) for i in chosen]
    unbroken = sum(1 for _ in takewhile(bool, entering[::-1]))
    road_slack = recording.road_slack[chosen]
    given_up = recording.unreachable[: int(chosen[-1]) + 1]
    lost = sum(1 for _ in takewhile(bool, given_up[::-1]))
    return PlanningFacts(
        window=(end - int(steps[chosen[0]])) * dt,
        cycles=len(chosen),
        slack_cycles=sum(entering),
        computed=computed,
        max_slack=None if computed else float(recording.slack[chosen].max()),
        slack_since=(end - int(steps[chosen[-unbroken]])) * dt if unbroken else None,
        max_road_slack=None
        if computed or not np.isfinite(road_slack).all()
        else float(road_slack.max()),
        statuses=dict(Counter(words).most_common()),
        iterations_max=None if computed else int(recording.iterations[chosen].max()),
        fallbacks=dict(
            Counter(name for i in chosen if (name := recording.fallback[i])).most_common()
        ),
        pressing=dict(Counter(user for users in touched for user in users).most_common()),
        waiting=dict(Counter(reason for reason in waits if reason).most_common()),
        unreachable=given_up[-1] if lost else None,
        unreachable_since=(end - int(steps[chosen[-1] + 1 - lost])) * dt if lost else None,
        decided=dict(Counter(words for words in decisions if words).most_common()),
    )


def _entered(drive: Drive, cycle: int) -> tuple[int, ...]:
    """Ids of the road users whose kept sets the plan of a cycle surely enters."""
    recording = drive.recording
    poses = _planned_poses(drive, cycle)
    columns = np.nonzero(recording.set_offsets < len(poses))[0]
    offsets = recording.set_offsets[columns]
    bodies = shapely.polygons(rectangle_corners(poses[offsets], drive.vehicle.size))
    tracks = drive.tracks
    sizes = dict(zip(tracks.ids.tolist(), tracks.size.min(axis=-1).tolist(), strict=True))
    found = []
    for row in np.nonzero(recording.set_cycle == cycle)[0]:
        user = int(recording.set_ids[row])
        sets = _ellipses(
            recording.set_centres[row, columns],
            recording.set_semi_axes[row, columns],
            recording.set_angles[row, columns],
        )
        here = np.isfinite(recording.set_centres[row, columns]).all(axis=-1)
        if np.any(shapely.distance(bodies[here], sets[here]) < 0.5 * sizes.get(user, 0.0)):
            found.append(user)
    return tuple(dict.fromkeys(found))  # A set that is a union has several rows.


def _planned_poses(drive: Drive, cycle: int) -> FloatArray:
    """(T + 1, 3) planned x, y and heading of the ego's centre, the heading that of the way."""
    centres = drive.recording.plan_centres[cycle]
    centres = centres[np.isfinite(centres).all(axis=-1)]
    heading = float(drive.ego[drive.recording.cycle_steps[cycle] - drive.start, USER_HEADING])
    headings = [heading]
    for way in np.diff(centres, axis=0):
        if np.hypot(*way) > _STILL:
            heading = float(np.arctan2(way[1], way[0]))
        headings.append(heading)
    return np.column_stack([centres, headings])


def _ellipses(centres: FloatArray, semi_axes: FloatArray, angles: FloatArray) -> npt.NDArray[Any]:
    """(S,) ellipses as polygons within them; points where they have no extent."""
    shown = np.nan_to_num(ellipse_boundary(centres, semi_axes, angles, _CORNERS))
    return np.asarray(shapely.convex_hull(shapely.multipoints(shown)))
