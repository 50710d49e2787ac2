"""The scenarios of a page: the outcome of each side, its cause, and what the page draws."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from dosplan.explain import shown_notes
from dosplan.explain.goal import goal_facts
from dosplan.report.html.codec import pack
from dosplan.report.html.coverage import Prediction, SetsMet, predictions_of, sets_met
from dosplan.report.html.player import encode_episode
from dosplan.report.html.scenarios import families
from dosplan.report.html.sides import Pairing
from dosplan.report.html.thumbnails import thumbnail
from dosplan.results.drive import Drive
from dosplan.results.recording import Recording
from dosplan.system.files import FileError
from dosplan.types import (
    STEP_SECONDS,
    CollisionClass,
    FloatArray,
    Outcome,
    Scenario,
    ScenarioFuture,
    Score,
)

OUTCOME_WORDS: Final = {
    Outcome.SUCCESS: "success",
    Outcome.GOAL_MISSED: "goal missed",
    Outcome.OUT_OF_BOUNDS: "out of bounds",
    Outcome.COLLISION: "collision",
    Outcome.PLANNER_FAILURE: "planner failure",
    Outcome.TRAFFIC_FAILURE: "traffic failure",
}
"""The outcomes, best first."""

FASTER: Final = 0.5
"""Mean velocities that differ by so much, m/s, make a drive faster or slower."""

MOST_EXAMINED: Final = 500
"""Recordings of so many scenarios are read for one page: those that differ or failed come first."""

_CLASS_WORDS: Final = {
    CollisionClass.STOPPED_EGO: "{} hit the standing ego",
    CollisionClass.STOPPED_TRACK: "ran into {}, which stood",
    CollisionClass.ACTIVE_REAR: "{} ran into the ego from behind",
    CollisionClass.ACTIVE_FRONT: "ran into {}",
    CollisionClass.ACTIVE_LATERAL: "touched {} at the side",
}
_LOOK_BACK: Final = (1.0, 2.0)  # s before a contact.


@dataclass(frozen=True)
class Case:
    """A scenario, in one of its futures, with the results of each side.

    Attributes:
        driven: Its id and the future.
        family: Where it comes from.
        kind: What happens in it, or its kind of road.
        rows: The row of each side.
        why: For each side, the cause of the outcome.
        met: The sets that each side met, or None where that is not known.
        cycle_ms: Times of the planning cycles of each side, ms.
        thumbnail: See ``dosplan.report.html.thumbnails``.
        notes: What reading the scenario file left out or corrected, as far as it is shown.
        payload: What the player draws, packed; None where there is no recording.
    """

    driven: ScenarioFuture
    family: str
    kind: str
    rows: tuple[Score, ...]
    why: tuple[str, ...]
    met: tuple[SetsMet | None, ...]
    cycle_ms: tuple[FloatArray, ...]
    thumbnail: dict[str, Any]
    notes: tuple[str, ...]
    payload: str | None


def examine(pairing: Pairing) -> Iterator[Case]:
    """Examines all episodes of a pairing, those that differ first, then those that failed.

    Args:
        pairing: What is set beside what.

    Yields:
        A case each; at most ``MOST_EXAMINED`` with what recordings and scenario files tell.
    """
    family = families(list(dict.fromkeys(one.scenario for one in pairing.driven)))
    ranked = sorted(pairing.driven, key=lambda one: _urgency(_rows(pairing, one)))  # Stable.
    for index, driven in enumerate(ranked):
        yield _case(pairing, driven, family[driven.scenario], index < MOST_EXAMINED)


def change_of(rows: Sequence[Score]) -> str:
    """Says in a word how the outcomes of a scenario differ.

    Args:
        rows: The row of each of two sides, or of the only one.

    Returns:
        What the second one changed: ``fixed``, ``broken``, ``both failed``, ``both succeeded``; for
        one alone ``failed`` or ``succeeded``. ``static/table.js`` knows the same words.
    """
    reached = [row.outcome is Outcome.SUCCESS for row in rows]
    if len(reached) == 1:
        return "succeeded" if reached[0] else "failed"
    return {
        (False, True): "fixed",
        (True, False): "broken",
        (False, False): "both failed",
        (True, True): "both succeeded",
    }[reached[0], reached[1]]


def _urgency(rows: Sequence[Score]) -> int:
    """Of several sides, those that differ first, then what failed in all of them."""
    reached = [row.outcome is Outcome.SUCCESS for row in rows]
    if all(reached) or not any(reached):
        return 3 if reached[0] else 2
    return 0 if reached[-1] else 1


def _rows(pairing: Pairing, driven: ScenarioFuture) -> tuple[Score, ...]:
    return tuple(side.rows[driven] for side in pairing.sides)


def _case(pairing: Pairing, driven: ScenarioFuture, family: str, examined: bool) -> Case:
    rows, scenario = _rows(pairing, driven), driven.scenario
    recordings = [side.recording(driven) if examined else None for side in pairing.sides]
    scene = pairing.scenes.load(scenario) if examined else None
    if scene is not None and not all(r.is_of(scene) for r in recordings if r is not None):
        scene = None
    drives = [
        None if recording is None else _drive(row, recording, scene)
        for recording, row in zip(recordings, rows, strict=True)
    ]
    met = tuple(None if drive is None else _met(drive) for drive in drives)
    return Case(
        driven=driven,
        family=family,
        kind=pairing.scenes.kind(scenario, scene),
        rows=rows,
        why=tuple(_why(row, one, drive) for row, one, drive in zip(rows, met, drives, strict=True)),
        met=met,
        cycle_ms=tuple(
            np.empty(0) if recording is None else recording.scored_cycle_ms(row.steps)
            for recording, row in zip(recordings, rows, strict=True)
        ),
        thumbnail=thumbnail(scene, drives),
        notes=() if scene is None else shown_notes(scene.notes),
        payload=pack(encode_episode(scene, drives)) if any(drives) else None,
    )


def _drive(row: Score, recording: Recording, scene: Scenario | None) -> Drive | None:
    """The drive; None where row and recording are not of one episode."""
    try:
        return Drive(row, recording, scene)
    except FileError:
        return None


def _met(drive: Drive) -> SetsMet | None:
    tracks = drive.known_tracks
    return None if tracks is None else sets_met(drive.recording, tracks, drive.row.steps)


def _why(row: Score, met: SetsMet | None, drive: Drive | None) -> str:
    """A line on the cause of the outcome, as far as row and recording show it."""
    if row.outcome in (Outcome.PLANNER_FAILURE, Outcome.TRAFFIC_FAILURE):
        return row.error or "no plan and no fallback"
    seconds = None if drive is None else drive.seconds(drive.decisive_step)
    when = "" if seconds is None else f" after {seconds:.1f} s"
    if row.outcome is Outcome.OUT_OF_BOUNDS:
        return f"left the road{when}"
    if row.outcome is Outcome.GOAL_MISSED and drive is not None and drive.scene is not None:
        return _missed(drive)
    if row.outcome is not Outcome.COLLISION or row.collision_with is None:
        return ""
    user = f"road user {row.collision_with}"
    if drive is not None and (tracks := drive.known_tracks) is not None:
        kinds = dict(zip(tracks.ids.tolist(), tracks.kinds, strict=True))
        user = f"{kinds[row.collision_with].value} {row.collision_with}"
    how = "touched {}" if row.collision_class is None else _CLASS_WORDS[row.collision_class]
    fault = "at fault" if row.at_fault else "not at fault"
    said = ""
    if met is not None and row.collision_step is not None:
        said = _said(predictions_of(met, row.collision_with, row.collision_step))
    return f"{how.format(user)}{when}; {fault}{said}"


def _missed(drive: Drive) -> str:
    """By how much the drive missed the goal to which it came nearest."""
    nearest = min(goal_facts(drive), key=lambda facts: (facts.distance, abs(facts.late)))
    return "; ".join(line.partition(": ")[2] for line in nearest.lines())


def _said(predictions: Sequence[Prediction]) -> str:
    """What had been predicted of the road user for the moment of the contact."""
    parts = []
    for prediction in predictions:
        seconds = round(prediction.offset * STEP_SECONDS, 3)
        if seconds in _LOOK_BACK:
            verdict = {True: "set held it, ", False: "set missed it, ", None: ""}[prediction.held]
            parts.append(f"{seconds:g} s before: {verdict}predicted {prediction.miss:.1f} m off")
    return "".join(f"; {part}" for part in parts)
