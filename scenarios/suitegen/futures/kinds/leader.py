"""The leader of a platoon brakes hard, brakes a little, or goes on."""

from __future__ import annotations

from typing import Any

import numpy as np
from dosplan_sumo.script import Action, Verb

from suitegen.futures.staging import EGO, Act, Actor, Kind, Moment, Spot, Staging
from suitegen.plain import Lane, Network, Node, two_way
from suitegen.roads import KMH, NO_BUS_MIX, Flow, Rng, Road, winding

LENGTH = 420.0
EGO_AT = 60.0
"""Where the ego appears, m along the road."""
GAPS = (0.9, 1.5)
"""Time gaps between the vehicles of the platoon, s; half of all drivers keep less than 1.4 s."""


def _after(seconds: float) -> Moment:
    def moment(sumo: Any) -> bool:
        return bool(sumo.simulation.getTime() >= seconds)

    return moment


def draw(rng: Rng) -> Staging:
    """A platoon of three on a road out of town; the ego is its last."""
    speed = float(rng.choice([50, 60, 70])) * KMH
    lane = Lane(round(float(rng.uniform(3.2, 3.6)), 2), "motor")
    bend = float(rng.choice([-1, 1]) / rng.uniform(250.0, 700.0))
    line = winding((0.0, 0.0), float(rng.uniform(-np.pi, np.pi)), [(LENGTH, bend)])
    nodes = (Node("w", line[0]), Node("e", line[-1]))
    edges = two_way("a", "w", "e", line, (lane,), speed, 3)
    flows = (Flow("a-", "a-", float(rng.uniform(150.0, 400.0)), NO_BUS_MIX),)
    road = Road(Network(nodes, edges), flows, (), tags=("urban", "two_lane", "oncoming_traffic"))
    cruise = speed * float(rng.uniform(0.9, 1.0))
    gaps = [float(rng.uniform(*GAPS)) * cruise + 6.0 for _ in range(2)]
    driver = {"speedFactor": f"{cruise / speed:.3f}", "sigma": "0.00", "tau": "0.80"}
    route = ("a+",)
    cast = (
        Actor(EGO, EGO, route, EGO_AT, cruise, driver={"speedFactor": f"{cruise / speed:.3f}"}),
        Actor("leader", "car", route, EGO_AT + gaps[0], cruise, driver=driver),
        Actor("first", "car", route, EGO_AT + sum(gaps), cruise, driver=driver),
    )
    warmup = 20.0
    moment = _after(warmup + 2.5)
    begin = EGO_AT + 2.5 * cruise

    def future(_: int, rng: Rng) -> Act:
        chance = rng.random()
        if chance < 0.4:
            return Act("goes on", ())
        at = round(float(rng.uniform(0.0, 1.0)), 2)
        if chance < 0.6:
            speed, hard = cruise * float(rng.uniform(0.5, 0.7)), float(rng.uniform(1.5, 3.0))
            over = (cruise - speed) / hard
            braking = Action(at, "leader", Verb.BRAKE, round(speed, 2), round(over, 2))
            return Act("slows", (braking, Action(at + over + 1.5, "leader", Verb.FREE)))
        hard = round(float(rng.uniform(6.0, 8.0)), 2)
        stands = round(float(rng.uniform(1.0, 2.0)), 2)
        return Act("brakes hard", (Action(at, "leader", Verb.HALT, hard, stands),))

    return Staging(
        road,
        cast,
        moment,
        future,
        Spot("a+", begin + 0.8 * cruise + cruise**2 / 8.0 + 35.0),
        warmup=warmup,
        seconds=14.0,
    )


KINDS = (
    Kind(
        "hard-braking leader",
        "HardBrake",
        draw,
        "The ego follows in a platoon. Its leader brakes to a stop for something that only it "
        "sees, slows down, or goes on.",
        "goes on 40 %, slows 20 %, brakes hard 40 % at 6 to 8 m/s2",
        "following and stopping behind others",
        "whether the leader stops is not told by the past",
    ),
)
