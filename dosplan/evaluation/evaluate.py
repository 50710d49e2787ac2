"""Evaluates methods on a folder of recordings, in worker processes.

A task is one file. Where anything fails there (the file, a method on it, the worker), the file is
left out for every method, so that all methods are compared on the same windows, and the failure is
listed. Results do not depend on the number of workers.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any, Final, TypeVar

from pebble import ProcessExpired

from dosplan.api import Predictor
from dosplan.evaluation.limits import MAX_RATIO
from dosplan.evaluation.methods import Method, build, check_labels, settings
from dosplan.evaluation.metrics import COVERAGE
from dosplan.evaluation.samples import FileSamples, PredictionError, sample_file
from dosplan.evaluation.summary import scales, summarise
from dosplan.evaluation.windows import HORIZONS, STEPS
from dosplan.plugins.loops import choose_loop, record_loop
from dosplan.plugins.settings import SettingsError
from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios, load_recording
from dosplan.simulation.settings import IDEAL, LoopSettings, loop_name
from dosplan.system.errors import DosplanError, one_line
from dosplan.system.provenance import describe_environment
from dosplan.system.workers import cause_of_death, seed_globals, worker_pool
from dosplan.types import HISTORY_STEPS

FILE_SECONDS: Final = 3600.0
"""After so long a file counts as hung: with some methods, a recording of minutes takes many."""
Progress = Callable[[int, int], None]
_Samples = TypeVar("_Samples")


class EvaluationError(DosplanError, ValueError):
    """An evaluation that cannot start or has nothing to show; the message is one line."""


@dataclass(frozen=True)
class EvaluationConfig:
    """What is evaluated; two evaluations of one configuration have the same figures.

    Attributes:
        source: Where the recordings are, as ``dosplan.scenario.find_scenarios`` takes it.
        methods: The methods.
        every: Steps between two observations of a recording.
        loop: The loop through which the road users are seen, by name.
        loop_options: What is changed of it.
        scale_on: Recordings on which the sets of OSA@90 are scaled; None scales them on
            ``source`` itself.
        workers: Number of worker processes.
        seed: Seed of everything random.
        file_timeout: Seconds after which a file counts as hung.
    """

    source: str
    methods: tuple[Method, ...]
    every: int = 5
    loop: str = "ideal"
    loop_options: Mapping[str, Any] = field(default_factory=dict)
    scale_on: str | None = None
    workers: int = 1
    seed: int = 0
    file_timeout: float = FILE_SECONDS

    @property
    def chosen_loop(self) -> LoopSettings:
        """The loop that ``loop`` and ``loop_options`` name."""
        return choose_loop(self.loop, self.loop_options)

    def __post_init__(self) -> None:
        try:
            loop = self.chosen_loop
        except SettingsError as error:
            raise EvaluationError(str(error)) from None
        if loop.real_time:
            raise EvaluationError(
                "real_time is True; here nothing is driven that takes its time, so set a latency"
            )
        if loop.latency_steps >= STEPS:
            raise EvaluationError(
                f"latency is {loop.latency} s; it must be less than the {HORIZONS[-1]:g} s that "
                "are predicted"
            )
        for name in ("every", "workers"):
            if getattr(self, name) < 1:
                raise EvaluationError(f"{name} is {getattr(self, name)}; it must be 1 or more")
        if self.seed < 0:
            raise EvaluationError(f"seed is {self.seed}; it must not be negative")
        check_timeout(self.file_timeout)
        check_labels(self.methods)


def check_timeout(seconds: float) -> None:
    """Checks the time that a file may take.

    Args:
        seconds: The time, s.

    Raises:
        EvaluationError: It is not positive and finite.
    """
    if not 0.0 < seconds < threading.TIMEOUT_MAX:
        raise EvaluationError(f"file_timeout is {seconds:g}; it must be a time above 0 s")


def evaluate(
    config: EvaluationConfig, progress: Progress = lambda done, total: None
) -> dict[str, Any]:
    """Evaluates every method.

    Args:
        config: What to evaluate.
        progress: Called with the number of finished files and of all.

    Returns:
        The content of ``--json``: rows of ``sets``, ``trajectories``, ``upper_limits`` and
        ``simultaneous``, and ``data``, which says what they were measured on and lists the
        files that failed.

    Raises:
        EvaluationError: There is no window to evaluate, or no worker gets anything done.
        MethodError: A method cannot be built.
        ScenarioError: There are no scenarios.
    """
    loop = config.chosen_loop
    names = [build(method, config.seed, loop).name for method in config.methods]
    files = one_problem_each(config.source)
    reference = [] if config.scale_on is None else one_problem_each(config.scale_on)
    total = len(reference) + len(files)
    progress(0, total)
    failed: list[dict[str, str]] = []
    factors = None
    if config.scale_on is not None:
        known, broken = _sample_all(reference, config, lambda done: progress(done, total))
        failed += broken
        _require_windows(known, config.scale_on, broken)
        factors = scales(known)
        del known  # It is as large as what follows.
    done_before = len(reference)
    samples, broken = _sample_all(files, config, lambda done: progress(done_before + done, total))
    failed += broken
    _require_windows(samples, config.source, broken)
    labels = [method.label for method in config.methods]
    return {
        **summarise(samples, labels, scales(samples) if factors is None else factors),
        "data": {
            "source": config.source,
            "files": len(files),
            "evaluated": len(samples),
            "failed": failed,
            "windows": sum(len(s.kind) for s in samples),
            "every": config.every,
            "loop": loop_name(loop),
            "loop_settings": record_loop(loop),
            "history": HISTORY_STEPS,
            "horizons_s": list(HORIZONS),
            "scaled_on": config.source if config.scale_on is None else config.scale_on,
            "scaled_on_itself": config.scale_on is None,
            "scaled_to": COVERAGE,
            "max_ratio": MAX_RATIO,
            "seed": config.seed,
            "methods": [
                {**asdict(method), "name": name, "settings": settings(method, loop)}
                for method, name in zip(config.methods, names, strict=True)
            ],
            **asdict(describe_environment()),
        },
    }


def sample_path(
    ref: ScenarioRef, methods: str, every: int, loop: LoopSettings, seed: int
) -> FileSamples | str:
    """Evaluates one file; what a worker does.

    Args:
        ref: The file.
        methods: The methods as JSON.
        every: Steps between two observations.
        loop: What is seen, and how late it is acted upon.
        seed: Seed of the run.

    Returns:
        Its samples, or one line that says why there are none.
    """
    seed_globals(seed)
    predictors = predictors_of(methods, seed, loop)
    seed_globals(seed)
    return samples_or_reason(
        ref, lambda: sample_file(load_recording(ref), predictors, every, loop, seed)
    )


def samples_or_reason(ref: ScenarioRef, measure: Callable[[], _Samples]) -> _Samples | str:
    """Measures a file; what goes wrong loses this file only.

    Args:
        ref: The file.
        measure: Measures it.

    Returns:
        What was measured, or one line that names the file and says why there is nothing.
    """
    try:
        return measure()
    except ScenarioError as error:
        return str(error)  # It names the file.
    except PredictionError as error:
        predictors_of.cache_clear()
        return f"{ref.path}: {error}"
    except Exception as error:  # An error in the reader loses one file only.
        return f"{ref.path}: {one_line(error)}"


@lru_cache(maxsize=1)
def predictors_of(
    methods: str, seed: int, loop: LoopSettings = IDEAL
) -> list[tuple[str, Predictor]]:
    """Makes the predictors of all methods; a worker keeps them from file to file.

    Args:
        methods: The methods as JSON.
        seed: Seed of the run.
        loop: The loop that they are to predict in.

    Returns:
        Labels and predictors.

    Raises:
        MethodError: A method cannot be built.
    """
    listed = [Method(**method) for method in json.loads(methods)]
    return [(method.label, build(method, seed, loop)) for method in listed]


def one_problem_each(source: str) -> list[ScenarioRef]:
    """Lists files with one planning problem each: the recording is the same for all of them.

    Args:
        source: Where they are, as ``dosplan.scenario.find_scenarios`` takes it.

    Returns:
        The first problem of each file.

    Raises:
        ScenarioError: There are no scenarios.
    """
    return list({ref.path: ref for ref in reversed(find_scenarios(source))}.values())[::-1]


def each_file(
    call: Callable[..., _Samples | str],
    files: Sequence[ScenarioRef],
    arguments: tuple[Any, ...],
    workers: int,
    progress: Callable[[int], None],
    timeout: float,
) -> tuple[list[_Samples], list[dict[str, str]]]:
    """Has worker processes take samples of files.

    Args:
        call: Takes a file and the arguments; what it returns is the file's samples, or one line
            that says why there are none.
        files: The files.
        arguments: The other arguments of the call.
        workers: Number of worker processes.
        progress: Called with the number of finished files.
        timeout: Seconds after which a file counts as hung.

    Returns:
        The samples of all files that can be used, in their order, and what the others lack.

    Raises:
        EvaluationError: No worker gets anything done.
    """
    results: dict[int, _Samples | str] = {}
    with worker_pool(min(workers, len(files))) as pool:
        futures: dict[Future[_Samples | str], int] = {
            pool.schedule(call, (ref, *arguments), timeout=timeout): i
            for i, ref in enumerate(files)
        }
        for future in as_completed(futures):
            i = futures[future]
            results[i] = _result(future, files[i], timeout)
            progress(len(results))
    samples: list[_Samples] = []
    failed: list[dict[str, str]] = []
    for i, ref in enumerate(files):
        result = results[i]
        if isinstance(result, str):
            failed.append({"file": ref.path.name, "error": result})
        else:
            samples.append(result)
    return samples, failed


def _sample_all(
    files: Sequence[ScenarioRef], config: EvaluationConfig, progress: Callable[[int], None]
) -> tuple[list[FileSamples], list[dict[str, str]]]:
    methods = json.dumps([asdict(method) for method in config.methods])
    arguments = (methods, config.every, config.chosen_loop, config.seed)
    return each_file(sample_path, files, arguments, config.workers, progress, config.file_timeout)


def _result(future: Future[_Samples | str], ref: ScenarioRef, timeout: float) -> _Samples | str:
    """What a task returned, or one line on the end of its worker."""
    try:
        return future.result()
    except TimeoutError:
        return f"{ref.path}: timed out after {timeout:g} s; allow it more with --timeout"
    except ProcessExpired as error:
        return f"{ref.path}: {cause_of_death(error.exitcode)}"
    except BrokenProcessPool as error:
        raise EvaluationError(
            "worker processes die before they take up a file; "
            "look at the machine's free memory and try fewer --workers"
        ) from error


def _require_windows(
    samples: Sequence[FileSamples], source: str, failed: Sequence[dict[str, str]]
) -> None:
    if not any(len(s.kind) for s in samples):
        cause = f"; the first that failed: {failed[0]['error']}" if failed else ""
        raise EvaluationError(
            f"{source}: no road user that can be predicted has a recorded future{cause}"
        )
