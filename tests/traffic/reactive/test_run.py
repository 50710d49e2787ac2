"""A run with reactive traffic, from the command line to its report."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosplan.cli.command import BAD_INPUT, OK
from dosplan.cli.main import main
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.rows import read_rows
from dosplan.scenario import find_scenarios, load_scenario
from dosplan.types import EpisodeKey
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

STEPS = 40

BRAKE = ["--planner", "brake", "--predictor", "none", "--in-process"]


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Two scenarios in two futures; in one of them somebody follows an ego that brakes."""
    base = tmp_path_factory.mktemp("reactive")
    (base / "scenes").mkdir()
    for number, start in enumerate((-12.0, 60.0)):
        write_scenario_xml(
            base / "scenes" / f"ZAM_Test-{number}_1_T-1.xml",
            users=[User(7, driving(start, 0.0, 10.0, STEPS + 1))],
            problems=[Problem(goals=(Goal(0, STEPS, rectangle(4.0, 3.0, 90.0, 0.0)),))],
            benchmark_id=f"ZAM_Test-{number}_1_T-1",
        )
    out = base / "run"
    options = ["--traffic", "reactive", "--futures", "2", "--out", str(out)]
    assert main(["run", str(base / "scenes"), *BRAKE, *options]) == OK
    return RunFolder(out)


def test_rows_scores_and_report_follow(
    driven: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = read_rows(driven.rows)
    assert len(rows) == 8
    assert {row.traffic for row in rows} == {"reactive-v1"}
    assert {row.collision_step for row in rows if row.future == 0} == {None}
    slowed = [row.measures["imposed_braking"] for row in rows if row.future == 0]
    assert max(float(x) for x in slowed if x is not None) > 1.0
    assert all(row.measures["imposed_braking"] is None for row in rows if row.future)
    assert main(["score", str(driven.path)]) == OK
    assert "8 of 8 rows agree" in capsys.readouterr().out
    assert main(["explain", str(driven.path), "ZAM_Test-0_1_T-1"]) == OK
    assert "reactive-v1" in driven.summary_text.read_text(encoding="utf-8")
    assert (driven.path / "report.html").exists()


def test_what_is_kept_of_an_episode_is_what_was_driven(driven: RunFolder) -> None:
    source = driven.path.parent / "scenes"
    off = 0
    for ref in find_scenarios(source):
        tracks = load_scenario(ref).tracks
        for row in read_rows(driven.rows):
            if row.scenario == ref.id and row.future == 0:
                kept = Recording.load(driven.recording(EpisodeKey(ref.id, row.arm))).tracks
                assert kept is not None
                off += bool((kept.states[:, -1] != tracks.states[:, kept.steps - 1]).any())
    assert off


def test_who_is_shown_the_recording_is_refused(
    driven: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    oracle = ["--planner", "brake", "--predictor", "ground-truth", "--unranked"]
    oracle += ["--traffic", "reactive"]
    source = str(driven.path.parent / "scenes")
    assert main(["run", source, *oracle, "--in-process", "--out", str(tmp_path / "x")]) == BAD_INPUT
    assert "is shown the recording" in capsys.readouterr().err
