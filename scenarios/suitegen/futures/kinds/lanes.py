"""Kinds in which somebody comes into the ego's lane, or does not: cut-in, and lane drop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dosplan_sumo.script import Action, Script, Verb

from dosplan.vehicle import VehicleParameters
from suitegen.futures.staging import Act, Actor, Kind, Spot, Staging
from suitegen.plain import Connection, Edge, Lane, Network, Node
from suitegen.roads import KMH, Rng, shifted, winding

from .drivers import DRIVERS, EXACT, STAND_IN, draw, pick
from .pace import BRANCH, LEAD_IN, paced_scene, released

_EGO = VehicleParameters()
SIDEWAYS = 4.0
"""Acceleration sideways of those who change lanes, m/s2."""


def until_overlap(lane: float, width: float, lateral: float) -> float:
    """Time from the first movement sideways until two cars in neighbouring lanes overlap, s."""
    return 0.5 * lateral / SIDEWAYS + (lane - 0.5 * (width + _EGO.width)) / lateral


def changing(lateral: float) -> dict[str, str]:
    """SUMO's figures for who changes lanes at that lateral speed, m/s."""
    return {
        "maxSpeedLat": f"{lateral:.2f}",
        "lcMaxSpeedLatFactor": "1",
        "lcAccelLat": f"{SIDEWAYS:.1f}",
    }


def changes_over(
    at: float, lane: int, slow: float, over: float, after: float, gaining: float
) -> Script:
    """The other changes its lane and brakes meanwhile, and goes on half a second later.

    Args:
        at: When, s.
        lane: The lane that it comes into.
        slow: Speed to which it brakes, m/s.
        over: For how long, s.
        after: Speed with which it goes on, m/s.
        gaining: For how long it speeds up to that, s.

    Returns:
        The acts.
    """
    return (
        Action(at, "other", Verb.LANE, lane),
        Action(at, "other", Verb.BRAKE, slow, over),
        Action(at + over + 0.5, "other", Verb.BRAKE, after, gaining),
    )


def cut_in(rng: Rng) -> Staging:
    """A car behind a slow lorry beside the ego's lane: it brakes, or cuts in before the ego."""
    motorway = bool(rng.random() < 0.65)
    lanes = int(rng.integers(2, 4)) if motorway else 2
    limit = float(rng.choice([100, 120, 130] if motorway else [50, 60, 70])) * KMH
    width = round(draw(rng, (3.5, 3.75) if motorway else (3.1, 3.5)), 2)
    curvature = float(rng.choice([-1, 1]) / draw(rng, (900, 2500) if motorway else (300, 700)))
    line = winding((0.0, 0.0), draw(rng, (-np.pi, np.pi)), [(950.0, curvature)], spacing=10.0)
    road_lanes = (Lane(width, "motor" if motorway else "car"),) * lanes
    network = Network(
        (Node("w", line[0]), Node("e", line[-1])),
        (Edge("road", "w", "e", road_lanes, limit, line, 5, "highway" if motorway else "urban"),),
    )
    own = int(rng.integers(1, lanes))
    beside = own - 1
    ego = min(draw(rng, (0.9, 1.0)) * limit, 33.0)
    slower = draw(rng, (0.24, 0.38)) * ego
    pace = ego - slower
    lorry = pace - draw(rng, (0.04, 0.1)) * ego
    size = (round(draw(rng, (4.0, 5.0)), 2), 1.85)
    lateral = draw(rng, DRIVERS.lane_change)
    overlap = until_overlap(width, size[1], lateral)
    meets = draw(rng, (3.0, 4.4))
    """After the start, s: when the two overlap if the other cuts in."""
    at = 120.0
    braking = draw(rng, DRIVERS.cut_in_braking)
    near = draw(rng, DRIVERS.cut_in_gap) + 0.5 * braking * overlap**2
    rear = at + slower * (meets + LEAD_IN) + near
    front = rear + size[0]
    heavy = draw(rng, (9.0, 14.0))
    gap = draw(rng, (6.0, 12.0)) + (pace - lorry) * (LEAD_IN + meets)
    cast = [
        Actor("ego", "ego", ("road",), at, ego, lane=own, driver=STAND_IN),
        Actor(
            "other", "car", ("road",), front, pace, lane=beside, size=size,
            driver={**EXACT, **changing(lateral)},
        ),
        Actor(
            "lorry", "truck", ("road",), front + gap + heavy, lorry, lane=beside,
            size=(round(heavy, 2), 2.5), driver=EXACT,
        ),
        Actor("ahead", "car", ("road",), at + draw(rng, (2.4, 3.2)) * ego + 5.0, ego, lane=own,
              driver=EXACT),
    ]  # fmt: skip
    speeds = {"ego": ego, "other": pace, "lorry": lorry, "ahead": ego}
    if own + 1 < lanes:
        for index, offset in enumerate((draw(rng, (-5.0, 2.0)), draw(rng, (14.0, 20.0)))):
            name = f"left{index}"
            cast.append(Actor(name, "car", ("road",), at + offset, ego, lane=own + 1, driver=EXACT))
            speeds[name] = ego

    def future(k: int, rng: Rng) -> Act:
        intention = pick(rng, {"stays behind the lorry": 0.45, "cuts in": 0.4, "lets pass": 0.15})
        slow_down = Action(0.0, "ego", Verb.BRAKE, pace, slower / 4.0)
        close = (pace - lorry) / draw(rng, DRIVERS.light_braking)
        if intention == "cuts in":
            when = meets - overlap - BRANCH + draw(rng, (-0.2, 0.2))
            slow = draw(rng, (0.6, 0.8)) * pace
            over = (pace - slow) / braking
            goes_on = released(meets + 0.6)
            acts = changes_over(when, own, slow, over, ego, 5.0)
        else:
            brakes = draw(rng, (0.2, 1.5))
            sees = brakes + close + draw(rng, DRIVERS.attentive_reaction)
            goes_on = (Action(sees, "ego", Verb.BRAKE, ego, 2.5), *released(meets + 4.0))
            acts = (Action(brakes, "other", Verb.BRAKE, lorry, close),)
            if intention == "lets pass":
                # It follows the ego into its lane.
                acts = (*acts, Action(meets + draw(rng, (4.0, 5.0)), "other", Verb.LANE, own))
        return Act(intention, (slow_down, *acts, *goes_on))

    tags = ("highway" if motorway else "urban", "multi_lane")
    goal = Spot("road", at + ego * (LEAD_IN + 6.8), own)
    return paced_scene(network, tags, cast, speeds, future, goal, 13.0)


def lane_drop(rng: Rng) -> Staging:
    """A lane beside the ego's ends; the car in it, abreast of the ego, goes first, or does not."""
    through = int(rng.integers(1, 3))
    limit = float(rng.choice([50, 60, 80])) * KMH
    width = round(draw(rng, (3.1, 3.4)), 2)
    curvature = float(rng.choice([-1, 1]) / draw(rng, (500, 2000)))
    heading = draw(rng, (-np.pi, np.pi))
    wide_length = 330.0
    line = winding((0.0, 0.0), heading, [(wide_length, curvature)], spacing=10.0)
    after = winding(line[-1], heading + wide_length * curvature, [(330.0, curvature)], spacing=10.0)
    drop_left = bool(rng.random() < 0.5)
    reference = shifted(line, width) if drop_left else line
    lane = Lane(width, "motor")
    network = Network(
        (Node("w", reference[0]), Node("d", after[0], "priority", 1.0), Node("e", after[-1])),
        (
            Edge("wide", "w", "d", (lane,) * (through + 1), limit, reference, 5, "highway"),
            Edge("narrow", "d", "e", (lane,) * through, limit, after, 5, "highway"),
        ),
        tuple(Connection("wide", "narrow", i + (not drop_left), i) for i in range(through)),
    )
    own, ending = (through - 1, through) if drop_left else (1, 0)
    ego = draw(rng, (0.75, 0.95)) * limit
    size = (round(draw(rng, (4.0, 5.0)), 2), 1.85)
    lateral = draw(rng, DRIVERS.merge)
    overlap = until_overlap(width, size[1], lateral)
    meets = draw(rng, (3.0, 5.0))
    """After the start, s: when a merging car comes into the ego's way."""
    pace = ego + draw(rng, (-0.06, 0.04)) * ego
    late = draw(rng, DRIVERS.late_gap)
    # It has come into the through lane 15 to 40 m before its own lane ends.
    at = wide_length - draw(rng, (15.0, 40.0)) - ego * (LEAD_IN + meets)
    braking = draw(rng, DRIVERS.cut_in_braking)
    near = late + 0.5 * braking * overlap**2
    front = at + near + size[0] + (ego - pace) * (LEAD_IN + meets)
    ahead = draw(rng, (1.6, 2.4)) * ego
    cast = [
        Actor("ego", "ego", ("wide", "narrow"), at, ego, lane=own, driver=STAND_IN),
        Actor(
            "other", "car", ("wide", "narrow"), front, pace, lane=ending, size=size,
            driver={**EXACT, **changing(lateral)},
        ),
        Actor("ahead", "car", ("wide", "narrow"), at + ahead + 5.0, ego, lane=own, driver=EXACT),
    ]  # fmt: skip
    speeds = {"ego": ego, "other": pace, "ahead": ego}
    tags = ("highway", "merging_lanes", "parallel_lanes")
    future = _merging(ego, pace, meets, overlap, own, braking)
    goal = Spot("narrow", at + ego * (LEAD_IN + 6.8) - wide_length, own - (not drop_left))
    return paced_scene(network, tags, cast, speeds, future, goal, 13.0)


def _merging(
    ego: float, pace: float, meets: float, overlap: float, own: int, braking: float
) -> Callable[[int, Rng], Act]:
    def future(k: int, rng: Rng) -> Act:
        intention = pick(rng, {"squeezes in": 0.45, "falls in behind": 0.35, "hurries ahead": 0.2})
        slow_down = Action(0.0, "ego", Verb.BRAKE, 0.75 * ego, 1.6)
        change = meets - overlap - BRANCH + draw(rng, (-0.2, 0.2))
        if intention == "squeezes in":
            goes_on = released(meets + 0.5)
            slow = draw(rng, (0.6, 0.75)) * ego
            over = (pace - slow) / braking
            acts = changes_over(change, own, slow, over, ego, 4.0)
        elif intention == "falls in behind":
            slow = draw(rng, (0.3, 0.45)) * ego
            over = (pace - slow) / draw(rng, DRIVERS.light_braking)
            when = draw(rng, (0.0, 0.4)) * change
            sees = when + draw(rng, DRIVERS.attentive_reaction)
            behind = when + over + 3.0
            goes_on = (Action(sees, "ego", Verb.BRAKE, ego, 2.0), *released(behind + 2.0))
            acts = (
                Action(when, "other", Verb.BRAKE, slow, over),
                Action(behind, "other", Verb.LANE, own),
                Action(behind + 1.0, "other", Verb.BRAKE, ego, 5.0),
            )
        else:
            goes_on = released(change + 1.0)
            quick = pace + draw(rng, (3.0, 5.0))
            acts = (
                Action(0.0, "other", Verb.BRAKE, quick, 2.0),
                Action(change + 0.5, "other", Verb.LANE, own),
                Action(change + 2.5, "other", Verb.BRAKE, ego, 2.0),
            )
        return Act(intention, (slow_down, *acts, *goes_on))

    return future


KINDS = (
    Kind(
        "cut-in or stay",
        "CutIn",
        cut_in,
        "A car closes in on a slow lorry in the lane beside the faster ego. It cuts in before the "
        "ego, which it has not seen, brakes and stays, or lets the ego pass and follows.",
        "stays behind the lorry 45 %, cuts in 40 % (1.8 to 2.5 m/s sideways, at 2.5 to 4.5 m/s2), "
        "lets pass 15 %",
        "lane changes in medium and high traffic density, by the ego",
        "the lane change of another, close and at a difference of speed, that may also not come",
    ),
    Kind(
        "lane drop",
        "Zipper",
        lane_drop,
        "The lane beside the ego's ends, and a car in it is abreast of the ego. It squeezes in "
        "before the ego, falls in behind it, or hurries ahead.",
        "squeezes in 45 % (1.8 to 2.4 m/s sideways, at 2.5 to 4.5 m/s2), falls in behind 35 % (1.5 "
        "to 3.4 m/s2), hurries ahead 20 %",
        "construction sites, at which the ego leaves the closed lane",
        "who goes first is open until late, and differs between futures of one past",
    ),
)
