"""From samples to figures: pools the recordings and averages over groups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dosplan.evaluation.groups import group_windows
from dosplan.evaluation.limits import REPRESENTATIONS
from dosplan.evaluation.metrics import (
    PAPER_AREAS,
    average_displacement,
    clustered_ratio,
    coverage_at_area,
    covered,
    covering_scale,
    mean_displacement,
    scaled_area,
)
from dosplan.evaluation.samples import (
    FileSamples,
    SetSamples,
    TrajectorySamples,
    join_sets,
    join_trajectories,
)
from dosplan.evaluation.windows import HORIZONS
from dosplan.types import BoolArray, IntArray

Rows = list[dict[str, Any]]
Scales = tuple[float | None, ...]


@dataclass(frozen=True)
class _Pool:
    """The windows of all recordings.

    Attributes:
        scenario: (W,) index of the recording.
        recorded: (W, 4) whether the truth is recorded at the horizons.
        groups: Indices of the windows of each group.
    """

    scenario: IntArray
    recorded: BoolArray
    groups: dict[str, IntArray]


def scales(samples: Sequence[FileSamples]) -> list[Scales]:
    """The factors on each method's sets that make them cover 90 % of all windows.

    Args:
        samples: Samples of the reference.

    Returns:
        For each method the factor at 1, 2, 3, 4 s; None where there is none.
    """
    recorded = np.concatenate([s.recorded for s in samples])
    return [
        tuple(covering_scale(sets.distance[recorded[:, h], h]) for h in range(len(HORIZONS)))
        for sets in _each_method(samples)
    ]


def summarise(
    samples: Sequence[FileSamples], labels: Sequence[str], factors: Sequence[Scales]
) -> dict[str, Rows]:
    """Averages the samples over every group.

    Args:
        samples: Samples of the recordings, in their order.
        labels: Labels of the methods.
        factors: What ``scales`` gave for the reference.

    Returns:
        Rows of ``sets``, ``simultaneous``, ``trajectories`` and ``upper_limits``; a figure is
        None where nothing counts.
    """
    scenario = np.repeat(np.arange(len(samples)), [len(s.kind) for s in samples])
    pool = _Pool(
        scenario=scenario,
        recorded=np.concatenate([s.recorded for s in samples]),
        groups=group_windows(
            np.concatenate([s.kind for s in samples]),
            np.concatenate([s.speed for s in samples]),
            np.concatenate([s.light for s in samples]),
            [s.family for s in samples],
            scenario,
        ),
    )
    figures: dict[str, Rows] = {
        "sets": [], "trajectories": [], "upper_limits": [], "simultaneous": []
    }  # fmt: skip
    for label, sets, factor in zip(labels, _each_method(samples), factors, strict=True):
        figures["sets"] += _set_rows(label, sets, factor, pool)
        figures["simultaneous"] += _simultaneous_rows(label, sets, pool)
    for members, trajectories in _each_trajectory(samples):
        names = [labels[i] for i in members]
        figures["trajectories"] += _trajectory_rows(names, trajectories, pool)
        figures["upper_limits"] += _limit_rows(names[0], trajectories, pool)
    return figures


def _each_method(samples: Sequence[FileSamples]) -> Iterator[SetSamples]:
    """Pools one method after the other, so that one copy is held at a time."""
    for parts in zip(*(s.sets for s in samples), strict=True):
        yield join_sets(parts)


def _each_trajectory(
    samples: Sequence[FileSamples],
) -> Iterator[tuple[list[int], TrajectorySamples]]:
    """The methods that agree on the centres in every recording, and these trajectories."""
    members: dict[tuple[str, ...], list[int]] = {}
    for index, digests in enumerate(zip(*(s.digests for s in samples), strict=True)):
        members.setdefault(digests, []).append(index)
    for digests, indices in members.items():
        parts = [s.trajectories[digest] for s, digest in zip(samples, digests, strict=True)]
        yield indices, join_trajectories(parts)


def _set_rows(label: str, sets: SetSamples, factor: Scales, pool: _Pool) -> Rows:
    rows = []
    for group, members in pool.groups.items():
        for h, horizon in enumerate(HORIZONS):
            counted = members[pool.recorded[members, h]]
            distance, scale = sets.distance[counted, h], factor[h]
            rate = clustered_ratio(covered(distance), pool.scenario[counted])
            osa = _mean(sets.area[counted, h])
            shape = None
            if sets.shape is not None and len(counted):
                shape = sets.shape[counted, h].mean(axis=0, dtype=np.float64)
            rows.append(
                {
                    "method": label,
                    "group": group,
                    "horizon_s": horizon,
                    "cr": rate.value,
                    "cr_se": rate.error,
                    "osa": osa,
                    "osa90": scaled_area(osa, scale, shape),
                    "cr90": None if scale is None else _mean(distance <= np.float32(scale)),
                    "scale90": scale,
                    "cr_at_paper_area": coverage_at_area(distance, osa, PAPER_AREAS[h], shape),
                    "n": rate.n,
                }
            )
    return rows


def _simultaneous_rows(label: str, sets: SetSamples, pool: _Pool) -> Rows:
    rows = []
    for group, members in pool.groups.items():
        rate = clustered_ratio(covered(sets.furthest[members]), pool.scenario[members])
        rows.append(
            {
                "method": label,
                "group": group,
                "coverage": rate.value,
                "coverage_se": rate.error,
                "n": rate.n,
            }
        )
    return rows


def _trajectory_rows(names: list[str], samples: TrajectorySamples, pool: _Pool) -> Rows:
    rows = []
    for group, members in pool.groups.items():
        error, count = samples.error[members], samples.count[members]
        displacements = [mean_displacement(error[:, h]) for h in range(len(HORIZONS))]
        best = samples.best_error[members]
        closest = [mean_displacement(best[:, h]) for h in range(len(HORIZONS))]
        rows.append(
            {
                "model": names[0],
                "group": group,
                "ade": average_displacement(samples.total[members], count),
                "fde": displacements[-1],
                "displacement": displacements,
                "n": int(np.count_nonzero(count)),
                "n_at": [int(np.isfinite(error[:, h]).sum()) for h in range(len(HORIZONS))],
                "methods": names,
                "components": int(samples.components[members].max(initial=0)),
                "min_ade": average_displacement(samples.best_total[members], count),
                "min_fde": closest[-1],
                "min_displacement": closest,
            }
        )
    return rows


def _limit_rows(model: str, samples: TrajectorySamples, pool: _Pool) -> Rows:
    rows = []
    for group, members in pool.groups.items():
        for h, horizon in enumerate(HORIZONS):
            counted = members[np.isfinite(samples.error[members, h])]
            for best_of in range(1, samples.limits.shape[-1] + 1):
                added = f", best of {best_of}" if best_of > 1 else ""
                for r, representation in enumerate(REPRESENTATIONS):
                    rows.append(
                        {
                            "model": model,
                            "group": group,
                            "horizon_s": horizon,
                            "representation": representation + added,
                            "area": _mean(samples.limits[counted, h, r, best_of - 1]),
                            "n": len(counted),
                        }
                    )
    return rows


def _mean(values: npt.NDArray[Any]) -> float | None:
    """The mean; None of nothing, and of sets without bounds."""
    mean = float(values.mean(dtype=np.float64)) if len(values) else np.inf
    return mean if np.isfinite(mean) else None
