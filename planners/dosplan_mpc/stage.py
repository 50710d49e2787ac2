"""A stage of the optimal control problem: its parameters, its costs, its limits.

Model: kinematic single track of ``dosplan.vehicle`` in the scenario frame, with the previous
acceleration as a sixth state ``x = (x, y, delta, v, psi, a_prev)``, inputs ``(delta', a)``,
Runge-Kutta 4 from one stage to the next, which is a step later or two, with the inputs held.

Cost at stages 1 .. K (weights of ``MpcConfig``, for each step that a stage stands for; the last
step counts double): offset from the reference path, heading error, velocity error, steering other
than the path's curvature asks for, and on the way to a goal the error of the station and of the
goal's heading;
at stages 0 .. K-1: steering rate, acceleration, jerk. The reference of a stage is a frozen
parabola ``(x, y, psi, kappa)`` of the path at the guess's arc length: cheaper than a
curvilinear model, and sets keep their shape.

Limits at stages 1 .. K, with slacks that are inputs of the stage:

* Sets: for slot j and covering disc i, ``(z1^4 + z2^4 + eps)^(1/4) >= 1 - s_j`` with
  ``z = M_j (p_i - c_j)``: the disc's centre stays out of a superellipse (see ``obstacles``).
  Every slot has a slack of its own: with one slack for all, a set that cannot be left would
  loosen the others. Penalty: that of the set times ``s_j`` (exact) plus a small square.
* Road: in five parts of its length, from the rear to the front bumper, both sides of the ego stay
  off the edges of the road: ``left - (e + w) >= -r`` and ``(e - w) - right >= -r``, slack r. The
  edges are those of the drivable area as the guess sees them (see ``road``).

Hard limits: the friction circle ``a^2 + (v psi')^2 <= (grip a_max)^2`` and engine power
``a v <= a_max v_s`` at stages 0 .. K-1, and the bounds of steering and velocity, of steering rate
and acceleration, which the problem sets.

Not modelled: tyre slip, actuator delay, reversing.

``input_stage`` and ``state_stage`` are CasADi functions, which are put into the problem stage by
stage: that is much quicker than to write every stage out in Python.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, PATH_SIZE, PATH_X, PATH_Y
from dosplan.types import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_STEERING,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    FloatArray,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.limits import discomfort, grip, half_width
from dosplan_mpc.shape import STATIONS, disc_offsets

PREVIOUS_ACCELERATION: Final = EGO_SIZE
STATE_SIZE: Final = EGO_SIZE + 1
STEERING_RATE: Final = 0
ACCELERATION: Final = 1
INPUT_SIZE: Final = 2


class Reference(NamedTuple):
    """What a stage's costs refer to: arrays for all stages, or CasADi's expressions for one.

    Attributes:
        path: (..., 4) x, y, m, heading, rad, and curvature, 1/m, of the path beside the guess.
        velocity: (...) m/s.
        offset: (...) lateral offset from the path, m.
        station: (...) way along the path from that point to where the ego's rear axle should be, m.
        station_weight: (...) 1/m2.
        heading: (...) heading that a goal asks for, rad.
        heading_weight: (...) 1/rad2.
        comfort: (...) share of what jerk and uncomfortable accelerations cost that counts.
    """

    path: Any
    velocity: Any
    offset: Any
    station: Any
    station_weight: Any
    heading: Any
    heading_weight: Any
    comfort: Any


class Edge(NamedTuple):
    """What bounds a part of the ego to one side: a point of its axis stays off a line.

    Attributes:
        line: (..., 4) x, y, m, heading, rad, and curvature, 1/m, of the line.
        bound: (...) offset from the line that half of the ego's width beside the point may reach,
            m, left positive.
        ahead: (...) the point of the axis, m ahead of the rear axle.
    """

    line: Any
    bound: Any
    ahead: Any


class Station(NamedTuple):
    """The road beside a part of the ego's length.

    Attributes:
        right: Its right edge.
        left: Its left edge.
    """

    right: Edge
    left: Edge


class Slot(NamedTuple):
    """A forbidden set: ``z1^4 + z2^4 < 1`` with ``z = M (p - c)``.

    Attributes:
        centre: (..., 2) c, m.
        first_row: (..., 2) of M, 1/m.
        second_row: (..., 2) of M, 1/m.
        penalty: (...) penalty on a unit of normalised distance inside the set.
    """

    centre: Any
    first_row: Any
    second_row: Any
    penalty: Any


# Number of parameters of each part, in their order; both sides are made from these.
_REFERENCE: Final = Reference(
    path=PATH_SIZE,
    velocity=1,
    offset=1,
    station=1,
    station_weight=1,
    heading=1,
    heading_weight=1,
    comfort=1,
)
_EDGE: Final = Edge(line=PATH_SIZE, bound=1, ahead=1)
_SLOT: Final = Slot(centre=2, first_row=2, second_row=2, penalty=1)

EMPTY_SLOT: Final = Slot(
    centre=(1e4, 1e4), first_row=(0.1, 0.0), second_row=(0.0, 0.1), penalty=1.0
)
"""A set that no plan can reach."""

_Parts = TypeVar("_Parts", Reference, Edge, Slot)
_PAIRS: Final = range(0, 2 * STATIONS, 2)
_Axis = Callable[[Any], tuple[Any, Any]]


@dataclass(frozen=True)
class StageParameters:
    """Parameters of all stages by name.

    Attributes:
        reference: Arrays that begin with (K + 1).
        stations: Arrays that begin with (K + 1, STATIONS), from the rear to the front bumper.
        slots: Arrays that begin with (K + 1, M).
    """

    reference: Reference
    stations: Station
    slots: Slot

    def pack(self) -> FloatArray:
        """(K + 1, ``stage_size``) the parameters as the problem takes them."""
        reference = _pack(self.reference, _REFERENCE)
        count = len(reference)
        stations = np.concatenate([_pack(edge, _EDGE) for edge in self.stations], axis=-1)
        slots = _pack(self.slots, _SLOT).reshape(count, -1)
        return np.concatenate([reference, stations.reshape(count, -1), slots], axis=1)


def stage_size(config: MpcConfig) -> int:
    """Number of parameters of a stage.

    Args:
        config: Settings.

    Returns:
        Their number: the reference's, the stations' and the slots'.
    """
    size: int = sum(_REFERENCE) + 2 * STATIONS * sum(_EDGE) + config.slots * sum(_SLOT)
    return size


def _pack(parts: _Parts, sizes: _Parts) -> FloatArray:
    """Parts side by side along the last axis."""
    columns = [
        np.asarray(part)[..., None] if size == 1 else np.asarray(part)
        for part, size in zip(parts, sizes, strict=True)
    ]
    return np.concatenate(columns, axis=-1)


def _unpack(vector: Any, sizes: _Parts) -> _Parts:
    """The parts of a CasADi vector, by the names of ``sizes``."""
    ends = accumulate(sizes)
    parts = (vector[end - size : end] for end, size in zip(ends, sizes, strict=True))
    return type(sizes)(*parts)


def unpack_stage(p: Any, slots: int) -> tuple[Reference, list[Station], list[Slot]]:
    """Names the parts of one stage's parameters: the inverse of ``StageParameters.pack``.

    Args:
        p: CasADi vector of the parameters.
        slots: Number of slots M.

    Returns:
        The reference, the stations and the slots.
    """
    sizes = [sum(_REFERENCE), *[sum(_EDGE)] * (2 * STATIONS), *[sum(_SLOT)] * slots]
    reference, *more = (
        p[end - size : end] for end, size in zip(accumulate(sizes), sizes, strict=True)
    )
    return (
        _unpack(reference, _REFERENCE),
        [Station(*(_unpack(part, _EDGE) for part in more[i : i + 2])) for i in _PAIRS],
        [_unpack(part, _SLOT) for part in more[2 * STATIONS :]],
    )


def input_stage(config: MpcConfig, vehicle: VehicleParameters, dt: float) -> Any:
    """What a state and an input lead to and cost.

    Args:
        config: Settings.
        vehicle: The ego.
        dt: Time to the next stage, s.

    Returns:
        A CasADi function of state (6), input (2) and the stage's parameters: next state (6), cost,
        limits as ``h >= 0``.
    """
    x, u = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", INPUT_SIZE)
    p = ca.SX.sym("p", stage_size(config))
    reference, _, _ = unpack_stage(p, config.slots)
    limits = ca.vertcat(*_input_constraints(config, vehicle, x, u))
    cost = _input_cost(config, vehicle, x, u, dt, reference.comfort)
    return ca.Function("input_stage", [x, u, p], [_transition(vehicle, x, u, dt), cost, limits])


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
    set_slack, road_slack = slack[: config.slots], slack[config.slots]
    reference, stations, slots = unpack_stage(p, config.slots)
    penalties = ca.vertcat(ca.SX(0, 1), *(slot.penalty for slot in slots))
    price = ca.dot(penalties, set_slack) + config.road_penalty * road_slack
    price += 0.5 * config.slack_curvature * ca.sumsqr(slack)
    axis, (discs, _) = _axis(x), disc_offsets(vehicle, config.discs)
    limits = ca.vertcat(
        *_set_constraints(axis, discs, set_slack, slots, config.norm_rounding),
        *_road_constraints(axis, road_slack, stations, half_width(config, vehicle)),
    )
    result = [_state_cost(config, vehicle, x, reference), price, limits]
    return ca.Function("state_stage", [x, slack, p], result)


def _transition(vehicle: VehicleParameters, x: Any, u: Any, dt: float) -> Any:
    """One Runge-Kutta step; the acceleration becomes the previous one."""

    def derivative(state: Any) -> Any:
        delta, v, psi = state[EGO_STEERING], state[EGO_VELOCITY], state[EGO_HEADING]
        return ca.vertcat(
            v * ca.cos(psi),
            v * ca.sin(psi),
            u[STEERING_RATE],
            u[ACCELERATION],
            v * ca.tan(delta) / vehicle.wheelbase,
        )

    s = x[:EGO_SIZE]
    k1 = derivative(s)
    k2 = derivative(s + 0.5 * dt * k1)
    k3 = derivative(s + 0.5 * dt * k2)
    k4 = derivative(s + dt * k3)
    return ca.vertcat(s + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), u[ACCELERATION])


def _local(x: Any, y: Any, path: Any) -> tuple[Any, Any]:
    """Way along a frozen parabola's tangent, and offset from the parabola."""
    dx, dy = x - path[PATH_X], y - path[PATH_Y]
    cos, sin = ca.cos(path[PATH_HEADING]), ca.sin(path[PATH_HEADING])
    along = cos * dx + sin * dy
    return along, -sin * dx + cos * dy - 0.5 * path[PATH_CURVATURE] * along**2


def _state_cost(config: MpcConfig, vehicle: VehicleParameters, x: Any, reference: Reference) -> Any:
    path = reference.path
    along, offset = _local(x[EGO_X], x[EGO_Y], path)
    heading = path[PATH_HEADING] + path[PATH_CURVATURE] * along
    path_steering = ca.atan(vehicle.wheelbase * path[PATH_CURVATURE])
    return 0.5 * (
        config.lateral_weight * (offset - reference.offset) ** 2
        + config.heading_weight * (x[EGO_HEADING] - heading) ** 2
        + config.velocity_weight * (x[EGO_VELOCITY] - reference.velocity) ** 2
        + config.steering_weight * (x[EGO_STEERING] - path_steering) ** 2
        + reference.station_weight * (along - reference.station) ** 2
        + reference.heading_weight * (x[EGO_HEADING] - reference.heading) ** 2
    )


def _input_cost(
    config: MpcConfig, vehicle: VehicleParameters, x: Any, u: Any, dt: float, comfort: Any
) -> Any:
    acceleration, lateral = u[ACCELERATION], _lateral_acceleration(vehicle, x)
    return 0.5 * (
        config.steering_rate_weight * u[STEERING_RATE] ** 2
        + config.acceleration_weight * acceleration**2
        + comfort * config.jerk_weight * ((acceleration - x[PREVIOUS_ACCELERATION]) / dt) ** 2
        + discomfort(config.comfort, acceleration, lateral, comfort, ca.fmax)
    )


def _lateral_acceleration(vehicle: VehicleParameters, x: Any) -> Any:
    return x[EGO_VELOCITY] ** 2 * ca.tan(x[EGO_STEERING]) / vehicle.wheelbase


def _input_constraints(config: MpcConfig, vehicle: VehicleParameters, x: Any, u: Any) -> list[Any]:
    """Friction circle and engine power, both as ``h >= 0`` and of the order of one."""
    velocity, acceleration = x[EGO_VELOCITY], u[ACCELERATION]
    lateral = _lateral_acceleration(vehicle, x)
    return [
        1.0 - (acceleration**2 + lateral**2) / grip(config, vehicle) ** 2,
        1.0 - acceleration * velocity / vehicle.engine_power,
    ]


def _axis(x: Any) -> _Axis:
    """Makes a function from a distance ahead of the rear axle, m, to coordinates on the axis, m."""
    cos, sin = ca.cos(x[EGO_HEADING]), ca.sin(x[EGO_HEADING])
    return lambda ahead: (x[EGO_X] + ahead * cos, x[EGO_Y] + ahead * sin)


def _set_constraints(
    axis: _Axis, discs: FloatArray, slack: Any, slots: list[Slot], rounding: float
) -> list[Any]:
    """Every disc outside of every set, as ``h >= 0``."""
    h = []
    for j, slot in enumerate(slots):
        for ahead in discs:
            x, y = axis(ahead)
            dx, dy = x - slot.centre[0], y - slot.centre[1]
            z1 = slot.first_row[0] * dx + slot.first_row[1] * dy
            z2 = slot.second_row[0] * dx + slot.second_row[1] * dy
            h.append(ca.sqrt(ca.sqrt(z1**4 + z2**4 + rounding)) - 1.0 + slack[j])
    return h


def _road_constraints(axis: _Axis, slack: Any, stations: list[Station], half: float) -> list[Any]:
    """Both sides of the ego off the road's edges, as ``h >= 0``."""
    h = []
    for right, left in stations:
        _, offset = _local(*axis(left.ahead), left.line)
        h.append(left.bound - offset - half + slack)
        _, offset = _local(*axis(right.ahead), right.line)
        h.append(offset - half - right.bound + slack)
    return h
