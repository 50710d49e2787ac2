"""Streets of the suite: with a zebra crossing, an arterial, a grid, with parked cars.

Each builder takes a random generator for the geometry and a demand factor (1 is dense traffic).
"""

from __future__ import annotations

import numpy as np

from .plain import Crossing, Edge, Lane, Network, Node, Point, two_way
from .roads import (
    KMH,
    NO_BUS_MIX,
    URBAN_MIX,
    Flow,
    Parked,
    Rng,
    Road,
    Walk,
    all_pairs,
    arclength,
    bezier,
    draw_arm,
    end_heading,
    urban_lanes,
    winding,
)

HALF_PI = 0.5 * np.pi


def pedestrian_crossing(rng: Rng, demand: float) -> Road:
    """A street with a zebra crossing between junctions."""
    heading = float(rng.uniform(-np.pi, np.pi))
    bend = float(rng.choice([-1, 1]) * rng.uniform(0.002, 0.006))
    lanes = tuple(urban_lanes(rng, 1, sidewalk=True))
    line = winding((0.0, 0.0), heading, [(150.0, bend), (60.0, 0.0), (150.0, -bend)])
    middle = int(np.argmin([abs(arclength(line, i) - 180.0) for i in range(len(line))]))
    nodes = (Node("w", line[0]), Node("z", line[middle], "crossing"), Node("e", line[-1]))
    speed = 50 * KMH
    edges = (
        *two_way("a", "w", "z", line[: middle + 1], lanes, speed),
        *two_way("b", "z", "e", line[middle:], lanes, speed),
    )
    rate = 480.0 * demand
    return Road(
        Network(nodes, edges, crossings=(Crossing("z", ("a+", "a-"), 4.0),)),
        (Flow("a+", "b+", rate, URBAN_MIX), Flow("b-", "a-", rate, URBAN_MIX)),
        (line[middle],),
        (Walk("a+", "a-", 200.0), Walk("a-", "b+", 200.0), Walk("b+", "a-", 100.0)),
        tags=("urban", "two_lane", "oncoming_traffic"),
    )


def arterial(rng: Rng, demand: float) -> Road:
    """A curved main road of two or three lanes each way with signals at two side streets."""
    count = int(rng.integers(2, 4))
    lanes = tuple(urban_lanes(rng, count))
    speed = float(rng.choice([50, 60, 70])) * KMH
    heading = float(rng.uniform(-np.pi, np.pi))
    bend = float(rng.choice([-1, 1]) / rng.uniform(250.0, 500.0))
    spacing = float(rng.uniform(130.0, 170.0))
    lengths = (150.0, spacing, 150.0)
    pieces: list[tuple[Point, ...]] = []
    start: Point = (0.0, 0.0)
    for length in lengths:
        piece = winding(start, heading, [(25.0, 0.0), (length - 50.0, bend), (25.0, 0.0)])
        pieces.append(piece)
        start, heading = piece[-1], end_heading(piece)
        bend = -bend
    names = ("w", "j0", "j1", "e")
    spots = (pieces[0][0], pieces[1][0], pieces[2][0], pieces[2][-1])
    nodes = [
        Node(name, spot, "traffic_light" if name.startswith("j") else "priority", 8.0)
        for name, spot in zip(names, spots, strict=True)
    ]
    edges: list[Edge] = []
    for i, piece in enumerate(pieces):
        edges.extend(two_way(f"m{i}", names[i], names[i + 1], piece, lanes, speed, 4))
    inward, outward = ["m0+", "m2-"], ["m0-", "m2+"]
    for i in range(2):
        road = end_heading(pieces[i])
        for k, side in enumerate((HALF_PI, -HALF_PI)):
            arm = draw_arm(
                rng, road + side + float(rng.uniform(-0.2, 0.2)), urban_lanes(rng, 1), 0, 1
            )
            shape = arm.shape(nodes[i + 1].position)
            name = f"s{i}{k}"
            nodes.append(Node(f"n{name}", shape[-1]))
            edges.extend(two_way(name, names[i + 1], f"n{name}", shape, arm.lanes, 50 * KMH, 2))
            inward.append(f"{name}-")
            outward.append(f"{name}+")
    flows = (
        Flow("m0+", "m2+", 430.0 * count * demand, URBAN_MIX),
        Flow("m2-", "m0-", 430.0 * count * demand, URBAN_MIX),
        *all_pairs(inward, outward, 170.0 * demand),
    )
    return Road(
        Network(tuple(nodes), tuple(edges)),
        flows,
        spots[1:3],
        tags=("urban", "intersection", "multi_lane"),
    )


def grid(rng: Rng, demand: float) -> Road:
    """An irregular 3 x 3 grid of 30 km/h streets, each junction with its own rule."""
    pitch, turn = float(rng.uniform(75.0, 95.0)), float(rng.uniform(-np.pi, np.pi))
    lanes = tuple(urban_lanes(rng, 1))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    spots: dict[tuple[int, int], Point] = {}
    nodes: list[Node] = []
    for i in range(5):
        for j in range(5):
            outer = (i in (0, 4)) + (j in (0, 4))
            if outer == 2:
                continue
            at = rotation @ (pitch * (np.array([i, j]) - 2.0) + rng.uniform(-9.0, 9.0, 2))
            spots[i, j] = (float(at[0]), float(at[1]))
            kinds = ["right_before_left", "right_before_left", "priority", "traffic_light"]
            kind = "priority" if outer else str(rng.choice(kinds))
            nodes.append(Node(f"g{i}{j}", spots[i, j], kind, 5.0))
    edges: list[Edge] = []
    inward, outward = [], []
    for (i, j), spot in spots.items():
        for other in ((i + 1, j), (i, j + 1)):
            rim = [i in (0, 4) or j in (0, 4), other[0] in (0, 4) or other[1] in (0, 4)]
            if other not in spots or all(rim):
                continue
            name = f"s{i}{j}{other[0]}{other[1]}"
            level = 2 if j == other[1] else 1
            bow = float(rng.uniform(-0.12, 0.12))
            straight = float(np.arctan2(spots[other][1] - spot[1], spots[other][0] - spot[0]))
            shape = bezier(spot, straight + bow, spots[other], straight - bow)
            edges.extend(
                two_way(name, f"g{i}{j}", f"g{other[0]}{other[1]}", shape, lanes, 30 * KMH, level)
            )
            if any(rim):
                inward.append(f"{name}{'+' if rim[0] else '-'}")
                outward.append(f"{name}{'-' if rim[0] else '+'}")
    return Road(
        Network(tuple(nodes), tuple(edges)),
        all_pairs(inward, outward, 300.0 * demand, NO_BUS_MIX),
        tuple(spots[i, j] for i in (1, 2, 3) for j in (1, 2, 3)),
        tags=("urban", "intersection"),
    )


def narrow_street(rng: Rng, demand: float) -> Road:
    """A one-way street with parked cars on both sides, some of which pull out."""
    width = round(float(rng.uniform(5.4, 6.0)), 2)
    bend = float(rng.choice([-1, 1]) * rng.uniform(0.001, 0.004))
    heading = float(rng.uniform(-np.pi, np.pi))
    lane = Lane(width, "car")
    arrival = winding((0.0, 0.0), heading, [(60.0, bend)])
    street = winding(arrival[-1], end_heading(arrival), [(90.0, -bend), (90.0, bend)])
    leave = winding(street[-1], end_heading(street), [(70.0, -bend)])
    spots = (arrival[0], street[0], leave[0], leave[-1])
    nodes = tuple(Node(f"s{i}", spot, "priority", 1.0) for i, spot in enumerate(spots))
    edges = tuple(
        Edge(name, f"s{i}", f"s{i + 1}", (lane,), 30 * KMH, line)
        for i, (name, line) in enumerate(
            (("arrive", arrival), ("street", street), ("leave", leave))
        )
    )
    parked: list[Parked] = []
    position, side = float(rng.uniform(12.0, 18.0)), -1.0
    while position < 170.0:
        until = float(rng.uniform(60.0, 200.0)) if rng.random() < 0.25 else None
        # 0.95 m: half a car's width; the kerb is just beside it.
        parked.append(Parked("street", "leave", position, side * (0.5 * width - 0.95), until))
        position += float(rng.uniform(6.5, 14.0))
        if rng.random() < 0.35:
            side = -side
            position += 12.0
    flows = (Flow("arrive", "leave", 650.0 * demand, NO_BUS_MIX),)
    return Road(
        Network(nodes, edges),
        flows,
        street,
        parked=tuple(parked),
        tags=("urban", "single_lane"),
    )
