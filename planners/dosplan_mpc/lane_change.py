"""The decision for a gap: in front of whom, behind whom and when the ego changes lanes.

Where the route changes lanes and others drive on the lane that it goes to, each gap between them is
an alternative. For each of them a drive of the ego's centre along the path is tried: it goes to the
gap, keeps pace with it, and stays before what blocks its own lane until it has changed. The sets
bound the gaps as they are soon; later ones will have been predicted anew by then. The drive that
costs least becomes the reference: speed, and offset from the path. The gap is kept until the ego
has changed lanes, unless another one is better by a margin or it closes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Self

import numpy as np

from dosplan.geometry import EvenPath, ellipse_extent, side_by_side
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    Lanelet,
    Observation,
    Occupancy,
    RoadMap,
    Route,
)
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.config import GapSettings
from dosplan_mpc.goal_window import GoalWindow
from dosplan_mpc.reference import EgoOnPath
from dosplan_mpc.speed_profile import SpeedLimit, SpeedProfile

_STEP: Final = 0.2  # s; of the drives that are tried.
_KNOTS: Final = 5  # Steps between the predicted places that are looked at.
_INSET: Final = 0.8  # m into a gap that a drive aims at,
_INSET_SHARE: Final = 0.3  # and the same as a share of the gap, where that is less.
_BACK: Final = 0.5  # Share of the way between two lanes below which the ego is on the first one.
_FAR: Final = 1e6  # m; the end of a gap that nobody bounds.


@dataclass(frozen=True)
class LaneChange:
    """A change of lanes of the route.

    Attributes:
        begin: Arc length from which the two lanes run side by side, m.
        until: Arc length up to which they do, m.
        width: Width of the lane that it goes to, m.
    """

    begin: float
    until: float
    width: float
    _before: tuple[FloatArray, FloatArray]
    _after: tuple[FloatArray, FloatArray]

    @classmethod
    def of(
        cls, before: Sequence[Lanelet], after: Sequence[Lanelet], first: int, path: EvenPath
    ) -> Self:
        """Takes its place along a path.

        Args:
            before: Lanelets of the lane that is left, from where the lanes run side by side.
            after: Those of the lane that it goes to, each beside one of ``before``.
            first: Which of them the route changes at.
            path: The route's path.

        Returns:
            The change.
        """
        lines = []
        for lane in (before, after):
            points = np.concatenate([lanelet.centre for lanelet in lane])
            along = path.locate(points)
            order = np.argsort(along, kind="stable")
            lines.append((along[order], path.project(points, along, iterations=1)[1][order]))
        begin = max(float(line[0][0]) for line in lines)
        until = min(float(line[0][-1]) for line in lines)
        edges = after[first].left - after[first].right
        return cls(begin, until, float(np.hypot(*edges.T).mean()), lines[0], lines[1])

    def before(self, arclength: FloatArray | float) -> FloatArray:
        """Offset of the middle of the lane that is left from the path, m."""
        return np.asarray(np.interp(arclength, *self._before))

    def after(self, arclength: FloatArray | float) -> FloatArray:
        """Offset of the middle of the lane that it goes to from the path, m."""
        return np.asarray(np.interp(arclength, *self._after))


def lane_changes(route: Route, road_map: RoadMap, path: EvenPath) -> tuple[LaneChange, ...]:
    """Finds the changes of lanes of a route.

    Args:
        route: The route.
        road_map: The map.
        path: The route's path.

    Returns:
        The changes, in their order.
    """
    lanelets = {lanelet.id: lanelet for lanelet in road_map.lanelets}
    chain = [lanelets[name] for name in route.lanelet_ids if name in lanelets]
    out = []
    for number, (a, b) in enumerate(pairwise(chain), start=1):
        if b.id in a.successors or b.id not in (a.left_neighbour, a.right_neighbour):
            continue
        pairs, first = side_by_side(chain[:number], chain[number:], lanelets)
        before, after = ([pair[i] for pair in pairs] for i in range(2))
        out.append(LaneChange.of(before, after, first, path))
    return tuple(out)


@dataclass(frozen=True)
class Gap:
    """A gap to change into, and the drive into it.

    Attributes:
        behind: Id of the road user behind whom the ego goes, or None at the head of all.
        front: Id of the one in front of whom it goes, or None at the end of all.
        entry: Time from which the ego is beside the gap, s.
        cost: What the drive costs; infinite where it does not get there.
        time: (K,) s from now.
        arclength: (K,) of the ego's centre, m.
        velocity: (K,) m/s.
        change: The change of lanes.
        done: Share of the way from lane to lane that the ego has behind it.
        step: Step of a reference, s.
        settings: How long the change takes, and what being elsewhere costs.
    """

    behind: int | None
    front: int | None
    entry: float
    cost: float
    time: FloatArray
    arclength: FloatArray
    velocity: FloatArray
    change: LaneChange
    done: float
    step: float
    settings: GapSettings

    def is_between(self, other: Gap | None) -> bool:
        """Whether it is between the same road users as another one."""
        return other is not None and (self.behind, self.front) == (other.behind, other.front)

    @property
    def is_open(self) -> bool:
        """Whether the drive gets there in time."""
        return bool(np.isfinite(self.cost))

    @property
    def words(self) -> str:
        """The decision in a few words."""
        sides = [
            f"{word} {name}"
            for word, name in (("behind", self.behind), ("in front of", self.front))
            if name is not None
        ]
        return "change lanes " + " and ".join(sides)

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference into the gap.

        Args:
            profile: The reference without it; its steps begin now.

        Returns:
            The reference: until the gap is beside it, the ego stays where it is between the lanes.
        """
        time = self.step * np.arange(len(profile.velocity))
        arclength = np.interp(time, self.time, self.arclength)
        before = self.change.before(arclength)
        after = self.change.after(arclength) + profile.offset
        left = max(self.settings.seconds * (1.0 - self.done), self.step)
        part = np.clip((time - self.entry) / left, 0.0, 1.0)
        share = self.done + (1.0 - self.done) * part**2 * (3.0 - 2.0 * part)
        return replace(
            profile,
            velocity=np.interp(time, self.time, self.velocity),
            arclength=arclength,
            station_weight=np.full(len(time), self.settings.station_weight),
            offset=before + share * (after - before),
        )


@dataclass(frozen=True)
class OnLane:
    """The ego is on the lane that the route goes to, beside a path that gets there later.

    Attributes:
        change: The change of lanes.
    """

    change: LaneChange

    def lead(self, profile: SpeedProfile) -> SpeedProfile:
        """The reference that keeps the lane.

        Args:
            profile: The reference along the path.

        Returns:
            The reference.
        """
        return replace(profile, offset=profile.offset + self.change.after(profile.arclength))


@dataclass(frozen=True)
class _Users:
    """Road users along the path over the time of a drive.

    Attributes:
        ids: (n,) ids.
        first: (n, K) arc length of their fronts, m.
        last: (n, K) of their rears, m.
        wide: (n, K) what the sets add to both, m.
        speed: (n, K) along the path, m/s.
    """

    ids: IntArray
    first: FloatArray
    last: FloatArray
    wide: FloatArray
    speed: FloatArray


class GapDecision:
    """Decides in every cycle of an episode."""

    def __init__(
        self,
        settings: GapSettings,
        path: EvenPath,
        route: Route,
        road_map: RoadMap,
        windows: Sequence[GoalWindow],
        vehicle: VehicleParameters,
        dt: float,
    ) -> None:
        """Begins an episode.

        Args:
            settings: What a gap has to be like, and what a drive into it costs.
            path: Reference path.
            route: The route.
            road_map: The map.
            windows: Goals along the path; a gap in which the ego comes too late for one is none.
            vehicle: The ego.
            dt: Step, s.
        """
        self._settings = settings
        self._path = path
        self._vehicle = vehicle
        self._dt = dt
        self._changes = lane_changes(route, road_map, path)
        self._windows = tuple(windows)
        self._time = np.arange(0.0, settings.ahead + 0.5 * _STEP, _STEP)
        self._kept: Gap | None = None
        self._through: LaneChange | None = None  # The last one that a gap was taken for.

    def decide(
        self,
        observation: Observation,
        occupancy: Occupancy,
        ego: EgoOnPath,
        profile: SpeedProfile,
        limit: SpeedLimit,
    ) -> Gap | OnLane | None:
        """The gap that the ego goes to.

        Args:
            observation: What is known now.
            occupancy: The sets of the road users, in the same order.
            ego: Where the ego is.
            profile: The reference without this decision.
            limit: How fast the ego may be ahead.

        Returns:
            The gap, or that the ego has changed into it; None where there is no change of lanes
            ahead, nobody in its way, or no gap that can be reached.
        """
        kept, self._kept = self._kept, None
        change = self._next(ego, profile)
        if change is None:
            return None
        if self._done(change, ego) < _BACK:  # It has been pushed back to the lane it came from.
            self._through = None
        if self._through is change or (kept is not None and self._is_on(change, ego)):
            self._through = change
            return OnLane(change)
        if len(observation.ids) == 0:
            return None
        beside, ahead = self._lanes(observation, ego, change)
        if not beside.any():
            return None
        users = self._users(observation, occupancy, ego, np.flatnonzero(beside))
        if kept is None and not self._in_the_way(users, change, profile):
            return None
        own = self._own_lane(observation, ego, np.flatnonzero(ahead), change)
        wanted = float(profile.velocity[-1])
        gaps = self._gaps(users, change, ego, wanted, limit, *own)
        known = next((gap for gap in gaps if gap.is_between(kept)), None)
        open_ones = [gap for gap in gaps if gap.is_open]
        if not open_ones or (known is not None and not known.is_open):
            # A gap that is tight is taken where there is no other, or where the ego is on its way.
            tight = self._gaps(users, change, ego, wanted, limit, *own, self._settings.tight)
            open_ones += [
                gap for gap in tight if gap.is_open and (not open_ones or gap.is_between(kept))
            ]
        if not open_ones:
            return None
        self._kept = min(open_ones, key=lambda gap: gap.cost - self._bonus(gap, kept))
        return self._kept

    def give_up(self) -> None:
        """Forgets the gap that was chosen; the next one is chosen as if there had been none."""
        self._kept = None

    def _bonus(self, gap: Gap, kept: Gap | None) -> float:
        """What a gap may cost more than another one because the ego is on its way to it."""
        return self._settings.keeping if gap.is_between(kept) else 0.0

    def _next(self, ego: EgoOnPath, profile: SpeedProfile) -> LaneChange | None:
        """The first change that is not done and not far."""
        for change in self._changes:
            if ego.position > change.until:
                continue
            # It is over when the path is on the lane as well.
            on_path = abs(float(change.after(ego.position))) < self._settings.arrived
            if on_path and self._is_on(change, ego):
                continue
            reach = max(float(profile.velocity.max()), ego.velocity) * self._settings.ahead
            return change if change.begin < ego.position + reach else None
        return None

    def _is_on(self, change: LaneChange, ego: EgoOnPath) -> bool:
        """Whether the ego is on the lane that the route goes to."""
        away = ego.offset - float(change.after(ego.position))
        return abs(away) < self._settings.arrived

    def _lanes(
        self, observation: Observation, ego: EgoOnPath, change: LaneChange
    ) -> tuple[BoolArray, BoolArray]:
        """(N,) who is on the lane that the ego goes to, and who is ahead on its own."""
        now = observation.present
        along = self._path.locate(now[:, :2], ego.position)
        across = self._path.project(now[:, :2], along, iterations=1)[1]
        turn = now[:, USER_HEADING] - self._path.heading_at(along)
        near = np.abs(along - ego.position) < self._settings.reach
        half = 0.5 * change.width
        beside = near & observation.moves & (np.cos(turn) > self._settings.alignment)
        beside &= np.abs(across - change.after(along)) < half
        # Before the lanes meet there is no lane beside.
        beside &= along > change.begin - self._settings.reach
        own = near & ~beside & (along > ego.position)
        own &= np.abs(across - change.before(along)) < half
        return beside, own

    def _users(
        self, observation: Observation, occupancy: Occupancy, ego: EgoOnPath, rows: IntArray
    ) -> _Users:
        """The road users of some rows along the path, from the last to the first."""
        dt, now = observation.dt, observation.present
        along = self._path.locate(now[rows, :2], ego.position)
        order = np.argsort(along, kind="stable")
        rows, along = rows[order], along[order]
        now = now[rows]
        last = occupancy.horizon - 1
        columns = np.unique(np.append(np.arange(_KNOTS - 1, last, _KNOTS), last))
        seconds = (columns + 1) * dt
        valid = occupancy.valid[rows][:, columns]
        carried = along[:, None] + now[:, USER_VELOCITY, None] * seconds
        centre = np.where(valid[..., None], occupancy.centre[rows][:, columns], 0.0)
        seen = self._path.project(centre, carried)[0]
        places = np.column_stack([along, np.where(valid, seen, carried)])
        heading = self._path.heading_at(places[:, 1:])
        turn = np.where(valid, occupancy.angle[rows][:, columns], 0.0) - heading
        axes = np.where(valid[..., None], occupancy.semi_axes[rows][:, columns], 0.0)
        reach = ellipse_extent(axes, turn)[..., 0]
        knots = np.concatenate([[0.0], seconds])
        margin = np.column_stack([np.zeros(len(rows)), reach])
        speed = np.diff(places, axis=1) / np.diff(knots)
        until = min(self._settings.known, float(knots[-1]))
        later = np.maximum(self._time - knots[-1], 0.0)
        middle = np.stack([np.interp(self._time, knots, row) for row in places])
        middle += np.maximum(speed[:, -1:], 0.0) * later
        wide = np.stack([np.interp(np.minimum(self._time, until), knots, row) for row in margin])
        half = 0.5 * observation.size[rows][:, :1]
        held = np.clip(np.searchsorted(knots, self._time, side="right") - 1, 0, len(seconds) - 1)
        return _Users(
            ids=observation.ids[rows],
            first=middle + half,
            last=middle - half,
            wide=wide,
            speed=np.maximum(speed[:, held], 0.0),
        )

    def _in_the_way(self, users: _Users, change: LaneChange, profile: SpeedProfile) -> bool:
        """Whether somebody is where the reference leads the ego on the lane it goes to."""
        settings, half = self._settings, 0.5 * self._vehicle.length
        known = self._dt * np.arange(len(profile.velocity))
        place = np.interp(self._time, known, profile.arclength)
        place += profile.velocity[-1] * np.maximum(self._time - known[-1], 0.0)
        offset = np.interp(self._time, known, profile.offset)
        wide = 0.5 * (change.width + self._vehicle.width)
        there = np.abs(offset - change.after(place)) < wide
        there |= place > change.until
        margin = half + settings.clearance + users.wide
        close = (place + margin > users.last) & (place - margin < users.first)
        return bool((close & there).any())

    def _own_lane(
        self, observation: Observation, ego: EgoOnPath, rows: IntArray, change: LaneChange
    ) -> tuple[FloatArray, float]:
        """What bounds the ego until it has changed.

        Returns:
            (K,) arc length that its front must not pass before, m, and the share of the way from
            lane to lane after which it may.
        """
        end = np.full(len(self._time), change.until)
        if not len(rows):
            return end, 1.0
        now, size = observation.present[rows], observation.size[rows]
        along = self._path.locate(now[:, :2], ego.position)
        speed = np.where(observation.moves[rows], now[:, USER_VELOCITY], 0.0)
        ahead = along - 0.5 * size[:, 0] - self._settings.clearance
        ahead = ahead[:, None] + speed[:, None] * self._time
        nearest = int(np.argmin(ahead[:, 0]))
        if ahead[nearest, 0] > change.until:
            return end, 1.0
        # Beside it the ego needs both halves of the widths, and some room.
        across = self._path.project(now[nearest, :2], along[nearest], iterations=1)[1]
        before, after = (float(at(along[nearest])) for at in (change.before, change.after))
        side = 1.0 if after > before else -1.0
        room = 0.5 * (size[nearest, 1] + self._vehicle.width) + self._settings.beside
        share = (room + side * (float(across) - before)) / max(abs(after - before), 1.0)
        return np.minimum(end, ahead.min(axis=0)), float(np.clip(share, 0.0, 1.0))

    def _gaps(
        self,
        users: _Users,
        change: LaneChange,
        ego: EgoOnPath,
        wanted: float,
        limit: SpeedLimit,
        stop: FloatArray,
        clear: float,
        share: float = 1.0,
    ) -> list[Gap]:
        """A drive into each gap, from the last to the first, with a share of the margins."""
        settings, half = self._settings, 0.5 * self._vehicle.length
        count, steps = len(users.ids) + 1, len(self._time)
        low, high = np.full((count, steps), -_FAR), np.full((count, steps), _FAR)
        slow, fast = np.zeros((count, steps)), np.full((count, steps), _FAR)
        low[1:], slow[1:] = users.first + half, users.speed
        high[:-1], fast[:-1] = users.last - half, users.speed
        margin = settings.clearance + users.wide
        low[1:] += share * (margin + settings.headway_behind * users.speed)
        high[:-1] -= share * (margin + settings.headway * users.speed)
        # A drive goes a little into the gap: it comes near to its aim, but never quite there.
        inset = np.clip(_INSET_SHARE * (high - low), 0.0, _INSET)
        done = self._done(change, ego)
        span = max(settings.seconds * (1.0 - done), _STEP)
        until_clear = settings.seconds * max(clear - done, 0.0)
        allowed = np.minimum(limit.velocity, limit.legal)
        place, velocity = np.full((count, steps), ego.position), np.full((count, steps), 0.0)
        velocity[:, 0] = ego.velocity
        inside = np.zeros((count, steps), dtype=np.bool_)
        beside, gain = np.zeros(count), settings.gain
        rate, change_of_rate = np.zeros(count), settings.jerk * _STEP
        for k in range(steps):
            x, v = place[:, k], velocity[:, k]
            here = (low[:, k] <= x) & (x <= high[:, k]) & (x >= change.begin)
            inside[:, k] = here
            beside = np.where(here, beside + _STEP, 0.0)
            if k == steps - 1:
                break
            fastest = fast[:, k] + gain * (high[:, k] - inset[:, k] - x)
            slowest = slow[:, k] + gain * (low[:, k] + inset[:, k] - x)
            asked = np.minimum(np.maximum(wanted, slowest), fastest)
            asked = np.minimum(asked, np.interp(x, limit.arclength, allowed))
            room = np.maximum(stop[k] - half - x, 0.0)
            bound = np.sqrt(2.0 * settings.braking * room)
            # What ends its own lane holds it up until it can be past before it gets there.
            late = ~here | (np.maximum(until_clear - beside, 0.0) * v > room)
            asked = np.where(late & (beside < until_clear), np.minimum(asked, bound), asked)
            wish = np.clip((asked - v) / settings.answer, -settings.braking, settings.speeding)
            rate = np.clip(wish, rate - change_of_rate, rate + change_of_rate)
            velocity[:, k + 1] = np.maximum(v + rate * _STEP, 0.0)
            place[:, k + 1] = x + 0.5 * _STEP * (v + velocity[:, k + 1])
        out = []
        for i in range(count):
            entry = self._entry(inside[i], span)
            if not self._in_time(ego, place[i], velocity[i], wanted):
                entry = np.inf
            out.append(
                Gap(
                    behind=int(users.ids[i]) if i < count - 1 else None,
                    front=int(users.ids[i - 1]) if i > 0 else None,
                    entry=entry,
                    cost=self._cost(entry, place[i], velocity[i], wanted),
                    time=self._time,
                    arclength=place[i],
                    velocity=velocity[i],
                    change=change,
                    done=done,
                    step=self._dt,
                    settings=settings,
                )
            )
        return out

    def _done(self, change: LaneChange, ego: EgoOnPath) -> float:
        """Share of the way from lane to lane that the ego has behind it."""
        before, after = float(change.before(ego.position)), float(change.after(ego.position))
        share = (ego.offset - before) / (after - before) if after != before else 1.0
        return float(np.clip(share, 0.0, 1.0))

    def _entry(self, inside: BoolArray, seconds: float) -> float:
        """Time from which a drive stays beside its gap for as long as the change takes, s."""
        span = max(round(seconds / _STEP), 1)
        held = np.convolve(inside, np.ones(span), mode="valid") > span - 0.5
        return float(self._time[int(np.argmax(held))]) if held.any() else np.inf

    def _in_time(
        self, ego: EgoOnPath, place: FloatArray, velocity: FloatArray, wanted: float
    ) -> bool:
        """Whether a drive comes to the next goal before its deadline, if the way without does."""
        goal = next((w for w in self._windows if w.last_step >= ego.step), None)
        if goal is None:
            return True
        left = self._dt * (goal.last_step - ego.step)
        if ego.position + wanted * left < goal.begin:
            return True
        later = max(left - float(self._time[-1]), 0.0)
        reached = float(np.interp(left, self._time, place)) + later * float(velocity[-1])
        return reached >= goal.begin

    def _cost(self, entry: float, place: FloatArray, velocity: FloatArray, wanted: float) -> float:
        """What a drive costs: the time until the change, the way that is lost, and comfort."""
        settings, rate = self._settings, np.diff(velocity) / _STEP
        lost = max(wanted * float(self._time[-1]) - float(place[-1] - place[0]), 0.0)
        cost = settings.time_cost * entry + settings.way_cost * lost
        return cost + settings.rate_cost * _STEP * float((rate**2).sum())
