"""Which road users the ego of a run met: for trainings on what a planner pays for.

Windows of recordings count a car at the far end of the map like the one that cuts in. A run says
whom an ego came near, and when.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dosplan.evaluation.tails import NEAR
from dosplan.results.drive import Drive, find_recording
from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_run
from dosplan.system.files import FileError
from dosplan.types import BoolArray, FloatArray, IntArray, Tracks


class DrivenPath(NamedTuple):
    """Where an ego was.

    Attributes:
        start: Step of the first place.
        centres: (K, 2) centres of the ego at the steps from there on, m.
    """

    start: int
    centres: FloatArray


Drives = Mapping[int, Sequence[DrivenPath]]
"""The drives of a recording, by the future that was driven."""


def read_drives(run: Path) -> dict[str, Drives]:
    """Reads where the egos of a run drove, in every arm.

    Args:
        run: The folder of a finished run in recorded traffic, with its episode files.

    Returns:
        The drives by the id of the scenario; those that failed before they began are left out.

    Raises:
        FileError: The folder cannot be read, or its traffic reacted to the ego: others than the
            recorded road users were met then.
    """
    manifest, rows = read_run(run)
    if manifest.config.traffic != "replay":
        raise FileError(
            f"{run} was driven in traffic {manifest.config.traffic}, so what its ego met is not "
            "what was recorded: drive it with --traffic replay"
        )
    folder = RunFolder(run)
    found: dict[str, dict[int, list[DrivenPath]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        if (recording := find_recording(folder, row)) is not None:
            drive = Drive(row, recording)
            path = DrivenPath(drive.start, drive.ego[:, :2])
            found[row.scenario][row.future].append(path)
    return {name: dict(drives) for name, drives in found.items()}


def are_met(
    step: int, horizon: int, tracks: Tracks, rows: IntArray, paths: Sequence[DrivenPath]
) -> BoolArray:
    """Whose way an ego shares, now or within the horizon.

    Args:
        step: The present step.
        horizon: Number of steps after it.
        tracks: The road users of the future that was driven.
        rows: (N,) those that are asked about.
        paths: Drives in that future.

    Returns:
        (N,) whether the centres of the road user and of an ego are within ``NEAR`` of each other at
        a step of the drive, from the present one up to the horizon.
    """
    met = np.zeros(len(rows), dtype=np.bool_)
    for path in paths:
        first = max(step, path.start)
        last = min(step + horizon, path.start + len(path.centres) - 1, tracks.steps - 1)
        if path.start > step or first > last:
            continue
        steps = np.arange(first, last + 1)
        index = np.ix_(rows, steps)
        apart = tracks.states[index][..., :2] - path.centres[steps - path.start]
        close = tracks.valid[index] & (np.hypot(apart[..., 0], apart[..., 1]) <= NEAR)
        met |= np.any(close, axis=1)
    return met
