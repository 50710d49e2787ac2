"""The optimal control problem: built once per process, solved once or twice a cycle.

What a stage costs and where its limits are stands in ``stage``.

A guess is the last solution, shifted along time, or a sample; slacks of sets are made anew from it.
CasADi's interface to fatrop takes no multipliers (they were measured to change nothing), so a small
initial barrier keeps the iterate near a good guess.
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
from dosplan_mpc.stage import STATE_SIZE, input_stage, stage_size, state_stage


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
        self.stage_size = stage_size(config)
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
        drive, rate = input_stage(config, vehicle, dt), state_stage(config, vehicle)
        cost: Any = 0
        for k in range(n + 1):
            if k < n:
                reached, input_cost, input_limits = drive(states[k], inputs[k])
                g.append(states[k + 1] - reached)
                equality += [True] * STATE_SIZE
                cost += input_cost
            if k == 0:
                g.append(states[0] - start)
                equality += [True] * STATE_SIZE
            h = []
            if k > 0:
                state_cost, slack_cost, limits = rate(states[k], slacks[k], parameters[:, k])
                h.append(limits)
                cost += (2.0 if k == n else 1.0) * state_cost
                cost += slack_cost
            if k < n:
                h.append(input_limits)
            g += h
            equality += [False] * sum(part.numel() for part in h)
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
