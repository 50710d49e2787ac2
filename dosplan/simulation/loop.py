"""One closed-loop episode: observe, predict, plan, drive a step, again.

The ego moves by the vehicle model, the other road users by the traffic. At each step the
planner's next input is cut to what the actuators can deliver and held for one step; where they
lag, a controller follows the plan's states instead (``tracking``). How often the ego plans, how
late its plans act and what it sees is the loop's (``LoopSettings``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np

from dosplan.api import OraclePredictor, Planner, PluginError, Predictor
from dosplan.geometry.goal import goal_reached
from dosplan.simulation.settings import IDEAL, LoopSettings, loop_name
from dosplan.simulation.tracking import Command
from dosplan.simulation.traffic import Replay, Traffic, empty_tracks
from dosplan.simulation.world import World
from dosplan.system.errors import failure_place, one_line
from dosplan.types import (
    EGO_HEADING,
    EGO_VELOCITY,
    USER_SIZE,
    Arm,
    Episode,
    EpisodeEnd,
    FloatArray,
    IntArray,
    Observation,
    Occupancy,
    Plan,
    Scenario,
    Sightings,
)


class _PluginFailedError(Exception):
    """A planner, predictor or traffic raised; the message is the line for the episode."""

    def __init__(self, message: str, end: EpisodeEnd, cause: BaseException) -> None:
        super().__init__(message)
        self.end = end
        self.cause = cause


@dataclass(frozen=True)
class _Cycle:
    """A planning cycle: what was seen of whom, and what was made of it.

    The plan begins at the step ``acts``.
    """

    seen_step: int
    seen_ids: IntArray
    seen_states: FloatArray
    acts: int
    occupancy: Occupancy
    plan: Plan
    predict_seconds: float
    plan_seconds: float

    @property
    def seconds(self) -> float:
        return self.predict_seconds + self.plan_seconds


def run_episode(
    scenario: Scenario,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    loop: LoopSettings = IDEAL,
    traffic: Traffic | None = None,
    on_failure: Callable[[BaseException], None] = lambda error: None,
) -> Episode:
    """Drives one scenario in closed loop.

    The episode ends at the first step at which a goal holds, at ``task.final_step``, or where
    the planner, the predictor or the traffic raises; what a traffic raises is a failure of its own
    and not the planner's. The start counts: a goal that holds there at
    once makes an episode of zero steps, as it does for CommonRoad's own goal check.

    In a loop with a latency, a plan is made of what was seen at a step and acts from a later one
    on; the plan before acts until then. The planner gets the ego's state at that later step, which
    follows from the commands that are on their way. The first plan acts at once: the ego is under
    way when the episode begins, and nothing that was seen before is known.

    Args:
        scenario: What to drive.
        planner: Drives the ego; ``reset`` is called here.
        predictor: Predicts the road users; ``reset`` is called here.
        arm: ``WITHOUT_DOS`` sets the semi-axes of every prediction to zero before it is planned.
        loop: How often, how late and of what the ego plans.
        traffic: Moves the other road users; a replay of the recording by default. Its seed and its
            future are those of the errors of what the ego sees, too.
        on_failure: Called with what a plug-in raised, traceback and all.

    Returns:
        The episode. A plug-in's exception is in ``Episode.error`` as one line
        ``"planner NAME: ExceptionType: message (file:line)"``, or ``predictor`` or ``traffic``; it
        is never raised.
    """
    traffic = Replay() if traffic is None else traffic
    log: list[_Cycle] = []
    world: World | None = None
    error: str | None = None
    try:
        with _closed_at_the_end(traffic):
            with _named_failure("traffic", traffic):
                world = World(scenario, traffic, loop=loop)
            end = _drive(world, planner, predictor, arm, loop, log)
    except _PluginFailedError as failure:
        end, error = failure.end, str(failure)
        on_failure(failure.cause)
    last = scenario.task.start_step if world is None else world.now
    cycles = [cycle for cycle in log if cycle.acts <= last]  # The others are of later.
    return Episode(
        scenario_id=scenario.id,
        arm=arm,
        start_step=scenario.task.start_step,
        states=scenario.task.start[None] if world is None else world.driven,
        inputs=np.empty((0, 2)) if world is None else world.inputs,
        tracks=empty_tracks(scenario.task.start_step + 1) if world is None else world.tracks,
        end=end,
        predict_seconds=np.array([cycle.predict_seconds for cycle in cycles]),
        plan_seconds=np.array([cycle.plan_seconds for cycle in cycles]),
        plans=tuple(cycle.plan for cycle in cycles),
        occupancies=tuple(cycle.occupancy for cycle in cycles),
        cycle_steps=np.array([cycle.acts for cycle in cycles], dtype=np.int64),
        error=error,
        traffic=traffic.name,
        future=traffic.future,
        signals=None if world is None else world.signals,
        loop=loop_name(loop),
        sightings=None if loop.sensing.exact and not loop.late else _sightings(cycles),
    )


def known_drive(
    scenario: Scenario, arm: Arm, start_step: int, states: FloatArray, future: int = 0
) -> Episode:
    """A drive that is known by its states alone, such as a recorded one, ready to be scored.

    Args:
        scenario: The scenario, whose recorded road users the drive met.
        arm: Arm that the row is to name.
        start_step: Step of the first state.
        states: (K + 1, 5) ego states.
        future: The recorded future that the drive met.

    Returns:
        An episode without planning cycles and with zeros for the inputs, which are not known.
    """
    return Episode(
        scenario_id=scenario.id,
        arm=arm,
        start_step=start_step,
        states=states,
        inputs=np.zeros((len(states) - 1, 2)),
        tracks=scenario.recorded(future),
        future=future,
        end=EpisodeEnd.TIME_OVER,
        predict_seconds=np.zeros(0),
        plan_seconds=np.zeros(0),
        plans=(),
        occupancies=(),
        cycle_steps=np.zeros(0, dtype=np.int64),
    )


def _sightings(cycles: Sequence[_Cycle]) -> Sightings:
    """What the plans of an episode were made from."""
    return Sightings(
        steps=np.array([cycle.seen_step for cycle in cycles], dtype=np.int64),
        cycle=np.repeat(np.arange(len(cycles)), [len(cycle.seen_ids) for cycle in cycles]),
        ids=np.concatenate([np.empty(0, dtype=np.int64), *(cycle.seen_ids for cycle in cycles)]),
        states=np.concatenate([np.empty((0, USER_SIZE)), *(c.seen_states for c in cycles)]),
    )


def _drive(
    world: World,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
    loop: LoopSettings,
    log: list[_Cycle],
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
            predictor.reveal(scenario.recorded(world.traffic.future))
        predictor.reset(task, scenario.road_map)
    with _named_failure("planner", planner):
        planner.reset(task, scenario.road_map, task.vehicle)

    period, latency = loop.period_steps, loop.latency_steps
    coming: list[Command] = []  # Commands from now on, as the plans so far have it.
    look = world.now  # Step of the next observation.
    while True:
        state = world.ego
        heading, velocity = float(state[EGO_HEADING]), float(state[EGO_VELOCITY])
        if goal_reached(task.goals, world.now, task.vehicle.centre(state), heading, velocity):
            return EpisodeEnd.GOAL_REACHED
        if world.now >= task.final_step:
            return EpisodeEnd.TIME_OVER
        delay, left = latency if log else 0, task.final_step - world.now
        if world.now == look and delay < left:
            cycle = _cycle(world, coming[:delay], latency, planner, predictor, arm)
            busy = math.ceil(cycle.seconds / scenario.dt) if loop.real_time and log else 0
            look += period * max(math.ceil(busy / period), 1)
            until = coming[: delay + busy]
            with _named_failure("planner", planner):
                _check_lasting(until, cycle, busy, min(look - world.now + latency, left))
            coming = [*until, *world.commands(cycle.plan)[busy:]]
            log.append(cycle)
        with _named_failure("traffic", world.traffic):
            world.drive(coming.pop(0))


def _check_lasting(until: Sequence[Command], cycle: _Cycle, busy: int, steps: int) -> None:
    """Refuses a plan that comes after the last one's end, or ends before the next one acts.

    Args:
        until: Commands that are driven before the plan.
        cycle: The plan.
        busy: Steps that were lost while it was made.
        steps: Steps from now on that have to be driven, until the next plan acts.
    """
    begins = cycle.acts + busy - cycle.seen_step
    if len(until) < min(begins, steps):
        raise PluginError(
            f"the last plan ends before this one is there, which took {cycle.seconds:.2f} s; "
            "plan further, or faster"
        )
    wanted = steps - (begins - busy)
    if len(cycle.plan.inputs) < wanted:
        raise PluginError(
            f"the plan holds {len(cycle.plan.inputs)} inputs, but {wanted} steps are driven "
            "from it; plan further, or lower period or latency of the loop"
        )


def _cycle(
    world: World,
    on_their_way: Sequence[Command],
    latency: int,
    planner: Planner,
    predictor: Predictor,
    arm: Arm,
) -> _Cycle:
    """One prediction and one plan, of what is seen now.

    Args:
        world: The world now.
        on_their_way: Commands that act before the plan does.
        latency: Steps of the loop's latency; the sets reach less far ahead by it in every cycle,
            that of the first plan, which acts at once, included.
        planner: The planner.
        predictor: The predictor.
        arm: The arm.

    Returns:
        The cycle.
    """
    seen, delay = world.observation(), len(on_their_way)
    with _named_failure("predictor", predictor):
        occupancy = predictor.predict(seen)
    if arm is Arm.WITHOUT_DOS:
        occupancy = occupancy.without_sets()
    occupancy = occupancy.later(delay).first_steps(max(predictor.horizon - latency, 0))
    known = seen
    if delay:
        known = _when_it_acts(seen, world.foresee(on_their_way))
    with _named_failure("planner", planner):
        plan = planner.plan(known, occupancy)
    return _Cycle(
        seen_step=seen.step,
        seen_ids=seen.ids,
        seen_states=np.array(seen.states[:, -1]),
        acts=known.step,
        occupancy=occupancy,
        plan=plan,
        predict_seconds=predictor.last_seconds,
        plan_seconds=planner.last_seconds,
    )


def _when_it_acts(seen: Observation, ahead: FloatArray) -> Observation:
    """What is known at the step at which a plan acts: where the ego is, and what was seen."""
    delay = len(ahead) - 1
    history = np.concatenate([seen.ego_history, ahead[1:]])[delay:]
    return replace(seen, step=seen.step + delay, ego=ahead[-1], ego_history=history, delay=delay)


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
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # Not all that a plug-in raises is an Exception.
        name = getattr(plugin, "name", type(plugin).__name__)
        place = failure_place(error, type(plugin))
        line = f"{role} {name}: {one_line(error)} ({place})"
        is_traffic = isinstance(plugin, Traffic)
        end = EpisodeEnd.TRAFFIC_FAILURE if is_traffic else EpisodeEnd.PLANNER_FAILURE
        raise _PluginFailedError(line, end, error) from error
