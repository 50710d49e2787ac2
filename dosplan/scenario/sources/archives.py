"""Archives of scenarios: unpacked once, into the cache, and read from there.

The folder is named by the archive's content, so that a run that is resumed, its workers and the
next run find the same files; on a cluster, the cache has to be on a file system that all see.

Archives are not trusted: only regular files with the ending of a scenario, of its futures, or of
what SUMO drives its traffic from, are written, each inside the folder, and no more than
``MAX_UNPACKED`` bytes of them. An archive that breaks one of these rules is refused as a whole,
before any of it is read. A member of a ``.zip`` that is damaged becomes an empty file, and so a row
that fails like any broken file.
"""

from __future__ import annotations

import json
import lzma
import os
import shutil
import stat
import tarfile
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from hashlib import file_digest
from pathlib import Path
from typing import IO, Final

from dosplan.scenario.commonroad.document import MAX_BYTES, ScenarioError, has_ending
from dosplan.scenario.sources.futures import is_of_futures
from dosplan.scenario.sources.sumo import is_of_sumo
from dosplan.system.folders import cache_folder

MAX_UNPACKED: Final = 16 * 1024**3
"""Bytes that the members of an archive may have in all."""
MAX_MEMBERS: Final = 1_000_000
KEPT_SECONDS: Final = 30 * 24 * 3600.0
"""How long after its last use an unpacked archive is removed."""

_TAR: Final = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
ENDINGS: Final = (".zip", *_TAR)
_KINDS: Final = ".4"
"""Changes with the kinds of files that are written."""
_LISTING: Final = "listing.json"
_ENCRYPTED: Final = 0x1
_DAMAGED: Final = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError)


@dataclass(frozen=True)
class _Member:
    """One entry of an archive; ``read`` gives its bytes, but no more than it is asked for.

    What is neither a folder nor a regular file cannot be read.
    """

    name: str
    size: int
    is_folder: bool
    read: Callable[[int], bytes] | None


def is_archive(path: Path) -> bool:
    """Whether a file is taken for an archive, by its name.

    Args:
        path: The file.

    Returns:
        Whether it is.
    """
    return path.name.lower().endswith(ENDINGS)


def is_scenario(name: str) -> bool:
    """Whether a file of a folder or an archive is taken for a scenario, by its name.

    Args:
        name: Its name, without the folder.

    Returns:
        Whether it has the ending of one, is not hidden, and not SUMO's.
    """
    return has_ending(name) and not name.startswith(".") and not is_of_sumo(name)


def unpacked(archive: Path) -> Path:
    """Unpacks the scenario files of an archive, where that was not done before.

    Args:
        archive: A ``.zip`` or ``.tar`` file, the latter also compressed.

    Returns:
        The folder that holds them.

    Raises:
        ScenarioError: The archive is broken, breaks a rule of this module, or cannot be unpacked.
    """
    try:
        with archive.open("rb") as stream:
            digest = file_digest(stream, "sha256").hexdigest()[:32]
            place = cache_folder() / "archives" / f"{digest}{_KINDS}"
            if not _whole(place):
                stream.seek(0)
                _unpack(archive, stream, place)
        os.utime(place)  # What is used is kept.
        _prune(place.parent)
    except ScenarioError:
        raise
    # On a damaged archive, the libraries can raise almost anything.
    except (tarfile.TarError, *_DAMAGED, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise ScenarioError(
            archive,
            f"cannot be unpacked into {cache_folder()} ({reason}); "
            "fetch it again, or unpack it yourself",
        ) from error
    return place


def _unpack(archive: Path, stream: IO[bytes], place: Path) -> None:
    """Unpacks beside its place, which a folder takes only when it is complete."""
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(place, ignore_errors=True)  # One of which files are gone.
    folder = Path(tempfile.mkdtemp(prefix=".", dir=place.parent))
    try:
        members = _tar(stream) if archive.name.lower().endswith(_TAR) else _zip(archive, stream)
        sizes = _write(archive, members, folder)
        (folder / _LISTING).write_text(json.dumps(sizes))
        folder.chmod(0o755)  # For the workers of a cluster that run as another user.
        try:
            folder.rename(place)
        except OSError:
            if not _whole(place):  # Another process has just unpacked it, too.
                raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write(archive: Path, members: Iterator[_Member], folder: Path) -> dict[str, int]:
    """Writes the scenario files and returns their sizes."""
    root, sizes = folder.resolve(), {}
    total = 0
    for count, member in enumerate(members, start=1):
        total += member.size
        if total > MAX_UNPACKED or count > MAX_MEMBERS:
            raise ScenarioError(
                archive,
                f"holds more than {MAX_UNPACKED} bytes or {MAX_MEMBERS} members; split it",
            )
        name = member.name.rpartition("/")[2]
        wanted = is_scenario(name) or is_of_sumo(name) or is_of_futures(member.name)
        if member.is_folder or not wanted:
            continue
        place = (root / member.name).resolve()
        if not place.is_relative_to(root):
            raise ScenarioError(
                archive, f"would write outside of its folder ({member.name}); do not trust it"
            )
        if member.read is None:
            raise ScenarioError(
                archive, f"holds something that is no regular file ({member.name}); remove it"
            )
        name = place.relative_to(root).as_posix()
        if name in sizes:
            raise ScenarioError(archive, f"holds {name} twice; remove one of them")
        # One byte more than a scenario may have, so that the file is refused when it is read.
        data = member.read(MAX_BYTES + 1)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(data)
        sizes[name] = len(data)
    return sizes


def _zip(archive: Path, stream: IO[bytes]) -> Iterator[_Member]:
    with zipfile.ZipFile(stream) as file:
        for info in file.infolist():
            if info.flag_bits & _ENCRYPTED:
                raise ScenarioError(archive, "is encrypted; unpack it yourself")
            regular = stat.S_IFMT(info.external_attr >> 16) in (0, stat.S_IFREG)
            read = partial(_of_zip, file, info) if regular else None
            yield _Member(info.filename, info.file_size, info.is_dir(), read)


def _of_zip(file: zipfile.ZipFile, info: zipfile.ZipInfo, size: int) -> bytes:
    try:
        with file.open(info) as member:
            return member.read(size)
    except _DAMAGED:
        return b""


def _tar(stream: IO[bytes]) -> Iterator[_Member]:
    try:
        # Not as a stream ("r|*"), which takes a compressed file that is cut between two members for
        # one that ends there.
        file = tarfile.open(fileobj=stream, mode="r:*")  # noqa: SIM115
    except tarfile.ReadError:  # Its message has a line for each compression.
        raise tarfile.ReadError("it is no archive") from None
    with file:
        for info in file:
            content = file.extractfile(info) if info.isreg() else None
            read = None if content is None else content.read
            yield _Member(info.name, info.size, info.isdir(), read)


def _whole(folder: Path) -> bool:
    """Whether a folder holds all that was unpacked into it."""
    try:
        sizes = json.loads((folder / _LISTING).read_text())
        return all((folder / name).stat().st_size == size for name, size in sizes.items())
    except (OSError, ValueError):
        return False


def _prune(folder: Path) -> None:
    for place in folder.iterdir():
        with suppress(FileNotFoundError):  # Another process does the same.
            if place.stat().st_mtime < time.time() - KEPT_SECONDS:
                shutil.rmtree(place, ignore_errors=True)
