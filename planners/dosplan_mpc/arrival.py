"""The last metres into a goal: a drive that meets it is looked for where the plan misses it.

A goal asks for a place, a heading, a velocity and a time at once. The optimal control problem is
drawn towards each of them by a price, and may end a degree beside. So, where the deadline is
within the horizon and no state of the plan meets the goal, short drives are tried: a steering angle
that is turned to, later another one, and an acceleration. One that meets the goal, keeps the road
and enters no set is driven instead, for as long as it does. The same where the plan enters a goal's
region whose heading is not that of the lane and does not take it up: behind the region, there is no
way back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import rectangle_corners, wrap_angle
from dosplan.types import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_STEERING,
    EGO_VELOCITY,
    BoolArray,
    FloatArray,
    GoalState,
    IntArray,
    PlanningTask,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import ArrivalSettings
from dosplan_mpc.obstacles import ForbiddenSets
from dosplan_mpc.sampler import Sampler
from dosplan_mpc.stage import ACCELERATION, PREVIOUS_ACCELERATION, STATE_SIZE

_LOOKED_AT: Final = 24  # Drives, in the order of their cost, whose road and sets are looked at.
_FAR: Final = 10  # Steps to the deadline from which on not every cycle is worth a search,
_PAUSE: Final = 3  # but one in so many, where the last one found nothing.
_EVASIVE: Final = 1.0  # Normalised distance from a set that a drive keeps.


@dataclass(frozen=True)
class Arrival:
    """A drive into a goal.

    Attributes:
        states: (N + 1, 6) states of the optimal control problem.
        inputs: (N, 2) steering rate, rad/s, and acceleration, m/s2.
        step: Step of the first state.
    """

    states: FloatArray
    inputs: FloatArray
    step: int


class Arrivals:
    """Looks for arrivals in one episode."""

    def __init__(
        self,
        settings: ArrivalSettings,
        task: PlanningTask,
        turned: Sequence[GoalState],
        road: shapely.Geometry,
        vehicle: VehicleParameters,
        sampler: Sampler,
    ) -> None:
        """Keeps the goals.

        Args:
            settings: What is tried.
            task: Its goals.
            turned: Those of them whose heading is not that of the path.
            road: Area that the ego keeps, m; prepared.
            vehicle: The ego.
            sampler: Knows the ego's discs.
        """
        self._settings = settings
        self._goals = task.goals
        self._turned = turned
        self._road = road
        self._vehicle = vehicle
        self._sampler = sampler
        self._dt = task.dt
        self._kept: Arrival | None = None
        self._missed = -_PAUSE

    def instead(
        self,
        plan: FloatArray,
        step: int,
        start: FloatArray,
        sets: ForbiddenSets,
        fastest: float,
    ) -> Arrival | None:
        """A drive that meets a goal, where the plan does not and has not the time to.

        Args:
            plan: (N + 1, 5 or more) planned states, the present one first.
            step: Present step.
            start: (6,) present state and previous acceleration.
            sets: Forbidden sets at the N steps.
            fastest: Velocity that the drive may not exceed, unless it begins faster, m/s.

        Returns:
            The drive; None where the plan meets a goal, where there is still time beyond it and
            the way into a turned one is not begun, or where none is found.
        """
        horizon = len(plan) - 1
        due = [goal for goal in self._goals if step <= goal.last_step <= step + horizon]
        kept, self._kept = self._kept, None
        if len(due) < len([goal for goal in self._goals if goal.last_step >= step]):
            due = [
                goal
                for goal in self._turned
                if goal.last_step >= step
                and (kept is not None or self._is_entered(goal, plan, step))
            ]
        if not due:
            return None
        until = min(horizon, max(goal.last_step for goal in due) - step)
        quickest = max(fastest, float(start[EGO_VELOCITY]))
        if kept is not None:  # What was found is driven to its end: no other plan knows of it.
            passed = step - kept.step
            tried = (
                _later(kept.states[1:, EGO_STEERING], passed),
                _later(kept.inputs[:, ACCELERATION], passed),
            )
            self._kept = self._best(start, tried, until, step, due, sets, quickest)
        if self._kept is not None:
            return self._kept
        if self._meets(plan, step, due, 0.0).any() or not self._within_reach(start, step, due):
            return None
        if until > _FAR and step < self._missed + _PAUSE:
            return None
        tried = self._tried(float(start[EGO_STEERING]), horizon, until)
        self._kept = self._best(start, tried, until, step, due, sets, quickest)
        if self._kept is None:
            self._missed = step
        return self._kept

    def _best(
        self,
        start: FloatArray,
        tried: tuple[FloatArray, FloatArray],
        until: int,
        step: int,
        goals: list[GoalState],
        sets: ForbiddenSets,
        fastest: float,
    ) -> Arrival | None:
        """The calmest of some drives that meets a goal, keeps the road and enters no set.

        Args:
            start: (6,) present state and previous acceleration.
            tried: (C, N) steering angles, rad, and accelerations, m/s2.
            until: Steps until the deadline.
            step: Present step.
            goals: The goals.
            sets: Forbidden sets at the N steps.
            fastest: Velocity that the drive may not exceed, m/s.
        """
        steering, wanted = tried
        # Nothing after the deadline tells one drive from another.
        states, inputs = self._drive(start, steering[:, :until], wanted[:, :until])
        meets = self._meets(states, step, goals, self._settings.margin)
        meets[:, 0] = False
        meets &= np.maximum.accumulate(states[..., EGO_VELOCITY], axis=1) <= fastest
        candidates = np.flatnonzero(meets.any(axis=1))
        first = meets.argmax(axis=1)
        driven = np.arange(until) < first[:, None]
        lateral = self._vehicle.lateral_acceleration(
            states[:, 1:, EGO_VELOCITY], states[:, 1:, EGO_STEERING]
        )
        cost = (driven * (inputs[..., ACCELERATION] ** 2 + lateral**2)).sum(axis=1)
        order = candidates[np.argsort(cost[candidates], kind="stable")]
        if len(order):
            order = order[self._corners_keep(states[order], first[order])]
        for index in order[:_LOOKED_AT]:
            steps = int(first[index])
            if self._is_free(states[index, : steps + 1], sets):
                later = slice(index, index + 1), slice(until, None)
                beyond = self._drive(states[index, -1], steering[later], wanted[later])
                return Arrival(
                    np.vstack([states[index], beyond[0][0, 1:]]),
                    np.vstack([inputs[index], beyond[1][0]]),
                    step,
                )
        return None

    def _is_entered(self, goal: GoalState, plan: FloatArray, step: int) -> bool:
        """Whether a plan enters a goal's region, and some of its time is within the horizon."""
        if goal.region is None or not goal.first_step - len(plan) < step <= goal.last_step:
            return False
        centre = self._vehicle.centre(plan)
        return bool(shapely.contains_xy(goal.region, centre[:, 0], centre[:, 1]).any())

    def _within_reach(self, start: FloatArray, step: int, goals: list[GoalState]) -> bool:
        """Whether a goal's region is not farther than can be driven until its deadline."""
        centre = shapely.Point(self._vehicle.centre(start[:EGO_SIZE]))
        for goal in goals:
            seconds = (goal.last_step - step) * self._dt
            way = start[EGO_VELOCITY] * seconds + 0.5 * self._vehicle.max_acceleration * seconds**2
            if goal.region is None or shapely.distance(goal.region, centre) <= way:
                return True
        return False

    def _meets(
        self, states: FloatArray, step: int, goals: list[GoalState], margin: float
    ) -> BoolArray:
        """(..., N + 1) whether states from now on meet one of some goals.

        Args:
            states: (..., N + 1, 5 or more).
            step: Step of the first of them.
            goals: The goals.
            margin: Share of each interval that is kept from its ends.
        """
        steps = step + np.arange(states.shape[-2])
        met = np.zeros(states.shape[:-1], dtype=np.bool_)
        for goal in goals:
            now = np.broadcast_to((steps >= goal.first_step) & (steps <= goal.last_step), met.shape)
            now = now.copy()
            if goal.heading is not None:
                low, high = goal.heading
                turned = wrap_angle(states[..., EGO_HEADING] - 0.5 * (low + high))
                now &= np.abs(turned) <= (0.5 - margin) * (high - low)
            if goal.velocity is not None:
                low, high = goal.velocity
                kept = margin * (high - low)
                velocity = states[..., EGO_VELOCITY]
                now &= (velocity >= low + kept) & (velocity <= high - kept)
            if goal.region is not None and now.any():
                centre = self._vehicle.centre(states[now])
                now[now] = shapely.contains_xy(goal.region, centre[..., 0], centre[..., 1])
            met |= now
        return met

    def _tried(self, steering: float, horizon: int, until: int) -> tuple[FloatArray, FloatArray]:
        """(C, N) steering angles, rad, and accelerations, m/s2, that are tried.

        Args:
            steering: Present angle, rad.
            horizon: Number N of steps.
            until: Step of the deadline; whoever turns the wheel after it does not count as another.
        """
        settings, limit = self._settings, self._vehicle.max_steering
        angles = [*np.linspace(-limit, limit, settings.angles), steering]
        switches = [step for step in settings.switches if step < until]
        turns = [(a, b, step) for a, b in product(angles, angles) if a != b for step in switches]
        turns += [(angle, angle, 0) for angle in angles]
        first, second, switch, acceleration = np.array(
            [(*turn, acceleration) for turn in turns for acceleration in settings.accelerations]
        ).T
        steps = np.arange(horizon)
        angle = np.where(steps < switch[:, None], first[:, None], second[:, None])
        wanted = np.tile(acceleration[:, None], (1, horizon))
        return angle, wanted

    def _drive(
        self, start: FloatArray, steering: FloatArray, wanted: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(C, T + 1, 6) states and (C, T, 2) inputs of angles and accelerations (C, T)."""
        vehicle, dt = self._vehicle, self._dt
        count, steps = steering.shape
        states, inputs = np.empty((count, steps + 1, STATE_SIZE)), np.empty((count, steps, 2))
        states[:, 0] = start
        for k in range(steps):
            state = states[:, k, :EGO_SIZE]
            asked = np.column_stack([(steering[:, k] - state[:, EGO_STEERING]) / dt, wanted[:, k]])
            inputs[:, k] = vehicle.clip_input(state, asked, dt)
            states[:, k + 1, :EGO_SIZE] = vehicle.step(state, inputs[:, k], dt)
            states[:, k + 1, PREVIOUS_ACCELERATION] = inputs[:, k, ACCELERATION]
        return states, inputs

    def _corners_keep(self, states: FloatArray, steps: IntArray) -> BoolArray:
        """(C,) whether the corners of drives are on the road at all of their steps.

        A quick look at all of them; edges may still reach in between the corners.
        """
        last = int(steps.max())
        poses = self._vehicle.poses(states[:, 1 : last + 1, :EGO_SIZE])
        corners = rectangle_corners(poses, self._vehicle.size)
        inside = shapely.contains_xy(self._road, corners[..., 0], corners[..., 1]).all(axis=-1)
        return np.asarray((inside | (np.arange(last) >= steps[:, None])).all(axis=1))

    def _is_free(self, states: FloatArray, sets: ForbiddenSets) -> bool:
        """Whether a drive keeps the road and enters no set."""
        poses = self._vehicle.poses(states[1:, :EGO_SIZE])
        outlines = shapely.polygons(rectangle_corners(poses, self._vehicle.size))
        if not shapely.covers(self._road, outlines).all():
            return False
        if not len(sets.ids):
            return True
        steps = len(states) - 1
        discs = self._sampler.disc_centres(states[1:])
        return bool((sets.at(slice(steps)).distance(discs) >= _EVASIVE).all())


def _later(values: FloatArray, steps: int) -> FloatArray:
    """(1, N) values some steps later, the last one held."""
    held = np.minimum(np.arange(len(values)) + steps, len(values) - 1)
    return np.asarray(values[held])[None]
