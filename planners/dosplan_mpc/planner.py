"""The planner: reference, sets, initial guess, solve, check, fallback."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import shapely

from dosplan.api import Planner
from dosplan.geometry import PATH_CURVATURE, PATH_HEADING, PATH_X, PATH_Y
from dosplan.types import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_VELOCITY,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    SolveReport,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.goal import GoalWindow, SpeedProfile, locate_goals, plan_speed
from dosplan_mpc.nlp import Guess, Solution, problems
from dosplan_mpc.obstacles import ForbiddenSets, forbidden_sets, release, stretch_back
from dosplan_mpc.reference import PATH_LEFT, PATH_RIGHT, aligned_path
from dosplan_mpc.sampler import Candidates, Sampler
from dosplan_mpc.shape import STATIONS, disc_offsets, station_offsets
from dosplan_mpc.stage import EMPTY_SLOT, REFERENCE_SIZE, STAGE_HEAD, STATION_SIZE
from dosplan_mpc.traffic import Traffic, look_around

_SLACK_SEEN = 0.02  # A slack above this makes the planner look at alternatives.
_BETTER = 0.25  # Share by which a candidate must beat the warm start to be solved as well.
_WORTH_IT = 3.0  # Cost by which it must beat it at least.
_EDGE = 0.3  # m that the ego's front keeps from the end of the map.
_TAIL = 15.0  # Metres by which a follower's set is lengthened to its rear.
_RELEVANT = 3.0  # Normalised distance to the guess beyond which a set is no constraint.
_WATCHED = 16  # Road users whose sets are widened; the nearest of them fill the slots.


@dataclass
class _Memory:
    """What a cycle leaves to the next one of the same episode."""

    step: int
    guess: Guess
    slack: float
    cycles: int


class MpcPlanner(Planner):
    """Model-predictive control that keeps out of occupancy sets."""

    name: ClassVar[str] = "mpc-v3"

    settings: ClassVar[type[MpcConfig]] = MpcConfig

    def __init__(self, *, seed: int = 0, settings: MpcConfig = MpcConfig()) -> None:
        """Keeps the settings; the problem itself is built at the first episode.

        Args:
            seed: Seed of the run; the planner draws nothing at random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self.config = settings
        self.look_ahead = settings.horizon

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Lays out path and goals; forgets the last episode.

        Args:
            task: Start, goal and route.
            road_map: The map; where the path leaves it, the ego has to be done.
            vehicle: The ego.
        """
        self._vehicle = vehicle
        self._dt = task.dt
        self._problems = problems(self.config, vehicle, task.dt)
        _, self._radius = disc_offsets(vehicle, self.config.discs)
        self._stations = station_offsets(vehicle)
        self._path = aligned_path(task)
        self._final_step = task.final_step
        self._farthest = _end_of_road(task, road_map) - vehicle.length / 2.0 - _EDGE
        self._windows: tuple[GoalWindow, ...] = locate_goals(task, self._path, self._farthest)
        self._sampler = Sampler(self.config, vehicle, self._path, task.dt)
        self._start_velocity = float(task.start[EGO_VELOCITY])
        self._arclength = float(self._path.locate(task.start[:2]))
        self._memory: _Memory | None = None

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Plans one cycle.

        Args:
            observation: What is known now.
            occupancy: Sets to keep out of.

        Returns:
            The plan.
        """
        start = np.append(observation.ego, _previous_acceleration(observation))
        located, offset = self._path.project(observation.ego[:2], np.array(self._arclength))
        self._arclength = float(located)
        position = self._arclength + self._vehicle.rear_to_centre
        traffic = look_around(
            observation, self._path, self._vehicle, position, float(offset), self._start_velocity
        )
        # Recordings end, and so do their maps: what is left of both has to go together.
        left = max(self._final_step - observation.step, 1) * self._dt
        cruise = min(traffic.cruise, max(self._farthest - position, 0.0) / left)
        profile = plan_speed(
            self._path,
            self._windows,
            observation.step,
            self._dt,
            position,
            float(observation.ego[EGO_VELOCITY]),
            replace(traffic, cruise=cruise),
            self.config,
            self._vehicle,
        )
        warm = self._warm_start(observation.step)
        sets = self._sets(observation, occupancy, profile, traffic)
        memory = self._memory
        due = memory is None or memory.cycles % self.config.resample_every == 0
        attempts: list[tuple[Solution, ForbiddenSets]] = []
        fallback: Guess | None = None
        if warm is not None:
            attempts.append(self._solve(start, warm, sets, profile))
        if due or (memory is not None and memory.slack > _SLACK_SEEN) or not _usable(attempts):
            fallback, cost = self._best_sample(start, float(offset), sets, profile)
            bar = self._rate_guess(warm, sets, profile) if warm is not None else np.inf
            if cost < bar - max(_WORTH_IT, _BETTER * bar) or not _usable(attempts):
                attempts.append(self._solve(start, fallback, sets, profile))
        solution, chosen = min(attempts, key=lambda a: (not a[0].usable, a[0].cost))
        report = SolveReport(
            status=solution.status,
            iterations=sum(s.iterations for s, _ in attempts),
            seconds=sum(s.seconds for s, _ in attempts),
            slack=float(solution.set_slack.max()),
            road_slack=max(float(solution.road_slack.max()), 0.0),
            active_ids=_active(chosen, solution),
        )
        if not solution.usable and fallback is not None:
            self._memory = None
            return _plan(observation, fallback, replace(report, fallback="sampled"))
        arclength, _ = self._path.project(solution.states[:, :2], self._expected(solution.states))
        self._memory = _Memory(
            step=observation.step,
            guess=Guess(
                solution.states,
                solution.inputs,
                solution.road_slack,
                arclength,
            ),
            slack=report.slack,
            cycles=memory.cycles + 1 if memory else 1,
        )
        return _plan(observation, self._memory.guess, report)

    def _sets(
        self,
        observation: Observation,
        occupancy: Occupancy,
        profile: SpeedProfile,
        traffic: Traffic,
    ) -> ForbiddenSets:
        """Forbidden sets of the road users that come closest to where the ego will be."""
        n = self.config.horizon
        way = self._path.at(profile.arclength[1:])[:, :2]
        delta = np.where(occupancy.valid[:, :n, None], occupancy.centre[:, :n] - way, np.inf)
        away = np.sqrt((delta**2).sum(axis=-1)).min(axis=-1, initial=np.inf)
        keep = np.argsort(away, kind="stable")[:_WATCHED]
        keep = keep[np.isfinite(away[keep])]
        followers = traffic.followers[keep]
        penalty = self.config.set_penalty * np.linspace(1.0, self.config.far_penalty, n)
        # An episode ends with its goal's deadline: nothing later may block the last metres.
        extended = max(self._final_step - observation.step, 0) if self._windows else n
        radius = self._radius + self.config.clearance
        sets = forbidden_sets(occupancy, radius, keep, penalty, extended)
        sets = stretch_back(sets, followers, _TAIL)
        return release(sets, self._sampler.disc_centres(observation.ego), self._dt)

    def _best_sample(
        self, start: FloatArray, offset: float, sets: ForbiddenSets, profile: SpeedProfile
    ) -> tuple[Guess, float]:
        """The best sampled candidate and its cost."""
        candidates = self._sampler.sample(start, self._arclength, offset, profile)
        costs = self._sampler.rate(candidates, sets, profile)
        best = int(np.argmin(costs))
        return self._sampler.guess(candidates, best), float(costs[best])

    def _warm_start(self, step: int) -> Guess | None:
        """The last solution, moved along time by the steps that have passed."""
        if self._memory is None:
            return None
        passed = step - self._memory.step
        n = self.config.horizon
        if not 0 < passed < n:
            return None
        g = self._memory.guess
        inputs = np.vstack([g.inputs[passed:], np.zeros((passed, 2))])
        tail = [g.states[-1]]
        for _ in range(passed):
            moved = self._vehicle.step(tail[-1][:EGO_SIZE], np.zeros(2), self._dt)
            tail.append(np.append(moved, 0.0))
        states = np.vstack([g.states[passed:], tail[1:]])
        keep = np.minimum(np.arange(n) + passed, n - 1)
        gone = np.minimum(np.arange(n + 1) + passed, n)
        over = np.maximum(np.arange(n + 1) + passed - n, 0)
        return Guess(
            states=states,
            inputs=inputs,
            road_slack=g.road_slack[keep],
            arclength=g.arclength[gone] + over * self._dt * states[-1, EGO_VELOCITY],
        )

    def _expected(self, states: FloatArray) -> FloatArray:
        """Arc lengths to begin a projection with: the way that was driven, added up."""
        way = np.hypot(np.diff(states[:, 0]), np.diff(states[:, 1]))
        return self._arclength + np.concatenate([[0.0], np.cumsum(way)])

    def _rate_guess(self, guess: Guess, sets: ForbiddenSets, profile: SpeedProfile) -> float:
        s, offset = self._path.project(guess.states[:, :2], guess.arclength)
        states = guess.states.copy()
        states[1:, 5] = guess.inputs[:, 1]
        candidate = Candidates(states[None], guess.inputs[None], s[None], offset[None])
        return float(self._sampler.rate(candidate, sets, profile)[0])

    def _solve(
        self, start: FloatArray, guess: Guess, sets: ForbiddenSets, profile: SpeedProfile
    ) -> tuple[Solution, ForbiddenSets]:
        discs = self._sampler.disc_centres(guess.states)
        chosen = sets.nearest(discs[1:], self.config.slots, _RELEVANT)
        fitting = next(p for p in self._problems if p.config.slots >= len(chosen.ids))
        stages = np.empty((self.config.horizon + 1, fitting.stage_size))
        s, _ = self._path.project(guess.states[:, :2], guess.arclength)
        row = self._path.at(s)
        stages[:, :4] = row[:, [PATH_X, PATH_Y, PATH_HEADING, PATH_CURVATURE]]
        stages[:, 4] = profile.velocity
        stages[:, 5] = profile.offset
        stages[:, 6] = profile.arclength - self._vehicle.rear_to_centre - s
        stages[:, 7] = profile.station_weight
        stages[:, 8] = profile.heading
        stages[:, 9] = profile.heading_weight
        heading = guess.states[:, EGO_HEADING, None]
        points = guess.states[:, None, :2] + self._stations[:, None] * np.stack(
            [np.cos(heading), np.sin(heading)], axis=-1
        )
        along, _ = self._path.project(points, s[:, None] + self._stations)
        beside = self._path.at(along)
        stations = beside[
            ..., [PATH_X, PATH_Y, PATH_HEADING, PATH_CURVATURE, PATH_RIGHT, PATH_LEFT]
        ]
        # A goal narrows the way of the ego's centre; the middle station's edges are of its sides.
        half = self._vehicle.width / 2.0 + self.config.road_margin
        middle = stations[:, STATIONS // 2]
        middle[:, 4] = np.maximum(middle[:, 4], profile.right - half)
        middle[:, 5] = np.minimum(middle[:, 5], profile.left + half)
        stages[:, REFERENCE_SIZE:STAGE_HEAD] = stations.reshape(-1, STATIONS * STATION_SIZE)
        slots = np.tile(np.array(EMPTY_SLOT), (self.config.horizon + 1, fitting.config.slots, 1))
        slots[1:, : len(chosen.ids)] = chosen.slots.transpose(1, 0, 2)
        stages[:, STAGE_HEAD:] = slots.reshape(len(slots), -1)
        # Slots change their owner between cycles: slacks are made anew from the guess.
        slack = np.zeros((self.config.horizon, fitting.config.slots))
        if len(chosen.ids):
            inside = 1.0 - chosen.distance(discs[1:]).T
            slack[:, : len(chosen.ids)] = np.maximum(inside, 0.0)
        return fitting.solve(start, stages, guess, slack), chosen


def _usable(attempts: list[tuple[Solution, ForbiddenSets]]) -> bool:
    return any(solution.usable for solution, _ in attempts)


def _plan(observation: Observation, guess: Guess, report: SolveReport) -> Plan:
    states = guess.states[:, :EGO_SIZE].copy()
    states[0] = observation.ego
    return Plan(states=states, inputs=guess.inputs, report=report)


def _end_of_road(task: PlanningTask, road_map: RoadMap) -> float:
    """Arc length, m, at which the route's path first leaves the road after the start."""
    route = task.route
    begin = int(np.argmin(np.hypot(*(route.path - task.start[:2]).T)))
    off = ~shapely.contains_xy(road_map.drivable, route.path[begin:])
    return float(route.arclength[begin + int(np.argmax(off))]) if off.any() else np.inf


def _previous_acceleration(observation: Observation) -> float:
    """Acceleration of the last step; zero at the start, where it is not known."""
    history = observation.ego_history[:, EGO_VELOCITY]
    if len(history) < 2 or not np.isfinite(history[-2]):
        return 0.0
    return float((history[-1] - history[-2]) / observation.dt)


def _active(sets: ForbiddenSets, solution: Solution) -> tuple[int, ...]:
    """Road users whose slack is seen in the solution."""
    touched = solution.set_slack.max(axis=0)[: len(sets.ids)] > 1e-3
    return tuple(int(i) for i in sets.ids[touched])
