"""What a film is made of: episodes of a run, a drive made for it, or the recording alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import shapely

from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.report.palette import ARM_COLOURS, EGO_COLOUR, INK
from dosplan.results.drive import Drive, find_drives
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, read_manifest
from dosplan.results.markdown import ARM_TITLES, ARMS_SIDE_BY_SIDE
from dosplan.scenario import ScenarioRef, has_problem, load_recording, load_scenario
from dosplan.simulation.loop import run_episode
from dosplan.system.files import FileError
from dosplan.types import (
    EGO_VELOCITY,
    STEP_SECONDS,
    Arm,
    FloatArray,
    Scenario,
    ScenarioFuture,
    Score,
    Signals,
    Tracks,
)

_DOT: Final = "  \N{MIDDLE DOT}  "


@dataclass(frozen=True)
class Take:
    """The content of a panel.

    Attributes:
        name: Its heading.
        colour: Colour of the ego.
        scenario: The scene.
        row: The row, or None where nothing was driven: the ego stands at its start.
        drive: The drive, or None where there is none.
        has_task: Whether there is anything to drive; False for a map or a recording alone, which
            has no ego, no route and no goal.
    """

    name: str
    colour: str
    scenario: Scenario
    row: Score | None = None
    drive: Drive | None = None
    has_task: bool = True

    @property
    def in_view(self) -> FloatArray:
        """(M, 2) points that the picture has to show, m."""
        if not self.has_task:
            users = self.tracks.states[self.tracks.valid][:, :2]
            return users if len(users) else _corners(self.scenario.road_map.drivable)
        ego = self.ego[:, :2]
        if self.row is not None:
            return ego
        goals = [_corners(goal.region) for goal in self.scenario.task.goals if goal.region]
        return np.concatenate([ego, *goals])

    @property
    def tracks(self) -> Tracks:
        """The road users: as they were driven, or as recorded where nothing was driven."""
        return self.scenario.tracks if self.drive is None else self.drive.tracks

    @property
    def signals(self) -> Signals:
        """The traffic lights: as they were in the drive, else as recorded."""
        return self.scenario.signals if self.drive is None else self.drive.signals

    @property
    def start(self) -> int:
        """Step of the first picture."""
        return self.scenario.task.start_step

    @property
    def end(self) -> int:
        """Step of the last picture: the end of the drive, or else of the task."""
        if self.drive is not None:
            return self.start + self.drive.row.steps
        task, recorded = self.scenario.task, self.tracks.steps - 1
        if self.row is not None:
            return self.start
        return max(self.start, min(task.final_step, recorded))

    @property
    def moment(self) -> int:
        """Step that decided the outcome; the first one where nothing was driven."""
        return self.start if self.drive is None else self.drive.decisive_step

    @property
    def ego(self) -> FloatArray:
        """(K + 1, 4) x, y, m, heading, rad, and velocity, m/s, of the ego's centre."""
        if self.drive is not None:
            return self.drive.ego
        start = self.scenario.task.start[None]
        return np.column_stack([self.scenario.task.vehicle.poses(start), start[:, EGO_VELOCITY]])

    @property
    def verdict(self) -> str:
        """The outcome in words; empty where nothing was driven."""
        if self.row is None:
            return ""
        words = self.row.outcome.value.replace("_", " ")
        if self.drive is None:
            return words
        if (contact := self.drive.contact) is not None:
            tracks = self.tracks
            words = f"{words} with {tracks.kinds[contact.user]} {tracks.ids[contact.user]}"
        return f"{words}, {self.seconds(self.moment):.1f} s"

    @property
    def place(self) -> FloatArray:
        """(2,) where the outcome was decided, m: the contact of a collision, else the ego."""
        if self.drive is not None:
            return self.drive.place
        return np.asarray(self.ego[0, :2])

    def seconds(self, step: int) -> float:
        """Time of a step since the start, s."""
        return (step - self.start) * STEP_SECONDS


Takes = tuple[list[Take], str]
"""The takes, and a line that says what they are."""


def takes_of_run(
    run: Path, scenario: str, arms: Sequence[Arm], source: str | None, future: int = 0
) -> Takes:
    """The episodes of a scenario in a run.

    Args:
        run: The run folder.
        scenario: Id of the scenario.
        arms: Arms that are wanted; those that the run does not drive are left out.
        source: Where the scenarios lie now; where the run found them if None.
        future: The continuation of its past that is wanted.

    Returns:
        A take for each arm.

    Raises:
        FileError: The folder holds no such episode, or none that ever drove, or its scenario
            cannot be found or read, or it is not the one that was driven.
    """
    found = find_drives(run, scenario, arms, source, future)
    scene = next((drive.scenario for _, drive in found if drive is not None), None)
    if scene is None:
        raise FileError(f"nothing was driven of {scenario} in {run}: {found[0][0].error}")
    takes = {row.arm: _take(scene, row, drive) for row, drive in found}
    manifest = read_manifest(RunFolder(run))
    title = _title(ScenarioFuture(scenario, future).title, manifest.planner, manifest.predictor)
    if manifest.loop != RunManifest.loop:
        title += f"{_DOT}loop {manifest.loop}"
    return [takes[arm] for arm in ARMS_SIDE_BY_SIDE if arm in takes], title


def takes_of_drive(
    ref: ScenarioRef, planner: str, predictor: str, arms: Sequence[Arm], seed: int
) -> Takes:
    """Drives a scenario, in this process.

    Args:
        ref: The scenario.
        planner: Planner, as ``dosplan.plugins.registry`` finds it.
        predictor: Predictor, likewise.
        arms: Arms to drive.
        seed: Seed of everything random.

    Returns:
        A take for each arm.

    Raises:
        RegistryError: There is no such plug-in.
        ScenarioError: The scenario cannot be read.
    """
    driver, prediction = create_planner(planner, seed), create_predictor(predictor, seed)
    scenario = load_scenario(ref)
    takes = []
    for arm in (arm for arm in ARMS_SIDE_BY_SIDE if arm in arms):
        drive = Drive.of(scenario, run_episode(scenario, driver, prediction, arm))
        takes.append(_take(scenario, drive.row, drive))
    return takes, _title(ref.id, driver.name, prediction.name)


def takes_of_scenario(ref: ScenarioRef) -> Takes:
    """The recorded traffic, with the ego at its start where the file has a planning problem.

    Args:
        ref: The scenario.

    Returns:
        One take.

    Raises:
        ScenarioError: The scenario cannot be read.
    """
    has_task = has_problem(ref)
    scenario = load_scenario(ref) if has_task else load_recording(ref)
    name = "recorded traffic" if len(scenario.tracks.ids) else "nobody else on the road"
    colour = EGO_COLOUR if has_task else INK
    if not has_task and not len(scenario.tracks.ids):
        name = "map"
    return [Take(name, colour, scenario, has_task=has_task)], ref.id


def _corners(area: shapely.Geometry) -> FloatArray:
    """(2, 2) lower left and upper right corner of the box around an area, m."""
    return np.reshape(area.bounds, (2, 2))


def _take(scenario: Scenario, row: Score, drive: Drive | None) -> Take:
    return Take(ARM_TITLES[row.arm], ARM_COLOURS[row.arm], scenario, row, drive)


def _title(scenario: str, planner: str, predictor: str) -> str:
    return f"{scenario}{_DOT}{planner} with {predictor}"
