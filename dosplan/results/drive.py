"""A drive: one episode with its row and the scenario it was driven in, from memory or a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
import shapely

from dosplan.geometry import rectangle_corners
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, read_manifest
from dosplan.results.recording import Recording
from dosplan.results.rows import read_rows
from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios, load_scenario
from dosplan.scenario.sources.catalogue import Source, source_text
from dosplan.scoring.collision import Contact, first_contacts, shape_at
from dosplan.scoring.score import score
from dosplan.system.errors import did_you_mean
from dosplan.system.files import FileError
from dosplan.types import (
    EGO_VELOCITY,
    STEP_SECONDS,
    Arm,
    Episode,
    FloatArray,
    Outcome,
    Scenario,
    Score,
    Signals,
    Tracks,
)
from dosplan.vehicle import VehicleParameters


@dataclass(frozen=True)
class Drive:
    """One episode, as far as it was scored.

    Attributes:
        row: Its row.
        recording: What its file keeps.
        scene: What was driven; None where the scenario file is not there any more.
        whole: The episode; None where the drive was read from a run folder.

    Raises:
        FileError: The episode was not driven in this scenario, or ended before its row says so.
    """

    row: Score
    recording: Recording
    scene: Scenario | None = None
    whole: Episode | None = None

    def __post_init__(self) -> None:
        if self.scene is not None and not self.recording.is_of(self.scene):
            raise FileError(
                f"{self.row.scenario} is not the scenario that the run drove: its ego starts "
                "elsewhere; name the right one with --source"
            )
        recorded = len(self.recording.inputs)
        if not 0 <= self.row.steps <= recorded:
            raise FileError(
                f"the row of {self.row.scenario} counts {self.row.steps} steps, its episode file "
                f"holds {recorded}: one of them is not of this run"
            )

    @classmethod
    def of(cls, scenario: Scenario, episode: Episode) -> Self:
        """Scores an episode that was driven in this process.

        Args:
            scenario: What was driven.
            episode: What happened.

        Returns:
            The drive.
        """
        return cls(score(scenario, episode), Recording.of(scenario, episode), scenario, episode)

    @property
    def scenario(self) -> Scenario:
        """What was driven.

        Raises:
            FileError: The scenario file is not there any more.
        """
        if self.scene is None:
            raise FileError(
                f"the scenario file of {self.row.scenario} was not found; name its place with "
                "--source"
            )
        return self.scene

    @property
    def episode(self) -> Episode:
        """The episode, where it was driven in this process.

        Raises:
            FileError: The drive was read from a run folder, which keeps a part.
        """
        if self.whole is None:
            raise FileError(
                f"a run folder does not keep all that happened in {self.row.scenario}; "
                "what it keeps is in the drive's recording"
            )
        return self.whole

    @property
    def vehicle(self) -> VehicleParameters:
        """The ego; where the scenario is not there, that of every scenario dosplan reads."""
        return VehicleParameters() if self.scene is None else self.scene.task.vehicle

    @property
    def known_tracks(self) -> Tracks | None:
        """The road users as they were driven; None where neither file is there that holds them."""
        recorded = self.recording.tracks
        return recorded if self.scene is None else self.recording.tracks_in(self.scene)

    @property
    def tracks(self) -> Tracks:
        """The road users as they were driven.

        Raises:
            FileError: The scenario file that holds them is not there any more.
        """
        known = self.known_tracks
        return self.scenario.recorded(self.recording.future) if known is None else known

    @property
    def signals(self) -> Signals:
        """The traffic lights as they were, at the steps of the scenario."""
        own = self.recording.signals
        return self.scenario.signals if own is None else own

    @cached_property
    def states(self) -> FloatArray:
        """(K + 1, 5) ego states of the drive that was scored."""
        return self.recording.states[: self.row.steps + 1]

    @cached_property
    def ego(self) -> FloatArray:
        """(K + 1, 4) x, y, heading, velocity of the ego's centre."""
        return np.column_stack([self.vehicle.poses(self.states), self.states[:, EGO_VELOCITY]])

    @property
    def start(self) -> int:
        """Step of the first state."""
        return self.recording.start_step

    @property
    def decisive_step(self) -> int:
        """The step that decided the outcome: of the contact, off the road, or the last one."""
        decided = {
            Outcome.COLLISION: self.row.collision_step,
            Outcome.OUT_OF_BOUNDS: self.row.out_of_bounds_step,
        }.get(self.row.outcome)
        return self.start + self.row.steps if decided is None else decided

    @cached_property
    def contact(self) -> Contact | None:
        """The collision that the row names; None where it names none.

        Raises:
            FileError: The recorded drive does not meet that road user in this scenario.
        """
        step, tracks = self.row.collision_step, self.tracks
        if step is None:
            return None
        for contact in first_contacts(self.ego, self.vehicle.size, tracks, self.start):
            if contact.step == step and int(tracks.ids[contact.user]) == self.row.collision_with:
                return contact
        raise FileError(
            f"the drive that was recorded of {self.row.scenario} does not touch road user "
            f"{self.row.collision_with} at step {step} of the scenario: the file, or dosplan's "
            "scoring, has changed since the run"
        )

    @property
    def place(self) -> FloatArray:
        """(2,) where the outcome was decided, m: the contact of a collision, else the ego.

        Raises:
            FileError: The recorded drive does not meet the road user that the row names.
        """
        pose = self.ego[self.decisive_step - self.start, :3]
        if self.known_tracks is None or (contact := self.contact) is None:
            return np.asarray(pose[:2])
        # Where they are in the picture of that step: a little past the touch, perhaps.
        tracks = self.tracks
        other = shape_at(tracks, contact.user, tracks.states[contact.user, contact.step])
        ego = shapely.Polygon(rectangle_corners(pose, self.vehicle.size))
        common = shapely.intersection(ego, other)
        met = shapely.shortest_line(ego, other) if common.is_empty else common
        return np.asarray(shapely.centroid(met).coords[0])

    def seconds(self, step: int) -> float:
        """Time of a step since the start, s."""
        return (step - self.start) * STEP_SECONDS


def find_drives(
    path: Path,
    scenario: str,
    arms: Sequence[Arm] = tuple(Arm),
    source: str | None = None,
    future: int | None = None,
) -> list[tuple[Score, Drive | None]]:
    """Reads the drives of a scenario in a run; the run may still be going on.

    Args:
        path: The run folder.
        scenario: Id of the scenario.
        arms: Arms that are wanted; those that the run does not drive are left out.
        source: Where the scenarios lie now; where the run found them if None.
        future: The continuation of its past that is wanted; all of them if None.

    Returns:
        The row of each arm and future with its drive; None where the episode failed before it
        began.

    Raises:
        FileError: The folder holds no such episode, or its scenario cannot be found or read, or
            is not the one that was driven.
    """
    folder = RunFolder(path)
    manifest = read_manifest(folder)
    if scenario not in manifest.scenarios:
        raise FileError(
            f"{path} holds no scenario {scenario}{did_you_mean(scenario, manifest.scenarios, 3)}"
        )
    if future is not None and not 0 <= future < manifest.config.futures:
        raise FileError(
            f"{path} holds no future {future} of {scenario}: its futures are 0 to "
            f"{manifest.config.futures - 1}"
        )
    rows = [
        row
        for row in read_rows(folder.rows)
        if row.scenario == scenario and row.arm in arms and future in (None, row.future)
    ]
    if not rows:
        raise FileError(f"{path} holds no finished episode of {scenario} in {' or '.join(arms)}")
    return drives_of(folder, rows, DrivenScenarios(manifest, source))


def drives_of(
    folder: RunFolder, rows: Sequence[Score], scenarios: DrivenScenarios
) -> list[tuple[Score, Drive | None]]:
    """Reads the drives of some episodes of one scenario, which is read where one was recorded.

    Args:
        folder: The run folder.
        rows: The episodes' rows.
        scenarios: Those of the run.

    Returns:
        Each row with its drive; None where the episode failed before it began.

    Raises:
        FileError: A recording or the scenario cannot be read, or is not the one that was driven.
    """
    recordings = [find_recording(folder, row) for row in rows]
    scene: Scenario | None = None
    drives: list[tuple[Score, Drive | None]] = []
    for row, recording in zip(rows, recordings, strict=True):
        if recording is None:
            drives.append((row, None))
            continue
        scene = scene or scenarios.load(row.scenario)
        drives.append((row, Drive(row, recording, scene)))
    return drives


class DrivenScenarios:
    """The scenarios that a run drove, where they lie now; they are listed when one is needed."""

    def __init__(self, manifest: RunManifest, source: Source | None = None) -> None:
        """Looks for nothing yet.

        Args:
            manifest: The run's.
            source: Where they lie now; where the run found them if None.
        """
        self._source = source or manifest.config.source
        self._cached = manifest.config.cache
        self._hint = "" if source else "; name where it lies now with --source"

    def load(self, scenario: str) -> Scenario:
        """Reads a scenario.

        Args:
            scenario: Its id.

        Returns:
            The scenario.

        Raises:
            FileError: It cannot be found or read.
        """
        try:
            return load_scenario(_of_id(self._refs, scenario, self._source), cached=self._cached)
        except ScenarioError as error:
            raise FileError(f"{error}{self._hint}") from error

    @cached_property
    def _refs(self) -> dict[str, ScenarioRef]:
        return {ref.id: ref for ref in find_scenarios(self._source)}


def find_scenario(scenario: str, source: Source) -> ScenarioRef:
    """Finds a scenario by its id.

    Args:
        scenario: The id.
        source: Where to look, as ``dosplan.scenario.find_scenarios`` takes it.

    Returns:
        The scenario's file and problem.

    Raises:
        FileError: The source does not hold it.
        ScenarioError: There is no such source.
    """
    return _of_id({ref.id: ref for ref in find_scenarios(source)}, scenario, source)


def _of_id(refs: Mapping[str, ScenarioRef], scenario: str, source: Source) -> ScenarioRef:
    if scenario not in refs:
        raise FileError(
            f"{source_text(source)} holds no scenario {scenario}{did_you_mean(scenario, refs, 3)}; "
            "name its place with --source"
        )
    return refs[scenario]


def find_recording(folder: RunFolder, row: Score) -> Recording | None:
    """Reads the file of an episode.

    Args:
        folder: The run folder.
        row: The episode's row.

    Returns:
        Its recording; None where it failed before there was anything to write, or was unusable.

    Raises:
        FileError: The file is missing or broken.
    """
    path = folder.recording(row.key)
    may_lack = row.outcome is Outcome.PLANNER_FAILURE or not row.outcome.of_planner
    if may_lack and not path.exists():
        return None
    return Recording.load(path)
