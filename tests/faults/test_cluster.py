"""A Dask cluster gives the rows of one machine, and survives what clusters go through."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed", reason="Dask is an optional dependency")

from distributed.utils_comm import gather_from_workers as fetch

from dosplan import __version__
from dosplan.cli.main import main
from dosplan.running import dask_cluster as cluster
from dosplan.running.job import Task
from dosplan.running.progress import ProgressObserver
from dosplan.running.run import RunError, run
from dosplan.running.sweep import one_executor
from dosplan.scenario import ScenarioError, find_scenarios, load_scenario
from dosplan.types import Arm
from tests.support.runs import (
    command,
    configured,
    rows_in,
    run_here,
    start,
    until,
    untimed,
    write_faults,
    write_scenes,
)

SCENARIOS = 8


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"), SCENARIOS)


@pytest.fixture(scope="module")
def undisturbed(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    return untimed(run_here(configured(tmp_path_factory.mktemp("undisturbed") / "run", scenes)))


@dataclass
class Cluster:
    """A scheduler and its workers, each a process that can be killed."""

    folder: Path
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.file = self.folder / "scheduler.json"
        options = ["--port", "0", "--scheduler-file", str(self.file)]
        self.scheduler = self._start("dask_scheduler", *options)
        until(self.file.exists, "the scheduler")
        self.address = f"tcp://127.0.0.1:{self._port()}"

    def _port(self) -> str:
        def read() -> str:
            try:
                return str(json.loads(self.file.read_text())["address"])
            except ValueError:  # Half written.
                return ""

        until(read, "the scheduler's address")
        return read().rpartition(":")[2]

    def grow(self, count: int) -> None:
        options = ["--nthreads", "1", "--no-nanny"]
        new = [self._start("dask_worker", self.address, *options) for _ in range(count)]
        self.workers.extend(new)

    def _start(self, program: str, *options: str) -> subprocess.Popen[bytes]:
        common = ["--host", "127.0.0.1", "--no-dashboard"]
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{program}", *options, *common],
            cwd=self.folder,  # Not the runner's: relative paths must not be taken for granted.
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def end(self) -> None:
        for process in [*self.workers, self.scheduler]:
            process.kill()
            process.wait()


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Cluster]:
    folder = tmp_path / "machines"
    folder.mkdir()
    made = Cluster(folder)
    yield made
    made.end()


@pytest.mark.slow
def test_a_local_cluster_isolates_as_one_machine_does(tmp_path: Path) -> None:
    kept = ("fine", "raise", "exit-3", "segv", "eat")
    scenes = write_faults(tmp_path / "scenes", kept)
    options: dict[str, Any] = {"memory_limit": 700, "arms": (Arm.WITH_DOS,)}
    here = configured(tmp_path / "here", scenes, "FaultPlanner", workers=2, **options)
    there = configured(tmp_path / "there", scenes, "FaultPlanner", cluster="local:2", **options)
    rows = untimed(run(there))
    assert rows == untimed(run(here))
    assert [row["error"] is None for row in rows] == [name == "fine" for name in kept]


@pytest.mark.slow
def test_the_death_of_half_of_the_workers_loses_nothing(
    machines: Cluster, scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    machines.grow(4)
    out = tmp_path / "run"
    process = start(command(out, scenes, "SlowPlanner", "--cluster", machines.address))
    until(lambda: rows_in(out) >= 1, "a row")
    machines.workers[0].kill()
    until(lambda: rows_in(out) >= 4, "more rows")
    machines.workers[1].kill()
    _, complaint = process.communicate(timeout=300.0)
    assert process.returncode == 0, complaint
    assert untimed(out) == undisturbed
    assert [x for x in complaint.splitlines() if "episodes" not in x and x[:2] != "  "] == []


def test_scenarios_whose_machines_die_are_not_called_unusable(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def died(future: Any) -> tuple[bool, Any]:
        await future
        return True, None

    monkeypatch.setattr(cluster, "_result", died)
    config = configured(tmp_path / "run", scenes, cluster="local:1")
    with pytest.raises(RunError, match="the same command resumes"):
        run(config)
    monkeypatch.undo()
    assert all(row["error"] is None for row in untimed(run(config)))


def test_nobody_waits_for_a_result_that_its_dead_worker_holds(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scheduler of a local cluster is in this process: here it gets the first one last."""
    others_are_there = asyncio.Event()
    fetched = []

    async def gather_from_workers(*arguments: Any, **options: Any) -> Any:
        fetched.append(arguments)
        if len(fetched) == 1:
            with suppress(TimeoutError):
                await asyncio.wait_for(others_are_there.wait(), 60.0)
        return await fetch(*arguments, **options)

    tasks = [Task(ref, Arm.WITH_DOS) for ref in find_scenarios(scenes)[:3]]
    config = configured(tmp_path, scenes, "SlowPlanner")
    with cluster.kept_cluster("local:1") as address:
        monkeypatch.setattr("distributed.scheduler.gather_from_workers", gather_from_workers)
        with cluster.DaskExecutor(address).start(config) as workers:
            results = workers.drive(tasks)
            others = [next(results)[0] for _ in tasks[1:]]
            workers.client.loop.add_callback(others_are_there.set)  # type: ignore[attr-defined]
            last = [task for task, _ in results]
    assert others == tasks[1:]
    assert last == tasks[:1]


def test_the_logs_of_a_local_scheduler_are_short(tmp_path: Path, scenes: Path) -> None:
    def longest(dask_scheduler: Any) -> int:
        return int(dask_scheduler.transition_log.maxlen)

    executor = cluster.DaskExecutor("local:1")
    with executor.start(configured(tmp_path, scenes, "SlowPlanner")) as workers:
        assert workers.client.run_on_scheduler(longest) == 100  # type: ignore[attr-defined]


@pytest.mark.slow
def test_a_scheduler_that_goes_away_leaves_a_folder_that_resumes(
    machines: Cluster, scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    machines.grow(2)
    out = tmp_path / "run"
    process = start(command(out, scenes, "SlowPlanner", "--cluster", machines.address))
    until(lambda: rows_in(out) >= 2, "two rows")
    machines.scheduler.kill()
    _, complaint = process.communicate(timeout=300.0)
    assert process.returncode == 2
    assert complaint.splitlines()[-1] == (
        f"dosplan: error: lost the Dask scheduler at {machines.address}; what was driven is kept, "
        "and the same command resumes when a scheduler is there"
    )
    assert "Traceback" not in complaint
    kept = rows_in(out)
    assert 2 <= kept < len(undisturbed)
    driven: list[int] = []
    counted = ProgressObserver(lambda done, total: driven.append(done))
    folder = run(configured(out, scenes, "SlowPlanner"), counted)
    assert driven[0] == kept
    assert untimed(folder) == undisturbed


def test_ctrl_c_stops_a_local_cluster(scenes: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    arguments = command(out, scenes, "SlowPlanner", "--cluster", "local:2")
    begun = time.monotonic()
    process = start(arguments, start_new_session=True)
    until(lambda: rows_in(out) >= 1, "a row")
    asked = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    _, complaint = process.communicate(timeout=120.0)  # Until the last process has ended.
    assert time.monotonic() - asked < 3.0 * (asked - begun)  # A busy machine draws out both.
    assert process.returncode == 130
    # Python itself may say something as its last process ends.
    interrupted = "dosplan: interrupted; the same command with"
    assert sum(line.startswith(interrupted) for line in complaint.splitlines()) == 1
    assert "Traceback" not in complaint


def test_scenarios_behind_a_url_are_read_where_they_are_driven(
    scenes: Path, tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    source = f"file://{scenes}"
    config = configured(tmp_path / "run", Path("unused"), cluster="local:1", limit=1)
    assert untimed(run(replace(config, source=source))) == undisturbed[:2]


def test_a_source_may_be_a_url(scenes: Path) -> None:
    from upath import UPath

    place = UPath("memory://recordings/deep")
    place.mkdir(parents=True)
    for file in sorted(scenes.iterdir())[:2]:
        (place / file.name).write_bytes(file.read_bytes())
    refs = find_scenarios("memory://recordings")
    assert [ref.id for ref in refs] == [ref.id for ref in find_scenarios(scenes)[:2]]
    assert load_scenario(refs[0]).id == refs[0].id
    with pytest.raises(ScenarioError, match=r"memory://.*nowhere: does not exist"):
        find_scenarios("memory://nowhere")
    with pytest.raises(ScenarioError, match=r"cannot be reached .*dosplan\[cluster\]"):
        find_scenarios("nosuch://place")


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("local:0", "local: takes a number of workers"),
        ("local:many", "local: takes a number of workers"),
        ("tcp://127.0.0.1:1", "no Dask scheduler answers at tcp://127.0.0.1:1"),
        ("nonsense", "it takes the address of a scheduler"),
        ("http://host", "it takes the address of a scheduler"),
    ],
)
def test_an_address_without_a_cluster_is_one_line(
    scenes: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    address: str,
    message: str,
) -> None:
    monkeypatch.setattr(cluster, "_CONNECT_SECONDS", 1.0)
    arguments = command(tmp_path / "run", scenes, "CoastPlanner", "--cluster", address)
    assert main(arguments[3:]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("dosplan: error: ")
    assert message in line


def test_a_worker_that_would_give_other_rows_or_cannot_isolate_is_refused(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ref, config = find_scenarios(scenes)[0], configured(tmp_path, scenes)
    with pytest.raises(RunError, match=r"has dosplan .* and the runner 0\.0"):
        cluster._drive(Task(ref, Arm.WITH_DOS), config, "0.0")
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    with pytest.raises(RunError, match=r"are daemons.*--no-nanny"):
        cluster._drive(Task(ref, Arm.WITH_DOS), config, __version__)


@pytest.mark.slow
def test_one_cluster_serves_the_runs_of_a_sweep_one_after_another(
    scenes: Path, undisturbed: list[dict[str, Any]], tmp_path: Path
) -> None:
    started = []
    with one_executor(1, "local:2") as executor:
        for name in ("a", "b", "c"):
            run(configured(tmp_path / name, scenes, cluster="local:2"), executor=executor)
            assert isinstance(executor, cluster.DaskExecutor)
            started.append(executor.address)
            assert untimed(tmp_path / name) == undisturbed
    assert len(set(started)) == 1
    assert started[0].startswith("tcp://127.0.0.1:")
