"""The optimal control problem: built once per process, solved once or twice a cycle.

The costs and limits of a stage are in ``stage``. The first stages follow one another by a step, the
later ones by two: what is further ahead will be planned again before it is driven, and a problem is
solved the quicker the fewer stages it has. Guesses and solutions have every step; what the stages
are told is made for the steps of ``stage_steps`` alone.

A guess is the last solution, shifted in time, or a sample; slacks of sets are computed from it.
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

from dosplan.types import (
    EGO_SIZE,
    EGO_STEERING,
    EGO_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    SolveStatus,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.compiled import Formulation
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.stage import (
    ACCELERATION,
    INPUT_SIZE,
    PREVIOUS_ACCELERATION,
    STATE_SIZE,
    StageParameters,
    input_stage,
    stage_size,
    state_stage,
)


@dataclass(frozen=True)
class Guess:
    """Initial guess of the solver.

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
        set_slack: (K, M) slacks of the sets at stages 1 .. K.
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
        """Whether the iterate is good enough to be driven."""
        return self.status in (SolveStatus.SOLVED, SolveStatus.ACCEPTED)


def stage_steps(config: MpcConfig) -> IntArray:
    """At which steps the stages of the problem are.

    Args:
        config: Settings.

    Returns:
        (K + 1,) increasing, from 0 to N: each step at first, then every other one.
    """
    n, fine = config.horizon, min(config.fine_steps, config.horizon)
    return np.array([*range(fine), *range(fine, n, 2), n], dtype=np.int64)


class _Variables:
    """Where states, inputs and slacks are in the vector of decisions, and their bounds.

    fatrop needs them stage by stage: state, input (none at the last stage), slacks (none at the
    first). ``casadi.Opti`` is not used because it makes its solver itself and takes no compiled
    library, nor is ``casadi.tools.struct_symSX``, which would give the first stage slacks.

    Attributes:
        count: Number of decisions.
        states: (K + 1, 6) indices.
        inputs: (K, 2) indices.
        slacks: (K, M + 1) indices of the slacks of stages 1 .. K: those of the sets, the road's.
        lower: (count,) lower bounds.
        upper: (count,) upper bounds.
    """

    def __init__(self, config: MpcConfig, vehicle: VehicleParameters) -> None:
        last = len(stage_steps(config)) - 1
        sizes = [
            (STATE_SIZE, INPUT_SIZE if k < last else 0, config.slots + 1 if k > 0 else 0)
            for k in range(last + 1)
        ]
        ends = np.cumsum(np.ravel(sizes))
        blocks = np.split(np.arange(ends[-1]), ends[:-1])
        self.count = int(ends[-1])
        self.states: IntArray = np.stack(blocks[0::3])
        self.inputs: IntArray = np.stack(blocks[1::3][:-1])
        self.slacks: IntArray = np.stack(blocks[2::3][1:])
        self.lower: FloatArray = np.full(self.count, -np.inf)
        self.upper: FloatArray = np.full(self.count, np.inf)
        # The first state has no bounds: an equation gives it.
        steering, velocity = self.states[1:, EGO_STEERING], self.states[1:, EGO_VELOCITY]
        self.lower[steering], self.upper[steering] = -vehicle.max_steering, vehicle.max_steering
        self.lower[velocity], self.upper[velocity] = 0.0, vehicle.max_velocity
        most = np.array([vehicle.max_steering_rate, vehicle.max_acceleration])
        self.lower[self.inputs], self.upper[self.inputs] = -most, most
        self.lower[self.slacks] = 0.0


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
        self._vehicle = vehicle
        self._dt = dt
        self._steps = stage_steps(config)
        self._spans = np.diff(self._steps)
        self._variables = _Variables(config, vehicle)
        graph, equality = _graph(config, vehicle, dt)
        self._equality: BoolArray = np.array(equality)
        self._g_upper = np.where(self._equality, 0.0, np.inf)
        options: dict[str, Any] = {
            "structure_detection": "auto",
            "equality": equality,
            "print_time": False,
            "error_on_fail": False,
            "fatrop": {
                "print_level": 0,
                "tolerance": config.tolerance,
                "mu_init": config.initial_barrier,
                "max_iter": config.max_iterations,
            },
        }
        self.formulation = Formulation(graph, options)
        self._solver = self.formulation.solver()

    def solve(
        self, start: FloatArray, stages: StageParameters, guess: Guess, set_slack: FloatArray
    ) -> Solution:
        """Solves the problem from a guess.

        Args:
            start: (6,) present state and previous acceleration.
            stages: Parameters of the K + 1 stages, with M slots.
            guess: Where to begin.
            set_slack: (K, M) slacks of the sets to begin with.

        Returns:
            The solution; failure is a status, not an exception.
        """
        variables, steps = self._variables, self._steps
        point = np.zeros(variables.count)
        point[variables.states] = guess.states[steps]
        held = np.add.reduceat(guess.inputs, steps[:-1], axis=0)
        point[variables.inputs] = held / self._spans[:, None]
        point[variables.slacks] = np.column_stack([set_slack, guess.road_slack[steps[1:] - 1]])
        parameter = np.concatenate([start, stages.pack().ravel()])
        if not (np.all(np.isfinite(parameter)) and np.all(np.isfinite(point))):
            return self._failed(guess, set_slack, 0.0)  # fatrop would never return.
        began = time.perf_counter()
        try:
            result = self._solver(
                x0=point,
                p=parameter,
                lbx=variables.lower,
                ubx=variables.upper,
                lbg=0.0,
                ubg=self._g_upper,
            )
        except RuntimeError:  # CasADi raises it where an evaluation failed.
            return self._failed(guess, set_slack, time.perf_counter() - began)
        seconds = time.perf_counter() - began
        values = np.asarray(result["x"]).ravel()
        if not np.all(np.isfinite(values)):
            return self._failed(guess, set_slack, seconds)
        stats = self._solver.stats()
        residual = self._residual(values, np.asarray(result["g"]).ravel())
        if residual > self.config.accept_residual:
            status = SolveStatus.MAX_ITERATIONS
        else:
            status = SolveStatus.SOLVED if stats["success"] else SolveStatus.ACCEPTED
        slack = values[variables.slacks]
        states, inputs = self._every_step(values[variables.states], values[variables.inputs])
        return Solution(
            states=states,
            inputs=inputs,
            set_slack=slack[:, :-1],
            road_slack=np.repeat(slack[:, -1], self._spans),
            cost=float(result["f"]),
            residual=residual,
            status=status,
            iterations=int(stats["iter_count"]),
            seconds=seconds,
        )

    def _every_step(self, states: FloatArray, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N + 1, 6) states and (N, 2) inputs at all steps, from those of the stages."""
        found = np.empty((self.config.horizon + 1, STATE_SIZE))
        found[self._steps] = states
        wide = np.flatnonzero(self._spans > 1)
        between = self._steps[wide] + 1
        found[between, :EGO_SIZE] = self._vehicle.step(
            states[wide, :EGO_SIZE], inputs[wide], self._dt
        )
        found[between, PREVIOUS_ACCELERATION] = inputs[wide, ACCELERATION]
        return found, np.repeat(inputs, self._spans, axis=0)

    def _residual(self, values: FloatArray, g: FloatArray) -> float:
        """Largest violation of a constraint or a bound."""
        return float(
            max(
                np.max(np.where(self._equality, np.abs(g), -g)),
                np.max(self._variables.lower - values),
                np.max(values - self._variables.upper),
            )
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


def _graph(
    config: MpcConfig, vehicle: VehicleParameters, dt: float
) -> tuple[dict[str, Any], list[bool]]:
    """The problem's expressions, and for each constraint whether it is an equation.

    Constraints come stage by stage: the next state, then the limits of the stage. A stage costs as
    many times as much as it stands for steps.
    """
    spans = np.diff(stage_steps(config)).tolist()
    last = len(spans)
    states = [ca.SX.sym(f"x{k}", STATE_SIZE) for k in range(last + 1)]
    inputs = [ca.SX.sym(f"u{k}", INPUT_SIZE) for k in range(last)]
    slacks = [ca.SX.sym(f"s{k}", config.slots + 1) for k in range(1, last + 1)]
    parameters = ca.SX.sym("P", stage_size(config), last + 1)
    start = ca.SX.sym("start", STATE_SIZE)
    drives = {span: input_stage(config, vehicle, span * dt) for span in sorted(set(spans))}
    rate = state_stage(config, vehicle)
    decisions: list[Any] = []
    equations: list[tuple[Any, bool]] = []
    cost: Any = 0
    for k, x in enumerate(states):
        decisions.append(x)
        input_limits = []
        if k < last:
            decisions.append(inputs[k])
            reached, input_cost, limits = drives[spans[k]](x, inputs[k], parameters[:, k])
            equations.append((states[k + 1] - reached, True))
            input_limits.append(limits)
            cost += spans[k] * input_cost
        if k == 0:
            equations.append((x - start, True))
        else:
            slack = slacks[k - 1]
            decisions.append(slack)
            state_cost, slack_cost, limits = rate(x, slack, parameters[:, k])
            equations.append((limits, False))
            # The last step counts double.
            cost += (spans[k - 1] + (1.0 if k == last else 0.0)) * state_cost
            cost += spans[k - 1] * slack_cost
        equations += [(limits, False) for limits in input_limits]
    graph = {
        "x": ca.vertcat(*decisions),
        "p": ca.vertcat(start, ca.vec(parameters)),
        "f": cost,
        "g": ca.vertcat(*(residual for residual, _ in equations)),
    }
    return graph, [equal for residual, equal in equations for _ in range(residual.numel())]


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
    sizes = sorted({-(-config.slots * part // 3) for part in (1, 2, 3)})
    return tuple(problem(replace(config, slots=slots), vehicle, dt) for slots in sizes)
