"""Traffic that keeps to the recording and reacts to the ego.

Each road user drives along **its own recording by a clock of its own**: its pose is the recorded
one at its clock. A clock runs as recorded, one step a step, until the ego, or somebody who is off
the recording, is in the way; then the road user brakes as a driver does, and its clock falls
behind. So path, stops and end come from the recording, and without an influence of the ego the
recording comes back to the last bit.

All decide at the same time from what there was a step before (the ego included), and move then.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from dosplan.geometry import LightIndex, rectangles_overlap
from dosplan.simulation.traffic import Replay, RoadUsers, Traffic, empty_tracks
from dosplan.types import (
    COLOURS,
    EGO_VELOCITY,
    USER_HEADING,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    LightColour,
    RoadUserKind,
    Scenario,
    Tracks,
)
from dosplan_reactive.corridors import Beside, Meetings, ego_beside
from dosplan_reactive.intentions import RAMP, drawn, recorded_minds
from dosplan_reactive.paths import RIDERS, SPACING, VEHICLES, Paths
from dosplan_reactive.settings import ReactiveSettings

OFF: Final = 0.5
"""Steps by which a clock is off before others react to it: 0.05 s."""

_NEAR: Final = 110.0  # Distance within which others are looked at, m.
_NEW_TABLES: Final = 12  # Pairs of paths that are looked at for the first time in a step.
_CLOSEST: Final = 0.1  # Smallest gap that is reckoned with, m.
_COMMITTED: Final = 6.0  # Deceleration beyond which nobody stops for a crossing any more, m/s2.
_ALIGNED: Final = 0.5  # Cosine of the angle up to which somebody ahead is a leader.
_DRIFTS: Final = 0.1  # Sine of the angle to a path from which on somebody leaves it to the side.
_ENTRY: Final = 3.0  # Deceleration that somebody who comes onto the scene may ask for, m/s2.
_SIGHT_AHEAD: Final = 2.4  # How far ahead courtesy looks, s.


class ReactiveTraffic(Traffic):
    """All drive along their recording by clocks of their own."""

    name = "reactive-v1"
    settings = ReactiveSettings
    has_futures = True

    def __init__(
        self,
        *,
        seed: int = 0,
        settings: ReactiveSettings = ReactiveSettings(),
        future: int = 0,
    ) -> None:
        """Makes it.

        Args:
            seed: Seed of the run.
            settings: The options.
            future: Which continuation is driven. The recorded one of that number, where several
                are recorded; else, 0 is the recorded one, and others have drawn intentions.
        """
        super().__init__(seed=seed, settings=settings, future=future)
        self.chosen = settings
        self._paths = Paths(empty_tracks(0))

    @classmethod
    def futures_of(cls, scenario: Path) -> int | None:
        """Counts the futures that it has for a scenario.

        Args:
            scenario: The scenario file.

        Returns:
            Those that are recorded, where these are several; else None, as it draws others.

        Raises:
            ScenarioError: The file of the recorded ones is damaged.
        """
        recorded = Replay.futures_of(scenario)
        return recorded if recorded > 1 else None

    def begin(self, scenario: Scenario, first_step: int) -> Tracks:
        """Begins an episode.

        Args:
            scenario: What is driven.
            first_step: Step at which the ego starts.

        Returns:
            What is recorded until then.

        Raises:
            ShapeError: Several futures are recorded of the scenario, but not so many.
        """
        chosen = self.chosen
        # Intentions are drawn where they are not recorded.
        self._drawn = self.future > 0 and not scenario.futures
        if self._drawn:
            minds, tracks = drawn(scenario, first_step, chosen, self.seed, self.future)
        else:
            tracks = scenario.recorded(self.future)
            minds = recorded_minds(len(tracks.ids), chosen)
        n = len(tracks.ids)
        self._minds, self._first = minds, first_step
        self._waited = np.zeros(n, dtype=np.int64)
        walks = [self._drawn and kind is RoadUserKind.PEDESTRIAN for kind in tracks.kinds]
        self._walks = np.array(walks, dtype=np.bool_)
        self._lights = _Lights(scenario) if scenario.road_map.lights else None
        self._paths = paths = Paths(tracks, RIDERS if self._drawn else VEHICLES)
        self._meetings = Meetings(paths, self.chosen.side_margin)
        self._vehicle, self._dt = scenario.task.vehicle, scenario.dt
        self._clock = np.full(n, float(first_step))
        self._started = (paths.first <= first_step) & (paths.last >= 0)
        self._gone = (paths.last < first_step) | (paths.last < 0)
        rows = np.flatnonzero(self._started & ~self._gone & paths.whole)
        self._speed = np.zeros(n)
        self._speed[rows] = np.abs(paths.at(rows, self._clock[rows])[:, USER_VELOCITY])
        # Towards the ego: how long it has been in the way, whether there is a reaction by now, and
        # the gaps to keep, which begin at those first seen.
        self._alarm = np.zeros(n)
        self._aware = np.zeros(n, dtype=np.bool_)
        self._ego_gaps = _Gaps(n, chosen, minds.time_gap)
        self._gaps = _Gaps((n, n), chosen, minds.time_gap)
        return Replay().begin(scenario, first_step)

    def step(self, step: int, ego: FloatArray) -> RoadUsers:
        """Moves all on by one step.

        Args:
            step: The step that is reached.
            ego: Ego states until then. The last one is not known to anybody yet.

        Returns:
            The road users on the scene.
        """
        paths = self._paths
        past = ego[:-1] if len(ego) > 1 else ego  # A single row is an ego that stays.
        here = np.flatnonzero(self._started & ~self._gone & paths.whole)
        pose = paths.at(here, self._clock[here])
        late = np.abs(self._clock[here] - (step - 1)) > OFF
        drives = paths.reacts[here]
        limit = np.full(len(here), np.inf)
        self._heed_ego(step, here, drives, pose, past, limit)
        if self._lights is not None:
            heeds = np.flatnonzero(drives & (late | self._drawn))
            self._lights.heed(
                step - 1,
                here[heeds],
                pose[heeds],
                self._speed,
                self._minds.amber,
                paths,
                limit,
                heeds,
            )
        if late.any():
            self._heed_others(here, drives, late, pose, limit)
        before = self._clock[here]
        self._move(step, here, drives, limit)
        if (np.abs(self._clock[here] - step) > OFF).any():
            self._keep_apart(step, here, pose, before)
        self._arrive(step, past)
        return self._present(step)

    # ---- what the ego asks for ------------------------------------------------------------

    def _heed_ego(
        self,
        step: int,
        here: IntArray,
        drives: BoolArray,
        pose: FloatArray,
        past: FloatArray,
        limit: FloatArray,
    ) -> None:
        """Lowers the accelerations to what the ego asks for, after the reaction time."""
        chosen, paths, dt = self.chosen, self._paths, self._dt
        centre, velocity = self._vehicle.poses(past[-1:])[0], float(past[-1, EGO_VELOCITY])
        apart = np.hypot(*(pose[:, :2] - centre[:2]).T)
        looks = np.flatnonzero(drives & (apart < _NEAR))
        if not len(looks):
            return
        rows = here[looks]
        way = paths.way(rows, self._clock[rows])
        size = np.asarray(self._vehicle.size)
        seen = ego_beside(paths, rows, way, centre, size, chosen.side_margin)
        front = way + 0.5 * paths.tracks.size[rows, 0]
        ahead = seen.inside & (0.5 * (seen.low + seen.high) > way)
        own = self._speed[rows]
        along, gap = velocity * np.cos(seen.turn), np.maximum(seen.low - front, _CLOSEST)
        braking = self._ego_braking(past)
        clears = _clears(seen, velocity * np.sin(seen.turn), paths.tracks.size[rows, 1], chosen)
        meets = ahead & self._will_meet(rows, way, front, seen.low, along, braking, clears)
        coming = np.where(along > 0.0, np.maximum(along - braking, 0.0), along)
        needed = np.maximum(own - coming, 0.0) ** 2 / (2.0 * gap)
        minds = self._minds
        away = minds.away[rows, (step - self._first) % minds.away.shape[1]]
        polite = np.flatnonzero(minds.courteous[rows] & ~away)
        if len(polite):
            limit[looks[polite]] = self._gives_way(
                rows[polite], way[polite], front[polite], centre, velocity, limit[looks[polite]]
            )
        noticed = np.where(away, self._alarm[rows], self._alarm[rows] + dt)
        self._alarm[rows] = np.where(meets, noticed, np.maximum(self._alarm[rows] - dt, 0.0))
        aware = self._aware[rows]
        fresh = meets & ~aware & (needed > chosen.needed_braking)
        fresh &= ~away & (self._alarm[rows] > minds.reaction[rows] - 1e-9)
        self._ego_gaps.first_seen(rows[fresh], gap[fresh], own[fresh])
        aware = (aware | fresh) & ahead
        self._aware[rows] = aware
        self._ego_gaps.grow(rows[aware], gap[aware], own[aware], dt)
        least, time_gap = self._ego_gaps.of(rows)
        follows = _idm(own, along, gap, least, time_gap, chosen)
        # Who crosses and will have left before one is there asks for nothing.
        acts = aware & ((np.cos(seen.turn) > _ALIGNED) | (gap < np.maximum(own, 1e-9) * clears))
        limit[looks] = np.where(acts, np.minimum(limit[looks], follows), limit[looks])

    def _ego_braking(self, past: FloatArray) -> float:
        """By how much the ego is slower in a second, m/s: it brakes on for that long."""
        recent = past[-3:, EGO_VELOCITY]
        if len(recent) < 2:
            return 0.0
        return max(0.0, float(recent[0] - recent[-1]) / (self._dt * (len(recent) - 1)))

    def _will_meet(
        self,
        rows: IntArray,
        way: FloatArray,
        front: FloatArray,
        low: FloatArray,
        along: FloatArray,
        braking: float,
        clears: FloatArray,
    ) -> BoolArray:
        """Whether road users reach the ego, if they drive as recorded and it as it does now."""
        paths, dt = self._paths, self._dt
        times = np.arange(2 * dt, self.chosen.look_ahead + 0.5 * dt, 2 * dt)
        clock = np.minimum(
            np.floor(self._clock[rows])[:, None] + np.round(times / dt), paths.last[rows, None]
        ).astype(np.int64)
        planned = paths.arc[rows[:, None], clock] - way[:, None]
        possible = self._speed[rows, None] * times + 0.5 * self.chosen.acceleration * times**2
        slows = np.where(along > 0.0, np.minimum(braking, along), 0.0)[:, None]
        held = np.minimum(times, 1.0)
        ego = along[:, None] * times - slows * (0.5 * held**2 + np.maximum(times - 1.0, 0.0))
        reached = front[:, None] + np.minimum(planned, possible) > low[:, None] + ego - 0.5
        return np.asarray((reached & (times < clears[:, None])).any(axis=1))

    def _gives_way(
        self,
        rows: IntArray,
        way: FloatArray,
        front: FloatArray,
        centre: FloatArray,
        velocity: float,
        limit: FloatArray,
    ) -> FloatArray:
        """Lowers accelerations where the ego, driving straight on, is in the corridor first."""
        chosen, own = self.chosen, np.maximum(self._speed[rows], 0.1)
        direction = np.array([np.cos(centre[2]), np.sin(centre[2])])
        size = np.asarray(self._vehicle.size)
        for time in np.arange(0.4, _SIGHT_AHEAD + 0.1, 0.4):
            pose = np.append(centre[:2] + velocity * time * direction, centre[2])
            seen = ego_beside(self._paths, rows, way, pose, size, chosen.side_margin)
            gap = seen.low - front
            there = gap / own
            crosses = seen.inside & (np.cos(seen.turn) < _ALIGNED) & (gap > 0.0)
            first = (
                crosses & (there > time) & (there < time + 0.4 + self._minds.crossing_margin[rows])
            )
            needed = own**2 / (2.0 * np.maximum(gap - 0.5, _CLOSEST))
            first &= (needed > chosen.needed_braking) & (needed < _COMMITTED)
            limit = np.where(first, np.minimum(limit, -needed), limit)
        return limit

    # ---- what the others ask for ----------------------------------------------------------

    def _heed_others(
        self,
        here: IntArray,
        drives: BoolArray,
        late: BoolArray,
        pose: FloatArray,
        limit: FloatArray,
    ) -> None:
        """Lowers the accelerations to what road users ask for that are off the recording.

        Who is off it reacts to everybody, all others to those who are off it only.
        """
        one, other = self._pairs(here, drives, late, pose)
        if not len(one):
            return
        chosen, paths, meetings = self.chosen, self._paths, self._meetings
        owner, met = np.concatenate([one, other]), np.concatenate([other, one])
        table, meet = meetings.of(here[owner], here[met])
        way = paths.way(here, self._clock[here])
        speed = self._speed[here]
        length = paths.tracks.size[here, 0]
        front, rear = (way + 0.5 * length)[owner], (way - 0.5 * length)[owner]
        point = np.clip(np.round(way / SPACING).astype(np.int64), 0, paths.count[here] - 1)[met]
        rest = way[met] - SPACING * point
        found = meetings.look_up(np.where(meet, table, 0), point) if meet.any() else None
        if found is None:
            return
        inside, low, high, cos, begin, end, nearest, farthest = found.T
        inside = meet & (inside > 0.0)
        low, high = low + cos * rest, high + cos * rest
        own, others = speed[owner], speed[met]
        ahead = inside & (0.5 * (low + high) > way[owner])
        gap = np.maximum(low - front, _CLOSEST)
        moving = np.maximum(others, 0.1)
        left = (SPACING * (end - point) - rest) / moving  # Time until it has left.
        # A leader: somebody ahead in the corridor who drives the same way, or does not leave it.
        leads = ahead & (cos > _ALIGNED)
        pair = (here[owner], here[met])
        self._gaps.first_seen(pair, gap, own, leads)
        self._gaps.grow(pair, gap, own, self._dt, leads)
        least, time_gap = self._gaps.of(pair)
        asked = np.where(leads, _idm(own, others * cos, gap, least, time_gap, chosen), np.inf)
        # Who crosses: whoever is there first goes, the other one stops before it.
        coming = meet & ~inside & np.isfinite(begin) & (farthest > rear)
        arrives = np.maximum(SPACING * (begin - point) - rest, 0.0) / moving
        to_zone = np.where(inside, np.minimum(low, nearest), nearest) - front
        zone_end = np.where(inside, np.maximum(high, farthest), farthest) - rear
        pace = np.maximum(own, 0.1)
        reaches, passes = np.maximum(to_zone, 0.0) / pace, np.maximum(zone_end, 0.0) / pace
        needed = own**2 / (2.0 * np.maximum(to_zone - 0.5, _CLOSEST))
        margin = self._minds.crossing_margin[here[owner]]
        both = coming & (reaches < left + margin) & (arrives < passes + margin)
        both &= np.minimum(reaches, arrives) < chosen.look_ahead
        half = len(one)
        swap = np.concatenate([np.arange(half, 2 * half), np.arange(half)])
        committed = (needed > _COMMITTED) | (to_zone <= 0.0)
        # When each is there, as both see it; who is in the other's corridor is there.
        mine = np.where(inside[swap], 0.0, np.where(committed, 0.0, reaches) + arrives[swap])
        theirs = np.where(inside, 0.0, np.where(committed[swap], 0.0, reaches[swap]) + arrives)
        later = (mine > theirs) | ((mine == theirs) & (owner > met))
        yields = both & later
        yields |= ahead & ~leads & (reaches < left) & ((to_zone > 0.0) | later)
        yields &= needed > chosen.needed_braking
        asked = np.where(yields, np.minimum(asked, -needed), asked)
        np.minimum.at(limit, owner, np.where(drives[owner], asked, np.inf))

    def _pairs(
        self, here: IntArray, drives: BoolArray, late: BoolArray, pose: FloatArray
    ) -> tuple[IntArray, IntArray]:
        """Pairs of which one is off the recording, one can react, and that may meet soon."""
        one, other = np.triu_indices(len(here), 1)
        apart = np.hypot(*(pose[one, :2] - pose[other, :2]).T)
        speed = self._speed[here]
        soon = 15.0 + self.chosen.look_ahead * (speed[one] + speed[other])
        chosen = (late[one] | late[other]) & (drives[one] | drives[other])
        chosen &= apart < np.minimum(soon, _NEAR)
        one, other, apart = one[chosen], other[chosen], apart[chosen]
        maybe = ~self._meetings.never(here[one], here[other])
        one, other, apart = one[maybe], other[maybe], apart[maybe]
        new = np.flatnonzero(~self._meetings.known(here[one], here[other]))
        if len(new) > _NEW_TABLES:  # The nearest first, the others in the next steps.
            later = new[np.argsort(apart[new], kind="stable")[_NEW_TABLES:]]
            one, other = np.delete(one, later), np.delete(other, later)
        return one, other

    # ---- moving ---------------------------------------------------------------------------

    def _move(self, step: int, here: IntArray, drives: BoolArray, limit: FloatArray) -> None:
        """Runs the clocks on, as far as the accelerations let the road users get."""
        paths, dt, chosen = self._paths, self._dt, self.chosen
        clock, last, minds = self._clock[here], paths.last[here], self._minds
        taken = min(1.0, (step - self._first) * dt / RAMP)
        pace = 1.0 + taken * (minds.pace[here] - 1.0)
        holds = (clock >= minds.hold[here]) & (self._waited[here] < minds.hold_steps[here])
        self._waited[here] += holds
        planned = paths.way(here, clock + pace) - paths.way(here, clock)
        speed = self._speed[here]
        on_time = clock == step - 1
        at = np.minimum(np.floor(clock).astype(np.int64), last)
        recorded = paths.tracks.states[here, at, USER_VELOCITY]
        following = paths.tracks.states[here, np.minimum(at + 1, last), USER_VELOCITY]
        most = np.maximum(chosen.acceleration, (np.abs(following) - np.abs(recorded)) / dt)
        acceleration = np.minimum(limit, np.where(on_time & (pace == 1.0), np.inf, most))
        acceleration = np.maximum(acceleration, -chosen.full_braking)
        free = ~drives | np.isinf(acceleration)
        brakes = drives & (acceleration < 0.0)
        acceleration = np.where(free, 0.0, acceleration)
        reached = np.maximum(speed + acceleration * dt, 0.0)
        # The way until it stands, where it stops within the step.
        stops = speed**2 / (2.0 * np.maximum(-acceleration, 1e-9))
        way = np.where(reached > 0.0, 0.5 * (speed + reached) * dt, np.minimum(stops, speed * dt))
        free |= way >= planned
        standing = paths.standing_until[here, at]
        moved = clock + pace
        held = ~free
        if held.any():
            moved[held] = paths.clock_after(here[held], clock[held], way[held], pace[held])
        # A standstill of the recording lasts until the recorded time.
        own = drives | self._walks[here]
        waits = own & (standing > at) & ((reached < 0.5) | ~drives)
        hurries = waits & minds.steps_out[here]
        waits &= ~hurries
        moved = np.where(waits, np.clip(step, clock, standing), moved)
        moved = np.where(hurries, standing, moved)
        moved = np.where(holds, clock, moved)
        self._clock[here] = moved
        gone = moved > last
        self._gone[here[gone]] = True
        stay = here[~gone]
        as_recorded = np.abs(paths.at(stay, self._clock[stay])[:, USER_VELOCITY]) * pace[~gone]
        # Recorded velocities may exceed the way that is driven: they make nobody faster.
        slower = np.minimum(as_recorded, reached[~gone])
        kept = np.where(free[~gone], np.where(brakes[~gone], slower, as_recorded), reached[~gone])
        self._speed[stay] = np.where(holds[~gone], 0.0, kept)

    def _keep_apart(self, step: int, here: IntArray, before: FloatArray, clock: FloatArray) -> None:
        """Holds who would overlap another that it did not overlap before."""
        paths = self._paths
        stay = np.flatnonzero(~self._gone[here])
        rows, before, clock = here[stay], before[stay], clock[stay]
        size = paths.tracks.size[rows]
        radius = 0.5 * np.hypot(*size.T)
        one, other = np.triu_indices(len(rows), 1)
        for _ in range(5):
            pose = paths.at(rows, self._clock[rows])
            off = np.abs(self._clock[rows] - step) > OFF
            near = np.hypot(*(pose[one, :2] - pose[other, :2]).T) < radius[one] + radius[other]
            near &= off[one] | off[other]
            a, b = one[near], other[near]
            hit = rectangles_overlap(pose[a], size[a], pose[b], size[b])
            a, b = a[hit], b[hit]
            already = rectangles_overlap(before[a], size[a], before[b], size[b])
            a, b = a[~already], b[~already]
            if not len(a):
                return
            held = self._who_waits(rows, pose, clock, a, b, step)
            if not len(held):
                return
            self._clock[rows[held]] = clock[held]
            self._speed[rows[held]] = 0.0

    def _who_waits(
        self,
        rows: IntArray,
        pose: FloatArray,
        clock: FloatArray,
        one: IntArray,
        other: IntArray,
        step: int,
    ) -> IntArray:
        """Of each pair the one that has the other ahead; else the one that is later."""
        moved = self._clock[rows] != clock
        can = moved & np.array([self._paths.tracks.kinds[i].moves for i in rows], dtype=np.bool_)
        can &= self._paths.whole[rows]
        between = pose[other, :2] - pose[one, :2]
        direction = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
        ahead = (between * direction[one]).sum(axis=1) > 0.0
        behind = (between * direction[other]).sum(axis=1) < 0.0
        later = self._clock[rows[one]] <= self._clock[rows[other]]
        first = np.where(ahead == behind, later, ahead)
        first = np.where(can[one] & can[other], first, can[one])
        held = np.where(first, one, other)
        return np.unique(held[can[held]])

    # ---- coming and being there -----------------------------------------------------------

    def _arrive(self, step: int, past: FloatArray) -> None:
        """Lets those come onto the scene whose place is free."""
        paths = self._paths
        due = np.flatnonzero(~self._started & (paths.first <= step) & (paths.last >= 0))
        if not len(due):
            return
        here = np.flatnonzero(self._started & ~self._gone & paths.whole)
        pose = paths.at(here, self._clock[here])
        size = paths.tracks.size[here]
        off = np.abs(self._clock[here] - step) > OFF
        speed = self._speed[here]
        centre = self._vehicle.poses(past[-1:])[0]
        ego_row = np.array([[*centre, abs(float(past[-1, EGO_VELOCITY]))]])
        for row in due:
            self._clock[row] = float(paths.first[row])
            new = paths.tracks.states[row, paths.first[row]]
            if paths.reacts[row]:
                others = slice(None) if paths.first[row] < step else off
                around = np.concatenate([ego_row, np.column_stack([pose[:, :3], speed])[others]])
                sizes = np.concatenate([[self._vehicle.size], size[others]])
                if not _is_free(new, paths.tracks.size[row], around, sizes):
                    continue
            self._started[row] = True
            self._speed[row] = abs(new[USER_VELOCITY])
            if paths.first[row] < step:  # The next to come must keep clear of this one.
                here = np.append(here, row)
                pose, size = np.vstack([pose, new]), np.vstack([size, paths.tracks.size[row]])
                off, speed = np.append(off, True), np.append(speed, self._speed[row])

    def _present(self, step: int) -> RoadUsers:
        paths = self._paths
        tracks = paths.tracks
        n = len(tracks.ids)
        there = self._started & ~self._gone & paths.whole
        if step < tracks.steps:  # Who is recorded with gaps is there when it is recorded.
            there |= ~paths.whole & tracks.valid[:, step]
            clock = np.where(paths.whole, self._clock, float(step))
        else:
            clock = self._clock
        rows = np.arange(n)[there]
        states = np.array(paths.at(rows, clock[rows]))
        off = (clock[rows] != step) & paths.whole[rows]
        states[off, USER_VELOCITY] = self._speed[rows[off]]
        return RoadUsers(
            ids=tracks.ids[rows],
            kinds=tuple(tracks.kinds[i] for i in rows),
            size=tracks.size[rows],
            states=states,
            outlines=tuple(tracks.outlines[i] for i in rows),
        )


class _Lights:
    """Traffic lights, for who is off the recording and cannot rely on what that met.

    Who is recorded to run a red light, or to go where it does not hold, runs it.
    """

    _BEFORE_LINE: Final = 1.0  # Where somebody stops before the line, m.
    _AT_LINE: Final = 3.0  # Up to where somebody who stands waits at the line, m.

    def __init__(self, scenario: Scenario) -> None:
        self._index = LightIndex(scenario.road_map)
        self._signals = scenario.signals
        self._runs: dict[int, bool] = {}

    def heed(
        self,
        step: int,
        rows: IntArray,
        pose: FloatArray,
        speeds: FloatArray,
        amber: FloatArray,
        paths: Paths,
        limit: FloatArray,
        at: IntArray,
    ) -> None:
        """Lowers accelerations where a light asks for a stop.

        Args:
            step: The present step.
            rows: (R,) who heeds lights.
            pose: (R, 4) where they are.
            speeds: (N,) speeds of all, m/s.
            amber: (N,) deceleration up to which each stops at a yellow light, m/s2.
            paths: The paths.
            limit: (H,) accelerations of who is here, which are lowered, m/s2.
            at: (R,) places of ``rows`` in ``limit``.
        """
        if not len(rows):
            return
        own = speeds[rows]
        seen = self._index.ahead(pose, paths.tracks.size[rows], self._signals.at(step))
        red = np.array([colour >= 0 and COLOURS[colour].forbids for colour in seen.colour])
        yellow = seen.colour == COLOURS.index(LightColour.YELLOW)
        needed = own**2 / (2.0 * np.maximum(seen.distance - self._BEFORE_LINE, _CLOSEST))
        stops = (red & (needed < _COMMITTED)) | (yellow & (needed < amber[rows]))
        stops &= seen.distance > 0.0
        for i in np.flatnonzero(stops):
            stops[i] = not self._is_run(int(rows[i]), paths)
        waits = stops & (seen.distance < self._AT_LINE) & (own < 1.0)
        asked = np.where(waits, -2.0, np.where(stops & (needed > 1.0), -needed, np.inf))
        limit[at] = np.minimum(limit[at], asked)

    def _is_run(self, row: int, paths: Paths) -> bool:
        """Whether somebody is recorded to drive over a line at red."""
        if row not in self._runs:
            before, self._runs[row] = np.inf, False
            for step in range(int(paths.first[row]), int(paths.last[row]) + 1, 2):
                state = paths.tracks.states[row, step : step + 1]
                size = paths.tracks.size[row : row + 1]
                seen = self._index.ahead(state, size, self._signals.at(step))
                distance, colour = float(seen.distance[0]), int(seen.colour[0])
                if before > 0.0 >= distance and colour >= 0 and COLOURS[colour].forbids:
                    self._runs[row] = True
                    break
                before = distance
        return self._runs[row]


class _Gaps:
    """Gaps to keep, by pair: they begin at what is first seen, and grow back to what is wanted.

    A tight gap that was there before is no reason to brake.
    """

    _OPENING: Final = 0.5  # How fast the gap at a standstill grows back, m/s.
    _EASING: Final = 0.1  # How fast the time gap grows back, s per s.

    def __init__(
        self, shape: int | tuple[int, int], chosen: ReactiveSettings, time_gap: FloatArray
    ) -> None:
        self._chosen, self._wanted = chosen, time_gap
        self._least = np.full(shape, np.nan)
        self._time = np.full(shape, np.nan)

    def first_seen(
        self,
        index: IntArray | tuple[IntArray, IntArray],
        gap: FloatArray,
        speed: FloatArray,
        where: BoolArray | None = None,
    ) -> None:
        """Takes the gap that there is, for pairs that have none yet or are seen anew."""
        least = np.minimum(0.9 * gap, self._chosen.least_gap)
        time = np.minimum((gap - least) / np.maximum(speed, 1.0), self._time_gap(index))
        if where is None:
            self._least[index], self._time[index] = least, time
            return
        new = np.isnan(self._least[index]) & where
        self._least[index] = np.where(new, least, np.where(where, self._least[index], np.nan))
        self._time[index] = np.where(new, time, np.where(where, self._time[index], np.nan))

    def grow(
        self,
        index: IntArray | tuple[IntArray, IntArray],
        gap: FloatArray,
        speed: FloatArray,
        dt: float,
        where: BoolArray | None = None,
    ) -> None:
        """Lets the gaps grow back, at once as far as there is room."""
        chosen = self._chosen
        least, time = self._least[index], self._time[index]
        room = np.maximum(least + self._OPENING * dt, np.minimum(0.9 * gap, chosen.least_gap))
        least = np.minimum(room, chosen.least_gap)
        held = (gap - least) / np.maximum(speed, 1.0)
        time = np.minimum(np.maximum(time + self._EASING * dt, held), self._time_gap(index))
        if where is not None:
            least = np.where(where, least, self._least[index])
            time = np.where(where, time, self._time[index])
        self._least[index], self._time[index] = least, time

    def of(self, index: IntArray | tuple[IntArray, IntArray]) -> tuple[FloatArray, FloatArray]:
        """The gap at a standstill, m, and the time gap, s; what is wanted where none is known."""
        least, time = self._least[index], self._time[index]
        known = ~np.isnan(least)
        return (
            np.where(known, least, self._chosen.least_gap),
            np.where(known, time, self._time_gap(index)),
        )

    def _time_gap(self, index: IntArray | tuple[IntArray, IntArray]) -> FloatArray:
        return self._wanted[index[0] if isinstance(index, tuple) else index]


def _idm(
    own: FloatArray,
    leader: FloatArray,
    gap: FloatArray,
    least: FloatArray,
    time_gap: FloatArray,
    chosen: ReactiveSettings,
) -> FloatArray:
    """The intelligent driver model's acceleration behind a leader, m/s2, without its free part.

    Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
    simulations", Phys. Rev. E 62, 2000.
    """
    closing = own * (own - leader) / (2.0 * np.sqrt(chosen.acceleration * chosen.deceleration))
    wanted = least + np.maximum(own * time_gap + closing, 0.0)
    return np.asarray(chosen.acceleration * (1.0 - (wanted / gap) ** 2))


def _clears(
    seen: Beside, sideways: FloatArray, width: FloatArray, chosen: ReactiveSettings
) -> FloatArray:
    """Time until the ego has left corridors to the side, if it drives straight on, s."""
    half_width = 0.5 * width + chosen.side_margin
    to_left = half_width + seen.half - seen.lateral
    to_right = half_width + seen.half + seen.lateral
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.where(sideways > 0.0, to_left, to_right) / np.abs(sideways)
    drifts = (np.abs(sideways) > 0.1) & (np.abs(np.sin(seen.turn)) > _DRIFTS)
    return np.where(drifts, np.maximum(time, 0.0), np.inf)


def _is_free(new: FloatArray, size: FloatArray, around: FloatArray, sizes: FloatArray) -> bool:
    """Whether somebody may come onto the scene: nobody is there, and nobody need brake hard."""
    n = len(around)
    own, own_size = np.broadcast_to(new, (n, 4)), np.broadcast_to(size + 0.4, (n, 2))
    if rectangles_overlap(own, own_size, around, sizes).any():
        return False
    for one, one_size, other, other_size in (
        (own, np.broadcast_to(size, (n, 2)), around, sizes),
        (around, sizes, own, np.broadcast_to(size, (n, 2))),
    ):
        c, s = np.cos(one[:, USER_HEADING]), np.sin(one[:, USER_HEADING])
        between = other[:, :2] - one[:, :2]
        along = between[:, 0] * c + between[:, 1] * s
        across = np.abs(between[:, 1] * c - between[:, 0] * s)
        turn = np.cos(other[:, USER_HEADING] - one[:, USER_HEADING])
        gap = along - 0.5 * (one_size[:, 0] + other_size[:, 0])
        behind = (along > 0.0) & (across < 0.5 * (one_size[:, 1] + other_size[:, 1]))
        closing = np.maximum(np.abs(one[:, 3]) - other[:, 3] * turn, 0.0)
        needed = closing**2 / (2.0 * np.maximum(gap, _CLOSEST))
        if (behind & (turn > -0.5) & (needed > _ENTRY)).any():
            return False
    return True
