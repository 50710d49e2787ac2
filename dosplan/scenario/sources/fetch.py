"""From what a user names to scenario files: folders, files, globs, archives, URLs and lists."""

from __future__ import annotations

import errno
import glob
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

from dosplan.scenario.commonroad.document import SUFFIXES, ScenarioError
from dosplan.scenario.sources.archives import is_archive, is_scenario, unpacked
from dosplan.scenario.sources.download import SCHEMES, downloaded

LIST: Final = "@"
"""Begins a source that is a list."""
SUITE: Final = "suite"
"""The source that is taken where none is named."""
SUITES: Final = (SUITE, "suite-1")
"""The sources that are embedded suites, by their names."""

Suites = Mapping[str, Mapping[str, Path]]
"""Files of the embedded suites by the name of the suite and the id of their scenario."""

_NOTHING: Final = (
    "does not exist; name a file, a folder, a quoted glob, an archive, @LIST, or a suite: "
    f"{' or '.join(SUITES)}"
)


@dataclass(frozen=True)
class Candidate:
    """A file that may hold scenarios.

    Attributes:
        path: The file.
        name: Its path in the source, which distinguishes broken files of one name.
        chosen: Whether it was named explicitly, so that it is listed whatever it holds.
        wanted: The id whose episodes are wanted, or None for all.
    """

    path: Path
    name: str
    chosen: bool = False
    wanted: str | None = None


def candidates(source: str | Path) -> list[Candidate]:
    """Finds the files of a source that is no list.

    Args:
        source: A file, folder, glob or archive, or the URL of a file, a folder or an archive.

    Returns:
        The files, each once, in the order of their paths.

    Raises:
        ScenarioError: There is no such thing, or an archive cannot be unpacked.
    """
    found = _named(Path(), str(source))
    if not found and not _holds((there := place(source)).exists):
        raise ScenarioError(there, _NOTHING)
    return list({candidate.path: candidate for candidate in found}.values())


def joined_candidates(sources: Sequence[str | Path], suites: Suites) -> list[Candidate]:
    """Finds the files of several sources, as those of a list's lines.

    Args:
        sources: Files, folders, globs, archives, URLs, lists, suites, or ids of theirs.
        suites: The embedded suites.

    Returns:
        The files, in the order of the sources.

    Raises:
        ScenarioError: One of them is not there, or cannot be used.
    """
    found: list[Candidate] = []
    for entry in map(str, sources):
        if entry.startswith(LIST):
            found.extend(listed_candidates(Path(entry.removeprefix(LIST)), suites))
        elif entry in suites:
            found.extend(c for name in suites[entry] for c in _by_id(Path(), name, suites))
        elif named := _named(Path(), entry, label=entry) or _by_id(Path(), entry, suites):
            found.extend(named)
        else:
            raise ScenarioError(Path(entry), _NOTHING)
    return found


def listed_candidates(path: Path, suites: Suites) -> list[Candidate]:
    """Finds the files that a list names.

    Each line names a file, folder, glob or archive, relative to the list's folder, or the id of a
    scenario, with or without ``@<problem id>``: one of an embedded suite, or one whose file
    stands beside the list as ``<id>.xml`` or ``<id>.xml.gz``. Empty lines and those that begin
    with ``#`` are passed over.

    Args:
        path: A text file.
        suites: The embedded suites.

    Returns:
        The files, in the order of the list.

    Raises:
        ScenarioError: The list cannot be read, or a line names nothing.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ScenarioError(path, f"cannot be read as a list ({reason})") from None
    found: list[Candidate] = []
    for number, line in enumerate(lines, start=1):
        entry = line.strip()
        if not entry or entry.startswith("#"):
            continue
        named = _named(path.parent, entry, label=entry) or _by_id(path.parent, entry, suites)
        if not named:
            raise ScenarioError(
                path,
                f"line {number}: {entry} names no scenario; give a path, or the id of one of a "
                "suite or of a file beside the list",
            )
        found.extend(named)
    return found


def place(source: str | Path) -> Path:
    """The path of a source, or what behaves like one for a URL.

    Args:
        source: A path or a URL.

    Returns:
        The path, which need not exist. A file behind an http(s) URL is fetched.

    Raises:
        ScenarioError: The URL cannot be reached.
    """
    if "://" not in str(source):
        return Path(source)
    if str(source).startswith(SCHEMES):
        return downloaded(str(source))
    try:
        from upath import UPath  # Of an optional dependency.

        found = UPath(source)
        found.exists()  # Shows whether the URL's file system is installed and answers.
    except Exception as error:  # A file system may raise anything.
        reason = f"{type(error).__name__}: {error}"
        raise ScenarioError(
            str(source),
            f"cannot be reached ({reason}); URLs need pip install 'dosplan[cluster]' "
            "and fsspec's package for theirs",
        ) from error
    return cast(Path, found)


def _named(root: Path, text: str, label: str = "") -> list[Candidate]:
    """The files of what a text names from a folder on; none where it names nothing."""
    found = _at(place(text) if "://" in text else root / text, label)
    if found or not glob.has_magic(text):
        return found
    # Unlike this, Path.glob takes no absolute pattern and finds hidden files.
    matches = sorted(glob.glob(text, root_dir=root, recursive=True))  # noqa: PTH207
    of_each = [_at(root / match, match, chosen=False) for match in matches]
    return [candidate for candidates in of_each for candidate in candidates]


def _at(where: Path, label: str, chosen: bool = True) -> list[Candidate]:
    """The files of a file, folder or archive; none where nothing of the kind is there.

    A file that is not chosen counts only where it has the name of a scenario.
    """
    if _holds(where.is_dir):
        return _in_folder(where, label)
    if not _holds(where.is_file):
        return []
    if is_archive(where):
        return _in_folder(unpacked(where), label)
    return [Candidate(where, label, chosen)] if chosen or is_scenario(where.name) else []


def _in_folder(folder: Path, label: str) -> list[Candidate]:
    if "://" not in str(folder):
        _check_access(folder)
    files = sorted(file for file in folder.rglob("*") if is_scenario(file.name))
    inside = ((file, file.relative_to(folder)) for file in files)
    return [
        Candidate(file, "/".join(filter(None, (label, name.as_posix()))))
        for file, name in inside
        if not any(part.startswith(".") for part in name.parts)
    ]


def _check_access(folder: Path) -> None:
    """Refuses a folder with another inside that cannot be opened: its files would be left out."""

    def refuse(error: OSError) -> None:
        raise ScenarioError(
            Path(error.filename), f"cannot be opened ({error.strerror}); allow it, or move it away"
        )

    for _ in os.walk(folder, onerror=refuse):
        pass


def _holds(test: Callable[[], bool]) -> bool:
    """Whether a path is what is asked; a name that no file can have, as it is too long, is not."""
    try:
        return test()
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        return False


def _by_id(folder: Path, wanted: str, suites: Suites) -> list[Candidate]:
    """The file of a scenario's id: beside the list, or in a suite."""
    scenario = wanted.partition("@")[0]
    beside = (folder / f"{scenario}{suffix}" for suffix in SUFFIXES)
    embedded = (files[scenario] for files in suites.values() if scenario in files)
    path = next((file for file in beside if _holds(file.is_file)), next(embedded, None))
    return [] if path is None else [Candidate(path, wanted, chosen=True, wanted=wanted)]
