"""Whether dosplan itself makes of a scene what the suite asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dosplan.types import FloatArray, Scenario


@dataclass(frozen=True)
class Judgement:
    """What is thought of a scenario.

    Attributes:
        reason: Why it is rejected, the same for all of its like; empty where it is accepted.
        defeats: Who is defeated, in which futures.
    """

    reason: str
    defeats: str


def judge(scenario: Scenario, drives: Sequence[FloatArray]) -> Judgement:
    """Judges a scenario.

    Args:
        scenario: The scenario with its futures.
        drives: (K, 4) states of the stand-in of each future, from the ego's start until it is in
            the goal: centre x, y, m, heading, rad, velocity, m/s.

    Returns:
        What is thought of it.
    """
    return Judgement("", "")
