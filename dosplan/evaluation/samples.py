"""What is kept of each window: the few numbers from which all figures are computed.

A window costs 36 bytes per method (144 more where sets are unions) and some 160 per trajectory
(350 where there are three or more components), so that 30 methods on 100 000 windows stay well
below a gigabyte. Methods that stand on the same
trajectories share them: they are recognised by the predicted centres, whatever the methods are
called.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any

import numpy as np
import numpy.typing as npt

from dosplan.api import OraclePredictor, Predictor
from dosplan.evaluation.groups import KINDS, MOVING, family_of, lights_of
from dosplan.evaluation.limits import BEST_OF, REPRESENTATIONS, upper_limits
from dosplan.evaluation.metrics import AREA_SCALES, displacement
from dosplan.evaluation.windows import HORIZON_COLUMNS, STEPS, Moment, moments
from dosplan.geometry import LightIndex, set_area, set_distance
from dosplan.simulation.settings import IDEAL, LoopSettings
from dosplan.system.errors import DosplanError, failure_place, one_line
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    BoolArray,
    FloatArray,
    IntArray,
    Observation,
    Occupancy,
    Scenario,
)

Float32Array = npt.NDArray[np.float32]


class PredictionError(DosplanError, RuntimeError):
    """A method failed on a recording; one line that names the method and the place."""


@dataclass(frozen=True)
class SetSamples:
    """A method's sets against the truth, in W windows.

    Where a method predicts nothing, its set is empty: infinitely far, of area zero.

    Attributes:
        distance: (W, 4) Mahalanobis distance of the true centre at 1, 2, 3, 4 s.
        area: (W, 4) area of the sets there, m2.
        furthest: (W,) largest distance over all recorded steps up to 4 s.
        shape: (W, 4, 9) area of the sets scaled by each of ``metrics.AREA_SCALES``, over the
            factor's square, m2; None where every set is one ellipse.
    """

    distance: Float32Array
    area: Float32Array
    furthest: Float32Array
    shape: Float32Array | None = None


@dataclass(frozen=True)
class TrajectorySamples:
    """Predicted centres against the truth, in W windows; NaN where either is missing.

    Attributes:
        error: (W, 4) displacement at 1, 2, 3, 4 s, m, of the most likely component.
        total: (W,) sum of its displacements over all steps that are recorded and predicted, m.
        count: (W,) number of these steps.
        best_error: (W, 4) the same of the component that is best at each of these times, m.
        best_total: (W,) the smallest such sum of any component, m.
        components: (W,) number of components.
        limits: (W, 4, 6, K) areas of the smallest sets that touch the truth, m2, see ``limits``:
            the best of the 1 .. K most likely components, K <= 3.
    """

    error: Float32Array
    total: FloatArray
    count: IntArray
    best_error: Float32Array
    best_total: FloatArray
    components: IntArray
    limits: Float32Array


@dataclass(frozen=True)
class FileSamples:
    """All samples of one recording.

    Attributes:
        family: The recording's family.
        kind: (W,) index into ``groups.KINDS``.
        speed: (W,) present speed, m/s.
        light: (W,) index into ``groups.LIGHTS``, of the light ahead; -1 where there is none.
        recorded: (W, 4) whether the truth is recorded at 1, 2, 3, 4 s.
        sets: Samples of each method.
        digests: Which trajectories each method stands on: a key of ``trajectories``.
        trajectories: Samples of each different set of trajectories.
    """

    family: str
    kind: npt.NDArray[np.int8]
    speed: Float32Array
    light: npt.NDArray[np.int8]
    recorded: BoolArray
    sets: tuple[SetSamples, ...]
    digests: tuple[str, ...]
    trajectories: Mapping[str, TrajectorySamples]


def sample_file(
    scenario: Scenario,
    predictors: Sequence[tuple[str, Predictor]],
    every: int,
    loop: LoopSettings = IDEAL,
    seed: int = 0,
) -> FileSamples:
    """Runs all methods on a recording and keeps their samples.

    All methods see an observation, as the same object, before the next one is made, so that
    methods can share the results of costly work. The sets are judged as a planner in the loop gets
    them: without the steps that are past when its plan acts.

    Args:
        scenario: The recording.
        predictors: Labels and predictors.
        every: Steps between two observations.
        loop: What is seen, and how late it is acted upon.
        seed: Seed of the errors of what is seen.

    Returns:
        The samples; without windows where no road user has a future.

    Raises:
        PredictionError: A predictor raised.
    """
    for label, predictor in predictors:
        try:
            if isinstance(predictor, OraclePredictor):
                predictor.reveal(scenario.tracks)
            predictor.reset(scenario.task, scenario.road_map)
        except (Exception, SystemExit) as error:
            raise prediction_failure(label, predictor, error) from error
    kind, speed, light, recorded = [], [], [], []
    index = LightIndex(scenario.road_map)
    methods = [_MethodLog() for _ in predictors]
    late = loop.latency_steps
    reach = min((predictor.horizon for _, predictor in predictors), default=STEPS) - late
    for moment in moments(scenario, every, loop, seed=seed, reach=max(reach, 0)):
        observation, rows = moment.observation, moment.rows
        kind.append(np.array([KINDS.index(observation.kinds[i]) for i in rows], dtype=np.int8))
        # Groups are told by the truth, so that a window is in the same one in every loop.
        speed.append(np.abs(moment.now[:, USER_VELOCITY]).astype(np.float32))
        ahead = index.ahead(moment.now, moment.size, observation.lights)
        light.append(lights_of(ahead.colour))
        recorded.append(moment.recorded[:, HORIZON_COLUMNS])
        for (label, predictor), log in zip(predictors, methods, strict=True):
            try:
                occupancy = predictor.predict(observation)
            except (Exception, SystemExit) as error:
                raise prediction_failure(label, predictor, error) from error
            log.add(moment, _when_it_acts(occupancy, late))
    digests = tuple(log.digest.hexdigest() for log in methods)
    return FileSamples(
        family=family_of(scenario.benchmark_id, scenario.tags),
        kind=_joined(kind, np.int8),
        speed=_joined(speed, np.float32),
        light=_joined(light, np.int8),
        recorded=_joined(recorded, np.bool_, len(HORIZON_COLUMNS)),
        sets=tuple(log.sets() for log in methods),
        digests=digests,
        trajectories={
            digest: log.trajectories()
            for digest, log in reversed(list(zip(digests, methods, strict=True)))
        },
    )


def _when_it_acts(occupancy: Occupancy, late: int) -> Occupancy:
    """Sets for ``STEPS`` steps after a latency; nothing is predicted at those that are missing."""
    occupancy = occupancy.later(late)
    missing = STEPS - occupancy.horizon
    if missing <= 0:
        return occupancy
    column = np.minimum(np.arange(STEPS), occupancy.horizon - 1)
    valid = occupancy.valid[:, column] & (np.arange(STEPS) < occupancy.horizon)
    return replace(occupancy.of_steps(column), valid=valid)


class _MethodLog:
    """Collects a method's samples moment by moment."""

    def __init__(self) -> None:
        self.digest = blake2b(digest_size=16)
        self._sets: list[SetSamples] = []
        self._trajectories: list[TrajectorySamples] = []

    def add(self, moment: Moment, occupancy: Occupancy) -> None:
        sets = occupancy.of_users(moment.rows).first_steps(STEPS)
        truth = moment.truth[..., [USER_X, USER_Y]]
        centre, heading = _most_likely_first(sets)
        for part in (centre, heading):
            self.digest.update(np.moveaxis(part, 1, 0).tobytes())
        self._sets.append(_against_sets(moment, truth, sets))
        self._trajectories.append(_against_centres(moment, truth, centre, heading))

    def sets(self) -> SetSamples:
        return join_sets(self._sets)

    def trajectories(self) -> TrajectorySamples:
        return join_trajectories(self._trajectories)


def join_sets(parts: Sequence[SetSamples]) -> SetSamples:
    """Puts samples of one method end to end.

    Args:
        parts: The samples.

    Returns:
        All of them; without windows where there are no parts.
    """
    h, shapes = len(HORIZON_COLUMNS), None
    if any(part.shape is not None for part in parts):
        one = np.ones(len(AREA_SCALES), dtype=np.float32)
        each = [part.area[..., None] * one if part.shape is None else part.shape for part in parts]
        shapes = _joined(each, np.float32, h, len(AREA_SCALES))
    return SetSamples(
        distance=_joined([part.distance for part in parts], np.float32, h),
        area=_joined([part.area for part in parts], np.float32, h),
        furthest=_joined([part.furthest for part in parts], np.float32),
        shape=shapes,
    )


def join_trajectories(parts: Sequence[TrajectorySamples]) -> TrajectorySamples:
    """Puts samples of the same trajectories end to end.

    Args:
        parts: The samples.

    Returns:
        All of them; without windows where there are no parts.
    """
    h, shapes = len(HORIZON_COLUMNS), len(REPRESENTATIONS)
    best_of = max((part.limits.shape[-1] for part in parts), default=1)
    missing = [(0, 0)] * 3  # The best of 3 of two components is the best of these two.
    limits = [
        np.pad(part.limits, [*missing, (0, best_of - part.limits.shape[-1])], mode="edge")
        for part in parts
    ]
    return TrajectorySamples(
        error=_joined([part.error for part in parts], np.float32, h),
        total=_joined([part.total for part in parts], np.float64),
        count=_joined([part.count for part in parts], np.int64),
        best_error=_joined([part.best_error for part in parts], np.float32, h),
        best_total=_joined([part.best_total for part in parts], np.float64),
        components=_joined([part.components for part in parts], np.int64),
        limits=_joined(limits, np.float32, h, shapes, best_of),
    )


def _against_sets(moment: Moment, truth: FloatArray, sets: Occupancy) -> SetSamples:
    columns = np.array(HORIZON_COLUMNS)
    distance = set_distance(truth, sets)
    known = sets.of_steps(columns)
    shape = None
    if sets.union is not None:
        areas = [set_area(known, scale) / scale**2 for scale in AREA_SCALES]
        shape = np.stack(areas, axis=-1).astype(np.float32)
    return SetSamples(
        distance=distance[:, columns].astype(np.float32),
        area=set_area(known).astype(np.float32),
        furthest=np.max(distance, axis=1, initial=0.0, where=moment.recorded).astype(np.float32),
        shape=shape,
    )


def _most_likely_first(sets: Occupancy) -> tuple[FloatArray, FloatArray]:
    """(W, M, T, 2) centres, NaN where there is none, and (W, M, T) headings of the components."""
    union = sets.components
    order = np.argsort(-union.weight, axis=1, kind="stable")
    row = np.arange(len(order))[:, None]
    known = union.present[row, order][:, :, None] & sets.valid[:, None]
    centre = np.where(known[..., None], union.centre[row, order], np.nan)
    return centre, union.heading[row, order]


def _against_centres(
    moment: Moment, truth: FloatArray, centre: FloatArray, heading: FloatArray
) -> TrajectorySamples:
    rows, columns = moment.rows, np.array(HORIZON_COLUMNS)
    error = displacement(centre, truth[:, None])
    known = np.isfinite(error)
    total, count = np.where(known, error, 0.0).sum(axis=-1), known.sum(axis=-1)
    best_total = np.where(count == count[:, :1], total, np.inf).min(axis=1)
    now = moment.observation.states[rows, -1, USER_HEADING]
    likely = slice(BEST_OF)
    limits = upper_limits(
        (truth[:, None] - centre)[:, likely, columns],
        now[:, None, None],
        _motion(moment.observation)[rows, None, None],
        heading[:, likely, columns],
    )
    return TrajectorySamples(
        error=error[:, 0, columns].astype(np.float32),
        total=total[:, 0],
        count=count[:, 0],
        best_error=np.fmin.reduce(error[..., columns], axis=1).astype(np.float32),
        best_total=best_total,
        components=np.isfinite(centre[..., 0]).any(axis=-1).sum(axis=1),
        limits=np.moveaxis(np.fmin.accumulate(limits, axis=1), 1, -1).astype(np.float32),
    )


def _motion(observation: Observation) -> FloatArray:
    """(N,) direction of the last step; the heading of one that stands or has just appeared."""
    now, before = observation.states[:, -1], observation.states[:, -2]
    way = now[:, [USER_X, USER_Y]] - before[:, [USER_X, USER_Y]]
    # NaN where there is no step before: the comparison is then False.
    moves = np.hypot(way[:, 0], way[:, 1]) >= MOVING * observation.dt
    return np.where(moves, np.arctan2(way[:, 1], way[:, 0]), now[:, USER_HEADING])


def _joined(parts: Sequence[npt.NDArray[Any]], dtype: type[Any], *shape: int) -> npt.NDArray[Any]:
    """The parts end to end; (0, *shape) where there are none."""
    return np.concatenate([np.empty((0, *shape), dtype=dtype), *parts], dtype=dtype, axis=0)


def prediction_failure(label: str, predictor: Predictor, error: BaseException) -> PredictionError:
    """Makes one line of what a method raised.

    Args:
        label: Label of the method.
        predictor: Its predictor.
        error: What was raised.

    Returns:
        The error that names the method and the place.
    """
    place = failure_place(error, type(predictor))
    return PredictionError(f"method {label!r} failed: {one_line(error)} ({place})")
