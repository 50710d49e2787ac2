"""The run folder: ``run.json``, the rows of ``scenarios.jsonl``, and their summary.

``run.json`` names every episode of the run, so the denominator of each share is the manifest:
an episode that crashed is a row like any other. Rows are appended as they finish; a row that was
cut off by a kill is dropped on reading and its episode is driven again. What each episode did is
in ``episodes/<scenario>.<arm>.npz``; where Python raised in it, the traceback is beside that, in
``episodes/<scenario>.<arm>.txt``.

How the figures of the summary are averaged:

* shares are over all scenarios of the run, but for ``comfortable_rate``;
* ``velocity``, ``progress`` and ``comfortable_rate`` are means over the episodes that drove a
  step (an episode that failed before its first step has no velocity);
* ``min_time_to_collision`` is the mean over the episodes that have one;
* ``cycle_ms_p50`` and ``cycle_ms_p99`` are percentiles over all planning cycles of all episodes
  pooled, read from the episode files: a percentile of per-episode percentiles would be neither.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from itertools import product
from pathlib import Path
from typing import IO, Any, Final, NoReturn, TypedDict, get_type_hints

import numpy as np

from dosplan.results.recording import load_cycle_ms
from dosplan.system.files import FileError, atomic_file, file_name, read_json
from dosplan.types import Arm, CollisionClass, FloatArray, Outcome, Score

_COLUMNS: Final = get_type_hints(Score)
_REQUIRED: Final = {column.name for column in fields(Score) if column.default is MISSING}
_MANIFEST: Final = {
    "config": dict,
    "planner": str,
    "predictor": str,
    "scenarios": list,
    "versions": dict,
}
_CONFIG: Final = {"source": str, "planner_options": dict, "predictor_options": dict}


class ArmSummary(TypedDict):
    """The figures of one arm; shares lie between 0 and 1.

    Attributes:
        n: Number of scenarios, the denominator of every share.
        success_rate: Share of ``success``.
        safe_rate: Share without collision and within bounds (the paper's success).
        collision_rate: Share of ``collision``.
        at_fault_collision_rate: Share with a collision that the ego is to blame for.
        out_of_bounds_rate: Share of ``out_of_bounds``.
        goal_missed_rate: Share of ``goal_missed``.
        planner_failure_rate: Share of ``planner_failure``.
        comfortable_rate: Share, of the episodes that drove a step, in which every comfort bound
            holds, or None where none did.
        velocity: Mean velocity, m/s, or None where no episode drove a step.
        progress: Mean distance along the reference path, m, or None likewise.
        min_time_to_collision: Mean of the smallest times to collision, s, or None where no
            episode has one.
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
    comfortable_rate: float | None
    velocity: float | None
    progress: float | None
    min_time_to_collision: float | None
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

    @property
    def report(self) -> Path:
        """``report.html``."""
        return self.path / "report.html"

    def recording(self, scenario: str, arm: Arm) -> Path:
        """File of an episode.

        Args:
            scenario: Id of the scenario.
            arm: The arm.

        Returns:
            Its path.
        """
        return self.path / "episodes" / f"{file_name(scenario)}.{arm.value}.npz"

    def traceback(self, scenario: str, arm: Arm) -> Path:
        """File of the traceback of an episode in which Python raised.

        Args:
            scenario: Id of the scenario.
            arm: The arm.

        Returns:
            Its path.
        """
        return self.recording(scenario, arm).with_suffix(".txt")

    def holds(self, row: Score) -> bool:
        """Whether the folder holds the episode file that a row speaks of.

        Args:
            row: A row.

        Returns:
            Whether it is there; True where no planning cycle ran, since nothing is read then.
        """
        return row.cycle_ms_p50 is None or self.recording(row.scenario, row.arm).is_file()


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


def append_row(file: IO[bytes], score: Score) -> None:
    """Appends a row at once, so that a kill loses no finished episode.

    Args:
        file: ``scenarios.jsonl``, opened for appending without a buffer: what a buffer could
            not write, closing the file would try, and fail, to write again.
        score: The score.

    Raises:
        FileError: It cannot be written.
    """
    rest = row_line(score).encode()
    try:
        while rest:  # A write without a buffer may take a part only.
            rest = rest[file.write(rest) :]
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
            rows.append(_score(json.loads(line, parse_constant=_refuse)))
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
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
        FileError: It is not a run folder, or its rows are not those of its episodes.
    """
    folder = RunFolder(path)
    if not folder.manifest.is_file():
        raise FileError(f"{path} is not a run folder: it has no run.json")
    manifest = read_manifest(folder)
    rows = read_rows(folder.rows)
    wanted = set(product(manifest["scenarios"], manifest["config"]["arms"]))
    held = {(row.scenario, row.arm) for row in rows}
    if missing := len(wanted - held):
        raise FileError(f"{path} lacks {missing} episodes: run the same command again to resume it")
    if len(rows) > len(wanted):
        raise FileError(
            f"{folder.rows} holds {len(rows) - len(wanted)} rows too many: "
            "run the same command again to put it right"
        )
    return manifest, rows


def read_manifest(folder: RunFolder) -> dict[str, Any]:
    """Reads ``run.json``.

    Args:
        folder: The run folder.

    Returns:
        Its content.

    Raises:
        FileError: It cannot be read or does not describe a run.
    """
    manifest = read_json(folder.manifest)
    if not _describes_a_run(manifest):
        raise FileError(
            f"{folder.manifest} is not a run.json of this version; "
            "name another folder, or delete this one"
        )
    found: dict[str, Any] = manifest
    return found


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
        load_cycle_ms(folder.recording(row.scenario, arm))
        for row in rows
        if row.arm is arm and row.cycle_ms_p50 is not None
    ]
    return np.concatenate([np.empty(0), *times])


def _score(row: Any) -> Score:
    if not isinstance(row, dict):
        raise TypeError("not an object")
    odd = (row.keys() - _COLUMNS.keys()) | (_REQUIRED - row.keys())
    if odd:
        raise ValueError(f"columns {', '.join(sorted(odd))} do not match")
    kind = row["collision_class"]
    typed = {
        "arm": Arm(row["arm"]),
        "outcome": Outcome(row["outcome"]),
        "collision_class": None if kind is None else CollisionClass(kind),
    }
    values = {**row, **typed}
    for name, value in values.items():
        # A float without decimals may stand as an integer in JSON.
        candidates = (value, float(value)) if type(value) is int else (value,)
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{name} is too large a number")
        if not any(isinstance(candidate, _COLUMNS[name]) for candidate in candidates):
            raise ValueError(f"{name} is {value!r:.100}")
    return Score(**values)


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number")


def _describes_a_run(manifest: Any) -> bool:
    if not isinstance(manifest, dict) or not all(
        isinstance(manifest.get(key), kind) for key, kind in _MANIFEST.items()
    ):
        return False
    config = manifest["config"]
    arms = config.get("arms")
    return (
        isinstance(arms, list)
        and all(isinstance(config.get(key, kind()), kind) for key, kind in _CONFIG.items())
        and all(arm in list(Arm) for arm in arms)
        and all(isinstance(scenario, str) for scenario in manifest["scenarios"])
    )


def _summarise_arm(rows: Sequence[Score], n: int, cycle_ms: FloatArray) -> ArmSummary:
    if len(rows) != n:
        raise ValueError(f"{len(rows)} rows for {n} scenarios: every scenario needs its row")
    outcomes = [row.outcome for row in rows]
    driven = [row for row in rows if row.steps > 0]
    times = [r.min_time_to_collision for r in rows if r.min_time_to_collision is not None]
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
        comfortable_rate=_mean([row.comfortable for row in driven]),
        velocity=_mean([row.velocity for row in driven]),
        progress=_mean([row.progress for row in driven]),
        min_time_to_collision=_mean(times),
        cycle_ms_p50=p50,
        cycle_ms_p99=p99,
    )


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
