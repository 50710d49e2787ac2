"""Drives many episodes; whatever happens, every episode becomes a row.

An episode is one scenario in one arm with one future. An ``Executor`` drives it; the run loop hands
out the episodes that have no row yet and is the only one that writes what comes back: first the
files of an episode, then its row, so that a row always has its files. A run that was killed at any
moment is resumed by the same command. One that names more scenarios, or more futures, adds them to
the run and drives what is missing. The rows end up in the order of the manifest.

Before the first episode every scenario is read and checked, where it would be driven. One that
nobody could drive has its rows at once, of the outcome ``unusable``, in every arm
and future.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any, Final

from dosplan.api import DeadlineSettings, OraclePredictor
from dosplan.plugins.loops import record_loop
from dosplan.plugins.registry import (
    PluginKind,
    choose_planner,
    choose_plugin,
    choose_predictor,
    record,
    source_files,
)
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import (
    SCENARIO_FILES,
    RunManifest,
    read_manifest,
    write_manifest,
)
from dosplan.results.markdown import summary_markdown
from dosplan.results.rows import append_row, read_rows, write_rows
from dosplan.results.solutions import write_solutions
from dosplan.results.summary import summarise_run, write_summary
from dosplan.results.unusable import unusable_scenarios
from dosplan.running.config import FREE, SELECTION, RunConfig, RunError
from dosplan.running.executor import Executor, LocalExecutor, Results, Workers
from dosplan.running.job import EpisodeResult, Task, make_plugins
from dosplan.running.progress import Observer
from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios
from dosplan.scenario.sources.catalogue import find_ids
from dosplan.scenario.sources.futures import futures_file
from dosplan.scenario.sources.selection import matching, sampled
from dosplan.scoring.score import failed_score
from dosplan.simulation.settings import loop_name
from dosplan.simulation.traffic import Traffic
from dosplan.system.files import remove_half_written, write_bytes, write_text
from dosplan.system.locks import exclusive
from dosplan.system.provenance import content_digest, describe_environment
from dosplan.types import Outcome, Score

__all__ = ["RunConfig", "RunError", "describe", "run"]

_CONTENT: Final = "content of its plug-in, weight or scenario files"
_PARTS: Final = ("episodes", "solutions")


def run(
    config: RunConfig,
    observer: Observer = Observer(),  # noqa: B008 - no state
    executor: Executor | None = None,
) -> RunFolder:
    """Drives every episode of a run, or those that are missing in its folder.

    A folder that holds the same run, but for scenarios that are new, is extended: its rows are
    kept. The list in ``run.json`` is written before anything is driven.

    Args:
        config: The run.
        observer: Receives the rows that exist already and each new one.
        executor: Drives the episodes; by default, what the configuration names: its cluster, or
            its number of worker processes on this machine.

    Returns:
        The run folder, complete.

    Raises:
        RunError: The run may not start or cannot go on, or its folder holds another one, or one
            of more scenarios.
        RegistryError: A plug-in cannot be found or built, or an option is wrong.
        ScenarioError: There are no scenarios, or a file of futures is damaged.
        SelectionError: Nothing is left of the choice among them.
        FileError: A result cannot be written.
    """
    refs = _chosen(config)
    _check_futures(config, refs)
    folder = RunFolder(config.out)
    wanted = _manifest(config, refs)
    _open_folder(folder, wanted, refs)
    tasks = [Task(*part) for part in product(refs, config.arms, range(config.futures))]
    with _held(folder):
        manifest = _extended(folder, wanted, refs)
        kept, left = _unfinished(folder, tasks)
        episodes = dict.fromkeys(config.arms, len(refs) * config.futures)
        observer.begin(episodes, kept, config.futures)
        if left:
            with (executor or _executor(config)).start(config) as workers:
                left = _check(folder, manifest, workers, kept, left, observer)
                _drive(folder, manifest, workers.drive(left), observer)
        else:
            observer.checked((), unusable_scenarios(kept))
        by_key = {row.key: row for row in read_rows(folder.rows)}
        if lost := [task.key for task in tasks if task.key not in by_key]:
            raise RunError(
                f"{folder.rows} has lost {len(lost)} rows while the run went on, as that of "
                f"{lost[0].title}; the same command drives them again"
            )
        rows = [by_key[task.key] for task in tasks]
        write_rows(folder.rows, rows)
        summary = summarise_run(folder, manifest, rows)
        write_summary(folder, summary)
        write_text(folder.summary_text, summary_markdown(summary))
        if config.solutions:
            write_solutions(folder, refs, manifest)
    return folder


def describe(config: RunConfig) -> RunManifest:
    """Tells what a run would drive, and finds what would keep it from starting; writes nothing.

    Args:
        config: The run.

    Returns:
        What ``run.json`` would hold.

    Raises:
        RunError: As of ``run``.
        RegistryError: Likewise.
        ScenarioError: Likewise.
        SelectionError: Likewise.
    """
    refs = _chosen(config)
    _check_futures(config, refs)
    folder, wanted = RunFolder(config.out), _manifest(config, refs)
    if folder.manifest.exists():
        _check_same(folder, read_manifest(folder), wanted, refs)
    return wanted


def _chosen(config: RunConfig) -> list[ScenarioRef]:
    """The scenarios of a run."""
    refs = find_ids(config.source, config.ids) if config.ids else find_scenarios(config.source)
    refs = matching(refs, config.only)
    if config.sample is not None:
        refs = sampled(refs, config.sample, config.seed)
    return refs[: config.limit]


def _check_futures(config: RunConfig, refs: Sequence[ScenarioRef]) -> None:
    """Refuses a run of more futures than the traffic has for one of its scenarios."""
    if config.futures == 1:
        return
    traffic: type[Traffic] = choose_plugin(
        PluginKind.TRAFFIC, config.traffic, config.traffic_options
    ).plugin
    few = {}
    for ref in refs:
        try:
            count = traffic.futures_of(ref.path)
        except ScenarioError:
            continue  # It becomes an unusable scenario; the others are driven.
        if count is not None and count < config.futures:
            few[ref] = count
    if few:
        ref, count = next(iter(few.items()))
        raise RunError(
            f"futures is {config.futures}, and the traffic {traffic.name} has {count} for "
            f"{len(few)} of the {len(refs)} scenarios, as {ref.id}, of which no more are "
            "recorded; lower --futures, or choose a traffic that has more"
        )


def _executor(config: RunConfig) -> Executor:
    if config.cluster is None:
        return LocalExecutor(config.workers)
    from dosplan.running.dask_cluster import DaskExecutor  # Of an optional dependency.

    return DaskExecutor(config.cluster)


def _unfinished(folder: RunFolder, tasks: Sequence[Task]) -> tuple[list[Score], list[Task]]:
    """Repairs what a run that was killed left in the folder.

    Returns:
        Its rows, and what is to be driven.
    """
    for place in (folder.path, *(folder.path / name for name in _PARTS)):
        remove_half_written(place)
    wanted = {task.key for task in tasks}
    rows = read_rows(folder.rows)
    kept = {row.key: row for row in rows if row.key in wanted and folder.holds(row)}
    write_rows(folder.rows, kept.values())
    left = [task for task in tasks if task.key not in kept]
    return list(kept.values()), left


def _check(
    folder: RunFolder,
    manifest: RunManifest,
    workers: Workers,
    kept: Sequence[Score],
    left: Sequence[Task],
    observer: Observer,
) -> list[Task]:
    """Has scenarios checked that have no row yet, and writes rows of the unusable ones.

    Returns:
        What is to be driven.
    """
    # A row says what was found when the run began, so that the arms agree whatever happens.
    reasons = {row.scenario: row.error or "" for row in kept if row.outcome is Outcome.UNUSABLE}
    known = {row.scenario for row in kept}
    refs = list({ref.id: ref for ref, *_ in left if ref.id not in known}.values())
    observer.checking(0, len(refs))
    with closing(workers.check(refs)) as verdicts:
        for done, (ref, reason) in enumerate(verdicts, start=1):
            if reason is not None:
                reasons[ref.id] = reason
            observer.checking(done, len(refs))
    rows = [
        manifest.row(failed_score(task.key, reasons[task.ref.id], Outcome.UNUSABLE))
        for task in left
        if task.ref.id in reasons
    ]
    with folder.rows.open("ab", buffering=0) as file:
        for row in rows:
            _write_files(folder, EpisodeResult(row))
            append_row(file, row)
    observer.checked(rows, unusable_scenarios((*kept, *rows)))
    return [task for task in left if task.ref.id not in reasons]


def _drive(folder: RunFolder, manifest: RunManifest, results: Results, observer: Observer) -> None:
    """Has episodes driven and writes what they give as they end."""
    with folder.rows.open("ab", buffering=0) as file, closing(results):
        for _, result in results:
            _write_files(folder, result)
            row = manifest.row(result.row)
            append_row(file, row)
            observer.add(row)


def _write_files(folder: RunFolder, result: EpisodeResult) -> None:
    recording = folder.recording(result.row.key)
    if result.recording is not None:
        write_bytes(recording, result.recording)
    else:  # Nor is there one of an attempt whose row was not written or taken out.
        recording.unlink(missing_ok=True)
    traceback = folder.traceback(result.row.key)
    if result.traceback is not None:
        write_text(traceback, result.traceback)
    else:
        traceback.unlink(missing_ok=True)


@contextmanager
def _held(folder: RunFolder) -> Iterator[None]:
    """Keeps a second runner out of the folder; the system releases it when the process ends."""
    with exclusive(folder.lock) as alone:
        if not alone:
            raise RunError(
                f"another process is driving the run in {folder.path}; "
                "wait for it, or choose another --out"
            )
        yield


def _manifest(config: RunConfig, refs: Sequence[ScenarioRef]) -> RunManifest:
    """Builds the plug-ins once, to check them, and describes the run."""
    loop = config.chosen_loop
    planner = choose_planner(config.planner, config.planner_options, loop)
    predictor = choose_predictor(config.predictor, config.predictor_options, loop)
    traffic = choose_plugin(PluginKind.TRAFFIC, config.traffic, config.traffic_options)
    if config.ranked and issubclass(predictor.plugin, OraclePredictor):
        raise RunError(
            f"predictor {predictor.plugin.name} is shown the future, so a ranked run refuses it; "
            "--unranked allows it and marks the results (in a sweep, ranked: false)"
        )
    _, built_predictor, _ = make_plugins(config)
    environment = describe_environment()
    return RunManifest(
        config=config.settings,
        planner=planner.plugin.name,
        predictor=predictor.plugin.name,
        traffic=traffic.plugin.name,
        loop=loop_name(loop),
        reproducible=not loop.real_time and not _watches_the_clock(planner.settings),
        settings={
            "planner": record(planner),
            "predictor": record(predictor),
            "traffic": record(traffic),
            "loop": record_loop(loop),
        },
        scenarios=tuple(ref.id for ref in refs),
        digests={
            "planner file": content_digest(source_files(planner)),
            "predictor file": content_digest(source_files(predictor)),
            "traffic file": content_digest(source_files(traffic)),
            "weights": content_digest(built_predictor.weight_files()),
            SCENARIO_FILES: content_digest(scenario_files(traffic.plugin, refs)),
        },
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        versions={**environment.versions, **traffic.plugin.versions()},
        git_revision=environment.git_revision,
        machine=environment.machine,
    )


def _watches_the_clock(settings: object) -> bool:
    """Whether plans depend on how long they take."""
    return isinstance(settings, DeadlineSettings) and settings.deadline is not None


def _open_folder(folder: RunFolder, manifest: RunManifest, refs: Sequence[ScenarioRef]) -> None:
    """Makes the run folder, or checks that the one that is there holds the same run."""
    for part in (folder.path / name for name in _PARTS):
        if part.is_symlink():
            raise RunError(
                f"{part} is a link, and a run writes into its own folder only; "
                "remove it or choose another --out"
            )
    if folder.manifest.exists():
        _check_same(folder, read_manifest(folder), manifest, refs)
        return
    remove_half_written(folder.path, folder.manifest.name)
    if folder.path.is_dir() and any(folder.path.iterdir()):
        raise RunError(f"{folder.path} is not empty and holds no run; choose another --out")
    write_manifest(folder, manifest)


def _extended(folder: RunFolder, manifest: RunManifest, refs: Sequence[ScenarioRef]) -> RunManifest:
    """Adds to the run in a folder the scenarios and futures that it does not hold yet.

    Returns:
        What its ``run.json`` holds then.
    """
    old = read_manifest(folder)  # Anew: until the folder was held, somebody may have extended it.
    _check_same(folder, old, manifest, refs)
    if old.episodes == manifest.episodes:
        return old
    chosen = {name: getattr(manifest.config, name) for name in SELECTION}
    grown = replace(
        old,
        config=replace(old.config, **chosen),
        scenarios=manifest.scenarios,
        digests=manifest.digests,
    )
    write_manifest(folder, grown)
    return grown


def _check_same(
    folder: RunFolder, old: RunManifest, manifest: RunManifest, refs: Sequence[ScenarioRef]
) -> None:
    """Refuses a run that differs from the one in the folder, but for new scenarios and futures.

    Raises:
        RunError: It does.
    """
    files = {SCENARIO_FILES: old.digests.get(SCENARIO_FILES, "")}  # Looked at when all are there.
    there = _identity(old)
    here = _identity(replace(manifest, digests={**manifest.digests, **files}))
    odd = next((key for key in here if there.get(key) != here[key]), None)
    config = manifest.config
    traffic = choose_plugin(PluginKind.TRAFFIC, config.traffic, config.traffic_options).plugin
    if odd is None:
        found = traffic.versions().items()
        odd = next((f"version of {key}" for key, v in found if old.versions.get(key) != v), None)
    by_id = {ref.id: ref for ref in refs}
    lost = [name for name in old.scenarios if name not in by_id]
    if odd is None and lost:
        raise RunError(
            f"{folder.path} holds a run of {len(old.scenarios)} scenarios, of which this one "
            f"leaves out {len(lost)} ({lost[0]}{', ...' if len(lost) > 1 else ''}): a run may grow "
            "but not shrink; nothing was changed. Choose another --out, or name all of them"
        )
    futures = manifest.config.futures
    if odd is None and futures < old.config.futures:
        raise RunError(
            f"{folder.path} holds a run of {old.config.futures} futures, and this one has "
            f"{futures}: a run may grow but not shrink; nothing was changed. Choose another --out"
        )
    if old.scenarios == manifest.scenarios:
        held = manifest.digests[SCENARIO_FILES]
    else:
        driven = (by_id[name] for name in old.scenarios if name in by_id)
        held = content_digest(scenario_files(traffic, driven))
    if odd is None and held not in files.values():
        odd = _CONTENT
    if odd is not None:
        again = "put the old files back" if odd == _CONTENT else "give the same arguments"
        raise RunError(
            f"{folder.path} holds a run with another {odd}; nothing was changed. "
            f"Choose another --out, or {again} to resume"
        )


def scenario_files(traffic: type[Traffic], refs: Iterable[ScenarioRef]) -> Iterator[Path]:
    """Names the files of scenarios.

    Args:
        traffic: The traffic that is driven.
        refs: The scenarios.

    Returns:
        Each scenario's file, that of its futures, and those that the traffic reads besides.
    """
    for ref in refs:
        yield ref.path
        if (futures := futures_file(ref.path)) is not None:
            yield futures
        yield from traffic.reads(ref.path)


def _identity(manifest: RunManifest) -> dict[str, Any]:
    """What must agree for two invocations to be one run."""
    return {
        **{key: value for key, value in vars(manifest.config).items() if key not in FREE},
        "planner version": manifest.planner,
        "predictor version": manifest.predictor,
        "traffic version": manifest.traffic,
        **{f"value of {name}": value for name, value in _leaves(manifest.settings)},
        "dosplan version": manifest.versions.get("dosplan"),
        _CONTENT: manifest.digests,
    }


def _leaves(settings: Mapping[str, Any], name: str = "") -> Iterator[tuple[str, Any]]:
    """The values in nested mappings, by dotted names."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{name}{key}.")
        else:
            yield f"{name}{key}", value
