"""Scripts: what chosen road users of a simulation do from a moment on, told to SUMO as it runs.

A script makes one future of a scene: the leader brakes, or goes on. Everybody whom it does not
name, and everybody whom it has let go, is driven by SUMO.

Vehicles are told speeds, lanes and routes. People on foot, and vehicles that leave the lanes, are
led along lines of their own (``Verb.WALK``). SUMO knows people as vehicles as small as a person: so
its drivers see them wherever they step, which they would not if they were SUMO's pedestrians, who
stay on sidewalks and crossings.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain
from typing import Any, Final

Point = tuple[float, float]

DECIMALS: Final = 3
"""To how many decimals files keep the numbers of a script."""

OBEDIENT: Final = 31
"""SUMO's speed mode of a vehicle that keeps every rule: five bits, see the next four."""
_BOUNDED_BRAKING: Final = 4
_RIGHT_OF_WAY: Final = 8
_RED_LIGHTS: Final = 16
_FOES_INSIDE: Final = 32  # This bit switches a rule off; the others switch theirs on.

_OWN_SPEED: Final = -1.0
"""What SUMO is told as the speed of a vehicle that drives as it likes again."""
OWN_LANES: Final = 1621
"""SUMO's lane change mode of a vehicle that changes lanes as it likes."""
_TOLD_LANES: Final = 0
"""The same of one that changes them only as it is told."""


class Verb(StrEnum):
    """What a road user can be told. The fields of ``Action`` that count are in brackets.

    Attributes:
        SPEED: Drive at a speed (``value``, m/s) as far as leaders and rules let it, as fast as its
            type gets there.
        BRAKE: Change the speed evenly to ``value``, m/s, within ``over``, s, and hold it; as hard
            as that asks, whatever its type brakes like by itself.
        HALT: Brake to a stop at ``value``, m/s2, stand for ``over``, s, and go on by itself.
        FREE: Do as SUMO likes again.
        LANE: Change to the lane with the index ``value`` from the right, whoever is there, and keep
            to it; as fast sideways as its type goes.
        KEEP: Change no lanes any more.
        ASIDE: Drive ``value``, m, to the left of the lane's middle.
        ROUTE: Go on to another last edge (``edge``).
        CARELESS: Heed neither right of way, nor red lights, nor who is inside the junction; those
            ahead in its own lane it does.
        START: Leave the place where it stops.
        WALK: Go along a line (``way``, m, from where it is) at ``value``, m/s, which it reaches
            evenly within ``over``, s; free of lanes. It stands at the end of the line.
        WAIT: Stand where it is; or, where ``way`` has a point, at that point from now on, facing
            the second point if there is one.
    """

    SPEED = "speed"
    BRAKE = "brake"
    HALT = "halt"
    FREE = "free"
    LANE = "lane"
    KEEP = "keep"
    ASIDE = "aside"
    ROUTE = "route"
    CARELESS = "careless"
    START = "start"
    WALK = "walk"
    WAIT = "wait"


@dataclass(frozen=True)
class Action:
    """One thing that one road user does.

    Attributes:
        at: When, s after the moment at which the script begins.
        actor: SUMO's name of the road user.
        verb: What; see ``Verb`` for what the other fields mean.
        value: A speed, m/s, a deceleration, m/s2, an offset, m, or the index of a lane.
        over: A duration, s.
        edge: An edge.
        way: Points, m.
    """

    at: float
    actor: str
    verb: Verb
    value: float = 0.0
    over: float = 0.0
    edge: str = ""
    way: tuple[Point, ...] = ()


Script = tuple[Action, ...]


def rounded(script: Iterable[Action]) -> Script:
    """A script in whole thousandths, as files keep it.

    Args:
        script: The script.

    Returns:
        It, with times, values and points rounded.
    """
    return tuple(
        replace(
            action,
            at=round(action.at, DECIMALS),
            value=round(action.value, DECIMALS),
            over=round(action.over, DECIMALS),
            way=tuple((round(x, DECIMALS), round(y, DECIMALS)) for x, y in action.way),
        )
        for action in script
    )


def script_json(script: Iterable[Action]) -> list[dict[str, Any]]:
    """A script for a JSON file.

    Args:
        script: The script.

    Returns:
        An object for each action, with the fields that are not at their defaults.
    """
    rows = []
    for action in script:
        row: dict[str, Any] = {"at": action.at, "actor": action.actor, "verb": action.verb.value}
        row |= {
            key: getattr(action, key) for key in ("value", "over", "edge") if getattr(action, key)
        }
        if action.way:
            row["way"] = [list(point) for point in action.way]
        rows.append(row)
    return rows


def read_script(rows: Iterable[Mapping[str, Any]]) -> Script:
    """Reads what ``script_json`` gives.

    Args:
        rows: Objects of a JSON file.

    Returns:
        The script.

    Raises:
        ValueError: One is no action; the message is one line.
    """
    script = []
    for row in rows:
        try:
            action = Action(
                at=float(row["at"]),
                actor=str(row["actor"]),
                verb=Verb(row["verb"]),
                value=float(row.get("value", 0.0)),
                over=float(row.get("over", 0.0)),
                edge=str(row.get("edge", "")),
                way=tuple((float(x), float(y)) for x, y in row.get("way", ())),
            )
            _check(action)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"no action of a script: {str(row)[:120]} ({error!r})") from None
        script.append(action)
    return tuple(script)


def _check(action: Action) -> None:
    """Raises where an action could not be played."""
    numbers = (action.at, action.value, action.over, *chain.from_iterable(action.way))
    if not all(map(math.isfinite, numbers)) or action.at < 0.0 or action.over < 0.0:
        raise ValueError("numbers are finite, and times 0 or more")
    if action.verb is Verb.HALT and action.value <= 0.0:
        raise ValueError("a deceleration is more than 0")
    if action.verb is Verb.WALK and action.value < 0.0:
        raise ValueError("nobody walks backwards")


class Executor:
    """Tells SUMO what scripts say, step by step."""

    def __init__(self, sumo: Any) -> None:
        """Begins without any script.

        Args:
            sumo: The connection: ``libsumo``, or what has the same functions.
        """
        self._sumo = sumo
        self._due: list[tuple[float, Action]] = []
        self._led: dict[str, _Led] = {}
        self._then: dict[str, list[tuple[float, float]]] = {}

    @property
    def led(self) -> Mapping[str, float]:
        """Who is led along a line, and how fast, m/s; SUMO does not always know its speed."""
        return {actor: led.speed for actor, led in self._led.items()}

    def play(self, script: Iterable[Action], begin: float) -> None:
        """Adds a script.

        Args:
            script: The script; actions on who is not on the road when they are due do nothing.
            begin: SUMO's time from which its times count, s.
        """
        self._due.extend((begin + action.at, action) for action in script)
        self._due.sort(key=lambda pair: pair[0])

    def step(self, time: float, dt: float) -> None:
        """Tells what is due; to be called before each step of SUMO.

        Args:
            time: SUMO's time at which the step begins, s.
            dt: Length of the step, s.
        """
        on_road = set(self._sumo.vehicle.getIDList())
        while self._due and self._due[0][0] <= time + 0.5 * dt:
            _, action = self._due.pop(0)
            if action.actor in on_road:
                self._tell(action, time)
        for actor, later in self._then.items():
            while later and later[0][0] <= time + 0.5 * dt:
                _, speed = later.pop(0)
                if actor in on_road:
                    self._sumo.vehicle.setSpeed(actor, speed)
        for actor, led in self._led.items():
            if actor in on_road:
                (x, y), angle = led.next(dt)
                self._sumo.vehicle.moveToXY(actor, "", -1, x, y, angle=angle, keepRoute=2)

    def _tell(self, action: Action, time: float) -> None:
        vehicle, actor, value = self._sumo.vehicle, action.actor, action.value
        match action.verb:
            case Verb.SPEED:
                self._then.pop(actor, None)
                vehicle.setSpeed(actor, value)
            case Verb.BRAKE:
                self._brake(actor, value, action.over)
                self._then[actor] = [(time + action.over, value)]
            case Verb.HALT:
                duration = float(vehicle.getSpeed(actor)) / value
                self._brake(actor, 0.0, duration)
                stands = time + duration
                self._then[actor] = [(stands, 0.0), (stands + action.over, _OWN_SPEED)]
            case Verb.FREE:
                self._then.pop(actor, None)
                self._led.pop(actor, None)
                vehicle.setSpeedMode(actor, OBEDIENT)
                vehicle.setLaneChangeMode(actor, OWN_LANES)
                vehicle.setSpeed(actor, _OWN_SPEED)
            case Verb.LANE:
                vehicle.setLaneChangeMode(actor, _TOLD_LANES)
                vehicle.changeSublane(actor, self._way_aside(actor, int(value)))
            case Verb.KEEP:
                vehicle.setLaneChangeMode(actor, _TOLD_LANES)
            case Verb.ASIDE:
                vehicle.setLateralAlignment(actor, f"{value:.3f}")
            case Verb.ROUTE:
                vehicle.changeTarget(actor, action.edge)
            case Verb.CARELESS:
                mode = int(vehicle.getSpeedMode(actor)) & ~(_RIGHT_OF_WAY | _RED_LIGHTS)
                vehicle.setSpeedMode(actor, mode | _FOES_INSIDE)
            case Verb.START:
                vehicle.resume(actor)
            case Verb.WALK | Verb.WAIT:
                led = self._led.get(actor) or _Led.of(self._sumo, actor)
                self._led[actor] = led.told(action)

    def _way_aside(self, actor: str, lane: int) -> float:
        """Way to the left from where a vehicle is to the middle of a lane, m."""
        vehicle, own = self._sumo.vehicle, int(self._sumo.vehicle.getLaneIndex(actor))
        edge = vehicle.getRoadID(actor)
        low, high = min(own, lane), max(own, lane)
        widths = [self._sumo.lane.getWidth(f"{edge}_{i}") for i in range(low, high + 1)]
        apart = sum(widths) - 0.5 * (widths[0] + widths[-1])
        way = apart if lane > own else -apart
        return float(way - vehicle.getLateralLanePosition(actor))

    def _brake(self, actor: str, speed: float, duration: float) -> None:
        vehicle = self._sumo.vehicle
        vehicle.setSpeedMode(actor, int(vehicle.getSpeedMode(actor)) & ~_BOUNDED_BRAKING)
        vehicle.slowDown(actor, speed, duration)


@dataclass
class _Led:
    """Somebody who goes along a line.

    Attributes:
        place: Where it is, m.
        angle: SUMO's angle, degrees.
        speed: m/s.
        wanted: The speed that it takes up, m/s.
        gain: At what rate, m/s2.
        way: Points before it, m.
    """

    place: Point
    angle: float
    speed: float = 0.0
    wanted: float = 0.0
    gain: float = math.inf
    way: tuple[Point, ...] = ()

    @classmethod
    def of(cls, sumo: Any, actor: str) -> _Led:
        """Who is led from where SUMO has it."""
        x, y = sumo.vehicle.getPosition(actor)
        angle, speed = sumo.vehicle.getAngle(actor), sumo.vehicle.getSpeed(actor)
        return cls((float(x), float(y)), float(angle), float(speed))

    def told(self, action: Action) -> _Led:
        """What it does from now on."""
        if action.verb is Verb.WALK:
            gain = abs(action.value - self.speed) / action.over if action.over else math.inf
            return _Led(self.place, self.angle, self.speed, action.value, gain, action.way)
        if not action.way:
            return _Led(self.place, self.angle)
        facing = action.way[1:]
        angle = _angle(action.way[0], facing[0]) if facing else self.angle
        return _Led(action.way[0], angle)

    def next(self, dt: float) -> tuple[Point, float]:
        """Place and angle a step later."""
        change = max(-self.gain * dt, min(self.gain * dt, self.wanted - self.speed))
        self.speed += change
        left = self.speed * dt
        while self.way and left > 0.0:
            gap = math.dist(self.place, self.way[0])
            if gap > 0.0:
                self.angle = _angle(self.place, self.way[0])
            if gap > left:
                share = left / gap
                x, y = self.place
                end_x, end_y = self.way[0]
                self.place = (x + share * (end_x - x), y + share * (end_y - y))
                break
            self.place, self.way, left = self.way[0], self.way[1:], left - gap
        if not self.way:
            self.speed = 0.0
        return self.place, self.angle


def _angle(start: Point, end: Point) -> float:
    """SUMO's angle of a direction, degrees clockwise from north."""
    return math.degrees(math.atan2(end[0] - start[0], end[1] - start[1])) % 360.0
