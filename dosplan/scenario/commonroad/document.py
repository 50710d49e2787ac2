"""Scenario files as text: reading them safely and making them fit for commonroad-io.

A file comes from anywhere, so nothing of it is trusted: document types and entities are refused,
and so are files that are not what they claim to be. What commonroad-io cannot express is put
right in the tree before it sees the file.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from dosplan.system.errors import DosplanError

VERSIONS: Final = ("2018b", "2020a")
SUFFIXES: Final = (".xml", ".xml.gz")
MAX_BYTES: Final = 512 * 1024 * 1024

MAX_NUMBER: Final = 1e9
"""Largest number that a file may hold; what is larger is no length, step or speed."""
MAX_ANGLE: Final = 1e3
"""Largest orientation, rad; commonroad-io turns it back by one turn at a time."""
_DOCTYPE: Final = "it has a document type (DOCTYPE), which is refused; remove the declaration"


class ScenarioError(DosplanError, ValueError):
    """A scenario that cannot be used: one line naming the file, what is wrong and what to do."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(" ".join(f"{path}: {problem}".split()))


@dataclass(frozen=True)
class Document:
    """A scenario file that passed the checks on its text.

    Attributes:
        path: The file.
        root: The parsed tree.
        data: The XML that commonroad-io is handed.
        derived: Per obstacle id, the fields (``orientation``, ``velocity``) its initial state
            leaves out; ``data`` holds zeros in their place.
        two_way: Ids of the lanelets that may be driven in both directions.
    """

    path: Path
    root: ElementTree.Element
    data: bytes
    derived: dict[int, frozenset[str]]
    two_way: frozenset[int]


class _Builder(ElementTree.TreeBuilder):
    """Refuses a document type, and with it every entity, before anything of it is expanded."""

    def doctype(self, *_: object) -> NoReturn:
        raise ValueError(_DOCTYPE)


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
        if path.exists() and not path.is_file():  # A pipe could keep us waiting for ever.
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
    if path.suffix != ".gz":
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


def scan(path: Path) -> tuple[str, str, list[int]]:
    """Root tag, benchmark id and planning-problem ids, without building a tree.

    Args:
        path: The file.

    Returns:
        The three; the benchmark id is empty where the file names none, and the list where it
        holds no more than one planning problem.

    Raises:
        ScenarioError: The file cannot be read or is not XML.
    """
    header: list[tuple[str, str]] = []
    problems: list[int] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if not header:
            header.append((tag, attributes.get("benchmarkID", "")))
            if single:  # A call for each element takes most of the time.
                parser.StartElementHandler = None
        elif tag == "planningProblem":
            problems.append(int(attributes["id"]))

    def doctype(*_: object) -> NoReturn:
        raise ValueError(_DOCTYPE)

    data = unpacked(path, read_file(path))
    # In an encoding in which neither would be found, both are absent.
    single = b"<commonRoad" in data and data.count(b"<planningProblem") < 2
    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = doctype
    _parse(path, lambda: parser.Parse(data, True))
    return (*header[0], problems)


def read_document(path: Path, content: bytes) -> Document:
    """Checks and completes a scenario file.

    Completed, because commonroad-io reads it wrongly or not at all: exact values in goal states
    become intervals of no length; an initial state that leaves out a field gets a zero for it,
    since the reader stops at the first field it misses and drops the rest.

    Args:
        path: A ``.xml`` or ``.xml.gz`` file.
        content: What it holds, as ``read_file`` gives it.

    Returns:
        The document.

    Raises:
        ScenarioError: The file is not a CommonRoad scenario that can be used.
    """
    data = unpacked(path, content)
    root = parse_xml(path, data)
    problem = _objection(root)
    if problem is not None:
        raise ScenarioError(path, problem)
    changed, derived = _complete(path, root)
    return Document(
        path=path,
        root=root,
        data=ElementTree.tostring(root) if changed else data,
        derived=derived,
        two_way=frozenset(
            _id(path, lanelet)
            for lanelet in root.findall("lanelet")
            if lanelet.find("userBidirectional") is not None
        ),
    )


def parse_xml(path: Path, data: bytes) -> ElementTree.Element:
    """Parses foreign XML safely.

    Args:
        path: The file, for messages.
        data: What it holds, decompressed.

    Returns:
        The root of the tree.

    Raises:
        ScenarioError: It is no XML, or has a document type.
    """
    # Safe on foreign text: _Builder refuses the declarations that the known attacks need.
    parser = ElementTree.XMLParser(target=_Builder())  # noqa: S314
    root: ElementTree.Element = _parse(
        path,
        lambda: ElementTree.fromstring(data, parser=parser),  # noqa: S314
    )
    return root


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
    """What speaks against using the file, or None."""
    version = root.get("commonRoadVersion")
    lanelets = Counter(lanelet.get("id") for lanelet in root.findall("lanelet"))
    repeated = [str(name) for name, times in lanelets.items() if times > 1]
    not_finite = [x for x in root.iter() if not _size(x) <= MAX_NUMBER]
    turned = [x for angle in root.iter("orientation") for x in angle.iter()]
    checks = (
        (root.tag != "commonRoad", f"is a <{root.tag}>, not a CommonRoad scenario"),
        (
            version not in VERSIONS,
            f"has CommonRoad version {version}; convert it to {' or '.join(VERSIONS)}",
        ),
        (not root.get("benchmarkID"), "has no benchmarkID; add one to its root element"),
        (not lanelets, "has no lanelets; a scenario needs a map"),
        (bool(repeated), f"names lanelet {', '.join(repeated)} twice; give it another id"),
        (
            root.find(".//occupancySet") is not None or root.find("phantomObstacle") is not None,
            "has set-based predictions; only recorded trajectories can be replayed",
        ),
        (
            bool(not_finite),
            f"holds {len(not_finite)} values that are not finite numbers up to {MAX_NUMBER:g} "
            f"(first in <{not_finite[0].tag if not_finite else ''}>); correct them",
        ),
        (
            any(_size(x) > MAX_ANGLE for x in turned),
            f"holds an <orientation> of more than {MAX_ANGLE:g} rad; correct it",
        ),
        (
            _goes_round(root, "adjacentLeft") or _goes_round(root, "adjacentRight"),
            "has lanelets that are each other's neighbours on the same side; correct them",
        ),
    )
    return next((message for applies, message in checks if applies), None)


def _size(element: ElementTree.Element) -> float:
    """The absolute value of the number in an element, 0 where it holds none."""
    try:
        return abs(float(element.text or ""))
    except ValueError:
        return 0.0


def _goes_round(root: ElementTree.Element, side: str) -> bool:
    """Whether the way from neighbour to neighbour leads back; commonroad-io follows it for ever."""
    beside = {
        lanelet.get("id"): neighbour.get("ref")
        for lanelet in root.iterfind("lanelet")
        if (neighbour := lanelet.find(side)) is not None and neighbour.get("drivingDir") == "same"
    }
    while beside:
        begun, here = beside.popitem()
        way = {begun}
        while here in beside:
            way.add(here)
            here = beside.pop(here)
        if here in way:
            return True
    return False


def _complete(path: Path, root: ElementTree.Element) -> tuple[bool, dict[int, frozenset[str]]]:
    changed = False
    for goal in root.iterfind("planningProblem/goalState"):
        for field in goal:
            exact = field.find("exact")
            if field.tag != "position" and exact is not None:
                for tag in ("intervalStart", "intervalEnd"):
                    ElementTree.SubElement(field, tag).text = exact.text
                field.remove(exact)
                changed = True
    for state in root.iterfind("planningProblem/initialState"):
        absent = [tag for tag in ("position", "orientation", "velocity") if state.find(tag) is None]
        if absent:
            raise ScenarioError(path, f"gives the ego no initial {absent[0]}; add it")
        changed |= bool(_fill(state, ("acceleration",)))
    derived = {}
    for tag in ("obstacle", "staticObstacle", "dynamicObstacle"):
        for obstacle in root.iterfind(tag):
            states = obstacle.findall("initialState")
            absent = [name for s in states for name in _fill(s, ("orientation", "velocity"))]
            if absent:
                derived[_id(path, obstacle)] = frozenset(absent)
    return changed or bool(derived), derived


def _id(path: Path, element: ElementTree.Element) -> int:
    text = element.get("id", "")
    try:
        return int(text)
    except ValueError:
        raise ScenarioError(
            path, f"has a <{element.tag}> of id '{text}'; give it a whole number"
        ) from None


def _fill(state: ElementTree.Element, tags: tuple[str, ...]) -> list[str]:
    """Adds a zero for each field that is absent and returns their names."""
    absent = [tag for tag in tags if state.find(tag) is None]
    for tag in absent:
        field = ElementTree.SubElement(state, tag)
        ElementTree.SubElement(field, "exact").text = "0.0"
    return absent
