"""How a cast is brought to the moment at which the scenario starts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dosplan_sumo.script import Action, Script, Verb

from suitegen.futures.staging import FIRST_BRANCH

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
