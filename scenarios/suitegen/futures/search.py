"""A search, with the true future, for a drive that solves a scenario: the proof that one exists.

Along a few paths (``paths``), the distance driven is planned over time: segments of constant
acceleration, half a second each, between states of distance and velocity; of the states in a
cell of distance and velocity the cheapest is kept. Where the ego's rectangle would come too near to
a road user, leave the road, pass a line that is closed or be too fast, a state is not kept. What
is found is driven with the vehicle model and steered along the path; the drive is then judged
exactly, by dosplan's own scorer among others. What is wrong with it is forbidden, and the search
goes on. Where nothing is found, that is no proof that there is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from scipy.spatial import cKDTree

from dosplan.geometry import PathFollower, ReferencePath, rectangle_corners, wrap_angle
from dosplan.scoring.bounds import outside
from dosplan.scoring.collision import contacts, overlap_window
from dosplan.scoring.score import score
from dosplan.types import (
    EGO_STEERING,
    EGO_VELOCITY,
    STEP_SECONDS,
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    Outcome,
    PlanningTask,
    Scenario,
    Score,
    StopCause,
)
from suitegen.futures.paths import paths
from suitegen.futures.right_of_way import Referee, lights_on_the_way
from suitegen.verdict import recorded_episode

CLEARANCE = 0.15
"""Distance from everybody that is planned, m; what is driven keeps nine tenths of it, at the steps
and between."""
KERB = 0.05
"""Distance that it keeps from the edge of the road, m."""
GENTLE = (1.5, 0.4)
"""What is gently kept free before and behind, and at the sides, where it costs little, m."""
CROSSES = 0.3
"""Sine of the angle to the path from which on a road user crosses it."""
WAY = 0.25
"""Distance between the poses along a path, m."""
SEGMENT = 5
"""Steps with the same acceleration."""
ACCELERATIONS = np.array([-8.0, -6.0, -5.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0])
"""m/s2; in the first segment up to 0.5 more or less, so that its velocity ends on ``GRID``."""
LATERAL = (3.0, 1.5)
"""Lateral accelerations in bends that are tried one after the other, m/s2."""
SHARP = 0.005
"""Curvature from which on a bend may need the second, 1/m."""
GRID = SEGMENT * STEP_SECONDS
"""Velocities after a segment are multiples of this, m/s: the least of the accelerations."""
CELL = 0.5
"""Of the states within this distance, m, with the same velocity the cheapest is kept."""
FADE = 1.5
"""Deceleration at least of an ego that is too fast at the start, m/s2."""
STOOD, WAITED = 1, 5
"""How long an ego has stood before a line: it has; for the patience of the rules (2 s)."""
STANDING, STAND_WITHIN = 0.3, 2.0
"""Speed up to which it stands, m/s, and where: this near before a line, m."""
ROUNDS = 12
"""Searches along one path, each with what was wrong with the drive before forbidden."""


def find_drive(scenario: Scenario, driven: Sequence[FloatArray] = ()) -> FloatArray | None:
    """Looks for a drive that solves a scenario.

    Args:
        scenario: The scenario, whose recording is the future.
        driven: Drives whose paths are worth a try, see ``paths``.

    Returns:
        (K, 4) centre x, y, m, heading, rad, and velocity, m/s, at each step from the start to the
        goal, rounded as the suite's table of drives is; None where none was found.
    """
    referee = Referee(scenario)
    for path in paths(scenario, driven):
        bends = np.abs(path.curvature).max() > SHARP
        for lateral in LATERAL if bends else LATERAL[:1]:
            states = _along(scenario, path, lateral, referee)
            if states is not None:
                return rounded(scenario.task, states)
    return None


def rounded(task: PlanningTask, states: FloatArray) -> FloatArray:
    """A drive as the suite's table holds it.

    Args:
        task: The task.
        states: (K, 5) ego states.

    Returns:
        (K, 4) centre x, y, m, heading, rad, and velocity, m/s, rounded.
    """
    poses = task.vehicle.poses(states)
    return np.column_stack(
        [
            np.round(poses[:, :2], 3),
            np.round(poses[:, 2], 4),
            np.round(states[:, EGO_VELOCITY], 3),
        ]
    )


def scored(scenario: Scenario, drive: FloatArray) -> Score:
    """Scores a drive that is known by its states alone.

    Args:
        scenario: The scenario, whose recording is the future.
        drive: (K, 4) centre x, y, heading and velocity from the start step on.

    Returns:
        Its row.
    """
    return score(scenario, recorded_episode(scenario, drive))


@dataclass(frozen=True)
class _Ribbon:
    """Where the ego is along a path, by the distance that its rear axle has driven.

    Attributes:
        poses: (P, 3) centre x, y, m, and heading, rad, ``WAY`` apart.
        bend: (P,) size of the curvature of the rear axle's way, 1/m.
    """

    poses: FloatArray
    bend: FloatArray

    @classmethod
    def of(cls, task: PlanningTask, states: FloatArray) -> _Ribbon:
        """The ribbon of a drive.

        Args:
            task: The task.
            states: (K, 5) ego states.
        """
        speed = states[:, EGO_VELOCITY]
        driven = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * task.dt)])
        at = np.arange(0.0, driven[-1], WAY)
        poses = task.vehicle.poses(states)
        bend = np.abs(np.tan(states[:, EGO_STEERING])) / task.vehicle.wheelbase
        columns = (*poses.T, bend)
        x, y, heading, curvature = (np.interp(at, driven, column) for column in columns)
        return cls(np.column_stack([x, y, heading]), curvature)


@dataclass(frozen=True)
class _Line:
    """A line of the route.

    Attributes:
        place: Distance after which the ego's front passes it, m; infinite where it never does.
        least: (K,) least velocity at which it may be passed on the way to a step, m/s; infinite
            where it is closed.
        stand: How long the ego has to stand before it, see ``STOOD``.
    """

    place: float
    least: FloatArray
    stand: int = 0

    def bars(
        self, driven: FloatArray, velocity: FloatArray, steps: IntArray, stood: IntArray
    ) -> tuple[BoolArray, IntArray]:
        """Looks where segments pass the line against the rules.

        Args:
            driven: (N, S + 1) distances, m, the begin of the segment first.
            velocity: (N, S) velocities at the S steps of the segment, m/s.
            steps: (S,) these steps of the scenario.
            stood: (N,) how long the ego has stood before the next line.

        Returns:
            (N, S) whether it passes on the way to a step, and (N,) how long it has stood then.
        """
        over = (driven[:, :-1] <= self.place) & (driven[:, 1:] > self.place)
        barred = over & ((velocity < self.least[steps]) | (stood < self.stand)[:, None])
        if not self.stand:
            return barred, stood
        way = self.place - driven[:, 1:]
        stands = (way >= 0.0) & (way <= STAND_WITHIN) & (velocity <= STANDING)
        still = stands[:, -1] & (driven[:, -1] - driven[:, 0] < STANDING * STEP_SECONDS)
        stood = np.where(still, np.minimum(stood + 1, WAITED), stood)
        stood = np.where(stands.any(axis=1), np.maximum(stood, STOOD), stood)
        return barred, np.where(over.any(axis=1), 0, stood)


@dataclass
class _Bans:
    """What is forbidden, as drives before have shown; it grows.

    Attributes:
        places: Steps and distances, m, at which the ego would touch somebody.
        least: See ``_Line``, by the stop's index in the route.
        stand: The same.
    """

    places: list[tuple[int, float]] = field(default_factory=list)
    least: dict[int, FloatArray] = field(default_factory=dict)
    stand: dict[int, int] = field(default_factory=dict)


def _along(
    scenario: Scenario, path: ReferencePath, lateral: float, referee: Referee
) -> FloatArray | None:
    """Looks for a drive along a path, bends taken with a lateral acceleration: (K, 5) states."""
    task = scenario.task
    follower = PathFollower(path, task.vehicle, task.dt)
    reach = _reach(task, path)
    bans = _Bans(least=dict(lights_on_the_way(scenario)))
    for number, stop in enumerate(task.route.stops):
        bans.stand[number] = STOOD if stop.cause is StopCause.STOP_SIGN else 0
    clearance = _clearance(scenario)
    crowd: _Crowd | None = None
    accelerations, patience = np.zeros(0), 3
    for _ in range(ROUNDS):
        states = _follow(follower, task.start, accelerations, reach, lateral)
        ribbon = _Ribbon.of(task, states)
        if crowd is None or not crowd.fits(ribbon):
            crowd = _Crowd.of(scenario, ribbon, clearance)
        found = _space(scenario, ribbon, crowd, lateral, bans, referee).plan()
        if found is None:
            return None
        accelerations = found
        states = _follow(follower, task.start, accelerations, 0.0, lateral)
        if _mend(scenario, states, clearance, bans, referee):
            continue
        if _solves(scenario, states):
            return states
        patience -= 1  # The ego is not where it was thought to be; the next ribbon knows.
        if not patience:
            return None
    return None


def _reach(task: PlanningTask, path: ReferencePath) -> float:
    """How far along a path to look, m: past every goal."""
    begin = float(path.locate(task.start[:2]))
    regions = [goal.region for goal in task.goals if goal.region is not None]
    if not regions:
        return 30.0 * (task.final_step - task.start_step) * task.dt
    ends = [float(path.locate(shapely.get_coordinates(x)).max()) for x in regions]
    return max(max(ends) - begin, 0.0) + 5.0


def _follow(
    follower: PathFollower,
    start: FloatArray,
    accelerations: FloatArray,
    reach: float,
    lateral: float,
) -> FloatArray:
    """Drives along a path: as told, and then on at an even speed until ``reach`` m are driven."""
    path, vehicle, dt = follower.path, follower.vehicle, follower.dt
    states, driven, step = [start], 0.0, 0
    even = max(4.0, float(start[EGO_VELOCITY]))
    while step < len(accelerations) or (driven < reach and step < 1500):
        state = states[-1]
        s, velocity = float(path.locate(state[:2])), float(state[EGO_VELOCITY])
        if step < len(accelerations):
            acceleration = accelerations[step]
        else:
            bend = np.abs(path.curvature_at(s + velocity * np.array([0.0, 0.5, 1.0]))).max()
            wanted = max(min(even, float(np.sqrt(lateral / max(bend, 1e-6)))), 2.0)
            acceleration = float(np.clip((wanted - velocity) / 0.5, -4.0, 2.0))
        rate = follower.steering_rate(state, s)
        inputs = vehicle.clip_input(state, np.array([rate, acceleration]), dt)
        states.append(vehicle.step(state, inputs, dt))
        driven += 0.5 * (velocity + float(states[-1][EGO_VELOCITY])) * dt
        step += 1
    return np.stack(states)


def _clearance(scenario: Scenario) -> float:
    """What a drive keeps from others, m: less where somebody is nearer at the start."""
    task, tracks = scenario.task, scenario.tracks
    there = tracks.valid[:, task.start_step]
    if not there.any():
        return CLEARANCE
    ego = shapely.Polygon(rectangle_corners(task.vehicle.poses(task.start), task.vehicle.size))
    others = rectangle_corners(tracks.states[there, task.start_step, :3], tracks.size[there])
    nearest = float(shapely.distance(ego, shapely.polygons(others)).min())
    return min(CLEARANCE, 0.8 * nearest)


@dataclass(frozen=True)
class _Crowd:
    """Which poses along a ribbon others are too near to, at each step from the start on.

    Attributes:
        ribbon: The ribbon.
        hard: (K, P) whether the clearance is not kept.
        near: (K, P) whether somebody is near, see ``GENTLE``.
    """

    ribbon: _Ribbon
    hard: BoolArray
    near: BoolArray

    def fits(self, ribbon: _Ribbon) -> bool:
        """Whether another ribbon is the same within some centimetres."""
        if len(ribbon.poses) > len(self.ribbon.poses):
            return False
        apart = ribbon.poses - self.ribbon.poses[: len(ribbon.poses)]
        return bool(np.hypot(apart[:, 0], apart[:, 1]).max(initial=0.0) < 0.03)

    @classmethod
    def of(cls, scenario: Scenario, ribbon: _Ribbon, clearance: float) -> _Crowd:
        """Looks at every road user and step.

        Who crosses the path blocks what it sweeps over, half a step before and after.

        Args:
            scenario: The scenario, whose recording is the future.
            ribbon: The ribbon.
            clearance: What is kept, m.
        """
        task, tracks = scenario.task, scenario.tracks
        steps = task.final_step - task.start_step + 1
        hard = np.zeros((steps, len(ribbon.poses)), dtype=np.bool_)
        near = np.zeros_like(hard)
        window = slice(task.start_step, task.final_step + 1)
        user, step = np.nonzero(tracks.valid[:, window])
        states, size = tracks.states[:, window][user, step], tracks.size[user]
        motion = np.abs(states[:, USER_VELOCITY]) * scenario.dt
        reach = 0.5 * np.hypot(*task.vehicle.size) + 0.5 * np.hypot(*size.T) + motion + max(GENTLE)
        found = cKDTree(ribbon.poses[:, :2]).query_ball_point(states[:, :2], reach)
        counts = np.array([len(places) for places in found], dtype=np.int64)
        row = np.repeat(np.arange(len(found)), counts)
        if not len(row):
            return cls(ribbon, hard, near)
        place: IntArray = np.concatenate([np.array(x, dtype=np.int64) for x in found if x])
        heading = states[row, USER_HEADING]
        across = np.abs(np.sin(heading - ribbon.poses[place, 2])) > CROSSES
        shift = np.where(across, states[row, USER_VELOCITY] * scenario.dt, 0.0)[:, None]
        shift = shift * np.column_stack([np.cos(heading), np.sin(heading)])
        pose = np.array(states[row, :3])
        pose[:, :2] -= 0.5 * shift
        ego = np.broadcast_to(np.asarray(task.vehicle.size), (len(row), 2))
        for mask, margin in ((hard, (clearance, clearance)), (near, GENTLE)):
            begin, _ = overlap_window(
                pose, size[row] + 2.0 * np.asarray(margin), ribbon.poses[place], ego, -shift
            )
            hits = begin <= 1.0
            mask[step[row[hits]], place[hits]] = True
        return cls(ribbon, hard, near)


@dataclass(frozen=True)
class _Layer:
    """States at the same step, N of them.

    Attributes:
        parent: (N,) rows of the layer before from which they come.
        acceleration: (N,) with which they come, m/s2.
        driven: (N,) distance, m.
        velocity: (N,) m/s, a multiple of what the accelerations give but at the start.
        cost: (N,) what it has cost until here.
        stood: (N,) how long the ego stands, or has stood, before the next line, see ``STOOD``.
    """

    parent: IntArray
    acceleration: FloatArray
    driven: FloatArray
    velocity: FloatArray
    cost: FloatArray
    stood: IntArray

    def rows(self, chosen: IntArray) -> _Layer:
        """Some of the states."""
        return _Layer(
            self.parent[chosen],
            self.acceleration[chosen],
            self.driven[chosen],
            self.velocity[chosen],
            self.cost[chosen],
            self.stood[chosen],
        )

    def cheapest(self) -> _Layer:
        """Of the states in a cell the cheapest."""
        cell = np.rint(self.driven / CELL).astype(np.int64)
        cell = cell * 1024 + np.rint(self.velocity / GRID).astype(np.int64)
        cell = cell * (WAITED + 1) + self.stood
        order = np.lexsort((self.cost, cell))
        return self.rows(order[np.concatenate([[True], np.diff(cell[order]) != 0])])


@dataclass(frozen=True)
class _Ending:
    """How a goal is reached: from a row of a layer, in some steps with an acceleration."""

    layer: int
    row: int
    acceleration: float
    steps: int
    cost: float


@dataclass(frozen=True)
class _Space:
    """What may be driven along a ribbon, and what it costs.

    Attributes:
        task: The task.
        closed: (K, P) poses where the ego must not be, at each step from the start on.
        near: (K, P) poses where somebody is near.
        allowed: (P,) the fastest, m/s.
        lines: The lines ahead.
        goals: The goals.
        purpose: (P,) the velocity that costs least, m/s.
    """

    task: PlanningTask
    closed: BoolArray
    near: BoolArray
    allowed: FloatArray
    lines: Sequence[_Line]
    goals: Sequence[_Goal]
    purpose: FloatArray

    def plan(self) -> FloatArray | None:
        """The cheapest accelerations, one for each step, that lead to a goal; None without any."""
        none = np.zeros(1, dtype=np.int64)
        start = np.array([self.task.start[EGO_VELOCITY]])
        layers = [_Layer(none, np.zeros(1), np.zeros(1), start, np.zeros(1), none)]
        ending: _Ending | None = None
        total = self.task.final_step - self.task.start_step
        for first in range(0, total, SEGMENT):
            layer, found = self._grow(layers[-1], len(layers) - 1)
            if found is not None and (ending is None or found.cost < ending.cost):
                ending = found
            most = np.inf if ending is None else ending.cost
            cheaper = np.flatnonzero(layer.cost < most)
            if first + SEGMENT >= total or not cheaper.size:
                break
            layers.append(layer.rows(cheaper).cheapest())
        return None if ending is None else _accelerations(layers, ending)

    def _grow(self, layer: _Layer, depth: int) -> tuple[_Layer, _Ending | None]:
        """Drives a segment from all states of a layer with all accelerations."""
        dt, total = self.task.dt, self.task.final_step - self.task.start_step
        steps = depth * SEGMENT + np.arange(1, SEGMENT + 1)
        exists, steps = steps <= total, np.minimum(steps, total)
        row, acceleration = self._choices(layer.velocity)
        time = dt * np.arange(1, SEGMENT + 1)
        begin, speed = layer.driven[row], layer.velocity[row]
        velocity = np.maximum(speed[:, None] + acceleration[:, None] * time, 0.0)
        way = speed[:, None] * time + 0.5 * acceleration[:, None] * time**2
        driven = np.concatenate([begin[:, None], begin[:, None] + way], axis=1)
        place = np.rint(driven[:, 1:] / WAY).astype(np.int64)
        last = self.closed.shape[1] - 1
        bad = place > last
        place = np.minimum(place, last)
        bad |= self.closed[steps, place]
        fading = self.task.start[EGO_VELOCITY] - FADE * dt * steps
        bad |= velocity > np.maximum(self.allowed[place], fading) + 0.03
        stood = layer.stood[row]
        for line in self.lines:
            barred, stood = line.bars(driven, velocity, self.task.start_step + steps, stood)
            bad |= barred
        bad = np.logical_or.accumulate(bad, axis=1)

        price = 0.1 * acceleration[:, None] ** 2 + self.near[steps, place]
        price += ((self.purpose[place] - velocity) / 5.0) ** 2
        spent = layer.cost[row, None] + np.cumsum(dt * price, axis=1)
        hit = np.zeros_like(bad)
        for goal in self.goals:
            hit |= goal.holds(self.task.start_step + steps, place, velocity)
        hit &= ~bad & exists
        ending = None
        if hit.any():
            priced = np.where(hit, spent, np.inf)
            i, step = divmod(int(np.argmin(priced)), SEGMENT)
            a = float(acceleration[i])
            ending = _Ending(depth, int(row[i]), a, step + 1, float(priced[i, step]))
        kept = np.flatnonzero(~bad[:, -1] & ~hit.any(axis=1))
        grown = _Layer(row, acceleration, driven[:, -1], velocity[:, -1], spent[:, -1], stood)
        return grown.rows(kept), ending

    def _choices(self, velocity: FloatArray) -> tuple[IntArray, FloatArray]:
        """Rows of states and accelerations that bring them to a velocity of the grid."""
        later = np.round(velocity / GRID)[:, None] * GRID + ACCELERATIONS * SEGMENT * STEP_SECONDS
        can = later > 0.0
        # One way at least to stand still: the gentlest that ends at or below zero.
        stops = np.maximum(np.sum(later <= 0.0, axis=1) - 1, 0)
        can[np.arange(len(can)), stops] = True
        later = np.maximum(later, 0.0)
        acceleration = (later - velocity[:, None]) / (SEGMENT * STEP_SECONDS)
        can &= acceleration <= 0.9 * self.task.vehicle.engine_acceleration(later)
        row, column = np.nonzero(can)
        return row, acceleration[row, column]


def _accelerations(layers: Sequence[_Layer], ending: _Ending) -> FloatArray:
    """The accelerations that lead to an ending, one for each step."""
    parts, row = [np.full(ending.steps, ending.acceleration)], ending.row
    for layer in layers[ending.layer : 0 : -1]:
        parts.append(np.full(SEGMENT, layer.acceleration[row]))
        row = int(layer.parent[row])
    return np.concatenate(parts[::-1])


def _space(
    scenario: Scenario,
    ribbon: _Ribbon,
    crowd: _Crowd,
    lateral: float,
    bans: _Bans,
    referee: Referee,
) -> _Space:
    """What may be driven along a ribbon."""
    task, count = scenario.task, len(ribbon.poses)
    closed = crowd.hard[:, :count] | outside(
        ribbon.poses, np.add(task.vehicle.size, 2.0 * KERB), scenario.road_map
    )
    for step, driven in bans.places:
        place = round(driven / WAY)
        closed[max(step - 1, 1) : step + 2, max(place - 4, 0) : place + 5] = True
    allowed = _allowed(scenario, ribbon, lateral)
    goals = _goals(scenario, ribbon)
    return _Space(
        task=task,
        closed=closed,
        near=crowd.near[:, :count],
        allowed=allowed,
        lines=_lines(scenario, ribbon, bans, referee),
        goals=goals,
        purpose=np.minimum(allowed, max(float(task.start[EGO_VELOCITY]), _needed(task, goals))),
    )


@dataclass(frozen=True)
class _Goal:
    """A goal along a ribbon: its steps, the poses at which it holds, its velocities, m/s."""

    first: int
    last: int
    poses: BoolArray
    velocity: tuple[float, float]

    def holds(self, steps: IntArray, place: IntArray, velocity: FloatArray) -> BoolArray:
        """(N, S) whether it is reached; a little within its velocities."""
        low, high = self.velocity
        found = self.poses[place] & (velocity >= low + 0.05) & (velocity <= high - 0.05)
        return np.asarray(found & (steps >= self.first) & (steps <= self.last))


def _goals(scenario: Scenario, ribbon: _Ribbon) -> list[_Goal]:
    points, found = shapely.points(ribbon.poses[:, :2]), []
    for goal in scenario.task.goals:
        there = np.ones(len(points), dtype=np.bool_)
        if goal.region is not None:
            inner = goal.region.buffer(-0.3)
            there &= shapely.intersects(goal.region if inner.is_empty else inner, points)
        if goal.heading is not None:
            low, high = goal.heading
            turn = np.abs(wrap_angle(ribbon.poses[:, 2] - 0.5 * (low + high)))
            there &= turn <= 0.5 * (high - low) - 0.01
        velocity = goal.velocity or (-np.inf, np.inf)
        found.append(_Goal(goal.first_step, goal.last_step, there, velocity))
    return found


def _needed(task: PlanningTask, goals: list[_Goal]) -> float:
    """The mean velocity that reaches a goal in the middle of its time, m/s."""
    means = [0.0]
    for goal in goals:
        places = np.flatnonzero(goal.poses)
        steps = 0.5 * (max(goal.first, task.start_step) + goal.last) - task.start_step
        if places.size and steps > 0.0:
            means.append(float(places.mean()) * WAY / (steps * task.dt))
    return max(means)


def _allowed(scenario: Scenario, ribbon: _Ribbon, lateral: float) -> FloatArray:
    """(P,) the fastest that limits and bends allow along a ribbon, m/s."""
    route = scenario.task.route
    at = ReferencePath.of(route).locate(ribbon.poses[:, :2])
    last = len(route.arclength) - 1
    right = np.clip(np.searchsorted(route.arclength, at + 0.5), 0, last)
    left = np.clip(np.searchsorted(route.arclength, at - 0.5) - 1, 0, last)
    limit = np.minimum(route.speed_limit[left], route.speed_limit[right])
    bend = np.sqrt(lateral / np.maximum(ribbon.bend, 1e-6))
    return np.minimum(np.minimum(limit, bend), scenario.task.vehicle.max_velocity)


def _lines(scenario: Scenario, ribbon: _Ribbon, bans: _Bans, referee: Referee) -> list[_Line]:
    """The lines of the route that are still ahead at the start."""
    found = []
    if not scenario.task.route.stops:
        return []
    front = np.maximum.accumulate(referee.front(ribbon.poses))
    for number, stop in enumerate(scenario.task.route.stops):
        past = np.flatnonzero(front > stop.arclength)
        if not past.size or past[0] == 0:
            continue
        low, high = front[past[0] - 1], front[past[0]]
        place = WAY * (past[0] - 1 + (stop.arclength - low) / (high - low))
        least = bans.least.get(number, np.zeros(scenario.task.final_step + 1))
        found.append(_Line(float(place), least, bans.stand[number]))
    return found


def _mend(
    scenario: Scenario, states: FloatArray, clearance: float, bans: _Bans, referee: Referee
) -> bool:
    """Forbids what is wrong with a drive; False where nothing is found that can be forbidden."""
    task = scenario.task
    ego = np.column_stack([task.vehicle.poses(states), states[:, EGO_VELOCITY]])
    size = np.add(task.vehicle.size, 1.8 * clearance)
    touched = next(contacts(ego, size, scenario.tracks, task.start_step), None)
    if touched is not None:
        step = touched.step - task.start_step
        speed = states[:, EGO_VELOCITY]
        driven = float(np.sum(0.5 * (speed[1:] + speed[:-1])[:step]) * task.dt)
        bans.places.append((step, driven))
        return True
    passed = referee.passed(states)
    if passed is None:
        return False
    if passed.edge:
        bans.stand[passed.line] = WAITED
        return True
    least = np.array(bans.least.get(passed.line, np.zeros(task.final_step + 1)))
    least[passed.step - 1 : max(passed.until, passed.step + 1)] = np.inf
    bans.least[passed.line] = least
    return True


def _solves(scenario: Scenario, states: FloatArray) -> bool:
    """Whether dosplan's scorer calls a drive a success, on the road and within the rules."""
    task = scenario.task
    drive = rounded(task, states)
    if outside(drive[:, :3], np.add(task.vehicle.size, KERB), scenario.road_map).any():
        return False
    return solved(scored(scenario, drive), task)


def solved(row: Score, task: PlanningTask) -> bool:
    """Whether a scored drive solves a scenario.

    Args:
        row: Its row.
        task: The task.

    Returns:
        Whether it is a success without a red light, a stop sign or a solid line ignored, and no
        faster than the limit but for an ego that is too fast at the start and slows down.
    """
    measures = row.measures
    broken = ("red_lights", "stop_lines_ignored", "solid_lines")
    if row.outcome is not Outcome.SUCCESS or any(measures.get(name) for name in broken):
        return False
    excess, share = measures.get("max_overspeed") or 0.0, measures.get("time_over_limit") or 0.0
    return share * (row.steps + 1) * task.dt <= (excess / FADE + 0.2 if share else 0.0)
