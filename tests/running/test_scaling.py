"""The projection of a million scenarios follows from the measured parts."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosplan.cli.command import BAD_INPUT
from dosplan.cli.main import main
from dosplan.running import scaling as bench
from dosplan.system.files import read_json

FAILING = """
from dosplan.api import Planner

class FailingPlanner(Planner):
    name = "failing-v1"

    def compute_plan(self, observation, occupancy):
        raise ValueError("no plan today")
"""


def test_a_million_scenarios_are_two_million_episodes() -> None:
    drive = {"episodes_per_second": 10.0, "folder_bytes_per_episode": 50_000.0}
    tiny = {"runner_bytes_per_episode": 100.0, "row_bytes_in_memory": 1000.0}
    parts = {
        "list_ms_per_scenario": 3.0,
        "digest_ms_per_scenario": 0.6,
        "write_ms_per_episode": 5.0,
        "summary_ms_per_episode": 0.9,
    }
    assert bench._project(drive, tiny, parts) == pytest.approx(
        {
            "worker_hours": 2e6 / 10.0 / 3600.0,
            "days_with_1000_workers": 2e6 / 10.0 / 1000.0 / 86400.0,
            "hours_before_the_first_episode": 1.0,  # A million times 3.6 ms.
            "hours_of_writing_alongside": 1e4 / 3600.0,  # Two million times 5 ms.
            "workers_that_one_runner_can_serve": 20.0,  # 200 writes/s for 10 episodes/s each.
            "hours_of_summarising": 0.5,
            "runner_gigabytes_while_driving": 0.2,
            "runner_gigabytes_at_the_end": 2.0,
            "folder_gigabytes": 100.0,
        }
    )


@pytest.mark.slow
def test_what_is_measured_is_shown_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scale.json"
    plugins = ["--planner", "cruise", "--predictor", "none", "--json", str(path)]
    assert main(["bench", "scale", "--scenarios", "2", "--episodes", "400", *plugins]) == 0
    shown = capsys.readouterr().out
    assert "episodes per second" in shown
    assert "a million scenarios" in shown
    figures = read_json(path)
    assert figures["drive"]["1"]["episodes"] == figures["drive"]["2"]["episodes"] == 4
    assert figures["tiny"]["episodes"] == 400
    assert all(value >= 0.0 for value in figures["million"].values())
    # Flat: a few hundred bytes for an episode are the task that waits for it.
    assert figures["tiny"]["runner_bytes_per_episode"] < 5000.0
    assert figures["start"]["worker_seconds"] > 0.1


def test_episodes_that_fail_are_no_measure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = tmp_path / "failing.py"
    planner.write_text(FAILING)
    plugins = ["--planner", f"{planner}:FailingPlanner", "--predictor", "none"]
    assert main(["bench", "scale", "--scenarios", "2", "--episodes", "400", *plugins]) == BAD_INPUT
    assert "episodes failed, whose times say nothing of a batch: " in capsys.readouterr().err


def test_too_little_to_measure_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["bench", "scale", "--episodes", "1"])
    assert stop.value.code == 2
    assert "1 is too few; give 2 or more" in capsys.readouterr().err
