"""Ctrl-C and SIGTERM stop a run at once, whatever its workers are doing."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from tests.support.plugins import BEGUN
from tests.support.runs import alive, command, rows_in, start, until, write_faults


@dataclass(frozen=True)
class Hanging:
    """A run of which one worker waits and one hangs.

    Attributes:
        process: The runner.
        workers: The processes that it started.
        started: Seconds that it took until both workers drove.
    """

    process: subprocess.Popen[str]
    workers: list[int]
    started: float

    def has_left_nobody(self) -> bool:
        return not any(alive(pid) for pid in self.workers)


def _hanging(tmp_path: Path, fault: str) -> Hanging:
    scenes = write_faults(tmp_path / "scenes", ("fine", fault))
    out, begun = tmp_path / "run", tmp_path / "begun"
    begun.mkdir()
    arguments = command(out, scenes, "FaultPlanner", "--workers", "2", "--with-dos")
    asked = time.monotonic()
    process = start(arguments, start_new_session=True, env={**os.environ, BEGUN: str(begun)})
    until(lambda: rows_in(out) == 1, "the row of the episode that is fine")
    until((begun / fault).exists, "the other one to hang")
    started = time.monotonic() - asked
    workers = [child.pid for child in psutil.Process(process.pid).children(recursive=True)]
    assert len(workers) >= 2
    return Hanging(process, workers, started)


@pytest.mark.parametrize(
    ("fault", "how"),
    [("hang", signal.SIGINT), ("hang-locked", signal.SIGTERM), ("stop", signal.SIGINT)],
)
def test_a_stop_takes_no_longer_than_a_few_starts_and_leaves_no_process(
    tmp_path: Path, fault: str, how: signal.Signals
) -> None:
    run = _hanging(tmp_path, fault)
    process, asked = run.process, time.monotonic()
    if how is signal.SIGINT:  # As a terminal does: to the whole group.
        os.killpg(process.pid, how)
    else:
        process.send_signal(how)
    _, complaint = process.communicate(timeout=120.0)
    # A busy machine draws out both.
    assert time.monotonic() - asked < 3.0 * run.started
    assert process.returncode == 130
    assert complaint.splitlines()[-1] == (
        f"dosplan: interrupted; the same command with --out {tmp_path / 'run'} resumes"
    )
    assert "Traceback" not in complaint
    until(run.has_left_nobody, "the workers to end")


def test_a_stop_while_the_workers_start_is_one_line(tmp_path: Path) -> None:
    out = tmp_path / "run"
    scenes = write_faults(tmp_path / "scenes", ("fine",))
    process = start(
        command(out, scenes, "FaultPlanner", "--workers", "1", "--with-dos"), start_new_session=True
    )
    of_it = psutil.Process(process.pid)

    def a_worker_imports() -> bool:
        with suppress(psutil.NoSuchProcess):  # Others come and go.
            return any(
                "spawn_main" in " ".join(child.cmdline()) and child.cpu_times().user > 0.2
                for child in of_it.children()
            )
        return False

    until(a_worker_imports, "the workers to start")
    os.killpg(process.pid, signal.SIGINT)
    _, complaint = process.communicate(timeout=120.0)
    assert process.returncode == 130
    assert "Traceback" not in complaint


@pytest.mark.parametrize("fault", ["hang-locked", "stop"])
def test_no_worker_outlives_a_runner_that_is_killed(tmp_path: Path, fault: str) -> None:
    run = _hanging(tmp_path, fault)
    run.process.kill()
    run.process.wait()
    until(run.has_left_nobody, "the workers to end")
