"""Kinds in which somebody beside the ego must brake for others, and may swerve into its lane."""

from __future__ import annotations

import numpy as np
from dosplan_sumo.script import Action, Verb

from suitegen.futures.staging import Act, Actor, Kind, Spot, Staging
from suitegen.plain import Edge, Lane, Network, Node
from suitegen.roads import KMH, Rng, winding

from .drivers import DRIVERS, EXACT, STAND_IN, draw, pick
from .lanes import changes_over, changing, until_overlap
from .pace import BRANCH, LEAD_IN, paced_scene, released


def braking_platoon(rng: Rng) -> Staging:
    """Beside the ego the first of a platoon brakes hard; the second brakes, too, or swerves."""
    motorway = bool(rng.random() < 0.6)
    lanes = int(rng.integers(2, 4)) if motorway else 2
    limit = float(rng.choice([80, 100, 120] if motorway else [50, 60, 70])) * KMH
    width = round(draw(rng, (3.5, 3.75) if motorway else (3.1, 3.5)), 2)
    curvature = float(rng.choice([-1, 1]) / draw(rng, (900, 2500) if motorway else (300, 700)))
    line = winding((0.0, 0.0), draw(rng, (-np.pi, np.pi)), [(950.0, curvature)], spacing=10.0)
    road_lanes = (Lane(width, "motor" if motorway else "car"),) * lanes
    kind = "highway" if motorway else "urban"
    network = Network(
        (Node("w", line[0]), Node("e", line[-1])),
        (Edge("road", "w", "e", road_lanes, limit, line, 5, kind),),
    )
    own = int(rng.integers(lanes))
    beside = own + 1 if own == 0 else own - 1
    ego = draw(rng, (0.9, 1.0)) * limit
    slower = draw(rng, (0.06, 0.18)) * ego
    pace = ego - slower
    size = (round(draw(rng, (4.0, 5.0)), 2), 1.85)
    lateral, braking = draw(rng, DRIVERS.swerve), draw(rng, DRIVERS.swerve_braking)
    overlap = until_overlap(width, size[1], lateral)
    meets = draw(rng, (3.4, 4.6))
    """After the start, s: when the two overlap if the other swerves."""
    at = 120.0
    near = draw(rng, DRIVERS.cut_in_gap) + 0.5 * braking * overlap**2
    front = at + slower * (LEAD_IN + meets) + near + size[0]
    gap = draw(rng, DRIVERS.time_gap) * pace + 1.0
    cast = [
        Actor("ego", "ego", ("road",), at, ego, lane=own, driver=STAND_IN),
        Actor("other", "car", ("road",), front, pace, lane=beside, size=size,
              driver={**EXACT, **changing(lateral)}),
        Actor("first", "car", ("road",), front + gap + 4.5, pace, lane=beside, size=(4.5, 1.85),
              driver=EXACT),
        Actor("ahead", "car", ("road",), at + draw(rng, (2.6, 3.4)) * ego + 5.0, ego, lane=own,
              driver=EXACT),
    ]  # fmt: skip
    speeds = {"ego": ego, "other": pace, "first": pace, "ahead": ego}
    free = own - 1 if beside > own else own + 1
    if 0 <= free < lanes:
        for index, offset in enumerate((draw(rng, (-5.0, 2.0)), draw(rng, (14.0, 20.0)))):
            name = f"side{index}"
            cast.append(Actor(name, "car", ("road",), at + offset, ego, lane=free, driver=EXACT))
            speeds[name] = ego

    def future(k: int, rng: Rng) -> Act:
        intention = pick(rng, {"drives on": 0.35, "brakes": 0.25, "swerves": 0.4})
        slow_down = Action(0.0, "ego", Verb.BRAKE, pace - 0.06 * ego, 1.5)
        swerves = meets - overlap - BRANCH + draw(rng, (-0.15, 0.15))
        reaction = min(draw(rng, DRIVERS.attentive_reaction), swerves)
        hard = draw(rng, DRIVERS.hard_braking)
        until = draw(rng, (0.2, 0.4)) * pace
        over = (pace - until) / hard
        again = swerves + over + 1.5
        first = (
            Action(swerves - reaction, "first", Verb.BRAKE, until, over),
            Action(again, "first", Verb.BRAKE, pace, 6.0),
        )
        if intention == "drives on":
            acts: tuple[Action, ...] = ()
            goes_on = (Action(1.6, "ego", Verb.BRAKE, ego, 2.0), *released(meets + 3.0))
        elif intention == "brakes":
            acts = (
                *first,
                Action(swerves - 0.6 * reaction, "other", Verb.BRAKE, until, over),
                Action(again + 0.5, "other", Verb.BRAKE, 0.9 * pace, 6.0),
            )
            goes_on = (Action(swerves + 0.7, "ego", Verb.BRAKE, ego, 2.0), *released(meets + 3.0))
        else:
            slow = draw(rng, (0.35, 0.6)) * pace
            over = (pace - slow) / braking
            acts = (*first, *changes_over(swerves, own, slow, over, ego, 6.0))
            goes_on = released(meets)
        return Act(intention, (slow_down, *acts, *goes_on))

    tags = ("highway" if motorway else "urban", "multi_lane")
    goal = Spot("road", at + ego * (LEAD_IN + 6.8), own)
    return paced_scene(network, tags, cast, speeds, future, goal, 14.0)


def queue_behind_bend(rng: Rng) -> Staging:
    """Behind a bend a queue stands in the lane beside the ego's; who comes to it may swerve."""
    radius = draw(rng, (60.0, 120.0))
    limit = float(rng.choice([50, 60])) * KMH
    ego = min(draw(rng, (0.88, 1.0)) * limit, float(np.sqrt(3.0 * radius)))
    sweep = draw(rng, (0.9, 1.7))
    bend = float(rng.choice([-1, 1])) / radius
    straight, heading = 150.0, draw(rng, (-np.pi, np.pi))
    pieces = [(straight, 0.0), (radius * sweep, bend), (220.0, 0.0)]
    line = winding((0.0, 0.0), heading, pieces, 3.0)
    width = round(draw(rng, (3.1, 3.5)), 2)
    network = Network(
        (Node("w", line[0]), Node("e", line[-1])),
        (Edge("road", "w", "e", (Lane(width, "car"),) * 2, limit, line, 3),),
    )
    own = int(rng.random() < 0.75)
    beside = 1 - own
    pace = draw(rng, (0.84, 0.95)) * ego
    size = (round(draw(rng, (4.0, 5.0)), 2), 1.85)
    lateral, braking = draw(rng, DRIVERS.swerve), draw(rng, DRIVERS.swerve_braking)
    overlap = until_overlap(width, size[1], lateral)
    meets = draw(rng, (3.2, 4.4))
    """After the start, s: when the two overlap if the other swerves."""
    hesitates = draw(rng, (0.2, 0.5))
    """For how long it brakes before it swerves, s."""
    conflict = straight + draw(rng, (0.3, 0.9)) * radius * sweep
    at = conflict - ego * (LEAD_IN + meets)
    near = draw(rng, DRIVERS.cut_in_gap) + 0.5 * braking * (hesitates + overlap) ** 2
    front = at + (ego - pace) * (LEAD_IN + meets) + near + size[0]
    decides = meets - overlap - hesitates - BRANCH
    rolling = draw(rng, (0.3, 1.5))
    there = front + pace * (LEAD_IN + BRANCH + decides)
    rear = there + pace**2 / 12.0 + draw(rng, (3.0, 7.0)) - rolling * (LEAD_IN + BRANCH + decides)
    cast = [
        Actor("ego", "ego", ("road",), at, ego, lane=own, driver=STAND_IN),
        Actor("other", "car", ("road",), front, pace, lane=beside, size=size,
              driver={**EXACT, **changing(lateral)}),
    ]  # fmt: skip
    speeds = {"ego": ego, "other": pace}
    for index in range(int(rng.integers(3, 6))):
        van = rng.random() < 0.2
        length = round(draw(rng, (5.3, 6.3) if van else (4.0, 5.0)), 2)
        name = f"queue{index}"
        cast.append(
            Actor(name, "van" if van else "car", ("road",), rear + length, rolling, lane=beside,
                  size=(length, 2.0 if van else 1.85), driver=EXACT)
        )  # fmt: skip
        speeds[name] = rolling
        rear += length + draw(rng, (3.0, 6.0))
    queue = [name for name in speeds if name.startswith("queue")]

    def future(k: int, rng: Rng) -> Act:
        intention = pick(rng, {"joins the queue": 0.4, "queue dissolves": 0.2, "swerves": 0.4})
        when = decides + draw(rng, (-0.15, 0.15))
        slow_down = Action(0.0, "ego", Verb.BRAKE, 0.72 * ego, 1.2)
        if intention == "swerves":
            slow = draw(rng, (0.3, 0.5)) * pace
            over = (pace - slow) / braking
            acts: tuple[Action, ...] = (
                Action(when, "other", Verb.BRAKE, slow, over),
                Action(when + hesitates, "other", Verb.LANE, own),
                Action(when + over + 0.7, "other", Verb.BRAKE, ego, 5.0),
            )
            return Act(intention, (slow_down, *acts, *released(meets)))
        start = draw(rng, DRIVERS.queue_start)
        if intention == "joins the queue":
            hard = draw(rng, DRIVERS.hard_braking)
            acts = (Action(when, "other", Verb.BRAKE, rolling, (pace - rolling) / hard),)
        else:
            follows = 0.4 * pace
            acts = (
                *(Action(0.0, name, Verb.BRAKE, pace, pace / start) for name in queue),
                Action(when, "other", Verb.BRAKE, follows, (pace - follows) / 4.0),
                Action(when + 2.5, "other", Verb.BRAKE, 0.8 * pace, 4.0),
            )
        sees = when + draw(rng, DRIVERS.attentive_reaction)
        goes_on = (Action(sees, "ego", Verb.BRAKE, ego, 2.0), *released(meets + 3.0))
        return Act(intention, (slow_down, *acts, *goes_on))

    goal = Spot("road", at + ego * (LEAD_IN + 6.8), own)
    return paced_scene(network, ("urban", "multi_lane"), cast, speeds, future, goal, 14.0)


KINDS = (
    Kind(
        "hard-braking platoon",
        "HardBrake",
        braking_platoon,
        "Beside the ego drives a close platoon, a little slower. Its first drives on, or brakes "
        "hard; then the second brakes as well, or swerves into the ego's lane, braking.",
        "drives on 35 %, brakes 25 % (6 to 8 m/s2), swerves 40 % (0.6 to 0.9 s after the first "
        "brakes, 2.4 to 3 m/s sideways, at 4 to 6 m/s2)",
        "lane changes in medium and high traffic density",
        "the braking that nothing in the past announces, and who is hit by it indirectly",
    ),
    Kind(
        "queue end behind a bend",
        "QueueBend",
        queue_behind_bend,
        "Behind a bend a queue stands in the lane beside the ego's. Who comes to its end brakes "
        "and joins it, or swerves into the ego's lane; or the queue dissolves.",
        "joins the queue 40 % (6 to 8 m/s2), queue dissolves 20 % (1.2 to 2 m/s2), swerves 40 % "
        "(2.4 to 3 m/s sideways, at 4 to 6 m/s2)",
        "accident sites, without others who come upon them",
        "others come upon the obstacle first, and how they avoid it is not told by the past",
    ),
)
