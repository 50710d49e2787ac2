"""An episode of the planner: reference, sets, initial guess, solve, check, fallback."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import shapely

from dosplan.geometry import PATH_SIZE, StopRules, Wait
from dosplan.types import (
    EGO_SIZE,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    Route,
    SolveReport,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.arrival import Arrivals
from dosplan_mpc.barrier import BARRIER_ID, barrier
from dosplan_mpc.components import Components
from dosplan_mpc.config import MpcConfig
from dosplan_mpc.decision import Decision, Decisions, Kind
from dosplan_mpc.effort import Effort
from dosplan_mpc.fork import other_branches
from dosplan_mpc.goal_window import GoalWindow, locate_goal
from dosplan_mpc.lane_change import GapDecision
from dosplan_mpc.limits import half_width
from dosplan_mpc.nlp import Guess, Solution, problems, stage_steps
from dosplan_mpc.obstacles import ChosenSets, ForbiddenSets, forbidden_sets, release, stretch_back
from dosplan_mpc.passing import PassingDecision
from dosplan_mpc.reach import Reach
from dosplan_mpc.reference import EgoOnPath, aligned_path
from dosplan_mpc.road import Road
from dosplan_mpc.sampler import Candidates, Sampler
from dosplan_mpc.shape import disc_offsets
from dosplan_mpc.speed_profile import LegalSpeed, SpeedPlanner, SpeedProfile
from dosplan_mpc.stage import (
    ACCELERATION,
    INPUT_SIZE,
    PREVIOUS_ACCELERATION,
    Reference,
    StageParameters,
)
from dosplan_mpc.traffic import Lane, Traffic

_ASTRAY: Final = 0.02  # Way off the road, unseen by a plan, from which on it is solved again, m.
_FAR_ASTRAY: Final = 0.5  # From which on its way is of no use, m.
_ANY_VELOCITY: Final = (0.0, np.inf)  # m/s
_LAST_PLAN: Final = "last plan"
_ARRIVAL: Final = "arrival"
_SAMPLED: Final = "sampled"
_SEEN: Final = 1e-3  # Slack of a set from which on its road user is reported as active.


@dataclass(frozen=True)
class _LastCycle:
    """What the next cycle needs of the last one.

    Attributes:
        step: Its step.
        guess: What it planned.
        slack: Largest slack of a set.
        cycles: Number of cycles in a row that ended with a plan to go on from.
        kind: What told its decision from others.
    """

    step: int
    guess: Guess
    slack: float
    cycles: int
    kind: tuple[Kind, ...]


@dataclass(frozen=True)
class _Scene:
    """The inputs of one planning cycle.

    Attributes:
        start: (6,) present state and previous acceleration.
        ego: The same relative to the path.
        profile: Reference of the next steps.
        sets: Forbidden sets of the road users nearby.
        decision: What was decided before the plan is optimised.
        barrier: The set behind the line before which the ego has to stop, or None.
    """

    start: FloatArray
    ego: EgoOnPath
    profile: SpeedProfile
    sets: ForbiddenSets
    decision: Decision
    barrier: ForbiddenSets | None

    @property
    def forbidden(self) -> ForbiddenSets:
        """All that candidates are rated by: the sets of road users and the barrier."""
        return self.sets.joined(self.barrier)


class _Spare(NamedTuple):
    """What is driven where no solution is of use.

    Attributes:
        name: Its name in the report.
        guess: What is driven.
        cost: Its cost by the rating of candidates; infinite where it was not rated.
    """

    name: str
    guess: Guess
    cost: float = np.inf


class _Attempt(NamedTuple):
    """A solution and what it is worth.

    Attributes:
        solution: What the solver found.
        plan: The same as a guess.
        sets: The sets that were its constraints.
        astray: How far it leaves the road where the edges beside its guess tell nothing of that, m.
        cost: Its cost with the price of that. An iterate that is accepted may have slacks below
            zero; they count as none.
    """

    solution: Solution
    plan: Guess
    sets: ChosenSets
    astray: float
    cost: float

    @property
    def keeps_road(self) -> bool:
        """Whether it is usable, and on the road where its edges tell nothing of that."""
        return self.solution.usable and self.astray <= _ASTRAY

    @property
    def road_slack(self) -> float:
        """How far the plan leaves the road, m."""
        return max(float(self.solution.road_slack.max()), self.astray, 0.0)


class MpcEpisode:
    """Plans the cycles of one episode, each from what the last one found."""

    def __init__(
        self,
        config: MpcConfig,
        task: PlanningTask,
        road_map: RoadMap,
        vehicle: VehicleParameters,
    ) -> None:
        """Makes the path and finds the goals along it.

        Args:
            config: Settings.
            task: Start, goal and route.
            road_map: The map; the ego has to stop before the path leaves it.
            vehicle: The ego.
        """
        self._config = config
        self._vehicle = vehicle
        self._dt = task.dt
        self._final_step = task.final_step
        self._problems = {p.config.slots: p for p in problems(config, vehicle, task.dt)}
        self._effort = Effort(config)
        self._stage_steps = stage_steps(config)
        self._radius = disc_offsets(vehicle, config.discs)[1] + config.clearance
        # (N,) on entering a set at each step.
        self._penalty = config.set_penalty * np.linspace(1.0, config.far_penalty, config.horizon)
        self._path = aligned_path(task, config.path)
        self._arclength = self._path.locate_first(task.start[:2])
        end = _end_of_road(task.route, road_map, self._arclength)
        self._farthest = end - vehicle.length / 2.0 - config.path.end_margin
        found = [locate_goal(goal, self._path, config.goal, self._farthest) for goal in task.goals]
        windows = tuple(window for window in found if isinstance(window, GoalWindow))
        self._reach = Reach(task, found, vehicle)
        self._has_goals = bool(windows)
        self._velocity = _velocity_asked(task) if not windows else _ANY_VELOCITY
        self._lane = Lane(config.traffic, self._path, vehicle, float(task.start[EGO_VELOCITY]))
        limits = LegalSpeed.of(task.route, config.speed.limit_factor)
        self._speed = SpeedPlanner(config, vehicle, self._path, windows, limits, task.dt)
        self._half_width = half_width(config, vehicle)
        self._decisions = Decisions(
            StopRules(task, config.stops),
            PassingDecision(config.passing, self._path, task.route, vehicle, self._half_width),
            GapDecision(config.gap, self._path, task.route, road_map, windows, vehicle, task.dt),
            0.5 * vehicle.length,
        )
        closed = other_branches(task, road_map, config.path.widest_swing, self._half_width)
        self._road = Road(road_map, self._path, vehicle, self._half_width, closed)
        self._sampler = Sampler(config, vehicle, self._path, self._road, task.dt)
        turned = [
            goal
            for goal, window in zip(task.goals, found, strict=True)
            if isinstance(window, GoalWindow) and window.turn
        ]
        self._arrivals = Arrivals(
            config.arrival, task, turned, self._road.area, vehicle, self._sampler
        )
        self._last: _LastCycle | None = None

    def plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Plans one cycle.

        Args:
            observation: What is known now.
            occupancy: Sets to keep out of, at least as far ahead as the horizon.

        Returns:
            The plan.
        """
        self._effort.begin()
        scene = self._look(observation, occupancy)
        attempts, spare = self._attempts(observation.step, scene)
        best = min(
            attempts, key=lambda a: (not a.solution.usable, not a.keeps_road, a.cost), default=None
        )
        solved = best if best is not None and self._is_driven(best, spare, scene) else None
        lost = self._reach.unreachable(observation.step, observation.ego, scene.ego.position)
        report = replace(_report(attempts, best, scene.decision), unreachable=lost)
        guess = spare.guess if solved is None else solved.plan
        if solved is None:
            report = replace(report, fallback=spare.name)
        arrival = self._arrival(observation, scene, guess)
        if arrival is not None:
            guess = arrival
            fallen = report.fallback and _ARRIVAL
            # What the plan before it entered is not entered.
            report = replace(report, slack=0.0, road_slack=0.0, active_ids=(), fallback=fallen)
        if solved is not None or arrival is not None:
            self._last = self._remember(observation.step, guess, report.slack, scene)
        elif spare.name != _LAST_PLAN:
            self._last = None
        if not self._effort.in_time():
            said = f"{report.fallback or 'solved'} at the deadline"
            report = replace(report, fallback=said)
        return _plan(observation, guess, report)

    def _is_driven(self, best: _Attempt, spare: _Spare, scene: _Scene) -> bool:
        """Whether the best solution is driven, and not what is there in its place.

        A plan that is off the road unseen solves another problem than that of the scene. It has to
        be worth more than the other by the same rating.
        """
        if best.keeps_road or not best.solution.usable:
            return best.keeps_road
        return self._cost_of(best.plan, scene) <= spare.cost

    def _arrival(self, observation: Observation, scene: _Scene, guess: Guess) -> Guess | None:
        """A drive into a goal that is driven in place of a plan, if there is one."""
        if not self._effort.in_time():
            return None
        arrival = self._arrivals.instead(
            guess.states,
            observation.step,
            scene.start,
            scene.forbidden,
            self._speed.fastest(scene.ego),
        )
        if arrival is None:
            return None
        on_road = np.zeros(len(arrival.inputs))
        return self._guess_along(arrival.states, arrival.inputs, on_road)

    def _look(self, observation: Observation, occupancy: Occupancy) -> _Scene:
        """Where the ego is, its reference, and the sets it keeps out of."""
        ego = self._locate(observation)
        self._arclength = ego.arclength
        decision = self._decisions.about_stops(observation, occupancy, ego)
        traffic = self._lane.look_around(observation, ego, decision.passed)
        # The road that is left on the map has to last until the final step.
        left = max(self._final_step - observation.step, 1) * self._dt
        cruise = min(traffic.cruise, max(self._farthest - ego.position, 0.0) / left)
        cruise = float(np.clip(cruise, *self._velocity))
        lost = self._reach.lost(observation.step, observation.ego, ego.position)
        window = self._speed.next_goal(ego, lost)
        profile, limit = self._speed.plan(
            ego, replace(traffic, cruise=cruise), window, decision.stop
        )
        decision = self._decisions.about_gaps(decision, observation, occupancy, ego, profile, limit)
        profile = decision.lead(profile)
        if decision.leads:  # It is elsewhere along the path now.
            profile = self._speed.beside_goal(profile, window, ego.step, decision.entry)
        return _Scene(
            start=np.append(observation.ego, _previous_acceleration(observation)),
            ego=ego,
            profile=profile,
            sets=self._sets(observation, occupancy, profile, traffic),
            decision=decision,
            barrier=None if decision.wait is None else self._barrier(decision.wait),
        )

    def _barrier(self, wait: Wait) -> ForbiddenSets:
        """The set behind a line."""
        return barrier(self._config, self._vehicle, self._path, wait.line, self._penalty)

    def _locate(self, observation: Observation) -> EgoOnPath:
        """Where the ego is on the path, near to where it was."""
        located, offset = self._path.project(observation.ego[:2], np.array(self._arclength))
        return EgoOnPath(
            step=observation.step,
            arclength=float(located),
            offset=float(offset),
            position=float(located) + self._vehicle.rear_to_centre,
            velocity=float(observation.ego[EGO_VELOCITY]),
        )

    def _sets(
        self,
        observation: Observation,
        occupancy: Occupancy,
        profile: SpeedProfile,
        traffic: Traffic,
    ) -> ForbiddenSets:
        """Forbidden sets of the road users that come closest to where the ego will be."""
        config, n = self._config, self._config.horizon
        way = self._path.at(profile.arclength[1:])[:, :2]
        near = Components.near(occupancy, way, config.sets)
        followers = traffic.followers[near.rows[near.keep]]
        price = near.price * np.where(followers, config.sets.follower_price, 1.0)
        penalty = price[:, None] * self._penalty
        # An episode ends with its goal's deadline: nothing later may block the last metres.
        extended = max(self._final_step - observation.step, 0) if self._has_goals else n
        sets = forbidden_sets(near.sets, self._radius, near.keep, penalty, extended)
        sets = stretch_back(sets, followers, config.sets.tail)
        return release(sets, self._sampler.disc_centres(observation.ego), self._dt, config.sets)

    def _attempts(self, step: int, scene: _Scene) -> tuple[list[_Attempt], _Spare]:
        """Solves from the last plan, and from a sampled candidate where that is rated better.

        Returns:
            The attempts, and the better of the last plan and that candidate, as far as they were
            looked at.
        """
        last, settings = self._last, self._config.sampler
        attempts: list[_Attempt] = []
        warm = None if last is None else self._warm_start(last, step)
        if warm is not None and self._effort.allows_solve():
            attempts += self._solve_on_road(scene, warm)
        # Another decision is another problem: the last plan is not in its class.
        new = last is not None and last.kind != scene.decision.kind
        due = last is None or new or last.cycles % self._config.resample_every == 0
        pressed = last is not None and last.slack > settings.slack_seen
        keeps_road = any(attempt.keeps_road for attempt in attempts)
        if warm is not None and keeps_road and not due and not pressed:
            return attempts, _Spare(_LAST_PLAN, warm)
        bar = np.inf if warm is None else self._cost_of(warm, scene)
        kept = 0.0 if new else max(settings.worth_it, settings.better * bar)
        # No cost is below zero: a plan that costs no more than that cannot be beaten by as much.
        unbeaten = keeps_road and bar <= kept
        if warm is not None and (unbeaten or not self._effort.in_time()):
            return attempts, _Spare(_LAST_PLAN, warm, bar)
        sampled = self._sampler.sample(scene.start, scene.ego, scene.profile)
        if scene.decision.leads:
            led = self._sampler.led(scene.start, scene.ego, scene.profile)
            sampled = sampled.joined(led)
        candidate, cost = self._best_of(scene, sampled)
        better = cost < bar - kept
        if (better or not keeps_road) and self._effort.allows_solve():
            attempts += self._solve_on_road(scene, candidate)
        if warm is not None and bar < cost:
            return attempts, _Spare(_LAST_PLAN, warm, bar)
        return attempts, _Spare(_SAMPLED, candidate, cost)

    def _best_of(self, scene: _Scene, candidates: Candidates) -> tuple[Guess, float]:
        """The best of some candidates and its cost."""
        best, cost = self._sampler.best(candidates, scene.forbidden, scene.profile)
        return candidates.guess(best), cost

    def _cost_of(self, guess: Guess, scene: _Scene) -> float:
        """Cost of a guess by the rating of candidates."""
        s, offset = self._path.project(guess.states[:, :2], guess.arclength)
        states = guess.states.copy()
        states[1:, PREVIOUS_ACCELERATION] = guess.inputs[:, ACCELERATION]
        candidate = Candidates(states[None], guess.inputs[None], s[None], offset[None])
        return float(self._sampler.rate(candidate, scene.forbidden, scene.profile)[0])

    def _warm_start(self, last: _LastCycle, step: int) -> Guess | None:
        """The last plan, moved along time by the steps that have passed."""
        passed, n, guess = step - last.step, self._config.horizon, last.guess
        if not 0 < passed < n:
            return None
        coasting = np.zeros(INPUT_SIZE)
        tail = [guess.states[-1]]
        for _ in range(passed):
            moved = self._vehicle.step(tail[-1][:EGO_SIZE], coasting, self._dt)
            tail.append(np.append(moved, 0.0))
        states = np.vstack([guess.states[passed:], tail[1:]])
        later = np.arange(n + 1) + passed
        over = np.maximum(later - n, 0)
        return Guess(
            states=states,
            inputs=np.vstack([guess.inputs[passed:], np.tile(coasting, (passed, 1))]),
            road_slack=guess.road_slack[np.minimum(later[:-1], n - 1)],
            arclength=guess.arclength[np.minimum(later, n)]
            + over * self._dt * states[-1, EGO_VELOCITY],
        )

    def _as_guess(self, solution: Solution) -> Guess:
        """A solution as the guess of another solve."""
        return self._guess_along(solution.states, solution.inputs, solution.road_slack)

    def _guess_along(self, states: FloatArray, inputs: FloatArray, road_slack: FloatArray) -> Guess:
        """A guess of states from the ego's own on, with their places along the path."""
        way = np.hypot(np.diff(states[:, EGO_X]), np.diff(states[:, EGO_Y]))
        expected = self._arclength + np.concatenate([[0.0], np.cumsum(way)])
        arclength, _ = self._path.project(states[:, :2], expected)
        return Guess(states, inputs, road_slack, arclength)

    def _remember(self, step: int, guess: Guess, slack: float, scene: _Scene) -> _LastCycle:
        """What the next cycle needs of a plan that is driven."""
        return _LastCycle(
            step=step,
            guess=guess,
            slack=slack,
            cycles=self._last.cycles + 1 if self._last else 1,
            kind=scene.decision.kind,
        )

    def _solve_on_road(self, scene: _Scene, guess: Guess) -> list[_Attempt]:
        """Solves from a guess, and once more where that leads off the road unseen.

        The edges and the path of a plan are those beside its guess. A plan that goes elsewhere
        (round a corner, from a guess that stands before it) may keep them all and not the road.
        From a little off it is solved again where it is; what is far off is of use for its speed
        alone, at which the path is followed.
        """
        attempt = self._solve(scene, guess)
        if attempt.astray <= _ASTRAY or not attempt.solution.usable:
            return [attempt]
        if not self._effort.allows_solve():
            return [attempt]
        again = attempt.plan
        if attempt.astray > _FAR_ASTRAY:
            again, _ = self._best_of(
                scene,
                self._sampler.at_speed(
                    scene.start, scene.ego, scene.profile, again.states[:, EGO_VELOCITY]
                ),
            )
        return [attempt, self._solve(scene, again)]

    def _solve(self, scene: _Scene, guess: Guess) -> _Attempt:
        """Solves the smallest problem that holds the sets near a guess.

        A line before which the ego has to stop is never left out for the sake of road users.
        """
        steps = self._stage_steps
        states, profile = guess.states[steps], scene.profile.at(steps)
        near = scene.forbidden.at(steps[1:] - 1).choose(
            self._sampler.disc_centres(states[1:]),
            tuple(self._problems),
            self._config.sets.relevant,
            np.array([BARRIER_ID]),
        )
        s, _ = self._path.project(states[:, :2], guess.arclength[steps])
        stages = StageParameters(
            reference=self._reference(s, profile),
            # A goal bounds the ego's centre, the middle station's edges bound its sides.
            stations=self._road.beside(
                states,
                s,
                right=profile.right - self._half_width,
                left=profile.left + self._half_width,
            ),
            slots=near.fill(),
        )
        # A slot may hold another road user than before: slacks are computed from the guess.
        problem = self._problems[near.slots]
        solution = problem.solve(scene.start, stages, guess, near.slack())
        self._effort.spend(solution)
        return self._attempt(solution, near)

    def _attempt(self, solution: Solution, sets: ChosenSets) -> _Attempt:
        """A solution with its price by the road itself."""
        steps, spans = self._stage_steps, np.diff(self._stage_steps)
        plan = self._as_guess(solution)
        states, road_slack = plan.states[steps], solution.road_slack[steps[1:] - 1]
        s, offset = self._path.project(states[:, :2], plan.arclength[steps])
        outside = self._road.outside(states[None], s[None], offset[None])[0, 1:]
        unseen = np.maximum(outside - np.maximum(road_slack, 0.0), 0.0)
        more = self._config.road_penalty * (unseen - np.minimum(road_slack, 0.0))
        more -= sets.price(np.minimum(solution.set_slack, 0.0))
        cost = solution.cost + float(spans @ more)
        return _Attempt(solution, plan, sets, float(unseen.max()), cost)

    def _reference(self, s: FloatArray, profile: SpeedProfile) -> Reference:
        """What the stages refer to, beside the arc lengths of a guess."""
        return Reference(
            path=self._path.at(s)[:, :PATH_SIZE],
            velocity=profile.velocity,
            offset=profile.offset,
            station=profile.arclength - self._vehicle.rear_to_centre - s,
            station_weight=profile.station_weight,
            heading=profile.heading,
            heading_weight=profile.heading_weight,
            comfort=profile.comfort,
        )


def _velocity_asked(task: PlanningTask) -> tuple[float, float]:
    """Least and largest velocity, m/s, of the first goal that has no region; of none, any."""
    asked = (goal.velocity for goal in task.goals if goal.region is None)
    return next((velocity for velocity in asked if velocity is not None), _ANY_VELOCITY)


def _report(attempts: list[_Attempt], best: _Attempt | None, decision: Decision) -> SolveReport:
    """Times and iterations of all attempts of a cycle, and the rest of the best one."""
    if best is None:
        return SolveReport(waits_for=decision.reason, decision=decision.words)
    solution = best.solution
    touched = best.sets.touched(solution.set_slack, _SEEN)
    return SolveReport(
        status=solution.status,
        iterations=sum(attempt.solution.iterations for attempt in attempts),
        seconds=sum(attempt.solution.seconds for attempt in attempts),
        slack=float(solution.set_slack.max()),
        road_slack=best.road_slack,
        active_ids=tuple(i for i in touched if i != BARRIER_ID),
        waits_for=decision.reason,
        decision=decision.words,
    )


def _plan(observation: Observation, guess: Guess, report: SolveReport) -> Plan:
    states = guess.states[:, :EGO_SIZE].copy()
    states[0] = observation.ego
    return Plan(states=states, inputs=guess.inputs, report=report)


def _end_of_road(route: Route, road_map: RoadMap, start: float) -> float:
    """Arc length, m, at which a route's path first leaves the road after some arc length."""
    begin = int(np.searchsorted(route.arclength, start))
    off = ~shapely.contains_xy(road_map.drivable, route.path[begin:])
    return float(route.arclength[begin + int(np.argmax(off))]) if off.any() else np.inf


def _previous_acceleration(observation: Observation) -> float:
    """Acceleration of the last step; zero at the start, where it is not known."""
    history = observation.ego_history[:, EGO_VELOCITY]
    if len(history) < 2 or not np.isfinite(history[-2]):
        return 0.0
    return float((history[-1] - history[-2]) / observation.dt)
