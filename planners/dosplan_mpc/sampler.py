"""Sampled alternatives: the initial guess, the passing side, and the fallback.

Speed profiles times lateral targets times manoeuvre lengths, all at once. Each combination is a
reference: a speed over time and an offset over arc length, a cubic from the present offset and
heading to the target. A tracking law drives the vehicle model after every reference, so a candidate
obeys the vehicle model and its actuators whatever its reference asks for, and any of them may be
driven as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, EvenPath
from dosplan.types import EGO_HEADING, EGO_SIZE, EGO_STEERING, EGO_VELOCITY, FloatArray, IntArray
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.limits import discomfort, grip, half_width
from dosplan_mpc.nlp import Guess
from dosplan_mpc.obstacles import ForbiddenSets
from dosplan_mpc.reference import PATH_LEFT, PATH_RIGHT, EgoOnPath
from dosplan_mpc.road import Road
from dosplan_mpc.shape import disc_offsets
from dosplan_mpc.speed_profile import SpeedProfile
from dosplan_mpc.stage import (
    ACCELERATION,
    INPUT_SIZE,
    PREVIOUS_ACCELERATION,
    STATE_SIZE,
    STEERING_RATE,
)

_CLOSEST_TO_CENTRE = 0.2  # Smallest 1 - kappa d: beyond a bend's centre, offsets are undefined.
_RATED_AT_ONCE = 16  # Candidates whose way on the road is looked at in one go.
_STEEPEST_LED = 0.7  # Slope of a line beside the path from which on it is followed as this.
_SHARPEST_LED = 0.2  # Second derivative of such a line, 1/m, beyond which it counts as this.
_LEAST_STEP = 1e-3  # m between two points of such a line.


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

    def some(self, rows: IntArray) -> Candidates:
        """Some of the candidates.

        Args:
            rows: Which.

        Returns:
            Those alone, in this order.
        """
        return Candidates(
            self.states[rows], self.inputs[rows], self.arclength[rows], self.offset[rows]
        )

    def joined(self, other: Candidates) -> Candidates:
        """These candidates and others.

        Args:
            other: Of as many steps.

        Returns:
            All of them, these first.
        """
        return Candidates(
            *(
                np.concatenate([getattr(self, part.name), getattr(other, part.name)])
                for part in fields(self)
            )
        )

    def guess(self, index: int) -> Guess:
        """A candidate as an initial guess.

        Args:
            index: Which one.

        Returns:
            The guess.
        """
        return Guess(
            states=self.states[index],
            inputs=self.inputs[index],
            road_slack=np.zeros(self.inputs.shape[1]),
            arclength=self.arclength[index],
        )


@dataclass(frozen=True)
class _References:
    """References that the candidates follow.

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
        """Reference offset and its first two derivatives at (C,) arc lengths.

        It is a cubic Hermite polynomial.
        """
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


@dataclass(frozen=True)
class _Led:
    """References along one line beside the path.

    Attributes:
        speed: (C, N + 1) m/s.
        begin: Arc length of the ego's rear axle, m.
        offset: Its offset, m.
        arclength: (N + 1,) increasing arc lengths of the line's points, m.
        line: (N + 1,) their offsets, m.
    """

    speed: FloatArray
    begin: float
    offset: float
    arclength: FloatArray
    line: FloatArray

    def offset_at(self, arclength: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Reference offset and its first two derivatives at (C,) arc lengths."""
        value, first, second = (np.interp(arclength, self.arclength, row) for row in self._rows)
        return value, first, second

    @cached_property
    def _rows(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N + 1,) the line's offset and its first two derivatives at its points."""
        slope = np.gradient(self.line, self.arclength).clip(-_STEEPEST_LED, _STEEPEST_LED)
        bend = np.gradient(slope, self.arclength).clip(-_SHARPEST_LED, _SHARPEST_LED)
        return self.line, slope, bend


class Sampler:
    """Makes and rates candidates."""

    def __init__(
        self,
        config: MpcConfig,
        vehicle: VehicleParameters,
        path: EvenPath,
        road: Road,
        dt: float,
    ) -> None:
        """Keeps what does not change during an episode.

        Args:
            config: Settings.
            vehicle: The ego.
            path: Reference path.
            road: The road's edges, which candidates are rated by.
            dt: Step, s.
        """
        self._config = config
        self._vehicle = vehicle
        self._path = path
        self._road = road
        self._dt = dt
        self._discs, _ = disc_offsets(vehicle, config.discs)
        self._half_width = half_width(config, vehicle)
        self._grip = grip(config, vehicle)

    def disc_centres(self, states: FloatArray) -> FloatArray:
        """Centres of the ego's covering discs.

        Args:
            states: (..., 6) or (..., 5) states.

        Returns:
            (..., D, 2) m.
        """
        heading = states[..., EGO_HEADING]
        direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        return np.asarray(states[..., None, :2] + self._discs[:, None] * direction[..., None, :])

    def sample(self, start: FloatArray, ego: EgoOnPath, profile: SpeedProfile) -> Candidates:
        """Samples from the present state.

        Args:
            start: (6,) present state.
            ego: Where that is on the path.
            profile: Reference of the next steps.

        Returns:
            The candidates.
        """
        return self._combine(start, ego, profile, self._speeds(start[EGO_VELOCITY], profile))

    def at_speed(
        self, start: FloatArray, ego: EgoOnPath, profile: SpeedProfile, speed: FloatArray
    ) -> Candidates:
        """Samples of one speed over time, such as that of a plan which left the road.

        Args:
            start: (6,) present state.
            ego: Where that is on the path.
            profile: Reference of the next steps.
            speed: (N + 1,) m/s.

        Returns:
            The candidates.
        """
        return self._combine(start, ego, profile, speed[None])

    def led(self, start: FloatArray, ego: EgoOnPath, profile: SpeedProfile) -> Candidates:
        """Samples that follow the reference's own offsets: aside when it does, and back.

        Args:
            start: (6,) present state.
            ego: Where that is on the path.
            profile: Reference of the next steps.

        Returns:
            The candidates, one of each speed.
        """
        speeds = self._speeds(start[EGO_VELOCITY], profile)
        along = profile.arclength - self._vehicle.rear_to_centre
        along = along + _LEAST_STEP * np.arange(len(along))  # Increasing where the ego stands.
        return self._drive(start, _Led(speeds, ego.arclength, ego.offset, along, profile.offset))

    def _combine(
        self, start: FloatArray, ego: EgoOnPath, profile: SpeedProfile, speeds: FloatArray
    ) -> Candidates:
        """Every combination of speeds, lateral targets and lengths."""
        settings = self._config.sampler
        targets = self._targets(ego, float(profile.offset[-1]))
        fastest = max(start[EGO_VELOCITY], float(profile.velocity[-1]))
        lengths = np.maximum(
            fastest * np.array(settings.manoeuvre_seconds), settings.shortest_manoeuvre
        )
        # Every combination: C = speeds x targets x lengths.
        combinations = np.indices((len(speeds), len(targets), len(lengths)))
        i, j, k = (index.ravel() for index in combinations)
        here = self._path.at(np.array(ego.arclength))
        turn = start[EGO_HEADING] - here[PATH_HEADING]
        turn = np.clip(turn, -settings.steepest, settings.steepest)
        shrink = max(1.0 - float(here[PATH_CURVATURE]) * ego.offset, _CLOSEST_TO_CENTRE)
        references = _References(
            speed=speeds[i],
            begin=ego.arclength,
            span=lengths[k],
            offset=ego.offset,
            slope=float(np.tan(turn)) * shrink,
            target=targets[j],
        )
        return self._drive(start, references)

    def _speeds(self, velocity: float, profile: SpeedProfile) -> FloatArray:
        """(speeds, N + 1) m/s: constant accelerations, and the reference itself."""
        settings = self._config.sampler
        time = self._dt * np.arange(self._config.horizon + 1)
        ceiling = max(velocity, float(profile.velocity.max()) + settings.overspeed)
        ramps = velocity + np.array(settings.accelerations)[:, None] * time
        speeds = np.vstack([np.clip(ramps, 0.0, ceiling), profile.velocity])
        speeds[:, 0] = velocity
        return speeds

    def _targets(self, ego: EgoOnPath, goal: float) -> FloatArray:
        """(6,) lateral targets, m: the goal's, the present one, a lane and half the road aside."""
        settings = self._config.sampler
        ahead = self._path.at(np.array(ego.arclength + settings.edge_distance))
        left = max(float(ahead[PATH_LEFT]) - self._half_width, 0.0)
        right = min(float(ahead[PATH_RIGHT]) + self._half_width, 0.0)
        beside = [min(settings.lane, left), max(-settings.lane, right)]
        return np.array([goal, ego.offset, *beside, 0.5 * left, 0.5 * right])

    def _drive(self, start: FloatArray, references: _References | _Led) -> Candidates:
        """Drives the vehicle model after the references."""
        vehicle, dt, n = self._vehicle, self._dt, self._config.horizon
        count = len(references.speed)
        states = np.empty((count, n + 1, STATE_SIZE))
        states[:, 0] = start
        inputs = np.empty((count, n, INPUT_SIZE))
        arclength, offset = np.empty((count, n + 1)), np.empty((count, n + 1))
        arclength[:, 0], offset[:, 0] = references.begin, references.offset
        for step in range(n):
            state, s = states[:, step, :EGO_SIZE], arclength[:, step]
            steering = self._tracking_angle(state, s, offset[:, step], references)
            self._actuate(state, steering, references.speed[:, step + 1], out=inputs[:, step])
            reached = states[:, step + 1]
            reached[:, :EGO_SIZE] = vehicle.step(state, inputs[:, step], dt)
            reached[:, PREVIOUS_ACCELERATION] = inputs[:, step, ACCELERATION]
            # The model never reverses, but rounding could give a negative velocity.
            np.maximum(reached[:, EGO_VELOCITY], 0.0, out=reached[:, EGO_VELOCITY])
            arclength[:, step + 1], offset[:, step + 1] = self._path.project(
                reached[:, :2], s + dt * state[:, EGO_VELOCITY], iterations=1
            )
        return Candidates(states, inputs, arclength, offset)

    def _tracking_angle(
        self,
        state: FloatArray,
        s: FloatArray,
        offset: FloatArray,
        references: _References | _Led,
    ) -> FloatArray:
        """(C,) steering angle, rad, that leads to the references' offsets.

        In arc length the offset's law is ``d'' = kappa_ego - kappa_path``: the curvature that is
        asked for adds the reference's own and critically damped feedback over the length of the
        look-ahead.
        """
        settings, limit = self._config.sampler, self._vehicle.max_steering
        row = self._path.at(s)
        curvature, turn = row[:, PATH_CURVATURE], state[:, EGO_HEADING] - row[:, PATH_HEADING]
        asked, first, second = references.offset_at(s)
        reach = np.maximum(
            settings.lookahead_seconds * state[:, EGO_VELOCITY], settings.shortest_lookahead
        )
        slope = np.tan(np.clip(turn, -settings.steepest, settings.steepest))
        bend = curvature / np.maximum(1.0 - curvature * offset, _CLOSEST_TO_CENTRE) + second
        bend += 2.0 * (first - slope) / reach
        bend += (asked - offset) / reach**2
        return np.clip(np.arctan(self._vehicle.wheelbase * bend), -limit, limit)

    def _actuate(
        self, state: FloatArray, steering: FloatArray, speed: FloatArray, out: FloatArray
    ) -> None:
        """Writes (C, 2) inputs that lead to steering angles and speeds as far as limits allow.

        Not ``clip_input``: the plan keeps to the smaller friction circle of ``grip``, and cornering
        does not go first, for a candidate that slips is rated and not repaired.
        """
        vehicle, dt = self._vehicle, self._dt
        velocity, turned = state[:, EGO_VELOCITY], state[:, EGO_STEERING]
        lateral = vehicle.lateral_acceleration(velocity, turned)
        friction = np.sqrt(np.maximum(self._grip**2 - lateral**2, 0.0))
        fastest = np.minimum(friction, vehicle.engine_acceleration(velocity))
        fastest = np.minimum(fastest, (vehicle.max_velocity - velocity) / dt)
        rate = vehicle.max_steering_rate
        np.clip((steering - turned) / dt, -rate, rate, out=out[:, STEERING_RATE])
        np.clip((speed - velocity) / dt, -friction, fastest, out=out[:, ACCELERATION])

    def best(
        self, candidates: Candidates, sets: ForbiddenSets, profile: SpeedProfile
    ) -> tuple[int, float]:
        """The candidate of the lowest cost.

        Where the road is takes longest to find out. So it is looked at for the cheapest of the
        others alone, until those that are left cost more without it than the best one with it.

        Args:
            candidates: What to choose from.
            sets: Forbidden sets.
            profile: Reference of the next steps.

        Returns:
            Its index and cost.
        """
        bound = self._cost(candidates, sets, profile, np.zeros(candidates.offset.shape))
        order = np.argsort(bound, kind="stable")
        index, lowest = int(order[0]), np.inf
        for rows in np.split(order, range(_RATED_AT_ONCE, len(order), _RATED_AT_ONCE)):
            if bound[rows[0]] > lowest:
                break
            costs = self.rate(candidates.some(rows), sets, profile)
            nearest = int(np.argmin(costs))
            if costs[nearest] < lowest:
                index, lowest = int(rows[nearest]), float(costs[nearest])
        return index, lowest

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
        outside = self._road.outside(candidates.states, candidates.arclength, candidates.offset)
        return self._cost(candidates, sets, profile, outside)

    def _cost(
        self,
        candidates: Candidates,
        sets: ForbiddenSets,
        profile: SpeedProfile,
        off_road: FloatArray,
    ) -> FloatArray:
        """(C,) costs of candidates that reach (C, N + 1) m beyond the edges of the road."""
        config, states = self._config, candidates.states
        acceleration = states[:, 1:, PREVIOUS_ACCELERATION]
        cost = self._tracking_cost(candidates, profile)[:, 1:].sum(axis=1)
        cost += 0.5 * config.acceleration_weight * (acceleration**2).sum(axis=1)
        cost += 0.5 * self._discomfort(states, profile)[:, 1:].sum(axis=1)
        outside = self._outside(candidates, profile, off_road)
        outside = outside + config.sampler.slip_penalty * self._slip(states)
        cost += config.road_penalty * outside[:, 1:].sum(axis=1)
        if len(sets.ids):
            distance = sets.distance(self.disc_centres(states[:, 1:]))
            cost += (sets.penalty * np.maximum(1.0 - distance, 0.0)).sum(axis=(1, 2))
        return np.asarray(cost)

    def _tracking_cost(self, candidates: Candidates, profile: SpeedProfile) -> FloatArray:
        """(C, N + 1) cost of being elsewhere or quicker than the reference."""
        config, states = self._config, candidates.states
        position = candidates.arclength + self._vehicle.rear_to_centre
        return np.asarray(
            0.5
            * (
                config.lateral_weight * (candidates.offset - profile.offset) ** 2
                + config.velocity_weight * (states[..., EGO_VELOCITY] - profile.velocity) ** 2
                + profile.station_weight * (position - profile.arclength) ** 2
                + profile.heading_weight * (states[..., EGO_HEADING] - profile.heading) ** 2
            )
        )

    def _outside(
        self, candidates: Candidates, profile: SpeedProfile, off_road: FloatArray
    ) -> FloatArray:
        """(C, N + 1) how far the ego reaches beyond the road's edges or those of a goal, m."""
        heading = self._path.at(candidates.arclength)[..., PATH_HEADING]
        turn = candidates.states[..., EGO_HEADING] - heading
        middle = candidates.offset + self._vehicle.rear_to_centre * np.sin(turn)
        outside = np.maximum(off_road, middle - profile.left)
        return np.asarray(np.maximum(outside, profile.right - middle))

    def _discomfort(self, states: FloatArray, profile: SpeedProfile) -> FloatArray:
        """(C, N + 1) cost of accelerations beyond what is comfortable."""
        along = states[..., PREVIOUS_ACCELERATION]
        lateral = self._vehicle.lateral_acceleration(
            states[..., EGO_VELOCITY], states[..., EGO_STEERING]
        )
        comfort, share = self._config.comfort, profile.comfort
        return np.asarray(discomfort(comfort, along, lateral, share, np.maximum))

    def _slip(self, states: FloatArray) -> FloatArray:
        """(C, N + 1) lateral acceleration beyond the friction circle, as a share of its radius."""
        lateral = self._vehicle.lateral_acceleration(
            states[..., EGO_VELOCITY], states[..., EGO_STEERING]
        )
        return np.asarray(np.maximum(np.abs(lateral) / self._grip - 1.0, 0.0))
