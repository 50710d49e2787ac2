"""Whatever an episode does to its process becomes its row, and costs no other episode anything."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from dosplan.results.rows import read_rows
from dosplan.running import process
from dosplan.running.job import Task
from dosplan.running.process import EpisodeProcess
from dosplan.running.run import RunError, run
from dosplan.scenario import find_scenarios
from dosplan.system.files import read_json
from dosplan.types import Arm, Outcome
from tests.support.plugins import FAULTS
from tests.support.runs import alive, configured, until, write_faults, write_scenes

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def test_every_fault_becomes_its_row_and_nothing_else_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = tmp_path / "child"
    monkeypatch.setenv("CHILD_PID_FILE", str(child))
    hang = [name for name, (_, reason) in FAULTS.items() if reason.startswith("timed out")]
    end = [name for name in FAULTS if name not in hang]
    begun = time.monotonic()
    _drive_faults(tmp_path / "end", end, workers=2, memory_limit=700)
    # A limit for what hangs that the others keep on this machine, however busy it is.
    per_episode = 2 * (time.monotonic() - begun) / len(end)
    _drive_faults(tmp_path / "hang", ["fine", *hang], workers=4, episode_timeout=5.0 * per_episode)
    children = [int(line) for line in child.read_text().splitlines()]
    assert len(children) == 2
    until(lambda: not any(map(alive, children)), "the children of dead workers to end")


def _drive_faults(folder: Path, names: list[str], **options: Any) -> None:
    """Drives an episode with each fault, and checks its row and the summary."""
    scenes = write_faults(folder / "scenes", names)
    config = configured(folder / "run", scenes, "FaultPlanner", arms=(Arm.WITH_DOS,), **options)
    done = run(config)
    rows = read_rows(done.rows)
    assert [row.scenario for row in rows] == [ref.id for ref in find_scenarios(scenes)]
    for row, name in zip(rows, names, strict=True):
        reason = FAULTS[name][1]
        if not reason:
            assert row.outcome is Outcome.SUCCESS, name
        else:
            assert row.outcome is Outcome.PLANNER_FAILURE, name
            assert str(row.error).startswith(reason), name
    summary = read_json(done.summary)["with_dos"]
    assert summary["n"] == len(names)
    assert summary["planner_failure_rate"] == (len(names) - 1) / len(names)


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> EpisodeProcess:
    """A process that has driven one episode and waits for the next."""
    write_scenes(tmp_path / "scenes", 1)
    made = EpisodeProcess(configured(tmp_path / "run", tmp_path / "scenes"))
    begun = time.monotonic()
    assert _outcome(made, tmp_path) is Outcome.SUCCESS
    # A stopped process is waited for as long as two take to start.
    monkeypatch.setattr(process, "_START_SECONDS", 2.0 * (time.monotonic() - begun))
    return made


def _outcome(driver: EpisodeProcess, tmp_path: Path) -> Outcome:
    (ref,) = find_scenarios(tmp_path / "scenes")
    return driver.drive(Task(ref, Arm.WITH_DOS)).row.outcome


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_lost_while_it_waits_costs_no_row(
    driver: EpisodeProcess, tmp_path: Path, how: signal.Signals
) -> None:
    lost = driver._pid.value
    os.kill(lost, how)
    assert _outcome(driver, tmp_path) is Outcome.SUCCESS
    assert driver._pid.value != lost
    driver.close()
    until(lambda: not alive(lost), "the lost process to end")


def test_a_healthy_process_is_kept_and_ends_when_closed(
    driver: EpisodeProcess, tmp_path: Path
) -> None:
    first = driver._pid.value
    assert _outcome(driver, tmp_path) is Outcome.SUCCESS
    assert driver._pid.value == first
    driver.close()
    assert not alive(first)


def test_processes_that_cannot_start_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every process is killed before it takes up an episode, as on a machine without memory.
    monkeypatch.setattr(process, "_prepare", _die)
    scenes = write_scenes(tmp_path / "scenes", 1)
    with pytest.raises(RunError, match="worker processes die before they take up an episode"):
        run(configured(tmp_path / "run", scenes))


def _die(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)
