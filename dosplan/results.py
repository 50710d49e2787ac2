"""The run folder: ``run.json``, the rows of ``scenarios.jsonl``, and their summary.

``run.json`` names every episode of the run, so the denominator of each share is the manifest:
an episode that crashed is a row like any other. Rows are appended and flushed as they finish;
a row that was cut off by a kill is dropped on reading and its episode is driven again.

How the figures of the summary are averaged:

* shares are over all scenarios of the run;
* ``velocity`` is the mean over the episodes that drove a step of their mean velocity (an
  episode that failed before its first step has no velocity);
* ``cycle_ms_p50`` and ``cycle_ms_p99`` are percentiles over all planning cycles of all episodes
  pooled, read from the episode files: a percentile of per-episode percentiles would be neither.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import IO, Any, TypedDict
from urllib.parse import quote

import numpy as np

from dosplan.files import FileError, atomic_file, read_json
from dosplan.recording import load_recording
from dosplan.types import Arm, CollisionClass, FloatArray, Outcome, Score


class ArmSummary(TypedDict):
    """The figures of one arm; shares lie between 0 and 1.

    Attributes:
        n: Number of scenarios, the denominator of every share.
        success_rate: Share of ``success``.
        safe_rate: Share without collision and within bounds (the paper's success).
        collision_rate: Share of ``collision``.
        at_fault_collision_rate: Share of collisions that the ego is to blame for.
        out_of_bounds_rate: Share of ``out_of_bounds``.
        goal_missed_rate: Share of ``goal_missed``.
        planner_failure_rate: Share of ``planner_failure``.
        velocity: Mean velocity, m/s, or None where no episode drove a step.
        cycle_ms_p50: Median time of a planning cycle, ms, or None where none ran.
        cycle_ms_p99: 99th percentile of it.
    """

    n: int
    success_rate: float
    safe_rate: float
    collision_rate: float
    at_fault_collision_rate: float
    out_of_bounds_rate: float
    goal_missed_rate: float
    planner_failure_rate: float
    velocity: float | None
    cycle_ms_p50: float | None
    cycle_ms_p99: float | None


@dataclass(frozen=True)
class RunFolder:
    """Where the files of a run are; every path follows from the folder's, so it can be moved.

    Attributes:
        path: The folder.
    """

    path: Path

    @property
    def manifest(self) -> Path:
        """``run.json``: configuration, episodes, versions, machine."""
        return self.path / "run.json"

    @property
    def rows(self) -> Path:
        """``scenarios.jsonl``: one row for each episode."""
        return self.path / "scenarios.jsonl"

    @property
    def summary(self) -> Path:
        """``summary.json``."""
        return self.path / "summary.json"

    @property
    def summary_text(self) -> Path:
        """``summary.md``."""
        return self.path / "summary.md"

    def recording(self, scenario: str, arm: Arm) -> Path:
        """File of an episode; characters of an id that are unsafe in a file name are quoted.

        Args:
            scenario: Id of the scenario.
            arm: The arm.

        Returns:
            Its path.
        """
        return self.path / "episodes" / f"{quote(scenario, safe='@')}.{arm.value}.npz"


def row_line(score: Score) -> str:
    """Writes a row of ``scenarios.jsonl``.

    Args:
        score: The score.

    Returns:
        One line of JSON, with its line break.

    Raises:
        ValueError: A figure is NaN or infinite.
    """
    return json.dumps(asdict(score), allow_nan=False) + "\n"


def append_row(file: IO[str], score: Score) -> None:
    """Appends a row and flushes it, so that a kill loses no finished episode.

    Args:
        file: ``scenarios.jsonl``, opened for appending.
        score: The score.

    Raises:
        FileError: It cannot be written.
    """
    try:
        file.write(row_line(score))
        file.flush()
    except OSError as error:
        raise FileError(f"cannot write {file.name}: {error.strerror or error}") from error


def read_rows(path: Path) -> list[Score]:
    """Reads ``scenarios.jsonl``.

    Args:
        path: The file; one that is missing holds no rows.

    Returns:
        The rows. A last line without its line break was cut off by a kill and is left out.

    Raises:
        FileError: A line is not a row of this version.
    """
    if not path.exists():
        return []
    *lines, _ = path.read_bytes().split(b"\n")
    rows = []
    for number, line in enumerate(lines, start=1):
        try:
            rows.append(_score(json.loads(line)))
        except (ValueError, TypeError, KeyError) as error:
            raise FileError(
                f"{path}, line {number}, is not a row of this version ({error}); "
                "delete the line to have its episode driven again"
            ) from None
    return rows


def write_rows(path: Path, rows: Iterable[Score]) -> None:
    """Writes ``scenarios.jsonl`` anew, whole or not at all.

    Args:
        path: The file.
        rows: The rows, in order.

    Raises:
        FileError: It cannot be written.
    """
    with atomic_file(path) as file:
        file.writelines(row_line(row).encode() for row in rows)


def read_run(path: Path) -> tuple[dict[str, Any], list[Score]]:
    """Reads a finished run.

    Args:
        path: A run folder.

    Returns:
        ``run.json`` and the rows.

    Raises:
        FileError: It is not a run folder, or rows are missing.
    """
    folder = RunFolder(path)
    if not folder.manifest.is_file():
        raise FileError(f"{path} is not a run folder: it has no run.json")
    manifest = read_json(folder.manifest)
    rows = read_rows(folder.rows)
    missing = len(manifest["scenarios"]) * len(manifest["config"]["arms"]) - len(rows)
    if missing:
        raise FileError(f"{path} lacks {missing} episodes: run the same command again to resume it")
    return manifest, rows


def summarise(
    rows: Sequence[Score], n: int, cycle_ms: Mapping[Arm, FloatArray]
) -> dict[Arm, ArmSummary]:
    """Summarises the rows, arm by arm.

    Args:
        rows: Rows of a run.
        n: Number of scenarios of the run: the denominator of every share.
        cycle_ms: Times of all planning cycles of each arm, ms.

    Returns:
        The figures of each arm of ``cycle_ms``, in its order.

    Raises:
        ValueError: An arm does not have exactly ``n`` rows.
    """
    return {
        arm: _summarise_arm([row for row in rows if row.arm is arm], n, times)
        for arm, times in cycle_ms.items()
    }


def pooled_cycle_ms(folder: RunFolder, rows: Iterable[Score], arm: Arm) -> FloatArray:
    """Reads the times of all planning cycles of an arm.

    Args:
        folder: The run folder.
        rows: Its rows.
        arm: The arm.

    Returns:
        (C,) times, ms, over all its episodes; an episode without a cycle has no part in it.

    Raises:
        FileError: The file of an episode that has cycles is missing or broken.
    """
    times = [
        load_recording(folder.recording(row.scenario, arm)).cycle_ms
        for row in rows
        if row.arm is arm and row.cycle_ms_p50 is not None
    ]
    return np.concatenate([np.empty(0), *times])


def _score(row: Any) -> Score:
    if not isinstance(row, dict):
        raise TypeError("not an object")
    unknown = row.keys() ^ {field.name for field in fields(Score)}
    if unknown:
        raise ValueError(f"columns {', '.join(sorted(unknown))} do not match")
    kind = row["collision_class"]
    typed = {
        "arm": Arm(row["arm"]),
        "outcome": Outcome(row["outcome"]),
        "collision_class": None if kind is None else CollisionClass(kind),
    }
    return Score(**{**row, **typed})


def _summarise_arm(rows: Sequence[Score], n: int, cycle_ms: FloatArray) -> ArmSummary:
    if len(rows) != n:
        raise ValueError(f"{len(rows)} rows for {n} scenarios: every scenario needs its row")
    outcomes = [row.outcome for row in rows]
    velocities = [row.velocity for row in rows if row.steps > 0]
    p50, p99 = np.percentile(cycle_ms, [50, 99]).tolist() if len(cycle_ms) else (None, None)
    return ArmSummary(
        n=n,
        success_rate=outcomes.count(Outcome.SUCCESS) / n,
        safe_rate=sum(row.safe for row in rows) / n,
        collision_rate=outcomes.count(Outcome.COLLISION) / n,
        at_fault_collision_rate=sum(row.at_fault for row in rows) / n,
        out_of_bounds_rate=outcomes.count(Outcome.OUT_OF_BOUNDS) / n,
        goal_missed_rate=outcomes.count(Outcome.GOAL_MISSED) / n,
        planner_failure_rate=outcomes.count(Outcome.PLANNER_FAILURE) / n,
        velocity=float(np.mean(velocities)) if velocities else None,
        cycle_ms_p50=p50,
        cycle_ms_p99=p99,
    )
