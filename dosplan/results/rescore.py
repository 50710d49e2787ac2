"""Scores a run again: from its episode files and its scenario files, without driving.

The rows come out as they were where scoring and scenarios are the same: to the last digit on the
same machine with the same libraries, and to the rounding of the last digits on another one, which
is no difference. An episode that failed before it had a file, or that is unusable, has nothing to
be scored, and keeps its row.

Files of versions before 0.5 hold cycle times and slacks in single precision: those columns keep
the values of the row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from dosplan.results.drive import Drive, DrivenScenarios, drives_of
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest
from dosplan.results.markdown import summary_markdown
from dosplan.results.rows import read_rows, read_run, write_rows
from dosplan.results.summary import summarise_run, write_summary
from dosplan.scenario.sources.catalogue import Source
from dosplan.scoring.score import score_driven
from dosplan.system.errors import one_line
from dosplan.system.files import FileError, write_text
from dosplan.system.locks import exclusive
from dosplan.types import EpisodeKey, Score

_ROUNDING: Final = 1e-9
"""Relative and absolute: processors and versions of numpy round sums in their last digits in ways
of their own."""
_INEXACT: Final = ("cycle_ms_p50", "cycle_ms_p99")
_INEXACT_MEASURES: Final = ("max_slack", "slack_cycles", "max_road_slack")


@dataclass(frozen=True)
class RowChange:
    """A row that came out differently.

    Attributes:
        key: Which episode it is of.
        columns: Value before and now of each column that differs.
    """

    key: EpisodeKey
    columns: Mapping[str, tuple[Any, Any]]


@dataclass(frozen=True)
class Rescored:
    """A run that was scored again.

    Attributes:
        folder: The run folder.
        manifest: Its ``run.json``.
        rows: Its rows as they are now, in their order.
        changes: Those that came out differently, by more than rounding.
        kept: How many rows were kept, as nothing was driven of their episodes.
    """

    folder: RunFolder
    manifest: RunManifest
    rows: tuple[Score, ...]
    changes: tuple[RowChange, ...]
    kept: int

    def write(self) -> None:
        """Writes the rows and the summary in place of those of the run.

        Raises:
            FileError: A file cannot be written, or the run goes on or has gone on.
        """
        with exclusive(self.folder.lock) as alone:
            if not alone:
                raise FileError(f"another process is driving the run in {self.folder.path}")
            now = [row.key for row in read_rows(self.folder.rows)]
            if now != [row.key for row in self.rows]:
                raise FileError(
                    f"{self.folder.rows} has changed since it was scored; score it again"
                )
            write_rows(self.folder.rows, self.rows)
            summary = summarise_run(self.folder, self.manifest, self.rows)
            write_summary(self.folder, summary)
            write_text(self.folder.summary_text, summary_markdown(summary))


def rescore(
    path: Path,
    source: Source | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Rescored:
    """Scores a finished run again. Nothing is written.

    Args:
        path: The run folder.
        source: Where the scenarios lie now; where the run found them if None.
        progress: Called with the number of episodes that are scored and of all.

    Returns:
        The rows, and how they differ from those of the run.

    Raises:
        FileError: It is not the folder of a finished run, an episode file is missing or broken, or
            a scenario cannot be found or read or is not the one that was driven.
    """
    manifest, before = read_run(path)
    folder = RunFolder(path)
    scenarios = DrivenScenarios(manifest, source)
    now: list[Score] = []
    kept = 0
    for _, rows in groupby(before, lambda row: row.scenario):
        for row, drive in drives_of(folder, list(rows), scenarios):
            kept += drive is None
            now.append(row if drive is None else _scored(drive))
        progress(len(now), len(before))
    compared = (_change(*pair) for pair in zip(before, now, strict=True))
    changes = tuple(change for change in compared if change.columns)
    return Rescored(folder, manifest, tuple(now), changes, kept)


def _scored(drive: Drive) -> Score:
    row, recording = drive.row, drive.recording
    try:
        found = score_driven(drive.scenario, recording, drive.tracks)
    except (ValueError, KeyError) as error:  # Raised for the plans of a damaged file.
        raise FileError(
            f"the episode file of {row.key.title}, cannot be scored: {one_line(error)}"
        ) from error
    if recording.exact:
        return found
    old = {name: row.measures[name] for name in _INEXACT_MEASURES if name in row.measures}
    times = {name: getattr(row, name) for name in _INEXACT}
    return replace(found, measures={**found.measures, **old}, **times)


def _change(before: Score, now: Score) -> RowChange:
    old, new = before.columns(), now.columns()
    columns = {
        name: (old.get(name), new.get(name))
        for name in {**old, **new}
        if not _agree(old.get(name), new.get(name))
    }
    return RowChange(now.key, columns)


def _agree(before: Any, now: Any) -> bool:
    if isinstance(before, float) and isinstance(now, float):
        return math.isclose(before, now, rel_tol=_ROUNDING, abs_tol=_ROUNDING)
    return bool(before == now)


def change_lines(changes: Sequence[RowChange]) -> list[str]:
    """Writes changes in plain words.

    Args:
        changes: The changes.

    Returns:
        A line for each row and column.
    """
    return [
        f"{change.key.title}: {name} was {before}, is {now}"
        for change in changes
        for name, (before, now) in change.columns.items()
    ]
