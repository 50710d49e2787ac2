"""Following a path or a trajectory: steering, and a plan by the vehicle model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.geometry.path import ReferencePath
from dosplan.geometry.plane import cross, wrap_angle
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    FloatArray,
    Plan,
    Route,
    ShapeError,
)
from dosplan.types.arrays import check_finite
from dosplan.types.vehicle import VehicleParameters

_EXTENSION: Final = 100.0  # m of straight road at both ends, so that every projection is inside.
_THINNING: Final = 0.005  # m; how far the line that points are projected on may be off the path.
_ACTUATION: Final = 0.2  # Time within which the wheels shall reach the wanted angle, s.
_LENGTH_TIME: Final = 0.8  # The lateral error decays over this time at speed, s ...
_LENGTH_LEAST: Final = 4.0  # ... and over no shorter a way than this, m.
_APART: Final = 0.2  # m; poses nearer to each other than this say nothing of a path.
_SPACING: Final = 0.5  # m between the points of a path through poses.
_RATE: Final = 2.0  # 1/s; how fast a lag behind a trajectory decays, critically damped.

AccelerationLaw = Callable[[int, float, float], float]
"""From step, arc length of the rear axle, m, and velocity, m/s, to acceleration, m/s2."""


def extended_path(route: Route) -> ReferencePath:
    """The path of a route, longer at both ends, so that a vehicle may be anywhere beside it.

    Args:
        route: The route to follow.

    Returns:
        Its path; arc lengths are those of the route and negative before its first point.
    """
    return _extended(route.path, route.heading, route.curvature)


def _extended(points: FloatArray, heading: FloatArray, curvature: FloatArray) -> ReferencePath:
    """A path that goes straight on at both ends, with arc length 0 at its first point."""
    ends = np.array([heading[0], heading[-1]])
    along = _EXTENSION * np.stack([np.cos(ends), np.sin(ends)], axis=1)
    points = np.concatenate([points[:1] - along[:1], points, points[-1:] + along[1:]])
    pieces = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # Projection costs time per vertex; arc lengths on the thinned line differ by less than
    # a thousandth.
    return ReferencePath(
        np.concatenate([[0.0], np.cumsum(pieces)]) - _EXTENSION,
        points,
        np.concatenate([ends[:1], heading, ends[1:]]),
        np.concatenate([[0.0], curvature, [0.0]]),
        thinning=_THINNING,
    )


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
        steps: int,
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


def follow_poses(
    vehicle: VehicleParameters, ego: FloatArray, poses: FloatArray, times: FloatArray, dt: float
) -> Plan:
    """A plan that follows poses in time: what becomes of a trajectory without inputs.

    The way is a cubic spline through the ego's pose and the others; along it, the ego is where the
    times say, between them by monotone interpolation. Poses behind the ego, or closer together than
    0.2 m, as where the trajectory stands, say when, but not where to.

    Args:
        vehicle: The ego.
        ego: (5,) its state now.
        poses: (K, 3) x and y of the rear axle, m, and heading, rad, in the scenario's frame.
        times: (K,) when it is to be there, from now on, increasing, s.
        dt: Step, s.

    Returns:
        The plan, up to the last of the times; its inputs are what the actuators can deliver.

    Raises:
        ShapeError: Poses or times have another shape, or a value that is not finite, or the times
            do not increase from 0 on, or end within the first step.
    """
    from scipy.interpolate import PchipInterpolator  # Takes long to import.

    poses, times = np.asarray(poses, dtype=float), np.asarray(times, dtype=float)
    if poses.ndim != 2 or poses.shape[1] != 3 or times.shape != poses.shape[:1]:
        raise ShapeError(
            f"poses and times have the shapes {poses.shape} and {times.shape}, expected (K, 3): x, "
            "y, heading, and (K,)"
        )
    check_finite(poses, "an array of poses")
    check_finite(times, "an array of times")
    moments = np.concatenate([[0.0], times])
    steps = round(float(moments[-1]) / dt)
    if steps < 1 or np.any(np.diff(moments) <= 0.0):
        raise ShapeError("times must increase from 0 on, and last for a step or more")
    path = _path_through(np.concatenate([ego[None, [EGO_X, EGO_Y, EGO_HEADING]], poses]))
    stations = np.maximum.accumulate(path.locate(poses[:, :2]))
    station = PchipInterpolator(moments, np.concatenate([[0.0], np.maximum(stations, 0.0)]))
    velocity = station.derivative()
    change = velocity.derivative()

    def law(step: int, s: float, now: float) -> float:
        time = min(step * dt, float(moments[-1]))
        lag, slower = float(station(time)) - s, float(velocity(time)) - now
        return float(change(time)) + 2.0 * _RATE * slower + _RATE**2 * lag

    return PathFollower(path, vehicle, dt).roll_out(ego, law, steps)


def _path_through(poses: FloatArray) -> ReferencePath:
    """A path through (K, 3) poses, the first at arc length 0, straight on at both ends."""
    from scipy.interpolate import CubicHermiteSpline

    kept = [poses[0]]
    for pose in poses[1:]:
        away = pose[:2] - kept[-1][:2]
        if away @ [np.cos(kept[-1][2]), np.sin(kept[-1][2])] > _APART:
            kept.append(pose)
    nodes = np.stack(kept)
    if len(nodes) == 1:
        nodes = np.stack([poses[0], poses[0]])
        nodes[1, :2] += [np.cos(poses[0, 2]), np.sin(poses[0, 2])]
    along = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(nodes[:, :2], axis=0), axis=1))]
    )
    tangents = np.stack([np.cos(nodes[:, 2]), np.sin(nodes[:, 2])], axis=1)
    spline = CubicHermiteSpline(along, nodes[:, :2], tangents)
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / _SPACING)) + 1)
    points, first, second = spline(at), spline(at, 1), spline(at, 2)
    heading = np.unwrap(np.arctan2(first[:, 1], first[:, 0]))
    curvature = cross(first, second) / np.maximum(np.linalg.norm(first, axis=1), 1e-3) ** 3
    return _extended(points, heading, curvature)
