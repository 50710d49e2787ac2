"""Lanelet2 maps (``.osm``) as lanelets in CommonRoad's sense.

The few elements that are needed are read here: Lanelet2's own reader comes as Linux wheels only,
and CommonRoad's converter (GPL) brings a graphical interface and thirty more packages.

Positions are what Lanelet2's UTM projector makes of latitude and longitude with its origin at
(0, 0), which is how the maps of SinD and INTERACTION are drawn.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from dosplan.scenario.commonroad.document import ScenarioError, parse_xml, read_file
from dosplan.scenario.commonroad.drafts import LaneletDraft
from dosplan.types import FloatArray

FIRST_ID: Final = 101
"""Id of the first lanelet; lights have lower ones."""
FARTHEST: Final = 0.01
"""Largest latitude and longitude, degrees: about 1 km, within which the projection is linear."""

_KINDS: Final[Mapping[str, str]] = {
    "bicycle_lane": "bicycleLane",
    "bus_lane": "busLane",
    "crosswalk": "crosswalk",
    "highway": "highway",
    "shared_walkway": "sidewalk",
    "stairs": "sidewalk",
    "walkway": "sidewalk",
}
"""CommonRoad lanelet types of Lanelet2's subtypes; whatever else is a street."""
_STREET: Final = "urban"
_USERS: Final[Mapping[str, tuple[str, ...]]] = {
    "bicycleLane": ("bicycle",),
    "busLane": ("bus",),
    "crosswalk": ("pedestrian",),
    "sidewalk": ("pedestrian",),
}
_VEHICLES: Final = ("vehicle",)
_CLOSE: Final = 0.01
"""Points nearer to each other than this along a bound are one, m."""


def _metres_per_degree() -> tuple[float, float]:
    """Lengths of a degree of longitude and of latitude at (0, 0) in UTM, m.

    (0, 0) lies in zone 31, three degrees west of its central meridian. There the point scale is
    k0 (1 + (1 + C) A^2 / 2 + (5 + 42 C + 13 C^2 - 28 e'^2) A^4 / 24), with A = 3 degrees in rad and
    C = e'^2 (Snyder, Map Projections, 1987, eq. 8-11 at latitude 0), the same in every direction,
    and the convergence is zero. On the ellipsoid a radian is a long along the equator and
    a (1 - e^2) along the meridian.
    """
    a, flattening, k0, offset = 6_378_137.0, 1.0 / 298.257223563, 0.9996, math.radians(3.0)
    e2 = flattening * (2.0 - flattening)
    c = e2 / (1.0 - e2)
    scale = k0 * (
        1.0
        + (1.0 + c) * offset**2 / 2.0
        + (5.0 + 42.0 * c + 13.0 * c**2 - 28.0 * c) * offset**4 / 24.0
    )
    return math.radians(scale * a), math.radians(scale * a * (1.0 - e2))


@dataclass(frozen=True)
class Lanelet2Map:
    """What is read of a map.

    Attributes:
        lanelets: The lanelets, ids from ``FIRST_ID`` on in the order of the file.
        lights: (2,) positions of the traffic lights whose names end in a number, by that number.
        middle: (2,) centre of the stop lines, or of all lanelets where there are none, m.
    """

    lanelets: tuple[LaneletDraft, ...]
    lights: Mapping[int, FloatArray]
    middle: FloatArray


@dataclass(frozen=True)
class _Way:
    """A line: the ids of its nodes, their positions (P, 2) and its tags."""

    nodes: tuple[str, ...]
    points: FloatArray
    tags: Mapping[str, str]

    def reversed(self) -> _Way:
        return _Way(self.nodes[::-1], self.points[::-1], self.tags)


@dataclass(frozen=True)
class _Lane:
    """A lanelet as the file has it, its bounds turned into its direction."""

    left: _Way
    right: _Way
    tags: Mapping[str, str]


_Side = tuple[LaneletDraft, str, bool]


def read_lanelet2(path: Path) -> Lanelet2Map:
    """Reads a map.

    Lanelets follow each other where both bounds end in the nodes in which the other's begin, and
    are neighbours where they share a bound, as in Lanelet2. Both bounds get a point beside each
    vertex of the other.

    Args:
        path: The ``.osm`` file.

    Returns:
        The map.

    Raises:
        ScenarioError: It cannot be used; one line that says why.
    """
    root = parse_xml(path, read_file(path))
    if root.tag != "osm":
        raise ScenarioError(path, f"is a <{root.tag}>, not a Lanelet2 map (<osm>)")
    points = dict(_node(path, node) for node in _elements(root, "node"))
    ways = {_name(way): _way(path, way, points) for way in _elements(root, "way")}
    lanes = [
        _lane(path, relation, ways)
        for relation in _elements(root, "relation")
        if _tags(relation).get("type") == "lanelet"
    ]
    if not lanes:
        raise ScenarioError(path, "holds no lanelet; name the map of the record")
    stops = [way.points for way in ways.values() if way.tags.get("type") == "stop_line"]
    around = stops or [side.points for lane in lanes for side in (lane.left, lane.right)]
    return Lanelet2Map(
        lanelets=tuple(_drafts(lanes)),
        lights={
            int(number[0]): np.asarray(way.points.mean(axis=0))
            for way in ways.values()
            if way.tags.get("type") == "traffic_light"
            and (number := re.findall(r"\d+$", way.tags.get("name", "")))
        },
        middle=np.mean([line.mean(axis=0) for line in around], axis=0),
    )


def _elements(root: Element, tag: str) -> list[Element]:
    # JOSM marks what was deleted and leaves it in the file.
    return [element for element in root.iterfind(tag) if element.get("action") != "delete"]


def _name(element: Element) -> str:
    return element.get("id", "")


def _tags(element: Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}


def _node(path: Path, node: Element) -> tuple[str, FloatArray]:
    try:
        place = np.array([float(node.get("lon", "")), float(node.get("lat", ""))])
    except ValueError:
        place = np.full(2, np.nan)
    if not np.all(np.abs(place) <= FARTHEST):
        raise ScenarioError(
            path,
            f"node {_name(node)} has no latitude and longitude within {FARTHEST} degrees of "
            "(0, 0); correct it",
        )
    return _name(node), place * _metres_per_degree()


def _way(path: Path, way: Element, points: Mapping[str, FloatArray]) -> _Way:
    nodes = tuple(node.get("ref", "") for node in way.iterfind("nd"))
    lost = [node for node in nodes if node not in points]
    if lost:
        raise ScenarioError(
            path, f"way {_name(way)} names node {lost[0]}, which is not there; fetch the map again"
        )
    return _Way(nodes, np.array([points[n] for n in nodes]).reshape(-1, 2), _tags(way))


def _lane(path: Path, relation: Element, ways: Mapping[str, _Way]) -> _Lane:
    bounds = []
    for role in ("left", "right"):
        found = [m.get("ref", "") for m in relation.iterfind("member") if m.get("role") == role]
        if len(found) != 1 or found[0] not in ways or len(ways[found[0]].nodes) < 2:
            raise ScenarioError(
                path,
                f"lanelet {_name(relation)} has no {role} bound of two points or more; correct it",
            )
        bounds.append(ways[found[0]])
    left, right = bounds
    # Bounds are drawn in any direction; as in Lanelet2, the left one has the other to its right.
    if _is_left(left.points, _halfway(right.points)):
        left = left.reversed()
    if not _is_left(right.points, _halfway(left.points)):
        right = right.reversed()
    return _Lane(left, right, _tags(relation))


def _halfway(line: FloatArray) -> FloatArray:
    """A point of a line away from its ends."""
    return np.asarray(line[len(line) // 2] if len(line) > 2 else line.mean(axis=0))


def _is_left(line: FloatArray, point: FloatArray) -> bool:
    """Whether a point lies to the left of the nearest part of a line."""
    along, towards = np.diff(line, axis=0), point - line[:-1]
    length = np.maximum(np.hypot(*along.T), 1e-9)
    share = np.clip(np.sum(towards * along, axis=1) / length**2, 0.0, 1.0)
    away = np.hypot(*(towards - share[:, None] * along).T)
    aside = (along[:, 0] * towards[:, 1] - along[:, 1] * towards[:, 0]) / length
    # At a vertex two parts are equally near; the one that the point is further aside of decides.
    nearest = np.flatnonzero(away <= away.min() + 1e-6)
    return bool(aside[nearest[np.argmax(np.abs(aside[nearest]))]] > 0.0)


def _drafts(lanes: list[_Lane]) -> list[LaneletDraft]:
    drafts = [_draft(number, lane) for number, lane in enumerate(lanes, FIRST_ID)]
    begins: defaultdict[tuple[str, str], list[LaneletDraft]] = defaultdict(list)
    # The lanelets on the right and on the left of each line, seen along it in one direction: the
    # lanelet, the name of its neighbour there, and whether it runs in that direction.
    beside: defaultdict[tuple[str, ...], tuple[list[_Side], list[_Side]]]
    beside = defaultdict(lambda: ([], []))
    for draft, lane in zip(drafts, lanes, strict=True):
        begins[lane.left.nodes[0], lane.right.nodes[0]].append(draft)
        for name, nodes in (
            ("adjacent_left", lane.left.nodes),
            ("adjacent_right", lane.right.nodes),
        ):
            line = min(nodes, nodes[::-1])
            along = nodes == line
            lies_left = along == (name == "adjacent_right")
            beside[line][lies_left].append((draft, name, along))
    for draft, lane in zip(drafts, lanes, strict=True):
        for after in begins[lane.left.nodes[-1], lane.right.nodes[-1]]:
            draft.successors.append(after.id)
            after.predecessors.append(draft.id)
    for right, left in beside.values():
        if len(right) == len(left) == 1:  # CommonRoad has no more than one neighbour on a side.
            (a, of_a, a_along), (b, of_b, b_along) = right[0], left[0]
            setattr(a, of_a, (b.id, a_along == b_along))
            setattr(b, of_b, (a.id, a_along == b_along))
    return drafts


def _draft(number: int, lane: _Lane) -> LaneletDraft:
    left, right = _side_by_side(lane.left.points, lane.right.points)
    kind = _KINDS.get(lane.tags.get("subtype", ""), _STREET)
    users = _USERS.get(kind, _VEHICLES)
    # Pedestrians walk in both directions, also where the map does not say so.
    if lane.tags.get("one_way") == "no" or users == ("pedestrian",):
        return LaneletDraft(number, left, right, kind, (), both_ways=users)
    return LaneletDraft(number, left, right, kind, users)


def _side_by_side(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two lines with a point at each share of the way at which either has one."""
    ways = [
        np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(x, axis=0).T))]) for x in (left, right)
    ]
    length = max(way[-1] for way in ways)
    shares = np.unique(np.concatenate([way / max(way[-1], 1e-9) for way in ways]))
    apart = np.concatenate([[True], np.diff(shares) * length > _CLOSE])
    shares = np.append(shares[apart][shares[apart] < 1.0 - _CLOSE / max(length, 1e-9)], 1.0)
    a, b = (
        np.column_stack([np.interp(shares * way[-1], way, line[:, k]) for k in (0, 1)])
        for way, line in zip(ways, (left, right), strict=True)
    )
    return a, b
