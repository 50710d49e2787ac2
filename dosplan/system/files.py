"""Writes files so that a reader never sees an incomplete one."""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import IO, Any, Final
from urllib.parse import quote

from dosplan.system.errors import DosplanError

_LONGEST_NAME: Final = 200  # File systems allow 255 bytes; endings need some of them.
_HALF: Final = ".part"  # Ends the name of a file that is being written.


class FileError(DosplanError, RuntimeError):
    """A file of a run that cannot be written, or is not what it should be; one line."""


def file_name(name: str) -> str:
    """Makes a file name of any text: what is unsafe in one is quoted, what is too long is cut.

    Args:
        name: The text.

    Returns:
        A name without folder and ending; two texts do not have the same one.
    """
    data = name.encode(errors="surrogatepass")  # It may be that of a file name.
    safe = quote(data, safe="@")
    if len(safe) <= _LONGEST_NAME:
        return safe
    digest = sha256(data).hexdigest()[:16]
    return f"{safe[: _LONGEST_NAME - len(digest) - 1]}-{digest}"


@contextmanager
def atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """Opens a file that takes its name only when the block ends without an exception.

    Args:
        path: The file to write; a file of that name is replaced. Its folder is made. A device or
            a pipe is written straight.

    Yields:
        A binary file to write to.

    Raises:
        FileError: It cannot be written (no room, no permission, ...).
    """
    # With the process id, two runs that write to one folder by mistake do not use one file.
    temporary = path.with_name(f".{path.name}.{os.getpid()}{_HALF}")
    try:
        if _is_stream(path):
            with path.open("wb") as stream:
                yield stream
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.unlink(missing_ok=True)  # Never write through a link that stands there.
            with temporary.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror or error}") from error


def _is_stream(path: Path) -> bool:
    """Whether a path stands for a device or a pipe, or, as /dev/stdout, for an open file."""
    try:
        mode = path.stat().st_mode
        folder = path.parent.resolve()
    except OSError:
        return False
    ordinary = stat.S_ISREG(mode) or stat.S_ISDIR(mode)
    return not ordinary or folder == Path("/dev") or folder.parts[:2] == ("/", "proc")


def remove_half_written(folder: Path, name: str = "*") -> None:
    """Removes the incomplete files of writers that were killed.

    Args:
        folder: The folder; no process may be writing to it.
        name: Pattern of the files that were to be written.
    """
    for path in folder.glob(f".{name}.*{_HALF}"):
        path.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> None:
    """Writes a file, whole or not at all.

    Args:
        path: The file.
        data: What to write.

    Raises:
        FileError: It cannot be written.
    """
    with atomic_file(path) as file:
        file.write(data)


def write_text(path: Path, text: str) -> None:
    """Writes a text file, whole or not at all.

    Args:
        path: The file.
        text: What to write; what UTF-8 cannot hold (of a file name, say) becomes a "?".

    Raises:
        FileError: It cannot be written.
    """
    write_bytes(path, text.encode(errors="replace"))


def write_json(path: Path, value: Any) -> None:
    """Writes a JSON file, whole or not at all.

    Args:
        path: The file.
        value: What ``json`` can write; NaN and infinity are refused, as JSON has neither.

    Raises:
        FileError: It cannot be written.
        ValueError: The value holds a NaN.
    """
    write_text(path, json_text(value))


def json_text(value: Any) -> str:
    """Writes a value as the text of a JSON file.

    Args:
        value: What ``json`` can write; NaN and infinity are refused, as JSON has neither.

    Returns:
        The text, with its last line break.

    Raises:
        ValueError: The value holds a NaN.
    """
    return json.dumps(value, indent=2, allow_nan=False) + "\n"


def parse_json(text: str | bytes) -> Any:
    """Reads the text of a JSON file.

    Args:
        text: The text.

    Returns:
        Its value.

    Raises:
        ValueError: It is not JSON, or holds NaN, infinity, or a float that is too large.
        RecursionError: It is nested too deeply.
    """
    return json.loads(text, parse_float=_finite, parse_constant=_finite)


def read_json(path: Path) -> Any:
    """Reads a JSON file.

    Args:
        path: The file.

    Returns:
        Its value.

    Raises:
        FileError: It is missing, cannot be read or is not JSON.
    """
    try:
        return parse_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileError(f"{path} is missing") from None
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path} is not JSON: {error}") from None


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text:.20} is not a finite number")
    return number
