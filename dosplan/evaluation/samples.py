"""What is kept of each window: the few numbers from which all figures are computed.

A window costs 37 bytes per method and some 130 per trajectory, so that 30 methods on 100 000
windows stay well below a gigabyte. Methods that stand on the same trajectories share them: they
are recognised by the predicted centres, whatever the methods are called.
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
from dosplan.evaluation.limits import REPRESENTATIONS, upper_limits
from dosplan.evaluation.metrics import displacement
from dosplan.evaluation.windows import HORIZON_COLUMNS, STEPS, Moment, moments
from dosplan.geometry import LightIndex, ellipse_area, mahalanobis
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
    """

    distance: Float32Array
    area: Float32Array
    furthest: Float32Array


@dataclass(frozen=True)
class TrajectorySamples:
    """Predicted centres against the truth, in W windows; NaN where either is missing.

    Attributes:
        error: (W, 4) displacement at 1, 2, 3, 4 s, m.
        total: (W,) sum of the displacements over all steps that are recorded and predicted, m.
        count: (W,) number of these steps.
        limits: (W, 4, 6) areas of the smallest sets that touch the truth, m2, see ``limits``.
    """

    error: Float32Array
    total: FloatArray
    count: IntArray
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
    parts = ("centre", "semi_axes", "angle", "heading")
    repeated = {name: getattr(occupancy, name)[:, column] for name in parts}
    return replace(occupancy, valid=valid, **repeated)


class _MethodLog:
    """Collects a method's samples moment by moment."""

    def __init__(self) -> None:
        self.digest = blake2b(digest_size=16)
        self._sets: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        self._trajectories: list[tuple[FloatArray, FloatArray, IntArray, FloatArray]] = []

    def add(self, moment: Moment, occupancy: Occupancy) -> None:
        rows, truth = moment.rows, moment.truth[..., [USER_X, USER_Y]]
        predicted = occupancy.valid[rows, :STEPS]
        centre = np.where(predicted[..., None], occupancy.centre[rows, :STEPS], np.nan)
        self.digest.update(centre.tobytes())
        self._sets.append(_against_sets(moment, truth, centre, predicted, occupancy))
        self._trajectories.append(_against_centres(moment, truth, centre, occupancy))

    def sets(self) -> SetSamples:
        distance, area, furthest = zip(*self._sets, strict=True) if self._sets else ((), (), ())
        h = len(HORIZON_COLUMNS)
        return SetSamples(
            distance=_joined(distance, np.float32, h),
            area=_joined(area, np.float32, h),
            furthest=_joined(furthest, np.float32),
        )

    def trajectories(self) -> TrajectorySamples:
        parts = self._trajectories
        error, total, count, limits = zip(*parts, strict=True) if parts else ((), (), (), ())
        h = len(HORIZON_COLUMNS)
        return TrajectorySamples(
            error=_joined(error, np.float32, h),
            total=_joined(total, np.float64),
            count=_joined(count, np.int64),
            limits=_joined(limits, np.float32, h, len(REPRESENTATIONS)),
        )


def _against_sets(
    moment: Moment,
    truth: FloatArray,
    centre: FloatArray,
    predicted: BoolArray,
    occupancy: Occupancy,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(W, 4) distances and areas at the horizons, (W,) largest distance."""
    rows, columns = moment.rows, np.array(HORIZON_COLUMNS)
    semi_axes = np.where(predicted[..., None], occupancy.semi_axes[rows, :STEPS], 0.0)
    angle = np.where(predicted, occupancy.angle[rows, :STEPS], 0.0)
    distance = mahalanobis(truth, centre, semi_axes, angle)
    distance[moment.recorded & ~predicted] = np.inf
    furthest = np.max(distance, axis=1, initial=0.0, where=moment.recorded)
    return distance[:, columns], ellipse_area(semi_axes)[:, columns], furthest


def _against_centres(
    moment: Moment, truth: FloatArray, centre: FloatArray, occupancy: Occupancy
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """(W, 4) errors at the horizons, (W,) sums and counts, (W, 4, 6) upper limits."""
    rows, columns = moment.rows, np.array(HORIZON_COLUMNS)
    error = displacement(centre, truth)
    known = np.isfinite(error)
    heading = moment.observation.states[rows, -1, USER_HEADING, None]
    limits = upper_limits(
        (truth - centre)[:, columns],
        heading,
        _motion(moment.observation)[rows, None],
        occupancy.heading[np.ix_(rows, columns)],
    )
    return error[:, columns], np.where(known, error, 0.0).sum(axis=1), known.sum(axis=1), limits


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
