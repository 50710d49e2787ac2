"""How drivers of vehicles behave in the kinds of this package: one table, with its sources."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from suitegen.roads import Rng

Range = tuple[float, float]
"""Least and greatest value of a uniform distribution."""


@dataclass(frozen=True)
class Drivers:
    """Ranges and shares from which the drivers of the cast are drawn.

    All bounds are assumptions, chosen so that both outcomes are common. Where a source is named,
    they are of the order of what it says.

    Attributes:
        time_gap: Time gap in dense traffic, s, of those who follow closely: about 1 s is frequent
            on motorways (Treiber, Kesting, "Traffic Flow Dynamics", 2013), and these are below.
        hard_braking: Deceleration of an emergency, m/s2: towards what a dry road lets brakes do.
        light_braking: Deceleration of ordinary driving, m/s2. Nine of ten drivers who must stop for
            something unexpected brake harder than its upper end (Fambro, Fitzpatrick, Koppa,
            "Determination of stopping sight distances", NCHRP Report 400, 1997).
        attentive_reaction: Time until the stand-in acts, s: about that of drivers who know what may
            come, 0.7 to 0.75 s (Green, "How long does it take to stop?", Transportation Human
            Factors 2, 2000).
        lane_change: Lateral speed of a lane change, m/s. Lane changes on motorways last between 1
            and 13 s, 4.6 s in the mean (Toledo, Zohar, "Modeling duration of lane changes",
            Transportation Research Record 1999, 2007): over 3.6 m of lane that is 0.8 m/s. These
            are quick ones, of 1.4 to 2 s.
        merge: Lateral speed where a lane ends, m/s.
        cut_in_gap: Distance between the rear of who cuts in and the ego when the two come to
            overlap sideways, m, if the ego keeps its speed. Drivers who change lanes into somebody
            have mostly not seen it (Chovan et al., "Examination of lane change crashes and
            potential IVHS countermeasures", DOT HS 808 071, 1994).
        late_gap: The same where a lane ends; negative where the two are abreast.
        cut_in_braking: Deceleration of who changes lanes because the own one is blocked, m/s2.
        swerve: Lateral speed of who avoids a collision, m/s.
        swerve_braking: Its deceleration meanwhile, m/s2: drivers who avoid a collision brake more
            often than they steer, or do both (Adams, "Review of the literature on obstacle
            avoidance maneuvers: braking versus steering", UMTRI-94-19, 1994).
        bus_start: Acceleration with which a bus leaves its stop, m/s2. About 1 m/s2 is usual
            (Transit Capacity and Quality of Service Manual, TCRP Report 165, 2013); these drivers
            are in a hurry.
        bus_angle: Its lateral speed as a share of its speed: 23 to 30 degrees.
        moving_off: Acceleration of a car that wants a small gap, m/s2: near the most that a common
            car can.
        entry_gap: Time until a circulating car comes by at which an assertive driver still enters
            a roundabout, s: about a third of the critical gap, which is 4 to 6 s ("Roundabouts in
            the United States", NCHRP Report 572, 2007).
        queue_start: Acceleration of a queue that dissolves, m/s2.
    """

    time_gap: Range = (0.6, 1.0)
    hard_braking: Range = (6.0, 8.0)
    light_braking: Range = (1.5, 3.4)
    attentive_reaction: Range = (0.6, 0.9)
    lane_change: Range = (1.8, 2.5)
    merge: Range = (1.8, 2.4)
    cut_in_gap: Range = (-2.5, 0.0)
    late_gap: Range = (-4.0, -2.2)
    cut_in_braking: Range = (2.5, 4.5)
    swerve: Range = (2.4, 3.0)
    swerve_braking: Range = (4.0, 6.0)
    bus_start: Range = (1.1, 1.6)
    bus_angle: Range = (0.42, 0.58)
    moving_off: Range = (2.6, 3.5)
    entry_gap: Range = (1.5, 1.85)
    queue_start: Range = (1.2, 2.0)


DRIVERS: Final = Drivers()


def draw(rng: Rng, bounds: Range) -> float:
    """A uniform draw."""
    return float(rng.uniform(*bounds))


def pick(rng: Rng, shares: Mapping[str, float]) -> str:
    """Draws one of several intentions.

    Args:
        rng: Source of randomness.
        shares: How likely each is; they sum to one.

    Returns:
        The key that was drawn.
    """
    return str(rng.choice(list(shares), p=list(shares.values())))


EXACT: Final[Mapping[str, str]] = MappingProxyType(
    {"sigma": "0", "speedFactor": "1", "tau": "0.2", "minGap": "0.5", "decel": "8.0"}
)
"""SUMO's figures for who keeps the pace it is told, close behind others if need be."""

STAND_IN: Final[Mapping[str, str]] = MappingProxyType(
    {"tau": "0.3", "minGap": "1.5", "accel": "2.6", "decel": "7.0", "emergencyDecel": "8.0"}
)
"""SUMO's figures for the stand-in that differ from its usual ones.

It may come near before the scenario starts; what reserve it has then is in the scripts.
"""
