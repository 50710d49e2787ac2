"""Traffic lights on the way of the ego: where it waited for one, and which it ran."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import Final

from dosplan.geometry import ReferencePath
from dosplan.results.drive import Drive
from dosplan.scoring.part import DrivenPart
from dosplan.scoring.rules import STANDING, red_light_runs
from dosplan.types import USER_VELOCITY, LightColour, RouteStop, StopCause

AHEAD: Final = 30.0
"""Who stands for a light stands so near to its line, m: a few cars may be between."""

_OVER: Final = 2.0  # m; whose front is farther over the line has not stopped for its light.


@dataclass(frozen=True)
class Wait:
    """A time during which the ego stood before a red light.

    Attributes:
        lights: Ids of the lights that hold for its way.
        start: When it began to stand, s since the start of the drive.
        end: When it drove on, or the drive was decided, s.
        distance: From its front to the line as it began to stand, m.
        red_since: When the light had turned red, s since the start; negative before it.
        red_until: When it was red no more; None where it still was at the end of the drive.
    """

    lights: tuple[int, ...]
    start: float
    end: float
    distance: float
    red_since: float
    red_until: float | None

    def line(self) -> str:
        """The wait, in plain words."""
        until = "" if self.red_until is None else f", until {self.red_until:.1f} s"
        return (
            f"stood {self.end - self.start:.1f} s before {_named(self.lights)}, "
            f"{_place(self.distance)}, from {self.start:.1f} s on; "
            f"red since {_moment(self.red_since)}{until}"
        )


@dataclass(frozen=True)
class RedLight:
    """A red light that the ego ran, as the metric ``red_lights`` counts them.

    Attributes:
        step: The last step before the line.
        seconds: Since the start of the drive, s.
        lights: Ids of the lights that forbade it.
        colour: What they showed.
        shown_since: When they had begun to, s since the start; negative before it.
        velocity: Of the ego, m/s.
    """

    step: int
    seconds: float
    lights: tuple[int, ...]
    colour: LightColour
    shown_since: float
    velocity: float

    def line(self) -> str:
        """The light that was run, in plain words."""
        colour = "red" if self.colour is LightColour.RED else "red with yellow"
        return (
            f"ran {_named(self.lights)} at step {self.step}, {self.seconds:.1f} s after the start, "
            f"at {self.velocity:.1f} m/s; {colour} since {_moment(self.shown_since)}"
        )


@dataclass(frozen=True)
class LightFacts:
    """The lights that mattered in a drive.

    Attributes:
        waits: Where the ego stood before a red light, in their order.
        runs: The red lights that it ran, in their order.
    """

    waits: tuple[Wait, ...]
    runs: tuple[RedLight, ...]

    def lines(self) -> list[str]:
        """The lights, in plain words."""
        return [*(run.line() for run in self.runs), *(wait.line() for wait in self.waits)]


def light_facts(drive: Drive) -> LightFacts | None:
    """Gathers what the lights had to do with a drive.

    Args:
        drive: The drive, with its scenario.

    Returns:
        The facts; None where the ego neither waited for a light nor ran one.
    """
    facts = LightFacts(waits=tuple(_waits(drive)), runs=tuple(_runs(drive)))
    return facts if facts.waits or facts.runs else None


def _waits(drive: Drive) -> list[Wait]:
    stops = [x for x in drive.scenario.task.route.stops if x.cause is StopCause.LIGHT]
    if not stops:
        return []
    along = ReferencePath.of(drive.scenario.task.route).follow(drive.ego[:, :2])
    front = along + 0.5 * drive.vehicle.length
    waited: list[RouteStop | None] = []
    for index, state in enumerate(drive.ego):
        shown = drive.signals.at(drive.start + index)
        left = [stop for stop in stops if -_OVER <= stop.arclength - front[index] <= AHEAD]
        stands = abs(state[USER_VELOCITY]) < STANDING
        held = stands and left and shown.shown(left[0].lights).forbids
        waited.append(left[0] if held else None)
    found, index = [], 0
    for stop, members in groupby(waited):
        steps = len(list(members))
        if stop is not None and steps > 1:
            found.append(_wait(drive, stop, index, index + steps, float(front[index])))
        index += steps
    return found


def _wait(drive: Drive, stop: RouteStop, first: int, end: int, front: float) -> Wait:
    """A wait from one index of the states to before another."""
    later = range(drive.start + end - 1, drive.start + len(drive.ego))
    forbidden = [drive.signals.at(step).shown(stop.lights).forbids for step in later]
    green = next((step for step, red in zip(later, forbidden, strict=True) if not red), None)
    return Wait(
        lights=stop.lights,
        start=drive.seconds(drive.start + first),
        end=drive.seconds(drive.start + min(end, len(drive.ego) - 1)),
        distance=stop.arclength - front,
        red_since=_since(drive, stop.lights, drive.start + first),
        red_until=None if green is None else drive.seconds(green),
    )


def _runs(drive: Drive) -> list[RedLight]:
    found = []
    part = DrivenPart(drive.scenario, drive.start, drive.ego, drive.signals)
    for run in red_light_runs(part):
        velocity = drive.ego[run.step - drive.start, USER_VELOCITY]
        found.append(
            RedLight(
                step=run.step,
                seconds=drive.seconds(run.step),
                lights=run.lights,
                colour=drive.signals.at(run.step).shown(run.lights),
                shown_since=_since(drive, run.lights, run.step),
                velocity=float(velocity),
            )
        )
    return found


def _since(drive: Drive, lights: tuple[int, ...], step: int) -> float:
    """When lights began to show what they show together at a step, s since the start."""
    states = drive.signals.at(step)
    colour = states.shown(lights)
    return drive.seconds(step) - max(
        states.seconds(light) for light in lights if states.colour(light) is colour
    )


def _named(lights: tuple[int, ...]) -> str:
    plural = "s" if len(lights) > 1 else ""
    return f"light{plural} {', '.join(map(str, sorted(lights)))}"


def _place(distance: float) -> str:
    where = "before" if distance >= 0.0 else "over"
    return f"{abs(distance):.1f} m {where} the line"


def _moment(seconds: float) -> str:
    if seconds < 0.0:
        return f"{-seconds:.1f} s before the start"
    return f"{seconds:.1f} s after the start"
