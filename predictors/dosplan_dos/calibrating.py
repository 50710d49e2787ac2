"""Calibrates sets by their scores, whatever made them, and tells how that holds on other places.

A score is the smallest factor on the semi-axes with which a set holds the truth; that of a union is
the smallest with which any of its ellipses does. Nothing else of a module is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Final, Self

import numpy as np

from dosplan.evaluation.groups import CELL_WINDOWS, SPEED_BINS
from dosplan.types import FloatArray, IntArray
from dosplan_dos.calibration import SPEED_EDGES, Calibration, Mode, estimate_coverage
from dosplan_dos.conditional import ConditionalScores, cross_fitted
from dosplan_dos.covariates import track_noise

LEVELS: Final = (0.5, 0.7, 0.8, 0.9, 0.95, 0.99)  # Of which is told what they cover.
WANTED: Final = 0.9
FOLDS: Final = 5
SECONDS: Final = (4, 9, 14, 19)  # Columns of the grid at 1, 2, 3 and 4 s.
NOISE_EDGES: Final = (0.003, 0.01, 0.03, 0.1)  # m


@dataclass(frozen=True, eq=False)
class Scored:
    """Windows whose trajectories are of networks that were not trained on their recordings; n.

    Attributes:
        score: (n, G) scores of the truth at the steps of the grid, NaN where it is not recorded.
        area: (n, G) areas of the sets as they were trained, m2.
        speed: (n,) m/s, >= 0.
        kinds: (n,) kinds, as objects.
        recording: (n,) recording.
        covariates: (n, F) see ``covariates.covariates``.
        place: (n,) number of the recording's place.
        places: Names of the places.
    """

    score: FloatArray
    area: FloatArray
    speed: FloatArray
    kinds: np.ndarray[tuple[int], np.dtype[np.object_]]
    recording: IntArray
    covariates: FloatArray
    place: IntArray
    places: tuple[str, ...]

    @property
    def folds(self) -> IntArray:
        """(n,) fold of each window: of about as many windows each; a place stays together."""
        counts = np.bincount(self.place, minlength=len(self.places))
        load, fold = np.zeros(FOLDS), np.zeros(len(self.places), dtype=np.int64)
        for place in np.argsort(-counts, kind="stable"):
            fold[place] = int(np.argmin(load))
            load[fold[place]] += counts[place]
        return np.asarray(fold[self.place])

    def chosen(self, rows: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Self:
        """Some of the windows.

        Args:
            rows: (n,) which.

        Returns:
            These.
        """
        names = [field.name for field in fields(self) if field.name != "places"]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def by_group(self, *modes: Mode) -> list[Calibration]:
        """Calibrates by groups of kind and speed.

        Args:
            modes: What the levels are to be probabilities of.

        Returns:
            A calibration for each.

        Raises:
            ValueError: A step has too few windows.
        """
        return self._fitted(self.score, modes)

    def conditional(self, *modes: Mode) -> list[Calibration]:
        """Calibrates by what is known of each road user.

        Args:
            modes: What the levels are to be probabilities of.

        Returns:
            A calibration for each.

        Raises:
            ValueError: A step has too few windows, or all are of one place.
        """
        given, ranks = cross_fitted(self.score, self.covariates, self.folds)
        return self._fitted(ranks, modes, given)

    def _fitted(
        self, scores: FloatArray, modes: Sequence[Mode], given: ConditionalScores | None = None
    ) -> list[Calibration]:
        """A calibration of these windows by some scores for each mode."""
        about = (self.speed, self.kinds.tolist(), self.recording)
        return [Calibration.fit(scores, *about, mode, given) for mode in modes]


def calibrate(scored: Scored) -> list[Calibration]:
    """Makes all calibrations of a module.

    Args:
        scored: Windows.

    Returns:
        Those of each step and of the whole horizon, by groups and by what is known of each road
        user. The latter need recordings of two places or more and are left out without.

    Raises:
        ValueError: A step has too few windows.
    """
    made = scored.by_group(*Mode)
    return made + scored.conditional(*Mode) if len(np.unique(scored.folds)) > 1 else made


def left_out(scored: Scored, before: Calibration | None = None) -> str:
    """Tells what sets cover of places on which they were not calibrated.

    Args:
        scored: Windows.
        before: A calibration by groups to show beside, such as that for another loop.

    Returns:
        Tables in Markdown: coverage by level, by speed and by the noise of the track, then for each
        way to calibrate the cell of place and speed that it misses by most, how far it is off over
        all of them, areas, and the factor that ``factor_for_recordings`` finds.
    """
    folds = scored.folds
    parts = [(folds == k, folds != k) for k in np.unique(folds)]
    ways: dict[str, Callable[[Scored], Calibration]] = {"by group": lambda s: s.by_group(*_ONE)[0]}
    if len(parts) > 2:
        ways["by what is known"] = lambda s: s.conditional(*_ONE)[0]
    fitted = {
        name: [(own, way(scored.chosen(rest))) for own, rest in parts] if len(parts) > 1 else []
        for name, way in ways.items()
    }
    if before is not None:
        fitted["as calibrated for the loop ideal"] = [(np.ones(len(folds), dtype=bool), before)]
    highest = min(c.highest_level for made in fitted.values() for _, c in made)
    levels = {level: _factors(scored, fitted, level) for level in LEVELS if level <= highest}
    bins = np.searchsorted(SPEED_EDGES, scored.speed, side="right")
    noise = np.searchsorted(NOISE_EDGES, track_noise(scored.covariates), side="right")
    everyone = np.ones(len(folds), dtype=np.bool_)
    covered = [f"{name}, % covered at 1 / 2 / 3 / 4 s" for name in fitted]

    def shares(factors: Mapping[str, FloatArray], rows: np.ndarray) -> list[str]:
        return [_share(scored, of, rows) for of in factors.values()]

    tables = [
        _table(
            ["asked for", *covered],
            [[f"{100 * level:g} %", *shares(of, everyone)] for level, of in levels.items()],
        )
    ]
    if WANTED in levels:
        wanted = levels[WANTED]
        tables += [
            _table(
                [f"{100 * WANTED:g} %, by speed now", *covered],
                [
                    [name, *shares(wanted, bins == b)]
                    for b, name in enumerate(SPEED_BINS)
                    if np.any(bins == b)
                ],
            ),
            _table(
                [f"{100 * WANTED:g} %, those that move, by the noise of their track", *covered],
                [
                    [name, *shares(wanted, (noise == b) & (bins > 0))]
                    for b, name in enumerate(_noise_names())
                    if np.any((noise == b) & (bins > 0))
                ],
            ),
            _table(
                [
                    f"{100 * WANTED:g} %, cells of place and speed",
                    f"the worst of those of {CELL_WINDOWS} windows or more",
                    "root mean square off, points",
                    "mean area at 1 / 2 / 3 / 4 s, m2",
                    f"larger by, for nobody to leave, in {100 * WANTED:g} % of recordings",
                ],
                [
                    [name, *_cells(scored, of, bins), _areas(scored, of), _recordings(scored, of)]
                    for name, of in wanted.items()
                ],
            ),
        ]
    return "\n\n".join(tables)


def factor_for_recordings(ratio: FloatArray, recording: IntArray, level: float) -> float:
    """The factor on all sets with which nobody of a new recording leaves any, that often.

    Windows of a recording are alike, so that a share of windows says little of a whole recording.
    Recordings are exchangeable: with the largest ratio of each of R as its score, the
    ceil((R + 1) level)-th smallest is not exceeded in a new one with a probability of ``level`` or
    more (split conformal with recordings in place of windows).

    Args:
        ratio: (n, G) score over factor on recordings that the factors do not know; NaN where
            nothing is recorded.
        recording: (n,) recording of each window.
        level: The probability.

    Returns:
        The factor; infinite where the recordings are too few for the level.
    """
    _, of = np.unique(recording, return_inverse=True)
    largest = np.zeros(int(of.max()) + 1)
    np.maximum.at(largest, of, np.fmax.reduce(ratio, axis=1, initial=0.0))
    rank = int(np.ceil((len(largest) + 1) * level - 1e-9))
    return float(np.sort(largest)[rank - 1]) if rank <= len(largest) else float("inf")


_ONE: Final = (Mode.PER_STEP,)


def _noise_names() -> list[str]:
    edges = [f"{100 * edge:g}" for edge in NOISE_EDGES]
    between = [f"{low} to {high} cm" for low, high in pairwise(edges)]
    return [f"below {edges[0]} cm", *between, f"{edges[-1]} cm and more"]


def _recordings(scored: Scored, factors: FloatArray) -> str:
    found = factor_for_recordings(scored.score / factors, scored.recording, WANTED)
    return f"{found:.1f} x"


def _factors(
    scored: Scored,
    fitted: Mapping[str, Sequence[tuple[np.ndarray, Calibration]]],
    level: float,
) -> dict[str, FloatArray]:
    """(n, G) factors of each way, on windows that it was not calibrated on."""
    found = {}
    for name, parts in fitted.items():
        if not parts:
            continue
        factors = np.full(scored.score.shape, np.nan)
        for rows, calibration in parts:
            own = scored.chosen(rows)
            factors[rows] = calibration.factors(
                level, own.speed, own.kinds.tolist(), own.covariates
            )
        found[name] = factors
    return found


def _share(scored: Scored, factors: FloatArray, rows: np.ndarray) -> str:
    covered = np.where(np.isfinite(scored.score), scored.score <= factors, np.nan)[rows]
    found = estimate_coverage(covered[:, SECONDS], scored.recording[rows])
    rates = zip(found.rate, found.standard_error, strict=True)
    return " / ".join(f"{100 * rate:.1f} ±{100 * error:.1f}" for rate, error in rates)


def _cells(scored: Scored, factors: FloatArray, bins: IntArray) -> tuple[str, str]:
    """The worst cell, and by how much cells are off, in points."""
    found = sorted(_coverage_by_cell(scored, factors, bins))
    if not found:
        return "none is as large", "-"
    rate, name = found[0]
    off = np.array([rate for rate, _ in found]) - WANTED
    return f"{100 * rate:.1f} % ({name})", f"{100 * np.sqrt(np.mean(off**2)):.1f}"


def _coverage_by_cell(
    scored: Scored, factors: FloatArray, bins: IntArray
) -> Iterator[tuple[float, str]]:
    for p, place in enumerate(scored.places):
        for b, speed in enumerate(SPEED_BINS):
            for second, column in enumerate(SECONDS, 1):
                score = scored.score[:, column]
                rows = (scored.place == p) & (bins == b) & np.isfinite(score)
                if np.sum(rows) >= CELL_WINDOWS:
                    rate = float(np.mean(score[rows] <= factors[rows, column]))
                    yield rate, f"{place}, {speed}, {second} s"


def _areas(scored: Scored, factors: FloatArray) -> str:
    """Mean areas; those of unions as if they grew with the square of the factor, as ellipses do."""
    known = np.isfinite(scored.score)
    area = np.where(known, scored.area * factors**2, 0.0).sum(axis=0) / known.sum(axis=0)
    return " / ".join(f"{area[column]:.2f}" for column in SECONDS)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["--"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
