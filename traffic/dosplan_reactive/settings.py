"""The options of the reactive traffic."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum

from dosplan.types.checks import check_numbers


class Manner(StrEnum):
    """Whom a road user gives way to."""

    STRICT = "strict"
    COURTEOUS = "courteous"


@dataclass(frozen=True)
class Intentions:
    """How road users differ in the futures that are not the recorded one.

    Attributes:
        speed_deviation: Standard deviation of the desired speed of vehicles as a share of the
            recorded one; twice that at most. SUMO's default for cars, ``normc(1, 0.1, 0.2, 2)``.
        reaction_mean: Mean of the reaction time, s, lognormal between 0.4 and 2.5 s: brake lights
            of a leader who is not expected to brake (Green, "How long does it take to stop?",
            Transportation Human Factors 2, 2000).
        reaction_deviation: Its standard deviation, s ("Fast-rise brake lamp as a
            collision-prevention device", Ergonomics, 1993).
        time_gap_spread: Standard deviation of the logarithm of the time gap, between 0.4 and 2.5
            times ``time_gap``; nine of ten are between 0.56 and 1.8 times. An assumption.
        courteous_share: Share of drivers who give way to an ego that will be there first. An
            assumption.
        glances: How often a driver looks away while it looks ahead, 1/s. An assumption: they look
            away for about a tenth of the time.
        glance_median: Median of how long, s, lognormal.
        glance_spread: Standard deviation of its logarithm: one of twenty glances is longer than
            1.7 s, beyond which Liang, Lee and Horrey ("A looming crisis", HFES 2014) find crashes.
        amber_mean: Mean of the deceleration up to which a driver stops at a yellow light, m/s2:
            what the Institute of Transportation Engineers times yellow lights for.
        amber_deviation: Its standard deviation, m/s2. An assumption.
        other_way_share: Share of drivers who take the path of somebody else who was in their lane,
            where there is one: a turn or a lane change. An assumption.
        walking_deviation: Standard deviation of the speed of people on foot and on bicycles, as a
            share of the recorded one; twice that at most (Fitzpatrick et al., "Improving pedestrian
            safety at unsignalized crossings", NCHRP 562, 2006: 1.45 m/s, and 1.15 m/s for the
            slowest 15 %).
        waiting_share: Share of people on foot who wait before they step onto the road. An
            assumption.
        waiting_mean: Mean of how long they wait, s, exponential. An assumption.
        stepping_out_share: Share of the others who do not wait where they are recorded to. An
            assumption.
    """

    speed_deviation: float = 0.1
    reaction_mean: float = 1.25
    reaction_deviation: float = 0.46
    time_gap_spread: float = 0.35
    courteous_share: float = 0.2
    glances: float = 0.12
    glance_median: float = 0.8
    glance_spread: float = 0.45
    amber_mean: float = 3.0
    amber_deviation: float = 0.5
    other_way_share: float = 0.2
    walking_deviation: float = 0.2
    waiting_share: float = 0.3
    waiting_mean: float = 2.0
    stepping_out_share: float = 0.2

    def __post_init__(self) -> None:
        shares = {field.name for field in fields(self) if field.name.endswith("_share")}
        check_numbers(self, positive={"reaction_mean", "glance_median"}, shares=shares)
        for name in ("speed_deviation", "walking_deviation"):
            if getattr(self, name) > 0.25:
                raise ValueError(f"{name} is {getattr(self, name):g}, expected 0.25 or less")


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
        intentions: How they differ in futures other than the recorded one.
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
    intentions: Intentions = Intentions()

    def __post_init__(self) -> None:
        check_numbers(self, positive={"acceleration", "deceleration", "full_braking", "look_ahead"})
