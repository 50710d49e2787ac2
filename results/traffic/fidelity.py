"""How far the reactive traffic is off the recording, whether it stays apart, and what it costs.

    python results/traffic/fidelity.py SOURCE... [--limit N] [--json FILE]

For each source, such as `suite` or a folder of recordings:

- *nobody*: the ego is far away; is every road user where it is recorded, to the last bit?
- *recorded*: recorded vehicles take the ego's place, one after the other, and drive as they did.
  All others were there then, so whoever brakes does so for nothing: how far is it off the recording
  after 3 and 10 s, and how many are exactly where they are recorded?
- *brake*: the ego brakes from its start until it stands; *cruise*: it keeps its speed along its
  route, whatever comes. Which road users overlap one another that never do in the recording, and
  who runs into the ego from behind without a cut-in?
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from dosplan_baseline.brake import BrakePlanner
from dosplan_baseline.cruise import CruisePlanner
from dosplan_reactive.paths import VEHICLES
from dosplan_reactive.settings import ReactiveSettings
from dosplan_reactive.traffic import ReactiveTraffic
from dosplan_simple.predictors import NonePredictor

from dosplan.api import Planner
from dosplan.geometry import rectangle_corners
from dosplan.scenario import ScenarioError, load_scenario
from dosplan.scenario.sources.catalogue import find_scenarios
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.types import (
    EGO_SIZE,
    USER_HEADING,
    USER_VELOCITY,
    Arm,
    CollisionClass,
    Episode,
    FloatArray,
    RoadUserKind,
    Scenario,
    Tracks,
)

EGOS: Final = 3
"""Recorded vehicles that take the ego's place in a scenario."""
SHRINK: Final = 0.02  # What is taken off every side before shapes overlap, m.


class TimedTraffic(ReactiveTraffic):
    """Notes how long each step takes."""

    name = ReactiveTraffic.name

    def __init__(self, future: int = 0) -> None:
        super().__init__(future=future)
        self.seconds: list[float] = []

    def step(self, step: int, ego: FloatArray):  # type: ignore[no-untyped-def]
        """A step of the traffic."""
        started = time.process_time()
        users = super().step(step, ego)
        self.seconds.append(time.process_time() - started)
        return users


@dataclass
class Figures:
    """What was measured on a source."""

    scenarios: int = 0
    not_as_recorded: int = 0
    egos: int = 0
    off: dict[int, list[float]] = field(default_factory=lambda: {30: [], 100: []})
    overlaps: dict[str, int] = field(default_factory=dict)
    rear_ends: dict[str, dict[str, int]] = field(default_factory=dict)
    drives: dict[str, int] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    named: list[str] = field(default_factory=list)

    def summary(self) -> dict[str, object]:
        """The figures that are published."""
        found: dict[str, object] = {
            "scenarios": self.scenarios,
            "scenarios not as recorded without an ego": self.not_as_recorded,
            "recorded vehicles as the ego": self.egos,
        }
        for steps, off in self.off.items():
            if off:
                values = np.array(off)
                found[f"after {steps / 10:g} s"] = {
                    "vehicles": len(values),
                    "mean m off": round(float(values.mean()), 4),
                    "99th percentile m off": round(float(np.percentile(values, 99)), 3),
                    "exact %": round(100 * float(np.mean(values == 0.0)), 2),
                }
        found["drives"] = self.drives
        found["pairs that overlap and are not recorded to"] = self.overlaps
        found["ego hit from behind without a cut-in"] = self.rear_ends
        milliseconds = 1e3 * np.array(self.seconds)
        found["ms of processor time a step"] = {
            "steps": len(milliseconds),
            "median": round(float(np.median(milliseconds)), 2),
            "99th percentile": round(float(np.percentile(milliseconds, 99)), 2),
        }
        return found


def measure(source: str, limit: int | None, future: int) -> Figures:
    """Measures a source.

    Args:
        source: As of `dosplan run`.
        limit: Number of scenarios, spread over the source; all of them where None.
        future: Which continuation is driven with the planners.

    Returns:
        The figures.
    """
    figures = Figures()
    refs = find_scenarios(source)
    if limit is not None and limit < len(refs):
        refs = [refs[i] for i in np.linspace(0, len(refs) - 1, limit).astype(int)]
    for ref in refs:
        try:
            scenario = load_scenario(ref)
        except ScenarioError:
            continue
        figures.scenarios += 1
        figures.not_as_recorded += not nobody(scenario)
        for ego in recorded_egos(scenario):
            recorded(scenario, ego, figures)
        planners: tuple[tuple[str, Planner], ...] = (
            ("brake", BrakePlanner()),
            ("cruise", CruisePlanner()),
        )
        for name, planner in planners:
            drive(scenario, name, planner, future, figures)
    return figures


def nobody(scenario: Scenario) -> bool:
    """Whether the recording comes back to the last bit where the ego is far away."""
    traffic, tracks = ReactiveTraffic(), scenario.tracks
    traffic.begin(scenario, 0)
    ego = np.zeros((2, EGO_SIZE))
    ego[:, 0] = 1e6
    for step in range(1, tracks.steps):
        users, valid = traffic.step(step, ego), tracks.valid[:, step]
        if not np.array_equal(users.ids, tracks.ids[valid]):
            return False
        if not np.array_equal(users.states, tracks.states[valid, step]):
            return False
    return True


def recorded_egos(scenario: Scenario) -> Iterator[int]:
    """Rows of the vehicles that drive the longest way."""
    tracks = scenario.tracks
    states = np.where(tracks.valid[..., None], tracks.states, np.nan)
    ways = np.nansum(np.hypot(*np.diff(states[..., :2], axis=1).transpose(2, 0, 1)), axis=1)
    whole = tracks.valid.sum(axis=1) > 31
    last = tracks.steps - 1 - tracks.valid[:, ::-1].argmax(axis=1)
    whole &= last - tracks.valid.argmax(axis=1) == tracks.valid.sum(axis=1) - 1
    fit = [kind in VEHICLES for kind in tracks.kinds] & whole & (ways > 10.0)
    yield from [int(row) for row in np.argsort(-ways, kind="stable") if fit[row]][:EGOS]


def recorded(scenario: Scenario, row: int, figures: Figures) -> None:
    """A recorded vehicle is the ego."""
    tracks = scenario.tracks
    seen = np.flatnonzero(tracks.valid[row])
    first, last = int(seen[0]), int(seen[-1])
    vehicle = replace(
        scenario.task.vehicle,
        length=float(tracks.size[row, 0]),
        width=float(tracks.size[row, 1]),
        rear_to_centre=0.0,
    )
    ego = np.zeros((last - first + 1, EGO_SIZE))
    ego[:, :2] = tracks.states[row, first : last + 1, :2]
    ego[:, 3] = tracks.states[row, first : last + 1, USER_VELOCITY]
    ego[:, 4] = tracks.states[row, first : last + 1, USER_HEADING]
    others = np.delete(np.arange(len(tracks.ids)), row)
    rest = Tracks(
        ids=tracks.ids[others],
        kinds=tuple(tracks.kinds[i] for i in others),
        size=tracks.size[others],
        states=tracks.states[others],
        valid=tracks.valid[others],
        outlines=tuple(tracks.outlines[i] for i in others),
    )
    task = replace(scenario.task, vehicle=vehicle, start_step=first, start=ego[0])
    traffic = TimedTraffic()
    traffic.begin(replace(scenario, tracks=rest, task=task), first)
    figures.egos += 1
    where = {int(name): i for i, name in enumerate(rest.ids)}
    for step in range(first + 1, last + 1):
        users = traffic.step(step, ego[: step - first + 1])
        off = figures.off.get(step - first)
        if off is None:
            continue
        there = {int(name): state for name, state in zip(users.ids, users.states, strict=True)}
        for name, i in where.items():
            moving = rest.kinds[i] in VEHICLES
            if moving and rest.valid[i, step]:
                if name in there:
                    off.append(float(np.hypot(*(there[name] - rest.states[i, step])[:2])))
                else:  # It waits for its place.
                    off.append(float(np.hypot(*(rest.states[i, step] - _start(rest, i))[:2])))
                if off[-1] > 1.0:
                    who = f"{scenario.id} ego {tracks.ids[row]}: {name}"
                    figures.named.append(f"{who} {off[-1]:.1f} m off after {step - first} steps")
    figures.seconds += traffic.seconds


def _start(tracks: Tracks, row: int) -> FloatArray:
    return tracks.states[row, int(np.argmax(tracks.valid[row]))]


def drive(scenario: Scenario, name: str, planner: Planner, future: int, figures: Figures) -> None:
    """A planner drives the ego."""
    traffic = TimedTraffic(future)
    episode = run_episode(scenario, planner, NonePredictor(), Arm.WITHOUT_DOS, traffic=traffic)
    if episode.error is not None:
        figures.named.append(f"{scenario.id} {name}: {episode.error}")
    row = score(scenario, episode)
    figures.drives[name] = figures.drives.get(name, 0) + 1
    figures.seconds += traffic.seconds
    pairs = overlapping(episode.tracks) - overlapping(scenario.tracks)
    figures.overlaps[name] = figures.overlaps.get(name, 0) + len(pairs)
    figures.named += [f"{scenario.id} {name}: {pair} overlap" for pair in sorted(pairs)]
    behind = row.collision_class in (CollisionClass.ACTIVE_REAR, CollisionClass.STOPPED_EGO)
    hit = behind and not row.at_fault
    if hit:
        who = int(np.flatnonzero(episode.tracks.ids == row.collision_with)[0])
        hit = episode.tracks.kinds[who] in VEHICLES
    if hit:
        could = avoidable(scenario, episode, who)
        counts = figures.rear_ends.setdefault(name, {"all": 0, "avoidable": 0})
        counts["all"] += 1
        counts["avoidable"] += could
        figures.named.append(
            f"{scenario.id} {name}: {row.collision_with} hits the ego ({row.collision_class}) at "
            f"{row.collision_step}, {'avoidable' if could else 'not avoidable'}"
        )


def avoidable(scenario: Scenario, episode: Episode, who: int) -> bool:
    """Whether a driver who reacts after 0.5 s and brakes at 8 m/s2 would have stayed behind.

    From the first step at which both are there, on a straight line.
    """
    chosen = ReactiveSettings()
    tracks, vehicle, start = episode.tracks, scenario.task.vehicle, episode.start_step
    first = max(start, int(np.argmax(tracks.valid[who])))
    x, y, heading, speed = tracks.states[who, first]
    states = episode.states[first - start :]
    direction = np.array([np.cos(heading), np.sin(heading)])
    ahead = (vehicle.centre(states) - [x, y]) @ direction
    gap = ahead - 0.5 * (tracks.size[who, 0] + vehicle.length)
    time = scenario.dt * np.arange(len(states))
    braked = np.clip(time - chosen.reaction_time, 0.0, speed / chosen.full_braking)
    way = speed * np.minimum(time, chosen.reaction_time)
    way += speed * braked - 0.5 * chosen.full_braking * braked**2
    return bool((gap > way).all())


def overlapping(tracks: Tracks) -> set[tuple[int, int]]:
    """Pairs of road users that overlap at a step."""
    found: set[tuple[int, int]] = set()
    moves = np.array([kind is not RoadUserKind.STATIC for kind in tracks.kinds], dtype=bool)
    for step in range(tracks.steps):
        rows = np.flatnonzero(tracks.valid[:, step] & moves)
        pose, size = tracks.states[rows, step, :3], tracks.size[rows] - 2.0 * SHRINK
        reach = 0.5 * np.hypot(*size.T)
        one, other = np.triu_indices(len(rows), 1)
        near = np.hypot(*(pose[one, :2] - pose[other, :2]).T) < reach[one] + reach[other]
        one, other = one[near], other[near]
        if len(one):
            shapes = shapely.polygons(rectangle_corners(pose, np.maximum(size, 0.1)))
            for i in np.flatnonzero(shapely.intersects(shapes[one], shapes[other])):
                a, b = int(tracks.ids[rows[one[i]]]), int(tracks.ids[rows[other[i]]])
                found.add((min(a, b), max(a, b)))
    return found


def main() -> None:
    """Measures and prints, and writes a file where one is named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sources", nargs="+")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--future", type=int, default=0)
    parser.add_argument("--named", action="store_true", help="name what is not as it should be")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = {}
    for source in options.sources:
        figures = measure(source, options.limit, options.future)
        found[Path(source).name] = figures.summary()
        if options.named:
            print("\n".join(figures.named))
    text = json.dumps(found, indent=2)
    print(text)
    if options.json is not None:
        options.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
