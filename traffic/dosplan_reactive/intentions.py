"""What road users intend in a future other than the recorded one.

Every figure is drawn from the seed, the future, the scenario and the road user alone, so that all
planners and both arms meet the same road users. Where the figures come from stands in
``Intentions`` and in ``docs/traffic.md``.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import wrap_angle
from dosplan.types import (
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    RoadUserKind,
    Scenario,
    Tracks,
)
from dosplan_reactive.corridors import beside
from dosplan_reactive.paths import RIDERS, SPACING, VEHICLES, Paths
from dosplan_reactive.settings import Intentions, Manner, ReactiveSettings

RAMP: Final = 2.0
"""Time over which a road user takes up its own speed, s."""

_GLANCES: Final = 600  # Steps for which it is drawn who looks away; then they come again.
_TOGETHER: Final = 0.7  # How far apart two paths are at most that are in one lane, m.
_PARALLEL: Final = np.deg2rad(10.0)
_APART: Final = 2.5  # How far apart they are in the end if they part, m.
_BEFORE: Final = 1.0  # Nobody takes another way within this time, s.
_LEAST_WAY: Final = 15.0  # Way that is left on another path, m.
_BLEND: Final = 30  # Steps over which somebody comes onto the other path, and to its speed.
_FASTEST_CHANGE: Final = 2.0  # By what factor the speeds on both paths differ at most.


@dataclass(frozen=True)
class Minds:
    """What N road users intend.

    Attributes:
        pace: (N,) desired speed as a share of the recorded one.
        reaction: (N,) reaction time to the ego, s.
        time_gap: (N,) time gap to a leader, s.
        crossing_margin: (N,) time that is kept to others at a crossing, s.
        courteous: (N,) who gives way to an ego that will be there first.
        amber: (N,) deceleration up to which somebody stops at a yellow light, m/s2.
        away: (N, G) who looks away at a step, from the first one on; it comes again after G steps.
        hold: (N,) clock at which somebody on foot waits before it steps onto the road; infinite
            where it does not.
        hold_steps: (N,) for how many steps.
        steps_out: (N,) who does not wait where it is recorded to wait.
    """

    pace: FloatArray
    reaction: FloatArray
    time_gap: FloatArray
    crossing_margin: FloatArray
    courteous: BoolArray
    amber: FloatArray
    away: BoolArray
    hold: FloatArray
    hold_steps: IntArray
    steps_out: BoolArray


def recorded_minds(count: int, chosen: ReactiveSettings) -> Minds:
    """The intentions of the recorded future: all are alike, and drive as recorded.

    Args:
        count: Number N of road users.
        chosen: The options.

    Returns:
        The intentions.
    """
    return Minds(
        pace=np.ones(count),
        reaction=np.full(count, chosen.reaction_time),
        time_gap=np.full(count, chosen.time_gap),
        crossing_margin=np.full(count, chosen.crossing_margin),
        courteous=np.full(count, chosen.manner is Manner.COURTEOUS),
        amber=np.full(count, chosen.intentions.amber_mean),
        away=np.zeros((count, 1), dtype=np.bool_),
        hold=np.full(count, np.inf),
        hold_steps=np.zeros(count, dtype=np.int64),
        steps_out=np.zeros(count, dtype=np.bool_),
    )


def drawn(
    scenario: Scenario, first_step: int, chosen: ReactiveSettings, seed: int, future: int
) -> tuple[Minds, Tracks]:
    """Draws what the road users of a future intend.

    Args:
        scenario: The scenario.
        first_step: Step from which on the future may differ.
        chosen: The options.
        seed: Seed of the run.
        future: Which future, 1 or more.

    Returns:
        The intentions, and what each drives along: its recording, or for who takes another way the
        recorded path of somebody who was in the same lane. Both are the recording until
        ``first_step``.
    """
    tracks, spread = scenario.tracks, chosen.intentions
    paths = Paths(tracks)
    minds = recorded_minds(len(tracks.ids), chosen)
    minds = replace(minds, away=np.zeros((len(tracks.ids), _GLANCES), dtype=np.bool_))
    states, valid = np.array(tracks.states), np.array(tracks.valid)
    place = zlib.crc32(scenario.id.encode())
    ways = _Ways(paths, first_step, scenario.dt)
    for row, name in enumerate(tracks.ids.tolist()):
        rng = np.random.default_rng([seed, future, place, name % 2**32])
        kind = tracks.kinds[row]
        deviation = spread.speed_deviation if kind in VEHICLES else spread.walking_deviation
        if kind in RIDERS or kind is RoadUserKind.PEDESTRIAN:
            factor = rng.normal(0.0, deviation)
            minds.pace[row] = 1.0 + np.clip(factor, -2.0 * deviation, 2.0 * deviation)
        if kind in RIDERS:
            _think(minds, row, rng, chosen, scenario.dt)
            turns = rng.random() < spread.other_way_share
            if turns and kind in VEHICLES and paths.reacts[row]:
                other = ways.another(row, rng)
                if other is not None:
                    states[row], valid[row] = other
        elif kind is RoadUserKind.PEDESTRIAN:
            _step_out_or_wait(minds, row, rng, scenario, paths, first_step, spread)
    return minds, replace(tracks, states=states, valid=valid)


def _think(
    minds: Minds, row: int, rng: np.random.Generator, chosen: ReactiveSettings, dt: float
) -> None:
    """A driver's figures."""
    spread = chosen.intentions
    ratio = spread.reaction_deviation / spread.reaction_mean
    log_deviation = np.sqrt(np.log1p(ratio**2))
    log_mean = np.log(spread.reaction_mean) - 0.5 * log_deviation**2
    minds.reaction[row] = np.clip(rng.lognormal(log_mean, log_deviation), 0.4, 2.5)
    share = float(np.clip(rng.lognormal(0.0, spread.time_gap_spread), 0.4, 2.5))
    minds.time_gap[row] *= share
    minds.crossing_margin[row] *= share  # Who drives close takes small gaps at crossings, too.
    minds.courteous[row] |= rng.random() < spread.courteous_share
    minds.amber[row] = max(0.5, rng.normal(spread.amber_mean, spread.amber_deviation))
    step, glances = 0.0, minds.away.shape[1]
    while spread.glances > 0.0:
        step += rng.exponential(1.0 / spread.glances) / dt
        length = rng.lognormal(np.log(spread.glance_median), spread.glance_spread) / dt
        if step >= glances:
            break
        minds.away[row, int(step) : int(step + length) + 1] = True
        step += length


def _step_out_or_wait(
    minds: Minds,
    row: int,
    rng: np.random.Generator,
    scenario: Scenario,
    paths: Paths,
    first_step: int,
    spread: Intentions,
) -> None:
    """Whether somebody on foot waits before the road, or does not wait where it is recorded to."""
    waits, length = rng.random() < spread.waiting_share, rng.exponential(spread.waiting_mean)
    hurries = rng.random() < spread.stepping_out_share
    first, last = int(paths.first[row]), int(paths.last[row])
    if last <= first_step or not paths.whole[row]:
        return
    begin = max(first, first_step)
    way = scenario.tracks.states[row, begin : last + 1, :2]
    on_road = shapely.contains_xy(scenario.road_map.drivable, way[:, 0], way[:, 1])
    enters = np.flatnonzero(on_road[1:] & ~on_road[:-1])
    if not len(enters):
        return
    if waits:
        minds.hold[row] = begin + int(enters[0])
        minds.hold_steps[row] = int(length / scenario.dt)
    else:
        minds.steps_out[row] = hurries


class _Ways:
    """The ways that others took who were in the same lane."""

    def __init__(self, paths: Paths, first_step: int, dt: float) -> None:
        self._paths, self._first, self._dt = paths, first_step, dt
        vehicles = np.array([kind in VEHICLES for kind in paths.tracks.kinds], dtype=np.bool_)
        self._others = np.flatnonzero(paths.whole & vehicles & (paths.count > _LEAST_WAY))

    def another(self, row: int, rng: np.random.Generator) -> tuple[FloatArray, BoolArray] | None:
        """Draws another way for a road user.

        Returns:
            (K, 4) states and (K,) whether it is on the scene; None where nobody took another way.
        """
        found = [way for other in self._others if (way := self._parting(row, int(other)))]
        if not found:
            return None
        return self._joined(row, *found[int(rng.integers(len(found)))])

    def _parting(self, row: int, other: int) -> tuple[int, float, float] | None:
        """Where the path of another leaves the lane: its row, its clock, and one's own."""
        paths = self._paths
        if other == row:
            return None
        low, high = paths.points[row].min(axis=0), paths.points[row].max(axis=0)
        theirs = paths.points[other]
        if np.any(theirs.max(axis=0) < low) or np.any(theirs.min(axis=0) > high):
            return None
        count, met = int(paths.count[row]), int(paths.count[other])
        seen = beside(
            np.broadcast_to(paths.points[row, :count], (met, count, 2)),
            np.broadcast_to(paths.heading[row, :count], (met, count)),
            np.zeros(met),
            np.column_stack([theirs[:met], paths.heading[other, :met]]),
            np.zeros((met, 2)),
            np.full((met, count), _TOGETHER),
        )
        together = seen.inside & (np.abs(wrap_angle(seen.turn)) < _PARALLEL)
        if not together.any():
            return None
        last = int(np.flatnonzero(together)[-1])
        nearest = np.hypot(*(paths.points[row, :count] - theirs[met - 1]).T).min()
        if met - last < _LEAST_WAY or nearest < _APART:
            return None
        own_way = float(seen.low[last])
        own = float(np.searchsorted(paths.arc[row], own_way))
        clock = float(np.searchsorted(paths.arc[other], SPACING * last))
        soonest = max(self._first, int(paths.first[row])) + _BEFORE / self._dt
        if not soonest < own < paths.last[row] or not clock < paths.last[other]:
            return None
        speeds = (self._speed(row, own), self._speed(other, clock))
        if min(speeds) < 1.0 or max(speeds) > _FASTEST_CHANGE * min(speeds):
            return None
        return other, clock, own

    def _speed(self, row: int, clock: float) -> float:
        return abs(float(self._paths.tracks.states[row, int(clock), USER_VELOCITY]))

    def _joined(
        self, row: int, other: int, clock: float, own: float
    ) -> tuple[FloatArray, BoolArray]:
        """One's own recording until a clock, then the other's, at one's own speed at first."""
        paths, steps = self._paths, self._paths.tracks.steps
        states, valid = np.full((steps, USER_SIZE), np.nan), np.zeros(steps, dtype=np.bool_)
        begin = int(own)
        first = int(paths.first[row])
        states[first : begin + 1] = paths.tracks.states[row, first : begin + 1]
        after = np.arange(steps - begin - 1)
        fading = np.maximum(1.0 - after / _BLEND, 0.0)
        ratio = self._speed(row, own) / self._speed(other, clock)
        rate = 1.0 + (ratio - 1.0) * fading
        clocks = clock + np.cumsum(rate)
        there = clocks <= paths.last[other]
        clocks, rate, fading = clocks[there], rate[there], fading[there]
        rows = np.full(len(clocks), other)
        new = np.array(paths.at(rows, clocks))
        gap = states[begin] - paths.at(rows[:1], np.array([clock]))[0]
        new[:, :2] += fading[:, None] * gap[:2]
        new[:, USER_HEADING] += fading * wrap_angle(gap[USER_HEADING])
        new[:, USER_VELOCITY] *= rate
        states[begin + 1 : begin + 1 + len(new)] = new
        valid[first : begin + 1 + len(new)] = True
        return states, valid
