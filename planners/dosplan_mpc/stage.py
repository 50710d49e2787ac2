"""A stage of the optimal control problem: its parameters, its costs, its limits.

Model: kinematic single track of ``dosplan.vehicle`` in the scenario frame, with the previous
acceleration as a sixth state ``x = (x, y, delta, v, psi, a_prev)``, inputs ``(delta', a)``,
Runge-Kutta 4 over a step with the inputs held.

Cost at stages 1 .. N (weights of ``MpcConfig``; the last stage counts double): offset from the
reference path, heading error, velocity error, steering other than the path's curvature asks for,
and on the way to a goal the error of the station and of the goal's heading;
at stages 0 .. N-1: steering rate, acceleration, jerk. The reference of a stage is a frozen
parabola ``(x, y, psi, kappa)`` of the path at the guess's arc length: cheaper than a
curvilinear model and it distorts no set.

Limits at stages 1 .. N, with slacks that are inputs of the stage:

* Sets: for slot j and covering disc i, ``(z1^4 + z2^4 + eps)^(1/4) >= 1 - s_j`` with
  ``z = M_j (p_i - c_j)``: the disc's centre stays out of a superellipse (see ``obstacles``).
  Every slot has a slack of its own: with one slack for all, a set that cannot be left would
  loosen the others. Penalty: that of the set times ``s_j`` (exact) plus a small square.
* Road: at five stations from the rear to the front bumper, both sides of the ego stay between the
  corridor's edges: ``left - (e + w) >= -r`` and ``(e - w) - right >= -r``, slack r.

Hard limits: the friction circle ``a^2 + (v psi')^2 <= (grip a_max)^2`` and engine power
``a v <= a_max v_s`` at stages 0 .. N-1, and the bounds of steering and velocity, of steering rate
and acceleration, which the problem sets.

Not modelled: tyre slip, actuator delay, reversing.

``input_stage`` and ``state_stage`` are CasADi functions, which are put into the problem stage by
stage: that is much quicker than to write every stage out in Python.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.shape import STATIONS, disc_offsets, station_offsets

STATE_SIZE = 6
STATION_SIZE = 6  # x, y, psi, kappa of the path beside the station; right and left edge.
SLOT_SIZE = 7  # Centre x, y, the rows of M and the penalty of a forbidden set.
# x, y, psi, kappa of the path; reference velocity and offset; way from the path's point to the
# reference station, m, and its weight; heading to be had at the goal, rad, and its weight.
REFERENCE_SIZE = 10
STAGE_HEAD = REFERENCE_SIZE + STATIONS * STATION_SIZE
EMPTY_SLOT = (1e4, 1e4, 0.1, 0.0, 0.0, 0.1, 1.0)  # A set no plan can reach.

_NORM_EPS = 1e-4  # Rounds the norm's tip, where it has no derivative.
_SLACK_CURVATURE = 1e-2  # Keeps the problem strictly convex in the slacks.


def stage_size(config: MpcConfig) -> int:
    """Number of parameters of a stage.

    Args:
        config: Settings.

    Returns:
        Their number: the reference's, the stations' and the slots'.
    """
    return STAGE_HEAD + SLOT_SIZE * config.slots


def input_stage(config: MpcConfig, vehicle: VehicleParameters, dt: float) -> Any:
    """What a state and an input lead to and cost.

    Args:
        config: Settings.
        vehicle: The ego.
        dt: Step, s.

    Returns:
        A CasADi function of state (6) and input (2): next state (6), cost, limits as ``h >= 0``.
    """
    x, u = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", 2)
    limits = ca.vertcat(*_input_constraints(config, vehicle, x, u))
    result = [_transition(vehicle, x, u, dt), _input_cost(config, x, u, dt), limits]
    return ca.Function("input_stage", [x, u], result)


def state_stage(config: MpcConfig, vehicle: VehicleParameters) -> Any:
    """What a state costs and where it may be.

    Args:
        config: Settings.
        vehicle: The ego.

    Returns:
        A CasADi function of state (6), slacks (M + 1: the sets', the road's) and the stage's
        parameters: cost of the state, cost of the slacks, limits as ``h >= 0``, those of the sets
        (M times discs) before those of the road.
    """
    x, p = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("p", stage_size(config))
    slack = ca.SX.sym("s", config.slots + 1)
    limits = ca.vertcat(*_path_constraints(config, vehicle, x, slack, p))
    penalties = p[STAGE_HEAD + SLOT_SIZE - 1 :: SLOT_SIZE]
    price = ca.dot(penalties, slack[: config.slots]) + config.road_penalty * slack[config.slots]
    price += 0.5 * _SLACK_CURVATURE * ca.sumsqr(slack)
    result = [_state_cost(config, vehicle, x, p), price, limits]
    return ca.Function("state_stage", [x, slack, p], result)


def _transition(vehicle: VehicleParameters, x: Any, u: Any, dt: float) -> Any:
    """One Runge-Kutta step; the acceleration becomes ``a_prev``."""

    def derivative(state: Any) -> Any:
        delta, v, psi = state[2], state[3], state[4]
        return ca.vertcat(
            v * ca.cos(psi), v * ca.sin(psi), u[0], u[1], v * ca.tan(delta) / vehicle.wheelbase
        )

    s = x[:5]
    k1 = derivative(s)
    k2 = derivative(s + 0.5 * dt * k1)
    k3 = derivative(s + 0.5 * dt * k2)
    k4 = derivative(s + dt * k3)
    return ca.vertcat(s + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), u[1])


def _local(x: Any, y: Any, frame: Any) -> tuple[Any, Any]:
    """Way along a frozen parabola's tangent, and offset from the parabola."""
    dx, dy = x - frame[0], y - frame[1]
    cos, sin = ca.cos(frame[2]), ca.sin(frame[2])
    along = cos * dx + sin * dy
    return along, -sin * dx + cos * dy - 0.5 * frame[3] * along**2


def _state_cost(config: MpcConfig, vehicle: VehicleParameters, x: Any, p: Any) -> Any:
    along, offset = _local(x[0], x[1], p[:4])
    heading = p[2] + p[3] * along
    path_steering = ca.atan(vehicle.wheelbase * p[3])
    return 0.5 * (
        config.lateral_weight * (offset - p[5]) ** 2
        + config.heading_weight * (x[4] - heading) ** 2
        + config.velocity_weight * (x[3] - p[4]) ** 2
        + config.steering_weight * (x[2] - path_steering) ** 2
        + p[7] * (along - p[6]) ** 2
        + p[9] * (x[4] - p[8]) ** 2
    )


def _input_cost(config: MpcConfig, x: Any, u: Any, dt: float) -> Any:
    return 0.5 * (
        config.steering_rate_weight * u[0] ** 2
        + config.acceleration_weight * u[1] ** 2
        + config.jerk_weight * ((u[1] - x[5]) / dt) ** 2
    )


def _input_constraints(config: MpcConfig, vehicle: VehicleParameters, x: Any, u: Any) -> list[Any]:
    """Friction circle and engine power, both as ``h >= 0`` and of the order of one."""
    limit = config.grip * vehicle.max_acceleration
    lateral = x[3] ** 2 * ca.tan(x[2]) / vehicle.wheelbase
    power = vehicle.max_acceleration * vehicle.switching_velocity
    return [1.0 - (u[1] ** 2 + lateral**2) / limit**2, 1.0 - u[1] * x[3] / power]


def _path_constraints(
    config: MpcConfig, vehicle: VehicleParameters, x: Any, slack: Any, p: Any
) -> list[Any]:
    """Sets and road edges of a stage as ``h >= 0``."""
    cos, sin = ca.cos(x[4]), ca.sin(x[4])
    h = []
    offsets, _ = disc_offsets(vehicle, config.discs)
    for j in range(config.slots):
        slot = p[STAGE_HEAD + SLOT_SIZE * j : STAGE_HEAD + SLOT_SIZE * (j + 1)]
        for ahead in offsets:
            dx, dy = x[0] + ahead * cos - slot[0], x[1] + ahead * sin - slot[1]
            z1 = slot[2] * dx + slot[3] * dy
            z2 = slot[4] * dx + slot[5] * dy
            h.append(ca.sqrt(ca.sqrt(z1**4 + z2**4 + _NORM_EPS)) - 1.0 + slack[j])
    half = vehicle.width / 2.0 + config.road_margin
    for i, ahead in enumerate(station_offsets(vehicle)):
        begin = REFERENCE_SIZE + STATION_SIZE * i
        frame = p[begin : begin + STATION_SIZE]
        _, offset = _local(x[0] + ahead * cos, x[1] + ahead * sin, frame)
        h.append(frame[5] - offset - half + slack[config.slots])
        h.append(offset - half - frame[4] + slack[config.slots])
    return h
