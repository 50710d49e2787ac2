"""Drives one scene in SUMO, once for each of its futures.

Network, demand, seed and all that is told before the branch are the same in each run, so SUMO
drives the same past. That it did is checked, to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import tostring

import numpy as np
from dosplan_sumo.script import Executor
from dosplan_sumo.simulator import Simulation

from dosplan.types import FloatArray
from suitegen.roads import Rng
from suitegen.traffic import LATERAL_RESOLUTION, STEP, Trace

from .demand import Demand, scene_demand
from .staging import Act, Spot, Staging

SETTLED = 3
"""Steps after the appearance of the cast from which on is recorded: people are in place then."""
LATEST = 60.0
"""Time after the appearance of the cast at which the moment must have come, s."""


class RejectedError(Exception):
    """A scene that is not used; the message is the reason, the same for all of its like."""


@dataclass(frozen=True)
class Simulated:
    """A scene as it was driven.

    Attributes:
        futures: What was driven in each future; step 0 is SUMO's time ``begin``.
        begin: s.
        start: Step at which the ego starts.
        last: Last step.
        goal: (3,) pose of the middle of the goal: x, y, m, and heading, rad.
        demand: The demand.
        seed: SUMO's seed.
    """

    futures: tuple[tuple[Trace, ...], ...]
    begin: float
    start: int
    last: int
    goal: FloatArray
    demand: Demand
    seed: int

    @property
    def start_time(self) -> float:
        """SUMO's time at which the ego starts, s."""
        return self.begin + self.start * STEP


def simulate(staging: Staging, acts: Sequence[Act], net: Path, folder: Path, rng: Rng) -> Simulated:
    """Drives a scene.

    Args:
        staging: The scene.
        acts: What happens in each future.
        net: Its compiled network.
        folder: For intermediate files.
        rng: Draws drivers and the background.

    Returns:
        What was driven.

    Raises:
        RejectedError: Its moment did not come, or not for all, or SUMO drove two pasts.
        SumoError: SUMO failed; its message is in the text.
    """
    until = staging.warmup + LATEST + staging.seconds
    demand = scene_demand(staging, rng, until)
    path = folder / "demand.rou.xml"
    path.write_bytes(tostring(demand.root))
    seed = int(rng.integers(1, 2**31 - 1))
    runs = []
    for act in acts:
        simulation = Simulation(
            net,
            [path],
            STEP,
            {
                "lateral-resolution": LATERAL_RESOLUTION,
                "ignore-route-errors": "true",
                "seed": str(seed),
            },
            folder,
        )
        try:
            with simulation.failures():
                runs.append(_run(simulation, staging, act, demand))
        finally:
            simulation.close()
    first = runs[0]
    branch = first.start + round(staging.branch / STEP)
    for run in runs:
        if run.start != first.start or not _same(run.traces, first.traces, branch):
            raise RejectedError("SUMO drove two pasts from the same demand and seed")
    begin = staging.warmup + SETTLED * STEP
    last = first.start + round(staging.seconds / STEP)
    traces = tuple(run.traces for run in runs)
    return Simulated(traces, begin, first.start, last, first.goal, demand, seed)


@dataclass(frozen=True)
class _Run:
    traces: tuple[Trace, ...]
    start: int
    goal: FloatArray


def _run(simulation: Simulation, staging: Staging, act: Act, demand: Demand) -> _Run:
    sumo, record = simulation.sumo, _Record(demand.users)
    executor = Executor(sumo)
    executor.play(demand.prelude, staging.warmup)
    begin = staging.warmup + SETTLED * STEP
    goal = _pose(sumo, staging.goal)
    start, step, last = None, -1, -1
    while start is None or step < last:
        executor.step(simulation.time, STEP)
        simulation.step()
        step = round((simulation.time - begin) / STEP)
        if step < 0:
            continue
        if step == 0 and not {actor.id for actor in staging.cast} <= set(sumo.vehicle.getIDList()):
            raise RejectedError("no room for one of the cast")
        record.add(sumo, step)
        if start is None and staging.moment(sumo):
            start, last = step, step + round(staging.seconds / STEP)
            executor.play(act.script, simulation.time + staging.branch)
        if start is None and step * STEP > LATEST:
            raise RejectedError("the moment never came")
    return _Run(record.traces(), start, goal)


class _Record:
    """Where everybody is, step by step."""

    def __init__(self, users: Mapping[str, tuple[str, float, float]]) -> None:
        self._users = users
        self._first: dict[str, int] = {}
        self._rows: dict[str, list[tuple[float, float, float]]] = {}

    def add(self, sumo: Any, step: int) -> None:
        """Adds who is on the road after a step."""
        for group in (sumo.vehicle, sumo.person):
            for name in group.getIDList():
                self._first.setdefault(name, step)
                x, y = group.getPosition(name)
                self._rows.setdefault(name, []).append((x, y, group.getAngle(name)))

    def traces(self) -> tuple[Trace, ...]:
        """The traces of all."""
        found = []
        for name, rows in self._rows.items():
            kind, length, width = self._users[name]
            values = np.array(rows)
            # SUMO counts angles in degrees, clockwise from north.
            heading = np.unwrap(np.deg2rad(90.0 - values[:, 2]))
            size = (length, width)
            found.append(Trace(name, kind, size, self._first[name], values[:, :2], heading))
        return tuple(found)


def _pose(sumo: Any, spot: Spot) -> FloatArray:
    """(3,) pose of a place on a lane: x, y, m, and heading, rad."""
    line = np.array(sumo.lane.getShape(f"{spot.edge}_{spot.lane}"))
    steps = np.diff(line, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    piece = int(np.clip(np.searchsorted(along, spot.position, "right") - 1, 0, len(steps) - 1))
    share = (spot.position - along[piece]) / (along[piece + 1] - along[piece])
    x, y = line[piece] + share * steps[piece]
    return np.array([x, y, np.arctan2(steps[piece, 1], steps[piece, 0])])


def _same(traces: Sequence[Trace], others: Sequence[Trace], last: int) -> bool:
    """Whether two runs are the same up to a step, to the last bit."""
    one, other = ({t.id: t for t in run if t.first <= last} for run in (traces, others))
    return one.keys() == other.keys() and all(
        a.first == b.first
        and np.array_equal(a.front[: last - a.first + 1], b.front[: last - b.first + 1])
        and np.array_equal(a.heading[: last - a.first + 1], b.heading[: last - b.first + 1])
        for a, b in ((one[name], other[name]) for name in one)
    )
