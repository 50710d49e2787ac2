"""The sets of an episode in a page: for each road user and step ahead, a series over the cycles.

A set that is a union has a series for each of its components, the most likely one first.

Road users do not react to the ego, so the arms of a run see the same predictions; where those of
two sides agree they are stored once. A block of predictions with an extent is drawn as sets for the
side that was handed sets, and as points for the side that was handed points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from dosplan.report.html.codec import AXIS, METRE, RADIAN, differences
from dosplan.results.recording import Recording
from dosplan.types import BoolArray, FloatArray, IntArray

AGREE_METRES: Final = 0.05
"""Centres that differ by no more than this are the same prediction."""

_Key = tuple[int, int, int]  # Step, id of the road user, and place among the components.
_Set = FloatArray  # (S, 5) centre, m, semi-axes, m, and angle, rad; NaN where not valid.
_PERCENT: Final = 0.01


@dataclass(frozen=True)
class _Predictions:
    offsets: tuple[int, ...]
    sets: dict[_Key, _Set]
    weights: dict[_Key, float]

    @property
    def points(self) -> bool:
        """Whether no set has an extent."""
        return not any(np.any(one[:, 2:4] > 0.0) for one in self.sets.values())


def prediction_blocks(
    recordings: Sequence[Recording | None],
    driven: Sequence[int],
    users: Mapping[int, int] | None,
    origin: FloatArray,
) -> tuple[list[dict[str, Any]], list[dict[str, Any] | None]]:
    """Writes the predictions of the sides.

    Args:
        recordings: The recording of each side, or None.
        driven: Steps of the scored drive of each.
        users: Index in the payload of each road user that is kept, by id; None keeps all, without
            an index.
        origin: (2,) what positions are relative to, m.

    Returns:
        The blocks, and for each side which block is its own and whether it shows points only.
    """
    found = [
        None if recording is None else _predictions(recording, steps, users)
        for recording, steps in zip(recordings, driven, strict=True)
    ]
    blocks: list[_Predictions] = []
    used: list[dict[str, Any] | None] = [None] * len(found)
    # Those with sets first: points may join them, but not the other way round.
    there = [(side, mine) for side, mine in enumerate(found) if mine is not None]
    for side, mine in sorted(there, key=lambda one: one[1].points):
        block = next((i for i, other in enumerate(blocks) if _agree(other, mine)), len(blocks))
        if block == len(blocks):
            blocks.append(_Predictions(mine.offsets, {}, {}))
        for key, one in mine.sets.items():
            if key not in blocks[block].sets:
                blocks[block].sets[key] = one
                blocks[block].weights[key] = mine.weights[key]
        used[side] = {"block": block, "points": mine.points}
    return [_encode(block, users, origin) for block in blocks], used


def _predictions(
    recording: Recording, driven: int, users: Mapping[int, int] | None
) -> _Predictions:
    steps = recording.cycle_steps[recording.set_cycle]
    kept = steps < recording.start_step + driven
    if users is not None:
        kept &= np.isin(recording.set_ids, list(users))
    rows = np.concatenate(
        [recording.set_centres, recording.set_semi_axes, recording.set_angles[..., None]], axis=-1
    )
    first = recording.first_components
    place = np.arange(len(steps)) - np.repeat(first, np.diff(first, append=len(steps)))
    names = list(zip(steps.tolist(), recording.set_ids.tolist(), place.tolist(), strict=True))
    chosen = np.flatnonzero(kept).tolist()
    return _Predictions(
        offsets=tuple(recording.set_offsets.tolist()),
        sets={names[i]: rows[i] for i in chosen},
        weights={names[i]: float(recording.weights[i]) for i in chosen},
    )


def _agree(ours: _Predictions, theirs: _Predictions) -> bool:
    """Whether two sides had the same predictions, where both had any."""
    if ours.offsets != theirs.offsets:
        return False
    common = ours.sets.keys() & theirs.sets.keys()
    columns = slice(0, 2) if theirs.points else slice(0, 4)
    return all(
        np.allclose(
            ours.sets[key][:, columns],
            theirs.sets[key][:, columns],
            rtol=0.0,
            atol=AGREE_METRES,
            equal_nan=True,
        )
        for key in common
    )


def _encode(
    block: _Predictions, users: Mapping[int, int] | None, origin: FloatArray
) -> dict[str, Any]:
    steps = sorted({step for step, _, _ in block.sets})
    position = {step: index for index, step in enumerate(steps)}
    runs = []
    for user, place in sorted({(user, place) for _, user, place in block.sets}):
        there = [position[step] for step in steps if (step, user, place) in block.sets]
        for run in _runs(there):
            keys = [(steps[index], user, place) for index in run]
            series = np.stack([block.sets[key] for key in keys])
            weights = [block.weights[key] for key in keys]
            component = {"component": place, "weights": differences(weights, _PERCENT, 1)}
            runs.append(
                {
                    "user": None if users is None else users[user],
                    "from": run[0],
                    "n": len(run),
                    "sets": [_encode_series(series[:, s], origin) for s in range(series.shape[1])],
                    **({} if place == 0 and min(weights) == 1.0 else component),
                }
            )
    return {"offsets": list(block.offsets), "steps": differences(steps, 1.0, 1), "runs": runs}


def _encode_series(series: FloatArray, origin: FloatArray) -> list[list[int]]:
    """(C, 5) one step ahead over the cycles; negative semi-axes mean nothing to draw."""
    hidden: BoolArray = np.asarray(np.isnan(series).any(axis=1))
    if hidden.all():
        return []
    filled = series[_last_seen(np.logical_not(hidden))]
    filled[:, :2] -= origin
    axes = np.where(hidden[:, None], -AXIS, filled[:, 2:4])
    # An ellipse turned by half a turn is the same, so its angle need never jump by one.
    angle = np.unwrap(filled[:, 4], period=np.pi)
    return [
        differences(filled[:, 0], METRE, 2),
        differences(filled[:, 1], METRE, 2),
        differences(axes[:, 0], AXIS, 1),
        differences(axes[:, 1], AXIS, 1),
        differences(angle, RADIAN, 1),
    ]


def _last_seen(there: BoolArray) -> IntArray:
    """(C,) index of the latest element that is there, or of the first one at the beginning."""
    index = np.where(there, np.arange(len(there)), 0)
    return np.asarray(np.maximum(np.maximum.accumulate(index), int(np.argmax(there))))


def _runs(indices: Sequence[int]) -> list[list[int]]:
    """Splits ascending indices where one is missing."""
    runs = [[indices[0]]]
    for before, index in pairwise(indices):
        if index == before + 1:
            runs[-1].append(index)
        else:
            runs.append([index])
    return runs
