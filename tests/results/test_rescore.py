"""A run that is scored again has its rows again, and tells those that are others."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.cli.main import BAD_INPUT, FAILED, OK, main
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.rescore import rescore
from dosplan.results.rows import read_rows, write_rows
from dosplan.results.summary import read_summary
from dosplan.running.config import RunConfig
from dosplan.system.files import FileError, read_json
from dosplan.types import Arm, EpisodeKey, Outcome
from tests.support import traffic
from tests.support.old_files import save_as_version_0_4
from tests.support.plugins import PLUGINS
from tests.support.runs import run_here
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

TRAFFIC = {"replay": "replay", "reacting": f"{traffic.__file__}:ShyTraffic"}
STEPS = 20


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scenarios of two seconds, each with its own end for an ego that rolls on at 10 m/s."""
    folder = tmp_path_factory.mktemp("scenes")
    ahead = Goal(first_step=0, last_step=STEPS, position=rectangle(6.0, 3.0, 28.0, 0.0))
    behind = Goal(first_step=0, last_step=STEPS, position=rectangle(4.0, 3.0, 2.0, 0.0))
    start = (10.0, 0.0, 0.0, 10.0)
    crossing = User(8, driving(24.0, -15.0, 12.0, STEPS + 1, np.pi / 2.0))
    beside = User(7, driving(30.0, 3.5, 9.0, STEPS + 1))
    for name, user, problem in (
        ("Goal", beside, Problem(goals=(ahead,), start=start)),
        ("Struck", crossing, Problem(goals=(behind,), start=start)),
        ("Missed", beside, Problem(goals=(behind,), start=start)),
        ("Tiring", beside, Problem(goals=(behind,), start=start)),
        ("Turned", beside, Problem(goals=(behind,), start=(10.0, 0.0, -0.4, 10.0))),
    ):
        scenario = f"ZAM_{name}-1_1_T-1"
        write_scenario_xml(
            folder / f"{scenario}.xml", users=[user], problems=[problem], benchmark_id=scenario
        )
    (folder / "ZAM_Unread-1_1_T-1.xml").write_text("<commonRoad")
    return folder


def drive(out: Path, scenes: Path, kind: str = "replay") -> RunFolder:
    return run_here(
        RunConfig(
            out=out,
            source=str(scenes),
            planner=f"{PLUGINS}:TiringPlanner",
            predictor=f"{PLUGINS}:StillPredictor",
            traffic=TRAFFIC[kind],
        )
    )


@pytest.fixture(scope="module", params=TRAFFIC)
def run(
    request: pytest.FixtureRequest, scenes: Path, tmp_path_factory: pytest.TempPathFactory
) -> RunFolder:
    return drive(tmp_path_factory.mktemp("runs") / "run", scenes, request.param)


def copied(run: RunFolder, tmp_path: Path) -> RunFolder:
    return RunFolder(Path(shutil.copytree(run.path, tmp_path / "run")))


def test_a_run_that_is_scored_again_has_its_rows_again(run: RunFolder) -> None:
    rows = read_rows(run.rows)
    ends = {row.scenario.partition("-")[0][4:]: row.outcome for row in rows}
    assert ends["Goal"] is Outcome.SUCCESS
    assert ends["Missed"] is Outcome.GOAL_MISSED
    assert ends["Turned"] is Outcome.OUT_OF_BOUNDS
    assert ends["Tiring"] is Outcome.PLANNER_FAILURE
    assert ends["Unread"] is Outcome.UNUSABLE
    reacting = rows[0].traffic == "shy-v1"
    assert ends["Struck"] is (Outcome.GOAL_MISSED if reacting else Outcome.COLLISION)
    assert any(row.steps == 5 and row.error for row in rows)
    assert any(row.fallback_cycles for row in rows)

    found = rescore(run.path)
    assert found.changes == ()
    assert list(found.rows) == rows
    assert found.kept == 2  # The file that cannot be read, in both arms.


def test_writing_gives_the_same_files(run: RunFolder, tmp_path: Path) -> None:
    copy = copied(run, tmp_path)
    before = {path: path.read_bytes() for path in copy.path.rglob("*") if path.is_file()}
    rescore(copy.path).write()
    assert {p: p.read_bytes() for p in copy.path.rglob("*") if p.is_file()} == before


def test_a_row_that_differs_is_told_and_put_right(
    run: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy, out = copied(run, tmp_path), tmp_path / "out.json"
    rows = read_rows(copy.rows)
    wrong = [replace(rows[0], velocity=99.0, measures={**rows[0].measures, "max_slack": None})]
    write_rows(copy.rows, [*wrong, *rows[1:]])
    assert main(["score", str(copy.path), "--json", str(out)]) == FAILED
    shown = capsys.readouterr().out
    assert f"{rows[0].scenario}, with_dos: velocity was 99.0, is {rows[0].velocity}" in shown
    assert "11 of 12 rows agree; 2 of them were never driven and are kept" in shown
    figures: dict[str, Any] = read_json(out)
    assert (figures["rows"], figures["agree"], figures["written"]) == (12, 11, False)
    (odd,) = figures["differ"]
    assert (odd["scenario"], odd["arm"]) == (rows[0].scenario, "with_dos")
    assert odd["columns"].keys() == {"velocity", "max_slack"}
    assert odd["columns"]["velocity"] == {"before": 99.0, "now": rows[0].velocity}
    assert read_rows(copy.rows)[0].velocity == 99.0

    assert main(["score", str(copy.path), "--write"]) == OK
    assert read_rows(copy.rows) == rows
    assert read_summary(copy) == read_summary(run)
    assert main(["score", str(copy.path)]) == OK


def test_scenarios_that_moved_are_named_and_others_are_refused(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = tmp_path / "first"
    shutil.copytree(scenes, first)
    run = drive(tmp_path / "run", first)
    first.rename(tmp_path / "second")
    assert main(["score", str(run.path)]) == BAD_INPUT
    assert "with --source" in capsys.readouterr().err
    assert rescore(run.path, str(tmp_path / "second")).changes == ()
    scenario = "ZAM_Goal-1_1_T-1"
    elsewhere = Problem(start=(11.0, 0.0, 0.0, 10.0))
    file = tmp_path / "second" / f"{scenario}.xml"
    write_scenario_xml(file, problems=[elsewhere], benchmark_id=scenario)
    with pytest.raises(FileError, match=f"{scenario} is not the scenario that the run drove"):
        rescore(run.path, str(tmp_path / "second"))
    file.unlink()
    with pytest.raises(FileError, match=f"holds no scenario {scenario}; did you mean .*--source"):
        rescore(run.path, str(tmp_path / "second"))


def test_an_episode_file_that_is_gone_is_named(run: RunFolder, tmp_path: Path) -> None:
    copy = copied(run, tmp_path)
    copy.recording(EpisodeKey("ZAM_Goal-1_1_T-1", Arm.WITH_DOS)).unlink()
    with pytest.raises(FileError, match=r"Goal-1_1_T-1.with_dos.npz is missing"):
        rescore(copy.path)


@pytest.mark.parametrize("first", [False, True])
def test_files_of_older_versions_keep_the_columns_that_they_hold_inexactly(
    scenes: Path, tmp_path: Path, first: bool
) -> None:
    run = drive(tmp_path / "run", scenes)
    for path in (run.path / "episodes").glob("*.npz"):
        save_as_version_0_4(path, Recording.load(path), first=first)
    assert rescore(run.path).changes == ()
