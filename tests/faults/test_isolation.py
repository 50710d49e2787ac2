"""Whatever an episode does to its process becomes its row, and costs no other episode anything."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

from dosplan.results.rows import read_rows
from dosplan.running import process
from dosplan.running.process import EpisodeProcess
from dosplan.running.run import RunError, run
from dosplan.scenario import find_scenarios
from dosplan.system.files import read_json
from dosplan.types import Arm, Outcome
from tests.faults.planners import FAULTS
from tests.support.fault_runs import alive, configured, until, write_scenes

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def test_every_fault_becomes_its_row_and_nothing_else_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    child = tmp_path / "child"
    monkeypatch.setenv("CHILD_PID_FILE", str(child))
    scenes = write_scenes(tmp_path / "scenes", len(FAULTS))
    config = configured(
        tmp_path / "run",
        scenes,
        "FaultPlanner",
        arms=(Arm.WITH_DOS,),
        workers=2,
        episode_timeout=4.0,
        memory_limit=700,
    )
    folder = run(config)
    rows = read_rows(folder.rows)
    assert [row.scenario for row in rows] == [ref.id for ref in find_scenarios(scenes)]
    for row, (name, (_, reason)) in zip(rows, FAULTS.items(), strict=True):
        if not reason:
            assert row.outcome is Outcome.SUCCESS, name
        else:
            assert row.outcome is Outcome.PLANNER_FAILURE, name
            assert str(row.error).startswith(reason), name
    summary = read_json(folder.summary)["with_dos"]
    assert summary["n"] == len(FAULTS)
    assert summary["planner_failure_rate"] == (len(FAULTS) - 1) / len(FAULTS)
    until(lambda: not alive(int(child.read_text())), "the child of a dead worker to end")


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> EpisodeProcess:
    """A process that has driven one episode and waits for the next."""
    monkeypatch.setattr(process, "_START_SECONDS", 4.0)
    write_scenes(tmp_path / "scenes", 1)
    made = EpisodeProcess(configured(tmp_path / "run", tmp_path / "scenes"))
    assert _outcome(made, tmp_path) is Outcome.SUCCESS
    return made


def _outcome(driver: EpisodeProcess, tmp_path: Path) -> Outcome:
    (ref,) = find_scenarios(tmp_path / "scenes")
    return driver.drive(ref, Arm.WITH_DOS).row.outcome


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


def _die(pid: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)
