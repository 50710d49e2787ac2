"""Split-conformal calibration of occupancy sets, group by group or by what is known of each.

The *score* of a recorded truth is its Mahalanobis distance d_M to the predicted ellipse, 1 on the
boundary: semi-axes scaled by a factor q cover every truth with d_M <= q. Of n scores that are
exchangeable with a new one, the ceil((n + 1) level)-th smallest covers the new one with a
probability in [level, level + 1 / (n + 1)] (Vovk, Gammerman, Shafer, "Algorithmic Learning in a
Random World"; Lei et al., "Distribution-Free Predictive Inference for Regression"). Taken within
groups that are known beforehand (Mondrian), this holds in each group.

* **Groups**: the speed now, in five bins, times vehicle or vulnerable. A group that is too small
  uses the scores of a coarser group, the first of these that is large enough: all speeds of its
  kinds, its speed bin of all kinds, all road users. It then has the guarantee of the coarser
  group, not one of its own. The choice depends on counts only, never on scores, and is made once
  for the horizon, so that no set jumps in size at the step where data runs out.
* **Modes**: ``Mode.PER_STEP`` covers at each step, of the windows that are recorded there.
  ``Mode.SIMULTANEOUS`` covers at all steps of the horizon at once: its score is the largest
  d_M / shape_t, and only windows that are recorded over the whole horizon count. The shape at t is
  the quantile of d_M of the group at ``SHAPE_LEVEL``; without it, the step with the largest errors
  would decide for all steps. It is estimated on recordings that are used for nothing else (every
  fourth), without which the guarantee would be lost.
* **Conditional**: the same with ranks of scores in place of scores. The rank says where a score
  lies among those of road users of which the same is known (``conditional``), so that factors
  differ within a group. The guarantee is that of the groups; what is better is how misses spread.
* **Loops**: the windows are seen as a loop between ego and world shows them, and a calibration is
  for loops that see as well. ``CalibratedFor`` names them; each has a file of its own beside the
  weights. The latency of a loop does not matter, as steps are counted from what is seen.
* **Which exchangeability**: coverage is defined over windows, so every window counts alike. But
  windows of one recording resemble each other; only recordings are exchangeable. Coverage on new
  recordings therefore varies more than with n independent windows; ``estimate_coverage`` gives
  the standard error.
* **What had seen the recordings**: ``dosplan train dos`` calibrates on the validation recordings
  and on the training recordings. Of the training recordings only the trajectories are cross-fitted:
  the module itself and the features H that it reads have seen these windows, so their scores are
  not quite exchangeable with new ones. The guarantee holds strictly for the part of the validation
  recordings alone, as far as choosing the weights by them does not count. What sets cover of other
  recordings is measured: ``results/prediction``, ``results/calibration``.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from dosplan.evaluation.groups import SPEED_EDGES as BIN_EDGES
from dosplan.system.errors import one_line
from dosplan.types import FloatArray, IntArray, RoadUserKind, ShapeError
from dosplan_dos.conditional import ConditionalScores

Kinds = Sequence[RoadUserKind]

SPEED_EDGES: Final = BIN_EDGES[1:-1]
"""Bounds between the speed bins, m/s; a speed on a bound belongs to the faster bin."""

VULNERABLE_KINDS: Final = frozenset({RoadUserKind.PEDESTRIAN, RoadUserKind.BICYCLE})

MIN_WINDOWS: Final = 200
"""Windows that a group needs of its own: enough for levels up to 0.995."""

MIN_RECORDINGS: Final = 10.0
"""Effective recordings that a group needs of its own (Kish's (sum m)^2 / sum m^2, m windows each).

Even if all windows of a recording were equal, the coverage with ten recordings would be 90 % with a
standard error of 9.5 points. A coarser group can be worse: with one factor for all road users, the
coverage of those that move was up to 20 points too low.
"""

MIN_SHAPE_WINDOWS: Final = 50
"""Windows at each step that the shape of a simultaneous profile needs."""

SHAPE_LEVEL: Final = 0.9
SHAPE_EVERY: Final = 4

SMALLEST: Final = 1e-3
"""Smallest quantile and shape: sets keep an area, and nothing is divided by zero."""

LEVELS: Final = np.r_[50:9000:50, 9000:9800:20, 9800:10001:5] / 10000
"""Levels whose quantiles are kept; a level between two of them takes the upper one."""

FORMAT: Final = "dosplan-calibration-1"
_ARRAYS: Final = ("source", "windows", "recordings", "shape", "quantiles")
_GIVEN: Final = ("low", "high", "scale", "shape")
_ROUNDING: Final = 1e-9
"""Tolerance for floating-point errors of a level and of (n + 1) level."""


class Mode(StrEnum):
    """What the level is a probability of."""

    PER_STEP = "per_step"
    SIMULTANEOUS = "simultaneous"


class CalibratedFor(StrEnum):
    """The loop whose road users sets are calibrated on; ``AUTO`` leaves it to the run."""

    AUTO = "auto"
    IDEAL = "ideal"
    REALISTIC = "realistic"


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

    def candidates(self) -> tuple[Group, ...]:
        """The groups whose scores it may use, in that order: itself, then coarser ones."""
        return (self, Group(self.kind, None), Group(None, self.speed_bin), ALL_USERS)


ALL_USERS: Final = Group(None, None)
GROUPS: Final = tuple(Group(k, b) for k in KindClass for b in range(len(SPEED_EDGES) + 1))
SOURCES: Final = tuple(dict.fromkeys(source for group in GROUPS for source in group.candidates()))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Factors for any level: a distribution of scores for each of the G ``GROUPS``.

    Attributes:
        mode: What the level is a probability of.
        source: (G,) whose scores each group uses, as an index of ``SOURCES``.
        windows: (G,) windows behind each distribution, at the step that has fewest.
        recordings: (G,) effective recordings behind it, at the step that has fewest.
        shape: (G, T) shape of the profile over T steps; 1 per step.
        quantiles: (G, T, L) finite-sample quantile of score / shape at each of the L ``LEVELS``;
            (G, 1, L) where all steps are covered at once.
        given: Quantiles of scores given covariates, whose ranks take the place of scores here;
            None where the scores themselves are kept.
    """

    mode: Mode
    source: IntArray
    windows: IntArray
    recordings: FloatArray
    shape: npt.NDArray[np.float32]
    quantiles: npt.NDArray[np.float32]
    given: ConditionalScores | None = None

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
        if self.given is not None and self.given.horizon != self.horizon:
            raise ShapeError(
                f"Calibration.given is of {self.given.horizon} steps, expected {self.horizon}"
            )

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
        return {g: SOURCES[i] for g, i in zip(GROUPS, self.source, strict=True)}

    @classmethod
    def fit(
        cls,
        scores: FloatArray,
        speed: FloatArray,
        kinds: Kinds,
        recording: IntArray,
        mode: Mode,
        given: ConditionalScores | None = None,
    ) -> Self:
        """Stores the distribution of scores whose predictors were not trained on the recordings.

        Args:
            scores: (n, T) d_M of the truth in each window; NaN where it is not recorded.
            speed: (n,) speed now, m/s.
            kinds: n kinds.
            recording: (n,) which recording a window is from; any integers.
            mode: What the level is to be a probability of.
            given: What ``scores`` are ranks of; they have to be of recordings that it was not
                fitted to.

        Returns:
            The calibration.

        Raises:
            ValueError: The arguments do not fit together, hold a value that is not a distance,
                or leave a step without a window.
        """
        scores = np.asarray(scores, dtype=np.float64)
        rows = np.shape(recording)
        if scores.ndim != 2 or not scores.shape[1] or rows != scores.shape[:1]:
            raise ShapeError(f"scores have shape {scores.shape}, recording {rows}; not (n, T), (n)")
        if np.any(scores < 0) or np.any(np.isinf(scores)):
            raise ValueError("scores hold a negative or an infinite d_M; set it to NaN")
        index = group_index(speed, kinds, len(scores))
        _, recording = np.unique(recording, return_inverse=True)
        samples = {}
        for source in SOURCES:
            members = np.isin(index, [i for i, g in enumerate(GROUPS) if source in g.candidates()])
            samples[source] = _Sample.of(scores[members], recording[members], mode)
        if not samples[ALL_USERS].windows:
            raise ValueError(
                f"{mode}: a step of the horizon has no window to calibrate on; "
                "give more recordings or a shorter horizon"
            )
        used = [
            next((g for g in group.candidates() if samples[g].suffices), ALL_USERS)
            for group in GROUPS
        ]
        sources = np.array([SOURCES.index(g) for g in used])
        parts: list[Any] = [*map(np.array, zip(*(samples[g] for g in used), strict=True)), given]
        return cls(mode, sources, *parts)

    def factors(
        self,
        level: float,
        speed: FloatArray,
        kinds: Kinds,
        covariates: FloatArray | None = None,
    ) -> FloatArray:
        """Factors on the semi-axes.

        Args:
            level: Wanted coverage.
            speed: (N,) speed now, m/s.
            kinds: N kinds.
            covariates: (N, F) what is known besides; needed where there is a ``given``.

        Returns:
            (N, T) factors, which do not decrease with the level. They are never below the exact
            quantile of the scores. They are above it by the rounding (one part in two thousand)
            and, for a level between two of ``LEVELS``, because the upper one is taken.

        Raises:
            ValueError: The level is not in (0, 1), or above ``highest_level``. This does not
                depend on the road users of the scene: a level works in every scene or in none.
                With the scores of a coarser group instead, a higher level could give a group
                that is hard to predict lower factors.
        """
        found = self.table(level)[group_index(speed, kinds, len(kinds))]
        if self.given is None:
            return found
        if covariates is None:
            raise ValueError("this calibration needs covariates")
        return self.given.score(found, covariates)

    def table(self, level: float) -> FloatArray:
        """(G, T) factors of the ``GROUPS``, see ``factors``; ranks where there is a ``given``."""
        if not 0 < level < 1:
            raise ValueError(f"level is {level:g}, expected a share between 0 and 1")
        if level > self.highest_level:
            raise ValueError(
                f"level {level:g} needs more windows than the {int(np.min(self.windows))} of the "
                f"smallest group; ask for at most {np.floor(self.highest_level * 1e4) / 1e4:g} or "
                "calibrate on more recordings"
            )
        column = int(np.searchsorted(LEVELS, level - _ROUNDING))
        return np.multiply(self.shape, self.quantiles[:, :, column], dtype=np.float64)

    def table_like(self, other: Calibration, scale: float) -> FloatArray:
        """Factors that cover here what one factor covers where another calibration was made.

        Both are of scores, not of ranks.

        Args:
            other: The other calibration, of as many steps.
            scale: The factor there, 0 or more.

        Returns:
            (G, T) factors, which do not decrease with ``scale``: the quantile here at the level
            whose quantile there is ``scale``, linear in between. Beyond the quantiles that are
            kept, the factor is in proportion to the outermost.
        """
        here, there = (
            np.multiply(c.shape[..., None], c.quantiles, dtype=np.float64) for c in (self, other)
        )
        after = np.sum(there < scale, axis=2)
        inside = np.clip(after, 1, len(LEVELS) - 1)[..., None]
        (h0, h1), (t0, t1) = (
            [np.take_along_axis(q, inside - 1 + k, axis=2)[..., 0] for k in (0, 1)]
            for q in (here, there)
        )
        share = (scale - t0) / np.maximum(t1 - t0, _ROUNDING)
        factors = h0 + np.clip(share, 0.0, 1.0) * (h1 - h0)
        factors = np.where(after == 0, scale * here[..., 0] / there[..., 0], factors)
        above = scale * here[..., -1] / there[..., -1]
        return np.asarray(np.where(after == len(LEVELS), above, factors))


class _Sample(NamedTuple):
    """The distribution of one group of ``SOURCES``, in the order of ``Calibration``'s fields."""

    windows: int
    recordings: float
    shape: npt.NDArray[np.float32]
    quantiles: npt.NDArray[np.float32]

    @property
    def suffices(self) -> bool:
        return self.windows >= MIN_WINDOWS and self.recordings >= MIN_RECORDINGS

    @classmethod
    def of(cls, scores: FloatArray, recording: IntArray, mode: Mode) -> Self:
        """Reduces (n, T) scores; with too few windows for a shape, it is NaN and counts are 0."""
        shape = np.ones(scores.shape[1], dtype=np.float32)
        if mode is Mode.SIMULTANEOUS:
            shaping = recording % SHAPE_EVERY == 0
            enough = np.sum(np.isfinite(scores[shaping]), axis=0) >= MIN_SHAPE_WINDOWS
            typical = _quantiles(scores[shaping], np.array([SHAPE_LEVEL]))[:, 0]
            shape = np.where(enough, typical, np.float32(np.nan))
            scores, recording = scores[~shaping], recording[~shaping]
            # The maximum is NaN for a window that is not recorded over the whole horizon.
            scores = np.max(scores / shape, axis=1, keepdims=True)
        counts = _sums_by_recording(np.isfinite(scores).astype(np.float64), recording)
        total, squares = counts.sum(axis=0), np.sum(counts**2, axis=0)
        effective = float(np.min(total**2 / np.maximum(squares, 1.0)))
        return cls(int(np.min(total)), effective, shape, _quantiles(scores, LEVELS))


def _quantiles(scores: FloatArray, levels: FloatArray) -> npt.NDArray[np.float32]:
    """(T, L) score of rank ceil((n + 1) level) among the n that are recorded at each step.

    The largest where that rank is beyond n; NaN where nothing is recorded. Rounded up to twelve
    binary digits: with zeros in the other digits, the file can be compressed.
    """
    n = np.sum(np.isfinite(scores), axis=0)[:, None]
    ordered = np.vstack([np.sort(scores, axis=0), np.full(scores.shape[1], np.nan)])  # NaN last.
    rank = np.clip(np.ceil((n + 1) * levels - _ROUNDING).astype(np.int64), 1, np.maximum(n, 1))
    exact = np.take_along_axis(ordered.T, rank - 1, axis=1)
    mantissa, exponent = np.frexp(np.maximum(exact, SMALLEST))
    return np.asarray(np.ldexp(np.ceil(mantissa * 4096) / 4096, exponent), dtype=np.float32)


def group_index(speed: FloatArray, kinds: Kinds, n: int) -> IntArray:
    """Finds the groups of road users.

    Args:
        speed: (n,) speed now, m/s.
        kinds: n kinds.
        n: Their number.

    Returns:
        (n,) index of each one's group in ``GROUPS``.

    Raises:
        ShapeError: The arguments do not fit together, or a speed is not finite.
    """
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
    """Coverage at T steps, with its standard error.

    Attributes:
        rate: (T,) share of the windows recorded at that step that are covered.
        standard_error: (T,) of ``rate``, between recordings; NaN with fewer than two.
        effective_windows: (T,) independent windows that would have that standard error; NaN where
            the standard error is zero or NaN.
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


def calibration_file(weights: Path, loop: CalibratedFor) -> Path:
    """Where the calibrations of a module lie.

    Args:
        weights: The module's weights, ``NAME.safetensors``.
        loop: The loop that they are for.

    Returns:
        ``NAME.calibration.npz`` beside them, ``NAME.LOOP.calibration.npz`` for another loop than
        the ideal one.
    """
    part = "" if loop is CalibratedFor.IDEAL else f".{loop}"
    return weights.with_suffix(f"{part}.calibration.npz")


def save_calibrations(path: Path, calibrations: Iterable[Calibration]) -> None:
    """Writes calibrations into one file; the same ones give the same bytes.

    Args:
        path: The file, ``.npz``.
        calibrations: At most one of each mode with a ``given``, which is the same for all of them,
            and at most one of each without.
    """
    arrays: dict[str, Any] = {}
    for calibration in calibrations:
        prefix = _prefix(calibration.mode, conditional=calibration.given is not None)
        arrays |= {prefix + field: getattr(calibration, field) for field in _ARRAYS}
        if calibration.given is not None:
            arrays |= {f"given.{field}": getattr(calibration.given, field) for field in _GIVEN}
    with path.open("wb") as file:
        np.savez_compressed(file, format=np.array(FORMAT), **arrays)


def load_calibrations(path: Path, *, conditional: bool = False) -> dict[Mode, Calibration]:
    """Reads what ``save_calibrations`` wrote.

    Args:
        path: The file.
        conditional: Whether those are wanted that depend on covariates.

    Returns:
        The calibrations by mode, one at least.

    Raises:
        ValueError: The file is missing, damaged, cut off or something else, or holds none of that
            sort.
    """
    try:
        if path.is_file() and not zipfile.is_zipfile(path):
            raise ValueError("cut off, or another kind of file")
        with np.load(path, allow_pickle=False) as content:
            if str(content["format"]) != FORMAT:
                raise ValueError(f"format {content['format']}, expected {FORMAT}")
            found = {
                mode: _read(content, mode, conditional=conditional)
                for mode in Mode
                if _prefix(mode, conditional=conditional) + "shape" in content
            }
        if not found:
            sort = "that depends on covariates" if conditional else "by groups"
            raise ValueError(f"it holds no calibration {sort}")
    except Exception as error:  # A damaged archive can raise almost anything.
        raise ValueError(
            f"{path}: not a file of calibrations ({one_line(error)}); "
            "write one with save_calibrations"
        ) from None
    return found


def _prefix(mode: Mode, *, conditional: bool) -> str:
    return f"{mode}.given." if conditional else f"{mode}."


def _read(content: Mapping[str, Any], mode: Mode, *, conditional: bool) -> Calibration:
    prefix = _prefix(mode, conditional=conditional)
    arrays = {field: content[prefix + field] for field in _ARRAYS}
    if not conditional:
        return Calibration(mode, **arrays)
    horizon = int(arrays["shape"].shape[1])
    parts = {field: content[f"given.{field}"] for field in _GIVEN}
    return Calibration(mode, **arrays, given=ConditionalScores(**parts, horizon=horizon))
