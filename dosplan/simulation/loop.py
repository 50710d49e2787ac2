"""One closed-loop episode: observe, predict, plan, drive a step, again.

Recorded road users are replayed; the ego moves by the vehicle model. Each step the planner's
next input is cut to what the actuators can deliver and held for one step.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from dosplan.api import OraclePredictor, Planner, PluginError, Predictor
from dosplan.geometry.goal import goal_reached
from dosplan.system.errors import failure_place, one_line
from dosplan.types import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_VELOCITY,
    HISTORY_STEPS,
    USER_SIZE,
    Arm,
    Episode,
    EpisodeEnd,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    Scenario,
)


@dataclass(frozen=True)
class SimulationConfig:
    """How an episode is driven.

    Attributes:
        replan_every: Steps that are driven from each plan.
        history: Steps H of an observation, the present one included.
    """

    replan_every: int = 1
    history: int = HISTORY_STEPS

    def __post_init__(self) -> None:
        for name in ("replan_every", "history"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"SimulationConfig.{name} is {getattr(self, name)}; it must be 1 or more"
                )


class _PluginFailedError(Exception):
    """A planner or predictor raised; the message is the line that goes into the episode."""

    def __init__(self, message: str, cause: BaseException) -> None:
        super().__init__(message)
        self.cause = cause


@dataclass
class _Log:
    """What has happened so far in an episode."""

    states: list[FloatArray]
    inputs: list[FloatArray] = field(default_factory=list)
    predict_seconds: list[float] = field(default_factory=list)
    plan_seconds: list[float] = field(default_factory=list)
    plans: list[Plan] = field(default_factory=list)
    occupancies: list[Occupancy] = field(default_factory=list)
    cycle_steps: list[int] = field(default_factory=list)


def run_episode(
    scenario: Scenario,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    config: SimulationConfig = SimulationConfig(),
    on_failure: Callable[[BaseException], None] = lambda error: None,
) -> Episode:
    """Drives one scenario in closed loop.

    The episode ends at the first step at which a goal holds, at ``task.final_step``, or where
    the planner or the predictor raises. The start counts: a goal that holds there at once
    makes an episode of zero steps, as it does for CommonRoad's own goal check.

    Args:
        scenario: What to drive.
        planner: Drives the ego; ``reset`` is called here.
        predictor: Foresees the road users; ``reset`` is called here.
        arm: ``WITHOUT_DOS`` takes the sets off every prediction before the planner sees it.
        config: How the loop runs.
        on_failure: Called with what the planner or the predictor raised, traceback and all.

    Returns:
        The episode. A plug-in's exception is in ``Episode.error`` as one line
        ``"planner NAME: ExceptionType: message (file:line)"``; it is never raised.
    """
    log = _Log(states=[np.array(scenario.task.start)])
    error: str | None = None
    try:
        end = _drive(scenario, planner, predictor, arm, config, log)
    except _PluginFailedError as failure:
        end, error = EpisodeEnd.PLANNER_FAILURE, str(failure)
        on_failure(failure.cause)
    return Episode(
        scenario_id=scenario.id,
        arm=arm,
        start_step=scenario.task.start_step,
        states=np.stack(log.states),
        inputs=np.reshape(log.inputs, (-1, 2)),
        end=end,
        predict_seconds=np.array(log.predict_seconds),
        plan_seconds=np.array(log.plan_seconds),
        plans=tuple(log.plans),
        occupancies=tuple(log.occupancies),
        cycle_steps=np.array(log.cycle_steps, dtype=np.int64),
        error=error,
    )


def known_drive(scenario_id: str, arm: Arm, start_step: int, states: FloatArray) -> Episode:
    """A drive that is known by its states alone, such as a recorded one, ready to be scored.

    Args:
        scenario_id: Id of the scenario.
        arm: Arm that the row is to name.
        start_step: Step of the first state.
        states: (K + 1, 5) ego states.

    Returns:
        An episode without planning cycles and with zeros for the inputs, which nobody knows.
    """
    return Episode(
        scenario_id=scenario_id,
        arm=arm,
        start_step=start_step,
        states=states,
        inputs=np.zeros((len(states) - 1, 2)),
        end=EpisodeEnd.TIME_OVER,
        predict_seconds=np.zeros(0),
        plan_seconds=np.zeros(0),
        plans=(),
        occupancies=(),
        cycle_steps=np.zeros(0, dtype=np.int64),
    )


def observe(scenario: Scenario, step: int, driven: FloatArray, history: int) -> Observation:
    """What may be known at a step.

    Every array is a copy of the past and the present, so that the future cannot be reached
    from it, not even through ``ndarray.base``.

    Args:
        scenario: The scenario, future included.
        step: The present step.
        driven: (K + 1, 5) ego states from the start step to now.
        history: Number H of steps to show.

    Returns:
        The observation. Ego states before the start and road users before step 0 of the
        recording are NaN; past the end of the recording nobody is on the scene.
    """
    tracks = scenario.tracks
    present = (
        np.flatnonzero(tracks.valid[:, step])
        if step < tracks.steps
        else np.empty(0, dtype=np.int64)
    )
    first = max(step - history + 1, 0)
    seen = step + 1 - first
    states = np.full((len(present), history, USER_SIZE), np.nan)
    valid = np.zeros((len(present), history), dtype=np.bool_)
    if len(present):
        states[:, history - seen :] = tracks.states[present, first : step + 1]
        valid[:, history - seen :] = tracks.valid[present, first : step + 1]
    recent = driven[-history:]
    ego_history = np.full((history, EGO_SIZE), np.nan)
    ego_history[history - len(recent) :] = recent
    return Observation(
        step=step,
        dt=scenario.dt,
        ego=np.array(driven[-1]),
        ego_history=ego_history,
        ids=tracks.ids[present],
        kinds=tuple(tracks.kinds[i] for i in present),
        size=tracks.size[present],
        states=states,
        valid=valid,
        road_map=scenario.road_map,
        task=scenario.task,
    )


def _drive(
    scenario: Scenario,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    config: SimulationConfig,
    log: _Log,
) -> EpisodeEnd:
    """Drives to the end and writes into ``log``, which stays right when a plug-in raises."""
    task, vehicle = scenario.task, scenario.task.vehicle
    with _blame("predictor", predictor):
        if isinstance(predictor, OraclePredictor):
            predictor.reveal(scenario.tracks)
        predictor.reset(task, scenario.road_map)
    with _blame("planner", planner):
        planner.reset(task, scenario.road_map, vehicle)

    step = task.start_step
    pending: deque[FloatArray] = deque()
    while True:
        state = log.states[-1]
        heading, velocity = float(state[EGO_HEADING]), float(state[EGO_VELOCITY])
        if goal_reached(task.goals, step, vehicle.centre(state), heading, velocity):
            return EpisodeEnd.GOAL_REACHED
        if step >= task.final_step:
            return EpisodeEnd.TIME_OVER
        if not pending:
            wanted = min(config.replan_every, task.final_step - step)
            observation = observe(scenario, step, np.stack(log.states), config.history)
            plan = _cycle(observation, planner, predictor, arm, wanted, log)
            pending.extend(plan.inputs[:wanted])
        applied = vehicle.clip_input(state, pending.popleft(), scenario.dt)
        log.inputs.append(applied)
        log.states.append(vehicle.step(state, applied, scenario.dt))
        step += 1


def _cycle(
    observation: Observation,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    wanted: int,
    log: _Log,
) -> Plan:
    """One prediction and one plan with at least ``wanted`` inputs."""
    with _blame("predictor", predictor):
        occupancy = predictor.predict(observation)
    if arm is Arm.WITHOUT_DOS:
        occupancy = occupancy.without_sets()
    with _blame("planner", planner):
        plan = planner.plan(observation, occupancy)
        if len(plan.inputs) < wanted:
            raise PluginError(
                f"the plan holds {len(plan.inputs)} inputs, but {wanted} steps are driven "
                "from it; plan further or lower replan_every"
            )
    log.predict_seconds.append(predictor.last_seconds)
    log.plan_seconds.append(planner.last_seconds)
    log.plans.append(plan)
    log.occupancies.append(occupancy)
    log.cycle_steps.append(observation.step)
    return plan


@contextmanager
def _blame(role: str, plugin: Planner | Predictor) -> Iterator[None]:
    """Turns whatever a plug-in raises into one line that names it and the place."""
    try:
        yield
    except (Exception, SystemExit) as error:
        name = getattr(plugin, "name", type(plugin).__name__)
        place = failure_place(error, type(plugin))
        raise _PluginFailedError(f"{role} {name}: {one_line(error)} ({place})", error) from error
