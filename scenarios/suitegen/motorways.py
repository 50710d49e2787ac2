"""Carriageways of the suite: on-ramp, lane drop and weaving section.

Each builder takes a random generator for the geometry and a demand factor (1 is dense traffic).
"""

from __future__ import annotations

import numpy as np

from .plain import Connection, Edge, Lane, Network, Node, Point
from .roads import KMH, MOTORWAY_MIX, Flow, Rng, Road, end_heading, shifted, winding


def _motorway_line(rng: Rng, lengths: tuple[float, ...]) -> list[tuple[Point, ...]]:
    """Consecutive pieces of one gently curved line."""
    curvature = float(rng.choice([-1, 1]) / rng.uniform(700.0, 2500.0))
    start: Point = (0.0, 0.0)
    heading = float(rng.uniform(-np.pi, np.pi))
    pieces = []
    for length in lengths:
        piece = winding(start, heading, [(length, curvature)], spacing=12.0)
        pieces.append(piece)
        start, heading = piece[-1], heading + length * curvature
    return pieces


def _through(source: str, target: str, count: int, first: int = 0, to: int = 0) -> list[Connection]:
    return [Connection(source, target, first + i, to + i) for i in range(count)]


def _ramp(at: Point, heading: float, offset: float, length: float, way: int) -> tuple[Point, ...]:
    """Line of a ramp that touches the carriageway at ``at``, ``offset`` to its right.

    ``way`` is -1 for an on-ramp (the line ends there) and 1 for an off-ramp (it begins there).
    """
    right = heading - 0.5 * np.pi
    foot: Point = (at[0] + offset * float(np.cos(right)), at[1] + offset * float(np.sin(right)))
    outward = heading if way > 0 else heading + np.pi
    curvature = -way / 260.0
    line = winding(foot, outward, [(12.0, 0.0), (55.0, curvature), (length - 67.0, -curvature / 3)])
    return line if way > 0 else line[::-1]


def on_ramp(rng: Rng, demand: float) -> Road:
    """A motorway on which traffic merges from an acceleration lane."""
    count, width = int(rng.integers(2, 4)), round(float(rng.uniform(3.5, 3.75)), 2)
    speed = float(rng.choice([80, 100, 120])) * KMH
    before, merge, after = _motorway_line(rng, (260.0, float(rng.uniform(170.0, 240.0)), 260.0))
    lane = Lane(width, "motor")
    ramp = _ramp(merge[0], end_heading(before), count * width, 180.0, -1)
    nodes = (
        Node("w", before[0]),
        Node("m", merge[0], "priority", 1.0),
        Node("d", after[0], "priority", 1.0),
        Node("e", after[-1]),
        Node("r", ramp[0]),
    )
    lanes, kind = (lane,) * count, "highway"
    edges = (
        Edge("main", "w", "m", lanes, speed, before, 5, kind),
        Edge("merge", "m", "d", (lane, *lanes), speed, merge, 5, kind),
        Edge("out", "d", "e", lanes, speed, after, 5, kind),
        Edge("ramp", "r", "m", (lane,), min(speed, 80 * KMH), ramp, 3, "accessRamp"),
    )
    links = (
        *_through("main", "merge", count, to=1),
        *_through("ramp", "merge", 1),
        *_through("merge", "out", count, first=1),
    )
    flows = (
        Flow("main", "out", 1300.0 * count * demand, MOTORWAY_MIX),
        Flow("ramp", "out", 750.0 * demand, MOTORWAY_MIX),
    )
    return Road(
        Network(nodes, edges, links),
        flows,
        merge,
        tags=("highway", "merging_lanes", "multi_lane"),
    )


def lane_drop(rng: Rng, demand: float) -> Road:
    """A carriageway that loses its right or its left lane."""
    count, width = int(rng.integers(1, 3)), round(float(rng.uniform(3.3, 3.6)), 2)
    speed = float(rng.choice([60, 80, 100])) * KMH
    before, after = _motorway_line(rng, (330.0, 300.0))
    drop_left = bool(rng.random() < 0.5)
    reference = shifted(before, width) if drop_left else before
    lane = Lane(width, "motor")
    nodes = (
        Node("w", reference[0]),
        Node("d", after[0], "priority", 1.0),
        Node("e", after[-1]),
    )
    edges = (
        Edge("wide", "w", "d", (lane,) * (count + 1), speed, reference, 5, "highway"),
        Edge("narrow", "d", "e", (lane,) * count, speed, after, 5, "highway"),
    )
    links = _through("wide", "narrow", count, first=0 if drop_left else 1)
    flow = Flow("wide", "narrow", (1500.0 + 1400.0 * count) * demand, MOTORWAY_MIX)
    return Road(
        Network(nodes, edges, tuple(links)),
        (flow,),
        before[-8:],
        tags=("highway", "merging_lanes", "parallel_lanes"),
    )


def weaving(rng: Rng, demand: float) -> Road:
    """A motorway with a lane that joins an on-ramp to the next off-ramp."""
    count, width = int(rng.integers(2, 4)), round(float(rng.uniform(3.5, 3.75)), 2)
    speed = float(rng.choice([80, 100])) * KMH
    before, weave, after = _motorway_line(rng, (230.0, float(rng.uniform(190.0, 260.0)), 230.0))
    lane = Lane(width, "motor")
    inward = _ramp(weave[0], end_heading(before), count * width, 170.0, -1)
    outward = _ramp(weave[-1], end_heading(weave), count * width, 170.0, 1)
    nodes = (
        Node("w", before[0]),
        Node("m", weave[0], "priority", 1.0),
        Node("d", weave[-1], "priority", 1.0),
        Node("e", after[-1]),
        Node("r", inward[0]),
        Node("x", outward[-1]),
    )
    lanes, kind = (lane,) * count, "highway"
    edges = (
        Edge("main", "w", "m", lanes, speed, before, 5, kind),
        Edge("weave", "m", "d", (lane, *lanes), speed, weave, 5, kind),
        Edge("out", "d", "e", lanes, speed, after, 5, kind),
        Edge("in", "r", "m", (lane,), 70 * KMH, inward, 3, "accessRamp"),
        Edge("off", "d", "x", (lane,), 70 * KMH, outward, 3, "exitRamp"),
    )
    links = (
        *_through("main", "weave", count, to=1),
        *_through("in", "weave", 1),
        *_through("weave", "out", count, first=1),
        *_through("weave", "off", 1),
    )
    flows = (
        Flow("main", "out", 950.0 * count * demand, MOTORWAY_MIX),
        Flow("main", "off", 550.0 * demand, MOTORWAY_MIX),
        Flow("in", "out", 650.0 * demand, MOTORWAY_MIX),
    )
    return Road(
        Network(nodes, edges, links),
        flows,
        weave,
        tags=("highway", "merging_lanes", "multi_lane", "lane_change"),
    )
