"""Split-conformal calibration of occupancy sets, group by group.

The *score* of a recorded truth is its Mahalanobis distance d_M to the predicted ellipse, 1 on the
boundary: semi-axes scaled by a factor q cover every truth with d_M <= q. Of n scores that are
exchangeable with a new one, the ceil((n + 1) level)-th smallest covers the new one with a
probability in [level, level + 1 / (n + 1)] (Vovk, Gammerman, Shafer, "Algorithmic Learning in a
Random World"; Lei et al., "Distribution-Free Predictive Inference for Regression"). Taken within
groups that are known beforehand (Mondrian), this holds in each group.

* **Groups**: the speed now, in five bins, times vehicle or vulnerable. A group that is too small
  borrows from the first that is not: all speeds of its kinds, its speed bin of all kinds,
  everybody. It then has the lender's guarantee, not one of its own. The choice looks at counts
  only, never at scores, and is made once for the horizon, so that no set jumps in size at the
  step where data runs out.
* **Modes**: ``Mode.PER_STEP`` covers at each step, of the windows that are recorded there.
  ``Mode.SIMULTANEOUS`` covers at all steps of the horizon at once: its score is the largest
  d_M / shape_t, and only windows that are recorded over the whole horizon count. The shape, the
  d_M that ``SHAPE_LEVEL`` of the group stay below at t, keeps one step from ruling the profile; it
  comes from recordings of its own (every fourth), without which the guarantee would be lost.
* **Which exchangeability**: coverage is defined over windows, so every window counts alike. But
  windows of one recording resemble each other; what is exchangeable is recordings. Coverage on
  new recordings scatters more than n windows would have it: ``estimate_coverage`` says by how much.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from dosplan.evaluation.groups import SPEED_EDGES as BIN_EDGES
from dosplan.system.errors import one_line
from dosplan.types import FloatArray, IntArray, RoadUserKind, ShapeError

Kinds = Sequence[RoadUserKind]

SPEED_EDGES: Final = BIN_EDGES[1:-1]
"""Bounds between the speed bins, m/s; a speed on a bound belongs to the faster bin."""

VULNERABLE_KINDS: Final = frozenset({RoadUserKind.PEDESTRIAN, RoadUserKind.BICYCLE})

MIN_WINDOWS: Final = 200
"""Windows that a group needs of its own: enough for levels up to 0.995."""

MIN_RECORDINGS: Final = 10.0
"""Effective recordings that a group needs of its own (Kish's (sum m)^2 / sum m^2, m windows each).

Even if all windows of a recording were alike, ten would cover 90 % give or take 9.5 points. To
borrow can be worse: one factor for everybody covered moving road users up to 20 points short.
"""

MIN_SHAPE_WINDOWS: Final = 50
"""Windows at each step that the shape of a simultaneous profile needs."""

SHAPE_LEVEL: Final = 0.9
SHAPE_EVERY: Final = 4

SMALLEST: Final = 1e-3
"""Smallest quantile and shape that is kept: sets neither vanish nor are divided by zero."""

LEVELS: Final = np.r_[50:9000:50, 9000:9800:20, 9800:10001:5] / 10000
"""Levels whose quantiles are kept; a level between two of them takes the upper one."""

FORMAT: Final = "dosplan-calibration-1"
_ARRAYS: Final = ("source", "windows", "recordings", "shape", "quantiles")
_ROUNDING: Final = 1e-9
"""How far (n + 1) level and a level may be off by floating point alone."""


class Mode(StrEnum):
    """What the level is a probability of."""

    PER_STEP = "per_step"
    SIMULTANEOUS = "simultaneous"


class KindClass(IntEnum):
    """Kinds of road users that are calibrated together."""

    VEHICLE = 0
    VULNERABLE = 1


class Group(NamedTuple):
    """Road users that are calibrated together; ``None`` stands for all.

    Attributes:
        kind: Class of kinds.
        speed_bin: Speed bin, 0 the slowest.
    """

    kind: KindClass | None
    speed_bin: int | None

    def __str__(self) -> str:
        edges = ("0", *(f"{edge:g}" for edge in SPEED_EDGES), "inf")
        kind = "all kinds" if self.kind is None else self.kind.name.lower()
        if self.speed_bin is None:
            return f"{kind}, all speeds"
        return f"{kind}, {edges[self.speed_bin]} to {edges[self.speed_bin + 1]} m/s"

    def lenders(self) -> tuple[Group, ...]:
        """The group itself and the coarser ones it borrows from, in that order."""
        return (self, Group(self.kind, None), Group(None, self.speed_bin), EVERYBODY)


EVERYBODY: Final = Group(None, None)
GROUPS: Final = tuple(Group(k, b) for k in KindClass for b in range(len(SPEED_EDGES) + 1))
LENDERS: Final = tuple(dict.fromkeys(lender for group in GROUPS for lender in group.lenders()))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Factors for any level: a distribution of scores for each of the G ``GROUPS``.

    Attributes:
        mode: What the level is a probability of.
        source: (G,) whose scores each group uses, as an index of ``LENDERS``.
        windows: (G,) windows behind each distribution, at the step that has fewest.
        recordings: (G,) effective recordings behind it, at the step that has fewest.
        shape: (G, T) shape of the profile over T steps; 1 per step.
        quantiles: (G, T, L) finite-sample quantile of score / shape at each of the L ``LEVELS``;
            (G, 1, L) where all steps are covered at once.
    """

    mode: Mode
    source: IntArray
    windows: IntArray
    recordings: FloatArray
    shape: npt.NDArray[np.float32]
    quantiles: npt.NDArray[np.float32]

    def __post_init__(self) -> None:
        groups, steps = len(GROUPS), self.horizon if self.mode is Mode.PER_STEP else 1
        tails = ((), (), (), (self.horizon,), (steps, len(LEVELS)))
        for field, tail in zip(_ARRAYS, tails, strict=True):
            array = np.array(getattr(self, field))
            if array.shape != (groups, *tail) or not np.all(array >= 0):
                raise ShapeError(
                    f"Calibration.{field} has shape {array.shape}, expected {(groups, *tail)} and "
                    "no negative number or NaN"
                )
            array.setflags(write=False)
            object.__setattr__(self, field, array)

    @property
    def horizon(self) -> int:
        """Number T of steps."""
        return int(self.shape.shape[1])

    @property
    def highest_level(self) -> float:
        """Highest level that the smallest of the distributions in use can give: n / (n + 1)."""
        fewest = int(np.min(self.windows))
        return fewest / (fewest + 1)

    @property
    def sources(self) -> dict[Group, Group]:
        """Whose scores each group uses: itself or a coarser one."""
        return {g: LENDERS[i] for g, i in zip(GROUPS, self.source, strict=True)}

    @classmethod
    def fit(
        cls, scores: FloatArray, speed: FloatArray, kinds: Kinds, recording: IntArray, mode: Mode
    ) -> Self:
        """Keeps the distribution of scores on recordings that trained nothing.

        Args:
            scores: (n, T) d_M of the truth in each window; NaN where it is not recorded.
            speed: (n,) speed now, m/s.
            kinds: n kinds.
            recording: (n,) which recording a window is from; any integers.
            mode: What the level is to be a probability of.

        Returns:
            The calibration.

        Raises:
            ValueError: The arguments do not fit together, hold what is no d_M, or leave a step
                without a window.
        """
        scores = np.asarray(scores, dtype=np.float64)
        rows = np.shape(recording)
        if scores.ndim != 2 or not scores.shape[1] or rows != scores.shape[:1]:
            raise ShapeError(f"scores have shape {scores.shape}, recording {rows}; not (n, T), (n)")
        if np.any(scores < 0) or np.any(np.isinf(scores)):
            raise ValueError("scores hold a negative or an infinite d_M; mark it NaN or mend it")
        index = _group_index(speed, kinds, len(scores))
        _, recording = np.unique(recording, return_inverse=True)
        samples = {}
        for lender in LENDERS:
            members = np.isin(index, [i for i, g in enumerate(GROUPS) if lender in g.lenders()])
            samples[lender] = _Sample.of(scores[members], recording[members], mode)
        if not samples[EVERYBODY].windows:
            raise ValueError(
                f"{mode}: a step of the horizon has no window to calibrate on; "
                "give more recordings or a shorter horizon"
            )
        used = [
            next((g for g in group.lenders() if samples[g].suffices), EVERYBODY) for group in GROUPS
        ]
        source = np.array([LENDERS.index(g) for g in used])
        return cls(mode, source, *map(np.array, zip(*(samples[g] for g in used), strict=True)))

    def factors(self, level: float, speed: FloatArray, kinds: Kinds) -> FloatArray:
        """Factors on the semi-axes.

        Args:
            level: Wanted coverage.
            speed: (N,) speed now, m/s.
            kinds: N kinds.

        Returns:
            (N, T) factors; they do not fall as the level rises. Never below the exact quantile of
            the scores, and above it by the rounding (one in two thousand) or, for a level between
            two of ``LEVELS``, by the way to the upper one.

        Raises:
            ValueError: The level is not in (0, 1), or above ``highest_level``, whomever the scene
                holds: a level works in every scene or in none. To borrow instead could lower the
                factors of a hard group just where more is asked.
        """
        if not 0 < level < 1:
            raise ValueError(f"level is {level:g}, expected a share between 0 and 1")
        if level > self.highest_level:
            raise ValueError(
                f"level {level:g} needs more windows than the {int(np.min(self.windows))} of the "
                f"smallest group; ask for at most {np.floor(self.highest_level * 1e4) / 1e4:g} or "
                "calibrate on more recordings"
            )
        column = int(np.searchsorted(LEVELS, level - _ROUNDING))
        table = np.multiply(self.shape, self.quantiles[:, :, column], dtype=np.float64)
        return table[_group_index(speed, kinds, len(kinds))]


class _Sample(NamedTuple):
    """What one lender has, in the order of ``Calibration``'s fields."""

    windows: int
    recordings: float
    shape: npt.NDArray[np.float32]
    quantiles: npt.NDArray[np.float32]

    @property
    def suffices(self) -> bool:
        return self.windows >= MIN_WINDOWS and self.recordings >= MIN_RECORDINGS

    @classmethod
    def of(cls, scores: FloatArray, recording: IntArray, mode: Mode) -> Self:
        """Reduces (n, T) scores; a shape that lacks windows is NaN and leaves none to count."""
        shape = np.ones(scores.shape[1], dtype=np.float32)
        if mode is Mode.SIMULTANEOUS:
            shaping = recording % SHAPE_EVERY == 0
            enough = np.sum(np.isfinite(scores[shaping]), axis=0) >= MIN_SHAPE_WINDOWS
            typical = _quantiles(scores[shaping], np.array([SHAPE_LEVEL]))[:, 0]
            shape = np.where(enough, typical, np.float32(np.nan))
            scores, recording = scores[~shaping], recording[~shaping]
            # NaN, where a window is not recorded over the whole horizon, outlives the maximum.
            scores = np.max(scores / shape, axis=1, keepdims=True)
        counts = _sums_by_recording(np.isfinite(scores).astype(np.float64), recording)
        total, squares = counts.sum(axis=0), np.sum(counts**2, axis=0)
        effective = float(np.min(total**2 / np.maximum(squares, 1.0)))
        return cls(int(np.min(total)), effective, shape, _quantiles(scores, LEVELS))


def _quantiles(scores: FloatArray, levels: FloatArray) -> npt.NDArray[np.float32]:
    """(T, L) score of rank ceil((n + 1) level) among the n that are recorded at each step.

    The largest where that rank is beyond n; NaN where nothing is recorded. Rounded up to twelve
    binary digits: the zeros behind them are what the file's compression lives on.
    """
    n = np.sum(np.isfinite(scores), axis=0)[:, None]
    ordered = np.vstack([np.sort(scores, axis=0), np.full(scores.shape[1], np.nan)])  # NaN last.
    rank = np.clip(np.ceil((n + 1) * levels - _ROUNDING).astype(np.int64), 1, np.maximum(n, 1))
    exact = np.take_along_axis(ordered.T, rank - 1, axis=1)
    mantissa, exponent = np.frexp(np.maximum(exact, SMALLEST))
    return np.asarray(np.ldexp(np.ceil(mantissa * 4096) / 4096, exponent), dtype=np.float32)


def _group_index(speed: FloatArray, kinds: Kinds, n: int) -> IntArray:
    """(n,) index of each road user's group in ``GROUPS``."""
    speed = np.asarray(speed, dtype=np.float64)
    if speed.shape != (n,) or len(kinds) != n or not np.all(np.isfinite(speed)):
        raise ShapeError(
            f"speed has shape {speed.shape} for {len(kinds)} kinds, expected {n} finite speeds"
        )
    vulnerable = np.fromiter((kind in VULNERABLE_KINDS for kind in kinds), np.int64, n)
    speed_bin = np.searchsorted(SPEED_EDGES, np.abs(speed), side="right")
    return vulnerable * (len(SPEED_EDGES) + 1) + speed_bin


def _sums_by_recording(values: FloatArray, recording: IntArray) -> FloatArray:
    """(R, T) sums of (n, T) values over the windows of each of R recordings."""
    order = np.argsort(recording, kind="stable")
    starts = np.unique(recording[order], return_index=True)[1]
    return np.add.reduceat(values[order], starts, axis=0)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Coverage on T steps, with what it is worth as an estimate.

    Attributes:
        rate: (T,) share of the windows recorded at that step that are covered.
        standard_error: (T,) of ``rate``, between recordings; NaN with fewer than two.
        effective_windows: (T,) independent windows that would have that standard error; NaN where
            it is zero or NaN and says nothing.
        windows: (T,) windows.
        recordings: (T,) recordings they are from.
    """

    rate: FloatArray
    standard_error: FloatArray
    effective_windows: FloatArray
    windows: IntArray
    recordings: IntArray


def estimate_coverage(covered: FloatArray, recording: IntArray) -> Coverage:
    """Estimates coverage, its error taken between recordings.

    The ratio-to-size estimator of cluster sampling (Cochran, "Sampling Techniques", chapter 9A):
    with y_r of the m_r windows of recording r covered, the rate p is sum y / sum m and its squared
    standard error R / (R - 1) sum (y_r - p m_r)^2 / (sum m)^2.

    Args:
        covered: (n, T) 1 where the truth is inside the set, 0 outside, NaN where not recorded.
        recording: (n,) which recording a window is from.

    Returns:
        Rate, standard error and counts at each step.
    """
    covered = np.asarray(covered, dtype=np.float64)
    hits = _sums_by_recording(np.nan_to_num(covered), recording)
    sizes = _sums_by_recording(np.isfinite(covered).astype(np.float64), recording)
    windows, recordings = sizes.sum(axis=0), np.sum(sizes > 0, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = hits.sum(axis=0) / windows
        between = np.sum((hits - rate * sizes) ** 2, axis=0) * recordings / (recordings - 1)
        error = np.sqrt(between) / windows
        effective = np.where(error > 0, rate * (1 - rate) / error**2, np.nan)
    return Coverage(rate, error, effective, windows.astype(np.int64), recordings)


def save_calibrations(path: Path, calibrations: Iterable[Calibration]) -> None:
    """Writes calibrations of different modes into one file; the same ones give the same bytes.

    Args:
        path: The file, ``.npz``.
        calibrations: At most one of each mode.
    """
    arrays = {f"{c.mode}.{field}": getattr(c, field) for c in calibrations for field in _ARRAYS}
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, format=np.array(FORMAT), **arrays)


def load_calibrations(path: Path) -> dict[Mode, Calibration]:
    """Reads what ``save_calibrations`` wrote.

    Args:
        path: The file.

    Returns:
        The calibrations by mode, one at least.

    Raises:
        ValueError: The file is missing, damaged, cut off or something else.
    """
    try:
        if path.is_file() and not zipfile.is_zipfile(path):
            raise ValueError("cut off, or another kind of file")
        with np.load(path, allow_pickle=False) as content:
            if str(content["format"]) != FORMAT:
                raise ValueError(f"format {content['format']}, expected {FORMAT}")
            found = {
                mode: Calibration(mode, **{f: content[f"{mode}.{f}"] for f in _ARRAYS})
                for mode in Mode
                if f"{mode}.shape" in content
            }
        if not found:
            raise ValueError("it holds no calibration")
    except Exception as error:  # What a damaged archive raises is not foreseeable.
        raise ValueError(
            f"{path}: not a file of calibrations ({one_line(error)}); "
            "write one with save_calibrations"
        ) from None
    return found
