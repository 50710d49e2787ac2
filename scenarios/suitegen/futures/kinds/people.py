"""Kinds along a street: who steps out, who crosses it, who swerves, and who leaves its kerb."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from dosplan_sumo.script import Action, Script, Verb

from suitegen.futures.staging import EGO, PARKED, PEDESTRIAN, Act, Actor, Kind, Spot, Staging
from suitegen.plain import Lane, Network, Node, Point, two_way
from suitegen.roads import KMH, Flow, Rng, Road, winding

from .behaviour import (
    BRANCH,
    CYCLING,
    DASHING,
    FIRST,
    LIGHT_MIX,
    PULLING_OUT,
    RUNNING,
    SETTING_OFF,
    START,
    WARMUP,
    at_time,
    halt,
    setting_off,
    slow,
    step_out,
    stopping,
    walking_speed,
)
from .drivers import draw, pick

EDGE = "m+"
LENGTH = 340.0
STRIP = 2.1
"""Width of the strip on which cars are parked, m; it is no lane for vehicles."""
SIDEWALK = 2.2
HALF_EGO = 0.85
PERSON = 0.28
"""Half of the width of a person, m."""
SWEPT = 2.0 * (HALF_EGO + PERSON)
"""How far somebody walks while the middle of a lane is blocked for the ego, m."""
CLEAR = 6.5
"""Least distance between the fronts of parked cars, m."""
VAN = (5.6, 2.0)


@dataclass(frozen=True)
class Street:
    """A street of one lane each way between strips with parked cars.

    Attributes:
        network: The network; the ego drives on ``EDGE``.
        line: (P, 2) the middle of the street, m.
        width: Width of a lane, m.
        cycle: Width of the cycle lane between lane and parked cars, m; 0 where there is none.
        limit: Speed limit, m/s.
    """

    network: Network
    line: tuple[Point, ...]
    width: float
    cycle: float
    limit: float

    @property
    def lane(self) -> int:
        """Index of the ego's lane."""
        return 3 if self.cycle else 2

    @property
    def kerb(self) -> float:
        """Offset of the strip with parked cars from the middle of the street, m."""
        return self.width + self.cycle

    def at(self, along: float, left: float) -> Point:
        """A point ``along`` the street, m, and ``left`` of its middle, m."""
        line = np.asarray(self.line)
        steps = np.diff(line, axis=0)
        length = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
        piece = int(np.clip(np.searchsorted(length, along) - 1, 0, len(steps) - 1))
        ahead = steps[piece] / np.hypot(*steps[piece])
        aside = np.array([-ahead[1], ahead[0]])
        x, y = line[piece] + (along - length[piece]) * ahead + left * aside
        return float(x), float(y)

    def way(self, fractions: dict[float, float]) -> tuple[Point, ...]:
        """Points of a way that is at given offsets from the middle at given places.

        Args:
            fractions: Offsets to the left, m, by the places along the street, m.

        Returns:
            A point every metre; between two places the offset changes as half a cosine.
        """
        places, offsets = np.array(list(fractions)), np.array(list(fractions.values()))
        along = np.arange(places[0], places[-1], 1.0)
        piece = np.clip(np.searchsorted(places, along, "right") - 1, 0, len(places) - 2)
        share = (along - places[piece]) / (places[piece + 1] - places[piece])
        blend = 0.5 - 0.5 * np.cos(np.pi * share)
        left = offsets[piece] + blend * (offsets[piece + 1] - offsets[piece])
        return tuple(self.at(float(a), float(b)) for a, b in zip(along, left, strict=True))


def draw_street(rng: Rng, limit: float, cycle: bool = False) -> Street:
    """Draws a street."""
    width = round(float(rng.uniform(3.0, 3.4)), 2)
    path = round(float(rng.uniform(1.6, 1.9)), 2) if cycle else 0.0
    lanes = (
        Lane(SIDEWALK, "sidewalk"),
        Lane(STRIP, "sidewalk"),
        *((Lane(path, "bicycle"),) if cycle else ()),
        Lane(width, "car"),
    )
    bend = float(rng.choice([-1, 1]) / rng.uniform(400.0, 1500.0))
    line = winding((0.0, 0.0), float(rng.uniform(-np.pi, np.pi)), [(LENGTH, bend)])
    edges = two_way("m", "w", "e", line, lanes, limit, 2)
    network = Network((Node("w", line[0]), Node("e", line[-1])), edges)
    return Street(network, line, width, path, limit)


def _ego(street: Street, speed: float, at: float) -> Actor:
    """The stand-in, whose front bumper is ``at`` m at the scenario's start."""
    driver = {"speedFactor": f"{speed / street.limit:.3f}", "speedDev": "0"}
    return Actor(EGO, EGO, (EDGE,), at - START * speed, speed, lane=street.lane, driver=driver)


def _parked(street: Street, name: str, front: float, size: tuple[float, float]) -> Actor:
    """A vehicle that is parked on the strip."""
    left = -street.kerb - 0.1 - 0.5 * size[1]
    spot, ahead = street.at(front, left), street.at(front + 5.0, left)
    lane = street.lane
    return Actor(name, PARKED, (EDGE,), 1.0, 0.0, lane=lane, at=spot, facing=ahead, size=size)


def _row(rng: Rng, street: Street, gaps: tuple[tuple[float, float], ...]) -> tuple[Actor, ...]:
    """Parked cars along the street, none of which is in a gap (from, to, m)."""
    row: list[Actor] = []
    front = 60.0 + float(rng.uniform(0.0, 8.0))
    while front < LENGTH - 30.0:
        size = round(float(rng.uniform(3.9, 4.8)), 2), round(float(rng.uniform(1.7, 1.85)), 2)
        blocked = [gap for gap in gaps if front > gap[0] and front - size[0] < gap[1]]
        if not blocked and rng.random() < 0.75:
            row.append(_parked(street, f"parked{len(row)}", front, size))
        front += CLEAR + float(rng.uniform(0.0, 2.0))
    return tuple(row)


def _person(street: Street, along: float, left: float) -> Actor:
    """Somebody on foot who looks across the street."""
    spot, across = street.at(along, left), street.at(along, 0.0)
    return Actor("walker", PEDESTRIAN, (EDGE,), 1.0, 0.0, lane=street.lane, at=spot, facing=across)


def _scene(
    street: Street,
    cast: tuple[Actor, ...],
    prelude: Script,
    futures: Callable[[int, Rng], Act],
    goal: float,
    oncoming: float,
    tags: tuple[str, ...] = (),
) -> Staging:
    flows = (Flow("m-", "m-", oncoming, LIGHT_MIX),) if oncoming else ()
    return Staging(
        Road(street.network, flows, (), tags=("urban", "two_lane", "oncoming_traffic", *tags)),
        cast,
        at_time(WARMUP + START),
        futures,
        Spot(EDGE, goal, street.lane),
        branch=BRANCH,
        seconds=15.0,
        warmup=WARMUP,
        prelude=prelude,
    )


def _behind_van(rng: Rng) -> Staging:
    street = draw_street(rng, 50 * KMH)
    speed = street.limit * float(rng.uniform(0.88, 1.05))
    place = float(rng.uniform(120.0, 140.0))
    away = float(rng.uniform(-0.1, 0.3))
    pace, haste = walking_speed(rng), draw(rng, RUNNING)
    walked = bool(rng.random() < 0.25)
    # From where it stands to the way of the ego.
    left = 0.5 * street.width + away - HALF_EGO - PERSON
    inside = left + float(rng.uniform(0.0, 0.1)) * SWEPT
    delay = 0.0 if walked else float(rng.uniform(0.3, 1.2))
    met = BRANCH + delay + (inside / pace if walked else setting_off(inside, pace))
    hard = stopping(speed, met - BRANCH)
    van = _parked(street, "van", place - float(rng.uniform(0.7, 1.2)), VAN)
    row = _row(rng, street, ((place - 9.0, place + 1.2),))
    stand = street.kerb + away
    before = pace * (START + BRANCH - 2.0 * FIRST) if walked else 0.0
    walker = _person(street, place, -stand - before)
    here, across = street.at(place, -stand), street.at(place, stand + 1.0)
    edge = street.at(place, -street.kerb + 0.3)
    prelude = (Action(2.0 * FIRST, "walker", Verb.WALK, pace, way=(here,)),) if walked else ()

    def futures(_: int, rng: Rng) -> Act:
        wish = pick(rng, {"waits": 0.4, "walks": 0.35, "runs": 0.1, "looks": 0.15})
        if wish == "waits":
            return Act("waits behind the van", ())
        if wish == "looks":
            return Act("stops at the edge of the van", (step_out("walker", delay, pace, (edge,)),))
        if wish == "runs":
            run = step_out("walker", delay, haste, (across,))
            return Act("runs across", (run, halt(0.0, hard, 1.5)))
        over = 0.0 if walked else pace / SETTING_OFF
        walk = Action(delay, "walker", Verb.WALK, pace, over=over, way=(across,))
        return Act("steps out and walks across", (walk, halt(0.0, hard, 1.5)))

    cast = (_ego(street, speed, place - met * speed), walker, van, *row)
    return _scene(street, cast, prelude, futures, place + float(rng.uniform(45.0, 58.0)), 40.0)


def _jaywalker(rng: Rng) -> Staging:
    street = draw_street(rng, 50 * KMH)
    speed = street.limit * float(rng.uniform(0.88, 1.0))
    place = float(rng.uniform(140.0, 160.0))
    side = float(rng.choice([-1.0, 1.0]))
    pace, haste = walking_speed(rng), draw(rng, RUNNING)
    # Where the ego's way begins for who comes from this side, and how far before that one waits.
    first = side * (HALF_EGO + PERSON) - 0.5 * street.width
    gap = float(rng.uniform(0.35, 0.8))
    until = float(rng.uniform(1.0, 1.9))
    met = BRANCH + until + float(np.sqrt(2.0 * gap / DASHING)) + float(rng.uniform(0.0, 0.25))
    hard = stopping(speed, met - BRANCH)
    walker = _person(street, place, first + side * (gap + pace * (START - 0.8)))
    here = street.at(place, first + side * gap)
    back = street.at(place, first + side * (gap + 3.0))
    beyond = street.at(place, first - side * (SWEPT + (4.0 if side > 0.0 else 7.0)))
    prelude = (Action(2.0 * FIRST, "walker", Verb.WALK, pace, way=(here,)),)

    def futures(_: int, rng: Rng) -> Act:
        wish = pick(rng, {"waits": 0.35, "back": 0.1, "walks": 0.25, "dashes": 0.3})
        if wish == "waits":
            later = step_out("walker", until + float(rng.uniform(3.5, 5.0)), pace, (beyond,))
            return Act("waits until the ego has passed", (later,))
        if wish == "back":
            return Act("goes back", (step_out("walker", until, pace, (back,)),))
        if wish == "walks":
            walk = step_out("walker", until, pace, (beyond,))
            return Act("walks on before the ego", (walk, halt(0.0, hard, 1.5)))
        over = haste / DASHING
        dash = Action(until, "walker", Verb.WALK, haste, over=over, way=(beyond,))
        return Act("dashes across", (dash, halt(0.0, hard, 1.5)))

    row = _row(rng, street, ((place - 30.0, place + 8.0),))
    cast = (_ego(street, speed, place - met * speed), walker, *row)
    return _scene(street, cast, prelude, futures, place + float(rng.uniform(45.0, 58.0)), 0.0)


def _door(rng: Rng) -> Staging:
    street = draw_street(rng, 50 * KMH, cycle=True)
    speed = street.limit * float(rng.uniform(0.85, 1.0))
    riding = draw(rng, CYCLING)
    met = float(rng.uniform(2.8, 4.4))
    swerve = max(BRANCH + 0.1, met - float(rng.uniform(0.45, 0.8)))
    front = 110.0
    rear = front - 1.8
    ride = -street.width - 0.5 * street.cycle
    out = -street.width + float(rng.uniform(0.75, 1.1))
    cyclist = Actor(
        "cyclist",
        "bicycle",
        (EDGE,),
        1.0,
        0.0,
        lane=2,
        at=street.at(front - riding * (START - 2.0 * FIRST), ride),
        facing=street.at(front + 20.0, ride),
        size=(1.8, 0.6),
    )
    end = LENGTH - 2.0
    first = front - riding * (START - 2.0 * FIRST) + 1.0
    prelude = (
        Action(2.0 * FIRST, "cyclist", Verb.WALK, riding, way=street.way({first: ride, end: ride})),
    )
    # The door stands open where the swerve is over.
    begin = front + riding * swerve
    door = begin + float(rng.uniform(5.0, 6.0))

    def futures(_: int, rng: Rng) -> Act:
        wish = pick(rng, {"straight": 0.45, "swerves": 0.4, "brakes": 0.15})
        if wish == "straight":
            return Act("rides straight on past a closed door", ())
        at = swerve - BRANCH
        if wish == "brakes":
            here = front + riding * (BRANCH + at)
            stands = here + riding**2 / 6.0
            way = street.way({here + 0.5: ride, end: ride})
            on = street.way({stands + 1.0: ride, end: ride})
            brake = Action(at, "cyclist", Verb.WALK, 0.0, over=riding / 3.0, way=way)
            again = Action(at + riding / 3.0 + 2.5, "cyclist", Verb.WALK, riding, 4.0, way=on)
            return Act("brakes before an opening door", (brake, again))
        way = street.way(
            {begin + 0.5: ride, door: out, door + 5.0: out, door + 13.0: ride, end: ride}
        )
        turn = Action(at, "cyclist", Verb.WALK, riding, way=way)
        return Act(
            "swerves round an opening door", (turn, *slow(max(0.0, at - 0.3), speed, riding))
        )

    start = rear - (speed - riding) * met
    cast = (_ego(street, speed, start), cyclist, *_row(rng, street, ()))
    goal = start + speed * met + float(rng.uniform(50.0, 62.0))
    return _scene(street, cast, prelude, futures, goal, 250.0)


def _pull_out(rng: Rng) -> Staging:
    street = draw_street(rng, float(rng.choice([40, 50])) * KMH)
    speed = street.limit * float(rng.uniform(0.9, 1.0))
    place = float(rng.uniform(115.0, 130.0))
    size = (4.4, 1.8)
    gain, reached = draw(rng, PULLING_OUT), float(rng.uniform(7.0, 8.5))
    delay = float(rng.uniform(0.2, 1.0))
    car = replace(_parked(street, "leaver", place, size), kind="car")
    stand = -street.kerb - 0.1 - 0.5 * size[1]
    turn = float(rng.uniform(8.5, 10.0))
    met = BRANCH + delay + np.sqrt(2.0 * 0.37 * turn / gain) + float(rng.uniform(-0.2, 0.1))
    end = LENGTH - 2.0

    def futures(_: int, rng: Rng) -> Act:
        wish = pick(rng, {"stays": 0.4, "leaves": 0.4, "noses": 0.2})
        if wish == "stays":
            return Act("stays parked", ())
        middle = -0.5 * street.width
        way = street.way({place + 0.5: stand, place + turn: middle, end: middle})
        leave = Action(delay, "leaver", Verb.WALK, reached, reached / gain, way=way)
        if wish == "leaves":
            return Act("pulls out before the ego", (leave, *slow(delay + 0.2, speed, 2.0)))
        nose = round(0.3 * turn)
        out = Action(delay, "leaver", Verb.WALK, 1.5, 1.5 / gain, way=way[:nose])
        again = Action(delay + 7.0, "leaver", Verb.WALK, reached, 5.0, way=way[nose:])
        return Act("noses out and lets the ego pass", (out, again))

    row = _row(rng, street, ((place - 6.0, place + 14.0),))
    cast = (_ego(street, speed, place + 1.0 - met * speed), car, *row)
    return _scene(street, cast, (), futures, place + float(rng.uniform(45.0, 58.0)), 200.0)


KINDS = (
    Kind(
        name="pedestrian behind a parked van",
        code="VanWalker",
        draw=_behind_van,
        description=(
            "Somebody stands, or comes to stand, before a parked van and waits, looks round it, "
            "walks or runs across."
        ),
        intentions="waits 40 %, walks 35 %, looks 15 %, runs 10 % (an assumption)",
        interplan="jaywalkers",
        new="who stands there hidden steps out or does not; the past is the same",
    ),
    Kind(
        name="jaywalker",
        code="Jaywalker",
        draw=_jaywalker,
        description=(
            "Somebody who crosses the street without a crossing has stopped beside the ego's "
            "lane, at the middle of the street or at the kerb, and waits, goes back, walks on "
            "or dashes across."
        ),
        intentions="waits 35 %, dashes 30 %, walks 25 %, goes back 10 % (an assumption)",
        interplan="jaywalkers",
        new="who stands there changes its mind as the ego is near",
    ),
    Kind(
        name="cyclist before an opening door",
        code="Door",
        draw=_door,
        description=(
            "The ego overtakes a cyclist on a cycle lane beside parked cars; the cyclist rides "
            "on, swerves into the ego's lane round a door, or brakes. The door itself is not "
            "recorded."
        ),
        intentions="rides on 45 %, swerves 40 %, brakes 15 % (an assumption)",
        interplan="nudging around stopped vehicles, of which a bicycle is none",
        new="a cyclist who has to leave its lane at once",
    ),
    Kind(
        name="parked car pulls out",
        code="PullOut",
        draw=_pull_out,
        description=(
            "A car at the kerb stays, pulls out before the ego, or noses out and lets the ego pass."
        ),
        intentions="stays 40 %, pulls out 40 %, noses out 20 % (an assumption)",
        interplan="nudging around stopped vehicles",
        new="a parked car that drives off",
    ),
)
