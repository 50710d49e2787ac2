"""How a cast is brought to the moment at which the scenario starts, and scenes of a cast alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from dosplan_sumo.script import Action, Script, Verb

from suitegen.futures.staging import FIRST_BRANCH, Act, Actor, Spot, Staging
from suitegen.plain import Network
from suitegen.roads import Rng, Road

LEAD_IN: Final = 3.0
"""Time that all drive before the scenario starts, s."""
BRANCH: Final = FIRST_BRANCH
"""From the start until the futures part, s."""


def started(connection: Any) -> bool:
    """Whether everybody has driven for ``LEAD_IN``."""
    return bool(connection.simulation.getTime() >= LEAD_IN)


def paced(speeds: Mapping[str, float]) -> Script:
    """Everybody drives at a speed of its own, and in its lane, from the beginning.

    Args:
        speeds: m/s, of each actor.

    Returns:
        The acts, which hold until others come.
    """
    acts = [Action(0.0, name, Verb.BRAKE, speed) for name, speed in speeds.items()]
    keeps = [Action(0.0, name, Verb.KEEP) for name in speeds]
    return (*acts, *keeps)


def released(at: float) -> Script:
    """From a moment on the stand-in drives as SUMO does, but in its lane.

    Args:
        at: When, s.

    Returns:
        The acts.
    """
    return (Action(at, "ego", Verb.FREE), Action(at, "ego", Verb.KEEP))


def paced_scene(
    network: Network,
    tags: tuple[str, ...],
    cast: Sequence[Actor],
    speeds: Mapping[str, float],
    futures: Callable[[int, Rng], Act],
    goal: Spot,
    seconds: float,
) -> Staging:
    """A scene of its cast alone, in which each drives at a speed of its own until the start.

    Args:
        network: The road.
        tags: Of the scenario.
        cast: Who is placed.
        speeds: m/s, of those who keep one.
        futures: Gives future k.
        goal: Centre of the goal.
        seconds: Time recorded after the start, s.

    Returns:
        The scene.
    """
    return Staging(
        Road(network, (), (), tags=tags),
        tuple(cast),
        started,
        futures,
        goal,
        seconds=seconds,
        warmup=0.0,
        prelude=paced(speeds),
    )
