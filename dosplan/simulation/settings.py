"""The loop between the ego and its world: how often it plans, how late, and what it sees.

In the ideal loop a plan is made at each step, from exact states, and acts at once. On a car nothing
of this holds. ``REALISTIC`` has the figures that were published of real stacks; where each of them
comes from stands in ``docs/loop.md``. They were written down before anything was driven with them,
and are not to be fitted to results.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from types import MappingProxyType
from typing import Any, Final

from dosplan.types import STEP_SECONDS
from dosplan.types.checks import check_numbers

_SLACK: Final = 1e-6  # Parts of a step by which a time may miss a whole number of them.


@dataclass(frozen=True)
class SensingSettings:
    """What the ego sees of the other road users, and how well. It knows its own state exactly.

    An error is a first-order Gauss-Markov process, as the errors of a tracker go on from one moment
    to the next: its correlation falls to 1/e in ``correlation``. Scenery (``RoadUserKind.STATIC``)
    has neither errors nor drop-outs: the figures are those of road users, and walls are on the map.

    Attributes:
        position: Standard deviation of the error of a centre along x and along y, m.
        speed: Standard deviation of the error of the speed of those that can move, m/s.
        heading: Standard deviation of the error of the heading, rad.
        size: Standard deviation of the error of length and of width, as a share of them.
        correlation: Correlation time of these errors, s.
        dropout_rate: How often a road user is lost, times a second.
        dropout_duration: For how long then, in the mean of an exponential distribution, s.
        memory: How long one that is not seen any more is carried on at constant velocity, s.
            After that it is no longer observed, as one that was never seen.
        range: How far the sensors see, from centre to centre, m; None for everywhere.
        occlusion: Whether road users and obstacles hide what is behind them.
    """

    position: float = 0.0
    speed: float = 0.0
    heading: float = 0.0
    size: float = 0.0
    correlation: float = 0.5
    dropout_rate: float = 0.0
    dropout_duration: float = 0.5
    memory: float = 1.5
    range: float | None = None
    occlusion: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.dropout_rate * STEP_SECONDS <= 1.0:
            raise ValueError(
                f"dropout_rate is {self.dropout_rate} a second, "
                f"expected 0 to {1.0 / STEP_SECONDS:g}"
            )
        if not STEP_SECONDS <= self.dropout_duration < math.inf:
            raise ValueError(
                f"dropout_duration is {self.dropout_duration}, "
                f"expected {STEP_SECONDS} s or more, and finite"
            )
        if self.range is not None and not 0.0 < self.range < math.inf:
            raise ValueError(f"range is {self.range}, expected more than 0 and finite, or None")
        check_numbers(self)

    @property
    def noisy(self) -> bool:
        """Whether states are measured with errors."""
        return any((self.position, self.speed, self.heading))

    @property
    def errs(self) -> bool:
        """Whether road users who are in reach and in sight are seen with errors or gaps."""
        return self.noisy or any((self.size, self.dropout_rate))

    @property
    def exact(self) -> bool:
        """Whether all road users are seen as they are."""
        return not self.errs and self.range is None and not self.occlusion


@dataclass(frozen=True)
class ActuatorSettings:
    """How the ego's actuators follow what is asked of them: as first-order lags.

    Attributes:
        acceleration: Time constant of the acceleration, s; 0 for at once.
        steering: Time constant of the steering rate, s. That of the steering angle is the same.
    """

    acceleration: float = 0.0
    steering: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True)
class LoopSettings:
    """The loop of an episode; the defaults are the ideal one.

    Times are counted in steps: a scenario has steps of ``STEP_SECONDS`` once it is loaded, whatever
    its file has.

    Attributes:
        period: From one plan to the next, s; a multiple of the step.
        latency: From what the sensors see to the first step that is driven from it, s; a multiple
            of the step. What acts until then is on its way and is known: a plan is made for the
            state in which the ego will be. The first plan of an episode acts at once, as the ego
            is under way when it begins and nothing earlier is known.
        real_time: Whether the time that prediction and plan take is added to the latency, rounded
            up to steps. The last plan goes on until then, and no other plan is begun. Such an
            episode cannot be repeated.
        sensing: What is seen of the road users.
        actuators: How the ego follows its plans.
    """

    period: float = STEP_SECONDS
    latency: float = 0.0
    real_time: bool = False
    sensing: SensingSettings = field(default_factory=SensingSettings)
    actuators: ActuatorSettings = field(default_factory=ActuatorSettings)

    def __post_init__(self) -> None:
        for name, least in (("period", 1), ("latency", 0)):
            value = getattr(self, name)
            steps = value / STEP_SECONDS
            if not math.isfinite(steps) or abs(steps - round(steps)) > _SLACK:
                raise ValueError(
                    f"{name} is {value} s, expected a multiple of the step, {STEP_SECONDS} s"
                )
            if round(steps) < least:
                raise ValueError(f"{name} is {value} s, expected {least * STEP_SECONDS:g} or more")

    @property
    def period_steps(self) -> int:
        """Steps from one plan to the next."""
        return round(self.period / STEP_SECONDS)

    @property
    def latency_steps(self) -> int:
        """Steps from an observation to the first that is driven from it."""
        return round(self.latency / STEP_SECONDS)

    @property
    def late(self) -> bool:
        """Whether a plan acts later than what it is made from was seen."""
        return self.latency_steps > 0 or self.real_time


IDEAL: Final = LoopSettings()
REALISTIC: Final = LoopSettings(
    period=0.1,
    latency=0.3,
    sensing=SensingSettings(
        position=0.15,
        speed=0.25,
        heading=0.075,
        size=0.06,
        correlation=0.5,
        dropout_rate=0.03,
        dropout_duration=0.5,
        memory=1.5,
        range=120.0,
        occlusion=True,
    ),
    actuators=ActuatorSettings(acceleration=0.1, steering=0.27),
)
LOOPS: Final[Mapping[str, LoopSettings]] = MappingProxyType(
    {"ideal": IDEAL, "realistic": REALISTIC}
)
"""The loops that have a name."""
REAL_TIME: Final = "real_time=True"
"""Part of the name of a loop that charges the time that plans take."""


def loop_name(loop: LoopSettings) -> str:
    """Names a loop as rows and titles do.

    Args:
        loop: The loop.

    Returns:
        Its name; where it has none, that of the most similar one and what differs from it, such as
        ``ideal, latency=0.3``.
    """
    own = dict(_leaves(loop))
    differences = {
        name: {key: value for key, value in own.items() if value != known[key]}
        for name, known in ((name, dict(_leaves(named))) for name, named in LOOPS.items())
    }
    name, changed = min(differences.items(), key=lambda pair: len(pair[1]))
    return ", ".join([name, *(f"{key}={value}" for key, value in changed.items())])


def _leaves(settings: Any, inside: str = "") -> Iterator[tuple[str, Any]]:
    for part in fields(settings):
        value = getattr(settings, part.name)
        if is_dataclass(value):
            yield from _leaves(value, f"{inside}{part.name}.")
        else:
            yield f"{inside}{part.name}", value
