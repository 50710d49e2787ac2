"""Scenes, configurations and comparisons that the tests of faults share."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dosplan.results.folder import RunFolder
from dosplan.running.run import RunConfig
from tests.faults import planners
from tests.faults.planners import NAMES
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

PLANNERS = Path(planners.__file__)
STILL = f"{Path(__file__).with_name('faulty.py')}:StillPredictor"
STEPS = 10


def write_scenes(folder: Path, count: int) -> Path:
    """Writes scenarios of one second: the ego coasts at 10 m/s to a goal 8 to 12 m ahead."""
    folder.mkdir(parents=True, exist_ok=True)
    goal = Goal(first_step=0, last_step=STEPS, position=rectangle(4.0, 3.0, 20.0, 0.0))
    for i in range(count):
        name = f"ZAM_Fault-{i:02d}_1_T-1"
        write_scenario_xml(
            folder / f"{name}.xml",
            users=[User(7, driving(60.0, 0.0, 5.0, STEPS + 1))],
            problems=[Problem(goals=(goal,))],
            benchmark_id=name,
        )
    return folder


def write_faults(folder: Path, names: Sequence[str]) -> Path:
    """Writes a scenario for each of some of the faults of ``tests.faults.planners``, in order."""
    write_scenes(folder, len(NAMES))
    for number, file in enumerate(sorted(folder.iterdir())):
        if NAMES[number] not in names:
            file.unlink()
    return folder


def configured(out: Path, scenes: Path, planner: str = "CoastPlanner", **changes: Any) -> RunConfig:
    """A run of planners of this folder."""
    config = RunConfig(
        out=out, source=str(scenes), planner=f"{PLANNERS}:{planner}", predictor=STILL
    )
    return replace(config, **changes)


def untimed(folder: RunFolder | Path) -> list[dict[str, Any]]:
    """The rows, in their order, without the columns that hold clock times."""
    path = folder.rows if isinstance(folder, RunFolder) else folder / "scenarios.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return [{key: v for key, v in row.items() if "_ms_" not in key} for row in rows]


def command(out: Path, scenes: Path, planner: str, *options: str) -> list[str]:
    """The command line of such a run."""
    plugins = ["--planner", f"{PLANNERS}:{planner}", "--predictor", STILL]
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
