"""The reference of the next steps: a speed that meets the goal, and the way into its region."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Self

import numpy as np

from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, EvenPath, braking_envelope
from dosplan.types import FloatArray, IntArray, Route
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig, SpeedSettings, Style
from dosplan_mpc.goal_window import GoalWindow
from dosplan_mpc.reference import EgoOnPath
from dosplan_mpc.traffic import Traffic

_GRID = 1.0  # Spacing of the arc lengths at which the speed limit is known, m.
_SHORTEST_GRID = 60.0  # m
_FASTEST = 45.0  # m/s; the grid reaches as far as this speed takes the ego in the horizon.
_BEYOND_GOAL = 5.0  # m of the grid behind a goal's region.
# Speeds that are tried for a goal, m/s; quicker vehicles try more.
_SPEEDS = np.concatenate([np.linspace(0.05, 12.0, 80), np.linspace(12.25, 45.0, 132)])
_SPEED_STEP = 0.25  # m/s, of the quicker ones.
_UNLIMITED = 100.0  # m/s, more than any plan; a number, so that it can be interpolated.
_SHORTEST_WAY = 0.1  # m; keeps the braking before a line finite.
_STRAIGHT = 1e-3  # Curvature below which a path limits no speed, 1/m; also a change of steering.


@dataclass(frozen=True)
class SpeedProfile:
    """Reference of the next steps.

    Attributes:
        velocity: (N + 1,) m/s.
        arclength: (N + 1,) where the ego's centre is at that speed, m.
        station_weight: (N + 1,) what being elsewhere costs, 1/m2.
        offset: (N + 1,) lateral offset from the path, m.
        right: (N + 1,) right edge that a goal asks the ego's centre to keep, m; -inf without one.
        left: (N + 1,) left edge, m; inf without one.
        heading: (N + 1,) heading that a goal asks for, rad.
        heading_weight: (N + 1,) what another heading costs, 1/rad2.
        comfort: (N + 1,) share of what discomfort costs that counts.
    """

    velocity: FloatArray
    arclength: FloatArray
    station_weight: FloatArray
    offset: FloatArray
    right: FloatArray
    left: FloatArray
    heading: FloatArray
    heading_weight: FloatArray
    comfort: FloatArray

    def at(self, steps: IntArray) -> SpeedProfile:
        """The reference of some steps.

        Args:
            steps: (K,) which.

        Returns:
            The same for those alone.
        """
        return SpeedProfile(**{part.name: getattr(self, part.name)[steps] for part in fields(self)})


@dataclass(frozen=True)
class SpeedLimit:
    """How fast the ego may be ahead, in one style of driving.

    Attributes:
        arclength: (S,) equally spaced from the ego's centre on, m.
        velocity: (S,) m/s.
        style: The accelerations it is made with.
        legal: (S,) what the map allows, m/s, with the braking before it; ``_UNLIMITED`` where
            that is not kept.
    """

    arclength: FloatArray
    velocity: FloatArray
    style: Style
    legal: FloatArray


@dataclass(frozen=True)
class LegalSpeed:
    """What the map allows along the path.

    Attributes:
        arclength: (P,) m.
        velocity: (P,) m/s; ``_UNLIMITED`` where the map names none.
    """

    arclength: FloatArray
    velocity: FloatArray

    @classmethod
    def of(cls, route: Route, factor: float) -> Self:
        """Reads it from a route.

        Args:
            route: The route.
            factor: How many times the limit is taken for allowed.

        Returns:
            The allowed speed.
        """
        return cls(route.arclength, np.minimum(factor * route.speed_limit, _UNLIMITED))

    def at(self, arclength: FloatArray) -> FloatArray:
        """The allowed speed at arc lengths: that of the last point of the route before it.

        Args:
            arclength: (S,) m.

        Returns:
            (S,) m/s.
        """
        before = np.searchsorted(self.arclength, arclength, side="right") - 1
        return self.velocity[np.maximum(before, 0)]


def curve_speed(
    path: EvenPath,
    arclength: FloatArray,
    lateral_acceleration: float,
    vehicle: VehicleParameters,
    settings: SpeedSettings,
) -> FloatArray:
    """Speed at which the path's curves are taken: what tyres and the steering's rate allow.

    Args:
        path: Reference path.
        arclength: (S,) m.
        lateral_acceleration: m/s2.
        vehicle: The ego.
        settings: Over which distance the change of steering is taken, and its share.

    Returns:
        (S,) m/s.
    """
    curvature = np.maximum(np.abs(path.at(arclength)[:, PATH_CURVATURE]), _STRAIGHT)
    winding = settings.winding
    around = np.stack([path.at(arclength - winding), path.at(arclength + winding)])
    steering = np.arctan(vehicle.wheelbase * around[..., PATH_CURVATURE])
    turn = np.abs(steering[1] - steering[0]) / (2.0 * winding)
    rate = settings.steering_share * vehicle.max_steering_rate / np.maximum(turn, _STRAIGHT)
    return np.asarray(np.minimum(np.sqrt(lateral_acceleration / curvature), rate))


class SpeedPlanner:
    """Makes the reference of every cycle of an episode."""

    def __init__(
        self,
        config: MpcConfig,
        vehicle: VehicleParameters,
        path: EvenPath,
        windows: tuple[GoalWindow, ...],
        legal: LegalSpeed,
        dt: float,
    ) -> None:
        """Keeps what does not change during an episode.

        Args:
            config: Settings.
            vehicle: The ego.
            path: Reference path.
            windows: Goals along it, see ``next_goal``.
            legal: What the map allows along it.
            dt: Step, s.
        """
        self._config = config
        self._vehicle = vehicle
        self._path = path
        self._windows = windows
        self._legal = legal
        self._dt = dt
        self._steps = np.arange(config.horizon + 1)
        more = np.arange(_SPEEDS[-1] + _SPEED_STEP, vehicle.max_velocity, _SPEED_STEP)
        self._speeds = np.concatenate([_SPEEDS, more])

    def next_goal(self, ego: EgoOnPath, lost: Container[GoalWindow] = ()) -> GoalWindow | None:
        """The first goal that is neither over nor passed, nor lost where there is another.

        Args:
            ego: Where the ego is.
            lost: Goals that cannot be reached any more.

        Returns:
            Its window, or None.
        """
        # A window's end may be this much short of the region's edge.
        short = self._config.goal.edge_margin + self._config.goal.spacing
        left = [w for w in self._windows if w.last_step >= ego.step]
        left = [w for w in left if w.end + short > ego.position]
        return next((w for w in left if w not in lost), left[0] if left else None)

    def plan(
        self,
        ego: EgoOnPath,
        traffic: Traffic,
        window: GoalWindow | None,
        stop: float | None = None,
    ) -> tuple[SpeedProfile, SpeedLimit]:
        """Speed and offset: for the goal where there is one, with the traffic otherwise.

        Args:
            ego: Where the ego is.
            traffic: Speed that is wanted without the goal, and whether a follower is close.
            window: The goal that counts, or None.
            stop: Arc length at which the ego's centre has to come to stand, m, or None.

        Returns:
            The reference, and how fast the ego may be ahead in the style that was chosen.
        """
        limit, target = self._choose_style(window, ego, traffic)
        waiting = (
            window is not None
            and window.first_step > ego.step
            and target < self._config.speed.crawl
        )
        velocity = self._velocity(window, ego, limit, target, waiting)
        stopping = None if stop is None else self._stopping(ego, velocity, stop)
        stops = stopping is not None and bool(np.any(stopping < velocity))
        held = waiting or stops
        velocity = velocity if stopping is None else stopping
        arclength = self._stations(ego.position, velocity)
        weight = self._config.station_weight * (self._config.speed.waiting if held else 1.0)
        weights = np.full(len(self._steps), weight)
        comfort = limit.style.comfort
        if waiting:
            comfort = min(comfort, self._config.speed.waiting_comfort)
        if stops:
            comfort = min(comfort, self._config.utmost.comfort)
        if window is None:
            profile = _without_goal(velocity, arclength, comfort)
            return (replace(profile, station_weight=weights) if held else profile), limit
        profile = replace(
            _without_goal(velocity, arclength, comfort),
            station_weight=weights,
            offset=self._offset(window, arclength, max(ego.velocity, target)),
        )
        return self.beside_goal(profile, window, ego.step), limit

    def beside_goal(
        self, profile: SpeedProfile, window: GoalWindow | None, step: int, entry: float = 0.0
    ) -> SpeedProfile:
        """The edges and the heading that a goal asks for, where a reference is at its region.

        Args:
            profile: The reference.
            window: The goal, or None.
            step: Present step.
            entry: Time from now until which the ego is not yet on the goal's lane, s.

        Returns:
            The reference with those of the goal in place of its own.
        """
        if window is None:
            return profile
        right, left, heading, weight = self._at_goal(window, step, profile.arclength)
        there = self._dt * self._steps >= entry
        return replace(
            profile,
            right=np.where(there, right, -np.inf),
            left=np.where(there, left, np.inf),
            heading=heading,
            heading_weight=np.where(there, weight, 0.0),
        )

    def fastest(self, ego: EgoOnPath) -> float:
        """The velocity that may not be exceeded for the sake of a goal's deadline.

        Args:
            ego: Where the ego is.

        Returns:
            m/s: the speed limit where the ego is, if the limit comes first; infinite otherwise.
        """
        if not self._config.speed.limit_first:
            return np.inf
        return float(self._legal.at(np.array(ego.position)))

    def cruise_for_goal(
        self, window: GoalWindow, ego: EgoOnPath, cruise: float, limit: SpeedLimit
    ) -> tuple[bool, float]:
        """Speed that brings the ego's centre into the region within its time window.

        Driving at speed c where the limit allows it, the ego enters the region after the time
        ``t_in(c)`` and leaves it after ``t_out(c)``. Wanted is the c nearest to ``cruise`` with
        ``t_in(c) <= deadline`` and ``t_out(c) >= opening``.

        Args:
            window: The goal.
            ego: Where the ego is.
            cruise: Speed that is wanted without the goal, m/s.
            limit: Speed limit ahead.

        Returns:
            Whether the deadline can be met within the limit, and the speed, m/s.
        """
        settings = self._config.speed
        opening = (window.first_step - ego.step) * self._dt
        deadline = (window.last_step - ego.step) * self._dt
        depth = window.end - window.begin
        margin = min(settings.depth_margin, settings.depth_share * depth)
        enter = window.begin + margin - ego.position
        leave = window.end - margin - ego.position
        if deadline < 0.0:
            return True, cruise
        if leave <= 0.0:
            return True, 0.0 if opening > 0.0 else cruise
        speeds = self._speeds
        ahead = limit.arclength - limit.arclength[0]
        first, last = (
            min(int(np.searchsorted(ahead, way)), len(ahead) - 1) for way in (enter, leave)
        )
        elapsed = _elapsed(limit, ego.velocity, speeds, last + 1)
        entered, left = elapsed[:, first], elapsed[:, last]
        in_time = entered <= max(deadline - settings.deadline_reserve, 0.5 * deadline)
        not_early = np.flatnonzero(left >= opening)
        slowest = float(speeds[np.argmax(in_time)]) if in_time.any() else float(speeds[-1])
        fastest = float(speeds[not_early[-1]]) if len(not_early) else 0.0
        return bool(in_time.any()), min(max(cruise, slowest), fastest)

    def _choose_style(
        self, window: GoalWindow | None, ego: EgoOnPath, traffic: Traffic
    ) -> tuple[SpeedLimit, float]:
        """The calmest style that meets the goal: its limit, and the speed to go to, m/s.

        Where none does within the speed limit, they are tried without it.
        """
        config = self._config
        reach = max(_SHORTEST_GRID, _FASTEST * config.horizon * self._dt)
        if window is not None:
            reach = max(reach, window.end - ego.position + _BEYOND_GOAL)
        grid = ego.position + np.arange(0.0, reach, _GRID)
        allowed = self._legal.at(grid)
        free = np.full_like(allowed, _UNLIMITED)
        ways = [allowed, free] if np.any(allowed < free) else [free]
        if config.speed.limit_first:
            ways = ways[:1]
        elif traffic.pressed:
            ways = [free]
        styles = (config.calm, config.hurried, config.utmost)
        # With a follower close behind, bends are taken quicker as well.
        for legal, style in product(ways, styles[int(traffic.pressed) :]):
            limit, target = self._limit(window, grid, legal, style), traffic.cruise
            if window is None:
                break
            met, target = self.cruise_for_goal(window, ego, traffic.cruise, limit)
            if met:
                break
        return limit, target

    def _limit(
        self, window: GoalWindow | None, grid: FloatArray, legal: FloatArray, style: Style
    ) -> SpeedLimit:
        """What curves, a goal's velocity window and the map allow, with the braking before."""
        settings = self._config.speed
        limit = curve_speed(self._path, grid, style.lateral, self._vehicle, settings)
        if window is not None and window.velocity is not None:
            low, high = window.velocity
            cap = high - settings.velocity_margin * (high - low)
            limit = np.where(grid >= window.begin - _GRID, np.minimum(limit, cap), limit)
        if window is not None and window.turn:
            cap = self._turning_speed(window, style)
            limit = np.where(grid >= window.begin - settings.turning, np.minimum(limit, cap), limit)
        envelope = braking_envelope(limit**2, grid, style.longitudinal)
        legal = braking_envelope(legal**2, grid, style.longitudinal)
        return SpeedLimit(grid, envelope, style, legal)

    def _turn(self, window: GoalWindow) -> tuple[float, float]:
        """Arc lengths at which the ego begins to turn into a goal's heading, and has turned, m."""
        depth = window.end - window.begin
        turning = self._config.speed.turning
        aim = window.begin + min(0.5 * turning + 0.25 * depth, 0.6 * depth)
        return window.begin - turning, aim

    def _turning_speed(self, window: GoalWindow, style: Style) -> float:
        """Speed at which the ego turns into a goal's heading, m/s.

        The wheels are turned at a constant rate from straight on: over a way D, the heading
        changes by ``rate D^2 / (2 l_wb v)``, and the curvature grows to twice its mean.
        """
        begin, end = self._turn(window)
        way, turn = end - begin, abs(window.turn)
        rate = self._config.speed.steering_share * self._vehicle.max_steering_rate
        by_rate = 0.5 * rate * way**2 / (self._vehicle.wheelbase * turn)
        return float(min(by_rate, np.sqrt(0.5 * style.lateral * way / turn)))

    def _velocity(
        self,
        window: GoalWindow | None,
        ego: EgoOnPath,
        limit: SpeedLimit,
        target: float,
        waiting: bool,
    ) -> FloatArray:
        """(N + 1,) speed, m/s: a ramp to the target, below the limit, fast enough for the goal."""
        settings, style = self._config.speed, limit.style
        time = self._dt * self._steps
        faster = settings.run_up * style.longitudinal
        slower = self._config.utmost.longitudinal if waiting else faster
        ramp = ego.velocity + np.clip(target - ego.velocity, -slower * time, faster * time)
        arclength = self._stations(ego.position, ramp)
        velocity = np.minimum(ramp, np.interp(arclength, limit.arclength, limit.velocity))
        # Who is too fast slows down; a jump of the reference would brake hard.
        slowing = np.maximum(ego.velocity - style.longitudinal * time, 0.0)
        legal = np.interp(arclength, limit.arclength, limit.legal)
        velocity = np.minimum(velocity, np.maximum(legal, slowing))
        if window is None or window.velocity is None:
            return np.asarray(velocity)
        lowest, highest = window.velocity
        low = lowest + settings.velocity_margin * (highest - lowest)
        run_up = np.maximum(window.begin - arclength, 0.0)
        at_least = np.sqrt(np.maximum(low**2 - 2.0 * style.longitudinal * run_up, 0.0))
        if settings.limit_first:
            at_least = np.minimum(at_least, legal)
        return np.asarray(np.maximum(velocity, at_least))

    def _stopping(self, ego: EgoOnPath, velocity: FloatArray, stop: float) -> FloatArray:
        """(N + 1,) speed, m/s: no faster than given, and standing at a place.

        It brakes as calmly as the way allows: ``v^2 <= 2 a (stop - s)`` at the end of each step.
        """
        calm, hard = self._config.calm.longitudinal, self._config.utmost.longitudinal
        way = max(stop - ego.position, _SHORTEST_WAY)
        rate = float(np.clip(ego.velocity**2 / (2.0 * way), calm, hard))
        slower, gap = np.array(velocity), stop - ego.position
        change = rate * self._dt
        for k in range(1, len(slower)):
            last = slower[k - 1]
            inside = change**2 + 8.0 * rate * gap - 4.0 * change * last
            fastest = 0.5 * (np.sqrt(inside) - change) if inside > change**2 else 0.0
            slower[k] = min(slower[k], fastest)
            gap -= 0.5 * self._dt * (last + slower[k])
        return slower

    def _offset(self, window: GoalWindow, arclength: FloatArray, speed: float) -> FloatArray:
        """(N + 1,) lateral offset, m: that of the goal is taken up smoothly on the way in."""
        settings = self._config.speed
        way = max(settings.shortest_approach, settings.approach_seconds * speed)
        part = (arclength - (window.begin - way)) / (settings.approach_end * way)
        part = np.clip(part, 0.0, 1.0)
        offset = window.offset * part**2 * (3.0 - 2.0 * part)
        if window.turn == 0.0:
            return np.asarray(offset)
        # Turning at a constant rate of steering, the ego moves aside by a third of turn times way:
        # it comes from the other side.
        begin, end = self._turn(window)
        aside = np.sin(window.turn) * (end - begin) / 3.0
        done = np.clip((arclength - begin) / (end - begin), 0.0, 1.0)
        return np.asarray(offset + aside * (done**3 - 0.5) * part)

    def _at_goal(
        self, window: GoalWindow, step: int, arclength: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(N + 1,) each: right and left edge, m, heading, rad, and its weight, 1/rad2."""
        settings = self._config.speed
        inside = arclength >= window.begin - settings.early_metres
        inside &= arclength <= window.end + settings.late_metres
        inside &= step + self._steps >= window.first_step - settings.early_steps
        if window.turn:  # Before and behind that place, there need not be room for the heading.
            reach = max(settings.late_metres, 2.0 * float(np.diff(arclength).max()))
            inside &= np.abs(arclength - self._turn(window)[1]) <= reach
        heading, weight = self._path.at(arclength)[:, PATH_HEADING], np.zeros(len(self._steps))
        if window.heading is not None:
            low, high = window.heading
            margin = min(settings.heading_margin, settings.heading_share * (high - low))
            heading = np.clip(heading, low + margin, high - margin)
            weight = np.where(inside, self._config.goal_heading_weight, 0.0)
        right = np.where(inside, window.right, -np.inf)
        left = np.where(inside, window.left, np.inf)
        return right, left, heading, weight

    def _stations(self, position: float, velocity: FloatArray) -> FloatArray:
        """(N + 1,) arc lengths, m, that are reached at a velocity over time: trapezoids."""
        way = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * self._dt)
        return np.asarray(position + np.concatenate([[0.0], way]))


def _without_goal(velocity: FloatArray, arclength: FloatArray, comfort: float) -> SpeedProfile:
    zero = np.zeros(len(velocity))
    return SpeedProfile(
        velocity=velocity,
        arclength=arclength,
        station_weight=zero,
        offset=zero,
        right=np.full_like(zero, -np.inf),
        left=np.full_like(zero, np.inf),
        heading=zero,
        heading_weight=zero,
        comfort=np.full_like(zero, comfort),
    )


def _elapsed(limit: SpeedLimit, velocity: float, speeds: FloatArray, count: int) -> FloatArray:
    """(C, S) times, s, at which the ego is along the limit's grid, for each of (C,) speeds.

    For the first ``count`` places S of the grid. Speed over distance while going from v to c at a
    constant rate a is ``v^2 +- 2 a s``, up to c.
    """
    grid, speeds = limit.arclength[:count], speeds[:, None]
    middle = np.maximum(grid - grid[0] - 0.5 * _GRID, 0.0)
    energy = 2.0 * limit.style.longitudinal * middle
    faster = np.minimum(np.sqrt(velocity**2 + energy), speeds)
    slower = np.maximum(np.sqrt(np.maximum(velocity**2 - energy, 0.0)), speeds)
    speed = np.where(speeds > velocity, faster, slower)
    pace = np.diff(grid, prepend=grid[0]) / np.maximum(
        np.minimum(speed, np.minimum(limit.velocity, limit.legal)[:count]), _SPEEDS[0]
    )
    return np.asarray(np.cumsum(pace, axis=1))
