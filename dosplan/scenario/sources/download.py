"""Files behind http(s) URLs: fetched into the cache, and again only where they have changed."""

from __future__ import annotations

import json
from hashlib import sha256
from http.client import HTTPException, HTTPResponse
from pathlib import Path, PurePosixPath
from typing import IO, Final
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

from dosplan.scenario.commonroad.document import SUFFIXES, ScenarioError
from dosplan.scenario.sources.archives import ENDINGS
from dosplan.system.files import FileError, atomic_file, file_name, write_text
from dosplan.system.folders import cache_folder

SCHEMES: Final = ("http://", "https://")
TIMEOUT: Final = 60.0
"""How long a server may stay silent, s."""
MAX_DOWNLOAD: Final = 16 * 1024**3
"""Bytes that a file may have."""
_CHUNK: Final = 1 << 20
_UNCHANGED: Final = 304
_MARKS: Final = {"ETag": "If-None-Match", "Last-Modified": "If-Modified-Since"}


def downloaded(url: str) -> Path:
    """Fetches a file, where the copy in the cache is not what the server has.

    Args:
        url: A URL that begins with one of ``SCHEMES``; the last part of its path is the file's
            name, by whose ending it is taken for a scenario or an archive.

    Returns:
        The copy.

    Raises:
        ScenarioError: The server does not give the file, or the cache cannot be written.
    """
    try:
        told = unquote(PurePosixPath(urlsplit(url).path).name) or "index"
    except ValueError as error:
        raise _refused(url, f"it is no URL: {error}") from None
    # What is too long is cut, but for the ending, which says what the file is.
    ending = next((end for end in (*SUFFIXES, *ENDINGS) if told.lower().endswith(end)), "")
    name = file_name(told[: len(told) - len(ending)]) + ending
    folder = cache_folder() / "downloads" / sha256(url.encode()).hexdigest()[:32]
    copy, marks = folder / name, folder / "marks.json"
    request = Request(url, headers=_known(copy, marks))  # noqa: S310 - one of SCHEMES
    try:
        with urlopen(request, timeout=TIMEOUT) as answer:  # noqa: S310 - one of SCHEMES
            with atomic_file(copy) as stream:
                _copy(answer, stream)
            found = {back: answer.headers[mark] for mark, back in _MARKS.items()}
        write_text(marks, json.dumps({back: mark for back, mark in found.items() if mark}))
    except HTTPError as error:
        if error.code == _UNCHANGED:
            return copy
        raise _refused(url, f"the server answers {error.code} {error.reason}") from None
    except (FileError, OSError, HTTPException, ValueError) as error:
        reason = getattr(error, "reason", None) if isinstance(error, URLError) else error
        raise _refused(url, str(reason)) from None
    return copy


def _copy(answer: HTTPResponse, stream: IO[bytes]) -> None:
    """Writes what a server sends.

    Raises:
        ValueError: It is too much, or less than the server has announced: the connection was cut;
            or nothing for too long.
    """
    announced = int(answer.headers.get("Content-Length", -1))
    total = 0
    while chunk := _read(answer):
        total += len(chunk)
        if total > MAX_DOWNLOAD:
            raise ValueError(f"it has more than {MAX_DOWNLOAD} bytes")
        stream.write(chunk)
    if announced not in (-1, total):
        raise ValueError(f"it was cut off after {total} of {announced} bytes")


def _read(answer: HTTPResponse) -> bytes:
    try:
        return answer.read(_CHUNK)
    except OSError as error:  # No fault of the file that is written.
        raise ValueError(f"the server went silent: {error}") from None


def _known(copy: Path, marks: Path) -> dict[str, str]:
    """Request headers that name the cached copy; empty where there is none."""
    try:
        return dict(json.loads(marks.read_text())) if copy.is_file() else {}
    except (OSError, ValueError):
        return {}


def _refused(url: str, reason: str) -> ScenarioError:
    return ScenarioError(url, f"cannot be fetched ({reason}); fetch it yourself")
