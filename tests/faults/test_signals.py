"""Ctrl-C and SIGTERM stop a run at once, whatever its workers are doing."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from tests.faults.planners import NAMES
from tests.support.fault_runs import alive, command, rows_in, start, until, write_scenes


def _hanging(tmp_path: Path, fault: str) -> tuple[subprocess.Popen[str], list[int]]:
    """A run of which one worker waits and one hangs, and the processes that it started."""
    scenes = write_scenes(tmp_path / "scenes", len(NAMES))
    for file in scenes.iterdir():  # What is fine, and what hangs.
        if int(file.name[10:12]) not in (0, NAMES.index(fault)):
            file.unlink()
    out = tmp_path / "run"
    options = ("--workers", "2", "--with-dos")
    process = start(command(out, scenes, "FaultPlanner", *options), start_new_session=True)
    until(lambda: rows_in(out) == 1, "the row of the episode that is fine")
    time.sleep(0.3)  # The other one hangs now.
    workers = [child.pid for child in psutil.Process(process.pid).children(recursive=True)]
    assert len(workers) >= 2
    return process, workers


@pytest.mark.parametrize(
    ("fault", "how"),
    [("hang", signal.SIGINT), ("hang-locked", signal.SIGTERM), ("stop", signal.SIGINT)],
)
def test_a_stop_takes_less_than_two_seconds_and_leaves_no_process(
    tmp_path: Path, fault: str, how: signal.Signals
) -> None:
    process, workers = _hanging(tmp_path, fault)
    asked = time.monotonic()
    if how is signal.SIGINT:  # As a terminal does: to the whole group.
        os.killpg(process.pid, how)
    else:
        process.send_signal(how)
    _, complaint = process.communicate(timeout=20.0)
    assert time.monotonic() - asked < 2.0
    assert process.returncode == 130
    assert complaint.splitlines()[-1] == (
        f"dosplan: interrupted; the same command with --out {tmp_path / 'run'} resumes"
    )
    assert "Traceback" not in complaint
    until(lambda: not any(alive(pid) for pid in workers), "the workers to end", 5.0)


@pytest.mark.parametrize("fault", ["hang-locked", "stop"])
def test_no_worker_outlives_a_runner_that_is_killed(tmp_path: Path, fault: str) -> None:
    process, workers = _hanging(tmp_path, fault)
    process.kill()
    process.wait()
    until(lambda: not any(alive(pid) for pid in workers), "the workers to end", 5.0)
