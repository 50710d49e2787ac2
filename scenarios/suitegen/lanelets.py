"""From a compiled SUMO network to lanelets, signals and intersections in CommonRoad's sense.

Every SUMO lane that vehicles use becomes one lanelet, every way through a junction another one.
Bounds are shared point by point: between neighbouring lanes, between the two directions of a road
and across the joints, so that the union of the lanelets has no slits.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import sumolib

from dosplan.scenario.commonroad.drafts import (
    Incoming,
    Intersection,
    LaneletDraft,
    LaneletMap,
    Light,
)
from dosplan.types import FloatArray

from .tapers import taper
from .traffic import STEP

EDGE_SPACING = 5.0
STRAIGHT_SPACING = 30.0
JUNCTION_SPACING = 1.5
TURN_WIDENING = 2.0
"""How much wider than its lane a turn is halfway, m; junctions would have holes without it."""
SAME_LINE = 0.6
"""Largest difference, m, between points of two bounds that are drawn as one."""

MIN_DISTANCE = 1e-3
"""Points nearer to each other than this are merged, m."""
INTERSECTION_ROADS = 3
"""Roads in, from which on a junction is an intersection; merges and roundabouts have fewer."""

DIRECTIONS = {"s": "straight", "l": "left", "L": "left", "r": "right", "R": "right"}
COLOURS = {"G": "green", "g": "green", "y": "yellow", "r": "red", "u": "redYellow", "s": "red"}


def resample(line: FloatArray, number: int) -> FloatArray:
    """A line with so many points at equal distances, m."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], number)
    return np.column_stack([np.interp(at, along, line[:, 0]), np.interp(at, along, line[:, 1])])


def _bounds(centre: FloatArray, half_width: FloatArray) -> tuple[FloatArray, FloatArray]:
    tangent = np.gradient(centre, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    aside = half_width[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    return centre + aside, centre - aside


def _join(bound: FloatArray, start: FloatArray, end: FloatArray) -> None:
    """Moves the ends of a bound to where its neighbours end, and what lies between with them."""
    share = np.linspace(0.0, 1.0, len(bound))[:, None]
    bound += (1.0 - share) * (start - bound[0]) + share * (end - bound[-1])


def _share(a: FloatArray, b: FloatArray) -> None:
    """Makes two bounds of the same length one line, in place."""
    middle = 0.5 * (a + b)
    a[:] = middle
    b[:] = middle


def _lane_kind(lane: Any) -> str:
    """``car``, ``bicycle`` or ``sidewalk``, by who may use it."""
    if lane.allows("passenger"):
        return "car"
    return "bicycle" if lane.allows("bicycle") else "sidewalk"


class _Converter:
    """Converts a network with ``run``; collects the lanelets."""

    def __init__(self, net: Any) -> None:
        self.net = net
        self.ids = count(1)
        self.of_lane: dict[str, LaneletDraft] = {}
        self.inside: dict[tuple[str, str], LaneletDraft] = {}
        self.links: dict[tuple[str, str], Any] = {}
        self.crossings: dict[str, list[LaneletDraft]] = defaultdict(list)
        self.tapers: list[LaneletDraft] = []
        self.lights: list[Light] = []

    def run(self) -> LaneletMap:
        edges = sorted(self.net.getEdges(withInternal=True), key=lambda edge: str(edge.getID()))
        roads = [edge for edge in edges if not edge.getFunction()]
        for edge in roads:
            self._edge(edge)
        self._opposites(roads)
        for edge in roads:
            for lane in edge.getLanes():
                if lane.getID() in self.of_lane:
                    self._links(lane)
        self._inside_neighbours()
        self._tapers()
        for edge in edges:
            if edge.getFunction() == "crossing":
                self._crossing(edge)
        self._signals()
        intersections = self._intersections()
        drafts = [*self.of_lane.values(), *self.inside.values(), *self.tapers]
        drafts.extend(draft for group in self.crossings.values() for draft in group)
        return LaneletMap(
            tuple(sorted(drafts, key=lambda draft: draft.id)),
            tuple(self.lights),
            intersections,
            self.ids,
        )

    def _edge(self, edge: Any) -> None:
        lanes = [lane for lane in edge.getLanes() if _lane_kind(lane) != "sidewalk"]
        spacing = STRAIGHT_SPACING if len(lanes[0].getShape()) == 2 else EDGE_SPACING
        # As many points as the other direction has, so that the two can share their line.
        twins = [e for e in edge.getToNode().getOutgoing() if e.getToNode() == edge.getFromNode()]
        length = max(e.getLength() for e in (edge, *twins))
        number = max(2, int(np.ceil(length / spacing)) + 1)
        drafts = []
        for lane in lanes:
            centre = resample(np.array(lane.getShape(), dtype=np.float64), number)
            left, right = _bounds(centre, np.full(number, 0.5 * lane.getWidth()))
            bicycle = _lane_kind(lane) == "bicycle"
            kind = "bicycleLane" if bicycle else str(edge.getType())
            users = ("bicycle",) if bicycle else ("vehicle",)
            draft = LaneletDraft(next(self.ids), left, right, kind, users, float(lane.getSpeed()))
            self.of_lane[lane.getID()] = draft
            drafts.append(draft)
        for right_one, left_one in pairwise(drafts):
            _share(right_one.left, left_one.right)
            right_one.adjacent_left = (left_one.id, True)
            left_one.adjacent_right = (right_one.id, True)

    def _opposites(self, roads: list[Any]) -> None:
        leftmost = {
            (e.getFromNode().getID(), e.getToNode().getID()): self.of_lane[e.getLanes()[-1].getID()]
            for e in roads
        }
        for (source, target), draft in leftmost.items():
            other = leftmost.get((target, source))
            if other is None or draft.id > other.id:
                continue
            if np.abs(draft.left - other.left[::-1]).max() > SAME_LINE:
                continue
            _share(draft.left, other.left[::-1])
            draft.adjacent_left = (other.id, False)
            other.adjacent_left = (draft.id, False)

    def _links(self, lane: Any) -> None:
        start = self.of_lane[lane.getID()]
        for link in lane.getOutgoing():
            end = self.of_lane.get(link.getToLane().getID())
            if end is None:
                continue
            line = self._way(lane, link)
            length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
            number = max(3, int(np.ceil(length / JUNCTION_SPACING)) + 1)
            widths = np.linspace(lane.getWidth(), link.getToLane().getWidth(), number)
            roads_in = len(lane.getEdge().getToNode().getIncoming())
            if roads_in >= INTERSECTION_ROADS and DIRECTIONS[link.getDirection()] != "straight":
                widths += TURN_WIDENING * np.sin(np.linspace(0.0, np.pi, number))
            left, right = _bounds(resample(line, number), 0.5 * widths)
            _join(left, start.left[-1], end.left[0])
            _join(right, start.right[-1], end.right[0])
            draft = LaneletDraft(next(self.ids), left, right, end.kind, end.users, end.speed)
            draft.predecessors.append(start.id)
            draft.successors.append(end.id)
            start.successors.append(draft.id)
            end.predecessors.append(draft.id)
            key = (lane.getID(), link.getToLane().getID())
            self.inside[key] = draft
            self.links[key] = link

    def _way(self, lane: Any, link: Any) -> FloatArray:
        """Middle of the way through a junction, m; SUMO may have cut it at a waiting position."""
        points = []
        via = link.getViaLaneID()
        while via:
            inner = self.net.getLane(via)
            points.extend(inner.getShape())
            via = inner.getOutgoing()[0].getViaLaneID()
        line = np.array(points or [lane.getShape()[-1], link.getToLane().getShape()[0]])
        apart = np.linalg.norm(np.diff(line, axis=0), axis=1) > MIN_DISTANCE
        return np.asarray(line[np.concatenate([[True], apart])], dtype=np.float64)

    def _inside_neighbours(self) -> None:
        """Joins the ways through a junction that run side by side between the same two edges."""
        for (source, target), draft in self.inside.items():
            beside = (_next_lane(source), _next_lane(target))
            other = self.inside.get(beside)
            if other is None:
                continue
            number = max(len(draft.left), len(other.left))
            for one in (draft, other):
                one.left, one.right = resample(one.left, number), resample(one.right, number)
            if np.abs(draft.left - other.right).max() > SAME_LINE:
                continue
            _share(draft.left, other.right)
            draft.adjacent_left = (other.id, True)
            other.adjacent_right = (draft.id, True)

    def _tapers(self) -> None:
        """Lets every lane run out that ends while the one beside it goes on."""
        drafts = {draft.id: draft for draft in (*self.of_lane.values(), *self.inside.values())}
        for ending in self.of_lane.values():
            beside = ending.adjacent_left or ending.adjacent_right
            if ending.successors or beside is None or not beside[1]:
                continue
            for way in (drafts[name] for name in drafts[beside[0]].successors):
                after = drafts[way.successors[0]]
                if ending.adjacent_left == beside:
                    inner, outer = np.vstack([way.right, after.right[1:]]), ending.right[-1]
                    left, right = taper(inner, outer)
                else:
                    inner, outer = np.vstack([way.left, after.left[1:]]), ending.left[-1]
                    right, left = taper(inner, outer)
                draft = LaneletDraft(
                    next(self.ids), left, right, ending.kind, ending.users, ending.speed
                )
                draft.predecessors.append(ending.id)
                ending.successors.append(draft.id)
                self.tapers.append(draft)

    def _crossing(self, edge: Any) -> None:
        (lane,) = edge.getLanes()
        centre = np.array(lane.getShape(), dtype=np.float64)
        left, right = _bounds(centre, np.full(len(centre), 0.5 * lane.getWidth()))
        walkers = ("pedestrian",)
        draft = LaneletDraft(next(self.ids), left, right, "crosswalk", (), both_ways=walkers)
        self.crossings[edge.getFromNode().getID()].append(draft)

    def _signals(self) -> None:
        cycles = {
            light.getID(): next(iter(light.getPrograms().values())).getPhases()
            for light in self.net.getTrafficLights()
        }
        seen: dict[tuple[str, str], int] = {}
        for (source, _), link in self.links.items():
            phases = cycles.get(link.getTLSID())
            direction = DIRECTIONS[link.getDirection()]
            if phases is None or (source, direction) in seen:
                continue
            cycle: list[tuple[str, int]] = []
            for phase in phases:
                colour = COLOURS[phase.state[link.getTLLinkIndex()]]
                steps = round(float(phase.duration) / STEP)
                if cycle and cycle[-1][0] == colour:
                    steps += cycle.pop()[1]
                cycle.append((colour, steps))
            draft = self.of_lane[source]
            light = Light(next(self.ids), draft.right[-1], direction, tuple(cycle))
            seen[source, direction] = light.id
            draft.lights.append(light.id)
            self.lights.append(light)

    def _intersections(self) -> tuple[Intersection, ...]:
        roads: dict[str, dict[str, list[tuple[str, str]]]] = defaultdict(lambda: defaultdict(list))
        for key, link in self.links.items():
            edge = link.getFromLane().getEdge()
            roads[edge.getToNode().getID()][edge.getID()].append(key)
        found = []
        for node, incoming_edges in sorted(roads.items()):
            if len(incoming_edges) < INTERSECTION_ROADS:
                continue
            incomings = []
            for _, keys in sorted(incoming_edges.items()):
                inside: dict[str, list[int]] = defaultdict(list)
                for key in keys:
                    draft = self.inside[key]
                    if draft.kind != "bicycleLane":
                        draft.kind = "intersection"
                    inside[DIRECTIONS[self.links[key].getDirection()]].append(draft.id)
                lanelets = sorted({self.of_lane[source].id for source, _ in keys})
                groups = {name: tuple(ids) for name, ids in inside.items()}
                incomings.append(Incoming(next(self.ids), tuple(lanelets), groups))
            crossings = tuple(draft.id for draft in self.crossings.get(node, []))
            found.append(Intersection(next(self.ids), tuple(incomings), crossings))
        return tuple(found)


def _next_lane(lane_id: str) -> str:
    edge, index = lane_id.rsplit("_", 1)
    return f"{edge}_{int(index) + 1}"


def convert(net: Path) -> LaneletMap:
    """Reads a compiled network.

    Args:
        net: The ``.net.xml``.

    Returns:
        Its lanelets, signals and intersections.
    """
    return _Converter(sumolib.net.readNet(str(net), withInternal=True, withPrograms=True)).run()
