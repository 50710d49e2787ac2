"""Runs of a second that several tests read: their scenarios, and an executor that is quick."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from dosplan.results.folder import RunFolder
from dosplan.running import run as runner
from dosplan.running.config import RunConfig
from dosplan.running.executor import Results, Task
from dosplan.running.job import drive_episode
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

FAULTY = Path(__file__).with_name("faulty.py")


class InProcess:
    """An executor that drives in the test's own process, which is quicker."""

    def __init__(self, config: RunConfig) -> None:
        self.config = config

    def drive(self, tasks: Iterable[Task]) -> Results:
        """Drives one after another."""
        for ref, arm in tasks:
            yield (ref, arm), drive_episode(ref, arm, self.config)


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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "LocalExecutor", InProcess)
        return runner.run(config)
