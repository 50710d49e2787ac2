"""What a scene is made of: a road, a cast, the moment at which it begins, what may come then."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from dosplan_sumo.acts import Act as Act  # Part of a staging.
from dosplan_sumo.script import Script

from suitegen.plain import Point
from suitegen.roads import Rng, Road

EGO = "ego"
"""Name of the stand-in for the ego; its kind in ``traffic.KINDS`` as well."""
PEDESTRIAN = "pedestrian"
PARKED = "parked"
FIRST_BRANCH = 0.8
"""Least time between the ego's start and the moment from which futures may differ, s.

What is recorded at a step depends on the traces of the next 0.8 s, see ``motion``.
"""


@dataclass(frozen=True)
class Spot:
    """A place on a lane.

    Attributes:
        edge: Edge.
        position: Along the lane, m.
        lane: Index from the right; sidewalks and cycle lanes count.
    """

    edge: str
    position: float
    lane: int = 0


@dataclass(frozen=True)
class Stop:
    """Where a vehicle stands until a script has it start.

    Attributes:
        at: Where its front bumper stands.
        lateral: Its middle, to the left of the lane's middle, m.
    """

    at: Spot
    lateral: float = 0.0


@dataclass(frozen=True)
class Actor:
    """A road user whom a scene places, and whom scripts may tell what to do.

    Attributes:
        id: Its name.
        kind: A key of ``traffic.KINDS``, ``parked`` or ``pedestrian``.
        route: Edges that it passes: the first one, more where they are needed, the last one. For
            people, an edge near which they stand.
        position: Of the front bumper along the first edge, m.
        speed: At departure, m/s; None for as fast as SUMO lets it drive there.
        depart: When it appears, s after the warm-up.
        lane: Index from the right; sidewalks and cycle lanes count.
        lateral: Its middle, to the left of the lane's middle, m.
        stops: Where it stands.
        at: Where somebody stands free of lanes, m: people, and who is led from there; or None.
        facing: A point that it looks at, m, or None.
        size: Length and width, m; None for one that is drawn by the kind.
        driver: Attributes of SUMO's vehicle type, which replace those that are drawn.
    """

    id: str
    kind: str
    route: tuple[str, ...]
    position: float
    speed: float | None = None
    depart: float = 0.0
    lane: int = 0
    lateral: float = 0.0
    stops: tuple[Stop, ...] = ()
    at: Point | None = None
    facing: Point | None = None
    size: tuple[float, float] | None = None
    driver: Mapping[str, str] = field(default_factory=dict)


Moment = Callable[[Any], bool]
"""Whether the scene begins, told SUMO's library (``libsumo``) after a step."""


@dataclass(frozen=True)
class Staging:
    """A scene.

    Attributes:
        road: Network, background traffic and tags.
        cast: Who is placed; the one called ``ego`` stands in for the ego.
        moment: The first step at which it is true becomes the ego's start.
        futures: Gives future k, with a generator that all futures share. Where all that are drawn
            have one intention, all are drawn again.
        goal: Centre of the goal, which the stand-in reaches in every future.
        goal_size: Length and width of the goal, m.
        branch: Time from the ego's start to the begin of the scripts, s; ``FIRST_BRANCH`` or more.
        seconds: Time recorded after the ego's start, 10 to 15 s.
        warmup: Time for which the background drives before the cast appears, s.
        prelude: What the cast is told from its appearance on, the same in every future.
    """

    road: Road
    cast: tuple[Actor, ...]
    moment: Moment
    futures: Callable[[int, Rng], Act]
    goal: Spot
    goal_size: tuple[float, float] = (12.0, 3.4)
    branch: float = FIRST_BRANCH
    seconds: float = 13.0
    warmup: float = 20.0
    prelude: Script = ()


@dataclass(frozen=True)
class Kind:
    """A kind of scene.

    Attributes:
        name: What it is called in tables.
        code: What it is called in CommonRoad ids, in letters.
        draw: Draws a scene.
        description: What happens, and what the past does not tell.
        intentions: The distribution that futures are drawn from, and its source.
        interplan: What interPlan has of it.
        new: What it has not.
    """

    name: str
    code: str
    draw: Callable[[Rng], Staging]
    description: str
    intentions: str
    interplan: str
    new: str
