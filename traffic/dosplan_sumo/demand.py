"""What SUMO is given: a network that was looked at, and a demand without what is not traffic.

SUMO trusts its files: it follows inclusions, writes files that detectors and devices name, and some
broken networks end its process. So none of them reaches it as it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element, tostring

import numpy as np

from dosplan.scenario import ScenarioError
from dosplan.scenario.commonroad.document import parse_xml
from dosplan.scenario.sources.sumo import SumoFiles, read_xml
from dosplan.types import FloatArray

EGO_PREFIX: Final = "egoVehicle"
"""How vehicles of a demand are called that stand for an ego, in CommonRoad's files."""
START: Final = "dosplan.start"
"""Parameter of such a vehicle: SUMO's time at which the ego starts, s."""

_VEHICLES: Final = ("vehicle", "trip")
_USERS: Final = (*_VEHICLES, "person")
_KEPT: Final = frozenset(
    {
        *_USERS,
        "busStop",
        "flow",
        "parkingArea",
        "personFlow",
        "route",
        "routeDistribution",
        "stop",
        "tlLogic",
        "trainStop",
        "vType",
        "vTypeDistribution",
    }
)
_WRITERS: Final = ("device.", "has.", "file")
"""How parameters begin that make SUMO write something."""


@dataclass(frozen=True)
class Demand:
    """The road users that files of SUMO tell of.

    Attributes:
        files: The cleaned files, those with types and stops first.
        users: Names of vehicles and persons, in the order of the files; not those of flows.
        egos: Names of those that stand for an ego.
        start: SUMO's time at which the ego starts, s; None where the files do not tell.
        routes: Sequences of edges, the most common first.
        ends: Edges at which somebody leaves, the most common first.
        types: Names of types by SUMO's class, the first of each.
    """

    files: tuple[Path, ...]
    users: tuple[str, ...]
    egos: tuple[str, ...]
    start: float | None
    routes: tuple[tuple[str, ...], ...]
    ends: tuple[str, ...]
    types: dict[str, str]


def read_offset(path: Path) -> FloatArray:
    """Looks at a network before SUMO reads it.

    Args:
        path: The network.

    Returns:
        (2,) what was added to its original coordinates, m.

    Raises:
        ScenarioError: It is none, or makes SUMO read or write other files.
    """
    status = path.stat()
    return _offset(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=64)
def _offset(path: Path, _: int, __: int) -> FloatArray:
    root = parse_xml(path, read_xml(path))
    if root.tag != "net":
        raise ScenarioError(path, f"is a <{root.tag}>, not a network of SUMO")
    location = root.find("location")
    if location is None or root.find("edge/lane") is None:
        raise ScenarioError(path, "is a network without <location> or lanes; make it anew")
    if root.find(".//include") is not None:
        raise ScenarioError(path, "includes another file, which is refused; write it as one")
    for logic in root.iterfind("tlLogic"):
        for parameter in logic.iterfind("param"):
            if parameter.get("key", "").startswith(_WRITERS):
                raise ScenarioError(
                    path,
                    f"has traffic light {logic.get('id')} write a file, which is refused; remove "
                    f"its <param> {parameter.get('key')}",
                )
    try:
        offset = np.array([float(part) for part in location.get("netOffset", "").split(",")])
        if offset.shape != (2,) or not np.isfinite(offset).all():
            raise ValueError
    except ValueError:
        raise ScenarioError(path, "has no netOffset of two numbers; make it anew") from None
    return offset


def read_demand(files: SumoFiles) -> list[tuple[Path, Element]]:
    """Reads the demand, without what is not traffic.

    Args:
        files: The files.

    Returns:
        Each file with its cleaned root, those with types and stops first.

    Raises:
        ScenarioError: One of them is none of SUMO's.
    """
    read = []
    for path in (*files.additional, *files.routes):
        root = parse_xml(path, read_xml(path))
        if root.tag not in ("routes", "additional"):
            raise ScenarioError(path, f"is a <{root.tag}>, no demand of SUMO")
        for element in list(root):
            if element.tag not in _KEPT:
                root.remove(element)
        _without_writers(root)
        read.append((path, root))
    return read


def write_demand(read: Iterable[tuple[Path, Element]], folder: Path) -> Demand:
    """Writes a demand for SUMO.

    Args:
        read: As ``read_demand`` gives it.
        folder: Where the files go.

    Returns:
        What is in it.

    Raises:
        ScenarioError: It says no number where the ego starts.
    """
    files, users, egos = [], [], []
    routes: Counter[tuple[str, ...]] = Counter()
    ends: Counter[str] = Counter()
    types: dict[str, str] = {}
    start = None
    for number, (path, root) in enumerate(read):
        files.append(folder / f"{number}.{'rou' if root.tag == 'routes' else 'add'}.xml")
        files[-1].write_bytes(tostring(root))
        for kind in root.iter("vType"):
            types.setdefault(kind.get("vClass", "passenger"), kind.get("id", ""))
        for edges in _routes(root):
            routes[edges] += 1
            ends[edges[-1]] += 1
        for user in root:
            if user.tag in _VEHICLES and "to" in user.attrib:
                ends[user.attrib["to"]] += 1
            if user.tag in _USERS:
                users.append(user.get("id", ""))
            if user.tag in _VEHICLES and users[-1].startswith(EGO_PREFIX):
                egos.append(users[-1])
                start = _start(path, user) if start is None else start
    return Demand(
        files=tuple(files),
        users=tuple(users),
        egos=tuple(egos),
        start=start,
        routes=tuple(edges for edges, _ in routes.most_common()),
        ends=tuple(edge for edge, _ in ends.most_common()),
        types=types,
    )


def _without_writers(element: Element) -> None:
    for child in list(element):
        writes = child.tag == "param" and child.get("key", "").startswith(_WRITERS)
        if writes or child.tag == "include":
            element.remove(child)
        else:
            _without_writers(child)


def _routes(root: Element) -> Iterator[tuple[str, ...]]:
    """Every route that names its edges; one that several vehicles share counts once."""
    for route in root.iter("route"):
        if edges := tuple(route.get("edges", "").split()):
            yield edges


def _start(path: Path, vehicle: Element) -> float | None:
    for parameter in vehicle.iterfind("param"):
        if parameter.get("key") == START:
            try:
                return float(parameter.get("value", ""))
            except ValueError:
                raise ScenarioError(path, f"gives {START} no number; correct it") from None
    return None
