"""Sampled alternatives: the initial guess, the passing side, and the fallback.

Speed profiles times lateral targets times manoeuvre lengths, all at once. Each combination is a
wish: a speed over time and an offset over arc length, a cubic from the present offset and heading
to the target. A tracking law drives the vehicle model after every wish, so a candidate obeys the
actuators and the vehicle model whatever was wished for, and any of them may be driven as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, EvenPath
from dosplan.types import EGO_SIZE, FloatArray
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.goal import SpeedProfile
from dosplan_mpc.nlp import Guess
from dosplan_mpc.obstacles import ForbiddenSets
from dosplan_mpc.reference import PATH_LEFT, PATH_RIGHT
from dosplan_mpc.shape import disc_offsets, station_offsets
from dosplan_mpc.stage import STATE_SIZE

_ACCELERATIONS = np.array([-8.0, -5.0, -3.0, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 4.0])
_MANOEUVRE_SECONDS = np.array([1.5, 3.0])
_SHORTEST_MANOEUVRE = 8.0  # m; a car cannot change its lane on the spot.
_LANE = 3.4  # m; offset of a candidate that goes to the next lane.
_STEEPEST = 0.8  # Largest angle to the path that the tracking law reacts to, rad.
_LOOKAHEAD_SECONDS = 0.6
_SLIP_PENALTY = 5.0  # m off the road that leaving the friction circle by its radius is worth
_SHORTEST_LOOKAHEAD = 3.0  # m


@dataclass(frozen=True)
class Candidates:
    """Sampled trajectories; they obey the vehicle model.

    Attributes:
        states: (C, N + 1, 6) states of the optimal control problem.
        inputs: (C, N, 2) steering rate, rad/s, and acceleration, m/s2.
        arclength: (C, N + 1) arc length of the rear axle, m.
        offset: (C, N + 1) lateral offset of the rear axle, m.
    """

    states: FloatArray
    inputs: FloatArray
    arclength: FloatArray
    offset: FloatArray


@dataclass(frozen=True)
class _Wishes:
    """What the candidates are asked to do.

    Attributes:
        speed: (C, N + 1) m/s.
        begin: Arc length at which the change of offset begins, m.
        span: (C,) its length, m.
        offset: Offset at ``begin``, m.
        slope: Derivative of the offset there.
        target: (C,) offset at its end, m.
    """

    speed: FloatArray
    begin: float
    span: FloatArray
    offset: float
    slope: float
    target: FloatArray

    def offset_at(self, arclength: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Wanted offset and its first two derivatives at (C,) arc lengths: a cubic Hermite."""
        part = np.clip((arclength - self.begin) / self.span, 0.0, 1.0)
        rise = self.target - self.offset
        value = (
            self.offset
            + self.slope * self.span * (part**3 - 2.0 * part**2 + part)
            + rise * (3.0 * part**2 - 2.0 * part**3)
        )
        first = self.slope * (3.0 * part**2 - 4.0 * part + 1.0)
        first += rise / self.span * 6.0 * (part - part**2)
        second = self.slope * (6.0 * part - 4.0) / self.span
        second += rise / self.span**2 * (6.0 - 12.0 * part)
        return value, first, np.where(part < 1.0, second, 0.0)


class Sampler:
    """Makes and rates candidates."""

    def __init__(
        self, config: MpcConfig, vehicle: VehicleParameters, path: EvenPath, dt: float
    ) -> None:
        """Keeps what does not change during an episode.

        Args:
            config: Settings.
            vehicle: The ego.
            path: Reference path.
            dt: Step, s.
        """
        self._config = config
        self._vehicle = vehicle
        self._path = path
        self._dt = dt
        self._discs, _ = disc_offsets(vehicle, config.discs)
        self._stations = station_offsets(vehicle)

    def disc_centres(self, states: FloatArray) -> FloatArray:
        """Centres of the ego's covering discs.

        Args:
            states: (..., 6) or (..., 5) states.

        Returns:
            (..., D, 2) m.
        """
        direction = np.stack([np.cos(states[..., 4]), np.sin(states[..., 4])], axis=-1)
        return np.asarray(states[..., None, :2] + self._discs[:, None] * direction[..., None, :])

    def sample(
        self, start: FloatArray, arclength: float, offset: float, profile: SpeedProfile
    ) -> Candidates:
        """Samples from the present state.

        Args:
            start: (6,) present state.
            arclength: Arc length of the rear axle, m.
            offset: Its lateral offset, m.
            profile: Reference of the next steps.

        Returns:
            The candidates.
        """
        n = self._config.horizon
        time = self._dt * np.arange(n + 1)
        v0 = start[3]
        ceiling = max(v0, float(profile.velocity.max()) + 3.0)
        constant = np.clip(v0 + _ACCELERATIONS[:, None] * time, 0.0, ceiling)
        speed = np.vstack([constant, profile.velocity])
        speed[:, 0] = v0
        here = self._path.at(np.array(arclength))
        ahead = self._path.at(np.array(arclength + 10.0))
        room = self._vehicle.width / 2.0 + self._config.road_margin
        left = max(float(ahead[PATH_LEFT]) - room, 0.0)
        right = min(float(ahead[PATH_RIGHT]) + room, 0.0)
        goal = float(profile.offset[-1])
        targets = np.array(
            [goal, offset, min(_LANE, left), max(-_LANE, right), 0.5 * left, 0.5 * right]
        )
        length = np.maximum(
            max(v0, float(profile.velocity[-1])) * _MANOEUVRE_SECONDS, _SHORTEST_MANOEUVRE
        )
        # Every combination: C = speeds x targets x lengths.
        i, j, k = (index.ravel() for index in np.indices((len(speed), len(targets), len(length))))
        turn = np.clip(start[4] - here[PATH_HEADING], -_STEEPEST, _STEEPEST)
        wishes = _Wishes(
            speed=speed[i],
            begin=arclength,
            span=length[k],
            offset=offset,
            slope=float(np.tan(turn)) * max(1.0 - float(here[PATH_CURVATURE]) * offset, 0.2),
            target=targets[j],
        )
        return self._drive(start, wishes)

    def _drive(self, start: FloatArray, wishes: _Wishes) -> Candidates:
        """Drives the vehicle model after the wishes.

        In arc length the offset's law is ``d'' = kappa_ego - kappa_path``: the wanted curvature
        adds the wish's own and critically damped feedback over the length ``_lookahead``.
        """
        vehicle, dt, n = self._vehicle, self._dt, self._config.horizon
        count = len(wishes.target)
        states = np.empty((count, n + 1, STATE_SIZE))
        states[:, 0] = start
        inputs = np.empty((count, n, 2))
        arclength, offset = np.empty((count, n + 1)), np.empty((count, n + 1))
        arclength[:, 0], offset[:, 0] = wishes.begin, wishes.offset
        grip = self._config.grip * vehicle.max_acceleration
        for step in range(n):
            state, s, d = states[:, step, :EGO_SIZE], arclength[:, step], offset[:, step]
            row = self._path.at(s)
            curvature, turn = row[:, PATH_CURVATURE], state[:, 4] - row[:, PATH_HEADING]
            wanted, first, second = wishes.offset_at(s)
            reach = np.maximum(_LOOKAHEAD_SECONDS * state[:, 3], _SHORTEST_LOOKAHEAD)
            bend = curvature / np.maximum(1.0 - curvature * d, 0.2) + second
            bend += 2.0 * (first - np.tan(np.clip(turn, -_STEEPEST, _STEEPEST))) / reach
            bend += (wanted - d) / reach**2
            steering = np.clip(
                np.arctan(vehicle.wheelbase * bend), -vehicle.max_steering, vehicle.max_steering
            )
            lateral = vehicle.lateral_acceleration(state[:, 3], state[:, 2])
            friction = np.sqrt(np.maximum(grip**2 - lateral**2, 0.0))
            engine = vehicle.engine_acceleration(state[:, 3])
            rate, acceleration = inputs[:, step, 0], inputs[:, step, 1]
            np.clip(
                (steering - state[:, 2]) / dt,
                -vehicle.max_steering_rate,
                vehicle.max_steering_rate,
                out=rate,
            )
            np.clip(
                (wishes.speed[:, step + 1] - state[:, 3]) / dt,
                -friction,
                np.minimum(friction, engine),
                out=acceleration,
            )
            states[:, step + 1, :EGO_SIZE] = vehicle.step(state, inputs[:, step], dt)
            states[:, step + 1, 5] = acceleration
            # The model never reverses; rounding must not either.
            np.maximum(states[:, step + 1, 3], 0.0, out=states[:, step + 1, 3])
            arclength[:, step + 1], offset[:, step + 1] = self._path.project(
                states[:, step + 1, :2], s + dt * state[:, 3], iterations=1
            )
        return Candidates(states, inputs, arclength, offset)

    def rate(
        self, candidates: Candidates, sets: ForbiddenSets, profile: SpeedProfile
    ) -> FloatArray:
        """Cost of each candidate, close to that of the optimal control problem.

        Args:
            candidates: What to rate.
            sets: Forbidden sets.
            profile: Reference of the next steps.

        Returns:
            (C,) costs.
        """
        c, x = self._config, candidates.states
        row = self._path.at(candidates.arclength)
        half = self._vehicle.width / 2.0 + c.road_margin
        turn = np.tan(np.clip(x[..., 4] - row[..., PATH_HEADING], -1.0, 1.0))
        outside = np.zeros(x.shape[:2])
        for ahead in self._stations:
            beside = self._path.at(candidates.arclength + ahead)
            # The ego's axis is a tangent; the path bends away from it by kappa l^2 / 2.
            d = candidates.offset + ahead * turn - 0.5 * row[..., PATH_CURVATURE] * ahead**2
            outside = np.maximum(outside, d + half - beside[..., PATH_LEFT])
            outside = np.maximum(outside, beside[..., PATH_RIGHT] - d + half)
        middle = candidates.offset + self._vehicle.rear_to_centre * turn
        outside = np.maximum(outside, middle - profile.left)
        outside = np.maximum(outside, profile.right - middle)
        acceleration = x[:, 1:, 5]
        lateral = self._vehicle.lateral_acceleration(x[..., 3], x[..., 2])
        slip = np.maximum(np.abs(lateral) / (c.grip * self._vehicle.max_acceleration) - 1.0, 0.0)
        cost = 0.5 * (
            c.lateral_weight * (candidates.offset - profile.offset) ** 2
            + c.velocity_weight * (x[..., 3] - profile.velocity) ** 2
            + profile.station_weight
            * (candidates.arclength + self._vehicle.rear_to_centre - profile.arclength) ** 2
            + profile.heading_weight * (x[..., 4] - profile.heading) ** 2
        )[:, 1:].sum(axis=1)
        cost += 0.5 * c.acceleration_weight * (acceleration**2).sum(axis=1)
        cost += c.road_penalty * (outside + _SLIP_PENALTY * slip)[:, 1:].sum(axis=1)
        if len(sets.ids):
            distance = sets.distance(self.disc_centres(x[:, 1:]))
            inside = sets.slots[..., 6] * np.maximum(1.0 - distance, 0.0)
            cost += inside.sum(axis=(1, 2))
        return np.asarray(cost)

    def guess(self, candidates: Candidates, index: int) -> Guess:
        """A candidate as an initial guess.

        Args:
            candidates: The candidates.
            index: Which one.

        Returns:
            The guess.
        """
        n = self._config.horizon
        return Guess(
            states=candidates.states[index],
            inputs=candidates.inputs[index],
            road_slack=np.zeros(n),
            arclength=candidates.arclength[index],
        )
