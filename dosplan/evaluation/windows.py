"""Windows: one road user at one step of a recording, what is known then and what came.

A window counts at a horizon where its true centre is recorded there. Road users that are parked
or static are not predicted and make no windows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.evaluation.groups import KINDS
from dosplan.simulation.world import watch
from dosplan.types import (
    STEP_SECONDS,
    USER_SIZE,
    BoolArray,
    FloatArray,
    IntArray,
    Observation,
    Scenario,
)

STEPS: Final = 40  # Steps of the future that count: 4 s.
HORIZONS: Final = (1.0, 2.0, 3.0, 4.0)  # s; where CR and OSA are given.
HORIZON_COLUMNS: Final = tuple(round(t / STEP_SECONDS) - 1 for t in HORIZONS)


@dataclass(frozen=True)
class Moment:
    """One step of a recording with the windows that begin there.

    Attributes:
        observation: What is known, of N road users.
        rows: (W,) rows of the observation that are windows.
        truth: (W, 40, 4) true states at the steps that follow; NaN where not ``recorded``.
        recorded: (W, 40) whether the road user is recorded; in each row somewhere.
    """

    observation: Observation
    rows: IntArray
    truth: FloatArray
    recorded: BoolArray


def moments(scenario: Scenario, every: int) -> Iterator[Moment]:
    """Walks through a recording.

    The ego stays at its start: it is not predicted.

    Args:
        scenario: The recording.
        every: Steps from one moment to the next, from step 0 on.

    Yields:
        The moments that have a window.
    """
    tracks = scenario.tracks
    predicted = np.array([kind in KINDS for kind in tracks.kinds], dtype=np.bool_)
    for observation in watch(scenario, every):
        step = observation.step
        present = np.flatnonzero(tracks.valid[:, step])
        last = min(step + 1 + STEPS, tracks.steps)
        recorded = np.zeros((len(present), STEPS), dtype=np.bool_)
        recorded[:, : last - step - 1] = tracks.valid[present, step + 1 : last]
        rows = np.flatnonzero(recorded.any(axis=1) & predicted[present])
        if not len(rows):
            continue
        truth = np.full((len(rows), STEPS, USER_SIZE), np.nan)
        truth[:, : last - step - 1] = tracks.states[present[rows], step + 1 : last]
        recorded = recorded[rows]
        truth[~recorded] = np.nan
        yield Moment(
            observation=observation,
            rows=rows,
            truth=truth,
            recorded=recorded,
        )
