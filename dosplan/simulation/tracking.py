"""The controller between a plan and actuators that lag: it follows the plan's states.

A plan is made as if its inputs acted at once. Where they do not, somebody has to ask earlier and
for more, so that the ego is where the plan has it. In every stack this is a controller's task and
not the planner's, so the loop has one, the same for all planners.

It is the linear-quadratic regulator with preview of a reference that is known ahead (Anderson,
Moore, "Optimal Control: Linear Quadratic Methods", 1990, sec. 4.3), along the plan: the kinematic
single track is linearised about each of its states, in the frame of the planned pose (Kanayama et
al., "A Stable Tracking Control Method for an Autonomous Mobile Robot", ICRA 1990, for the errors
of the pose), and the lags of both actuators are two more states. nuPlan's ``LQRTracker`` is of the
same family, with one matrix for a whole second and no lag of the acceleration. The weights are
inverse squares of errors that are as bad as each other (Bryson's rule: Bryson, Ho, "Applied Optimal
Control", 1975, sec. 5.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.geometry import wrap_angle
from dosplan.simulation.actuators import Actuators
from dosplan.types import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_STEERING,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    FloatArray,
    Plan,
)
from dosplan.vehicle import VehicleParameters

# Errors that are as bad as each other. Of the state in the frame of the planned pose:
_ALONG: Final = 0.2  # m
_BESIDE: Final = 0.2  # m
_STEERING: Final = 0.05  # rad
_VELOCITY: Final = 0.2  # m/s
_HEADING: Final = 0.05  # rad
# Of what the actuators are asked for, from what is planned:
_STEERING_RATE: Final = 0.5  # rad/s
_ACCELERATION: Final = 1.0  # m/s2


@dataclass(frozen=True)
class Command:
    """What the actuators are asked for in a step.

    Attributes:
        input: (2,) steering rate, rad/s, and acceleration, m/s2, where the ego is as planned.
        state: (5,) planned state.
        output: (2,) planned input, of which the lags' outputs may be off.
        gain: (2, 7) what is taken from ``input`` for errors of the state, in the frame of the
            planned pose, and of the lags' outputs; None where nothing lags.
    """

    input: FloatArray
    state: FloatArray
    output: FloatArray
    gain: FloatArray | None = None

    def wanted(self, ego: FloatArray, output: FloatArray) -> FloatArray:
        """What is asked for, not yet cut to the vehicle's limits.

        Args:
            ego: (5,) ego state at the step's begin.
            output: (2,) output of the lags then.

        Returns:
            (2,) steering rate, rad/s, and acceleration, m/s2.
        """
        if self.gain is None:
            return self.input
        error = np.concatenate([_in_frame(ego, self.state), output - self.output])
        return np.asarray(self.input - self.gain @ error)


class Tracker:
    """Turns plans into commands for the actuators."""

    def __init__(self, actuators: Actuators, vehicle: VehicleParameters, dt: float) -> None:
        """Takes the lags over.

        Args:
            actuators: The actuators.
            vehicle: The ego.
            dt: Step, s.
        """
        self._actuators, self._vehicle, self._dt = actuators, vehicle, dt
        errors = np.array([_ALONG, _BESIDE, _STEERING, _VELOCITY, _HEADING])
        self._bad_state = np.diag(np.concatenate([errors**-2.0, np.zeros(2)]))
        self._bad_input = np.diag(np.array([_STEERING_RATE, _ACCELERATION]) ** -2.0)

    def commands(self, plan: Plan) -> list[Command]:
        """The commands that drive a plan.

        Args:
            plan: A plan of T steps.

        Returns:
            T commands: the plan's own inputs where nothing lags. Where something does, command k
            minimises, over the rest of the plan, the errors of its states and what is asked for
            beyond its inputs.
        """
        if not self._actuators.lag:
            return [
                Command(planned, state, planned)
                for planned, state in zip(plan.inputs, plan.states[:-1], strict=True)
            ]
        inputs = self._vehicle.clip_input(plan.states[:-1], plan.inputs, self._dt)
        a, b = self._linear(plan.states[:-1], inputs)
        # Where the plan itself does not keep to the model, and where its inputs change.
        drift = np.zeros((len(inputs), EGO_SIZE + 2))
        reached = self._vehicle.step(plan.states[:-1], inputs, self._dt)
        drift[:, :EGO_SIZE] = _in_frame(reached, plan.states[1:])
        drift[:-1, EGO_SIZE:] = inputs[:-1] - inputs[1:]

        commands: list[Command] = []
        value, slope = self._bad_state, np.zeros(EGO_SIZE + 2)  # Cost to go: quadratic and linear.
        for k in reversed(range(len(inputs))):
            to_value = b[k].T @ value
            after = slope + value @ drift[k]
            solved = np.linalg.solve(
                self._bad_input + to_value @ b[k],
                np.column_stack([to_value @ a[k], b[k].T @ after]),
            )
            gain, ahead = solved[:, :-1], solved[:, -1]
            closed = a[k] - b[k] @ gain
            value = self._bad_state + a[k].T @ value @ closed
            value = 0.5 * (value + value.T)
            slope = closed.T @ after
            commands.append(Command(inputs[k] - ahead, plan.states[k], inputs[k], gain))
        return commands[::-1]

    def _linear(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The model of the errors, from one planned state to the next.

        Args:
            states: (T, 5) planned states.
            inputs: (T, 2) planned inputs.

        Returns:
            (T, 7, 7) of the errors of state and outputs, and (T, 7, 2) of the error of what is
            asked for. The step is a Taylor series of second order, about its middle.
        """
        dt, wheelbase = self._dt, self._vehicle.wheelbase
        velocity = states[:, EGO_VELOCITY] + 0.5 * dt * inputs[:, 1]
        steering = states[:, EGO_STEERING] + 0.5 * dt * inputs[:, 0]
        turning = velocity * np.tan(steering) / wheelbase
        rate = np.zeros((len(states), EGO_SIZE, EGO_SIZE))
        rate[:, EGO_X, EGO_Y], rate[:, EGO_Y, EGO_X] = turning, -turning
        rate[:, EGO_X, EGO_VELOCITY] = 1.0
        rate[:, EGO_Y, EGO_HEADING] = velocity
        rate[:, EGO_HEADING, EGO_STEERING] = velocity / np.cos(steering) ** 2 / wheelbase
        rate[:, EGO_HEADING, EGO_VELOCITY] = np.tan(steering) / wheelbase
        acting = np.zeros((EGO_SIZE, 2))
        acting[EGO_STEERING, 0] = acting[EGO_VELOCITY, 1] = 1.0
        over_a_step = np.eye(EGO_SIZE) + 0.5 * dt * rate
        state = np.eye(EGO_SIZE) + dt * rate @ over_a_step
        applied = dt * over_a_step @ acting

        left, mean = self._actuators.left, self._actuators.mean
        a = np.zeros((len(states), EGO_SIZE + 2, EGO_SIZE + 2))
        a[:, :EGO_SIZE, :EGO_SIZE] = state
        a[:, :EGO_SIZE, EGO_SIZE:] = applied * mean
        a[:, EGO_SIZE:, EGO_SIZE:] = np.diag(left)
        b = np.zeros((len(states), EGO_SIZE + 2, 2))
        b[:, :EGO_SIZE] = applied * (1.0 - mean)
        b[:, EGO_SIZE:] = np.diag(1.0 - left)
        return a, b


def _in_frame(states: FloatArray, planned: FloatArray) -> FloatArray:
    """(..., 5) errors of states, the positions along and beside the planned heading."""
    error = states - planned
    heading = planned[..., EGO_HEADING]
    x, y = np.array(error[..., EGO_X]), np.array(error[..., EGO_Y])
    error[..., EGO_X] = np.cos(heading) * x + np.sin(heading) * y
    error[..., EGO_Y] = np.cos(heading) * y - np.sin(heading) * x
    error[..., EGO_HEADING] = wrap_angle(error[..., EGO_HEADING])
    return error
