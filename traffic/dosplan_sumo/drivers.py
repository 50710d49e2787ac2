"""Other drivers for other futures: the same past, driven on by people of another kind.

Future 0 is driven by the drivers of SUMO's files. In every other one each road user is drawn anew
when the ego starts or when it comes onto the road, from

- desired speed over the limit: times a normal 1 +- 0.1, within 0.8 to 1.2 (0.1 is SUMO's own
  deviation of passenger cars);
- imperfection ``sigma`` of Krauss's model, how much a driver falls short of the speed that would
  be safe: uniform, 0.2 to 0.8 (SUMO's default is 0.5);
- time between two decisions: log-normal around 0.4 s with a deviation of 0.4 of its logarithm,
  0.1 to 1.2 s. It is a driver's reaction time; the time gap is no shorter, as SUMO's drivers run
  into each other otherwise;
- time gap: times a log-normal with a deviation of 0.2;
- impatience, how far a driver at a junction makes others brake: uniform, 0 to 0.6;
- walking speed: times a normal 1 +- 0.15, within 0.6 to 1.4.

These are assumptions, spread around SUMO's defaults, and fitted to no data.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any

import numpy as np

from dosplan.types import STEP_SECONDS


class Drivers:
    """Draws the road users of one future of a scenario."""

    def __init__(self, seed: int, scenario: str, future: int) -> None:
        """Keeps what the draws depend on.

        Args:
            seed: Seed of the run.
            scenario: Id of the scenario.
            future: The future; nobody is drawn in future 0.
        """
        self._key = f"{seed} {scenario} {future}"
        self._as_given = future == 0

    def draw_vehicle(self, sumo: Any, name: str) -> None:
        """Draws the driver of a vehicle.

        Args:
            sumo: The library.
            name: The vehicle.
        """
        if self._as_given:
            return
        rng, vehicle = self._rng(name), sumo.vehicle
        speed = float(np.clip(rng.normal(1.0, 0.1), 0.8, 1.2))
        sigma = float(rng.uniform(0.2, 0.8))
        reaction = float(np.clip(0.4 * rng.lognormal(0.0, 0.4), 0.1, 1.2))
        reaction = max(1, round(reaction / STEP_SECONDS)) * STEP_SECONDS
        gap, impatience = float(rng.lognormal(0.0, 0.2)), float(rng.uniform(0.0, 0.6))
        vehicle.setSpeedFactor(name, vehicle.getSpeedFactor(name) * speed)
        vehicle.setImperfection(name, sigma)
        vehicle.setActionStepLength(name, reaction)
        vehicle.setTau(name, max(vehicle.getTau(name) * gap, reaction))
        vehicle.setImpatience(name, impatience)

    def draw_walker(self, sumo: Any, name: str) -> None:
        """Draws a pedestrian.

        Args:
            sumo: The library.
            name: The person.
        """
        if self._as_given:
            return
        factor = float(np.clip(self._rng(name).normal(1.0, 0.15), 0.6, 1.4))
        sumo.person.setSpeedFactor(name, sumo.person.getSpeedFactor(name) * factor)

    def _rng(self, name: str) -> np.random.Generator:
        """A generator for each road user, whoever else is there."""
        return np.random.default_rng(list(sha256(f"{self._key} {name}".encode()).digest()))
