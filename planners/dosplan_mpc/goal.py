"""Where along the reference path a goal lies, and the speed profile that meets it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from dosplan.geometry import (
    PATH_CURVATURE,
    PATH_HEADING,
    PATH_X,
    PATH_Y,
    EvenPath,
    braking_envelope,
    wrap_angle,
)
from dosplan.types import FloatArray, GoalState, PlanningTask
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig, Style
from dosplan_mpc.traffic import Traffic

_SAMPLING = 0.25  # m along the path.
_EDGE = 0.2  # m that are kept from the goal region's edge.
_OFFSETS = np.arange(-12.0, 12.01, 0.1)  # Lateral offsets that are searched for the region, m.
_SPEEDS = np.concatenate([np.linspace(0.05, 12.0, 80), np.linspace(12.25, 45.0, 132)])  # m/s
_RUN_UP = 1.4  # The reference accelerates faster than it is reckoned with: the plan lags behind.
_WINDING = 1.5  # m to both sides over which the change of steering is taken.
_STEERING_SHARE = 1.0  # Share of the steering's rate that the reference speed asks for.
_AIM = 0.06  # rad that are kept from the edge of a goal's heading window.
_TURN = 0.3  # rad by which the path may miss that window; the ego turns towards it.
_SHORT = _EDGE + _SAMPLING  # m by which a window's end may be short of the region's edge.
_CRAWL = 1.0  # m/s below which whoever is too early for a goal waits for it.
_WAITING = 20.0  # Times a station counts for more while waiting: past the region's end is too far.
_LATE = 0.3  # s of reserve before the deadline.


@dataclass(frozen=True)
class GoalWindow:
    """A goal in the path's coordinates, for the ego's centre.

    Attributes:
        first_step: First step at which it counts.
        last_step: Last step at which it counts.
        begin: Arc length at which the region begins, m.
        end: Arc length at which it ends, m.
        offset: Lateral offset to drive at there, m.
        right: Right edge of the region beside the path, m.
        left: Left edge, m.
        heading: Heading window on the path's turn, rad, or None.
        velocity: Velocity window, m/s, or None.
    """

    first_step: int
    last_step: int
    begin: float
    end: float
    offset: float
    right: float
    left: float
    heading: tuple[float, float] | None
    velocity: tuple[float, float] | None


def locate_goals(
    task: PlanningTask, path: EvenPath, farthest: float = np.inf
) -> tuple[GoalWindow, ...]:
    """Finds the goals that have a region along the path.

    Args:
        task: The planning task.
        path: Its reference path.
        farthest: Arc length up to which the ego's centre may go, m.

    Returns:
        A window for each goal state with a region that lies beside the path.
    """
    windows = (_locate(goal, path) for goal in task.goals)
    return tuple(
        replace(window, end=max(min(window.end, farthest), window.begin))
        for window in windows
        if window is not None
    )


def _locate(goal: GoalState, path: EvenPath) -> GoalWindow | None:
    if goal.region is None:
        return None
    s = np.arange(0.0, path.length, _SAMPLING)
    rows = path.at(s)
    region = goal.region.buffer(-_EDGE)
    if region.is_empty:
        region = goal.region
    near = shapely.dwithin(region, shapely.points(rows[:, :2]), float(_OFFSETS[-1]))
    if goal.heading is not None:
        middle = 0.5 * (goal.heading[0] + goal.heading[1])
        half = 0.5 * (goal.heading[1] - goal.heading[0])
        near &= np.abs(wrap_angle(rows[:, PATH_HEADING] - middle)) <= half + _TURN
    index = np.flatnonzero(near)
    if len(index) == 0:
        return None
    x = rows[index, PATH_X, None] - np.sin(rows[index, PATH_HEADING, None]) * _OFFSETS
    y = rows[index, PATH_Y, None] + np.cos(rows[index, PATH_HEADING, None]) * _OFFSETS
    inside = shapely.contains_xy(region, x, y)
    touched = inside.any(axis=1)
    if not touched.any():
        return None
    first = int(np.argmax(touched))
    stretch = touched[first:]
    last = first + (int(np.argmin(stretch)) if not stretch.all() else len(stretch)) - 1
    # The lateral window is taken from the middle half: a region's corners are narrow.
    quarter = (last - first) // 4
    rows_inside = inside[first + quarter : last - quarter + 1]
    share = rows_inside.mean(axis=0)
    common = share > 0.9 * share.max()
    nearest = int(np.argmin(np.where(common, np.abs(_OFFSETS), np.inf)))
    low = high = nearest
    while low > 0 and common[low - 1]:
        low -= 1
    while high < len(_OFFSETS) - 1 and common[high + 1]:
        high += 1
    right, left = float(_OFFSETS[low]), float(_OFFSETS[high])
    offset = float(
        np.clip(0.0, min(right + 0.5, 0.5 * (right + left)), max(left - 0.5, 0.5 * (right + left)))
    )
    column = int(np.argmin(np.abs(_OFFSETS - offset)))
    along = np.flatnonzero(
        inside[:, column] & (np.arange(len(index)) >= first) & (np.arange(len(index)) <= last)
    )
    begin = index[along[0]]
    heading = None
    if goal.heading is not None:
        path_heading = rows[begin, PATH_HEADING]
        middle = path_heading - float(wrap_angle(path_heading - 0.5 * sum(goal.heading)))
        half = 0.5 * (goal.heading[1] - goal.heading[0])
        heading = (middle - half, middle + half)
    return GoalWindow(
        first_step=goal.first_step,
        last_step=goal.last_step,
        begin=float(s[begin]),
        end=float(s[index[along[-1]]]),
        offset=offset,
        right=right,
        left=left,
        heading=heading,
        velocity=goal.velocity,
    )


def curve_speed(
    path: EvenPath, s: FloatArray, lateral_acceleration: float, vehicle: VehicleParameters
) -> FloatArray:
    """Speed at which the path's curves are taken: what tyres and the steering's rate allow.

    Args:
        path: Reference path.
        s: (S,) arc lengths, m.
        lateral_acceleration: m/s2.
        vehicle: The ego.

    Returns:
        (S,) m/s.
    """
    curvature = np.maximum(np.abs(path.at(s)[:, PATH_CURVATURE]), 1e-3)
    before, after = path.at(s - _WINDING), path.at(s + _WINDING)
    steering = np.arctan(vehicle.wheelbase * np.stack([before, after])[..., PATH_CURVATURE])
    turn = np.abs(steering[1] - steering[0]) / (2.0 * _WINDING)
    rate = _STEERING_SHARE * vehicle.max_steering_rate / np.maximum(turn, 1e-3)
    return np.asarray(np.minimum(np.sqrt(lateral_acceleration / curvature), rate))


def cruise_for_goal(
    window: GoalWindow,
    step: int,
    dt: float,
    position: float,
    velocity: float,
    cruise: float,
    grid: FloatArray,
    limit: FloatArray,
    acceleration: float,
) -> tuple[bool, float]:
    """Speed that brings the ego's centre into the region within its time window.

    Driving at speed c where the limit allows it, the ego enters the region after the time
    ``t_in(c)`` and leaves it after ``t_out(c)``. Wanted is the c nearest to ``cruise`` with
    ``t_in(c) <= deadline`` and ``t_out(c) >= opening``.

    Args:
        window: The goal.
        step: Present step.
        dt: Step, s.
        position: Arc length of the ego's centre, m.
        velocity: Its velocity, m/s.
        cruise: Speed that is wanted but for the goal, m/s.
        grid: (S,) arc lengths ahead, beginning at ``position``, m.
        limit: (S,) speed limit along the grid, m/s.
        acceleration: Rate at which the speed is changed, m/s2.

    Returns:
        Whether the deadline can be met within the limit, and the speed, m/s.
    """
    opening = (window.first_step - step) * dt
    deadline = (window.last_step - step) * dt
    depth = window.end - window.begin
    enter = window.begin + min(1.0, 0.3 * depth) - position
    leave = window.end - min(1.0, 0.3 * depth) - position
    if deadline < 0.0:
        return True, cruise
    if leave <= 0.0:
        return True, 0.0 if opening > 0.0 else cruise
    # Speed over distance while going from v to c at a constant rate: v^2 +- 2 a s, up to c.
    middle = np.maximum(grid - grid[0] - 0.5 * (grid[1] - grid[0]), 0.0)
    energy = 2.0 * acceleration * middle
    faster = np.minimum(np.sqrt(velocity**2 + energy), _SPEEDS[:, None])
    slower = np.maximum(np.sqrt(np.maximum(velocity**2 - energy, 0.0)), _SPEEDS[:, None])
    speed = np.where(_SPEEDS[:, None] > velocity, faster, slower)
    pace = np.diff(grid, prepend=grid[0]) / np.maximum(np.minimum(speed, limit), _SPEEDS[0])
    elapsed = np.cumsum(pace, axis=1)

    def time_to(distance: float) -> FloatArray:
        column = min(int(np.searchsorted(grid - grid[0], distance)), len(grid) - 1)
        return np.asarray(elapsed[:, column])

    in_time = time_to(enter) <= max(deadline - _LATE, 0.5 * deadline)
    not_early = time_to(leave) >= opening
    slowest = float(_SPEEDS[np.argmax(in_time)]) if in_time.any() else float(_SPEEDS[-1])
    early = np.flatnonzero(not_early)
    fastest = float(_SPEEDS[early[-1]]) if len(early) else 0.0
    return bool(in_time.any()), min(max(cruise, slowest), fastest)


@dataclass(frozen=True)
class SpeedProfile:
    """Reference of the next steps.

    Attributes:
        velocity: (N + 1,) m/s.
        offset: (N + 1,) lateral offset from the path, m.
        right: (N + 1,) right edge that a goal asks the ego's centre to keep, m; -inf without one.
        left: (N + 1,) left edge, m; inf without one.
        arclength: (N + 1,) where the ego's centre is at that speed, m.
        station_weight: (N + 1,) what being elsewhere costs, 1/m2.
        heading: (N + 1,) heading that a goal asks for, rad.
        heading_weight: (N + 1,) what another heading costs, 1/rad2.
    """

    velocity: FloatArray
    offset: FloatArray
    right: FloatArray
    left: FloatArray
    arclength: FloatArray
    station_weight: FloatArray
    heading: FloatArray
    heading_weight: FloatArray


def _speed_limit(
    path: EvenPath,
    window: GoalWindow | None,
    grid: FloatArray,
    style: Style,
    vehicle: VehicleParameters,
) -> FloatArray:
    """Speed that curves and a goal's velocity window allow, with the braking before them."""
    limit = curve_speed(path, grid, style.lateral, vehicle)
    if window is not None and window.velocity is not None:
        low, high = window.velocity
        cap = high - 0.15 * (high - low)
        limit = np.where(grid >= window.begin - 1.0, np.minimum(limit, cap), limit)
    return braking_envelope(limit**2, grid, style.longitudinal)


def plan_speed(
    path: EvenPath,
    windows: tuple[GoalWindow, ...],
    step: int,
    dt: float,
    position: float,
    velocity: float,
    traffic: Traffic,
    config: MpcConfig,
    vehicle: VehicleParameters,
) -> SpeedProfile:
    """Reference speed and offset: for the goal where there is one, with the traffic otherwise.

    Args:
        path: Reference path.
        windows: Goals along it; the first that can still be met counts.
        step: Present step.
        dt: Step, s.
        position: Arc length of the ego's centre, m.
        velocity: Its velocity, m/s.
        traffic: Speed that is wanted but for the goal, and whether a follower presses.
        config: Settings: horizon, styles of driving and the weights of a goal.
        vehicle: The ego.

    Returns:
        The profile.
    """
    window = next((w for w in windows if w.last_step >= step and w.end + _SHORT > position), None)
    reach = max(60.0, 45.0 * config.horizon * dt, (window.end - position + 5.0) if window else 0.0)
    grid = position + np.arange(0.0, reach, 1.0)
    horizon = config.horizon
    # Whoever is followed closely does not dawdle in bends either.
    for style in (config.calm, config.hurried, config.utmost)[int(traffic.pressed) :]:
        limit, target = _speed_limit(path, window, grid, style, vehicle), traffic.cruise
        if window is None:
            break
        met, target = cruise_for_goal(
            window, step, dt, position, velocity, traffic.cruise, grid, limit, style.longitudinal
        )
        if met:
            break
    time = dt * np.arange(horizon + 1)
    rate = _RUN_UP * style.longitudinal
    waiting = window is not None and window.first_step > step and target < _CRAWL
    slower = config.utmost.longitudinal if waiting else rate
    ramp = velocity + np.clip(target - velocity, -slower * time, rate * time)
    s = _stations(position, ramp, dt)
    reference = np.minimum(ramp, np.interp(s, grid, limit))
    if window is not None and window.velocity is not None:
        low = window.velocity[0] + 0.15 * (window.velocity[1] - window.velocity[0])
        run_up = np.maximum(window.begin - s, 0.0)
        reference = np.maximum(
            reference, np.sqrt(np.maximum(low**2 - 2.0 * style.longitudinal * run_up, 0.0))
        )
    s = _stations(position, reference, dt)
    zero = np.zeros(horizon + 1)
    if window is None:
        return SpeedProfile(reference, zero, zero - np.inf, zero + np.inf, s, zero, zero, zero)
    # The offset is taken up on the way in, over about three seconds of driving.
    way = max(10.0, 3.0 * max(velocity, target))
    part = np.clip((s - (window.begin - way)) / (0.8 * way), 0.0, 1.0)
    offset = window.offset * part**2 * (3.0 - 2.0 * part)
    inside = (s >= window.begin - 2.0) & (s <= window.end + 1.0)
    inside &= step + np.arange(horizon + 1) >= window.first_step - 5
    heading, asked = path.at(s)[:, PATH_HEADING], inside & (window.heading is not None)
    if window.heading is not None:
        low, high = window.heading
        aim = min(_AIM, 0.3 * (high - low))
        heading = np.clip(heading, low + aim, high - aim)
    return SpeedProfile(
        reference,
        offset,
        np.where(inside, window.right, -np.inf),
        np.where(inside, window.left, np.inf),
        s,
        np.full(horizon + 1, config.station_weight * (_WAITING if waiting else 1.0)),
        heading,
        np.where(asked, config.goal_heading_weight, 0.0),
    )


def _stations(position: float, velocity: FloatArray, dt: float) -> FloatArray:
    """Arc lengths, m, that are reached at a velocity over time: trapezoids."""
    way = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt)
    return np.asarray(position + np.concatenate([[0.0], way]))
