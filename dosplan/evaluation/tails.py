"""What the planner pays for its sets: who left them on the drives of a run, and by how much.

Coverage over the windows of recordings counts a parked row like the car that cuts in. Here the
road users that come near the ego count, in the traffic that the ego met, with the sets that its
planner was handed, at the steps for which a run keeps them (``dosplan.results.recording``).

The distance is d_M of the true centre, the least of the components where a set is a union: 1 on
the boundary of the set, 2 where it would have to be twice as long and wide.

An episode holds if nobody near left a set at any step that was compared. Episodes of scenarios
that are exchangeable with new ones tell the rate of new ones; the intervals take into account that
scenarios of one place resemble each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np

from dosplan.evaluation.kept_sets import KeptSets
from dosplan.results.drive import Drive, DrivenScenarios, drives_of
from dosplan.results.folder import RunFolder
from dosplan.results.intervals import Interval, share_interval
from dosplan.results.recording import Recording
from dosplan.results.rows import read_run
from dosplan.system.files import FileError
from dosplan.system.provenance import describe_environment
from dosplan.types import STEP_SECONDS, Arm, BoolArray, FloatArray, IntArray, Tracks

NEAR: Final = 20.0
"""m between the centres of ego and road user at the step that is compared."""

AHEAD: Final = (5, 10, 20, 30)
"""Steps after that of the plan: 0.5, 1, 2 and 3 s."""

NEARBY: Final = "near the ego"
GROUPS: Final = (NEARBY, "all that the run keeps")

BEFORE: Final = 5
"""Steps before a collision at which the set of the road user that was struck was made: 0.5 s."""

QUANTILES: Final = (0.5, 0.9, 0.99)


@dataclass(frozen=True)
class Comparisons:
    """Sets and what came of the road users, of one drive; M comparisons.

    Attributes:
        cycle: (M,) planning cycle that the set was made in.
        ids: (M,) road user.
        ahead: (M,) steps from the cycle's own to the one that is compared.
        distance: (M,) normalised distance of the true centre.
        beyond: (M,) how far the true centre is outside of the set, seen from the set's centre, m.
        near: (M,) whether the road user was near the ego then.
    """

    cycle: IntArray
    ids: IntArray
    ahead: IntArray
    distance: FloatArray
    beyond: FloatArray
    near: BoolArray


def compare_sets(recording: Recording, tracks: Tracks, ego: FloatArray) -> Comparisons:
    """Compares the sets that a recording keeps with what was driven.

    Sets that are points are no sets: they are left out, as are steps at which the road user was
    not on the scene or that the drive did not reach.

    Args:
        recording: The drive.
        tracks: The road users as they were driven.
        ego: (K + 1, 2) centres of the ego, m, as far as the drive was scored.

    Returns:
        The comparisons, by cycle and road user.
    """
    kept = KeptSets.of(recording, tracks)
    at = kept.made[:, None] + kept.offsets
    last = recording.start_step + len(ego) - 1
    there = ego[np.minimum(at, last) - recording.start_step]
    near = np.linalg.norm(kept.truth - there, axis=-1) <= NEAR
    which, column = np.nonzero(np.isfinite(kept.distance) & (at <= last))
    return Comparisons(
        cycle=kept.cycle[which],
        ids=kept.ids[which],
        ahead=kept.offsets[column],
        distance=kept.distance[which, column],
        beyond=kept.beyond[which, column],
        near=near[which, column],
    )


def struck_distance(drive: Drive, compared: Comparisons) -> float | None:
    """Where the road user that was struck was in the set made half a second before.

    Args:
        drive: The drive.
        compared: Its comparisons.

    Returns:
        The normalised distance at the step of the contact. Where no plan was made exactly half a
        second before the contact, the latest plan before that counts, and the distance is that at
        half a second after it. None where nobody was struck, or whoever it was had no set.
    """
    step, struck = drive.row.collision_step, drive.row.collision_with
    if step is None or struck is None:
        return None
    at = drive.recording.cycle_steps[compared.cycle] + compared.ahead
    chosen = (compared.ids == struck) & (compared.ahead == BEFORE) & (at <= step)
    chosen &= at > step - 2 * BEFORE
    if not np.any(chosen):
        return None
    candidates = np.flatnonzero(chosen)
    return float(compared.distance[candidates[np.argmax(at[candidates])]])


def evaluate_drives(
    path: Path,
    source: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Measures the sets of a finished run on its drives.

    Args:
        path: The run folder.
        source: Where the scenarios lie now; where the run found them if None.
        progress: Called with the number of scenarios that are done and of all.

    Returns:
        The content of ``--json``: ``tails``, a row for each time ahead, of those near the ego and
        of all that the run keeps; ``episodes``, the share in which nobody near left a set;
        ``struck``, a row for each collision; and ``data``, what it was measured on.

    Raises:
        FileError: It is not the folder of a finished run with sets, or what was driven cannot be
            read.
    """
    manifest, rows = read_run(path)
    driven = [row for row in rows if row.arm is Arm.WITH_DOS]
    folder, scenes = RunFolder(path), DrivenScenarios(manifest, source)
    by_scenario = {name: list(of) for name, of in groupby(driven, key=lambda row: row.scenario)}
    parts: list[Comparisons] = []
    of: list[str] = []
    struck: list[dict[str, Any]] = []
    progress(0, len(by_scenario))
    for done, (name, episodes) in enumerate(by_scenario.items(), 1):
        for row, drive in drives_of(folder, episodes, scenes):
            if drive is None:
                continue
            compared = compare_sets(drive.recording, drive.tracks, drive.ego[:, :2])
            parts.append(compared)
            of.append(name)
            if row.collision_with is not None:
                distance = struck_distance(drive, compared)
                struck.append(
                    {
                        "scenario": name,
                        "future": row.future,
                        "at_fault": row.at_fault,
                        "road_user": row.collision_with,
                        "distance": distance,
                        "inside": None if distance is None else distance <= 1.0,
                    }
                )
        progress(done, len(by_scenario))
    if not any(len(part.ids) for part in parts):
        raise FileError(f"{path} holds no drive in which a road user had a set")
    return {
        "tails": list(_tails(parts)),
        "episodes": list(_episodes(parts, of)),
        "struck": struck,
        "data": {
            "run": str(path),
            "planner": manifest.planner,
            "predictor": manifest.predictor,
            "loop": manifest.loop,
            "traffic": manifest.traffic,
            "drives": len(parts),
            "near_m": NEAR,
            "failed": [],
            **asdict(describe_environment()),
        },
    }


def _tails(parts: Sequence[Comparisons]) -> Iterator[dict[str, Any]]:
    """A row for each group and time ahead."""
    for group in GROUPS:
        for ahead in AHEAD:
            chosen = [(part.ahead == ahead) & (part.near | (group != NEARBY)) for part in parts]
            pairs = list(zip(parts, chosen, strict=True))
            distance = np.concatenate([np.empty(0), *(part.distance[of] for part, of in pairs)])
            beyond = np.concatenate([np.empty(0), *(part.beyond[of] for part, of in pairs)])
            outside = distance > 1.0
            yield {
                "group": group,
                "ahead_s": ahead * STEP_SECONDS,
                "n": len(distance),
                "road_users": sum(len(np.unique(part.ids[of])) for part, of in pairs),
                "outside": float(outside.mean()) if len(distance) else None,
                "distance": _quantiles(distance),
                "distance_outside": _quantiles(distance[outside]),
                "beyond_m": _quantiles(beyond[outside]),
            }


def _quantiles(values: FloatArray) -> dict[str, float | None]:
    """Quantiles by their level; None where there is no value."""
    found = np.quantile(values, QUANTILES, method="higher") if len(values) else None
    return {
        f"{level:g}": None if found is None else float(found[i])
        for i, level in enumerate(QUANTILES)
    }


def _episodes(parts: Sequence[Comparisons], of: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A row for each time ahead, and for all of them together, of the episodes that hold."""
    for ahead in (*AHEAD, None):
        held, scenarios = [], []
        for part, name in zip(parts, of, strict=True):
            chosen = part.near & np.isin(part.ahead, AHEAD if ahead is None else ahead)
            if np.any(chosen):
                held.append(float(np.all(part.distance[chosen] <= 1.0)))
                scenarios.append(name)
        interval = share_interval(np.array(held), scenarios) if held else None
        yield {
            "ahead_s": None if ahead is None else ahead * STEP_SECONDS,
            "n": len(held),
            **_interval(interval),
        }


def _interval(interval: Interval | None) -> Mapping[str, float | None]:
    if interval is None:
        return {"held": None, "low": None, "high": None}
    return {"held": interval.value, "low": interval.low, "high": interval.high}
