"""The run folder: where its files are.

``run.json`` names every episode of the run, so the denominator of each share is the manifest:
an episode that crashed is a row like any other. Rows are appended as they finish; a row that was
cut off by a kill is dropped on reading and its episode is driven again. What each episode did is
in ``episodes/<scenario>.<arm>.npz``; where Python raised in it, the traceback is beside that, in
``episodes/<scenario>.<arm>.txt``. Futures of a scenario other than the first one have their number
in the names: ``<scenario>.<arm>.future-<k>.npz``. ``docs/run-folder.md`` lists the keys of each
file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from zipfile import is_zipfile

from dosplan.system.files import file_name
from dosplan.types import EpisodeKey, Score


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
    def lock(self) -> Path:
        """``.lock``: there while a process drives the run, and where one was killed."""
        return self.path / ".lock"

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

    def recording(self, key: EpisodeKey) -> Path:
        """File of an episode.

        Args:
            key: The episode.

        Returns:
            Its path.
        """
        return self.path / "episodes" / f"{file_name(key.scenario)}.{_part(key)}.npz"

    def traceback(self, key: EpisodeKey) -> Path:
        """File of the traceback of an episode in which Python raised.

        Args:
            key: The episode.

        Returns:
            Its path.
        """
        return self.recording(key).with_suffix(".txt")

    def solution(self, scenario: str, key: EpisodeKey) -> Path:
        """File of a CommonRoad solution.

        Args:
            scenario: Id of the scenario file, which may hold several planning problems.
            key: One of its episodes.

        Returns:
            Its path.
        """
        return self.path / "solutions" / f"{file_name(scenario)}.{_part(key)}.xml"

    def holds(self, row: Score) -> bool:
        """Whether the folder holds the whole episode file of a row.

        Args:
            row: A row.

        Returns:
            Whether it is there and has its end; True where no planning cycle ran, since nothing is
            read then.
        """
        return row.cycle_ms_p50 is None or is_zipfile(self.recording(row.key))


def _part(key: EpisodeKey) -> str:
    """What a file name says after the scenario; the first future goes unnamed."""
    return f"{key.arm.value}.future-{key.future}" if key.future else key.arm.value
