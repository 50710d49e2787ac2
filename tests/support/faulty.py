"""Planners and a predictor for the runner's tests: one that works, several that do not.

Loaded by the runner as ``faulty.py:Class``, by its worker processes too.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace

import numpy as np

from dosplan.api import NoSettings, OraclePredictor, Planner, Predictor
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


class SlowPlanner(Planner):
    """The same, a little late each time."""

    name = "slow-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        time.sleep(0.06)
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


class SeerPredictor(StillPredictor, OraclePredictor):
    """Is shown the future, and makes nothing of it."""

    name = "seer-v1"

    def reveal(self, tracks: Tracks) -> None:
        pass
