"""Planners that bring about real faults; which one, the scenario's id says.

Loaded by the runner as ``planners.py:Class``, by its worker processes too.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dosplan.api import Planner
from dosplan.types import EGO_SIZE, Observation, Occupancy, Plan
from dosplan.vehicle import VehicleParameters

HORIZON = 5
EATEN: list[bytearray] = []
BEGUN = "FAULTS_BEGUN"
"""Names a folder in which each fault leaves a file of its name before it happens, if set."""


def _raise() -> None:
    raise ValueError("no way\nto go")


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
    "raise": (_raise, "planner fault-v1: ValueError: no way to go (planners.py:"),
    "interrupt": (_interrupt, "KeyboardInterrupt:"),
    "exit": (lambda: sys.exit("enough"), "planner fault-v1: SystemExit: enough (planners.py:"),
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
}
NAMES = list(FAULTS)


def _recurse(depth: int) -> int:
    return _recurse(depth + 1) + 1


def coast(observation: Observation) -> Plan:
    """Keeps wheel and speed for ``HORIZON`` steps."""
    import numpy as np

    vehicle = VehicleParameters()
    zero = np.zeros(2)
    states = np.empty((HORIZON + 1, EGO_SIZE))
    states[0] = observation.ego
    for t in range(HORIZON):
        states[t + 1] = vehicle.step(states[t], zero, observation.dt)
    return Plan(states=states, inputs=np.zeros((HORIZON, 2)))


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


class CoastPlanner(Planner):
    """Drives on as it started."""

    name = "coast-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return coast(observation)


class SlowPlanner(Planner):
    """The same, a little late each time."""

    name = "coast-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        time.sleep(0.03)
        return coast(observation)
