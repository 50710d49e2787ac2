"""What a sweep of many episodes takes of a Dask cluster whose workers come and go.

    python results/batch/cluster.py --episodes 10000

It starts a scheduler and a worker on this machine and drives a sweep of episodes of one step
(``cruise``, no prediction) with the command ``dosplan sweep``. Each time a part of the episodes is
done, a worker joins and the oldest one is killed with whatever it is driving. Once a second it
looks at the resident memory and the processor time of runner, scheduler and workers, and in the
end at the rows: each episode must have one, once. With ``--minutes`` it is cut off, and the figures
are of the episodes until then. It writes ``cluster.json`` beside this file, with
what follows for a million episodes from these parts and from those of ``scale.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import psutil

from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_rows
from dosplan.running.scaling import MILLION, write_tiny
from dosplan.system.files import read_json, write_json
from dosplan.system.provenance import describe_environment
from dosplan.types import Arm, FloatArray, Outcome

HERE: Final = Path(__file__).parent
RUNS: Final = 5
"""Runs of the sweep, which differ in their seed."""
CHANGES: Final = 10
"""How often a worker joins and the oldest one is killed."""
_LOOK_EVERY: Final = 1.0  # s
_SETTLED: Final = 0.4
"""Share of the episodes after which memory is compared: the runner has read all code by then, as
its first run is summarised, and Dask's logs of the scheduler are full."""
_SWEEP: Final = """\
base: {{source: {source}, planner: cruise, predictor: none, arms: [with_dos, without_dos]}}
axes:
  seed: [{seeds}]
"""


@dataclass
class Watched:
    """A process, with those that it has started.

    Attributes:
        process: The process.
        killed: Whether it was killed while the sweep went on.
        samples: Each time it was looked at: finished episodes; resident memory, bytes; processor
            time, s.
    """

    process: subprocess.Popen[bytes]
    killed: bool = False
    samples: list[tuple[int, int, float]] = field(default_factory=list)

    def look(self, done: int) -> None:
        """Takes a sample where the process is there.

        Args:
            done: Number of finished episodes.
        """
        memory, processor = 0, 0.0
        try:
            own = psutil.Process(self.process.pid)
            for one in (own, *own.children(recursive=True)):
                memory += one.memory_info().rss
                times = one.cpu_times()
                processor += times.user + times.system
        except psutil.NoSuchProcess:
            return
        if own.is_running() and own.status() != psutil.STATUS_ZOMBIE:
            self.samples.append((done, memory, processor))


@dataclass
class Cluster:
    """A scheduler and its workers, each a process of its own.

    Attributes:
        folder: Where they run.
        workers: The workers, also those that are gone.
    """

    folder: Path
    workers: list[Watched] = field(default_factory=list)

    def __post_init__(self) -> None:
        file = self.folder / "scheduler.json"
        self.scheduler = self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))
        while not file.exists():
            time.sleep(0.1)
        time.sleep(1.0)  # Until it is written.
        self.address: str = json.loads(file.read_text())["address"]

    def grow(self) -> None:
        """Has a worker join."""
        options = ("--nthreads", "1", "--no-nanny", "--memory-limit", "0")
        self.workers.append(self._start("dask_worker", self.address, *options))

    def shrink(self) -> None:
        """Kills the worker that has been there the longest."""
        oldest = next(worker for worker in self.workers if not worker.killed)
        oldest.process.kill()
        oldest.process.wait()
        oldest.killed = True

    def end(self) -> None:
        """Kills all that is left."""
        for one in (self.scheduler, *self.workers):
            one.process.kill()
            one.process.wait()

    def _start(self, program: str, *options: str) -> Watched:
        command = [sys.executable, "-m", f"distributed.cli.{program}", *options]
        return _started([*command, "--host", "127.0.0.1", "--no-dashboard"], self.folder)


def _started(command: Sequence[str], folder: Path) -> Watched:
    variables = {
        **os.environ,
        "OMP_NUM_THREADS": "1",
        "DOSPLAN_CACHE": str(folder / "cache"),
        "DASK_DISTRIBUTED__ADMIN__LOG_LENGTH": "100",  # As docs/clusters.md has it.
        "DASK_DISTRIBUTED__ADMIN__LOW_LEVEL_LOG_LENGTH": "100",
    }
    with (folder / "log.txt").open("ab") as log:
        process = subprocess.Popen(  # noqa: S603 - fixed arguments
            command, cwd=folder, stdout=log, stderr=log, env=variables
        )
    return Watched(process)


class _Rows:
    """Counts the rows of runs as they are written; only what is new is read."""

    def __init__(self, runs: Sequence[RunFolder]) -> None:
        self._runs = runs
        self._read: dict[Path, tuple[int, int, int]] = {}

    def count(self) -> int:
        for path in (run.rows for run in self._runs):
            if not path.exists():
                continue
            with path.open("rb") as file:
                found = os.fstat(file.fileno())
                number, size, lines = self._read.get(path, (0, 0, 0))
                if found.st_ino != number:  # It was put in order and written anew.
                    size = lines = 0
                if found.st_size > size:
                    file.seek(size)
                    new = file.read()
                    size, lines = size + len(new), lines + new.count(b"\n")
                self._read[path] = (found.st_ino, size, lines)
        return sum(lines for *_, lines in self._read.values())


def measure(episodes: int, place: Path, minutes: float) -> dict[str, Any]:
    """Drives the sweep and measures.

    Args:
        episodes: How many; a multiple of those that one scenario has in all runs.
        place: A folder for everything that is written.
        minutes: After how many the runner is killed; it leaves whole rows.

    Returns:
        Figures.
    """
    scenes = write_tiny(place / "scenes", episodes // (RUNS * len(Arm)))
    sweep, out = place / "many.yaml", place / "out"
    sweep.write_text(_SWEEP.format(source=scenes, seeds=", ".join(map(str, range(RUNS)))))
    runs = [RunFolder(out / f"seed={seed}") for seed in range(RUNS)]
    rows, changes, waits = _Rows(runs), [], []
    cluster = Cluster(place)
    try:
        cluster.grow()
        options = ["--cluster", cluster.address, "--out", str(out), "--quiet"]
        began = time.monotonic()
        runner = _started([sys.executable, "-m", "dosplan", "sweep", str(sweep), *options], place)
        marks = [episodes * part // (CHANGES + 1) for part in range(1, CHANGES + 1)]
        done, last = 0, began
        while runner.process.poll() is None:
            time.sleep(_LOOK_EVERY)
            now, before, done = time.monotonic(), done, rows.count()
            if done > before:
                waits.append(now - last)
                last = now
            for watched in (runner, cluster.scheduler, *cluster.workers):
                watched.look(done)
            if marks and done >= marks[0]:
                marks.pop(0)
                cluster.grow()
                cluster.shrink()
                changes.append((done, round(now - began, 1)))
            if now - began > 60.0 * minutes:
                runner.process.kill()
                runner.process.wait()
                runner.killed = True
        seconds = time.monotonic() - began
    finally:
        cluster.end()
    if runner.process.returncode != 0 and not runner.killed:
        raise SystemExit((place / "log.txt").read_text()[-3000:])
    found = [row for run in runs for row in read_rows(run.rows)]
    asked, episodes = episodes, len(found)
    driving = [np.array(worker.samples) for worker in cluster.workers if worker.samples]
    return {
        "episodes_asked_for": asked,
        "rows": episodes,
        "episodes_with_a_row": sum(len({row.key for row in read_rows(run.rows)}) for run in runs),
        "rows_by_outcome": {o: sum(row.outcome is o for row in found) for o in Outcome},
        "seconds": seconds,
        "longest_wait_for_a_row_s": max(waits[1:]),
        "runner": _figures(runner, episodes),
        "scheduler": _figures(cluster.scheduler, episodes),
        "workers": {
            "started": len(cluster.workers),
            "killed": sum(worker.killed for worker in cluster.workers),
            "most_megabytes": [round(float(life[:, 1].max()) / 1e6, 1) for life in driving],
            "processor_ms_per_episode": 1e3 * sum(float(x[-1, 2]) for x in driving) / episodes,
        },
        "changes": [{"episodes": count, "second": second} for count, second in changes],
        "folder_bytes_per_episode": _size(out) / episodes,
    }


def _figures(watched: Watched, episodes: int) -> dict[str, Any]:
    """Memory and processor time of a process, by the number of finished episodes."""
    done, memory, processor = np.array(watched.samples, dtype=np.float64).T
    steady = (done >= _SETTLED * episodes) & (done < episodes)
    return {
        "processor_s_before_the_first_row": float(processor[done == 0.0].max()),
        "processor_ms_per_episode": 1e3 * _slope(done[steady], processor[steady]),
        "bytes_per_episode": _slope(done[steady], memory[steady]),
        "most_megabytes": float(memory.max()) / 1e6,
        "megabytes": [
            {"episodes": int(done[k]), "megabytes": round(float(memory[k]) / 1e6, 1)}
            for k in np.searchsorted(done, np.linspace(0.0, done[-1], 21))
        ],
    }


def _slope(x: FloatArray, y: FloatArray) -> float:
    return float(np.polyfit(x, y, 1)[0])


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def project(found: Mapping[str, Any], scale: Mapping[str, Any]) -> dict[str, float]:
    """A million episodes of ``mpc`` in one sweep: the cost of each part times how often it occurs.

    Args:
        found: What ``measure`` returns.
        scale: Content of ``scale.json``.

    Returns:
        Figures.
    """
    rate = scale["drive"]["1"]["episodes_per_second"]
    busiest = max(found[name]["processor_ms_per_episode"] for name in ("runner", "scheduler"))
    runner = found["runner"]
    return {
        "worker_hours": MILLION / rate / 3600.0,
        "runner_processor_hours": MILLION * runner["processor_ms_per_episode"] / 3.6e6,
        "scheduler_processor_hours": MILLION
        * found["scheduler"]["processor_ms_per_episode"]
        / 3.6e6,
        "workers_that_one_runner_can_serve": 1e3 / busiest / rate,
        "least_hours": MILLION * busiest / 3.6e6,
        "runner_gigabytes": runner["most_megabytes"] / 1e3
        + MILLION * max(runner["bytes_per_episode"], 0.0) / 1e9,
        "scheduler_gigabytes": found["scheduler"]["most_megabytes"] / 1e3
        + MILLION * max(found["scheduler"]["bytes_per_episode"], 0.0) / 1e9,
        "rows_gigabytes_for_the_table": MILLION * scale["tiny"]["row_bytes_in_memory"] / 1e9,
        "folder_gigabytes": MILLION * scale["drive"]["1"]["folder_bytes_per_episode"] / 1e9,
    }


def main() -> None:
    """Measures, and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=10_000, metavar="N")
    parser.add_argument("--minutes", type=float, default=np.inf, metavar="M")
    parser.add_argument("--json", type=Path, default=HERE / "cluster.json", metavar="FILE")
    options = parser.parse_args()
    with TemporaryDirectory() as place:
        found = measure(options.episodes, Path(place), options.minutes)
    found["million"] = project(found, read_json(HERE / "scale.json"))
    write_json(options.json, {**found, "environment": asdict(describe_environment())})


if __name__ == "__main__":
    main()
