"""Following a reference path: projection, steering, and a plan rolled out by the vehicle model."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely

from dosplan.geometry import wrap_angle
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


class ReferencePath:
    """A route's path, longer at both ends, with fast look-ups by arc length.

    Arc lengths here are those of the route; they are negative before its first point.
    """

    def __init__(self, route: Route) -> None:
        """Prepares the look-ups.

        Args:
            route: The route to follow.
        """
        ends = np.array([route.heading[0], route.heading[-1]])
        along = _EXTENSION * np.stack([np.cos(ends), np.sin(ends)], axis=1)
        self._points = np.concatenate(
            [route.path[:1] - along[:1], route.path, route.path[-1:] + along[1:]]
        )
        # Projection costs time per vertex; arc lengths on the thinned line differ by less than
        # a thousandth.
        self._line = shapely.LineString(self._points).simplify(_THINNING, preserve_topology=False)
        pieces = np.linalg.norm(np.diff(self._points, axis=0), axis=1)
        self._s = np.concatenate([[0.0], np.cumsum(pieces)]) - _EXTENSION
        self._heading = np.concatenate([ends[:1], route.heading, ends[1:]])
        self._curvature = np.concatenate([[0.0], route.curvature, [0.0]])

    def arclength(self, points: FloatArray) -> FloatArray:
        """Projects points on the path.

        Args:
            points: (..., 2) m.

        Returns:
            (...) arc length of the nearest point of the path, m.
        """
        return np.asarray(
            shapely.line_locate_point(self._line, shapely.points(points)) - _EXTENSION
        )

    def heading(self, s: FloatArray | float) -> FloatArray:
        """Heading of the path.

        Args:
            s: (...) arc length, m.

        Returns:
            (...) rad, continuous.
        """
        return np.asarray(np.interp(s, self._s, self._heading))

    def curvature(self, s: FloatArray | float) -> FloatArray:
        """Signed curvature of the path.

        Args:
            s: (...) arc length, m.

        Returns:
            (...) 1/m, left positive.
        """
        return np.asarray(np.interp(s, self._s, self._curvature))

    def offset(self, points: FloatArray, s: FloatArray | float) -> FloatArray:
        """Signed lateral distance from the path.

        Args:
            points: (..., 2) m.
            s: (...) their arc lengths, m.

        Returns:
            (...) m, left positive.
        """
        heading = self.heading(s)
        x = np.interp(s, self._s, self._points[:, 0])
        y = np.interp(s, self._s, self._points[:, 1])
        return np.asarray(
            np.cos(heading) * (points[..., 1] - y) - np.sin(heading) * (points[..., 0] - x)
        )

    def speed_profile(self, lateral: float, braking: float) -> tuple[FloatArray, FloatArray]:
        """The fastest a vehicle may go at each point to take every bend ahead.

        Args:
            lateral: Largest lateral acceleration, m/s2.
            braking: Deceleration with which it slows down before a bend, m/s2.

        Returns:
            (P,) arc length, m, and (P,) velocity, m/s.
        """
        bend = lateral / np.maximum(np.abs(self._curvature), 1e-6)
        # v(s)^2 <= bend(s') + 2 b (s' - s) for every s' >= s.
        ahead = bend + 2.0 * braking * self._s
        allowed = np.minimum.accumulate(ahead[::-1])[::-1] - 2.0 * braking * self._s
        return self._s, np.sqrt(np.maximum(allowed, 0.0))


def steering_rate(
    path: ReferencePath, state: FloatArray, s: float, vehicle: VehicleParameters
) -> float:
    """Steering rate that brings the rear axle onto the path and keeps it there.

    The feedback law for the rear axle of a kinematic bicycle (Paden et al., "A Survey of Motion
    Planning and Control Techniques for Self-Driving Urban Vehicles", 2016, sec. V-A2), written
    as a curvature, with gains for a critically damped decay of the lateral error e over the
    length l: ``curvature = k cos(a) / (1 - k e) - 2 a / l - sinc(a) e / l^2``, where a is the
    heading error and k the path's curvature where the ego will be once the wheels have turned.

    Args:
        path: The path.
        state: (5,) ego state.
        s: Its arc length on the path, m.
        vehicle: The ego.

    Returns:
        rad/s, not yet limited.
    """
    velocity = float(state[EGO_VELOCITY])
    error = float(path.offset(state[:2], s))
    angle = float(wrap_angle(state[EGO_HEADING] - path.heading(s)))
    bend = float(path.curvature(s + _ACTUATION * velocity))
    length = max(_LENGTH_LEAST, _LENGTH_TIME * velocity)
    # Beyond the centre of the bend the law has no meaning; there the pole is kept away.
    follow = bend * np.cos(angle) / max(1.0 - bend * error, 0.2)
    curvature = follow - 2.0 * angle / length - np.sinc(angle / np.pi) * error / length**2
    wanted = np.arctan(vehicle.wheelbase * curvature)
    limited = np.clip(wanted, -vehicle.max_steering, vehicle.max_steering)
    return float(limited - state[EGO_STEERING]) / _ACTUATION


def roll_out(
    path: ReferencePath,
    state: FloatArray,
    acceleration: AccelerationLaw,
    vehicle: VehicleParameters,
    dt: float,
    steps: int = PLAN_STEPS,
) -> Plan:
    """A plan that follows a path with a given law for the speed.

    Args:
        path: The path.
        state: (5,) ego state now.
        acceleration: From step, arc length of the rear axle, m, and velocity, m/s, to
            acceleration, m/s2.
        vehicle: The ego.
        dt: Step, s.
        steps: Number T of steps.

    Returns:
        The plan; its inputs are what the actuators can deliver.
    """
    states, inputs = [state], []
    for step in range(steps):
        now = states[-1]
        s = float(path.arclength(now[:2]))
        rate = steering_rate(path, now, s, vehicle)
        wanted = np.array([rate, acceleration(step, s, float(now[EGO_VELOCITY]))])
        inputs.append(vehicle.clip_input(now, wanted, dt))
        states.append(vehicle.step(now, inputs[-1], dt))
    return Plan(states=np.stack(states), inputs=np.stack(inputs))
