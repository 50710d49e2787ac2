"""Following a path: steering, the speed that bends allow, and a plan by the vehicle model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dosplan.geometry import ReferencePath, braking_envelope, wrap_angle
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    FloatArray,
    Plan,
    Route,
)
from dosplan.vehicle import VehicleParameters

PLAN_STEPS = 30  # 3 s.

_EXTENSION = 100.0  # m of straight road added at both ends, so that every projection is inside.
_THINNING = 0.005  # m; how far the line that points are projected on may be off the path.
_ACTUATION = 0.2  # Time within which the wheels shall reach the wanted angle, s.
_LENGTH_TIME = 0.8  # The lateral error decays over this time at speed, s ...
_LENGTH_LEAST = 4.0  # ... and over no shorter a way than this, m.

AccelerationLaw = Callable[[int, float, float], float]


def extended_path(route: Route) -> ReferencePath:
    """The path of a route, longer at both ends, so that a vehicle may be anywhere beside it.

    Args:
        route: The route to follow.

    Returns:
        Its path; arc lengths are those of the route and negative before its first point.
    """
    ends = np.array([route.heading[0], route.heading[-1]])
    along = _EXTENSION * np.stack([np.cos(ends), np.sin(ends)], axis=1)
    points = np.concatenate([route.path[:1] - along[:1], route.path, route.path[-1:] + along[1:]])
    pieces = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # Projection costs time per vertex; arc lengths on the thinned line differ by less than
    # a thousandth.
    return ReferencePath(
        np.concatenate([[0.0], np.cumsum(pieces)]) - _EXTENSION,
        points,
        np.concatenate([ends[:1], route.heading, ends[1:]]),
        np.concatenate([[0.0], route.curvature, [0.0]]),
        thinning=_THINNING,
    )


def bend_speed(
    path: ReferencePath, lateral: float, braking: float
) -> tuple[FloatArray, FloatArray]:
    """The fastest a vehicle may go at each point to take every bend ahead.

    Args:
        path: The path.
        lateral: Largest lateral acceleration, m/s2.
        braking: Deceleration with which it slows down before a bend, m/s2.

    Returns:
        (P,) arc length, m, and (P,) velocity, m/s.
    """
    squared = lateral / np.maximum(np.abs(path.curvature), 1e-6)
    return path.arclength, braking_envelope(squared, path.arclength, braking)


@dataclass(frozen=True)
class PathFollower:
    """Drives a vehicle along a path.

    Attributes:
        path: The path.
        vehicle: The ego.
        dt: Step, s.
    """

    path: ReferencePath
    vehicle: VehicleParameters
    dt: float

    def steering_rate(self, state: FloatArray, s: float) -> float:
        """Steering rate that brings the rear axle onto the path and keeps it there.

        The feedback law for the rear axle of a kinematic bicycle (Paden et al., "A Survey of
        Motion Planning and Control Techniques for Self-Driving Urban Vehicles", 2016, sec. V-A2),
        written as a curvature, with gains for a critically damped decay of the lateral error e
        over the length l: ``curvature = k cos(a) / (1 - k e) - 2 a / l - sinc(a) e / l^2``, where
        a is the heading error and k the path's curvature where the ego will be once the wheels
        have turned.

        Args:
            state: (5,) ego state.
            s: Its arc length on the path, m.

        Returns:
            rad/s, not yet limited.
        """
        path, vehicle, velocity = self.path, self.vehicle, float(state[EGO_VELOCITY])
        error = float(path.offset(state[:2], s))
        angle = float(wrap_angle(state[EGO_HEADING] - path.heading_at(s)))
        bend = float(path.curvature_at(s + _ACTUATION * velocity))
        length = max(_LENGTH_LEAST, _LENGTH_TIME * velocity)
        # Beyond the centre of the bend the law has no meaning; there the pole is kept away.
        follow = bend * np.cos(angle) / max(1.0 - bend * error, 0.2)
        curvature = follow - 2.0 * angle / length - np.sinc(angle / np.pi) * error / length**2
        wanted = np.arctan(vehicle.wheelbase * curvature)
        limited = np.clip(wanted, -vehicle.max_steering, vehicle.max_steering)
        return float(limited - state[EGO_STEERING]) / _ACTUATION

    def roll_out(
        self,
        state: FloatArray,
        acceleration: AccelerationLaw,
        steps: int = PLAN_STEPS,
        last: float | None = None,
    ) -> Plan:
        """A plan that follows the path with a given law for the speed.

        Args:
            state: (5,) ego state now.
            acceleration: From step, arc length of the rear axle, m, and velocity, m/s, to
                acceleration, m/s2.
            steps: Number T of steps.
            last: Arc length at which it was a step ago, m; None where it does not matter on which
                of several laps it is.

        Returns:
            The plan; its inputs are what the actuators can deliver.
        """
        states, inputs = [state], []
        for step in range(steps):
            now = states[-1]
            s = float(self.path.locate(now[:2]) if last is None else self.path.track(now[:2], last))
            last = None if last is None else s
            law = acceleration(step, s, float(now[EGO_VELOCITY]))
            wanted = np.array([self.steering_rate(now, s), law])
            inputs.append(self.vehicle.clip_input(now, wanted, self.dt))
            states.append(self.vehicle.step(now, inputs[-1], self.dt))
        return Plan(states=np.stack(states), inputs=np.stack(inputs))
