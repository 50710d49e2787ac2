"""Windows: one road user at one step of a recording, what is known then and what came.

What is known is what the loop between ego and world shows of it, what came is the recording. In a
loop with a latency, the future begins when a plan acts that is made of what is known. A window
counts at a horizon where its true centre is recorded there. Road users that are parked or static
are not predicted and make no windows, nor do those who are not seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.evaluation.groups import KINDS
from dosplan.simulation.settings import IDEAL, LoopSettings
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
        now: (W, 4) true states at the observation's step.
        size: (W, 2) true length and width, m.
        truth: (W, 40, 4) true states at the steps that follow ``observation.step`` and the loop's
            latency; NaN where not ``recorded``.
        recorded: (W, 40) whether the road user is recorded; in each row somewhere.
    """

    observation: Observation
    rows: IntArray
    now: FloatArray
    size: FloatArray
    truth: FloatArray
    recorded: BoolArray


def moments(
    scenario: Scenario,
    every: int,
    loop: LoopSettings = IDEAL,
    *,
    seed: int = 0,
    reach: int = STEPS,
) -> Iterator[Moment]:
    """Walks through a recording.

    The ego stays at its start: it is not predicted.

    Args:
        scenario: The recording.
        every: Steps from one moment to the next, from step 0 on.
        loop: What is seen, and how late it is acted upon.
        seed: Seed of the errors of what is seen.
        reach: Steps of the future that are predicted when it is acted upon; no later one counts.

    Yields:
        The moments that have a window.
    """
    tracks = scenario.tracks
    row_of = {name: row for row, name in enumerate(tracks.ids.tolist())}
    for observation in watch(scenario, every, loop=loop, seed=seed):
        step, acts = observation.step, observation.step + loop.latency_steps
        first = min(acts + 1, tracks.steps)
        last = min(first + min(reach, STEPS), tracks.steps)
        of = np.array([row_of[name] for name in observation.ids.tolist()], dtype=np.int64)
        predicted = np.array([kind in KINDS for kind in observation.kinds], dtype=np.bool_)
        recorded = np.zeros((len(of), STEPS), dtype=np.bool_)
        recorded[:, : last - first] = tracks.valid[of, first:last]
        # One that is carried on may be gone.
        rows = np.flatnonzero(recorded.any(axis=1) & predicted & tracks.valid[of, step])
        if not len(rows):
            continue
        of, recorded = of[rows], recorded[rows]
        truth = np.full((len(rows), STEPS, USER_SIZE), np.nan)
        truth[:, : last - first] = tracks.states[of, first:last]
        truth[~recorded] = np.nan
        yield Moment(
            observation=observation,
            rows=rows,
            now=tracks.states[of, step],
            size=tracks.size[of],
            truth=truth,
            recorded=recorded,
        )
