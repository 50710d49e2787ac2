"""Checks that a traffic keeps the contract of ``dosplan.simulation.traffic``.

It is driven on scenes built in code, or on a scenario of one's own where it needs one that brings
more, such as the files of a simulator.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from dosplan.api import PluginSpec
from dosplan.plugins.conformance import (
    SEED,
    BrokenError,
    Contract,
    Report,
    Rule,
    check_version,
)
from dosplan.scenario.synthetic import busy_scenario, crowded_scenario, straight_scenario
from dosplan.simulation.traffic import RoadUsers, Traffic
from dosplan.simulation.world import World
from dosplan.types import FloatArray, LightStates, Scenario, Tracks

STEPS = 30
"""Steps of a drive."""

SLOW_SECONDS = 0.1
"""Median time of a step beyond which a traffic is too slow: the length of a step."""

FASTEST = 100.0
"""Speed at which nobody drives, m/s; who moves faster is somebody else."""


@dataclass(frozen=True)
class TrafficTrace:
    """What a traffic did over a drive.

    Attributes:
        past: What ``begin`` returned.
        users: What each ``step`` returned.
        seconds: How long each step took, s.
        touched: What of its input it changed.
    """

    past: Tracks
    users: tuple[RoadUsers, ...]
    seconds: tuple[float, ...]
    touched: tuple[str, ...]


class _Watched(Traffic):
    """Passes everything on to a traffic, and notes what it does."""

    name = "watched-v1"

    def __init__(self, traffic: Traffic) -> None:
        super().__init__(seed=traffic.seed, future=traffic.future)
        self._traffic = traffic
        vars(self)["refuses"] = traffic.refuses  # Of its class, which this one stands for.
        self.past: Tracks | None = None
        self.users: list[RoadUsers] = []
        self.seconds: list[float] = []
        self.touched: set[str] = set()

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        self.past = self._traffic.begin(scenario, first_step)
        return self.past

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        before = np.array(ego)
        started = time.perf_counter()
        users = self._traffic.step(step, ego)
        self.seconds.append(time.perf_counter() - started)
        if not np.array_equal(before, ego):
            self.touched.add("the ego's states")
        self.users.append(users)
        return users

    def lights(self, step: int) -> LightStates | None:
        return self._traffic.lights(step)


def drive_traffic(traffic: Traffic, scenario: Scenario, braking: float = 0.0) -> TrafficTrace:
    """Drives a traffic while the ego rolls straight on; it is closed at the end.

    Args:
        traffic: The traffic.
        scenario: The scene.
        braking: The ego's deceleration, m/s2.

    Returns:
        What it did.
    """
    watched, before = _Watched(traffic), copy.deepcopy(scenario.tracks)
    try:
        world = World(scenario, watched)
        for _ in range(STEPS):
            world.step(np.array([0.0, -braking]))
    finally:
        traffic.close()
    assert watched.past is not None
    if _changed(before, scenario.tracks):
        watched.touched.add("the scenario's tracks")
    return TrafficTrace(
        watched.past, tuple(watched.users), tuple(watched.seconds), tuple(sorted(watched.touched))
    )


def check_traffic(
    plugin: type[Traffic] | PluginSpec[Any], scenario: Scenario | None = None
) -> Report:
    """Checks a traffic.

    Args:
        plugin: Its class, or that with settings.
        scenario: What to drive; scenes built in code by default.

    Returns:
        The report; nothing is raised for a broken traffic.
    """
    contract = traffic_contract(plugin, scenario)
    return contract.report(contract.check)


def traffic_contract(
    plugin: type[Traffic] | PluginSpec[Any], scenario: Scenario | None = None
) -> Contract:
    """Lists what a traffic is checked for.

    Args:
        plugin: As for ``check_traffic``.
        scenario: Likewise.

    Returns:
        The checks.
    """
    chosen = plugin if isinstance(plugin, PluginSpec) else None
    made_by = plugin.plugin if isinstance(plugin, PluginSpec) else plugin
    scene = busy_scenario() if scenario is None else scenario

    def build(future: int = 0) -> Traffic:
        if not issubclass(made_by, Traffic):
            raise BrokenError("is no dosplan.simulation.traffic.Traffic; inherit from it")
        settings = made_by.settings() if chosen is None else chosen.settings
        return made_by(seed=SEED, settings=settings, future=future)

    def drive(future: int = 0, braking: float = 0.0) -> TrafficTrace:
        traffic = build(future)
        if scenario is None and (why := traffic.refuses(scene)) is not None:
            raise BrokenError(
                "refuses a scene built in code; name one that it drives with --scenario FILE "
                f"(it says that the scene {why})"
            )
        return drive_traffic(traffic, scene, braking)

    # What replays has the futures that are recorded.
    several = made_by.has_futures and (not made_by.as_recorded or len(scene.futures) > 0)
    futures = (0, 1) if several else (0,)
    drives = "begin gives the past, step the road users of the next step, as RoadUsers"
    rules = [
        Rule("versioned_name", lambda: _versioned(build())),
        Rule("deterministic", lambda: _deterministic(drive, futures)),
        Rule("begin_forgets", lambda: _forgets(build(), scene, drive)),
        Rule("one_past", lambda: _one_past(drive, futures)),
        Rule("input_untouched", lambda: _keeps_input(drive())),
        Rule("ids_kept", lambda: _keeps_ids(drive(), scene.dt)),
        Rule("as_recorded", lambda: _as_recorded(drive, futures, scene, made_by)),
        Rule("time", lambda: _in_time(drive())),
    ]
    if scenario is None:
        rules += [
            Rule(
                "no_road_users",
                lambda: drive_traffic(build(), straight_scenario()),
                "where nobody is on the scene, RoadUsers has no rows",
            ),
            Rule(
                "many_road_users",
                lambda: drive_traffic(build(), crowded_scenario()),
                "take any number of road users; here they are fifty",
            ),
        ]
    return Contract(
        str(getattr(made_by, "name", made_by.__name__)),
        made_by,
        (Rule("constructs", build), Rule("drives", drive, drives)),
        tuple(rules),
    )


_Drive = Callable[..., TrafficTrace]


def _versioned(traffic: Traffic) -> None:
    if not traffic.as_recorded:  # A replay can drive in one way only.
        check_version(traffic)


def _deterministic(drive: _Drive, futures: Sequence[int]) -> None:
    for future in futures:
        if not _same(drive(future), drive(future)):
            raise BrokenError(
                f"two instances with the same seed differ in future {future}; draw every random "
                "number from a generator made from seed, future and the scenario"
            )


def _forgets(used: Traffic, scene: Scenario, drive: _Drive) -> None:
    drive_traffic(used, scene, braking=8.0)
    if not _same(drive(), drive_traffic(used, scene)):
        raise BrokenError(
            "after another episode, a scene goes another way; begin() must clear what an episode "
            "left behind, and work again after close()"
        )


def _one_past(drive: _Drive, futures: Sequence[int]) -> None:
    if _changed(drive(futures[0]).past, drive(futures[-1]).past):
        raise BrokenError("begin() gives futures another past; they may differ from then on only")


def _keeps_input(trace: TrafficTrace) -> None:
    if trace.touched:
        raise BrokenError(
            f"changed {' and '.join(trace.touched)}; work on copies of what it is handed"
        )


def _keeps_ids(trace: TrafficTrace, dt: float) -> None:
    last = trace.past.steps - 1
    here = np.flatnonzero(trace.past.valid[:, last])
    places = {int(trace.past.ids[i]): trace.past.states[i, last, :2] for i in here}
    for users in trace.users:
        found = dict(zip(users.ids.tolist(), users.states[:, :2], strict=True))
        for name in found.keys() & places.keys():
            way = float(np.hypot(*(found[name] - places[name])))
            if way > FASTEST * dt:
                raise BrokenError(
                    f"road user {name} moves {way:.0f} m in a step; an id belongs to one road user"
                )
        places = found


def _as_recorded(
    drive: _Drive, futures: Sequence[int], scene: Scenario, made_by: type[Traffic]
) -> None:
    if not made_by.as_recorded:
        return
    for future in futures:
        _check_recorded(drive(future, braking=5.0), scene.recorded(future), scene.task.start_step)


def _check_recorded(trace: TrafficTrace, tracks: Tracks, start: int) -> None:
    for step, users in enumerate(trace.users, start + 1):
        valid = tracks.valid[:, step] if step < tracks.steps else np.zeros(len(tracks.ids), bool)
        rows = np.flatnonzero(valid)
        same = np.array_equal(users.ids, tracks.ids[rows])
        if not same or not np.array_equal(users.states, tracks.states[rows, step]):
            raise BrokenError(
                "says as_recorded, but departs from the recording; leave as_recorded out"
            )


def _in_time(trace: TrafficTrace) -> None:
    median = float(np.median(trace.seconds))
    if median > SLOW_SECONDS:
        raise BrokenError(
            f"a step takes {median:.2f} s (median of {len(trace.seconds)}), more than "
            f"{SLOW_SECONDS:g} s; move what does not change to begin()"
        )


def _same(one: TrafficTrace, other: TrafficTrace) -> bool:
    pairs = zip(one.users, other.users, strict=True)
    return not _changed(one.past, other.past) and not any(_changed(a, b) for a, b in pairs)


def _changed(one: Tracks | RoadUsers, other: Tracks | RoadUsers) -> bool:
    """Whether two values differ in an array."""
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray) and not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            return True
    return False
