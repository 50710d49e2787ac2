"""Sets that grow for whoever leaves them: adaptive conformal inference within an episode.

Whoever was outside of earlier sets is likelier to be outside of the next: its intention, its noise
or its place is not like that of the recordings that sets were calibrated on. The loop sees this at
every step. Each road user has a number g, and its sets are exp(g) times as long and wide as they
were calibrated. At each step the sets that were handed out for it up to ``REACH`` steps before are
compared with where it is seen now, and with e the share of these that it is outside of,

    g <- max(g + rate (e - alpha), 0),    alpha = 1 - coverage.

This is the update of Gibbs and Candes, "Adaptive conformal inference under distribution shift"
(2021), on the logarithm of the size instead of the level, as quantile tracking does (Angelopoulos,
Candes and Tibshirani, "Conformal PID control for time series prediction", 2023): a level cannot ask
for more than the largest score of the calibration. Sets never get smaller than calibrated ones, as
a calm second says little about the next. Who is seen for the first time begins with the mean of
those who are there: the noise of a place is common to its road users.

**What holds at the level of an episode**, whatever the road users do: over the K steps at which a
road user was compared, the mean of e is at most

    alpha + (g_K - g_0) / (rate K).

Since g grows only while sets of the last ``REACH`` steps fail, g_K is at most the larger of g_0 and
log(s) + (1 - alpha) rate REACH, with s the largest distance to a calibrated set. The bound is about
what was seen: in a loop whose sensors err, about seen positions. One that is not seen for a while
and carried on counts as seen there.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.geometry import mahalanobis
from dosplan.types import BoolArray, FloatArray, IntArray, Observation, Occupancy

REACH: Final = 10
"""Steps ahead up to which sets are compared: 1 s. Of later ones it would be known too late that
they fail, and sets would go on growing when they hold again."""


@dataclass(frozen=True)
class _HandedOut:
    """Sets that were handed out at a step; R ellipses."""

    step: int
    ids: IntArray
    centre: FloatArray
    semi_axes: FloatArray
    angle: FloatArray
    valid: BoolArray


class Adaptation:
    """The growth of each road user's sets, from step to step of an episode."""

    def __init__(self, rate: float, coverage: float) -> None:
        """Begins an episode.

        Args:
            rate: How fast sets grow, see the top of the module.
            coverage: Share that is to be inside.
        """
        self._rate = rate
        self._alpha = 1.0 - coverage
        self._growth: dict[int, float] = {}
        self._compared: set[int] = set()
        self._past: deque[_HandedOut] = deque(maxlen=REACH)
        self._step: int | None = None

    def observe(self, observation: Observation) -> FloatArray:
        """Compares what is seen with the sets that were handed out.

        Args:
            observation: What is known now; a second time at a step, nothing is learned from it.

        Returns:
            (N,) factors on the semi-axes of the sets that are handed out next.
        """
        ids = observation.ids.tolist()
        if self._step is None or observation.step > self._step:
            missed = self._missed(observation)
            for row in np.flatnonzero(np.isfinite(missed)):
                g = self._growth[ids[row]] + self._rate * (missed[row] - self._alpha)
                self._growth[ids[row]] = max(float(g), 0.0)
                self._compared.add(ids[row])
            # Who cannot move is never compared, and says nothing of newcomers.
            known = [self._growth[name] for name in ids if name in self._compared]
            prior = float(np.mean(known)) if known else 0.0
            for name in ids:
                self._growth.setdefault(name, prior)
            self._step = observation.step
        return np.exp([self._growth[name] for name in ids])

    def remember(self, observation: Observation, occupancy: Occupancy) -> None:
        """Keeps the sets that are handed out.

        Args:
            observation: What they were made from.
            occupancy: The sets.
        """
        if self._past and self._past[-1].step >= observation.step:
            return
        each, _, _ = occupancy.first_steps(REACH).by_component()
        kept = np.any(each.semi_axes > 0.0, axis=(1, 2))
        self._past.append(
            _HandedOut(
                step=observation.step,
                ids=each.ids[kept],
                centre=each.centre[kept],
                semi_axes=each.semi_axes[kept],
                angle=each.angle[kept],
                valid=each.valid[kept],
            )
        )

    def _missed(self, observation: Observation) -> FloatArray:
        """(N,) share of each road user's sets for this step that it is outside of; NaN of none."""
        row_of = {name: row for row, name in enumerate(observation.ids.tolist())}
        n = len(row_of)
        total, outside = np.zeros(n), np.zeros(n)
        for sets in self._past:
            column = observation.step - sets.step - 1
            if not 0 <= column < sets.valid.shape[1]:
                continue
            row = np.array([row_of.get(name, -1) for name in sets.ids.tolist()], dtype=np.int64)
            there = np.flatnonzero((row >= 0) & sets.valid[:, column])
            row = row[there]
            distance = mahalanobis(
                observation.states[row, -1, :2],
                sets.centre[there, column],
                sets.semi_axes[there, column],
                sets.angle[there, column],
            )
            # A set that is a union is several ellipses of one road user: any of them will do.
            least = np.full(n, np.inf)
            np.minimum.at(least, row, distance)
            compared = np.zeros(n, dtype=np.bool_)
            compared[row] = True
            total += compared
            outside += compared & (least > 1.0)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(total > 0, outside / total, np.nan))
