"""What SUMO is told of the road users of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement

from dosplan_sumo.script import Action, Script, Verb, rounded

from suitegen.roads import Rng
from suitegen.traffic import STEP, demand_of, vehicle_type

from .staging import EGO, PARKED, PEDESTRIAN, Actor, Staging

FOR_EVER = 1e5
"""Duration of a stop that only a script ends, s."""
HARDEST_BRAKING = 8.0
"""What drivers brake with in need, m/s2."""
PERSON_LENGTH = (0.35, 0.45)
PERSON_WIDTH = (0.5, 0.6)
STAND_IN = {
    "accel": "2.00",
    "decel": "4.00",
    "speedFactor": "1.000",
    "sigma": "0.00",
    "tau": "1.20",
    "minGap": "2.00",
    "lcSpeedGain": "0.00",
    "lcKeepRight": "0.00",
    "impatience": "0.00",
}
"""The driver who stands in for the ego: attentive, keeps the rules, and its lane if it can."""


@dataclass(frozen=True)
class Demand:
    """The demand of a scene.

    Attributes:
        root: Root of SUMO's demand file.
        users: Kind, length and width, m, of each road user in it.
        prelude: What the cast is told from its appearance on: those on foot are put in their place.
    """

    root: Element
    users: dict[str, tuple[str, float, float]]
    prelude: Script


def scene_demand(staging: Staging, rng: Rng, until: float) -> Demand:
    """The demand of a scene.

    Args:
        staging: The scene.
        rng: Draws drivers and the background.
        until: Time after which nobody departs any more, s.

    Returns:
        Background and cast.
    """
    root, users = demand_of(staging.road, rng, until)
    everybody = [element for element in root if "depart" in element.attrib]
    for element in everybody:
        root.remove(element)
    placed = []
    for actor in staging.cast:
        users[actor.id] = _type_of(actor, root, rng)
        everybody.append(_trip(actor, staging.warmup))
        if actor.at is not None:
            way = (actor.at,) if actor.facing is None else (actor.at, actor.facing)
            placed.append(Action(actor.depart + STEP, actor.id, Verb.WAIT, way=way))
    everybody.sort(key=lambda element: float(element.attrib["depart"]))
    root.extend(everybody)
    return Demand(root, users, rounded((*placed, *staging.prelude)))


def _type_of(actor: Actor, root: Element, rng: Rng) -> tuple[str, float, float]:
    """Adds the type of an actor; gives its kind and size."""
    name = f"t{actor.id}"
    if actor.kind == PEDESTRIAN:
        size = tuple(
            round(float(rng.uniform(*low_high)), 3) for low_high in (PERSON_LENGTH, PERSON_WIDTH)
        )
        attributes = {"vClass": "passenger", "minGap": "0.50", "minGapLat": "0.30"}
        made = SubElement(root, "vType", {"id": name, **attributes})
    else:
        drawn = "car" if actor.kind == PARKED else actor.kind
        size = vehicle_type(rng, root, name, drawn)
        made = root[-1]
        made.set("emergencyDecel", f"{HARDEST_BRAKING:.2f}")
        if actor.id == EGO:
            for key, value in STAND_IN.items():
                made.set(key, value)
    if actor.size is not None:
        size = actor.size
    made.set("length", f"{size[0]:.3f}")
    made.set("width", f"{size[1]:.3f}")
    # SUMO draws a deviation from the speed factor of a type unless it is told not to.
    made.set("speedDev", "0.00")
    for key, value in actor.driver.items():
        made.set(key, value)
    return actor.kind, size[0], size[1]


def _trip(actor: Actor, warmup: float) -> Element:
    first, *through, last = actor.route if len(actor.route) > 1 else actor.route * 2
    trip = Element(
        "trip",
        {"from": first, "to": last},
        id=actor.id,
        type=f"t{actor.id}",
        depart=f"{warmup + actor.depart:.2f}",
        departPos=f"{actor.position:.2f}",
        departLane=str(actor.lane),
        departPosLat=f"{actor.lateral:.2f}",
        departSpeed="max" if actor.speed is None else f"{actor.speed:.2f}",
        # A cast stands where it is put; who overlaps then is found by the checks.
        insertionChecks="none",
    )
    if through:
        trip.set("via", " ".join(through))
    for stop in actor.stops:
        spot = stop.at
        SubElement(
            trip,
            "stop",
            lane=f"{spot.edge}_{spot.lane}",
            startPos=f"{spot.position - 0.5:.2f}",
            endPos=f"{spot.position:.2f}",
            posLat=f"{stop.lateral:.2f}",
            duration=f"{FOR_EVER:.1f}",
        )
    return trip
