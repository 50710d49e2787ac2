"""From a record to the episodes that planners drive, whatever the record was read from.

A car of the record becomes the ego: its own track is left out, and what planners are asked for is
to get where it got. The first moment of its drive is taken at which braking would not do and at
which the recorded drive itself succeeds under dosplan's scoring.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from dosplan.convert.windows import Moment, Track, moments
from dosplan.scenario import ScenarioError, ScenarioRef, parse_scenario
from dosplan.scenario.commonroad.drafts import Goal, ProblemDraft
from dosplan.scenario.commonroad.obstacles import Resampling
from dosplan.scenario.commonroad.writer import compress
from dosplan.scoring.score import score
from dosplan.simulation.loop import known_drive
from dosplan.system.files import write_bytes
from dosplan.types import Arm, FloatArray, Outcome

RECORDINGS: Final = "recordings"
"""Folder for what predictors are trained and evaluated on."""
SCENARIOS: Final = "scenarios"
"""Folder for what planners drive."""
GOAL_WIDTH: Final = 3.4
"""Width of the goal, m: about a lane's."""
UNUSABLE: Final = "unusable"
"""Reason for moments that dosplan cannot read, such as one far off the road."""


def find_episode(
    track: Track, dt: float, xml: Callable[[Moment], bytes], refused: Counter[str]
) -> bytes | None:
    """The scenario file in which a car of a record is the ego.

    Args:
        track: The car.
        dt: Step of the record, s.
        xml: The file of a moment, without the car.
        refused: Counts the moments that make no scenario by the reason; added to.

    Returns:
        The file; None where no moment makes one.
    """
    for moment in moments(track, dt):
        made = xml(moment)
        objection = _objection(made, moment)
        if objection is None:
            return made
        refused[objection] += 1
    return None


def problem_of(moment: Moment) -> ProblemDraft:
    """The planning problem of a moment: to be where the car was when its drive ended.

    Args:
        moment: The moment.

    Returns:
        The problem, in steps from the first of the moment on.
    """
    drive = moment.drive()
    return ProblemDraft(
        drive=drive,
        start=moment.start - moment.first,
        goal_first=moment.goal_first - moment.first,
        goal_last=moment.last - moment.first,
        goal=Goal(max(10.0, 0.8 * float(drive[-1, 3])), GOAL_WIDTH, None, None),
    )


def write(folder: Path, name: str, xml: bytes) -> None:
    """Writes a file, compressed.

    Args:
        folder: Where.
        name: Its name without the ending.
        xml: What it holds.

    Raises:
        FileError: It cannot be written.
    """
    write_bytes(folder / f"{name}.xml.gz", compress(xml))


def _objection(xml: bytes, moment: Moment) -> str | None:
    """Why a moment makes no scenario: the recorded drive must succeed under dosplan's scoring."""
    try:
        scenario = parse_scenario(ScenarioRef(Path("episode.xml"), ""), xml)
    except ScenarioError:
        return UNUSABLE
    vehicle = scenario.task.vehicle
    states = np.array([vehicle.state_at(row[:2], row[2], row[3]) for row in _driven(moment)])
    driven = score(
        scenario, known_drive(scenario, Arm.WITHOUT_DOS, scenario.task.start_step, states)
    )
    return None if driven.outcome is Outcome.SUCCESS else driven.outcome.value


def _driven(moment: Moment) -> FloatArray:
    """(K, 4) states of the recorded drive, every 0.1 s from the start on."""
    drive = moment.drive()
    states, _ = Resampling.of(moment.dt).tracks(drive[None], np.ones((1, len(drive)), dtype=bool))
    return np.asarray(states[0])
