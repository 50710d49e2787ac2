"""How batches scale: measured parts, and what follows from them for a million scenarios.

What is measured is measured through the public ``run`` in a temporary folder. A projection is
the measured cost of a part times how often it occurs, nothing else; a machine that is busy with
other work while this runs gives figures of a busy machine.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import psutil

from dosplan.results.folder import RunFolder
from dosplan.results.recording import load_cycle_ms
from dosplan.results.rows import append_row, read_rows
from dosplan.running.job import Session, Task
from dosplan.running.process import EpisodeProcess
from dosplan.running.progress import ProgressObserver
from dosplan.running.run import RunConfig, RunError, run
from dosplan.scenario import find_scenarios
from dosplan.system.files import write_bytes
from dosplan.system.provenance import content_digest, describe_environment
from dosplan.system.workers import WORKER_ENVIRONMENT, environment
from dosplan.types import Arm, EpisodeKey, Outcome

MILLION: Final = 1_000_000
SUITE: Final = "suite-1"
"""What is driven: always the same, so that the figures of versions can be compared."""
_WRITES: Final = 200
_SETTLED: Final = 0.1  # Share of a run after which the runner's memory is compared.
_TINY: Final = """\
<commonRoad commonRoadVersion="2020a" benchmarkID="{name}" date="2024-01-01" author="dosplan"
 affiliation="" source="" timeStepSize="0.1">
 <lanelet id="1">
  <leftBound><point><x>0</x><y>2</y></point><point><x>90</x><y>2</y></point></leftBound>
  <rightBound><point><x>0</x><y>-2</y></point><point><x>90</x><y>-2</y></point></rightBound>
  <laneletType>urban</laneletType>
 </lanelet>
 <planningProblem id="2">
  <initialState>
   <position><point><x>10</x><y>0</y></point></position>
   <orientation><exact>0</exact></orientation><time><exact>0</exact></time>
   <velocity><exact>5</exact></velocity><yawRate><exact>0</exact></yawRate>
   <slipAngle><exact>0</exact></slipAngle>
  </initialState>
  <goalState><time><intervalStart>1</intervalStart><intervalEnd>2</intervalEnd></time></goalState>
 </planningProblem>
</commonRoad>
"""


@dataclass
class _Watch:
    """Takes the time and the memory of this process and of its workers as a run goes on."""

    runner: list[int] = field(default_factory=list)
    workers: list[int] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)
    listed: float = 0.0
    first: float = 0.0

    def __call__(self, done: int, total: int) -> None:
        now = time.perf_counter() - self.started
        self.listed = self.listed or now
        if done == 1:
            self.first = now
        if done % max(total // 100, 1) == 0:
            me = psutil.Process()
            self.runner.append(me.memory_info().rss)
            # Small ones are Python's own helper processes.
            sizes = [child.memory_info().rss for child in me.children()]
            self.workers.append(max(sizes, default=0))


def measure_scale(
    planner: str, predictor: str, scenarios: int, episodes: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Measures, and projects a million scenarios in both arms.

    Args:
        planner: Planner, as ``dosplan.plugins.registry`` finds it.
        predictor: Predictor, likewise.
        scenarios: Number of scenarios of ``SUITE`` to drive with one and with two workers.
        episodes: Number of tiny episodes that show what an episode costs the runner.
        tell: Called with the name of the next measurement.

    Returns:
        Figures: ``drive`` for each number of workers, ``start``, ``tiny``, ``parts`` and
        ``million``.
    """
    with TemporaryDirectory() as name:
        base = RunConfig(
            out=Path(name) / "unused", source=SUITE, planner=planner, predictor=predictor
        )
        tell(f"{episodes} tiny episodes")  # First, while this process is as small as a runner is.
        source = write_tiny(Path(name) / "tiny", episodes // 2)
        tiny_config = replace(base, planner="cruise", predictor="none", workers=2)
        tiny = _measure_run(
            replace(tiny_config, out=Path(name) / "many", source=str(source)), 2 * (episodes // 2)
        )
        drives = {}
        for workers in (1, 2):
            tell(f"{scenarios} scenarios of {SUITE} in both arms, workers: {workers}")
            config = replace(base, out=Path(name) / f"{workers}", limit=scenarios, workers=workers)
            drives[str(workers)] = _measure_run(config, 2 * scenarios)
        tell("start of a worker, listing and writing")
        start = _measure_start(base)
        parts = _measure_parts(base, Path(name))
    return {
        "planner": planner,
        "predictor": predictor,
        "start": start,
        "drive": drives,
        "parts": parts,
        "tiny": tiny,
        "million": _project(drives["1"], tiny, parts),
        "environment": asdict(describe_environment()),
    }


def _measure_start(config: RunConfig) -> dict[str, float]:
    """What the first episode of a worker costs more than the second: imports and plug-ins."""
    ref = find_scenarios(SUITE)[0]
    seconds = []
    process = EpisodeProcess(config)
    try:
        with environment(WORKER_ENVIRONMENT):
            for _ in range(2):
                started = time.perf_counter()
                process.drive(Task(ref, Arm.WITHOUT_DOS))
                seconds.append(time.perf_counter() - started)
    finally:
        process.close()
    return {"worker_seconds": max(seconds[0] - seconds[1], 0.0)}


def _measure_run(config: RunConfig, episodes: int) -> dict[str, float]:
    watch = _Watch()
    folder = run(config, ProgressObserver(watch))
    total = time.perf_counter() - watch.started
    failed = [row for row in read_rows(folder.rows) if row.outcome is Outcome.PLANNER_FAILURE]
    if failed:
        raise RunError(
            f"{len(failed)} of {episodes} episodes failed, whose times say nothing of a batch: "
            f"{failed[0].error} [{failed[0].key.title}]"
        )
    steady = watch.runner[int(_SETTLED * len(watch.runner)) :]
    driving = total - watch.first
    return {
        "episodes": episodes,
        "seconds": total,
        "seconds_to_first_row": watch.first - watch.listed,
        "episodes_per_second": (episodes - 1) / driving,
        "worker_megabytes": max(watch.workers) / 1e6,
        "runner_megabytes": watch.runner[-1] / 1e6,
        "runner_bytes_per_episode": (steady[-1] - steady[0]) / (episodes * (1.0 - _SETTLED)),
        "row_bytes_in_memory": _row_bytes(folder),
        "folder_bytes_per_episode": _size(folder.path) / episodes,
    }


def _measure_parts(config: RunConfig, place: Path) -> dict[str, float]:
    """What the runner does for each scenario before, and for each episode while it drives."""
    started = time.perf_counter()
    refs = find_scenarios(Path(find_scenarios(SUITE)[0].path).parent)
    listed = time.perf_counter()
    content_digest(ref.path for ref in refs)
    digested = time.perf_counter()
    result = Session(config).drive(Task(refs[0], Arm.WITHOUT_DOS))
    folder = RunFolder(place / "written")
    folder.path.mkdir()
    seconds = []
    with folder.rows.open("ab", buffering=0) as file:
        for i in range(_WRITES):
            began = time.perf_counter()
            write_bytes(
                folder.recording(EpisodeKey(f"{i}", Arm.WITHOUT_DOS)), result.recording or b""
            )
            append_row(file, result.row)
            seconds.append(time.perf_counter() - began)
    read = time.perf_counter()
    for i in range(_WRITES):
        load_cycle_ms(folder.recording(EpisodeKey(f"{i}", Arm.WITHOUT_DOS)), result.row.steps)
    summarised = time.perf_counter() - read
    return {
        "list_ms_per_scenario": 1e3 * (listed - started) / len(refs),
        "digest_ms_per_scenario": 1e3 * (digested - listed) / len(refs),
        "write_ms_per_episode": 1e3 * float(np.median(seconds)),
        "summary_ms_per_episode": 1e3 * summarised / _WRITES,
    }


def _project(
    drive: dict[str, float], tiny: dict[str, float], parts: dict[str, float]
) -> dict[str, float]:
    """A million scenarios in both arms, from the measured parts."""
    episodes = len(Arm) * MILLION
    before = parts["list_ms_per_scenario"] + parts["digest_ms_per_scenario"]
    rate = drive["episodes_per_second"]
    return {
        "worker_hours": episodes / rate / 3600.0,
        "days_with_1000_workers": episodes / rate / 1000.0 / 86400.0,
        "hours_before_the_first_episode": MILLION * before / 1e3 / 3600.0,
        "hours_of_writing_alongside": episodes * parts["write_ms_per_episode"] / 1e3 / 3600.0,
        "workers_that_one_runner_can_serve": 1e3 / parts["write_ms_per_episode"] / rate,
        "hours_of_summarising": episodes * parts["summary_ms_per_episode"] / 1e3 / 3600.0,
        "runner_gigabytes_while_driving": episodes * tiny["runner_bytes_per_episode"] / 1e9,
        "runner_gigabytes_at_the_end": episodes * tiny["row_bytes_in_memory"] / 1e9,
        "folder_gigabytes": episodes * drive["folder_bytes_per_episode"] / 1e9,
    }


def write_tiny(folder: Path, count: int) -> Path:
    """Writes scenarios of one step on an empty road."""
    folder.mkdir()
    for i in range(count):
        name = f"ZAM_Tiny-{i}_1_T-1"
        (folder / f"{name}.xml").write_text(_TINY.format(name=name), encoding="utf-8")
    return folder


def _row_bytes(folder: RunFolder) -> float:
    """What a row takes in memory; the summary holds them all."""
    tracemalloc.start()
    rows = read_rows(folder.rows)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return held / len(rows)


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
