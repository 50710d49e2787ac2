"""The ego's actuators, which follow what is asked of them as first-order lags."""

from __future__ import annotations

import numpy as np

from dosplan.simulation.settings import ActuatorSettings
from dosplan.types import FloatArray
from dosplan.vehicle import VehicleParameters


class Actuators:
    """Turns inputs that are asked for into those that are applied.

    Attributes:
        lag: Whether any of them lags.
        at_rest: (2,) their output when an episode begins: the wheels are not turning and the ego
            keeps its velocity.
        left: (2,) share of a difference between output and what is asked for that is left after
            a step.
        mean: (2,) share of it that is left in the mean over the step.
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
        self.lag = bool(lags.any())
        steps = dt / np.where(lags > 0.0, lags, 1.0)
        self.left = np.where(lags > 0.0, np.exp(-steps), 0.0)
        self.mean = np.where(lags > 0.0, -np.expm1(-steps) / steps, 0.0)

    def follow(
        self, ego: FloatArray, wanted: FloatArray, output: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Follows an input for a step.

        The input that is applied is the mean of the lag's answer over the step, so that velocity
        and steering angle at the step's end are those of the exact answer. The steering's lag is
        that of Autoware's ``simple_planning_simulator``: the wheels go to an angle that is asked
        for at a rate in proportion to what is missing, which is cut to the largest one. So more
        than that rate may be asked for, to have it sooner.

        Args:
            ego: (5,) ego state.
            wanted: (2,) steering rate, rad/s, and acceleration, m/s2.
            output: (2,) output of the lags at the step's begin.

        Returns:
            (2,) input that is applied, within the vehicle's limits, and (2,) output at the
            step's end.
        """
        asked = self._vehicle.clip_input(ego, wanted, self._dt)
        if not self.lag:
            return asked, output
        if self.left[0] > 0.0:  # What limits a lagging rate is the rate that comes of it.
            asked[0] = wanted[0]
        behind = output - asked
        applied = self._vehicle.clip_input(ego, asked + self.mean * behind, self._dt)
        output = asked + self.left * behind
        fastest = self._vehicle.max_steering_rate
        output[0] = min(max(output[0], -fastest), fastest)
        return applied, output
