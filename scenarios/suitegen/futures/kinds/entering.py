"""A kind in which somebody enters where the ego has the right of way: the roundabout."""

from __future__ import annotations

import numpy as np
from dosplan_sumo.script import Action, Verb

from suitegen.crossings import roundabout
from suitegen.futures.staging import Act, Actor, Kind, Spot, Staging
from suitegen.plain import Network
from suitegen.roads import Rng, Road, arclength

from .drivers import DRIVERS, EXACT, STAND_IN, draw, pick
from .pace import BRANCH, LEAD_IN, paced, released, started

YIELD_LINE = 13.0
"""How far before the end of an entry's line its lane ends, m; the rest is the junction's."""


def _lengths(network: Network) -> dict[str, float]:
    """Length of each edge's line, m."""
    return {edge.id: arclength(edge.shape, len(edge.shape) - 1) for edge in network.edges}


def roundabout_entry(rng: Rng) -> Staging:
    """The ego is in a roundabout; who comes to the next entry yields, or takes a small gap."""
    road = roundabout(rng, 0.0)
    while len(road.focus) < 8:  # Two places an arm: on three arms it is too far round.
        road = roundabout(rng, 0.0)
    length = _lengths(road.network)
    radius = float(np.hypot(*road.focus[0]))
    ego = min(draw(rng, (6.8, 8.3)), float(np.sqrt(3.6 * radius)))
    ring = ("re0", "rx1", "re1")
    meets = draw(rng, (2.8, 3.8))
    """After the start, s: when the ego would be where the other enters."""
    before = ego * (LEAD_IN + meets) - length["re0"] - length["rx1"]
    at = length["a0-"] - max(before, YIELD_LINE + 1.0)
    creeping, gain = draw(rng, (1.2, 2.6)), draw(rng, DRIVERS.moving_off)
    reserve = draw(rng, DRIVERS.entry_gap)
    reveal = max(meets - reserve, BRANCH + 0.1)
    arrives = draw(rng, (4.0, 6.0))
    braking = 2.5
    gap = YIELD_LINE + creeping**2 / (2.0 * braking) + draw(rng, (0.2, 1.0))
    """From the other's front to where its lane's line meets the ring, as it decides, m."""
    front = length["a1-"] - gap - creeping * reveal - 0.5 * (arrives + creeping) * LEAD_IN
    cast = (
        Actor("ego", "ego", ("a0-", *ring, "a2+"), at, ego, driver=STAND_IN),
        Actor("other", "car", ("a1-", "re1", "a2+"), front, arrives, driver=EXACT),
    )

    def future(k: int, rng: Rng) -> Act:
        intention = pick(rng, {"yields": 0.5, "enters": 0.5})
        when = max(reveal - BRANCH + draw(rng, (-0.25, 0.25)), 0.0)
        quick = draw(rng, (6.0, 7.5))
        slow_down = Action(0.0, "ego", Verb.BRAKE, 0.65 * ego, 1.0)
        goes_on = meets + 0.6 - BRANCH
        acts: tuple[Action, ...] = ()
        if intention == "yields":
            acts = (Action(when, "other", Verb.BRAKE, 0.0, creeping / braking),)
            goes_on = when + draw(rng, DRIVERS.attentive_reaction)
            when = meets + 2.5
        enter = Action(when, "other", Verb.BRAKE, quick, quick / gain)
        return Act(intention, (slow_down, *released(goes_on), *acts, enter))

    return Staging(
        Road(road.network, (), (), tags=road.tags),
        cast,
        started,
        future,
        Spot("a2+", 4.0),
        goal_size=(8.0, 3.4),
        seconds=15.0,
        warmup=0.0,
        prelude=(
            *paced({"ego": ego}),
            Action(0.0, "other", Verb.CARELESS),
            Action(0.0, "other", Verb.BRAKE, creeping, LEAD_IN),
        ),
    )


KINDS = (
    Kind(
        "assertive entry into a roundabout",
        "RoundEntry",
        roundabout_entry,
        "The ego is in a roundabout. Who rolls up to the next entry yields, or takes a gap that is "
        "too small.",
        "yields 50 %, enters 50 %: begins 1.2 to 2.1 s before the ego would come by, at 2.6 to "
        "3.5 m/s2",
        "none",
        "a right of way that is the ego's and may be taken from it",
    ),
)
