"""What the ego sees of the road users: with errors, with gaps, as far as the sensors reach.

The random part of what is seen of a road user at a step depends on nothing but the seed, the
scenario, the future, the road user and the step. So both arms, all planners and all traffics meet
the same errors and the same gaps; whether it is in reach and in sight depends on where they are.
What is measured with errors is shown as a filter estimates it (``filtering``).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Final

import numpy as np

from dosplan.simulation.filtering import TrackFilter
from dosplan.simulation.settings import SensingSettings
from dosplan.simulation.sight import visible
from dosplan.simulation.traffic import RoadUsers
from dosplan.types import (
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    BoolArray,
    FloatArray,
    IntArray,
    RoadUserKind,
)

_ERRORS: Final = 6  # x, y, heading, speed, length, width.
_LEAST_SIZE: Final = 0.2  # Of its true size; a road user without extent cannot be predicted.

Seen = tuple[IntArray, tuple[RoadUserKind, ...], FloatArray, FloatArray, BoolArray]
"""Ids, kinds, size, states and valid, as an ``Observation`` has them."""


class Sensors:
    """Sensors and tracker of the ego in one episode."""

    def __init__(
        self,
        settings: SensingSettings,
        dt: float,
        steps: int,
        *,
        scenario: str,
        seed: int = 0,
        future: int = 0,
    ) -> None:
        """Begins with nobody seen.

        Args:
            settings: What is seen, and how well.
            dt: Step, s.
            steps: Steps of the episode, from step 0 of the scenario.
            scenario: Id of the scenario.
            seed: Seed of the run.
            future: Which continuation of the same past is driven.
        """
        self._settings = settings
        self._dt = dt
        self._steps = steps
        digest = hashlib.sha256(scenario.encode()).digest()
        self._key = (seed, int.from_bytes(digest[:8], "little"), future)
        self._rows: dict[int, int] = {}
        self._kinds: list[RoadUserKind] = []
        self._moves = np.empty(0, dtype=np.bool_)
        self._scenery = np.empty(0, dtype=np.bool_)
        self._filter = TrackFilter(settings, dt) if settings.noisy else None
        self._size = np.empty((0, 2))  # Mean of what was seen so far.
        self._times = np.empty(0, dtype=np.int64)  # How often each was seen.
        self._last = np.empty(0, dtype=np.int64)  # Step at which each was seen last.
        self._states = np.empty((0, steps, USER_SIZE))
        self._tracked = np.empty((0, steps), dtype=np.bool_)
        self._errors = np.empty((0, steps, _ERRORS))
        self._lost = np.empty((0, steps), dtype=np.bool_)

    def look(self, step: int, eye: FloatArray, users: RoadUsers) -> None:
        """Sees what is to be seen at a step, and carries on whoever was seen lately.

        Args:
            step: The step: one after that of the last call.
            eye: (2,) centre of the ego at that step, m.
            users: Everybody on the scene at that step.
        """
        settings = self._settings
        rows = self._rows_of(users)
        seen = ~self._lost[rows, step]
        if settings.range is not None:
            seen &= np.linalg.norm(users.states[:, :2] - eye, axis=1) <= settings.range
        if settings.occlusion:
            seen &= visible(eye, users)
        rows, states, size = rows[seen], users.states[seen], users.size[seen]
        errors = self._errors[rows, step]
        measured = np.array(states)
        measured[:, :2] += settings.position * errors[:, :2]
        measured[:, USER_HEADING] += settings.heading * errors[:, 2]
        measured[:, USER_VELOCITY] += settings.speed * errors[:, 3] * self._moves[rows]
        self._states[rows, step] = self._filtered(step, rows, measured)
        measured_size = size * np.maximum(1.0 + settings.size * errors[:, 4:], _LEAST_SIZE)
        self._times[rows] += 1
        self._size[rows] += (measured_size - self._size[rows]) / self._times[rows, None]
        self._tracked[rows, step] = True
        self._last[rows] = step
        carried = (self._last < step) & (self._last >= 0)
        carried &= (step - self._last) * self._dt <= settings.memory + 1e-9
        if carried.any():
            before = self._states[carried, step - 1]
            heading, way = before[:, USER_HEADING], before[:, USER_VELOCITY] * self._dt
            before[:, :2] += way[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            self._states[carried, step] = before
            self._tracked[carried, step] = True

    def seen(self, step: int, history: int) -> Seen:
        """Those who are seen or carried on at a step, in the order in which they came.

        Args:
            step: The step of the last ``look``.
            history: Steps H that are shown, this one included.

        Returns:
            The fields of an observation.
        """
        rows = np.flatnonzero(self._tracked[:, step])
        first = max(step - history + 1, 0)
        begin = history - (step + 1 - first)
        states = np.full((len(rows), history, USER_SIZE), np.nan)
        valid = np.zeros((len(rows), history), dtype=np.bool_)
        states[:, begin:] = self._states[rows, first : step + 1]
        valid[:, begin:] = self._tracked[rows, first : step + 1]
        ids = np.fromiter(self._rows, dtype=np.int64, count=len(self._rows))[rows]
        return ids, tuple(self._kinds[i] for i in rows), self._size[rows], states, valid

    def _filtered(self, step: int, rows: IntArray, measured: FloatArray) -> FloatArray:
        """(M, 4) the likeliest states of those who are seen; of scenery, what is on the map."""
        if self._filter is None:
            return measured
        self._filter.forget((step - self._last) * self._dt > self._settings.memory + 1e-9)
        estimated, erring = np.array(measured), ~self._scenery[rows]
        estimated[erring] = self._filter.measure(rows[erring], measured[erring])
        return estimated

    def _rows_of(self, users: RoadUsers) -> IntArray:
        """Rows of road users; those who are new get theirs."""
        ids = users.ids.tolist()
        new = [i for i, name in enumerate(ids) if name not in self._rows]
        if new:
            self._add([ids[i] for i in new], [users.kinds[i] for i in new])
        return np.array([self._rows[name] for name in ids], dtype=np.int64)

    def _add(self, ids: Sequence[int], kinds: Sequence[RoadUserKind]) -> None:
        settings, count = self._settings, len(ids)
        for name in ids:
            self._rows[name] = len(self._rows)
        self._kinds += kinds
        self._moves = np.append(self._moves, [kind.moves for kind in kinds])
        self._size = np.concatenate([self._size, np.zeros((count, 2))])
        self._times = np.append(self._times, np.zeros(count, dtype=np.int64))
        if self._filter is not None:
            self._filter.add(self._moves[-count:])
        self._last = np.append(self._last, np.full(count, -1))
        room = ((0, count), (0, 0))
        self._states = np.pad(self._states, (*room, (0, 0)), constant_values=np.nan)
        self._tracked = np.pad(self._tracked, room)
        streams = [
            [np.random.default_rng([*self._key, name % 2**64, part]) for part in (0, 1)]
            for name in ids
        ]
        normal = np.stack([errors.standard_normal((self._steps, _ERRORS)) for errors, _ in streams])
        uniform = np.stack([gaps.random(self._steps) for _, gaps in streams])
        errors = gauss_markov(normal, self._dt, settings.correlation)
        lost = gaps_of(uniform, self._dt, settings.dropout_rate, settings.dropout_duration)
        # Walls and barriers stand on the map: what is seen of them is their true place.
        scenery = np.array([kind is RoadUserKind.STATIC for kind in kinds])
        errors[scenery], lost[scenery] = 0.0, False
        self._scenery = np.append(self._scenery, scenery)
        self._errors = np.concatenate([self._errors, errors])
        self._lost = np.concatenate([self._lost, lost])


def gauss_markov(noise: FloatArray, dt: float, correlation: float) -> FloatArray:
    """First-order Gauss-Markov processes of standard deviation 1.

    Args:
        noise: (N, K, P) independent standard normal numbers, step by step.
        dt: Step, s.
        correlation: Correlation time, s; 0 gives ``noise`` back.

    Returns:
        (N, K, P) the processes, in their stationary state from the first step on.
    """
    kept = np.exp(-dt / correlation) if correlation > 0.0 else 0.0
    process = np.array(noise)
    for step in range(1, noise.shape[1]):
        process[:, step] = kept * process[:, step - 1] + np.sqrt(1.0 - kept**2) * noise[:, step]
    return process


def gaps_of(chance: FloatArray, dt: float, rate: float, duration: float) -> BoolArray:
    """When road users are lost: a Markov chain of two states.

    Args:
        chance: (N, K) independent numbers between 0 and 1, step by step.
        dt: Step, s.
        rate: How often one that is seen is lost, 1/s.
        duration: Mean duration of a gap, s.

    Returns:
        (N, K) whether it is lost, in the stationary state from the first step on.
    """
    begins, ends = rate * dt, dt / duration
    lost = np.zeros(chance.shape, dtype=np.bool_)
    lost[:, :1] = chance[:, :1] < begins / (begins + ends)
    for step in range(1, chance.shape[1]):
        before = lost[:, step - 1]
        lost[:, step] = np.where(before, chance[:, step] >= ends, chance[:, step] < begins)
    return lost
