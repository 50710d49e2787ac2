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

    Where no source is named, the figure is an assumption, chosen so that both outcomes are common.

    Attributes:
        time_gap: Time gap in dense traffic, s, of those who follow closely; the most frequent one
            on German motorways is 0.9 to 1.1 s (Treiber, Kesting, "Traffic Flow Dynamics", 2013,
            sec. 4.3).
        hard_braking: Deceleration of an emergency, m/s2. Drivers who must stop unexpectedly brake
            with 5.4 m/s2 in the mean, up to 7.5 and more (Fambro, Fitzpatrick, Koppa,
            "Determination of stopping sight distances", NCHRP Report 400, 1997).
        light_braking: Deceleration of ordinary driving, m/s2; 3.4 is what nine of ten drivers
            exceed only when they must (the same report).
        attentive_reaction: Time until the stand-in acts on what it did not expect, s: its lower
            end is that of alerted drivers (Green, "How long does it take to stop?", Transportation
            Human Factors 2, 2000).
        lane_change: Lateral speed of a lane change, m/s. Lane changes on motorways last 4.6 s in
            the mean and 1 to 13 s at the extremes (Toledo, Zohar, "Modeling duration of lane
            changes", Transportation Research Record 1999, 2007): with 3.6 m of lane a mean of
            0.8 m/s; these are the quickest ones, of 1.4 to 2 s.
        merge: Lateral speed where a lane ends, m/s.
        cut_in_gap: Distance between the rear of who cuts in and the ego when the two come to
            overlap sideways, m, if the ego keeps its speed. Drivers who change lanes into somebody
            have mostly not seen it (Chovan et al., "Examination of lane change crashes and
            potential IVHS countermeasures", DOT HS 808 071, 1994).
        late_gap: The same where a lane ends; negative where the two are abreast.
        cut_in_braking: Deceleration of who changes lanes because the own one is blocked, m/s2.
        swerve: Lateral speed of who avoids a collision, m/s.
        swerve_braking: Its deceleration meanwhile, m/s2: of drivers who avoid a collision most
            brake first, and many steer then, too (Adams, "Review of the literature on obstacle
            avoidance maneuvers", UMTRI-94-19, 1994).
        bus_start: Acceleration with which a bus leaves its stop, m/s2, from about the 1 m/s2 of
            the Transit Capacity and Quality of Service Manual (TCRP Report 165, 2013) upwards:
            these drivers are in a hurry.
        bus_angle: Its lateral speed as a share of its speed: 23 to 30 degrees.
        moving_off: Acceleration of a car that wants a small gap, m/s2 (Long, "Acceleration
            characteristics of starting vehicles", Transportation Research Record 1737, 2000: up to
            about 3 m/s2 below 10 m/s).
        entry_gap: Time until a circulating car comes by at which an assertive driver still enters
            a roundabout, s: an assumption, about a third of the critical gap of 4.2 to 5.9 s
            (NCHRP Report 572, "Roundabouts in the United States", 2007).
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
