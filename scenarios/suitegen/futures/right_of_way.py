"""Whether a known drive keeps the lights, signs and crosswalks, as ``StopRules`` decides them.

The rules are asked at every step of the drive with the true future in place of a prediction, for
each line of the route by itself. A line that they ask the ego to wait at must not be passed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from dosplan_simple.predictors import GroundTruthPredictor

from dosplan.api import PredictorSettings
from dosplan.geometry import ReferencePath, StopRules, StopSettings
from dosplan.types import (
    EGO_VELOCITY,
    BoolArray,
    FloatArray,
    Observation,
    Occupancy,
    RouteStop,
    Scenario,
    StopCause,
)

SETTINGS = StopSettings()


@dataclass(frozen=True)
class Passed:
    """A line is passed at which the rules ask the ego to wait.

    Attributes:
        line: Index of the stop in the route.
        step: Step of the scenario at which the ego's front is past the line.
        until: First step from which on the line may be passed, as far as that can be told.
        edge: Whether it is only that somebody stands at the edge of the crosswalk: the ego may go
            on once it has stood.
    """

    line: int
    step: int
    until: int
    edge: bool


class Referee:
    """Judges drives through a scenario whose recording is the future."""

    def __init__(self, scenario: Scenario) -> None:
        """Prepares the true future as a prediction.

        Args:
            scenario: The scenario.
        """
        self._scenario = scenario
        self._path = ReferencePath.of(scenario.task.route)
        horizon = scenario.task.final_step - scenario.task.start_step + 1
        self._oracle = GroundTruthPredictor(settings=PredictorSettings(horizon=horizon))
        self._oracle.reveal(scenario.tracks)
        self._oracle.reset(scenario.task, scenario.road_map)

    def front(self, poses: FloatArray) -> FloatArray:
        """Arc length of the ego's front along the route.

        Args:
            poses: (..., 3) centre x, y, m, and heading, rad.

        Returns:
            (...) m.
        """
        return self._path.locate(poses[..., :2]) + 0.5 * self._scenario.task.vehicle.length

    def passed(self, states: FloatArray) -> Passed | None:
        """The first line of the route that a drive passes against the rules.

        Args:
            states: (K, 5) ego states from the start step on.

        Returns:
            The line; None where the drive keeps the rules.
        """
        task = self._scenario.task
        if not task.route.stops:
            return None
        front = self.front(task.vehicle.poses(states))
        seen = [self._seen(task.start_step + i, state) for i, state in enumerate(states)]
        found = [
            broken
            for number, stop in enumerate(task.route.stops)
            if (broken := self._passed(number, stop, front, seen)) is not None
        ]
        return min(found, key=lambda broken: broken.step, default=None)

    def _passed(
        self,
        number: int,
        stop: RouteStop,
        front: FloatArray,
        seen: list[tuple[Observation, Occupancy]],
    ) -> Passed | None:
        over = np.flatnonzero((front[:-1] <= stop.arclength) & (front[1:] > stop.arclength))
        if not over.size:
            return None
        told = self._told(stop, front[: over[0] + 1], seen, SETTINGS)
        if told is None:
            return None
        step = self._scenario.task.start_step + int(over[0]) + 1
        patient = replace(SETTINGS, patience=0.0)
        edge = (
            stop.cause is StopCause.CROSSWALK
            and self._told(stop, front[: over[0] + 1], seen, patient) is None
        )
        ego = seen[over[0]][0].ego
        return Passed(number, step, step if edge else self._free(stop, ego, step), edge)

    def _told(
        self,
        stop: RouteStop,
        front: FloatArray,
        seen: list[tuple[Observation, Occupancy]],
        settings: StopSettings,
    ) -> str | None:
        """Why the ego had to wait when it last could still have stopped before the line."""
        rules, reason = self._rules(stop, settings), None
        for place, (observation, occupancy) in zip(front.tolist(), seen, strict=False):
            wait = rules.wait(observation, occupancy, place)
            velocity = float(observation.ego[EGO_VELOCITY])
            if wait is not None:
                reason = wait.reason
            elif velocity**2 / (2.0 * max(stop.arclength - place, 0.1)) <= settings.hardest:
                reason = None
        return reason

    def _free(self, stop: RouteStop, ego: FloatArray, step: int) -> int:
        """First step at which an ego that has waited may pass a line, not before ``step + 1``."""
        velocity = max(float(ego[EGO_VELOCITY]), 1.0)
        way = max(velocity**2 / (1.9 * SETTINGS.hardest), 0.2)
        early = round(way / velocity / self._scenario.dt)
        ego = np.array(ego)
        ego[EGO_VELOCITY] = velocity
        last = self._scenario.task.final_step
        for later in range(step + 1, last + 1):
            rules = self._rules(stop, SETTINGS)
            if rules.wait(*self._seen(later - early, ego), stop.arclength - way) is None:
                return later
        return last + 1

    def _rules(self, stop: RouteStop, settings: StopSettings) -> StopRules:
        task = self._scenario.task
        return StopRules(replace(task, route=replace(task.route, stops=(stop,))), settings)

    def _seen(self, step: int, ego: FloatArray) -> tuple[Observation, Occupancy]:
        """What is known at a step, and the true future as the prediction."""
        scenario, tracks = self._scenario, self._scenario.tracks
        column = min(step, tracks.steps - 1)
        there: BoolArray = tracks.valid[:, column]
        observation = Observation(
            step=step,
            dt=scenario.dt,
            ego=ego,
            ego_history=ego[None],
            ids=tracks.ids[there],
            kinds=tuple(kind for kind, on in zip(tracks.kinds, there, strict=True) if on),
            size=tracks.size[there],
            states=tracks.states[there, column : column + 1],
            valid=np.ones((int(there.sum()), 1), dtype=np.bool_),
            road_map=scenario.road_map,
            task=scenario.task,
            lights=scenario.signals.at(step),
        )
        return observation, self._oracle.predict(observation)


def lights_on_the_way(scenario: Scenario) -> Iterator[tuple[int, FloatArray]]:
    """When the lights of the route may be passed.

    Args:
        scenario: The scenario, whose lights are known.

    Yields:
        Index of the stop in the route, and for each step of the scenario (K,) the least velocity
        at which its line may be passed at it, m/s: zero where it is green, infinite where it is
        red; where it is yellow, that of an ego that could not have stopped gently.
    """
    steps = scenario.task.final_step + 1
    for number, stop in enumerate(scenario.task.route.stops):
        if stop.cause is not StopCause.LIGHT:
            continue
        least, yellow_for = np.zeros(steps), 0.0
        for step in range(steps):
            shown = scenario.signals.at(step).shown(stop.lights)
            yellow_for = yellow_for + scenario.dt if shown.value == "yellow" else 0.0
            # At a constant speed v it was t v before the line when the light changed, t ago; to
            # stop there takes v / 2 t.
            least[step] = np.inf if shown.forbids else 2.0 * SETTINGS.comfortable * yellow_for
        # A red light counts from the step before the line is passed to the step after.
        red = np.isinf(least)
        least[1:][red[:-1]] = np.inf
        least[:-1][red[1:]] = np.inf
        yield number, least
