"""Every executor gives the same rows; the serial one leaves the terminal to a debugger."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from dosplan.results.rows import read_rows
from dosplan.running.config import RunConfig
from dosplan.running.executor import LocalExecutor, SerialExecutor
from dosplan.running.job import Task
from dosplan.running.process import EpisodeProcesses
from dosplan.running.run import run
from dosplan.scenario import find_scenarios
from dosplan.system.workers import WORKER_ENVIRONMENT
from dosplan.types import Arm, Outcome
from tests.support.runs import command, configured, rows_in, run_here, until, untimed, write_scenes

RUNS = ("processes", "serial")
STOPPING = """
from tests.support.plugins import coast
from dosplan.api import Planner

class StoppingPlanner(Planner):
    name = "stopping-v1"

    def compute_plan(self, observation, occupancy):
        if observation.step == 2:
            breakpoint()
        return coast(observation)
"""
INTERRUPTING = """
import os
import signal
from tests.support.plugins import coast
from dosplan.api import Planner

class InterruptingPlanner(Planner):
    name = "interrupting-v1"

    def compute_plan(self, observation, occupancy):
        if observation.step == 2:
            os.kill(os.getpid(), signal.SIGINT)
        return coast(observation)
"""


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    return write_scenes(tmp_path / "scenes", 2)


def test_rows_are_the_same_wherever_they_are_driven(tmp_path: Path) -> None:
    # The shipped planner and predictor on the suite: solver, sampler, networks, random numbers.
    config = RunConfig(out=tmp_path / "processes", limit=1, loop_options={"period": 0.5})
    run(config, executor=LocalExecutor(2))
    options = f"--in-process --limit 1 --set loop.period=0.5 --quiet --out {tmp_path / 'serial'}"
    serial = [sys.executable, "-m", "dosplan", "run", *options.split()]
    subprocess.run(serial, env=os.environ | WORKER_ENVIRONMENT, check=True)
    assert untimed(tmp_path / RUNS[0]) == untimed(tmp_path / RUNS[1])
    episodes = [{path.name for path in (tmp_path / run / "episodes").iterdir()} for run in RUNS]
    assert episodes[0] == episodes[1]


def test_what_plugins_raise_here_is_a_row_and_the_next_episode_is_driven(scenes: Path) -> None:
    # The planner raises in the second scenario.
    config = configured(scenes.parent / "run", scenes, "FaultPlanner", arms=(Arm.WITH_DOS,))
    outcomes = [row.outcome for row in read_rows(run_here(config).rows)]
    assert outcomes == [Outcome.SUCCESS, Outcome.PLANNER_FAILURE]


def _debugged(scenes: Path, typed: str) -> subprocess.CompletedProcess[str]:
    planner = scenes.parent / "stopping.py"
    planner.write_text(STOPPING)
    arguments = command(scenes.parent / "run", scenes, "CoastPlanner", "--in-process", "--with-dos")
    arguments[arguments.index("--planner") + 1] = f"{planner}:StoppingPlanner"
    return subprocess.run(arguments, input=typed, capture_output=True, text=True, check=False)


def test_a_breakpoint_in_a_plugin_stops_at_the_terminal(scenes: Path) -> None:
    done = _debugged(scenes, "p 'at', observation.step\nc\n" * 2)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("('at', 2)") == 2
    assert "-> return coast(observation)" in done.stdout
    assert rows_in(scenes.parent / "run") == 2


def test_leaving_the_debugger_ends_the_run_which_can_go_on(scenes: Path) -> None:
    done = _debugged(scenes, "c\nq\n")
    assert done.returncode == 130
    assert done.stderr.splitlines()[-1].startswith("dosplan: interrupted; the same command with")
    assert rows_in(scenes.parent / "run") == 1
    assert _debugged(scenes, "c\n").returncode == 0
    rows = read_rows(scenes.parent / "run" / "scenarios.jsonl")
    assert [row.outcome for row in rows] == [Outcome.SUCCESS] * 2


def test_ctrl_c_in_an_episode_here_ends_the_run(scenes: Path) -> None:
    # The planner presses the key itself: a timer would hit the start of a run on a busy machine.
    planner = scenes.parent / "interrupting.py"
    planner.write_text(INTERRUPTING)
    config = configured(scenes.parent / "run", scenes)
    config = replace(config, planner=f"{planner}:InterruptingPlanner")
    with pytest.raises(KeyboardInterrupt):
        run_here(config)
    assert rows_in(scenes.parent / "run") == 0
    assert not list(config.out.rglob("*.txt"))  # It has not become an episode's failure.


def test_processes_are_kept_from_episode_to_episode_and_none_starts_after_the_end(
    scenes: Path,
) -> None:
    (ref, other) = find_scenarios(scenes)
    processes = EpisodeProcesses(configured(scenes.parent / "run", scenes, "SlowPlanner"))
    assert processes.drive(Task(ref, Arm.WITH_DOS)).row.outcome is Outcome.SUCCESS
    (kept,) = processes._idle
    with ThreadPoolExecutor(1) as thread:
        driving = thread.submit(processes.drive, Task(other, Arm.WITH_DOS))
        until(lambda: processes._busy == [kept], "the kept process to be used")
        stopped = time.monotonic()
        processes.stop()
        with pytest.raises(CancelledError):
            driving.result()
    assert time.monotonic() - stopped < 10.0
    assert processes._idle == processes._busy == []
    with pytest.raises(CancelledError):
        processes.drive(Task(ref, Arm.WITH_DOS))


def test_retired_processes_end_with_their_episodes(scenes: Path) -> None:
    (ref, _) = find_scenarios(scenes)
    processes = EpisodeProcesses(configured(scenes.parent / "run", scenes, "SlowPlanner"))
    with ThreadPoolExecutor(1) as thread:
        driving = thread.submit(processes.drive, Task(ref, Arm.WITH_DOS))
        until(lambda: processes._busy, "an episode to begin")
        (process,) = processes._busy
        processes.retire()
        assert driving.result().row.outcome is Outcome.SUCCESS
    assert processes._idle == []
    assert process._pool is None


def test_an_executor_is_a_value() -> None:
    assert SerialExecutor() == SerialExecutor()
    assert LocalExecutor(2) == LocalExecutor(2) != LocalExecutor(3)
