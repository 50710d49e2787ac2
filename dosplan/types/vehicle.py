"""The ego: CommonRoad's kinematic single track with the parameters of a BMW 320i.

Model, with x and y of the rear axle, steering angle delta, velocity v, heading psi, steering
rate u1 and acceleration u2 (Althoff, Wuersching, "CommonRoad: Vehicle Models", 2020a, sec. 3)::

    x' = v cos psi    y' = v sin psi    delta' = u1    v' = u2    psi' = v tan(delta) / l_wb

The figures of ``VehicleParameters`` are those of the same document's vehicle 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dosplan.types.arrays import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_STEERING,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    FloatArray,
)

_STRAIGHT = 1e-9  # Curvature below which a bend limits no velocity, 1/m.


@dataclass(frozen=True)
class VehicleParameters:
    """Size and limits of the ego (defaults: BMW 320i, CommonRoad vehicle 2).

    Attributes:
        length: m.
        width: m.
        rear_to_centre: Distance from the rear axle to the centre of the rectangle, m.
        wheelbase: m.
        max_steering: Largest |steering angle|, rad.
        max_steering_rate: Largest |steering rate|, rad/s.
        max_acceleration: Radius of the friction circle, m/s2.
        switching_velocity: Velocity above which the engine's power limits acceleration, m/s.
        max_velocity: m/s.
    """

    length: float = 4.508
    width: float = 1.610
    rear_to_centre: float = 1.4227170936
    wheelbase: float = 1.1561957064 + 1.4227170936
    max_steering: float = 1.066
    max_steering_rate: float = 0.4
    max_acceleration: float = 11.5
    switching_velocity: float = 7.319
    max_velocity: float = 50.8

    @property
    def size(self) -> tuple[float, float]:
        """Length and width, m."""
        return self.length, self.width

    def centre(self, states: FloatArray) -> FloatArray:
        """Centre of the ego's rectangle.

        Args:
            states: (..., 5) ego states.

        Returns:
            (..., 2) m.
        """
        heading = states[..., EGO_HEADING]
        offset = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        return np.asarray(states[..., :2] + self.rear_to_centre * offset)

    def poses(self, states: FloatArray) -> FloatArray:
        """Pose of the ego's rectangle.

        Args:
            states: (..., 5) ego states.

        Returns:
            (..., 3) centre x, y, m, and heading, rad.
        """
        return np.concatenate([self.centre(states), states[..., EGO_HEADING, None]], axis=-1)

    def state_at(
        self, centre: FloatArray, heading: float, velocity: float, steering: float = 0.0
    ) -> FloatArray:
        """Ego state whose rectangle has the given centre.

        Args:
            centre: (2,) centre of the rectangle, m.
            heading: rad.
            velocity: m/s.
            steering: rad.

        Returns:
            (5,) ego state.
        """
        x = centre[0] - self.rear_to_centre * np.cos(heading)
        y = centre[1] - self.rear_to_centre * np.sin(heading)
        return np.array([x, y, steering, velocity, heading], dtype=np.float64)

    @property
    def engine_power(self) -> float:
        """Power of the engine by the ego's mass, m2/s3."""
        return self.max_acceleration * self.switching_velocity

    def engine_acceleration(self, velocity: FloatArray) -> FloatArray:
        """Largest acceleration that the engine can give.

        Args:
            velocity: (...) m/s.

        Returns:
            (...) m/s2: ``max_acceleration``, above ``switching_velocity`` what its power allows.
        """
        share = self.switching_velocity / np.maximum(self.switching_velocity, velocity)
        return self.max_acceleration * share

    def lateral_acceleration(self, velocity: FloatArray, steering: FloatArray) -> FloatArray:
        """Lateral acceleration of the rear axle.

        Args:
            velocity: (...) m/s.
            steering: (...) rad.

        Returns:
            (...) m/s2, ``v^2 tan(delta) / l_wb``, left positive.
        """
        return velocity**2 * np.tan(steering) / self.wheelbase

    def clip_input(self, states: FloatArray, inputs: FloatArray, dt: float) -> FloatArray:
        """The inputs the actuators can deliver, nearest to those that are asked for.

        Cornering comes first: at the step's end the wheels are turned no further than their stop,
        and no further than the grip allows at the present velocity,
        ``v^2 tan|delta| / l_wb <= max_acceleration``; wheels that are turned further already go
        back as fast as they can. The acceleration keeps the velocity within 0 and
        ``max_velocity`` (the ego does not reverse) and is within what cornering leaves of the
        friction circle and within the engine's power. It does not lead into a velocity that is
        too fast for the bend.

        Takes one state or many, whose leading shapes are broadcast: (M, 1, 5) states and (K, 2)
        inputs give the (M, K, 2) inputs of each state with each input.

        Args:
            states: (..., 5) ego states.
            inputs: (..., 2) steering rate, rad/s, and acceleration, m/s2.
            dt: Time for which an input is held, s.

        Returns:
            (..., 2) inputs, the same to the last bit for states one by one and many at once.
        """
        # [()] makes a single state's values plain numbers, which are quicker than arrays of one.
        steering, velocity = states[..., EGO_STEERING][()], states[..., EGO_VELOCITY][()]
        # velocity**2 would round a single number and an array differently.
        squared = np.float_power(velocity, 2.0)
        gripping = np.arctan2(self.max_acceleration * self.wheelbase, squared)
        furthest = np.minimum(self.max_steering, gripping)
        rate = _clip(inputs[..., 0][()], (-furthest - steering) / dt, (furthest - steering) / dt)
        rate = _clip(rate, -self.max_steering_rate, self.max_steering_rate)

        turned = np.maximum(abs(steering), abs(steering + rate * dt))
        curvature = np.tan(turned) / self.wheelbase
        left = self.max_acceleration**2 - np.float_power(squared * curvature, 2.0)
        left = np.sqrt(np.maximum(0.0, left))
        fastest = np.sqrt(self.max_acceleration / np.maximum(_STRAIGHT, curvature))
        bend = np.maximum(0.0, fastest - velocity) / dt
        upper = np.minimum(np.minimum(left, self.engine_acceleration(velocity)), bend)
        acceleration = _clip(
            inputs[..., 1][()], -velocity / dt, (self.max_velocity - velocity) / dt
        )
        acceleration = _clip(acceleration, -left, upper)
        out = np.empty((*acceleration.shape, 2))
        out[..., 0], out[..., 1] = rate, acceleration
        return out

    def derivative(self, states: FloatArray, inputs: FloatArray) -> FloatArray:
        """Right-hand side of the kinematic single track.

        Args:
            states: (..., 5) ego states.
            inputs: (..., 2) steering rate, rad/s, and acceleration, m/s2.

        Returns:
            (..., 5) time derivative.
        """
        velocity, heading = states[..., EGO_VELOCITY], states[..., EGO_HEADING]
        out = np.empty((*np.broadcast_shapes(states.shape[:-1], inputs.shape[:-1]), EGO_SIZE))
        out[..., EGO_X] = velocity * np.cos(heading)
        out[..., EGO_Y] = velocity * np.sin(heading)
        out[..., EGO_STEERING] = inputs[..., 0]
        out[..., EGO_VELOCITY] = inputs[..., 1]
        out[..., EGO_HEADING] = velocity * np.tan(states[..., EGO_STEERING]) / self.wheelbase
        return out

    def step(self, states: FloatArray, inputs: FloatArray, dt: float) -> FloatArray:
        """One step of the classical Runge-Kutta method with the inputs held.

        Args:
            states: (..., 5) ego states.
            inputs: (..., 2) steering rate, rad/s, and acceleration, m/s2.
            dt: Step, s.

        Returns:
            (..., 5) ego states ``dt`` later.
        """
        k1 = self.derivative(states, inputs)
        k2 = self.derivative(states + 0.5 * dt * k1, inputs)
        k3 = self.derivative(states + 0.5 * dt * k2, inputs)
        k4 = self.derivative(states + dt * k3, inputs)
        return np.asarray(states + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


def _clip(value: FloatArray, lower: FloatArray | float, upper: FloatArray | float) -> FloatArray:
    """``np.clip``, which takes twice as long for a single number."""
    return np.minimum(upper, np.maximum(lower, value))
