"""The true state of one scenario, step by step: the ego and the other road users.

The world hands out an ``Observation`` of the past and the present, and keeps what was driven: the
ego's states and inputs, and the tracks of the road users.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from dosplan.api import PluginError
from dosplan.simulation.actuators import Actuators
from dosplan.simulation.sensing import Sensors
from dosplan.simulation.settings import IDEAL, LoopSettings
from dosplan.simulation.tracking import Command, Tracker
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic, users_at
from dosplan.types import (
    COLOURS,
    EGO_HEADING,
    EGO_SIZE,
    EGO_VELOCITY,
    HISTORY_STEPS,
    USER_SIZE,
    FloatArray,
    IntArray,
    LightStates,
    Observation,
    Plan,
    RoadUserKind,
    Scenario,
    Signals,
    Tracks,
)


class World:
    """The ego of a scenario among its road users, at a step.

    Attributes:
        scenario: The scenario.
        traffic: Moves the road users.
        start_step: Step of the first of ``driven``.
    """

    def __init__(
        self,
        scenario: Scenario,
        traffic: Traffic | None = None,
        *,
        first_step: int | None = None,
        history: int = HISTORY_STEPS,
        loop: LoopSettings = IDEAL,
    ) -> None:
        """Puts the ego at its start.

        Args:
            scenario: The scenario.
            traffic: Moves the road users; a replay of the recording by default.
            first_step: Step at which the ego is at its start; that of the task by default.
            history: Steps H that an observation shows, the present one included.
            loop: What the ego sees of the road users, and how it follows its inputs.
        """
        self.scenario = scenario
        self.traffic = Replay() if traffic is None else traffic
        self.start_step = scenario.task.start_step if first_step is None else first_step
        self._history = history
        vehicle, dt = scenario.task.vehicle, scenario.dt
        self._actuators = Actuators(loop.actuators, vehicle, dt)
        self._tracker = Tracker(self._actuators, vehicle, dt)
        self._output = self._actuators.at_rest
        self._states: list[FloatArray] = [np.array(scenario.task.start)]
        self._inputs: list[FloatArray] = []
        if (why := self.traffic.refuses(scenario)) is not None:
            raise PluginError(f"cannot drive {scenario.id}, which {why}")
        past = self.traffic.begin(scenario, self.start_step)
        if not isinstance(past, Tracks) or past.steps != self.start_step + 1:
            raise PluginError(f"begin must return Tracks of the steps 0 to {self.start_step}")
        steps = max(scenario.task.final_step, self.start_step, scenario.tracks.steps - 1) + 1
        self._others = _Others(past, steps)
        self._sensors: Sensors | None = None
        if not loop.sensing.exact:
            self._sensors = Sensors(
                loop.sensing,
                dt,
                steps,
                scenario=scenario.id,
                seed=self.traffic.seed,
                future=self.traffic.future,
            )
            self._look_back(self._sensors, past)
        self._lights: list[LightStates] = []
        self._look_at_lights()

    @property
    def now(self) -> int:
        """The present step."""
        return self.start_step + len(self._states) - 1

    @property
    def ego(self) -> FloatArray:
        """(5,) the present ego state."""
        return self._states[-1]

    @property
    def driven(self) -> FloatArray:
        """(K + 1, 5) ego states from ``start_step`` to now."""
        return np.stack(self._states)

    @property
    def inputs(self) -> FloatArray:
        """(K, 2) inputs that were applied."""
        return np.reshape(self._inputs, (-1, 2))

    @property
    def tracks(self) -> Tracks:
        """The road users as they were driven, at the steps 0 to now.

        Where all drive as recorded, this is the recording, which may go on beyond now.
        """
        if self.traffic.as_recorded:
            return self.scenario.recorded(self.traffic.future)
        return self._others.tracks(self.now)

    @property
    def signals(self) -> Signals | None:
        """The lights as they were, at the steps 0 to now; None where that is as recorded.

        Before the ego's start they were as at it.
        """
        if not self._lights:
            return None
        number = {colour: k for k, colour in enumerate(COLOURS)}
        before = self.now + 1 - len(self._lights)
        shown = [self._lights[max(k - before, 0)] for k in range(self.now + 1)]
        return Signals(
            ids=self._lights[0].ids,
            colours=np.array([[number[c] for c in at.colours] for at in shown]).T,
            since=np.stack([at.since for at in shown], axis=1),
        )

    def _look_back(self, sensors: Sensors, past: Tracks) -> None:
        """What was seen until the start, of an ego that came straight on at its velocity."""
        task = self.scenario.task
        heading, velocity = task.start[EGO_HEADING], task.start[EGO_VELOCITY]
        a_step = velocity * self.scenario.dt * np.array([np.cos(heading), np.sin(heading)])
        centre = task.vehicle.centre(task.start)
        for step in range(max(self.start_step - self._history + 1, 0), self.start_step + 1):
            eye = centre - (self.start_step - step) * a_step
            sensors.look(step, eye, users_at(past, step))

    def _look_at_lights(self) -> None:
        """Asks the traffic what the lights show now."""
        lights = self.traffic.lights(self.now)
        if lights is None:
            return
        if self._lights and not np.array_equal(lights.ids, self._lights[0].ids):
            raise PluginError("lights must name the same lights at every step")
        self._lights.append(lights)

    def observation(self) -> Observation:
        """What may be known now.

        Every array is a copy of the past and the present, so that nothing else can be reached
        from it, not even through ``ndarray.base``.

        Returns:
            The observation. Ego states before the start and road users before step 0 are NaN. The
            road users are as the ego's sensors see them.
        """
        recent = self._states[-self._history :]
        ego_history = np.full((self._history, EGO_SIZE), np.nan)
        ego_history[self._history - len(recent) :] = recent
        seen = self._others if self._sensors is None else self._sensors
        ids, kinds, size, states, valid = seen.seen(self.now, self._history)
        return Observation(
            step=self.now,
            dt=self.scenario.dt,
            ego=self.ego,
            ego_history=ego_history,
            ids=ids,
            kinds=kinds,
            size=size,
            states=states,
            valid=valid,
            road_map=self.scenario.road_map,
            task=self.scenario.task,
            lights=self._lights[-1] if self._lights else self.scenario.signals.at(self.now),
        )

    def step(self, wanted: FloatArray) -> None:
        """Drives one step; the ego's input is cut to what its actuators can deliver.

        Args:
            wanted: (2,) steering rate, rad/s, and acceleration, m/s2.

        Raises:
            PluginError: The traffic broke its contract.
        """
        vehicle, dt = self.scenario.task.vehicle, self.scenario.dt
        applied, output = self._actuators.follow(self.ego, wanted, self._output)
        states = [*self._states, vehicle.step(self.ego, applied, dt)]
        users = self.traffic.step(self.now + 1, np.stack(states))
        self._others.add(self.now + 1, users)
        self._states, self._output = states, output
        self._inputs.append(applied)
        self._look_at_lights()
        if self._sensors is not None:
            self._sensors.look(self.now, vehicle.centre(self.ego), users)

    def commands(self, plan: Plan) -> list[Command]:
        """What the actuators are to be asked for at each step of a plan."""
        return self._tracker.commands(plan)

    def drive(self, command: Command) -> None:
        """Drives one step, as ``step`` does.

        Args:
            command: What the actuators are asked for.

        Raises:
            PluginError: The traffic broke its contract.
        """
        self.step(command.wanted(self.ego, self._output))

    def foresee(self, commands: Sequence[Command]) -> FloatArray:
        """Where the ego gets by commands that are on their way to the actuators.

        Args:
            commands: S commands.

        Returns:
            (S + 1, 5) ego states from now on, the same to the last bit as when they are driven.
        """
        vehicle, dt = self.scenario.task.vehicle, self.scenario.dt
        states, output = [self.ego], self._output
        for command in commands:
            wanted = command.wanted(states[-1], output)
            applied, output = self._actuators.follow(states[-1], wanted, output)
            states.append(vehicle.step(states[-1], applied, dt))
        return np.stack(states)

    def wait(self) -> None:
        """Lets one step pass in which the ego stays where it is, with no other history.

        For uses in which only the road users matter.

        Raises:
            PluginError: The traffic broke its contract.
        """
        users = self.traffic.step(self.now + 1, self.ego[None])
        self._others.add(self.now + 1, users)
        self.start_step = self.now + 1
        self._states, self._inputs = self._states[-1:], []
        self._look_at_lights()
        if self._sensors is not None:
            self._sensors.look(self.now, self.scenario.task.vehicle.centre(self.ego), users)


def watch(
    scenario: Scenario,
    every: int,
    history: int = HISTORY_STEPS,
    *,
    loop: LoopSettings = IDEAL,
    seed: int = 0,
    future: int = 0,
) -> Iterator[Observation]:
    """Walks through a recording, from step 0 to its end.

    The ego stays at its start: only the road users matter. It sees them as an ego does that drives
    in the loop, with the same errors and gaps at the same seed.

    Args:
        scenario: The recording.
        every: Steps from one observation to the next.
        history: Steps that an observation shows, the present one included.
        loop: What the ego sees of the road users.
        seed: Seed of the errors of what it sees.
        future: Which of the recorded futures comes.

    Yields:
        The observations.

    Raises:
        ShapeError: So many futures are not recorded.
    """
    traffic = Replay(seed=seed, future=future)
    world = World(scenario, traffic, first_step=0, history=history, loop=loop)
    for step in range(scenario.tracks.steps):
        if step:
            world.wait()
        if step % every == 0:
            yield world.observation()


class _Others:
    """The road users that were handed over so far, in the order in which they came."""

    def __init__(self, past: Tracks, steps: int) -> None:
        """Takes the past over.

        Args:
            past: The road users until now.
            steps: For how many steps room is made at first.
        """
        self._rows = {name: row for row, name in enumerate(past.ids.tolist())}
        self._kinds = list(past.kinds)
        self._outlines = list(past.outlines)
        self._size = np.array(past.size)
        self._states = np.empty((0, 0, USER_SIZE))
        self._valid = np.empty((0, 0), dtype=np.bool_)
        self._make_room(len(past.ids), max(steps, past.steps))
        self._states[:, : past.steps] = past.states
        self._valid[:, : past.steps] = past.valid
        self._present = np.flatnonzero(past.valid[:, -1])

    def add(self, step: int, users: RoadUsers) -> None:
        """Adds the road users on the scene at a step."""
        if not isinstance(users, RoadUsers):
            raise PluginError(f"step returned {type(users).__name__}, not RoadUsers")
        ids = users.ids.tolist()
        new = [i for i, name in enumerate(ids) if name not in self._rows]
        for i in new:
            self._rows[ids[i]] = len(self._rows)
            self._kinds.append(users.kinds[i])
            self._outlines.append(users.outlines[i])
        if new:
            self._size = np.concatenate([self._size, users.size[new]])
        self._make_room(len(self._rows), step + 1)
        rows = np.array([self._rows[name] for name in ids], dtype=np.int64)
        same = np.all(self._size[rows] == users.size, axis=1)
        for i, (row, kind) in enumerate(zip(rows, users.kinds, strict=True)):
            same[i] &= self._kinds[row] is kind
            same[i] &= _is_same(self._outlines[row], users.outlines[i])
        if not same.all():
            raise PluginError(
                f"road user {ids[int(np.argmin(same))]} has another kind, size or outline "
                "than before"
            )
        self._states[rows, step] = users.states
        self._valid[rows, step] = True
        self._present = rows

    def seen(
        self, step: int, history: int
    ) -> tuple[IntArray, tuple[RoadUserKind, ...], FloatArray, FloatArray, npt.NDArray[np.bool_]]:
        """The road users on the scene now, with their last steps: the fields of an observation."""
        rows = self._present
        first = max(step - history + 1, 0)
        begin = history - (step + 1 - first)
        states = np.full((len(rows), history, USER_SIZE), np.nan)
        valid = np.zeros((len(rows), history), dtype=np.bool_)
        states[:, begin:] = self._states[rows, first : step + 1]
        valid[:, begin:] = self._valid[rows, first : step + 1]
        return self._ids[rows], tuple(self._kinds[i] for i in rows), self._size[rows], states, valid

    def tracks(self, last: int) -> Tracks:
        """All road users at the steps 0 to ``last``."""
        return Tracks(
            ids=self._ids,
            kinds=tuple(self._kinds),
            size=self._size,
            states=self._states[: len(self._rows), : last + 1],
            valid=self._valid[: len(self._rows), : last + 1],
            outlines=tuple(self._outlines),
        )

    @property
    def _ids(self) -> IntArray:
        return np.fromiter(self._rows, dtype=np.int64, count=len(self._rows))

    def _make_room(self, users: int, steps: int) -> None:
        """Has the arrays hold so many road users and steps; where they grow, by half more."""
        rows, columns = self._valid.shape
        if users <= rows and steps <= columns:
            return
        shape = (
            rows if users <= rows else max(users, rows + rows // 2),
            columns if steps <= columns else max(steps, columns + columns // 2),
        )
        states, valid = np.full((*shape, USER_SIZE), np.nan), np.zeros(shape, dtype=np.bool_)
        states[:rows, :columns], valid[:rows, :columns] = self._states, self._valid
        self._states, self._valid = states, valid


def _is_same(outline: FloatArray | None, other: FloatArray | None) -> bool:
    """Whether two outlines are one; None is a rectangle."""
    if outline is None or other is None:
        return outline is other
    return outline is other or np.array_equal(outline, other)
