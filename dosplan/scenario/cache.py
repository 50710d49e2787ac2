"""Parsed scenarios on disk: the second run of a scenario does not parse it again.

An entry is named by a SHA-256 over all that it depends on: the file's content, the episode's
name, the source of the code that makes a ``Scenario`` of it and the versions of the libraries it
calls. So no entry has to be invalidated: when one of these changes, an entry of another name is
used. What cannot be read back is made anew.

Entries are written by ``dosplan.system.arrays_file``, without pickle, so that an entry that was
tampered with can give a wrong scenario but cannot run code.

The size is bounded: each of the cache's 256 folders drops its least recently read entries when it
grows beyond its share of ``MAX_BYTES``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Final

from dosplan.scenario.sources.catalogue import ScenarioRef
from dosplan.system.arrays_file import pack, unpack
from dosplan.system.files import FileError, write_bytes
from dosplan.system.folders import cache_folder
from dosplan.types import Scenario

MAX_BYTES: Final = 4 * 1024**3
"""Size that the whole cache keeps to, about."""
_FORMAT: Final = 8
_LIBRARIES: Final = ("networkx", "numpy", "scipy", "shapely")


def cached(ref: ScenarioRef, content: bytes, make: Callable[[], Scenario]) -> Scenario:
    """Reads an episode from the cache, or makes it and puts it there.

    Args:
        ref: The episode.
        content: What its file holds.
        make: Makes the scenario.

    Returns:
        The scenario, equal in every field to what ``make`` returns.
    """
    path = _entry(ref, content)
    with suppress(Exception):  # A damaged entry may raise anything; it is made anew.
        scenario = unpack(path.read_bytes(), Scenario)
        os.utime(path)
        return scenario
    scenario = make()
    with suppress(FileError, OSError):  # No room, no permission: it works without a cache.
        write_bytes(path, pack(scenario))
        _prune(path.parent)
    return scenario


def _entry(ref: ScenarioRef, content: bytes) -> Path:
    key = sha256(_code_digest().encode())
    key.update(f"{ref.id!r} {ref.problem_id} {len(content)}\n".encode())
    key.update(content)
    name = key.hexdigest()
    return cache_folder() / "scenarios" / name[:2] / f"{name[2:]}.npz"


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Fingerprints the code that makes a ``Scenario`` of a file."""
    package = Path(__file__).resolve().parents[1]
    modules = [package / "system" / "arrays_file.py"]
    for room in ("types", "geometry", "scenario"):
        modules += sorted(package.glob(f"{room}/**/*.py"))
    total = sha256(f"format {_FORMAT}\n".encode())
    for path in modules:
        total.update(path.name.encode() + sha256(path.read_bytes()).digest())
    for library in _LIBRARIES:
        total.update(f"{library} {version(library)}\n".encode())
    return total.hexdigest()


def _prune(folder: Path) -> None:
    found = [(entry.stat(), entry) for entry in folder.iterdir()]
    excess = sum(status.st_size for status, _ in found) - MAX_BYTES // 256
    for status, entry in sorted(found, key=lambda item: item[0].st_mtime):
        if excess <= 0:
            break
        entry.unlink(missing_ok=True)
        excess -= status.st_size
