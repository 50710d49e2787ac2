"""The ego's actuators, which follow what is asked of them as first-order lags."""

from __future__ import annotations

import numpy as np

from dosplan.simulation.settings import ActuatorSettings
from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters


class Actuators:
    """Turns inputs that are asked for into those that are applied.

    Attributes:
        at_rest: (2,) their output when an episode begins: the wheels are not turning and the ego
            keeps its velocity.
    """

    at_rest: FloatArray = np.zeros(2)

    def __init__(self, settings: ActuatorSettings, vehicle: VehicleParameters, dt: float) -> None:
        """Computes what is left of a difference after a step.

        Args:
            settings: Time constants.
            vehicle: The ego, whose limits hold.
            dt: Step, s.
        """
        self._vehicle, self._dt = vehicle, dt
        lags = np.array([settings.steering, settings.acceleration])
        self._lags = lags if lags.any() else None
        steps = dt / np.where(lags > 0.0, lags, 1.0)
        self._left = np.where(lags > 0.0, np.exp(-steps), 0.0)
        # Of the difference at a step's begin, its mean over the step.
        self._mean = np.where(lags > 0.0, -np.expm1(-steps) / steps, 0.0)

    def follow(
        self, ego: FloatArray, wanted: FloatArray, output: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Follows an input for a step.

        The input that is applied is the mean of the lag's answer over the step, so that velocity
        and steering angle at the step's end are those of the exact answer.

        Args:
            ego: (5,) ego state.
            wanted: (2,) steering rate, rad/s, and acceleration, m/s2.
            output: (2,) output of the lags at the step's begin.

        Returns:
            (2,) input that is applied, within the vehicle's limits, and (2,) output at the
            step's end.
        """
        asked = self._vehicle.clip_input(ego, wanted, self._dt)
        if self._lags is None:
            return asked, output
        behind = output - asked
        applied = self._vehicle.clip_input(ego, asked + self._mean * behind, self._dt)
        return applied, asked + self._left * behind
