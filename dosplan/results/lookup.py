"""The episodes of a scenario in a run folder, with the scenario file that they were driven in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, read_manifest
from dosplan.results.recording import Recording, load_recording
from dosplan.results.rows import read_rows
from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios, load_scenario
from dosplan.system.errors import did_you_mean
from dosplan.system.files import FileError
from dosplan.types import Arm, Outcome, Scenario, Score


@dataclass(frozen=True)
class RecordedScenario:
    """What a run holds of a scenario.

    Attributes:
        folder: The run folder.
        manifest: Content of its ``run.json``.
        rows: The row of each arm.
        recordings: The episode of each arm; None where it failed before it began.
        scenario: The scenario; None where no episode began.
    """

    folder: RunFolder
    manifest: RunManifest
    rows: tuple[Score, ...]
    recordings: tuple[Recording | None, ...]
    scenario: Scenario | None


def find_recorded(
    path: Path, scenario: str, arms: Sequence[Arm] = tuple(Arm), source: str | None = None
) -> RecordedScenario:
    """Reads the episodes of a scenario in a run; the run may still be going on.

    Args:
        path: The run folder.
        scenario: Id of the scenario.
        arms: Arms that are wanted; those that the run does not drive are left out.
        source: Where the scenarios lie now; where the run found them if None.

    Returns:
        The episodes.

    Raises:
        FileError: The folder holds no such episode, or its scenario cannot be found or read.
    """
    folder = RunFolder(path)
    manifest = read_manifest(folder)
    if scenario not in manifest.scenarios:
        raise FileError(
            f"{path} holds no scenario {scenario}{did_you_mean(scenario, manifest.scenarios, 3)}"
        )
    rows = [row for row in read_rows(folder.rows) if row.scenario == scenario and row.arm in arms]
    if not rows:
        raise FileError(f"{path} holds no finished episode of {scenario} in {' or '.join(arms)}")
    recordings = [_recording(folder, row) for row in rows]
    loaded: Scenario | None = None
    if any(recording is not None for recording in recordings):
        place = source or manifest.config.source
        try:
            loaded = load_scenario(find_scenario(scenario, place))
        except ScenarioError as error:
            hint = "" if source else "; name where it lies now with --source"
            raise FileError(f"{error}{hint}") from error
    return RecordedScenario(folder, manifest, tuple(rows), tuple(recordings), loaded)


def find_scenario(scenario: str, source: str) -> ScenarioRef:
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
    refs = {ref.id: ref for ref in find_scenarios(source)}
    if scenario not in refs:
        raise FileError(
            f"{source} holds no scenario {scenario}{did_you_mean(scenario, refs, 3)}; "
            "name its place with --source"
        )
    return refs[scenario]


def _recording(folder: RunFolder, row: Score) -> Recording | None:
    """An episode's file; None where it failed before there was anything to write."""
    path = folder.recording(row.scenario, row.arm)
    if row.outcome is Outcome.PLANNER_FAILURE and not path.exists():
        return None
    return load_recording(path)
