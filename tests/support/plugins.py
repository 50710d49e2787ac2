"""Planners and predictors of the tests: some that work, and some that fail in every way.

Worker processes load them as ``plugins.py:Class``, also where the folder ``tests`` is on no path:
nothing is imported from it here.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from dosplan.api import DeadlineSettings, NoSettings, OraclePredictor, Planner, Predictor
from dosplan.scenario.synthetic import forking_sets, growing_sets
from dosplan.types import (
    EGO_SIZE,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    SolveReport,
    SolveStatus,
    Tracks,
)
from dosplan.vehicle import VehicleParameters

PLUGINS: Final = Path(__file__)
HORIZON = 10


def coast(observation: Observation, acceleration: float = 0.0) -> Plan:
    """Keeps the wheel still for ``HORIZON`` steps."""
    vehicle = VehicleParameters()
    u = np.array([0.0, acceleration])
    states: FloatArray = np.empty((HORIZON + 1, EGO_SIZE))
    states[0] = observation.ego
    for t in range(HORIZON):
        states[t + 1] = vehicle.step(
            states[t], vehicle.clip_input(states[t], u, observation.dt), observation.dt
        )
    return Plan(states=states, inputs=np.tile(u, (HORIZON, 1)))


class CoastPlanner(Planner):
    """Drives on as it started."""

    name = "coast-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return coast(observation)


class FarSightedPlanner(CoastPlanner):
    """Drives on as it started, and wants to know of 3 s."""

    name = "far-sighted-v1"
    look_ahead = 30


class TimelyPlanner(CoastPlanner):
    """Drives on as it started, by any deadline."""

    name = "timely-v1"
    settings = DeadlineSettings


class SlowPlanner(Planner):
    """The same, a little late each time."""

    name = "slow-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        time.sleep(0.03)
        return coast(observation)


class RandomPlanner(Planner):
    """Accelerates at random, from the global generator."""

    name = "random-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return coast(observation, float(np.random.uniform(-1.0, 1.0)))  # noqa: NPY002


@dataclass(frozen=True)
class Tuning:
    """The options of ``TunedPlanner``."""

    acceleration: float = 0.0

    def __post_init__(self) -> None:
        if abs(self.acceleration) > 9.0:
            raise ValueError(f"acceleration is {self.acceleration}, expected -9 to 9")


class TunedPlanner(Planner):
    """Accelerates as it is told to."""

    name = "tuned-v1"
    settings = Tuning

    def __init__(self, *, seed: int = 0, settings: Tuning = Tuning()) -> None:
        super().__init__(seed=seed, settings=settings)
        self.acceleration = settings.acceleration

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return coast(observation, self.acceleration)


class LeakyPlanner(Planner):
    """Is broken for good after its first failure, which scenario 1 brings about."""

    name = "leaky-v1"
    broken = False

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        self.broken = self.broken or "_Test-1_" in observation.task.scenario_id
        if self.broken:
            raise RuntimeError("broken for good")
        return coast(observation)


class TiringPlanner(Planner):
    """Says much of its plans, and raises at the sixth step of scenarios called ``Tiring``."""

    name = "tiring-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        step = observation.step
        if step == 5 and "_Tiring-" in observation.task.scenario_id:
            raise RuntimeError("enough")
        report = SolveReport(
            SolveStatus.MAX_ITERATIONS if step % 4 == 3 else SolveStatus.SOLVED,
            iterations=step,
            slack=step / 7.0,
            fallback="coast" if step % 4 == 3 else None,
            road_slack=step / 300.0,
        )
        return replace(coast(observation, 0.1 * step), report=report)


class FaultyPlanner(Planner):
    """Leaves where it is handed sets that have an extent."""

    name = "faulty-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        if np.any(occupancy.semi_axes > 0.0):
            sys.exit("enough")
        return coast(observation)


class RandomlyMadePlanner(Planner):
    """Accelerates as it was made to, at random, from the global generator."""

    name = "randomly-made-v1"

    def __init__(self, *, seed: int = 0, settings: NoSettings = NoSettings()) -> None:
        super().__init__(seed=seed, settings=settings)
        self.acceleration = float(np.random.uniform(-1.0, 1.0))  # noqa: NPY002

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return coast(observation, self.acceleration)


class HangingPlanner(CoastPlanner):
    """Prints, and hangs in scenario 1."""

    name = "hanging-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        if "_Test-1_" in observation.task.scenario_id:
            print("hanging", flush=True)
            time.sleep(3600.0)
        return coast(observation)


class UnbuildablePlanner(CoastPlanner):
    """Cannot be made."""

    name = "unbuildable-v1"

    def __init__(self, *, seed: int = 0, settings: NoSettings = NoSettings()) -> None:
        raise OSError("the weights are missing")


class StillPredictor(Predictor):
    """Everyone stays within a metre of where they are."""

    name = "still-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        n, t = len(observation.ids), self.horizon
        now = observation.states[:, -1]
        return Occupancy.from_trajectory(
            observation,
            np.repeat(now[:, None, :2], t, axis=1),
            np.repeat(now[:, None, 2], t, axis=1),
            semi_axes=np.ones((n, t, 2)),
        )


class GrowingPredictor(Predictor):
    """Everyone keeps their velocity, in ellipses that grow."""

    name = "growing-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        return growing_sets(observation, self.horizon)


class SeerPredictor(StillPredictor, OraclePredictor):
    """Is shown the future, and makes nothing of it."""

    name = "seer-v1"

    def reveal(self, tracks: Tracks) -> None:
        pass


# Faults; the number of the scenario says which.

EATEN: list[bytearray] = []
BEGUN = "FAULTS_BEGUN"
"""Names a folder in which each fault leaves a file of its name before it happens, if set."""


def _raise() -> None:
    raise ValueError("no way\nto go")


def _raise_no_exception() -> None:
    raise GeneratorExit  # Of BaseException alone.


def _interrupt() -> None:
    raise KeyboardInterrupt


def _eat() -> None:
    while True:
        EATEN.append(bytearray(b"x") * 20_000_000)  # Written, not only reserved.
        time.sleep(0.01)


def _eat_with_the_lock() -> None:
    EATEN.append(bytearray(b"x") * 8_000_000_000)  # One call, during which no Python runs.


def _hang_with_the_lock() -> None:
    re.match(r"(a+)+$", "a" * 64 + "b")  # Takes longer than anybody waits, in one call.


def _start_a_child() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"])
    with Path(os.environ["CHILD_PID_FILE"]).open("a") as file:
        file.write(f"{child.pid}\n")


def _leave_a_child() -> None:
    _start_a_child()
    os._exit(5)


def _hang_with_a_child() -> None:
    _start_a_child()
    time.sleep(3600.0)


FAULTS: dict[str, tuple[Callable[[], Any], str]] = {
    "fine": (lambda: None, ""),
    "raise": (_raise, "planner fault-v1: ValueError: no way to go (plugins.py:"),
    "interrupt": (_interrupt, "KeyboardInterrupt:"),
    "exit": (lambda: sys.exit("enough"), "planner fault-v1: SystemExit: enough (plugins.py:"),
    "exit-3": (lambda: os._exit(3), "the worker process ended with exit code 3"),
    "exit-0": (lambda: os._exit(0), "the worker process ended with exit code 0"),
    "segv": (
        lambda: os.kill(os.getpid(), signal.SIGSEGV),
        "the worker process was killed by SIGSEGV",
    ),
    "abort": (os.abort, "the worker process was killed by SIGABRT"),
    "kill": (
        lambda: os.kill(os.getpid(), signal.SIGKILL),
        "the worker process was killed by SIGKILL",
    ),
    "term": (
        lambda: os.kill(os.getpid(), signal.SIGTERM),
        "the worker process ended with exit code 15",
    ),
    "stop": (lambda: os.kill(os.getpid(), signal.SIGSTOP), "timed out after "),
    "hang": (lambda: time.sleep(3600.0), "timed out after "),
    "hang-with-child": (_hang_with_a_child, "timed out after "),
    "hang-locked": (_hang_with_the_lock, "timed out after "),
    "eat": (_eat, "took more than the memory limit of 700 MB"),
    "eat-locked": (_eat_with_the_lock, "took more than the memory limit of 700 MB"),
    "recurse": (lambda: _recurse(0), "planner fault-v1: RecursionError:"),
    "close-files": (lambda: os.closerange(3, 256), "the worker process ended with exit code"),
    "child": (_leave_a_child, "the worker process ended with exit code 5"),
    "no-exception": (_raise_no_exception, "planner fault-v1: GeneratorExit"),
}
NAMES = list(FAULTS)


def _recurse(depth: int) -> int:
    return _recurse(depth + 1) + 1


class FaultPlanner(Planner):
    """Does in its third step what the scenario's number stands for."""

    name = "fault-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        if observation.step == 2:
            number = re.search(r"-(\d+)_", observation.task.scenario_id)
            assert number is not None
            name = NAMES[int(number[1])]
            if begun := os.environ.get(BEGUN):
                Path(begun, name).touch()
            FAULTS[name][0]()
        return coast(observation)


class ForkPredictor(Predictor):
    """Who moves drives straight on, or turns left; who stands has one component."""

    name = "fork-v1"
    turning = 0.3

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        return forking_sets(observation, self.horizon, self.turning)


class StraightForkPredictor(ForkPredictor):
    """Straight on alone, as one of two components."""

    name = "straight-fork-v1"
    turning = 0.0


class SingleForkPredictor(StraightForkPredictor):
    """The same without a union."""

    name = "single-fork-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        return super().compute_occupancy(observation).likeliest()
