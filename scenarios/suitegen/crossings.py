"""Junctions of the suite: 4-way, T, with cycle lanes, with signals and roundabouts.

Each builder takes a random generator for the geometry and a demand factor (1 is dense traffic).
"""

from __future__ import annotations

import numpy as np

from .plain import Crossing, Edge, Lane, Network, Node, Point
from .roads import (
    KMH,
    NO_BUS_MIX,
    Flow,
    Rng,
    Road,
    Walk,
    all_pairs,
    bezier,
    draw_angles,
    draw_arm,
    star,
    urban_lanes,
    ways,
    winding,
)

HALF_PI = 0.5 * np.pi


def signalised_crossing(rng: Rng, demand: float) -> Road:
    """A 4-way crossing with signals, sidewalks and pedestrian crossings."""
    angles = draw_angles(rng, (0.0, HALF_PI, np.pi, 3 * HALF_PI), 0.2)
    counts = [int(rng.integers(1, 3)), int(rng.integers(1, 3))]
    speed = 50 * KMH
    arms = [
        draw_arm(rng, angle, urban_lanes(rng, counts[i % 2], sidewalk=True), speed, 2)
        for i, angle in enumerate(angles)
    ]
    centre = Node("c", (0.0, 0.0), "traffic_light", float(rng.uniform(7.0, 10.0)))
    nodes, edges = star(centre, arms)
    crossings = tuple(Crossing("c", (f"a{i}+", f"a{i}-"), 4.0) for i in range(4))
    sources, targets = ways(4)
    walks = tuple(Walk(f"a{i}-", f"a{(i + k) % 4}+", 70.0) for i in range(4) for k in (1, 2, 3))
    return Road(
        Network(tuple(nodes), tuple(edges), crossings=crossings),
        all_pairs(sources, targets, 550.0 * demand),
        (centre.position,),
        walks,
        tags=("urban", "intersection"),
    )


def plain_crossing(rng: Rng, demand: float) -> Road:
    """A 4-way crossing without signals: right before left, or a main road that has priority."""
    angles = draw_angles(rng, (0.0, HALF_PI, np.pi, 3 * HALF_PI), 0.25)
    equal = bool(rng.random() < 0.5)
    speed = (30 if equal else 50) * KMH
    arms = [
        draw_arm(rng, angle, urban_lanes(rng, 1), speed, 1 if equal else 3 - 2 * (i % 2))
        for i, angle in enumerate(angles)
    ]
    kind = "right_before_left" if equal else "priority"
    centre = Node("c", (0.0, 0.0), kind, float(rng.uniform(5.0, 8.0)))
    nodes, edges = star(centre, arms)
    sources, targets = ways(4)
    return Road(
        Network(tuple(nodes), tuple(edges)),
        all_pairs(sources, targets, 380.0 * demand),
        (centre.position,),
        tags=("urban", "intersection"),
    )


def t_junction(rng: Rng, demand: float) -> Road:
    """A side road that meets a curved main road."""
    angles = draw_angles(rng, (0.0, np.pi + rng.uniform(-0.3, 0.3), HALF_PI), 0.15)
    speeds = (60 * KMH, 60 * KMH, 40 * KMH)
    arms = [
        draw_arm(rng, angle, urban_lanes(rng, 1), speed, 3 if i < 2 else 1)
        for i, (angle, speed) in enumerate(zip(angles, speeds, strict=True))
    ]
    centre = Node("c", (0.0, 0.0), "priority", float(rng.uniform(7.0, 11.0)))
    nodes, edges = star(centre, arms)
    sources, targets = ways(3)
    return Road(
        Network(tuple(nodes), tuple(edges)),
        all_pairs(sources, targets, 420.0 * demand),
        (centre.position,),
        tags=("urban", "intersection"),
    )


def cycle_crossing(rng: Rng, demand: float) -> Road:
    """A crossing whose main road has cycle lanes beside the car lanes."""
    angles = draw_angles(rng, (0.0, HALF_PI, np.pi, 3 * HALF_PI), 0.15)
    arms = [
        draw_arm(rng, angle, urban_lanes(rng, 1, cycle=i % 2 == 0), 50 * KMH, 3 - 2 * (i % 2))
        for i, angle in enumerate(angles)
    ]
    centre = Node("c", (0.0, 0.0), "priority", float(rng.uniform(7.0, 10.0)))
    nodes, edges = star(centre, arms)
    sources, targets = ways(4)
    bicycles = {"bicycle": 1.0}
    cyclists = (
        Flow("a0-", "a2+", 330.0, bicycles),
        Flow("a2-", "a0+", 330.0, bicycles),
        Flow("a0-", "a1+", 60.0, bicycles),
        Flow("a2-", "a3+", 60.0, bicycles),
    )
    return Road(
        Network(tuple(nodes), tuple(edges)),
        all_pairs(sources, targets, 380.0 * demand, NO_BUS_MIX) + cyclists,
        (centre.position,),
        tags=("urban", "intersection"),
    )


def roundabout(rng: Rng, demand: float) -> Road:
    """A one-lane roundabout with 3 to 5 arms; each arm's lanes part around a splitter island."""
    arms = int(rng.integers(3, 6))
    radius = float(rng.uniform(15.0, 21.0))
    width = round(float(rng.uniform(4.0, 4.6)), 2)
    spread = float(rng.uniform(0.30, 0.36)) * 18.0 / radius
    angles = sorted(
        a % (2 * np.pi) for a in draw_angles(rng, 2 * np.pi * np.arange(arms) / arms, 0.15)
    )
    lanes = (Lane(3.4, "car"),)
    ring = (Lane(width, "car"),)
    nodes: list[Node] = []
    edges: list[Edge] = []
    around: list[tuple[str, float]] = []
    for i, angle in enumerate(angles):
        length, bend = float(rng.uniform(110.0, 150.0)), float(rng.uniform(-0.5, 0.5))
        gate: Point = (float((radius + 32) * np.cos(angle)), float((radius + 32) * np.sin(angle)))
        # Right-hand traffic turns counter-clockwise: it meets an arm's exit before its entry.
        for name, at in ((f"x{i}", angle - spread), (f"e{i}", angle + spread)):
            nodes.append(Node(name, (radius * np.cos(at), radius * np.sin(at)), "priority", 6.0))
            around.append((name, at))
        far = winding(gate, angle, [(length, bend / length)])
        nodes.append(Node(f"n{i}", far[-1]))
        ex, en = nodes[-3].position, nodes[-2].position
        exit_heading = angle - spread + 0.5 * np.pi - 0.75
        entry_heading = angle + spread + 0.5 * np.pi + 0.75
        out = bezier(ex, exit_heading, gate, angle)
        into = bezier(gate, angle + np.pi, en, entry_heading)
        edges.append(Edge(f"a{i}+", f"x{i}", f"n{i}", lanes, 40 * KMH, out + far[1:]))
        edges.append(Edge(f"a{i}-", f"n{i}", f"e{i}", lanes, 40 * KMH, far[:0:-1] + into))
    for (name, at), (after, until) in zip(around, around[1:] + around[:1], strict=True):
        sweep = (until - at) % (2 * np.pi)
        turn = at + np.linspace(0.0, sweep, max(4, int(sweep * radius / 2.5)))
        arc = tuple((float(radius * np.cos(t)), float(radius * np.sin(t))) for t in turn)
        edges.append(Edge(f"r{name}", name, after, ring, 30 * KMH, arc, priority=5))
    sources, targets = ways(arms)
    return Road(
        Network(tuple(nodes), tuple(edges)),
        all_pairs(sources, targets, 430.0 * demand),
        tuple((radius * np.cos(at), radius * np.sin(at)) for _, at in around),
        tags=("urban", "roundabout"),
    )
