"""The solutions of a run: ``solutions/<scenario>.<arm>.xml`` for CommonRoad's tools and site.

They are made from the episode files, so they can be made after a run, too. The planning
problems of one scenario file are in one solution, as CommonRoad has it; a problem of which nothing
was driven is missing there.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from datetime import UTC, datetime
from itertools import product
from pathlib import Path

from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest
from dosplan.results.recording import Recording
from dosplan.scenario import ScenarioRef
from dosplan.scenario.commonroad.solution import Trajectory, solution_xml
from dosplan.system.files import write_bytes
from dosplan.types import EpisodeKey


def write_solutions(folder: RunFolder, refs: Iterable[ScenarioRef], manifest: RunManifest) -> None:
    """Writes a solution for each scenario file, arm and future of which an episode was driven.

    Args:
        folder: The run folder, with its episode files.
        refs: The scenarios of the run.
        manifest: Its ``run.json``.

    Raises:
        FileError: An episode file cannot be read, or a solution cannot be written.
        ScenarioError: A scenario file that was driven cannot be read any more.
    """
    by_file: defaultdict[Path, list[ScenarioRef]] = defaultdict(list)
    for ref in refs:
        by_file[ref.path].append(ref)
    episodes = list(product(manifest.config.arms, range(manifest.config.futures)))
    for path, problems in by_file.items():
        for arm, future in episodes:
            keys = {ref.problem_id: EpisodeKey(ref.id, arm, future) for ref in problems}
            files = {problem: folder.recording(key) for problem, key in keys.items()}
            driven = {problem: file for problem, file in files.items() if file.is_file()}
            if driven:
                recordings = {name: Recording.load(file) for name, file in driven.items()}
                drives = {problem: _drive(recording) for problem, recording in recordings.items()}
                met = next(iter(recordings.values()))
                # A scenario file records future 0 alone.
                traffic = None if met.tracks is None and not future else met.traffic
                if future:
                    traffic = f"{traffic} in future {future}"
                date = max(_written(file) for file in driven.values())
                place = folder.solution(problems[0].scenario, next(iter(keys.values())))
                write_bytes(place, solution_xml(path, drives, date, traffic))


def _drive(recording: Recording) -> Trajectory:
    return Trajectory(
        start_step=recording.start_step,
        states=recording.states,
        inputs=recording.inputs,
        seconds=1e-3 * float(recording.cycle_ms.sum()),
    )


def _written(file: Path) -> datetime:
    return datetime.fromtimestamp(file.stat().st_mtime, UTC)
