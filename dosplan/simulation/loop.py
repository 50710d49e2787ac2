"""One closed-loop episode: observe, predict, plan, drive a step, again.

The ego moves by the vehicle model, the other road users by the traffic. At each step the
planner's next input is cut to what the actuators can deliver and held for one step.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

import numpy as np

from dosplan.api import OraclePredictor, Planner, PluginError, Predictor
from dosplan.geometry.goal import goal_reached
from dosplan.simulation.traffic import Replay, Traffic, empty_tracks
from dosplan.simulation.world import World
from dosplan.system.errors import failure_place, one_line
from dosplan.types import (
    EGO_HEADING,
    EGO_VELOCITY,
    HISTORY_STEPS,
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
    """A planner, predictor or traffic raised; the message is the line for the episode."""

    def __init__(self, message: str, cause: BaseException) -> None:
        super().__init__(message)
        self.cause = cause


@dataclass
class _Log:
    """The planning cycles of an episode so far."""

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
    traffic: Traffic | None = None,
    on_failure: Callable[[BaseException], None] = lambda error: None,
) -> Episode:
    """Drives one scenario in closed loop.

    The episode ends at the first step at which a goal holds, at ``task.final_step``, or where
    the planner, the predictor or the traffic raises. The start counts: a goal that holds there at
    once makes an episode of zero steps, as it does for CommonRoad's own goal check.

    Args:
        scenario: What to drive.
        planner: Drives the ego; ``reset`` is called here.
        predictor: Predicts the road users; ``reset`` is called here.
        arm: ``WITHOUT_DOS`` sets the semi-axes of every prediction to zero before it is planned.
        config: How the loop runs.
        traffic: Moves the other road users; a replay of the recording by default.
        on_failure: Called with what a plug-in raised, traceback and all.

    Returns:
        The episode. A plug-in's exception is in ``Episode.error`` as one line
        ``"planner NAME: ExceptionType: message (file:line)"``; it is never raised.
    """
    traffic = Replay() if traffic is None else traffic
    log = _Log()
    world: World | None = None
    error: str | None = None
    try:
        with _closed_at_the_end(traffic):
            with _named_failure("traffic", traffic):
                world = World(scenario, traffic, history=config.history)
            end = _drive(world, planner, predictor, arm, config, log)
    except _PluginFailedError as failure:
        end, error = EpisodeEnd.PLANNER_FAILURE, str(failure)
        on_failure(failure.cause)
    return Episode(
        scenario_id=scenario.id,
        arm=arm,
        start_step=scenario.task.start_step,
        states=scenario.task.start[None] if world is None else world.driven,
        inputs=np.empty((0, 2)) if world is None else world.inputs,
        tracks=empty_tracks(scenario.task.start_step + 1) if world is None else world.tracks,
        end=end,
        predict_seconds=np.array(log.predict_seconds),
        plan_seconds=np.array(log.plan_seconds),
        plans=tuple(log.plans),
        occupancies=tuple(log.occupancies),
        cycle_steps=np.array(log.cycle_steps, dtype=np.int64),
        error=error,
        traffic=traffic.name,
        future=traffic.future,
        signals=None if world is None else world.signals,
    )


def known_drive(scenario: Scenario, arm: Arm, start_step: int, states: FloatArray) -> Episode:
    """A drive that is known by its states alone, such as a recorded one, ready to be scored.

    Args:
        scenario: The scenario, whose recorded road users the drive met.
        arm: Arm that the row is to name.
        start_step: Step of the first state.
        states: (K + 1, 5) ego states.

    Returns:
        An episode without planning cycles and with zeros for the inputs, which are not known.
    """
    return Episode(
        scenario_id=scenario.id,
        arm=arm,
        start_step=start_step,
        states=states,
        inputs=np.zeros((len(states) - 1, 2)),
        tracks=scenario.tracks,
        end=EpisodeEnd.TIME_OVER,
        predict_seconds=np.zeros(0),
        plan_seconds=np.zeros(0),
        plans=(),
        occupancies=(),
        cycle_steps=np.zeros(0, dtype=np.int64),
    )


def _drive(
    world: World,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    config: SimulationConfig,
    log: _Log,
) -> EpisodeEnd:
    """Drives to the end; world and ``log`` stay right when a plug-in raises."""
    scenario, task = world.scenario, world.scenario.task
    with _named_failure("predictor", predictor):
        if isinstance(predictor, OraclePredictor):
            if not world.traffic.as_recorded:
                raise PluginError(
                    f"it is shown the recording, which the traffic {world.traffic.name} departs "
                    "from; choose another predictor, or the traffic replay"
                )
            predictor.reveal(scenario.tracks)
        predictor.reset(task, scenario.road_map)
    with _named_failure("planner", planner):
        planner.reset(task, scenario.road_map, task.vehicle)

    pending: deque[FloatArray] = deque()
    while True:
        state = world.ego
        heading, velocity = float(state[EGO_HEADING]), float(state[EGO_VELOCITY])
        if goal_reached(task.goals, world.now, task.vehicle.centre(state), heading, velocity):
            return EpisodeEnd.GOAL_REACHED
        if world.now >= task.final_step:
            return EpisodeEnd.TIME_OVER
        if not pending:
            wanted = min(config.replan_every, task.final_step - world.now)
            plan = _cycle(world.observation(), planner, predictor, arm, wanted, log)
            pending.extend(plan.inputs[:wanted])
        with _named_failure("traffic", world.traffic):
            world.step(pending.popleft())


def _cycle(
    observation: Observation,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    wanted: int,
    log: _Log,
) -> Plan:
    """One prediction and one plan with at least ``wanted`` inputs."""
    with _named_failure("predictor", predictor):
        occupancy = predictor.predict(observation)
    if arm is Arm.WITHOUT_DOS:
        occupancy = occupancy.without_sets()
    with _named_failure("planner", planner):
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
def _closed_at_the_end(traffic: Traffic) -> Iterator[None]:
    """Closes the traffic, however the episode ends; of two failures the first is reported."""
    try:
        yield
    except BaseException:
        with suppress(Exception):
            traffic.close()
        raise
    with _named_failure("traffic", traffic):
        traffic.close()


@contextmanager
def _named_failure(role: str, plugin: Planner | Predictor | Traffic) -> Iterator[None]:
    """Turns any exception of a plug-in into one line that names the plug-in and the place."""
    try:
        yield
    except (Exception, SystemExit) as error:
        name = getattr(plugin, "name", type(plugin).__name__)
        place = failure_place(error, type(plugin))
        raise _PluginFailedError(f"{role} {name}: {one_line(error)} ({place})", error) from error
