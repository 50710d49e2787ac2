"""The sets that a run keeps of a drive, compared with what was driven.

The true centres are those of what was driven, not of what the ego saw. A union holds whom any of
its components holds: its distance is the least of theirs. Sets without an extent, as those of the
arm without DOS, are points: they have a miss, but no distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.geometry import mahalanobis
from dosplan.results.recording import Recording
from dosplan.types import USER_X, USER_Y, FloatArray, IntArray, Tracks

_ROUNDING: Final = 0.02
"""m by which semi-axes are longer here: a run keeps places and axes rounded to 1/64 m, which is
more than what a set of someone at rest may measure."""


@dataclass(frozen=True)
class KeptSets:
    """U sets, each of a road user as predicted in a planning cycle, at S steps ahead.

    Attributes:
        cycle: (U,) planning cycle that each was made in.
        ids: (U,) road user.
        rows: (U,) its row in the tracks; -1 where it is not in them.
        made: (U,) step that each was made at.
        offsets: (S,) steps ahead of that.
        truth: (U, S, 2) true centres, m; NaN where the road user was not on the scene.
        miss: (U, S) distance of the predicted from the true centre, of a union that of its most
            likely component, m; NaN where one of them is not known.
        distance: (U, S) normalised distance of the true centre: 1 on the boundary of the set; NaN
            where it is not known or the set is a point.
        beyond: (U, S) how far the true centre is outside of the set, seen from the set's centre, m;
            NaN where ``distance`` is.
    """

    cycle: IntArray
    ids: IntArray
    rows: IntArray
    made: IntArray
    offsets: IntArray
    truth: FloatArray
    miss: FloatArray
    distance: FloatArray
    beyond: FloatArray

    @classmethod
    def of(cls, recording: Recording, tracks: Tracks) -> KeptSets:
        """Compares the sets of a recording.

        Args:
            recording: The drive.
            tracks: The road users as they were driven.

        Returns:
            The comparisons, in the order of the recording.
        """
        row_of = {int(name): row for row, name in enumerate(tracks.ids)}
        user = np.array([row_of.get(int(name), -1) for name in recording.set_ids], dtype=np.int64)
        made = recording.cycle_steps[recording.set_cycle]
        step = made[:, None] + recording.set_offsets
        column = np.minimum(step, tracks.steps - 1)
        there = (user >= 0)[:, None] & (step < tracks.steps) & tracks.valid[user[:, None], column]
        centres = tracks.states[user[:, None], column][..., [USER_X, USER_Y]]
        truth = np.where(there[..., None], centres, np.nan)
        miss = np.linalg.norm(truth - recording.set_centres, axis=-1)
        distance = mahalanobis(
            truth,
            recording.set_centres,
            recording.set_semi_axes + _ROUNDING,
            recording.set_angles,
        )
        point = ~np.all(recording.set_semi_axes > 0.0, axis=-1)
        distance = np.where(point | np.isnan(miss), np.nan, distance)
        beyond = miss * (1.0 - 1.0 / np.maximum(distance, 1.0))
        first = recording.first_components
        return cls(
            cycle=recording.set_cycle[first],
            ids=recording.set_ids[first],
            rows=user[first],
            made=made[first],
            offsets=recording.set_offsets,
            truth=truth[first],
            miss=miss[first],
            distance=_least(distance, first),
            beyond=_least(beyond, first),
        )


def _least(values: FloatArray, first: IntArray) -> FloatArray:
    """(U, S) the least of the components, of which the first are at these rows."""
    return np.asarray(np.fmin.reduceat(values, first, axis=0)) if len(first) else values
