"""Kinds of narrow town streets: a bus at its stop, and oncoming traffic beside parked cars."""

from __future__ import annotations

import numpy as np
from dosplan_sumo.script import Action, Verb

from suitegen.futures.staging import Act, Actor, Kind, Spot, Staging, Stop
from suitegen.plain import Connection, Edge, Lane, Network, Node, Point, two_way
from suitegen.roads import KMH, Rng, Road, winding

from .drivers import DRIVERS, EXACT, STAND_IN, draw, pick
from .pace import BRANCH, LEAD_IN, paced, paced_scene, released, started

TAGS = ("urban", "two_lane", "oncoming_traffic")


def bus_stop(rng: Rng) -> Staging:
    """A bus in its bay beside the ego's lane pulls out before the ego, behind it, or stays."""
    limit = float(rng.choice([40, 50])) * KMH
    ego = draw(rng, (0.88, 1.0)) * limit
    curvature = float(rng.choice([-1, 1]) / draw(rng, (250.0, 800.0)))
    width, bay = round(draw(rng, (3.1, 3.4)), 2), round(draw(rng, (2.8, 3.0)), 2)
    heading, start = draw(rng, (-np.pi, np.pi)), (0.0, 0.0)
    lengths = (130.0, draw(rng, (52.0, 65.0)), 160.0)
    lines: list[tuple[Point, ...]] = []
    for length in lengths:
        line = winding(start, heading, [(length, curvature)])
        lines.append(line)
        start, heading = line[-1], heading + length * curvature
    names = ("w", "b", "c", "e")
    spots = (lines[0][0], lines[1][0], lines[2][0], lines[2][-1])
    lane = Lane(width, "car")
    forward = [(lane,), (Lane(bay, "car"), lane), (lane,)]
    edges: list[Edge] = []
    for i, (line, lanes) in enumerate(zip(lines, forward, strict=True)):
        edges.append(Edge(f"road{i}+", names[i], names[i + 1], lanes, limit, line))
        edges.append(Edge(f"road{i}-", names[i + 1], names[i], (lane,), limit, line[::-1]))
    links = (
        Connection("road0+", "road1+", 0, 1),
        Connection("road1+", "road2+", 1, 0),
        Connection("road2-", "road1-", 0, 0),
        Connection("road1-", "road0-", 0, 0),
    )
    nodes = tuple(
        Node(name, spot, "priority", 1.0) for name, spot in zip(names, spots, strict=True)
    )
    size = (round(draw(rng, (11.5, 12.5)), 2), 2.5)
    gain, share = draw(rng, DRIVERS.bus_start), draw(rng, DRIVERS.bus_angle)
    aside = 0.5 * (width + bay) - 0.5 * (2.5 + 1.61)
    overlap = float(np.sqrt(2.0 * aside / (share * gain)))
    """From the bus's start until its side is in the ego's way, s."""
    meets = overlap + BRANCH + draw(rng, (0.4, 1.6))
    """After the start, s: when the ego's front would be beside the bus's."""
    front = draw(rng, (24.0, 30.0))
    passes = lengths[0] + front
    at = passes - ego * (LEAD_IN + meets)
    cast = [
        Actor("ego", "ego", ("road0+", "road1+", "road2+"), at, ego, driver=STAND_IN),
        Actor(
            "bus", "bus", ("road1+", "road2+"), front, 0.0, lane=0, size=size,
            stops=(Stop(Spot("road1+", front)),),
            driver={
                "sigma": "0", "speedFactor": "1", "accel": f"{gain:.2f}", "maxSpeedLat": "1.3",
                "lcMaxSpeedLatStanding": "0.02", "lcMaxSpeedLatFactor": f"{share:.2f}",
                "lcAccelLat": "2",
            },
        ),
    ]  # fmt: skip
    speeds = {"ego": ego}
    beyond = sum(lengths) - passes
    for index in range(3):
        # One is beside the bus as the ego is; the others follow it.
        name = f"oncoming{index}"
        place = beyond - ego * (LEAD_IN + meets - draw(rng, (0.2, 0.8)) - 2.0 * index)
        if place > 6.0:
            route = ("road2-", "road1-", "road0-")
            cast.append(Actor(name, "car", route, place, ego, driver=EXACT))
            speeds[name] = ego

    def future(k: int, rng: Rng) -> Act:
        shares = {"pulls out": 0.4, "pulls out early": 0.1, "lets pass": 0.2, "stays": 0.3}
        intention = pick(rng, shares)
        when = meets - overlap - draw(rng, (-0.25, 0.25)) - BRANCH
        goes_on = released(meets + 1.0 - BRANCH)
        if intention == "pulls out early":
            when = draw(rng, (0.0, 0.3)) * max(when, 0.0)
        elif intention == "lets pass":
            when = meets + draw(rng, (1.8, 2.8)) - BRANCH
        when = max(when, 0.0)
        acts: tuple[Action, ...] = ()
        if intention != "stays":
            acts = (Action(when, "bus", Verb.START), Action(when + 0.1, "bus", Verb.LANE, 1))
        slow_down = Action(0.0, "ego", Verb.BRAKE, 0.62 * ego, 1.5)
        return Act(intention, (slow_down, *acts, *goes_on))

    network = Network(nodes, tuple(edges), links)
    goal = Spot("road2+", at + ego * (LEAD_IN + 7.2) - lengths[0] - lengths[1])
    return paced_scene(network, TAGS, cast, speeds, future, goal, 14.0)


def _beside(line: tuple[Point, ...], at: np.ndarray, aside: np.ndarray) -> tuple[Point, ...]:
    """Points at arc lengths along a line, so many metres to its left, m."""
    points = np.asarray(line)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    x, y = (np.interp(at, along, column) for column in points.T)
    tangent = np.gradient(points, axis=0)
    angle = np.interp(at, along, np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])))
    moved = np.column_stack([x - aside * np.sin(angle), y + aside * np.cos(angle)])
    return tuple((float(px), float(py)) for px, py in moved)


def narrow_street(rng: Rng) -> Staging:
    """Cars parked in the oncoming lane: who comes there waits behind them, or swerves round."""
    limit = 50 * KMH
    ego = draw(rng, (0.86, 1.0)) * limit
    width = round(draw(rng, (2.75, 2.95)), 2)
    curvature = float(rng.choice([-1, 1]) / draw(rng, (200.0, 900.0)))
    length = 420.0
    heading = draw(rng, (-np.pi, np.pi))
    line = winding((0.0, 0.0), heading, [(length, curvature)], spacing=2.0)
    lane = (Lane(width, "car"),)
    network = Network(
        (Node("w", line[0]), Node("e", line[-1])), two_way("road", "w", "e", line, lane, limit)
    )
    van = bool(rng.random() < 0.3)
    size = (round(draw(rng, (5.3, 6.0) if van else (4.0, 4.8)), 2), 2.0 if van else 1.8)
    near = 190.0
    """Where the row of parked cars begins for the ego, m."""
    cast: list[Actor] = []
    far = near
    for index in range(int(2 + (rng.random() < 0.4))):
        parked = (round(draw(rng, (4.0, 4.8)), 2), 1.8)
        rear = far + parked[0]
        # They stand as the oncoming lane leads, 0.1 m from its edge.
        place, aside = length - far, -(0.5 * width - 1.0)
        cast.append(
            Actor(f"parked{index}", "parked", ("road-",), place, 0.0, lateral=aside, size=parked,
                  stops=(Stop(Spot("road-", place), lateral=aside),))
        )  # fmt: skip
        far = rear + draw(rng, (0.8, 2.0))
    swerve = draw(rng, (7.5, 9.0))
    """Way within which the oncoming car comes over, and back, m."""
    over = width - 1.9 - draw(rng, (0.45, 0.6)) - 0.5 * size[1]
    creeping, gain = draw(rng, (5.2, 6.4)), draw(rng, DRIVERS.moving_off)
    reveal = draw(rng, (1.6, 2.2))
    quick = draw(rng, (0.75, 0.95)) * limit
    begins = far + swerve + 3.0
    """Where the front of the oncoming car is as it may go on, m."""
    arrives = 10.0
    first = begins + creeping * reveal + 0.5 * (arrives + creeping) * LEAD_IN
    reserve = draw(rng, (-0.5, 0.0))
    """From the reveal until the ego would be where it has to wait, s."""
    waits = near - 0.5 - swerve - 2.5
    at = waits - ego * (LEAD_IN + reveal + reserve)
    halts = begins - creeping**2 / 9.0 - 0.3
    """Where it stands if it brakes from there on, or a little before, m."""

    def way(start: float) -> tuple[Point, ...]:
        """Its way from there on, at the middle of its lane but beside the parked cars."""
        at = np.arange(start, 3.0, -0.5)
        inward = np.clip((far + 0.5 + swerve - at) / swerve, 0.0, 1.0)
        outward = np.clip((at - (near - 0.5 - swerve)) / swerve, 0.0, 1.0)
        share = 0.5 - 0.5 * np.cos(np.pi * np.minimum(inward, outward))
        return _beside(line, at, 0.5 * width + (over - 0.5 * width) * share)

    cast = [
        Actor("ego", "ego", ("road+",), at, ego, driver=STAND_IN),
        Actor("oncoming", "van" if van else "car", ("road-",), length - first, arrives, size=size,
              driver=EXACT),
        *cast,
    ]  # fmt: skip

    def future(k: int, rng: Rng) -> Act:
        intention = pick(rng, {"waits": 0.5, "goes on": 0.5})
        when = reveal - BRANCH
        slow_down = Action(0.0, "ego", Verb.BRAKE, 0.4 * ego, 0.8)
        halt = Action(when, "oncoming", Verb.WALK, 0.0, creeping / 4.5, way=way(begins - 0.7))
        stands = when + draw(rng, DRIVERS.attentive_reaction)
        stop = Action(stands, "ego", Verb.BRAKE, 0.0, 0.4 * ego / 6.5)
        acts: tuple[Action, ...]
        if intention == "waits":
            go, place, speed, acts = when + creeping / 4.5 + 5.0, halts, 0.0, (halt,)
        else:
            go, place, speed, acts = when, begins - 0.7, creeping, ()
        over_time = (quick - speed) / gain
        if intention == "waits":
            goes_on = released(when + 1.0)
        else:
            # Until the other is in its own lane again.
            left = place - (near - 0.5 - swerve) - 0.5 * (quick + speed) * over_time
            acts = (*acts, stop)
            goes_on = released(go + over_time + left / quick + 0.3)
        drive = Action(go, "oncoming", Verb.WALK, quick, over_time, way=way(place))
        return Act(intention, (slow_down, *acts, *goes_on, drive))

    return Staging(
        Road(network, (), (), tags=TAGS),
        tuple(cast),
        started,
        future,
        Spot("road+", far + 35.0),
        seconds=15.0,
        warmup=0.0,
        prelude=(
            *paced({"ego": ego}),
            Action(0.0, "oncoming", Verb.WALK, creeping, LEAD_IN, way=way(first - 1.0)),
        ),
    )


KINDS = (
    Kind(
        "bus pulls out of its stop",
        "BusStop",
        bus_stop,
        "A bus stands in its bay, with oncoming traffic on the other side. It pulls out before the "
        "ego, lets it pass, or stays.",
        "pulls out 40 %, early 10 %, lets pass 20 %, stays 30 %; 1.1 to 1.6 m/s2, sideways at 42 "
        "to 58 % of its speed",
        "nudging around stopped vehicles, which stay",
        "the stopped vehicle may start beside the ego, and is twelve metres long",
    ),
    Kind(
        "narrow street with oncoming traffic",
        "Narrow",
        narrow_street,
        "Parked cars fill the oncoming lane. Who comes there slows down behind them, and waits, "
        "or goes on round them through the ego's lane.",
        "waits 50 %, goes on 50 % (2.6 to 3.5 m/s2)",
        "nudging around stopped vehicles and overtaking with oncoming traffic, by the ego",
        "the other is the one who leaves its lane, and may take the right of way that is the ego's",
    ),
)
