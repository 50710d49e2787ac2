"""The folder of a sweep: run folders below it, and ``sweep.json``, which says what each is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from dosplan.results.manifest import RunSettings
from dosplan.system.files import FileError, read_json, write_json
from dosplan.system.typed import plain, typed

_FILE: Final = "sweep.json"


@dataclass(frozen=True, kw_only=True)
class SweepRun:
    """A run of a sweep.

    Attributes:
        name: Its name, ``axis=value,axis=value``, which is that of its folder.
        values: The name of its value on each axis.
        settings: Its settings.
    """

    name: str
    values: Mapping[str, str] = field(default_factory=dict, hash=False)
    settings: RunSettings


@dataclass(frozen=True)
class SweepFolder:
    """Where the runs of a sweep are; it can be moved.

    Attributes:
        path: The folder.
    """

    path: Path

    @property
    def record(self) -> Path:
        """``sweep.json``: the runs, in order."""
        return self.path / _FILE

    def run(self, run: SweepRun) -> Path:
        """The folder of a run.

        Args:
            run: The run.

        Returns:
            Its path.
        """
        return self.path / run.name

    def read(self) -> tuple[SweepRun, ...]:
        """Reads ``sweep.json``.

        Returns:
            The runs, in order.

        Raises:
            FileError: It cannot be read or does not describe a sweep.
        """
        try:
            return typed(read_json(self.record), _Record).runs
        except ValueError as error:
            raise FileError(
                f"{self.record} is not a sweep.json of this version ({error}); "
                "name another folder, or delete this file and sweep again"
            ) from None

    def write(self, runs: tuple[SweepRun, ...]) -> None:
        """Writes ``sweep.json``.

        Args:
            runs: The runs, in order.

        Raises:
            FileError: It cannot be written.
        """
        write_json(self.record, plain(_Record(runs)))


@dataclass(frozen=True)
class _Record:
    """Content of ``sweep.json``."""

    runs: tuple[SweepRun, ...]
