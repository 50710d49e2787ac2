"""Kinds at crossings: who turns across, runs a light, does not yield, or is met on a left turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dosplan_sumo.script import Action, Script, Verb

from suitegen.futures.staging import EGO, Act, Actor, Kind, Spot, Staging
from suitegen.plain import Crossing, Network, Node, Point
from suitegen.roads import KMH, Arm, Flow, Rng, Road, star, urban_lanes

from .behaviour import (
    BRANCH,
    FIRST,
    LIGHT_MIX,
    RED_RUNNING,
    START,
    STOPPING_AT_AMBER,
    TURNING,
    WARMUP,
    at_time,
    halt,
)
from .drivers import draw, pick

GAIN = 3.0
"""Acceleration of who does not yield, m/s2."""
TIGHT = (3.0, 4.5)
"""Radii of kerbs, m, at crossings at which who comes from the side is soon in the way."""
HALF_PI = 0.5 * np.pi
MAIN_AMBER = 42.0
"""SUMO's time at which netconvert's program shows amber to the main road, s."""


@dataclass(frozen=True)
class Place:
    """A crossing; the ego comes on ``a0-``, ``a1`` is to its right, ``a2`` ahead, ``a3`` left.

    Attributes:
        network: The network.
        angles: Directions in which the arms leave, rad.
        cut: From the stop lines to the middle, m.
        width: Width of a lane, m.
        limit: Speed limit of the main road, m/s.
        lane: Index of the lane for vehicles.
    """

    network: Network
    angles: tuple[float, ...]
    cut: float
    width: float
    limit: float
    lane: int

    def beside(self, arm: int, out: float, left: float) -> Point:
        """A point ``out`` m from the middle along an arm and ``left`` m to the left of it."""
        angle = self.angles[arm]
        x = out * np.cos(angle) - left * np.sin(angle)
        y = out * np.sin(angle) + left * np.cos(angle)
        return float(x), float(y)


def draw_place(
    rng: Rng,
    limit: float,
    kind: str = "priority",
    arms: tuple[int, ...] = (0, 1, 2, 3),
    walks: bool = False,
    radii: tuple[float, float] = (6.5, 9.0),
) -> Place:
    """Draws a crossing of a main road, ``a0`` and ``a2``, with side roads."""
    turn = float(rng.uniform(-np.pi, np.pi))
    angles = tuple(turn + arm * HALF_PI + float(rng.uniform(-0.1, 0.1)) for arm in range(4))
    lanes = urban_lanes(rng, 1, sidewalk=walks)
    legs = [
        Arm(
            angle,
            tuple(lanes),
            limit if arm % 2 == 0 else 50 * KMH,
            3 - 2 * (arm % 2),
            # Ahead it is so long that nobody comes to its end.
            length=(15.0 * limit if arm == 2 else 140.0) + float(rng.uniform(0.0, 30.0)),
            bend=float(rng.uniform(-0.3, 0.3)),
        )
        for arm, angle in enumerate(angles)
    ]
    radius, width = draw(rng, radii), lanes[-1].width
    nodes, edges = star(Node("c", (0.0, 0.0), kind, radius), legs)
    kept = {f"a{arm}{way}" for arm in arms for way in "+-"}
    network = Network(
        tuple(node for node in nodes if node.id == "c" or int(node.id[1:]) in arms),
        tuple(edge for edge in edges if edge.id in kept),
        crossings=tuple(Crossing("c", (f"a{i}+", f"a{i}-"), 4.0) for i in arms if walks),
    )
    cut = radius + width + (2.7 if walks else 0.0)
    return Place(network, angles, cut, width, limit, int(walks))


def ego(target: str, speed: float, before: float, place: Place) -> Actor:
    """The stand-in, at a constant speed as far as the crossing lets it.

    Args:
        target: Edge on which it leaves.
        speed: m/s.
        before: Distance from the stop line at the scenario's start, m.
        place: The crossing.

    Returns:
        It, on ``a0-``.
    """
    driver = {"speedFactor": f"{speed / place.limit:.3f}", "speedDev": "0"}
    at = -(before + START * speed)
    return Actor(EGO, EGO, ("a0-", target), at, speed, lane=place.lane, driver=driver)


def comes(
    name: str, kind: str, route: tuple[str, str], speed: float, before: float, place: Place
) -> tuple[Actor, Action]:
    """A vehicle that keeps its speed until the branch, so far from its stop line at the start."""
    driver = {
        "sigma": "0",
        "speedFactor": f"{max(1.0, speed / place.limit):.3f}",
        "speedDev": "0",
        "accel": f"{GAIN}",
    }
    actor = Actor(name, kind, route, -(before + START * speed), speed, driver=driver)
    return actor, Action(FIRST, name, Verb.SPEED, speed)


def _speeding_up(metres: float, speed: float, to: float) -> float:
    """Time for a way of somebody who speeds up from one speed to another, m/s."""
    ramp = (to - speed) / GAIN
    way = 0.5 * (speed + to) * ramp
    if way > metres:
        return float((np.sqrt(speed**2 + 2.0 * GAIN * metres) - speed) / GAIN)
    return ramp + (metres - way) / to


def _careless(name: str, speed: float, at: float = 0.0) -> Script:
    return Action(at, name, Verb.CARELESS), Action(at, name, Verb.SPEED, speed)


def _scene(
    place: Place,
    cast: tuple[Actor, ...],
    pace: Action,
    futures: Callable[[int, Rng], Act],
    goal: Spot,
    oncoming: float = 0.0,
    warmup: float = WARMUP,
    tags: tuple[str, ...] = (),
) -> Staging:
    """A scene that starts ``START`` after its cast has come, with so many oncoming cars an hour."""
    flows = (Flow("a2-", "a0+", oncoming, LIGHT_MIX),) if oncoming else ()
    return Staging(
        Road(place.network, flows, (), tags=("urban", "intersection", *tags)),
        cast,
        at_time(warmup + START),
        futures,
        goal,
        branch=BRANCH,
        warmup=warmup,
        seconds=15.0,
        prelude=(pace,),
    )


def _oncoming_turn(rng: Rng) -> Staging:
    limit = float(rng.choice([50, 60])) * KMH
    place = draw_place(rng, limit, arms=(0, 1, 2) if rng.random() < 0.5 else (0, 1, 2, 3))
    speed = limit * float(rng.uniform(0.85, 1.0))
    turning = draw(rng, TURNING)
    kind = str(rng.choice(["car", "car", "van"]))
    # The way of the one who turns, from its stop line until it is in the ego's lane.
    into = 0.64 * place.cut
    met = float(rng.uniform(4.0, 5.2))
    line = met - float(rng.uniform(0.2, 0.8)) - into / turning
    name = "oncoming"
    other, pace = comes(name, kind, ("a2-", "a0+"), turning, line * turning, place)
    cast = (ego("a2+", speed, met * speed - place.cut - 2.0, place), other)

    def futures(_: int, rng: Rng) -> Act:
        wish = pick(rng, {"on": 0.4, "across": 0.4, "behind": 0.2})
        if wish == "on":
            return Act("goes straight on", (Action(0.0, name, Verb.FREE),))
        route = Action(0.0, name, Verb.ROUTE, edge="a1+")
        if wish == "behind":
            free = Action(0.0, name, Verb.FREE)
            return Act("waits in the crossing and turns behind the ego", (free, route))
        turn = _careless(name, turning * float(rng.uniform(0.92, 1.08)))
        stop = halt(line - BRANCH - 0.2, 7.0)
        return Act("turns left across the ego's way", (route, *turn, stop))

    goal = Spot("a2+", float(rng.uniform(25.0, 40.0)))
    return _scene(place, cast, pace, futures, goal, oncoming=120.0, tags=("oncoming_traffic",))


def _minor_road(rng: Rng) -> Staging:
    limit = float(rng.choice([50, 60, 70])) * KMH
    right = bool(rng.random() < 0.6)
    source = "a1-" if right else "a3-"
    place = draw_place(rng, limit, radii=TIGHT)
    speed = limit * float(rng.uniform(0.92, 1.0))
    merges = right and bool(rng.random() < 0.4)
    # Seen from the ego: merges beyond the middle, crosses at the side on which it drives.
    target = "a2+" if merges else ("a3+" if right else "a1+")
    beyond = 4.0 if merges else (0.5 if right else -0.5) * place.width
    rolling, going = float(rng.uniform(2.0, 3.2)), float(rng.uniform(6.5, 7.5))
    into = place.cut - (place.width if right else 0.0) + (2.0 if merges else 0.0)
    line = BRANCH + float(rng.uniform(0.5, 0.8))
    goes = _speeding_up(rolling * (line - BRANCH) + into, rolling, going)
    met = BRANCH + goes + float(rng.uniform(-0.15, 0.1))
    name = "side"
    kind = str(rng.choice(["car", "car", "van"]))
    other, pace = comes(name, kind, (source, target), rolling, line * rolling, place)
    cast = (ego("a2+", speed, met * speed - place.cut - beyond + 1.0, place), other)

    def futures(_: int, rng: Rng) -> Act:
        if pick(rng, {"yields": 0.55, "goes": 0.45}) == "yields":
            return Act("yields", (Action(0.0, name, Verb.FREE),))
        pull = _careless(name, going * float(rng.uniform(0.95, 1.1)))
        pull = (*pull, Action(goes + 1.0, name, Verb.FREE), halt(0.0, 7.6))
        return Act("does not yield and " + ("turns in" if merges else "crosses"), pull)

    goal = Spot("a2+", float(rng.uniform(42.0, 55.0)))
    return _scene(place, cast, pace, futures, goal, oncoming=180.0)


def _left_turn(rng: Rng) -> Staging:
    limit = float(rng.choice([50, 60])) * KMH
    place = draw_place(rng, limit, arms=(0, 2, 3) if rng.random() < 0.5 else (0, 1, 2, 3))
    speed = float(rng.uniform(7.0, 9.0))
    before = speed * float(rng.uniform(2.2, 2.8))
    oncoming = float(rng.uniform(9.5, 12.0))
    # It comes as the ego, which slows down in its turn, is about to be in its lane.
    crosses = before / speed + 1.2
    line = crosses + float(rng.uniform(0.45, 1.1)) - 0.64 * place.cut / oncoming
    name = "oncoming"
    kind = str(rng.choice(["car", "car", "van", "motorcycle"]))
    other, pace = comes(name, kind, ("a2-", "a0+"), oncoming, line * oncoming, place)
    cast = (ego("a3+", speed, before, place), other)

    def futures(_: int, rng: Rng) -> Act:
        wish = pick(rng, {"keeps": 0.35, "faster": 0.3, "slower": 0.35})
        if wish == "keeps":
            return Act("keeps its speed", ())
        if wish == "faster":
            value = min(oncoming * float(rng.uniform(1.25, 1.4)), 1.1 * limit)
            return Act("speeds up to be there first", (Action(0.0, name, Verb.SPEED, value),))
        brake = Action(0.0, name, Verb.BRAKE, float(rng.uniform(3.5, 5.0)), over=2.2)
        return Act("slows down", (brake, Action(3.0, name, Verb.FREE)))

    goal = Spot("a3+", float(rng.uniform(12.0, 20.0)))
    return _scene(place, cast, pace, futures, goal, tags=("oncoming_traffic",))


def _amber_turn(rng: Rng) -> Staging:
    place = draw_place(rng, 50 * KMH, "traffic_light")
    start = MAIN_AMBER - float(rng.uniform(0.85, 0.95))
    speed = float(rng.uniform(6.0, 7.5))
    before = speed * float(rng.uniform(0.65, 0.9))
    oncoming = float(rng.uniform(9.5, 11.5))
    line = max(before / speed + float(rng.uniform(2.0, 2.5)), MAIN_AMBER - start + 1.85)
    name = "oncoming"
    kind = str(rng.choice(["car", "car", "van"]))
    other, pace = comes(name, kind, ("a2-", "a0+"), oncoming, line * oncoming, place)
    cast = (ego("a3+", speed, before, place), other)

    def futures(_: int, rng: Rng) -> Act:
        reaction = MAIN_AMBER - start - BRANCH + float(rng.uniform(0.4, 0.7))
        left = oncoming * (line - BRANCH - reaction)
        if pick(rng, {"stops": 0.5, "runs": 0.5}) == "stops":
            over = max(2.0 * (left - 0.7) / oncoming, oncoming / STOPPING_AT_AMBER)
            brake = Action(reaction, name, Verb.BRAKE, 0.0, over=over)
            return Act("stops at the amber light", (brake,))
        run = _careless(name, oncoming * draw(rng, RED_RUNNING), reaction)
        passes = line + place.cut / oncoming - BRANCH
        waits = halt(0.0, 6.0, max(0.5, passes - speed / 6.0))
        return Act("runs the amber light", (*run, waits))

    goal = Spot("a3+", float(rng.uniform(12.0, 18.0)))
    return _scene(
        place, cast, pace, futures, goal, warmup=start - START, tags=("oncoming_traffic",)
    )


KINDS = (
    Kind(
        name="oncoming car turns left or goes on",
        code="OncomingTurn",
        draw=_oncoming_turn,
        description=(
            "The ego goes straight on with the right of way; an oncoming car has slowed down "
            "before the crossing and turns left across the ego's way, waits, or goes on."
        ),
        intentions=(
            "goes on 40 %, turns across 40 %, waits and turns behind the ego 20 % (an assumption)"
        ),
        interplan="none",
        new="the same past ends in a turn across, in waiting and in going on",
    ),
    Kind(
        name="driver on a side road yields or not",
        code="NoYield",
        draw=_minor_road,
        description=(
            "The ego has the right of way; somebody rolls up to the line of a side road and "
            "stops there, or turns in or crosses in front of the ego."
        ),
        intentions="yields 55 %, goes 45 % (an assumption)",
        interplan="none",
        new="a driver who does not yield, from the left or the right",
    ),
    Kind(
        name="unprotected left turn",
        code="LeftTurn",
        draw=_left_turn,
        description=(
            "The ego turns left; an oncoming car is about a critical gap away and keeps its "
            "speed, speeds up, or slows down."
        ),
        intentions="keeps its speed 35 %, speeds up 30 %, slows down 35 % (an assumption)",
        interplan="none",
        new="the gap that counts is the one after the oncoming driver has decided",
    ),
    Kind(
        name="left turn at the end of green",
        code="AmberTurn",
        draw=_amber_turn,
        description=(
            "The ego is in a crossing with signals, about to turn left, as the light turns "
            "amber; an oncoming car in its dilemma zone stops or runs the light."
        ),
        intentions="stops 50 %, runs the light 50 % (an assumption)",
        interplan="none",
        new="whether amber is run decides who goes first",
    ),
)
