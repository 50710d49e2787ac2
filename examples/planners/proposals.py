"""A small planner of the kind that leads nuPlan: proposals along the route, scored.

After PDM-Closed (Dauner et al., "Parting with Misconceptions about Learning-based Vehicle Motion
Planning", CoRL 2023): the Intelligent Driver Model is rolled out at several desired speeds and
lateral offsets, and the proposal with the best score is driven. Its obstacles are the sets.

    dosplan run --planner examples/planners/proposals.py:ProposalPlanner --limit 10
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.api import Planner
from dosplan.geometry import (
    PATH_HEADING,
    PATH_SIZE,
    PATH_X,
    PATH_Y,
    EvenPath,
    StopRules,
    Wait,
    rectangles_overlap,
    set_sizes,
    wrap_angle,
)
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
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

SPEED, LEFT, RIGHT = PATH_SIZE, PATH_SIZE + 1, PATH_SIZE + 2
"""Columns that the path has beside its own: desired speed, m/s, and edges of the lane, m."""
STOP: Final = -1.0
"""Share of the desired speed that stands for full braking."""


@dataclass(frozen=True)
class ProposalSettings:
    """The options.

    Attributes:
        steps: Steps of a proposal.
        speeds: Shares of the desired speed.
        offset: Lateral offset of the outer proposals, m.
        speed: Desired speed where the map has no limit, m/s.
        lateral: Lateral acceleration in bends, m/s2.
        time_gap: Of the Intelligent Driver Model, s.
        gap: Likewise, m.
        braking: Likewise, comfortable, m/s2.
        clearance: Added to length and width of the sets, m.
    """

    steps: int = 30
    speeds: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
    offset: float = 0.8
    speed: float = 15.0
    lateral: float = 3.0
    time_gap: float = 1.0
    gap: float = 2.0
    braking: float = 3.0
    clearance: float = 0.3

    def __post_init__(self) -> None:
        if not 1 <= self.steps <= 40:
            raise ValueError(f"steps is {self.steps}; a proposal has 1 to 40")
        if not self.speeds:
            raise ValueError("speeds is empty; name a share of the desired speed")


@dataclass(frozen=True)
class Users:
    """R sets over T steps, as the proposals see them.

    Attributes:
        poses: (R, T, 3) centre and heading; NaN where nobody is.
        sizes: (R, T, 2) length and width of all that may be occupied, m.
        rear: (R, T) arc length at which it ends towards the ego; infinite where it is not ahead.
        speed: (R, T) velocity along the path, m/s.
    """

    poses: FloatArray
    sizes: FloatArray
    rear: FloatArray
    speed: FloatArray


class ProposalPlanner(Planner):
    """Rolls out the Intelligent Driver Model and drives the best of the proposals."""

    name = "proposals-v1"
    settings = ProposalSettings

    def __init__(self, *, seed: int = 0, settings: ProposalSettings = ProposalSettings()) -> None:
        super().__init__(seed=seed, settings=settings)
        self.look_ahead = self.plan_steps = settings.steps
        offsets = (0.0, -settings.offset, settings.offset)
        self.share = np.append(np.repeat(settings.speeds, len(offsets)), STOP)
        self.offset = np.append(np.tile(offsets, len(settings.speeds)), 0.0)

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        route, chosen = task.route, self.settings
        limit = np.where(np.isfinite(route.speed_limit), route.speed_limit, chosen.speed)
        limit = np.maximum(limit, float(task.start[EGO_VELOCITY]))
        bend = np.sqrt(chosen.lateral / np.maximum(np.abs(route.curvature), 1e-3))
        self.path = EvenPath(
            route.arclength,
            route.path,
            route.heading,
            route.curvature,
            [np.minimum(limit, bend), route.left, route.right],
        )
        self.vehicle = vehicle
        self.stops = StopRules(task)

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        ego, dt, vehicle = observation.ego, observation.dt, self.vehicle
        start = float(self.path.locate(ego[:2]))
        nose = vehicle.length / 2.0 + vehicle.rear_to_centre
        wait = self.stops.wait(observation, occupancy, start + nose)
        users = self.users(occupancy, start)

        state = np.repeat(ego[None], len(self.share), axis=0)
        s = np.full(len(self.share), start)
        states, inputs = [state], []
        for step in range(self.settings.steps):
            s, _ = self.path.project(state[:, :2], s, 1)
            row = self.path.at(s)
            desired = np.maximum(self.share, 0.0) * row[:, SPEED]
            law = self.acceleration(s + nose, state[:, EGO_VELOCITY], desired, users, step, wait)
            wished = np.where(self.share == STOP, -vehicle.max_acceleration, law)
            wish = np.stack([self.steering_rate(state, s), wished], axis=-1)
            inputs.append(vehicle.clip_input(state, wish, dt))
            state = vehicle.step(state, inputs[-1], dt)
            states.append(state)
        driven, given = np.stack(states, axis=1), np.stack(inputs, axis=1)
        best = int(np.argmax(self.score(driven, given, s - start, users)))
        return Plan(
            states=driven[best],
            inputs=given[best],
            report=SolveReport(
                waits_for=wait.reason if wait else None,
                decision=f"{self.share[best]:.1f} of the speed, {self.offset[best]:+.1f} m",
            ),
        )

    def users(self, occupancy: Occupancy, start: float) -> Users:
        """What may be occupied, each component of a set for itself, and what of it is ahead."""
        sets = occupancy.by_component()[0].first_steps(self.settings.steps)
        sizes = set_sizes(sets) + self.settings.clearance
        poses = np.concatenate([sets.centre, sets.heading[..., None]], axis=-1)
        poses = np.where(sets.valid[..., None], poses, np.nan)
        if not sets.valid.size:
            return Users(poses, sizes, np.zeros(sets.valid.shape), np.zeros(sets.valid.shape))
        centre = np.where(sets.valid[..., None], sets.centre, 0.0)
        s = self.path.locate(centre)
        turn = sets.heading - self.path.heading_at(s)
        along, across = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        half_length = 0.5 * (along * sizes[..., 0] + across * sizes[..., 1])
        half_width = 0.5 * (across * sizes[..., 0] + along * sizes[..., 1])
        beside = np.abs(self.path.offset(centre, s)) >= half_width + self.vehicle.width / 2.0
        ahead = sets.valid & ~beside & (s > start + 1.0)
        speed = np.gradient(s, 0.1, axis=1) if s.shape[1] > 1 else np.zeros_like(s)
        return Users(poses, sizes, np.where(ahead, s - half_length, np.inf), np.maximum(speed, 0.0))

    def acceleration(
        self,
        front: FloatArray,
        velocity: FloatArray,
        desired: FloatArray,
        users: Users,
        step: int,
        wait: Wait | None,
    ) -> FloatArray:
        """(M,) m/s2 behind the nearest leader, or before a line, by the model of Treiber (2000)."""
        chosen, rear, speed = self.settings, users.rear[:, step], users.speed[:, step]
        pace = velocity / (2.0 * np.sqrt(2.0 * chosen.braking))
        room = rear - front[:, None]  # (M, R)
        room = np.where(room > -3.0, np.maximum(room, 0.1), np.inf)
        closing = velocity[:, None] - speed
        wanted = chosen.gap + np.maximum(
            0.0, chosen.time_gap * velocity[:, None] + pace[:, None] * closing
        )
        near = np.max((wanted / room) ** 2, axis=1, initial=0.0)
        if wait is not None:
            gap = np.maximum(wait.place - front, 0.1)
            near = np.maximum(near, ((0.1 + velocity * pace) / gap) ** 2)
        free = 1.0 - (velocity / np.maximum(desired, 0.1)) ** 4
        return np.asarray(np.clip(2.0 * (np.maximum(free, -1.5) - near), -6.0, 2.0))

    def steering_rate(self, state: FloatArray, s: FloatArray) -> FloatArray:
        """(M,) rad/s, by pure pursuit of the path, moved sideways within the lane."""
        row = self.path.at(s + np.maximum(5.0, 0.9 * state[:, EGO_VELOCITY]))
        least = row[:, RIGHT] + 1.0
        off = np.clip(self.offset, least, np.maximum(row[:, LEFT] - 1.0, least))
        heading = row[:, PATH_HEADING]
        x = row[:, PATH_X] - np.sin(heading) * off - state[:, 0]
        y = row[:, PATH_Y] + np.cos(heading) * off - state[:, 1]
        angle = wrap_angle(np.arctan2(y, x) - state[:, EGO_HEADING])
        wanted = np.arctan2(2.0 * self.vehicle.wheelbase * np.sin(angle), np.hypot(x, y))
        return np.asarray((wanted - state[:, EGO_STEERING]) / 0.2)

    def score(
        self, states: FloatArray, inputs: FloatArray, way: FloatArray, users: Users
    ) -> FloatArray:
        """(M,) no contact first; then progress, distance, gentleness, and the middle of the lane.

        Of proposals that all meet a set, the one that does so latest and slowest is best.
        """
        steps = inputs.shape[1]
        ego = self.vehicle.poses(states[:, 1:])[:, None]
        hit = self.meets(ego, users, 0.0, 0.0)
        first = np.where(hit.any(axis=1), hit.argmax(axis=1), steps)
        row = np.arange(len(first))
        speed = states[row, np.minimum(first, steps - 1) + 1, EGO_VELOCITY]
        progress = way / max(float(np.max(way)), 1.0)
        rough = np.clip(-inputs[:, :10, 1].min(axis=1) - 3.0, 0.0, 6.0) / 6.0
        close = self.meets(ego, users, 3.0, 0.8).mean(axis=1)
        quality = 5.0 * progress - rough - 0.3 * np.abs(self.offset) - 3.0 * close
        late = 0.2 * first / steps - 0.1 * np.minimum(speed / 20.0, 1.0)
        return np.asarray(np.where(first == steps, 10.0 + quality, late + 0.01 * quality))

    def meets(self, ego: FloatArray, users: Users, longer: float, wider: float) -> FloatArray:
        """(M, T) whether a proposal meets anybody, enlarged, at each step."""
        sizes = users.sizes + np.array([longer, wider])
        return np.asarray(
            rectangles_overlap(ego, self.vehicle.size, users.poses, sizes).any(axis=1)
        )
