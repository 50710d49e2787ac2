"""Reads an episode of a run folder and puts together why it ended as it did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dosplan.explain.collision import CollisionFacts, collision_facts
from dosplan.explain.goal import GoalFacts, goal_facts
from dosplan.explain.lights import LightFacts, light_facts
from dosplan.explain.margins import Margins, margins
from dosplan.explain.planning import PlanningFacts, planning_facts
from dosplan.explain.road import RoadFacts, road_facts
from dosplan.results.drive import Drive, find_drives
from dosplan.results.folder import RunFolder
from dosplan.types import Arm, EpisodeKey, Outcome, Score

MOST_NOTES: Final = 5
"""Notes of one scenario that are shown; a map may have one for every lanelet."""


@dataclass(frozen=True)
class Explanation:
    """Why one episode ended as it did; what does not belong to its outcome is None or empty.

    Attributes:
        scenario: Id of the scenario.
        arm: The arm.
        future: Which continuation of the scenario's past.
        outcome: Its outcome.
        step: The step that decided it; None where the episode never began.
        seconds: That step since the start, s.
        min_time_to_collision: The row's, s.
        collision: The collision.
        out_of_bounds: Where the ego left the road, also before a collision.
        goals: How each alternative goal was missed.
        lights: The traffic lights that the ego waited for, and those that it ran.
        margins: What was left in a success.
        planning: The planner's last cycles before that step.
        error: What went wrong in a failure, or why the scenario is unusable.
        traceback: File of the traceback, relative to the run folder.
        notes: What reading the scenario file left out or corrected, a line each.
    """

    scenario: str
    arm: Arm
    future: int
    outcome: Outcome
    step: int | None = None
    seconds: float | None = None
    min_time_to_collision: float | None = None
    collision: CollisionFacts | None = None
    out_of_bounds: RoadFacts | None = None
    goals: tuple[GoalFacts, ...] = ()
    lights: LightFacts | None = None
    margins: Margins | None = None
    planning: PlanningFacts | None = None
    error: str | None = None
    traceback: str | None = None
    notes: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """The explanation in plain words: a heading, then indented lines."""
        unusable = self.outcome is Outcome.UNUSABLE
        when = "for everybody, so not driven" if unusable else "before the first step"
        if self.step is not None:
            when = f"at step {self.step}, {self.seconds:.1f} s after the start"
        body = [] if self.error is None else [self.error]
        if self.traceback is not None:
            body.append(f"the traceback is in {self.traceback}")
        parts = (self.collision, self.out_of_bounds, self.lights, *self.goals, self.margins)
        for part in (*parts, self.planning):
            body += [] if part is None else part.lines()
        if self.min_time_to_collision is not None:
            body.append(f"smallest time to collision: {self.min_time_to_collision:.2f} s")
        body += [f"the scenario file: {note}" for note in shown_notes(self.notes)]
        key = EpisodeKey(self.scenario, self.arm, self.future)
        title = f"{key.title}: {self.outcome} {when}"
        return [title, *(f"  {line}" for line in body)]


def explain(
    path: Path,
    scenario: str,
    arms: Sequence[Arm] = tuple(Arm),
    source: str | None = None,
    future: int | None = None,
) -> list[Explanation]:
    """Explains the episodes of a scenario in a run; the run may still be going on.

    Args:
        path: The run folder.
        scenario: Id of the scenario.
        arms: Arms that are wanted; those that the run does not drive are left out.
        source: Where the scenarios lie now; where the run found them if None.
        future: The continuation of its past that is wanted; all of them if None.

    Returns:
        One explanation for each arm and future.

    Raises:
        FileError: The folder holds no such episode, or its scenario cannot be found or read, or
            it is not the one that was driven.
    """
    folder = RunFolder(path)
    return [
        _failure(folder, row) if drive is None else explain_drive(drive, _traceback(folder, row))
        for row, drive in find_drives(path, scenario, arms, source, future)
    ]


def explain_drive(drive: Drive, traceback: str | None = None) -> Explanation:
    """Explains a drive.

    Args:
        drive: The drive, with its scenario.
        traceback: File of its traceback, where it has one.

    Returns:
        The explanation.

    Raises:
        FileError: The drive does not fit its row.
    """
    row = drive.row
    contact, off_road, reached = drive.contact, row.out_of_bounds_step, row.goal_step
    return Explanation(
        **row.key._asdict(),
        outcome=row.outcome,
        step=drive.decisive_step,
        seconds=drive.seconds(drive.decisive_step),
        min_time_to_collision=row.min_time_to_collision,
        collision=None if contact is None else collision_facts(drive, contact),
        out_of_bounds=None if off_road is None else road_facts(drive, off_road),
        goals=goal_facts(drive) if row.outcome is Outcome.GOAL_MISSED else (),
        lights=light_facts(drive),
        margins=margins(drive, reached)
        if row.outcome is Outcome.SUCCESS and reached is not None
        else None,
        planning=planning_facts(drive),
        error=row.error,
        traceback=traceback,
        notes=drive.scenario.notes,
    )


def shown_notes(notes: tuple[str, ...]) -> tuple[str, ...]:
    """The first notes of a scenario, as they are shown to people.

    Args:
        notes: ``Scenario.notes``.

    Returns:
        ``MOST_NOTES`` at most, and a line that counts the rest.
    """
    rest = len(notes) - MOST_NOTES
    return notes if rest <= 0 else (*notes[:MOST_NOTES], f"{rest} more notes")


def _failure(folder: RunFolder, row: Score) -> Explanation:
    return Explanation(
        **row.key._asdict(),
        outcome=row.outcome,
        error=row.error,
        traceback=_traceback(folder, row),
    )


def _traceback(folder: RunFolder, row: Score) -> str | None:
    path = folder.traceback(row.key)
    return path.relative_to(folder.path).as_posix() if path.exists() else None
