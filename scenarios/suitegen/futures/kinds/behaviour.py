"""What people do on the road, as far as the kinds of crossings and of people on foot draw it.

=========================  =====================================================================
what                       from where
=========================  =====================================================================
``WALKING``                about what Fitzpatrick et al., "Improving pedestrian safety at
                           unsignalized crossings", NCHRP Report 562, 2006, found of adults below
                           60: 1.45 m/s in the median, the slowest 15 % below 1.15 m/s; the bounds
                           are assumptions
``RUNNING``,               the order of magnitude is that of Zebala, Ciepka and Reza, "Pedestrian
``SETTING_OFF``,           acceleration and speeds", Problems of Forensic Sciences 91, 2012; the
``DASHING``                bounds are assumptions
``CYCLING``                below the 6 m/s on the flat of Parkin and Rotheram, "Design speeds and
                           acceleration characteristics of bicycle traffic", Transport Policy 17,
                           2010: beside parked cars; the bounds are assumptions
``STOPPING_AT_AMBER``      Gates, Noyce, Laracuente and Nordheim, "Analysis of driver behavior in
                           dilemma zones at signalized intersections", Transportation Research
                           Record 2030, 2007: those who stop brake with 2.2 to 3.9 m/s2 (15 % and
                           85 %), after 1.0 s in the median. Here they brake with as much as
                           they need, and 0.4 to 0.7 s after amber: an assumption
``RED_RUNNING``            who runs a light keeps the speed or accelerates: an assumption
``TURNING``                a lateral acceleration of 3 to 4 m/s2 at radii of 10 to 15 m: an
                           assumption
``PULLING_OUT``            Bokare and Maurya, "Acceleration-deceleration behaviour of various
                           vehicle types", Transportation Research Procedia 25, 2017, in order of
                           magnitude; the bounds are assumptions
=========================  =====================================================================

The gaps in front of the ego are drawn so short that a driver who sees nothing coming meets who
takes them; most are below the critical gaps of the Highway Capacity Manual 2010, 4.1 s for a left
turn from the main road and 6.2 to 7.1 s from a side road. How often somebody does the one or the
other is an assumption throughout, and stands with each kind: the harmless and the dangerous are
about as frequent, far more than on a road on which one would have to wait for weeks.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from dosplan_sumo.script import Action, Script, Verb

from suitegen.futures.staging import EGO, FIRST_BRANCH, Moment
from suitegen.plain import Point
from suitegen.roads import Rng

START: Final = 3.0
"""Time for which the cast drives before the scenario starts, s."""
BRANCH: Final = FIRST_BRANCH
"""Time from the ego's start to the scripts of the futures, s."""
WARMUP: Final = 20.0
"""Time for which the background drives before the cast appears, s."""
LIGHT_MIX: Final[Mapping[str, float]] = MappingProxyType(
    {"car": 0.8, "van": 0.15, "motorcycle": 0.05}
)
"""Background traffic."""
FIRST: Final = 0.1
"""When a cast can be told something first, s: it is on the road then."""

WALKING: Final = (1.45, 0.25)
"""Mean and standard deviation of the walking speed, m/s."""
WALKING_BOUNDS: Final = (0.9, 2.2)
RUNNING: Final = (2.6, 3.6)
"""Bounds of the running speed, m/s."""
SETTING_OFF: Final = 2.0
"""Acceleration of somebody on foot, m/s2."""
DASHING: Final = 3.0
"""Acceleration of somebody who breaks into a run, m/s2."""
CYCLING: Final = (4.0, 5.5)
"""Bounds of the speed of cyclists, m/s."""
STOPPING_AT_AMBER: Final = 4.2
"""Hardest deceleration of who stops for a light, m/s2."""
RED_RUNNING: Final = (1.0, 1.15)
"""Bounds of the speed of who runs a light over the speed before."""
TURNING: Final = (5.5, 7.0)
"""Bounds of the speed in a left turn, m/s."""
PULLING_OUT: Final = (2.0, 2.8)
"""Bounds of the acceleration of who pulls out, m/s2."""


def walking_speed(rng: Rng) -> float:
    """Speed of somebody who walks, m/s."""
    mean, deviation = WALKING
    low, high = WALKING_BOUNDS
    return min(high, max(low, float(rng.normal(mean, deviation))))


def at_time(seconds: float) -> Moment:
    """The moment at which SUMO's time is so many seconds."""
    return lambda sumo: float(sumo.simulation.getTime()) >= seconds - 1e-6


def setting_off(metres: float, speed: float) -> float:
    """Time in which somebody who stands comes so far, s."""
    return metres / speed + 0.5 * speed / SETTING_OFF


def step_out(name: str, at: float, speed: float, way: tuple[Point, ...]) -> Action:
    """Somebody on foot walks from where it stands, m/s, after ``at``, s."""
    return Action(at, name, Verb.WALK, speed, over=speed / SETTING_OFF, way=way)


def halt(at: float, hard: float, stands: float = 0.2) -> Action:
    """The stand-in stops for what it sees coming, with ``hard`` m/s2."""
    return Action(at, EGO, Verb.HALT, hard, over=stands)


def slow(at: float, speed: float, to: float, hard: float = 6.0) -> Script:
    """The stand-in brakes from one speed to another, m/s, with ``hard`` m/s2."""
    over = (speed - to) / hard
    return Action(at, EGO, Verb.BRAKE, to, over=over), Action(at + over, EGO, Verb.FREE)


def stopping(speed: float, seconds: float) -> float:
    """Deceleration, m/s2, with which the stand-in stops 4 m short of where it would be in time."""
    return min(7.8, max(3.0, speed**2 / (2.0 * (speed * seconds - 4.0))))
