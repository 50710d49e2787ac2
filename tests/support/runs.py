"""Runs of a second that several tests read: their scenarios, and a way to run them quickly."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dosplan.results.folder import RunFolder
from dosplan.running.config import RunConfig
from dosplan.running.executor import SerialExecutor
from dosplan.running.progress import Observer
from dosplan.running.run import run
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

QUIET: Final = Observer()
FAULTY = Path(__file__).with_name("faulty.py")


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


def write_followed(folder: Path) -> Path:
    """Two scenarios of one second with a car ahead."""
    goal = Goal(first_step=0, last_step=10, position=rectangle(4.0, 3.0, 40.0, 0.0))
    for i in range(2):
        name = f"ZAM_Test-{i}_1_T-1"
        write_scenario_xml(
            folder / f"{name}.xml",
            users=[User(7, driving(60.0, 0.0, 5.0, 11))],
            problems=[Problem(goals=(goal,))],
            benchmark_id=name,
        )
    return folder


def run_leaky(out: Path, scenes: Path) -> RunFolder:
    """A run of a planner that raises in its second scenario."""
    config = RunConfig(
        out=out,
        source=str(scenes),
        planner=f"{FAULTY}:LeakyPlanner",
        predictor=f"{FAULTY}:StillPredictor",
    )
    return run_here(config)
