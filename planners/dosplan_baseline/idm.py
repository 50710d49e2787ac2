"""``idm-v4``: the Intelligent Driver Model along the route.

Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62, 2000; the free-road term and the figures are those of Treiber,
Kesting, "Traffic Flow Dynamics", 2013, sec. 11.3.7 and table 11.2 (city traffic).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from dosplan.api import Planner
from dosplan.geometry import (
    PathFollower,
    ReferencePath,
    StopRules,
    StopSettings,
    braking_envelope,
    extended_path,
    rectangle_corners,
    set_sizes,
)
from dosplan.types import (
    EGO_VELOCITY,
    FloatArray,
    GoalState,
    Observation,
    Occupancy,
    Plan,
    PlanningTask,
    RoadMap,
    SolveReport,
)
from dosplan.types.checks import check_numbers
from dosplan.vehicle import VehicleParameters
from dosplan_baseline.tracking import PLAN_STEPS, bend_speed

_UNLIMITED = 100.0  # m/s; stands for no speed limit.
_BESIDE = 5.0  # m; a region that is farther off the path is not come by.


@dataclass(frozen=True)
class IdmSettings:
    """The options of the model and of what surrounds it.

    Attributes:
        time_gap: Time gap to a leader, s.
        least_gap: Gap at a standstill, m.
        acceleration: Acceleration on a free road, m/s2.
        deceleration: Comfortable deceleration, m/s2.
        exponent: How late the acceleration falls off as the desired velocity comes near.
        full_braking: Largest deceleration, m/s2.
        lateral_acceleration: Lateral acceleration in bends, m/s2.
        least_velocity: Smallest desired velocity, m/s; at zero a vehicle would never arrive.
        side_margin: Distance that is added on either side of the ego to give its corridor, m.
        goal_margin: Distance from either end of the goal's region that is aimed at, m.
        searched_steps: Predicted steps in which a leader is looked for; the default is the time
            gap.
        limit_factor: How many times the map's speed limit it drives at the most.
        limit_first: Whether it keeps that where it is late for its goal.
        stops: When it stops for lights, signs and crosswalks.
    """

    time_gap: float = 1.0
    least_gap: float = 2.0
    acceleration: float = 1.0
    deceleration: float = 1.5
    exponent: float = 4.0
    full_braking: float = 8.0
    lateral_acceleration: float = 3.0
    least_velocity: float = 1.0
    side_margin: float = 0.2
    goal_margin: float = 2.0
    searched_steps: int = 10
    limit_factor: float = 1.0
    limit_first: bool = False
    stops: StopSettings = StopSettings()

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive={
                *("acceleration", "deceleration", "exponent", "full_braking"),
                *("lateral_acceleration", "least_velocity", "searched_steps", "limit_factor"),
            },
        )


@dataclass(frozen=True)
class Leaders:
    """Road users in the way, as they would be at the present if their speed along the path held.

    Attributes:
        rear: (L,) arc length of their nearest point, m.
        velocity: (L,) velocity along the path, m/s, negative of who comes towards the ego.
    """

    rear: FloatArray
    velocity: FloatArray

    def with_standing(self, rear: float) -> Leaders:
        """These and one that stands.

        Args:
            rear: Arc length of its nearest point, m.

        Returns:
            All of them.
        """
        return Leaders(np.append(self.rear, rear), np.append(self.velocity, 0.0))


def idm_acceleration(
    velocity: float,
    desired: float,
    gap: FloatArray,
    leader_velocity: FloatArray,
    settings: IdmSettings,
) -> float:
    """Acceleration of the model, for the leader that asks for the hardest braking.

    Args:
        velocity: Own velocity, m/s.
        desired: Desired velocity, m/s, positive.
        gap: (L,) bumper-to-bumper gaps, m; L may be 0.
        leader_velocity: (L,) m/s.
        settings: The figures of the model.

    Returns:
        m/s2, at least ``-settings.full_braking``.
    """
    most, comfortable = settings.acceleration, settings.deceleration
    velocity = max(velocity, 0.0)  # Braking to a stop, rounding can leave a little less.
    if velocity <= desired:
        free = most * (1.0 - (velocity / desired) ** settings.exponent)
    else:
        power = most * settings.exponent / comfortable
        free = -comfortable * (1.0 - (desired / velocity) ** power)
    closing = velocity * (velocity - leader_velocity)
    dynamic = velocity * settings.time_gap + closing / (2.0 * np.sqrt(most * comfortable))
    ratio = (settings.least_gap + np.maximum(dynamic, 0.0)) / np.maximum(gap, 0.1)
    return float(max(free - most * np.max(ratio**2, initial=0.0), -settings.full_braking))


def find_leaders(
    path: ReferencePath,
    ego: float,
    observation: Observation,
    occupancy: Occupancy,
    vehicle: VehicleParameters,
    settings: IdmSettings,
) -> Leaders:
    """Road users whose set, with their footprint, enters the ego's corridor within a time gap.

    Each of the next steps is searched. The stretch that a set blocks is moved back to the present
    by the distance that its road user covers along the path until then. So a leader at constant
    speed has the same gap at every step, and one that cuts in is found before it does.

    Args:
        path: The ego's path.
        ego: Arc length of the ego's centre, m.
        observation: What is known now.
        occupancy: The sets of the road users of ``observation``.
        vehicle: The ego.
        settings: How wide and how far ahead to look.

    Returns:
        Every road user and step that blocks the corridor ahead of the ego.
    """
    sets, rows, _ = occupancy.by_component()
    steps = min(settings.searched_steps, sets.horizon)
    valid = sets.valid[:, :steps]
    corners = set_corners(sets, steps)
    s = path.locate(corners, ego)
    lateral = path.offset(corners, s)
    side = 0.5 * vehicle.width + settings.side_margin
    blocks = valid & (lateral.min(axis=-1) < side) & (lateral.max(axis=-1) > -side)

    now = path.locate(observation.present[rows, :2], ego)
    then = path.locate(corners.mean(axis=-2), ego)
    way = then - now[:, None]
    time = observation.dt * np.arange(1, steps + 1)
    chosen = blocks & (now > ego)[:, None]
    return Leaders(rear=(s.min(axis=-1) - way)[chosen], velocity=(way / time)[chosen])


def set_corners(occupancy: Occupancy, steps: int) -> FloatArray:
    """Corners of the rectangles of ``geometry.set_sizes``.

    Args:
        occupancy: The sets of N road users.
        steps: Number S of steps.

    Returns:
        (N, S, 4, 2) corners, m; around the origin where the occupancy is not valid.
    """
    poses = np.concatenate(
        [occupancy.centre[:, :steps], occupancy.heading[:, :steps, None]], axis=-1
    )
    poses = np.where(occupancy.valid[:, :steps, None], poses, 0.0)
    return rectangle_corners(poses, set_sizes(occupancy, steps))


class IdmEpisode:
    """Plans the cycles of one episode."""

    def __init__(
        self, settings: IdmSettings, task: PlanningTask, vehicle: VehicleParameters
    ) -> None:
        """Prepares the path, the speed its bends allow and the way to each goal.

        Args:
            settings: The options.
            task: Start, goal and route.
            vehicle: The ego's parameters.
        """
        path = extended_path(task.route)
        self._settings = settings
        self._follower = PathFollower(path, vehicle, task.dt)
        self._bends = bend_speed(path, settings.lateral_acceleration, settings.deceleration)
        legal = np.minimum(settings.limit_factor * task.route.speed_limit, _UNLIMITED)
        self._legal = braking_envelope(legal**2, task.route.arclength, settings.deceleration)
        self._route_arclength = task.route.arclength
        self._rules = StopRules(task, settings.stops)
        self._start_velocity = float(task.start[EGO_VELOCITY])
        self._place = path.locate_first(vehicle.centre(task.start))
        goals = [(goal, _extent(goal, path, settings.goal_margin)) for goal in task.goals]
        on_path = [pair for pair in goals if _is_beside(pair[0], path)]
        self._goals = on_path or goals

    def plan(self, observation: Observation, occupancy: Occupancy, steps: int) -> Plan:
        """Rolls the model out behind leaders that keep their speed.

        Args:
            observation: What is known now.
            occupancy: What the leaders are found in.
            steps: How far; a longer plan begins like a shorter one.

        Returns:
            The plan.
        """
        settings, vehicle, dt = self._settings, self._follower.vehicle, observation.dt
        path = self._follower.path
        self._place = centre = path.track(vehicle.centre(observation.ego), self._place)
        leaders = find_leaders(path, centre, observation, occupancy, vehicle, settings)
        desired = self.desired_velocity(observation.step, centre)
        needed = 0.0 if settings.limit_first else self.needed_velocity(observation.step, centre)
        front = vehicle.rear_to_centre + 0.5 * vehicle.length
        wait = self._rules.wait(observation, occupancy, centre + 0.5 * vehicle.length)
        if wait is not None:
            # A line is a standing leader, so far behind it that the gap ends at the place.
            leaders = leaders.with_standing(wait.place + settings.least_gap)

        def allowed(s: float) -> tuple[float, float]:
            """What bends and the map allow with the rear axle there, m/s."""
            legal = np.interp(s + vehicle.rear_to_centre, self._route_arclength, self._legal)
            return float(np.interp(s, *self._bends)), max(needed, float(legal))

        def acceleration(step: int, s: float, velocity: float) -> float:
            gap = leaders.rear + leaders.velocity * step * dt - (s + front)
            target = max(min(desired, *allowed(s)), settings.least_velocity)
            law = idm_acceleration(velocity, target, gap, leaders.velocity, settings)
            # The model brakes too gently for a desired velocity that falls.
            in_bend, legal = (
                (max(limit, settings.least_velocity) - velocity) / dt
                for limit in allowed(s + velocity * dt)
            )
            law = min(law, max(legal, -settings.deceleration))
            return min(law, max(in_bend, -settings.full_braking))

        plan = self._follower.roll_out(observation.ego, acceleration, steps, centre)
        if wait is None:
            return plan
        return replace(plan, report=SolveReport(waits_for=wait.reason))

    def needed_velocity(self, now: int, s: float) -> float:
        """The least mean speed that brings the ego to its goal before the deadline.

        Args:
            now: Present step.
            s: Arc length of the ego's centre, m.

        Returns:
            m/s; not positive where it is there.
        """
        goal, (near, _) = self._next_goal(now, s)
        return (near - s) / ((max(goal.last_step, now + 1) - now) * self._follower.dt)

    def desired_velocity(self, now: int, s: float) -> float:
        """The start's speed, changed only as far as the goal's region, time and speed require.

        Args:
            now: Present step.
            s: Arc length of the ego's centre, m.

        Returns:
            m/s.
        """
        goal, (near, far) = self._next_goal(now, s)
        window = max(goal.first_step, now + 1), max(goal.last_step, now + 1)
        time = (0.5 * sum(window) - now) * self._follower.dt
        on_time = float(np.clip(self._start_velocity, (near - s) / time, (far - s) / time))
        return float(np.clip(on_time, *(goal.velocity or (0.0, np.inf))))

    def _next_goal(self, now: int, s: float) -> tuple[GoalState, tuple[float, float]]:
        """The goal that asks for the least speed, of those that are left; and where it is.

        Left are those beside the path whose time is not over, and that are not passed; the last
        goal where there is none.

        Args:
            now: Present step.
            s: Arc length of the ego's centre, m.

        Returns:
            The goal, and the arc lengths at which it begins and ends, m.
        """
        left = [pair for pair in self._goals if pair[0].last_step > now and pair[1][1] > s]
        return min(
            left,
            key=lambda pair: max(pair[1][0] - s, 0.0) / (pair[0].last_step - now),
            default=self._goals[-1],
        )


class IdmPlanner(Planner):
    """Follows the route, the goal's deadline and the leader."""

    name = "idm-v4"
    settings = IdmSettings
    plan_steps: int = PLAN_STEPS

    def __init__(self, *, seed: int = 0, settings: IdmSettings = IdmSettings()) -> None:
        """Keeps the settings.

        Args:
            seed: Seed of the run; nothing here is random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self._settings = settings
        self._episode: IdmEpisode | None = None

    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        """Begins an episode."""
        self._episode = IdmEpisode(self._settings, task, vehicle)

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        """Plans one cycle.

        Args:
            observation: What is known now.
            occupancy: What the leaders are found in.

        Returns:
            The plan.

        Raises:
            RuntimeError: No episode has begun.
        """
        if self._episode is None:
            raise RuntimeError("no episode has begun: reset comes before plan")
        return self._episode.plan(observation, occupancy, self.plan_steps)


def _is_beside(goal: GoalState, path: ReferencePath) -> bool:
    """Whether the path comes by a goal's region; one without a region is anywhere."""
    if goal.region is None:
        return True
    return bool(shapely.dwithin(goal.region, shapely.LineString(path.points), _BESIDE))


def _extent(goal: GoalState, path: ReferencePath, most: float) -> tuple[float, float]:
    """First and last arc length of a goal's region, a little inside; infinite without one.

    Where the path comes by it more than once, those of the last time.
    """
    if goal.region is None:
        return -np.inf, np.inf
    inside = np.flatnonzero(shapely.intersects_xy(goal.region, *path.points.T))
    last = float(path.arclength[inside[-1]]) if inside.size else None
    s = path.locate(shapely.get_coordinates(goal.region), last)
    margin = min(most, 0.25 * float(np.ptp(s)))
    return float(s.min()) + margin, float(s.max()) - margin
