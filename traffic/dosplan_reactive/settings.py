"""The options of the reactive traffic."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum


class Manner(StrEnum):
    """Whom a road user gives way to."""

    STRICT = "strict"
    COURTEOUS = "courteous"


@dataclass(frozen=True)
class ReactiveSettings:
    """How road users drive once they have to react; the recording says how they drive before.

    The figures of the car-following model are those of Treiber and Kesting, "Traffic Flow
    Dynamics", 2013, table 11.2 (city traffic), with a more common deceleration of 2 m/s2.

    Attributes:
        manner: ``strict``: a road user brakes for what is on its way now. ``courteous``: it also
            gives way to an ego that will be there first, as it looks 2.4 s ahead.
        acceleration: Acceleration of who catches up, m/s2.
        deceleration: Comfortable deceleration, m/s2.
        full_braking: Largest deceleration, m/s2.
        least_gap: Gap to a leader at a standstill, m.
        time_gap: Time gap to a leader, s.
        side_margin: What is added to each side of a road user to give its corridor, m.
        reaction_time: Time from when the ego is in the way until a road user brakes for it, s.
        look_ahead: How long before it would reach the ego a road user sees that it will, s.
        needed_braking: Deceleration that must be needed before the ego, or who crosses, counts as
            in the way, m/s2.
        crossing_margin: Time between two road users at a crossing that both take for free, s.
    """

    manner: Manner = Manner.STRICT
    acceleration: float = 1.5
    deceleration: float = 2.0
    full_braking: float = 8.0
    least_gap: float = 2.0
    time_gap: float = 1.0
    side_margin: float = 0.2
    reaction_time: float = 0.5
    look_ahead: float = 4.0
    needed_braking: float = 1.0
    crossing_margin: float = 0.5

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not value >= 0.0:
                raise ValueError(f"{field.name} is {value:g}, expected 0 or more")
        for name in ("acceleration", "deceleration", "full_braking", "look_ahead"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name):g}, expected more than 0")
