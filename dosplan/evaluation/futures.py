"""How often a set holds over the futures of one past: coverage as it is meant.

A recording has one future, so coverage over recordings mixes pasts: sets that are too large in one
situation and too small in another can cover as often as they should. Traffic with several futures
allows to ask it of each past alone. A past is a road user as it was seen at the start of a
scenario; each method predicts it once, and K futures come.

Nobody plans here. The ego drives on along its route, at the speed and the distance from the
reference path at which it started, so that traffic that reacts has an ego to react to, the same
for every method and in every future.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dosplan.api import OraclePredictor, Predictor
from dosplan.evaluation.evaluate import (
    FILE_SECONDS,
    EvaluationError,
    Progress,
    check_timeout,
    each_file,
    one_problem_each,
    predictors_of,
    samples_or_reason,
)
from dosplan.evaluation.groups import KINDS, family_of, group_windows, lights_of
from dosplan.evaluation.methods import Method, build, check_labels, settings
from dosplan.evaluation.metrics import COVERAGE, clustered_ratio, covered
from dosplan.evaluation.samples import PredictionError, prediction_failure
from dosplan.evaluation.windows import HORIZON_COLUMNS, HORIZONS, STEPS
from dosplan.geometry import LightIndex, ReferencePath, set_distance
from dosplan.plugins.registry import PluginKind, choose_plugin, create_traffic, record
from dosplan.scenario import ScenarioError, ScenarioRef, load_scenario
from dosplan.simulation.traffic import RoadUsers, Traffic
from dosplan.simulation.world import World
from dosplan.system.errors import failure_place, one_line
from dosplan.system.provenance import describe_environment
from dosplan.system.workers import seed_globals
from dosplan.types import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    BoolArray,
    FloatArray,
    IntArray,
    Observation,
    Scenario,
)

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class FuturesConfig:
    """What is measured; two measurements of one configuration have the same figures.

    Attributes:
        source: Where the scenarios are, as ``dosplan.scenario.find_scenarios`` takes it.
        methods: The methods.
        traffic: Traffic that has several futures, as ``dosplan.plugins.registry`` finds it.
        futures: Number of futures of each past.
        level: What the sets are meant to cover, a share.
        workers: Number of worker processes.
        seed: Seed of everything random.
        file_timeout: Seconds after which a file counts as hung.
    """

    source: str
    methods: tuple[Method, ...]
    traffic: str
    futures: int
    level: float = COVERAGE
    workers: int = 1
    seed: int = 0
    file_timeout: float = FILE_SECONDS

    def __post_init__(self) -> None:
        for name in ("futures", "workers"):
            if getattr(self, name) < 1:
                raise EvaluationError(f"{name} is {getattr(self, name)}; it must be 1 or more")
        if not 0.0 < self.level < 1.0:
            raise EvaluationError(f"level is {self.level}; it must be between 0 and 1")
        if self.seed < 0:
            raise EvaluationError(f"seed is {self.seed}; it must not be negative")
        check_timeout(self.file_timeout)
        check_labels(self.methods)


@dataclass(frozen=True)
class PastSamples:
    """What came of the pasts of one scenario: W road users, K futures.

    Attributes:
        family: The scenario's family.
        kind: (W,) index into ``groups.KINDS``.
        speed: (W,) speed at the start, m/s.
        light: (W,) index into ``groups.LIGHTS``, of the light ahead; -1 where there is none.
        present: (K, W, 4) whether the road user is on the scene at 1, 2, 3, 4 s.
        held: For each method (K, W, 4), whether its set holds the centre then; False where the
            road user is gone.
    """

    family: str
    kind: npt.NDArray[np.int8]
    speed: npt.NDArray[np.float32]
    light: npt.NDArray[np.int8]
    present: BoolArray
    held: tuple[BoolArray, ...]


def evaluate_futures(
    config: FuturesConfig, progress: Progress = lambda done, total: None
) -> dict[str, Any]:
    """Measures the coverage of every method over the futures of each past.

    Args:
        config: What to measure.
        progress: Called with the number of finished files and of all.

    Returns:
        The content of ``--json``: rows of ``futures``, and ``data``, which says what they were
        measured on and lists the files that failed.

    Raises:
        EvaluationError: The traffic has one future, a method is shown the recording, there is no
            road user to predict, or no worker gets anything done.
        MethodError: A method cannot be built.
        RegistryError: There is no such traffic.
        ScenarioError: There are no scenarios.
    """
    chosen = choose_plugin(PluginKind.TRAFFIC, config.traffic)
    if not chosen.plugin.has_futures:
        raise EvaluationError(
            f"the traffic {chosen.plugin.name} has one future only; choose one that has several"
        )
    predictors = [build(method, config.seed) for method in config.methods]
    for method, predictor in zip(config.methods, predictors, strict=True):
        if isinstance(predictor, OraclePredictor):
            raise EvaluationError(
                f"method {method.label!r} is shown the recording, which the traffic departs from; "
                "leave it out"
            )
    files = one_problem_each(config.source)
    methods = json.dumps([asdict(method) for method in config.methods])
    arguments = (methods, config.traffic, config.futures, config.seed)
    progress(0, len(files))
    samples, failed = each_file(
        sample_pasts_of,
        files,
        arguments,
        config.workers,
        lambda done: progress(done, len(files)),
        config.file_timeout,
    )
    if not any(len(sample.kind) for sample in samples):
        cause = f"; the first that failed: {failed[0]['error']}" if failed else ""
        raise EvaluationError(f"{config.source}: no road user that can be predicted{cause}")
    labels = [method.label for method in config.methods]
    return {
        "futures": summarise_futures(samples, labels, config.level),
        "data": {
            "source": config.source,
            "files": len(files),
            "evaluated": len(samples),
            "failed": failed,
            "pasts": sum(len(sample.kind) for sample in samples),
            "futures": config.futures,
            "traffic": chosen.plugin.name,
            "traffic_settings": record(chosen),
            "level": config.level,
            "horizons_s": list(HORIZONS),
            "seed": config.seed,
            "methods": [
                {**asdict(method), "name": predictor.name, "settings": settings(method)}
                for method, predictor in zip(config.methods, predictors, strict=True)
            ],
            **asdict(describe_environment()),
        },
    }


def sample_pasts_of(
    ref: ScenarioRef, methods: str, traffic: str, futures: int, seed: int
) -> PastSamples | str:
    """Measures one file; what a worker does.

    Args:
        ref: The file.
        methods: The methods as JSON.
        traffic: The traffic.
        futures: Number of futures.
        seed: Seed of the run.

    Returns:
        Its samples, or one line that says why there are none.
    """
    seed_globals(seed)
    predictors = predictors_of(methods, seed)
    seed_globals(seed)

    def measure() -> PastSamples:
        scenario = load_scenario(ref)
        made = [create_traffic(traffic, seed, future=future) for future in range(futures)]
        if (why := made[0].refuses(scenario)) is not None:
            raise ScenarioError(ref.path, why)
        count = made[0].futures_of(ref.path)
        if count is not None and count < futures:
            raise ScenarioError(
                ref.path,
                f"has {count} recorded future{'s' if count > 1 else ''}, and {futures} are asked "
                "for; lower --futures, or choose a traffic that has more",
            )
        return sample_pasts(scenario, predictors, made)

    return samples_or_reason(ref, measure)


def sample_pasts(
    scenario: Scenario,
    predictors: Sequence[tuple[str, Predictor]],
    futures: Sequence[Traffic],
) -> PastSamples:
    """Predicts the start of a scenario once and lets each of its futures come.

    Args:
        scenario: The scenario.
        predictors: Labels and predictors.
        futures: The traffic of each future.

    Returns:
        The samples.

    Raises:
        PredictionError: A predictor or a traffic raised, or the futures do not have one past.
    """
    begun = [_begun(scenario, traffic) for traffic in futures]
    seen = begun[0][0]
    for traffic, (observation, _) in zip(futures, begun, strict=True):
        if not _same_past(seen, observation):
            raise PredictionError(
                f"the futures of traffic {traffic.name} do not have one past: future "
                f"{traffic.future} begins with other road users"
            )
    rows = np.array([i for i, kind in enumerate(seen.kinds) if kind in KINDS], dtype=np.int64)
    ahead = LightIndex(scenario.road_map).ahead(seen.states[rows, -1], seen.size[rows], seen.lights)
    truth = np.stack([_centres(come, seen.ids[rows]) for _, come in begun])
    return PastSamples(
        family=family_of(scenario.benchmark_id, scenario.tags),
        kind=np.array([KINDS.index(seen.kinds[row]) for row in rows], dtype=np.int8),
        speed=np.abs(seen.states[rows, -1, USER_VELOCITY]).astype(np.float32),
        light=lights_of(ahead.colour),
        present=np.isfinite(truth[..., 0]),
        held=tuple(
            _held(scenario, seen, rows, truth, label, predictor) for label, predictor in predictors
        ),
    )


def coasting(scenario: Scenario, steps: int) -> FloatArray:
    """The ego that drives on: constant speed, at a constant distance from its reference path.

    Args:
        scenario: The scenario.
        steps: How many steps.

    Returns:
        (steps + 1, 5) ego states from its start on, with the wheel straight. Beyond the ends of
        the path it goes straight on.
    """
    task = scenario.task
    path = ReferencePath.of(task.route)
    start = task.start[[EGO_X, EGO_Y]]
    first = path.locate_first(start)
    across = float(path.offset(start, first))
    along = first + task.start[EGO_VELOCITY] * scenario.dt * np.arange(steps + 1)
    heading = path.heading_at(along)
    beyond = along - np.clip(along, path.arclength[0], path.arclength[-1])
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
    points = np.stack(
        [np.interp(along, path.arclength, path.points[:, axis]) for axis in (0, 1)], axis=-1
    )
    states = np.zeros((steps + 1, EGO_SIZE))
    states[:, [EGO_X, EGO_Y]] = points + beyond[:, None] * forward + across * left
    states[:, EGO_HEADING] = heading
    states[:, EGO_VELOCITY] = task.start[EGO_VELOCITY]
    states[0] = task.start
    return states


def summarise_futures(samples: Sequence[PastSamples], labels: Sequence[str], level: float) -> Rows:
    """Averages the samples over every group.

    Args:
        samples: Samples of the scenarios, in their order.
        labels: Labels of the methods.
        level: What the sets are meant to cover.

    Returns:
        A row for each method, group and horizon. ``cr`` is the share of all futures in which the
        set held, with its standard error over scenarios; ``below`` the share of pasts in whose own
        futures it held less often than ``level``. Few futures scatter, so that some pasts are below
        by chance: ``below_by_chance`` is the share that would be if every past were covered with
        the probability ``level``. ``pasts`` and ``n``, how many pasts and futures of them count.
        A figure is None where nothing counts.
    """
    scenario = np.repeat(np.arange(len(samples)), [len(s.kind) for s in samples])
    groups = group_windows(
        np.concatenate([s.kind for s in samples]),
        np.concatenate([s.speed for s in samples]),
        np.concatenate([s.light for s in samples]),
        [s.family for s in samples],
        scenario,
    )
    present = np.concatenate([s.present for s in samples], axis=1)
    rows = []
    for index, label in enumerate(labels):
        held = np.concatenate([s.held[index] for s in samples], axis=1)
        for group, members in groups.items():
            for h, horizon in enumerate(HORIZONS):
                figures = _figures(
                    held[:, members, h], present[:, members, h], scenario[members], level
                )
                rows.append({"method": label, "group": group, "horizon_s": horizon, **figures})
    return rows


def _figures(
    held: BoolArray, present: BoolArray, scenario: IntArray, level: float
) -> Mapping[str, float | int | None]:
    """The figures of (K, W) verdicts on W pasts."""
    from scipy.stats import binom  # A slow import that the rest of the command does without.

    rate = clustered_ratio(held[present], np.broadcast_to(scenario, present.shape)[present])
    count, hits = present.sum(axis=0), held.sum(axis=0)
    count, hits = count[count > 0], hits[count > 0]
    enough = np.ceil(level * count - 1e-9)
    some = len(count) > 0
    return {
        "cr": rate.value,
        "cr_se": rate.error,
        "below": float(np.mean(hits < enough)) if some else None,
        "below_by_chance": float(np.mean(binom.cdf(enough - 1, count, level))) if some else None,
        "pasts": len(count),
        "n": rate.n,
    }


def _begun(scenario: Scenario, traffic: Traffic) -> tuple[Observation, list[RoadUsers]]:
    """What is seen at the start under a traffic, and the road users at the steps that follow."""
    ego = coasting(scenario, STEPS)
    try:
        world = World(scenario, traffic)
        first, seen = world.start_step, world.observation()
        steps = range(1, STEPS + 1)
        return seen, [traffic.step(first + step, ego[: step + 1]) for step in steps]
    except (Exception, SystemExit) as error:
        place = failure_place(error, type(traffic))
        raise PredictionError(
            f"traffic {traffic.name}, future {traffic.future}, failed: {one_line(error)} ({place})"
        ) from error
    finally:
        traffic.close()


def _same_past(one: Observation, other: Observation) -> bool:
    return np.array_equal(one.ids, other.ids) and np.array_equal(
        one.states, other.states, equal_nan=True
    )


def _centres(come: Sequence[RoadUsers], ids: IntArray) -> FloatArray:
    """(W, 4, 2) centres of road users at the horizons, m; NaN where one is not on the scene."""
    found = np.full((len(ids), len(HORIZON_COLUMNS), 2), np.nan)
    for h, column in enumerate(HORIZON_COLUMNS):
        users = come[column]
        places = {name: row for row, name in enumerate(users.ids.tolist())}
        for row, name in enumerate(ids.tolist()):
            if name in places:
                found[row, h] = users.states[places[name], [USER_X, USER_Y]]
    return found


def _held(
    scenario: Scenario,
    observation: Observation,
    rows: IntArray,
    truth: FloatArray,
    label: str,
    predictor: Predictor,
) -> BoolArray:
    """(K, W, 4) whether the sets of a method hold the (K, W, 4, 2) true centres."""
    try:
        predictor.reset(scenario.task, scenario.road_map)
        occupancy = predictor.predict(observation)
    except (Exception, SystemExit) as error:
        raise prediction_failure(label, predictor, error) from error
    sets = occupancy.of_users(rows).of_steps(np.array(HORIZON_COLUMNS))
    return covered(set_distance(truth, sets))
