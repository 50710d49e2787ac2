"""Plug-ins that are wrong on purpose, each in its own way; ``test_check_command`` lists them."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import numpy as np
from dosplan_simple.predictors import ConstantVelocityPredictor

from dosplan.api import Planner
from dosplan.types import FloatArray, Observation, Occupancy, Plan
from dosplan.vehicle import VehicleParameters

STEPS = 10


def plan_of(observation: Observation, acceleration: float = 0.0) -> Plan:
    inputs = np.tile([0.0, acceleration], (STEPS, 1))
    states = [observation.ego]
    for u in inputs:
        states.append(VehicleParameters().step(states[-1], u, observation.dt))
    return Plan(states=np.stack(states), inputs=inputs)


class Writer(Planner):
    """Moves a road user in what it is handed."""

    name = "writer-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        observation.states[:, -1, 0] += 1.0
        return plan_of(observation)


class Dice(Planner):
    """Draws from a generator that is not seeded."""

    name = "dice-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, float(np.random.default_rng().normal(0.0, 0.1)))


class OneStateShort(Planner):
    """Leaves out the present state."""

    name = "one-state-short-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        plan = plan_of(observation)
        return Plan(states=plan.states[1:], inputs=plan.inputs)


class PlansNan(Planner):
    """Divides zero by zero."""

    name = "plans-nan-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, float("nan"))


class Hangs(Planner):
    """Waits for what never comes."""

    name = "hangs-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        while True:
            time.sleep(1.0)


class Dies(Planner):
    """Takes its process with it."""

    name = "dies-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        os.abort()


class StartsElsewhere(Planner):
    """Plans from a metre ahead of where the ego is."""

    name = "starts-elsewhere-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        plan = plan_of(observation)
        return Plan(states=plan.states + np.eye(5)[0], inputs=plan.inputs)


class Teleporter(Planner):
    """Stands still in its states and rolls on in its inputs."""

    name = "teleporter-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return Plan(states=np.tile(observation.ego, (STEPS + 1, 1)), inputs=np.zeros((STEPS, 2)))


class NeedsCompany(Planner):
    """Looks for the nearest road user where there may be none."""

    name = "needs-company-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        nearest = np.min(observation.states[:, -1, 0])
        return plan_of(observation, -0.1 if nearest < observation.ego[0] else 0.0)


class Peeks(Planner):
    """Takes the recording from who called it."""

    name = "peeks-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        frame: Any = sys._getframe()
        while "scenario" not in frame.f_locals:
            frame = frame.f_back
        return plan_of(observation, -0.1 if frame.f_locals["scenario"].tracks.valid.all() else 0.0)


class StuckOnCompany(Planner):
    """Brakes for sets that are marked as not there, if they have an extent."""

    name = "stuck-on-company-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, -0.1 if np.any(occupancy.semi_axes > 0.0) else 0.0)


class Reorders(ConstantVelocityPredictor):
    """Returns the road users the other way round."""

    name = "reorders-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        plain = super().compute_occupancy(observation)
        arrays = [field for field in plain.__dataclass_fields__ if field != "union"]
        backwards: dict[str, FloatArray] = {field: getattr(plain, field)[::-1] for field in arrays}
        return Occupancy(**backwards)  # type: ignore[arg-type]


class ShortSighted(ConstantVelocityPredictor):
    """Predicts half of the steps it was asked for."""

    name = "short-sighted-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        plain = super().compute_occupancy(observation)
        half = self.horizon // 2
        return Occupancy(
            ids=plain.ids,
            centre=plain.centre[:, :half],
            semi_axes=plain.semi_axes[:, :half],
            angle=plain.angle[:, :half],
            valid=plain.valid[:, :half],
            footprint=plain.footprint,
            heading=plain.heading[:, :half],
        )
