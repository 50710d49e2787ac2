"""Traffic that reacts to the ego, for tests; also loaded by the runner as ``traffic.py:Class``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from zlib import crc32

import numpy as np
from dosplan_baseline.brake import BrakePlanner
from dosplan_simple.predictors import NonePredictor

from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.simulation.loop import run_episode
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    Arm,
    Episode,
    FloatArray,
    RoadUserKind,
    Scenario,
    Tracks,
)


@dataclass(frozen=True)
class Shyness:
    """From what distance of the ego someone stands, m."""

    near: float = 12.0


class ShyTraffic(Traffic):
    """Everyone drives along the recording by a clock of their own, and stands near the ego.

    From the third step on there is a cyclist, far away, whom the recording does not know.
    """

    name = "shy-v1"
    settings = Shyness

    def __init__(self, *, seed: int = 0, settings: Shyness = Shyness(), future: int = 0) -> None:
        super().__init__(seed=seed, settings=settings, future=future)
        self.near = settings.near

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        self.recorded, self.first_step = scenario.tracks, first_step
        self.clock = np.full(len(scenario.tracks.ids), first_step)
        self.vehicle = scenario.task.vehicle
        return Replay().begin(scenario, first_step)

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        tracks, centre = self.recorded, self.vehicle.centre(ego[-2])
        rows = np.arange(len(tracks.ids))
        before = tracks.states[rows, self.clock]
        waits = np.linalg.norm(before[:, :2] - centre, axis=1) < self.near
        self.clock = np.minimum(self.clock + ~waits, tracks.steps - 1)
        states = np.array(tracks.states[rows, self.clock])
        states[waits, USER_VELOCITY] = 0.0
        users = RoadUsers(tracks.ids, tracks.kinds, tracks.size, states, tracks.outlines)
        if step < self.first_step + 3:
            return users
        return replace(
            users,
            ids=np.append(users.ids, 900),
            kinds=(*users.kinds, RoadUserKind.BICYCLE),
            size=np.concatenate([users.size, [[1.8, 0.6]]]),
            states=np.concatenate([states, [[30.0 + step, 30.0, 0.0, 10.0]]]),
            outlines=(*users.outlines, None),
        )


class LostTraffic(ShyTraffic):
    """Does not know the way at the second step."""

    name = "lost-v1"

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        if len(ego) == 3:
            raise KeyError("way")
        return super().step(step, ego)


@dataclass(frozen=True)
class Wandering:
    """How much speeds differ, m/s: the standard deviation."""

    spread: float = 3.0


class WanderingTraffic(Traffic):
    """From the start on everyone drives straight on, at a speed that is drawn for the future.

    The mean is the recorded speed. Nobody looks at the ego.
    """

    name = "wandering-v1"
    settings = Wandering
    has_futures = True

    def __init__(
        self, *, seed: int = 0, settings: Wandering = Wandering(), future: int = 0
    ) -> None:
        super().__init__(seed=seed, settings=settings, future=future)
        self.spread = settings.spread

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        past = Replay().begin(scenario, first_step)
        random = np.random.default_rng([self.seed, self.future, crc32(scenario.id.encode())])
        self.first_step, self.dt, self.past = first_step, scenario.dt, past
        self.speed = random.normal(past.states[:, -1, USER_VELOCITY], self.spread)
        return past

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        past = self.past
        states = np.array(past.states[:, -1])
        way = self.speed * (step - self.first_step) * self.dt
        heading = states[:, USER_HEADING]
        states[:, USER_X] += way * np.cos(heading)
        states[:, USER_Y] += way * np.sin(heading)
        states[:, USER_VELOCITY] = self.speed
        return RoadUsers(past.ids, past.kinds, past.size, states, past.outlines)


class ForgetfulTraffic(WanderingTraffic):
    """Does not hand its future on."""

    name = "forgetful-v1"
    has_futures = True

    def __init__(
        self, *, seed: int = 0, settings: Wandering = Wandering(), future: int = 0
    ) -> None:
        super().__init__(seed=seed, settings=settings)


@cache
def followed() -> Scenario:
    """The ego at 10 m/s; who follows 19 m behind it at the same speed is recorded to drive on."""
    return straight_scenario(steady_tracks([[-18.0, 0.0, 0.0, 10.0]]))


def braking_before(traffic: Traffic) -> Episode:
    """The ego brakes to a stop in front of who follows it."""
    return run_episode(followed(), BrakePlanner(), NonePredictor(), Arm.WITH_DOS, traffic=traffic)
