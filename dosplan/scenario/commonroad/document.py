"""Scenario files as text, and the checks on them before they are read.

Files are not trusted: document types and entities are refused, and so are files that are something
else.
"""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from dosplan.system.errors import DosplanError

VERSIONS: Final = ("2018b", "2020a")
SUFFIXES: Final = (".xml", ".xml.gz")
"""Endings of scenario files, in lower or upper case."""
MAX_BYTES: Final = 512 * 1024 * 1024
_ENDING: Final = re.compile(r"(\.xml)?(\.gz)?$", re.IGNORECASE)
_CHUNK: Final = 1 << 16
_KEPT: Final = 1 << 16
"""Files of which is kept what ``scan`` found, some 30 MB at most."""
_PROTOBUF: Final = (
    "is a protocol buffer, not XML; write it as XML with commonroad-io "
    "(CommonRoadFileReader, then CommonRoadFileWriter)"
)
_DOCTYPE: Final = "it has a document type (DOCTYPE), which is refused; remove the declaration"


class ScenarioError(DosplanError, ValueError):
    """A scenario that cannot be used: one line naming the file, what is wrong and what to do."""

    def __init__(self, path: Path | str, problem: str) -> None:
        super().__init__(" ".join(f"{path}: {problem}".split()))


@dataclass(frozen=True)
class Document:
    """A scenario file that passed the checks on its text.

    Attributes:
        path: The file.
        root: The parsed tree.
    """

    path: Path
    root: ElementTree.Element


def read_file(path: Path) -> bytes:
    """Content of a scenario file as it lies there, compressed or not.

    Args:
        path: The file.

    Returns:
        Its bytes.

    Raises:
        ScenarioError: It cannot be read or is larger than ``MAX_BYTES``.
    """
    try:
        if path.exists() and not path.is_file():  # Reading a pipe might never return.
            raise ScenarioError(path, "is not a regular file; remove it")
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise _unreadable(path, error) from None
    return _within_limit(path, data)


def unpacked(path: Path, data: bytes) -> bytes:
    """The XML of a ``.xml`` or ``.xml.gz`` file.

    Args:
        path: The file.
        data: Its content.

    Returns:
        Its (decompressed) content.

    Raises:
        ScenarioError: It cannot be decompressed, or is larger than ``MAX_BYTES`` then.
    """
    if path.suffix.lower() != ".gz":
        return data
    try:
        with gzip.open(io.BytesIO(data)) as stream:
            return _within_limit(path, stream.read(MAX_BYTES + 1))
    except (OSError, EOFError, zlib.error) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> ScenarioError:
    reason = getattr(error, "strerror", None) or str(error)
    return ScenarioError(path, f"cannot be read ({reason}); fetch the file again")


def _within_limit(path: Path, data: bytes) -> bytes:
    if len(data) > MAX_BYTES:
        raise ScenarioError(path, f"holds more than {MAX_BYTES} bytes; split it")
    return data


def scan(path: Path) -> tuple[str, str, tuple[int, ...]]:
    """Root tag, benchmark id and planning-problem ids, without building a tree.

    A file on this machine is read again only if it has changed: a sweep lists its scenarios for
    each of its runs.

    Args:
        path: The file.

    Returns:
        The three; the benchmark id is empty where the file names none, and there are no
        planning-problem ids where it holds no more than one.

    Raises:
        ScenarioError: The file cannot be read or is not XML.
    """
    if type(path) is not type(Path()):  # Behind a URL, where nothing tells that it has changed.
        return _scan(path)
    try:
        found = path.stat()
    except OSError as error:
        raise _unreadable(path, error) from None
    return _scan_unchanged(
        str(path), found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns
    )


@lru_cache(maxsize=_KEPT)
def _scan_unchanged(path: str, *_: int) -> tuple[str, str, tuple[int, ...]]:
    return _scan(Path(path))


def _scan(path: Path) -> tuple[str, str, tuple[int, ...]]:
    header: list[tuple[str, str]] = []
    problems: list[int] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if not header:
            header.append((tag, attributes.get("benchmarkID", "")))
            if single:  # A call for each element takes most of the time.
                parser.StartElementHandler = None
        elif tag == "planningProblem":
            problems.append(_problem_id(attributes.get("id")))

    data = unpacked(path, read_file(path))
    # In an encoding in which neither would be found, both are absent.
    single = b"<commonRoad" in data and data.count(b"<planningProblem") < 2
    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = _doctype
    _parse(path, lambda: parser.Parse(data, True))
    return (*header[0], tuple(problems))


class _FoundError(Exception):
    """Ends a parse that has found what it looks for."""


def scan_tags(path: Path) -> frozenset[str]:
    """Tags of a scenario, without reading on behind them.

    Args:
        path: The file.

    Returns:
        The tags, such as ``highway``.

    Raises:
        ScenarioError: The file cannot be read or is not XML.
    """
    tags: list[str] = []
    listed = root = False

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal listed, root
        if not root and "tags" in attributes:  # So they are written in files of 2018.
            tags.extend(attributes["tags"].split())
            raise _FoundError
        root = True
        if listed:
            tags.append(tag)
        listed = listed or tag == "scenarioTags"

    def end(tag: str) -> None:
        if tag == "scenarioTags":
            raise _FoundError

    data = unpacked(path, read_file(path))
    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = _doctype
    with suppress(_FoundError):
        _parse(path, lambda: parser.Parse(data, True))
    return frozenset(tags)


def _problem_id(text: str | None) -> int:
    try:
        return int(text or "")
    except ValueError:
        raise ValueError(
            f"a planning problem has the id '{(text or '')[:40]}'; give it a whole number"
        ) from None


def has_ending(name: str) -> bool:
    """Whether a file has the ending of a scenario file.

    Args:
        name: Its name.

    Returns:
        Whether it has one of ``SUFFIXES``.
    """
    return name.lower().endswith(SUFFIXES)


def stem(path: Path) -> str:
    """The name of a scenario file without its ending.

    Args:
        path: The file.

    Returns:
        The name without ``.xml`` or ``.xml.gz``.
    """
    return _ENDING.sub("", path.name)


def read_document(path: Path, content: bytes) -> Document:
    """Parses and checks a scenario file.

    Args:
        path: A ``.xml`` or ``.xml.gz`` file.
        content: What it holds, as ``read_file`` gives it.

    Returns:
        The document.

    Raises:
        ScenarioError: The file is not a CommonRoad scenario that can be used.
    """
    if path.suffix.lower() == ".pb":
        raise ScenarioError(path, _PROTOBUF)
    root = parse_xml(path, unpacked(path, content))
    problem = _objection(root)
    if problem is not None:
        raise ScenarioError(path, problem)
    return Document(path, root)


def parse_xml(path: Path, data: bytes) -> ElementTree.Element:
    """Parses XML of unknown origin safely.

    Args:
        path: The file, for messages.
        data: What it holds, decompressed.

    Returns:
        The root of the tree.

    Raises:
        ScenarioError: It is no XML, or has a document type.
    """
    _parse(path, lambda: _refuse_doctype(data))
    # Safe: what the known attacks need has just been refused.
    root: ElementTree.Element = _parse(path, lambda: ElementTree.fromstring(data))  # noqa: S314
    return root


def _refuse_doctype(data: bytes) -> None:
    """Looks for a document type where one may stand: before the root element."""
    begun = False

    def start(*_: object) -> None:
        nonlocal begun
        begun = True

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = _doctype
    for first in range(0, len(data), _CHUNK):
        parser.Parse(data[first : first + _CHUNK])
        if begun:
            return


def _doctype(*_: object) -> NoReturn:
    raise ValueError(_DOCTYPE)


def _parse(path: Path, parse: Callable[[], Any]) -> Any:
    try:
        return parse()
    except ScenarioError:
        raise
    except (ElementTree.ParseError, expat.ExpatError) as error:
        raise ScenarioError(path, f"is not complete XML ({error}); fetch it again") from None
    except (ValueError, KeyError, LookupError) as error:
        raise ScenarioError(path, f"cannot be used: {error}") from None


def _objection(root: ElementTree.Element) -> str | None:
    """Why the file cannot be used, or None."""
    version = root.get("commonRoadVersion")
    checks = (
        (root.tag != "commonRoad", f"is a <{root.tag}>, not a CommonRoad scenario"),
        (version is None, f"names no commonRoadVersion; it may be {' or '.join(VERSIONS)}"),
        (
            version not in VERSIONS,
            f"has CommonRoad version {version}; convert it to {' or '.join(VERSIONS)}",
        ),
        (not root.get("benchmarkID"), "has no benchmarkID; add one to its root element"),
        (root.find("lanelet") is None, "has no lanelets; a scenario needs a map"),
        (
            root.find(".//occupancySet") is not None or root.find("phantomObstacle") is not None,
            "has set-based predictions; only recorded trajectories can be replayed",
        ),
    )
    return next((message for applies, message in checks if applies), None)
