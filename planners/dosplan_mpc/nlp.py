"""The optimal control problem: built once per process, solved once or twice a cycle.

Model: kinematic single track of ``dosplan.vehicle`` in the scenario frame, with the previous
acceleration as a sixth state ``x = (x, y, delta, v, psi, a_prev)``, inputs ``(delta', a)``,
Runge-Kutta 4 over a step with the inputs held.

Cost at stages 1 .. N (weights of ``MpcConfig``; the last stage counts double): offset from the
reference path, heading error, velocity error, steering other than the path's curvature asks for,
and on the way to a goal the error of the station and of the goal's heading;
at stages 0 .. N-1: steering rate, acceleration, jerk. The reference of a stage is a frozen
parabola ``(x, y, psi, kappa)`` of the path at the warm start's arc length: cheaper than a
curvilinear model and it distorts no set.

Constraints at stages 1 .. N, with slacks that are inputs of the stage:

* Sets: for slot j and covering disc i, ``(z1^4 + z2^4 + eps)^(1/4) >= 1 - s_j`` with
  ``z = M_j (p_i - c_j)``: the disc's centre stays out of a superellipse (see ``obstacles``).
  Every slot has a slack of its own: with one slack for all, a set that cannot be left would
  loosen the others. Penalty: that of the set times ``s_j`` (exact) plus a small square.
* Road: at five stations from the rear to the front bumper, both sides of the ego stay between the
  corridor's edges: ``left - (e + w) >= -r`` and ``(e - w) - right >= -r``, slack r.
* Friction circle ``a^2 + (v psi')^2 <= (grip a_max)^2`` and engine power ``a v <= a_max v_s`` are
  hard, and so are the bounds of steering, steering rate and velocity.

Warm start: states and inputs of the last solution, shifted along time. CasADi's interface to
fatrop takes no multipliers (they were measured to change nothing), so a small initial barrier
keeps the iterate near a good guess.

Not modelled: tyre slip, actuator delay, reversing.
"""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from dosplan.types import BoolArray, FloatArray, IntArray, SolveStatus
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.compiled import Formulation
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


@dataclass(frozen=True)
class Guess:
    """Where the solver begins.

    Attributes:
        states: (N + 1, 6).
        inputs: (N, 2).
        road_slack: (N,).
        arclength: (N + 1,) where the rear axle is along the reference path, m.
    """

    states: FloatArray
    inputs: FloatArray
    road_slack: FloatArray
    arclength: FloatArray


@dataclass(frozen=True)
class Solution:
    """What the solver found.

    Attributes:
        states: (N + 1, 6).
        inputs: (N, 2).
        set_slack: (N, M) slacks of stages 1 .. N.
        road_slack: (N,).
        cost: Value of the objective.
        residual: Largest violation of a constraint; infinite where the iterate is not finite.
        status: What the solver said.
        iterations: Number of iterations.
        seconds: Wall-clock time, s.
    """

    states: FloatArray
    inputs: FloatArray
    set_slack: FloatArray
    road_slack: FloatArray
    cost: float
    residual: float
    status: SolveStatus
    iterations: int
    seconds: float

    @property
    def usable(self) -> bool:
        """Whether the iterate may be driven."""
        return self.status in (SolveStatus.SOLVED, SolveStatus.ACCEPTED)


class MpcProblem:
    """The problem's graph, its solver and the layout of their vectors."""

    def __init__(self, config: MpcConfig, vehicle: VehicleParameters, dt: float) -> None:
        """Builds graph and solver (about half a second).

        Args:
            config: Settings.
            vehicle: The ego.
            dt: Step, s.
        """
        self.config = config
        self.stage_size = STAGE_HEAD + SLOT_SIZE * config.slots
        n, m = config.horizon, config.slots
        w: list[Any] = []
        lower: list[float] = []
        upper: list[float] = []
        g: list[Any] = []
        equality: list[bool] = []
        offset = 0
        states, inputs, slacks = [], [], []
        indices_x, indices_u, indices_s = [], [], []
        x_bound = [np.inf, np.inf, vehicle.max_steering, vehicle.max_velocity, np.inf, np.inf]
        x_floor = [-np.inf, -np.inf, -vehicle.max_steering, 0.0, -np.inf, -np.inf]
        u_bound = [vehicle.max_steering_rate, vehicle.max_acceleration]
        for k in range(n + 1):
            x = ca.SX.sym(f"x{k}", STATE_SIZE)
            u = ca.SX.sym(f"u{k}", 2 if k < n else 0)
            s = ca.SX.sym(f"s{k}", m + 1 if k > 0 else 0)
            states.append(x)
            inputs.append(u)
            slacks.append(s)
            w += [x, u, s]
            indices_x.append(np.arange(offset, offset + STATE_SIZE))
            offset += STATE_SIZE
            lower += x_floor if k else [-np.inf] * STATE_SIZE
            upper += x_bound if k else [np.inf] * STATE_SIZE
            if k < n:
                indices_u.append(np.arange(offset, offset + 2))
                offset += 2
                lower += [-bound for bound in u_bound]
                upper += u_bound
            if k:
                indices_s.append(np.arange(offset, offset + m + 1))
                offset += m + 1
                lower += [0.0] * (m + 1)
                upper += [np.inf] * (m + 1)
        parameters = ca.SX.sym("P", self.stage_size, n + 1)
        start = ca.SX.sym("start", STATE_SIZE)
        step = _transition(vehicle, dt)
        cost: Any = 0
        for k in range(n + 1):
            if k < n:
                g.append(states[k + 1] - step(states[k], inputs[k]))
                equality += [True] * STATE_SIZE
                cost += _input_cost(config, states[k], inputs[k], dt)
            if k == 0:
                g.append(states[0] - start)
                equality += [True] * STATE_SIZE
            h = []
            if k > 0:
                h += _path_constraints(config, vehicle, states[k], slacks[k], parameters[:, k])
                weight = 2.0 if k == n else 1.0
                cost += weight * _state_cost(config, vehicle, states[k], parameters[:, k])
                penalties = parameters[STAGE_HEAD + SLOT_SIZE - 1 :: SLOT_SIZE, k]
                cost += ca.dot(penalties, slacks[k][:m])
                cost += config.road_penalty * slacks[k][m]
                cost += 0.5 * _SLACK_CURVATURE * ca.sumsqr(slacks[k])
            if k < n:
                h += _input_constraints(config, vehicle, states[k], inputs[k])
            g += h
            equality += [False] * len(h)
        self.variables = offset
        self._lower, self._upper = np.array(lower), np.array(upper)
        self._equality: BoolArray = np.array(equality)
        self._g_upper = np.where(self._equality, 0.0, np.inf)
        self._x: IntArray = np.array(indices_x)
        self._u: IntArray = np.array(indices_u)
        self._s: IntArray = np.array(indices_s)
        decision, residual = ca.vertcat(*w), ca.vertcat(*g)
        parameter = ca.vertcat(start, ca.vec(parameters))
        nlp = {"x": decision, "p": parameter, "f": cost, "g": residual}
        options: dict[str, Any] = {
            "structure_detection": "auto",
            "equality": equality,
            "print_time": False,
            "error_on_fail": False,
            "fatrop": {
                "print_level": 0,
                "tolerance": config.tolerance,
                "mu_init": 1e-3,
                "max_iter": config.max_iterations,
            },
        }
        self.formulation = Formulation(nlp, options)
        self._solver = self.formulation.solver()

    def solve(
        self, start: FloatArray, stages: FloatArray, guess: Guess, set_slack: FloatArray
    ) -> Solution:
        """Solves the problem from a guess.

        Args:
            start: (6,) present state and previous acceleration.
            stages: (N + 1, stage_size) parameters of the stages.
            guess: Where to begin.
            set_slack: (N, M) slacks of the sets to begin with.

        Returns:
            The solution; failure is a status, not an exception.
        """
        point = np.zeros(self.variables)
        point[self._x] = guess.states
        point[self._u] = guess.inputs
        point[self._s[:, :-1]] = set_slack
        point[self._s[:, -1]] = guess.road_slack
        parameter = np.concatenate([start, stages.ravel()])
        if not (np.all(np.isfinite(parameter)) and np.all(np.isfinite(point))):
            return self._failed(guess, set_slack, 0.0)  # fatrop would search for a step for ever.
        began = time.perf_counter()
        try:
            result = self._solver(
                x0=point,
                p=parameter,
                lbx=self._lower,
                ubx=self._upper,
                lbg=0.0,
                ubg=self._g_upper,
            )
        except RuntimeError:  # CasADi's way of saying that an evaluation failed.
            return self._failed(guess, set_slack, time.perf_counter() - began)
        seconds = time.perf_counter() - began
        stats = self._solver.stats()
        values = np.asarray(result["x"]).ravel()
        if not np.all(np.isfinite(values)):
            return self._failed(guess, set_slack, seconds)
        g = np.asarray(result["g"]).ravel()
        residual = float(
            max(
                np.max(np.where(self._equality, np.abs(g), -g)),
                np.max(self._lower - values),
                np.max(values - self._upper),
            )
        )
        if residual > self.config.accept_residual:
            status = SolveStatus.MAX_ITERATIONS
        else:
            status = SolveStatus.SOLVED if stats["success"] else SolveStatus.ACCEPTED
        slack = values[self._s]
        return Solution(
            states=values[self._x],
            inputs=values[self._u],
            set_slack=slack[:, :-1],
            road_slack=slack[:, -1],
            cost=float(result["f"]),
            residual=residual,
            status=status,
            iterations=int(stats["iter_count"]),
            seconds=seconds,
        )

    @staticmethod
    def _failed(guess: Guess, set_slack: FloatArray, seconds: float) -> Solution:
        return Solution(
            states=guess.states,
            inputs=guess.inputs,
            set_slack=set_slack,
            road_slack=guess.road_slack,
            cost=np.inf,
            residual=np.inf,
            status=SolveStatus.SOLVER_ERROR,
            iterations=0,
            seconds=seconds,
        )


@functools.lru_cache(maxsize=8)
def problem(config: MpcConfig, vehicle: VehicleParameters, dt: float) -> MpcProblem:
    """The problem for these settings, built at the first call in a process.

    Args:
        config: Settings.
        vehicle: The ego.
        dt: Step, s.

    Returns:
        The shared problem.
    """
    return MpcProblem(config, vehicle, dt)


def problems(config: MpcConfig, vehicle: VehicleParameters, dt: float) -> tuple[MpcProblem, ...]:
    """The problem for few, more and all of the road users: few of them are solved quicker.

    Args:
        config: Settings.
        vehicle: The ego.
        dt: Step, s.

    Returns:
        The shared problems by increasing number of slots.
    """
    sizes = sorted({config.slots // 4, config.slots // 2, config.slots})
    return tuple(problem(replace(config, slots=slots), vehicle, dt) for slots in sizes)


def _transition(vehicle: VehicleParameters, dt: float) -> Any:
    """``x_{k+1} = F(x_k, u_k)``: one Runge-Kutta step; the acceleration becomes ``a_prev``."""
    x, u = ca.SX.sym("x", STATE_SIZE), ca.SX.sym("u", 2)

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
    after = s + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return ca.Function("step", [x, u], [ca.vertcat(after, u[1])])


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
