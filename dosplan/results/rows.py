"""The rows of a run: ``scenarios.jsonl``, a JSON object for each episode on a line of its own."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import IO, Any, Final, get_type_hints

from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, read_manifest
from dosplan.scoring import metrics
from dosplan.system.files import FileError, atomic_file, parse_json
from dosplan.system.typed import plain, typed
from dosplan.types import Score

LATER: Final = ("traffic", "future", "loop")
"""Columns that rows of earlier versions lack; there they have the default of ``Score``."""

_COLUMNS: Final = {name: kind for name, kind in get_type_hints(Score).items() if name != "measures"}


def row_line(score: Score) -> str:
    """Writes a row of ``scenarios.jsonl``.

    Args:
        score: The score.

    Returns:
        One line of JSON, with its line break.

    Raises:
        ValueError: A figure is NaN or infinite.
    """
    return json.dumps(plain(score.columns()), allow_nan=False) + "\n"


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
    rows, kind = [], _row_kind()
    for number, line in enumerate(lines, start=1):
        try:
            rows.append(_score(parse_json(line), kind))
        except (ValueError, RecursionError) as error:
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


class UnfinishedError(FileError):
    """A run that has not driven all its episodes; the message is one line."""


def read_run(path: Path) -> tuple[RunManifest, list[Score]]:
    """Reads a finished run.

    Args:
        path: A run folder.

    Returns:
        ``run.json`` and the rows.

    Raises:
        UnfinishedError: Rows are missing.
        FileError: It is not a run folder, or its rows are not those of its episodes.
    """
    folder = RunFolder(path)
    manifest = read_manifest(folder)
    rows = read_rows(folder.rows)
    wanted = set(manifest.episodes)
    held = {row.key for row in rows}
    if missing := len(wanted - held):
        raise UnfinishedError(
            f"{path} lacks {missing} episodes: run the same command again to resume it"
        )
    if len(rows) > len(wanted):
        raise FileError(
            f"{folder.rows} holds {len(rows) - len(wanted)} rows too many: "
            "run the same command again to put it right"
        )
    return manifest, rows


def _row_kind() -> type[Any]:
    """A dataclass of the columns; those that metrics add may be absent in older rows."""
    always = [column for column in _COLUMNS.items() if column[0] not in LATER]
    later = [(name, _COLUMNS[name], field(default=getattr(Score, name))) for name in LATER]
    measured = metrics.measured_kinds().items()
    added = [(name, kind | None, field(default=None)) for name, kind in measured]
    return make_dataclass("Row", [*always, *later, *added])


def _score(row: Any, kind: type[Any]) -> Score:
    # A column that is not known is refused, as a misspelt one could be one that may be absent.
    if isinstance(row, dict) and (odd := sorted(row.keys() - kind.__annotations__.keys())):
        raise ValueError(f"there is no column {odd[0]!r:.100}")
    found = typed(row, kind)
    columns = {name: getattr(found, name) for name in kind.__annotations__}
    own = {name: columns.pop(name) for name in _COLUMNS}
    return Score(**own, measures=columns)
