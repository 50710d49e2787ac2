"""Recorded paths as tables: from a clock to a pose and an arc length, and back.

A clock counts steps of the recording. It is a whole number, and the pose is the recorded one to
the last bit, for who drives as recorded; between two steps poses are interpolated.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import wrap_angle
from dosplan.types import (
    USER_HEADING,
    BoolArray,
    FloatArray,
    IntArray,
    RoadUserKind,
    Tracks,
)

SPACING: Final = 1.0
"""Distance between the points of a path, m."""

STANDING: Final = 0.1
"""Way over which a road user counts as standing, m: recorded poses are never quite still."""

VEHICLES: Final = frozenset(
    (RoadUserKind.CAR, RoadUserKind.TRUCK, RoadUserKind.BUS, RoadUserKind.MOTORCYCLE)
)
"""Who reacts; people on foot and on bicycles, trains and what is unknown drive as recorded."""

RIDERS: Final = VEHICLES | {RoadUserKind.BICYCLE}
"""Who reacts in futures other than the recorded one, where bicycles have a speed of their own."""

_BACK: Final = 0.05  # Way of a step backwards of who drives backwards, m.
_OFTEN: Final = 10  # Number of such steps.
_SWING: Final = 1.0  # The most that a front swings out in a bend, m.
_LONG: Final = 10  # Steps of a standstill: a second.
_LONGEST: Final = 500  # Points of a path; what is driven beyond is not looked at.


class Paths:
    """What N road users drive along.

    Attributes:
        tracks: The tracks that the paths are made of.
        first: (N,) first step on the scene.
        last: (N,) last step on the scene; -1 for who never is.
        whole: (N,) whether it is on the scene at each step between.
        reacts: (N,) whether it reacts: it is of such a kind, recorded whole and drives forwards.
        arc: (N, K) way driven until a step, m; constant before the first and after the last one.
        standing_until: (N, K) last step of the standstill that a step is part of, or the step.
        points: (N, M, 2) points of the path, ``SPACING`` apart, m; the last one is repeated.
        heading: (N, M) heading of the road user there, rad.
        swing: (N, M) how far its front swings out there, in a bend, m.
        count: (N,) number of points.
    """

    def __init__(self, tracks: Tracks, reacting: frozenset[RoadUserKind] = VEHICLES) -> None:
        """Makes the tables.

        Args:
            tracks: The recording.
            reacting: Kinds of road users that react.
        """
        self.tracks = tracks
        n, steps = tracks.valid.shape
        ever = tracks.valid.any(axis=1)
        self.first = np.where(ever, tracks.valid.argmax(axis=1), 0) if steps else np.zeros(n, int)
        if steps:
            self.last = np.where(ever, steps - 1 - tracks.valid[:, ::-1].argmax(axis=1), -1)
        else:
            self.last = np.full(n, -1)
        self.whole = tracks.valid.sum(axis=1) == self.last - self.first + 1
        self.arc = np.zeros((n, steps))
        both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
        moves = np.where(both[..., None], np.diff(tracks.states[..., :2], axis=1), 0.0)
        np.cumsum(np.hypot(moves[..., 0], moves[..., 1]), axis=1, out=self.arc[:, 1:])
        self.reacts = self.whole & np.array([kind in reacting for kind in tracks.kinds], dtype=bool)
        self.reacts &= self._forwards(moves)
        self.standing_until = self._standstills()
        self._sample()

    def at(self, rows: IntArray, clock: FloatArray) -> FloatArray:
        """Poses and recorded velocities at a clock.

        Args:
            rows: (R,) road users.
            clock: (R,) their clocks.

        Returns:
            (R, 4) states; the recorded ones where the clock is a whole number.
        """
        before = np.floor(clock).astype(np.int64)
        part = (clock - before)[:, None]
        states = self.tracks.states[rows, before]
        between = part[:, 0] > 0.0
        if between.any():
            after = self.tracks.states[rows, np.where(between, before + 1, before)]
            change = after - states
            change[:, USER_HEADING] = wrap_angle(change[:, USER_HEADING])
            states = np.where(between[:, None], states + part * change, states)
        return states

    def half_width(self, rows: IntArray, points: IntArray, side: float) -> FloatArray:
        """Half widths of corridors.

        Args:
            rows: (..., 1) road users.
            points: (..., P) points of their paths.
            side: What is added to each side of a road user, m; where its front swings out farther,
                that counts.

        Returns:
            (..., P) m.
        """
        return np.asarray(
            0.5 * self.tracks.size[rows, 1] + np.maximum(self.swing[rows, points], side)
        )

    def way(self, rows: IntArray, clock: FloatArray) -> FloatArray:
        """Arc lengths at a clock.

        Args:
            rows: (R,) road users.
            clock: (R,) their clocks; beyond the last step the way no longer grows.

        Returns:
            (R,) m.
        """
        clock = np.minimum(clock, self.last[rows])
        before = np.floor(clock).astype(np.int64)
        start = self.arc[rows, before]
        end = self.arc[rows, np.minimum(before + 1, self.last[rows])]
        return np.asarray(start + (clock - before) * (end - start))

    def clock_after(
        self, rows: IntArray, clock: FloatArray, way: FloatArray, most: FloatArray
    ) -> FloatArray:
        """Clocks after a way that is driven.

        Args:
            rows: (R,) road users.
            clock: (R,) their clocks.
            way: (R,) what they drive, m.
            most: (R,) the most that the clock moves on, steps; at most 3.

        Returns:
            (R,) new clocks.
        """
        before = np.floor(clock).astype(np.int64)
        knots = np.minimum(before[:, None] + np.arange(5), self.last[rows, None])
        arcs = self.arc[rows[:, None], knots]
        target = self.way(rows, clock) + way
        index = np.clip((arcs <= target[:, None]).sum(axis=1) - 1, 0, 3)
        each = np.arange(len(rows))
        low, high = arcs[each, index], arcs[each, index + 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(high > low, (target - low) / (high - low), 1.0)
        after = before + index + np.clip(part, 0.0, 1.0)
        return np.asarray(np.clip(after, clock, clock + most))

    def _forwards(self, moves: FloatArray) -> BoolArray:
        """Who does not drive backwards; recorded poses shake, and simulated ones jump at times."""
        heading = np.nan_to_num(self.tracks.states[:, :-1, USER_HEADING])
        along = moves[..., 0] * np.cos(heading) + moves[..., 1] * np.sin(heading)
        return np.asarray((along < -_BACK).sum(axis=1) < _OFTEN)

    def _standstills(self) -> IntArray:
        n, steps = self.arc.shape
        until = np.tile(np.arange(steps), (n, 1))
        for row in np.flatnonzero(self.last > self.first):
            first, last = int(self.first[row]), int(self.last[row])
            arc = self.arc[row, : last + 1]
            ends = np.searchsorted(arc, arc[first:] + STANDING, side="right") - 1
            begun = first + np.flatnonzero(ends - np.arange(first, last + 1) >= _LONG)
            done = -1
            for step in begun.tolist():
                if step > done:
                    done = int(ends[step - first])
                    until[row, step : done + 1] = done
        return until

    def _sample(self) -> None:
        n = len(self.arc)
        total = self.arc[:, -1] if self.arc.size else np.zeros(n)
        # A car's length straight on, so that what stands just beyond the end is seen.
        ends = total + 0.5 * self.tracks.size[:, 0] + 2.0
        self.count = np.minimum(np.ceil(ends / SPACING).astype(np.int64) + 1, _LONGEST)
        width = int(self.count.max(initial=1))
        self.points = np.zeros((n, width, 2))
        self.heading = np.zeros((n, width))
        for row in np.flatnonzero(self.last >= 0):
            known = np.flatnonzero(self.tracks.valid[row])
            arc, states = self.arc[row, known], self.tracks.states[row, known]
            turned = np.unwrap(states[:, USER_HEADING])
            at = SPACING * np.minimum(np.arange(width), self.count[row] - 1)
            self.heading[row] = np.interp(at, arc, turned)
            beyond = np.maximum(at - arc[-1], 0.0)
            direction = np.array([np.cos(turned[-1]), np.sin(turned[-1])])
            for axis in (0, 1):
                self.points[row, :, axis] = np.interp(at, arc, states[:, axis])
            self.points[row] += beyond[:, None] * direction
        bend = np.abs(np.gradient(self.heading, axis=1)) / SPACING if width > 1 else 0.0
        self.swing = np.minimum(self.tracks.size[:, 0, None] ** 2 / 8.0 * bend, _SWING)
