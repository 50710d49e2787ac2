"""Coverage of the sets as met in the episodes, from their files and the road users as driven.

A set that was handed to the planner at step s for a road user t steps ahead counts where it is
known where that road user was at s + t: it is a hit where the true centre lies inside it, for a
union inside any of its components.
Recordings keep the sets near the ego only, so these are the ones that mattered to it. Sets without
an extent (the arm without DOS) are no sets and do not count.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dosplan.evaluation.groups import MOVING
from dosplan.evaluation.kept_sets import KeptSets
from dosplan.results.recording import Recording
from dosplan.types import USER_VELOCITY, BoolArray, FloatArray, IntArray, Tracks


@dataclass(frozen=True)
class SetsMet:
    """The kept sets of an episode against the truth; M sets, S kept steps ahead.

    Attributes:
        step: (M,) step at which each was made.
        ids: (M,) id of the road user.
        offsets: (S,) steps ahead.
        miss: (M, S) distance of the predicted from the true centre, that of the most likely
            component, m; NaN where that is unknown.
        counted: (M, S) whether the set has an extent and the true centre is known.
        inside: (M, S) whether it held the true centre; False where not counted.
        moving: (M,) whether the road user moved when it was predicted.
    """

    step: IntArray
    ids: IntArray
    offsets: IntArray
    miss: FloatArray
    counted: BoolArray
    inside: BoolArray
    moving: BoolArray


@dataclass(frozen=True)
class Prediction:
    """What was predicted of a road user for a moment.

    Attributes:
        offset: Steps before the moment.
        miss: Distance of the predicted from the true centre, m.
        held: Whether the set held the true centre; None where a point was predicted.
    """

    offset: int
    miss: float
    held: bool | None


@dataclass(frozen=True)
class Coverage:
    """Hits at one horizon.

    Attributes:
        offset: Steps ahead.
        inside: Sets of moving road users that held the true centre.
        counted: Sets of moving road users whose true centre is known.
        all_inside: The same for all road users, standing ones too.
        all_counted: Likewise.
    """

    offset: int
    inside: int
    counted: int
    all_inside: int
    all_counted: int


def sets_met(recording: Recording, tracks: Tracks, driven: int) -> SetsMet:
    """Compares the sets that were met during the scored drive with the truth.

    Args:
        recording: The episode.
        tracks: The road users as they were driven.
        driven: Number of steps of the scored drive.

    Returns:
        The comparisons, of the cycles of that drive.
    """
    kept = KeptSets.of(recording, tracks)
    now = tracks.states[kept.rows, np.minimum(kept.made, tracks.steps - 1), USER_VELOCITY]
    scored = kept.made < recording.start_step + driven
    return SetsMet(
        step=kept.made[scored],
        ids=kept.ids[scored],
        offsets=kept.offsets,
        miss=kept.miss[scored],
        counted=~np.isnan(kept.distance[scored]),
        inside=kept.distance[scored] <= 1.0,
        moving=np.abs(now[scored]) >= MOVING,
    )


def total(met: Iterable[SetsMet]) -> list[Coverage]:
    """Adds up the hits of several episodes.

    Args:
        met: The sets of each, compared with the truth.

    Returns:
        One entry for each horizon at which a set was counted, ascending.
    """
    sums: dict[int, IntArray] = {}
    for episode in met:
        moving = episode.moving[:, None]
        columns = np.stack(
            [
                np.sum(mask, axis=0)
                for mask in (
                    episode.inside & moving,
                    episode.counted & moving,
                    episode.inside,
                    episode.counted,
                )
            ],
            axis=1,
        )
        for offset, counts in zip(episode.offsets.tolist(), columns, strict=True):
            sums[offset] = sums.get(offset, np.zeros(4, dtype=np.int64)) + counts
    return [
        Coverage(offset, *map(int, counts))
        for offset, counts in sorted(sums.items())
        if counts[3] > 0
    ]


def predictions_of(met: SetsMet, user: int, step: int) -> list[Prediction]:
    """Looks up what was predicted of a road user for a moment.

    Args:
        met: The sets of the episode.
        user: Id of the road user.
        step: The moment: that of a contact, say.

    Returns:
        One entry for each time before the moment at which there was a prediction, the latest
        first.
    """
    answer = []
    for column, offset in enumerate(met.offsets.tolist()):
        made = (met.ids == user) & (met.step == step - offset) & np.isfinite(met.miss[:, column])
        for row in np.flatnonzero(made):
            held = bool(met.inside[row, column]) if met.counted[row, column] else None
            answer.append(Prediction(offset, float(met.miss[row, column]), held))
    return answer
