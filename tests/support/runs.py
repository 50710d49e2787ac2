"""Runs of a second: their scenarios, configurations, commands and comparisons."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from dosplan.results.folder import RunFolder
from dosplan.running.config import RunConfig
from dosplan.running.executor import SerialExecutor
from dosplan.running.progress import Observer
from dosplan.running.run import run
from tests.support.plugins import NAMES, PLUGINS
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

QUIET: Final = Observer()
STILL: Final = f"{PLUGINS}:StillPredictor"
STEPS: Final = 10


def run_here(config: RunConfig, observer: Observer = QUIET) -> RunFolder:
    """Runs in the test's own process, which is quicker."""
    return run(config, observer, SerialExecutor())


def write_reached_and_missed(folder: Path) -> Path:
    """Two scenarios of one second; the goal of the second is behind the ego."""
    for name, x in (("ZAM_Test-0_1_T-1", 20.0), ("ZAM_Test-1_1_T-1", 2.0)):
        goal = Goal(first_step=0, last_step=10, position=rectangle(4.0, 3.0, x, 0.0))
        write_scenario_xml(
            folder / f"{name}.xml", problems=[Problem(goals=(goal,))], benchmark_id=name
        )
    return folder


def write_scenes(
    folder: Path, count: int, name: str = "ZAM_Fault-{:02d}_1_T-1", goal: float = 20.0
) -> Path:
    """Writes scenarios of one second, each with a car far ahead.

    Args:
        folder: Where; made.
        count: How many.
        name: Their ids; the number is filled in.
        goal: Centre of the goal, which is 4 m long, m; the ego coasts at 10 m/s from 10 m.

    Returns:
        The folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    goals = (Goal(first_step=0, last_step=STEPS, position=rectangle(4.0, 3.0, goal, 0.0)),)
    for i in range(count):
        write_scenario_xml(
            folder / f"{name.format(i)}.xml",
            users=[User(7, driving(60.0, 0.0, 5.0, STEPS + 1))],
            problems=[Problem(goals=goals)],
            benchmark_id=name.format(i),
        )
    return folder


def write_followed(folder: Path) -> Path:
    """Two scenarios of one second with a car ahead; the goal is too far."""
    return write_scenes(folder, 2, "ZAM_Test-{}_1_T-1", goal=40.0)


def run_leaky(out: Path, scenes: Path) -> RunFolder:
    """A run of a planner that raises in its second scenario."""
    config = RunConfig(
        out=out,
        source=str(scenes),
        planner=f"{PLUGINS}:LeakyPlanner",
        predictor=STILL,
    )
    return run_here(config)


def write_faults(folder: Path, names: Sequence[str]) -> Path:
    """Writes a scenario for each of some of the faults of ``tests.support.plugins``, in order."""
    write_scenes(folder, len(NAMES))
    for number, file in enumerate(sorted(folder.iterdir())):
        if NAMES[number] not in names:
            file.unlink()
    return folder


def configured(out: Path, scenes: Path, planner: str = "CoastPlanner", **changes: Any) -> RunConfig:
    """A run of planners of ``tests.support.plugins``."""
    config = RunConfig(out=out, source=str(scenes), planner=f"{PLUGINS}:{planner}", predictor=STILL)
    return replace(config, **changes)


def untimed(folder: RunFolder | Path) -> list[dict[str, Any]]:
    """The rows, in their order, without the columns that hold clock times."""
    path = folder.rows if isinstance(folder, RunFolder) else folder / "scenarios.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [{key: v for key, v in row.items() if "_ms_" not in key} for row in rows]


def command(out: Path, scenes: Path, planner: str, *options: str) -> list[str]:
    """The command line of such a run."""
    plugins = ["--planner", f"{PLUGINS}:{planner}", "--predictor", STILL]
    return [
        *(sys.executable, "-m", "dosplan", "run", str(scenes), *plugins),
        *("--out", str(out), *options),
    ]


def start(arguments: list[str], **kwargs: Any) -> subprocess.Popen[str]:
    """Starts a command with its output in pipes."""
    return subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **kwargs
    )


def until(condition: Callable[[], object], what: str, seconds: float = 300.0) -> None:
    """Waits for something to become true."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited {seconds} s for {what}"
        time.sleep(0.01)


def rows_in(out: Path) -> int:
    """Number of whole rows in a run folder that may be in use."""
    path = out / "scenarios.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
