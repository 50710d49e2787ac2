"""Drives many episodes in worker processes; whatever happens, every episode becomes a row.

An episode is one scenario in one arm, and one task of the pool. It loads its scenario itself:
reading costs a hundredth of driving, and so a planner that brings its process down takes that
one episode with it and nothing else. The planner and the predictor, whose making is costly, are
kept from episode to episode by each worker, and made anew after a failure.

Determinism: a row must not depend on which worker drove it or what that worker drove before.
Plug-ins are ``reset``, the global random generators are seeded before plug-ins are made and for
each episode, numerical libraries get one thread, and the rows end up in the order of the manifest.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import random
import signal
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import lru_cache
from itertools import product
from pathlib import Path
from threading import Thread
from typing import Any, Final

import numpy as np
from pebble import ProcessExpired, ProcessPool

from dosplan.api import OraclePredictor, Planner, Predictor
from dosplan.compare import compare_rows
from dosplan.files import FileError, write_json, write_text
from dosplan.provenance import content_digest, describe_environment
from dosplan.recording import save_recording
from dosplan.registry import (
    create_planner,
    create_predictor,
    find_planner,
    find_predictor,
    one_line,
    source_files,
)
from dosplan.report.tables import summary_markdown
from dosplan.results import (
    RunFolder,
    append_row,
    pooled_cycle_ms,
    read_manifest,
    read_rows,
    row_line,
    summarise,
    write_rows,
)
from dosplan.scenario import ScenarioRef, find_scenarios, load_scenario
from dosplan.scoring import failed_score, score
from dosplan.simulation import SimulationConfig, run_episode
from dosplan.types import Arm, EpisodeEnd, Score
from dosplan.vehicle import VehicleParameters

Progress = Callable[[int, int], None]
_Task = tuple[ScenarioRef, Arm]

# Read once, when a numerical library is loaded. The hash seed fixes the order of sets of strings.
_WORKER_ENVIRONMENT: Final = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
}


class RunError(ValueError):
    """A run that cannot start or go on; the message is one line."""


@dataclass(frozen=True)
class RunConfig:
    """What a run is; two runs of one configuration have the same rows but for their timings.

    Attributes:
        out: The run folder.
        source: ``suite``, or a scenario file or folder.
        planner: Planner, as ``dosplan.registry`` finds it.
        predictor: Predictor, likewise.
        arms: Arms to drive.
        workers: Number of worker processes.
        limit: Number of scenarios to drive, the first ones; None drives all.
        seed: Seed of everything random.
        replan_every: Steps driven from each plan.
        episode_timeout: Seconds after which an episode counts as hung; the making of the
            planner, where a worker has none yet, is within them.
        ranked: Whether the run keeps the rules: a predictor that sees the future is refused.
    """

    out: Path
    source: str = "suite"
    planner: str = "mpc"
    predictor: str = "growing-circle"
    arms: tuple[Arm, ...] = tuple(Arm)
    workers: int = 1
    limit: int | None = None
    seed: int = 0
    replan_every: int = 1
    episode_timeout: float = 600.0
    ranked: bool = True

    def __post_init__(self) -> None:
        if not self.arms or len(set(self.arms)) != len(self.arms):
            raise RunError("arms must name one arm or both, each once")
        if not 0.0 < self.episode_timeout < math.inf:
            raise RunError(
                f"episode_timeout is {self.episode_timeout}; it must be more than 0 and finite"
            )
        for name in ("workers", "limit", "replan_every"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise RunError(f"{name} is {value}; it must be more than 0")
        if self.seed < 0:
            raise RunError(f"seed is {self.seed}; it must not be negative")


def run(config: RunConfig, progress: Progress = lambda done, total: None) -> RunFolder:
    """Drives every episode of a run, or those that an interrupted one left.

    Args:
        config: The run.
        progress: Called with the number of finished episodes and of all, first before any is
            driven.

    Returns:
        The run folder, complete.

    Raises:
        RunError: The run may not start, or its folder holds another one.
        RegistryError: A plug-in cannot be found.
        ScenarioError: There are no scenarios.
        FileError: A result cannot be written.
    """
    refs = find_scenarios(config.source)[: config.limit]
    manifest = _manifest(config, refs)
    folder = RunFolder(config.out)
    manifest = _open_folder(folder, manifest)
    tasks = list(product(refs, config.arms))
    wanted = {(ref.id, arm) for ref, arm in tasks}
    kept = [row for row in read_rows(folder.rows) if folder.holds(row)]
    rows = {key: row for row in kept if (key := (row.scenario, row.arm)) in wanted}
    write_rows(folder.rows, rows.values())

    left = [(ref, arm) for ref, arm in tasks if (ref.id, arm) not in rows]
    progress(len(rows), len(tasks))
    with folder.rows.open("ab", buffering=0) as file, closing(_drive_all(left, config)) as done:
        for row in done:
            append_row(file, row)
            rows[row.scenario, row.arm] = row
            progress(len(rows), len(tasks))

    ordered = [rows[ref.id, arm] for ref, arm in tasks]
    write_rows(folder.rows, ordered)
    summary = _summary(folder, manifest, ordered)
    write_json(folder.summary, summary)
    write_text(folder.summary_text, summary_markdown(summary))
    return folder


def drive_episode(ref: ScenarioRef, arm: Arm, config: RunConfig) -> Score:
    """Drives, scores and records one episode; what a worker does.

    Args:
        ref: The scenario.
        arm: The arm.
        config: The run.

    Returns:
        Its row. Whatever a plug-in or a scenario file raises becomes a row, too.

    Raises:
        FileError: The episode's file cannot be written; that ends the run.
    """
    vehicle = VehicleParameters()
    folder = RunFolder(config.out)

    def keep_traceback(error: BaseException) -> None:
        text = "".join(traceback.format_exception(error))
        write_text(folder.traceback(ref.id, arm), text.encode(errors="replace").decode())

    try:
        _seed_globals(config.seed)
        planner, predictor = _plugins(config.planner, config.predictor, config.seed)
        _seed_globals(config.seed)
        scenario = load_scenario(ref)
        simulation = SimulationConfig(replan_every=config.replan_every)
        episode = run_episode(
            scenario, planner, predictor, arm, simulation, vehicle, keep_traceback
        )
        row = score(scenario, episode, vehicle)
        row_line(row)  # What is no number is told here, not by the runner when it appends the row.
        save_recording(folder.recording(ref.id, arm), episode, vehicle)
    except FileError:
        raise
    except (Exception, SystemExit) as error:
        _plugins.cache_clear()
        keep_traceback(error)
        return failed_score(ref.id, arm, one_line(error))
    if episode.end is EpisodeEnd.PLANNER_FAILURE:
        _plugins.cache_clear()
    return row


def _seed_globals(seed: int) -> None:
    """Seeds the global generators, which a plug-in may use."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002


@lru_cache(maxsize=1)
def _plugins(planner: str, predictor: str, seed: int) -> tuple[Planner, Predictor]:
    return create_planner(planner, seed), create_predictor(predictor, seed)


def _manifest(config: RunConfig, refs: Sequence[ScenarioRef]) -> dict[str, Any]:
    """Checks the plug-ins and describes the run: the content of ``run.json``."""
    planner, predictor = find_planner(config.planner), find_predictor(config.predictor)
    if config.ranked and issubclass(predictor, OraclePredictor):
        raise RunError(
            f"predictor {predictor.name} is shown the future, so a ranked run refuses it; "
            "--unranked allows it and marks the results"
        )
    settings = {**asdict(config), "arms": list(config.arms)}
    del settings["out"]  # The folder is where the file is.
    return {
        "config": settings,
        "planner": planner.name,
        "predictor": predictor.name,
        "scenarios": [ref.id for ref in refs],
        "digests": {
            "planner file": content_digest(source_files(config.planner)),
            "predictor file": content_digest(source_files(config.predictor)),
            "scenario files": content_digest(ref.path for ref in refs),
        },
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        **describe_environment(),
    }


def _open_folder(folder: RunFolder, manifest: dict[str, Any]) -> dict[str, Any]:
    """Makes the run folder, or checks that the one that is there holds the same run.

    Returns:
        What its ``run.json`` holds.
    """
    if folder.manifest.exists():
        old = read_manifest(folder)
        there, here = _identity(old), _identity(manifest)
        odd = next((key for key in here if there.get(key) != here[key]), None)
        if odd is not None:
            raise RunError(
                f"{folder.path} holds a run with another {odd}; nothing was changed. "
                "Choose another --out, or give the same arguments to resume"
            )
        return old
    if folder.path.is_dir() and any(folder.path.iterdir()):
        raise RunError(f"{folder.path} is not empty and holds no run; choose another --out")
    write_json(folder.manifest, manifest)
    return manifest


def _identity(manifest: dict[str, Any]) -> dict[str, Any]:
    """What must agree for two invocations to be one run."""
    # The source is known by its scenarios: the same files by another path are the same source.
    free = ("workers", "source")
    settings = {key: value for key, value in manifest["config"].items() if key not in free}
    plugins = {f"{key} version": manifest[key] for key in ("planner", "predictor")}
    return {
        **settings,
        **plugins,
        "dosplan version": manifest["versions"].get("dosplan"),
        "list of scenarios": manifest["scenarios"],
        "content of its planner, predictor or scenario files": manifest.get("digests"),
    }


def _drive_all(tasks: Sequence[_Task], config: RunConfig) -> Generator[Score]:
    """Yields the rows of all tasks as they finish."""
    waiting = list(tasks)
    while waiting:
        unfinished = dict.fromkeys(waiting)
        for task, row in _drive_in_pool(waiting, config):
            del unfinished[task]
            yield row
        if len(unfinished) == len(waiting):
            raise RunError(
                "worker processes die before they take up an episode; "
                "look at the machine's free memory and try fewer --workers"
            )
        waiting = list(unfinished)


def _drive_in_pool(tasks: Sequence[_Task], config: RunConfig) -> Iterator[tuple[_Task, Score]]:
    """Yields what one pool gets done: all tasks, unless it breaks as a whole."""
    context = multiprocessing.get_context("spawn")
    workers = min(config.workers, len(tasks))
    made = ProcessPool(workers, initializer=_prepare_worker, context=context)
    with _environment(_WORKER_ENVIRONMENT), _stopped(made) as pool:
        futures: dict[Future[Score], _Task] = {}
        for task in tasks:
            arguments = (*task, config)
            futures[pool.schedule(drive_episode, arguments, timeout=config.episode_timeout)] = task
        for future in as_completed(futures):
            ref, arm = task = futures[future]
            error = future.exception()
            if error is None:
                yield task, future.result()
            elif isinstance(error, TimeoutError):
                reason = f"timed out after {config.episode_timeout:g} s"
                yield task, failed_score(ref.id, arm, reason)
            elif isinstance(error, ProcessExpired):
                yield task, failed_score(ref.id, arm, _cause_of_death(error.exitcode))
            elif not isinstance(error, BrokenProcessPool):
                raise error


def _prepare_worker() -> None:
    """Keeps a worker's prints out of the figures on stdout, and ends it with the runner."""
    os.dup2(2, 1)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # However it ends: killed, too, when it can no longer stop its workers.
        os._exit(1)


def _cause_of_death(exit_code: int) -> str:
    if exit_code >= 0:
        return f"the worker process ended with exit code {exit_code}"
    return f"the worker process was killed by {signal.Signals(-exit_code).name}"


@contextmanager
def _stopped(pool: ProcessPool) -> Iterator[ProcessPool]:
    """Ends the pool's processes on leaving, whatever they are doing."""
    try:
        yield pool
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Sets environment variables, which child processes inherit, for the length of the block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _summary(folder: RunFolder, manifest: dict[str, Any], rows: Sequence[Score]) -> dict[str, Any]:
    """Content of ``summary.json``: the figures of each arm, and the run they belong to."""
    arms = [Arm(arm) for arm in manifest["config"]["arms"]]
    times = {arm: pooled_cycle_ms(folder, rows, arm) for arm in arms}
    figures = summarise(rows, len(manifest["scenarios"]), times)
    summary: dict[str, Any] = {arm.value: figures[arm] for arm in arms}
    summary["run"] = {
        "source": manifest["config"]["source"],
        "planner": manifest["planner"],
        "predictor": manifest["predictor"],
        "seed": manifest["config"]["seed"],
        "ranked": manifest["config"]["ranked"],
    }
    if len(arms) == len(Arm):
        by_arm = {arm: [row for row in rows if row.arm is arm] for arm in Arm}
        comparison = compare_rows(
            by_arm[Arm.WITHOUT_DOS],
            by_arm[Arm.WITH_DOS],
            Arm.WITHOUT_DOS.value,
            Arm.WITH_DOS.value,
        )
        summary["comparison"] = asdict(comparison)
    return summary
