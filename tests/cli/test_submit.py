"""`dosplan submit` and `dosplan leaderboard`: what they take, write and refuse."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dosplan
from dosplan.cli.main import BAD_INPUT, FAILED, OK, main
from dosplan.results.leaderboard import SubmissionError, read_submission
from dosplan.results.rows import read_rows, write_rows
from dosplan.results.scenario_sets import ScenarioSet
from dosplan.running import submission
from dosplan.scenario import find_scenarios
from dosplan.scenario.sources.futures import futures_file
from dosplan.system.files import read_json, write_json
from dosplan.system.provenance import content_digest
from dosplan.types import Arm, Outcome
from tests.support.runs import configured, run_here, write_reached_and_missed

Edit = Callable[[dict[str, Any]], object]


def a_set(folder: Path, futures: int = 1) -> ScenarioSet:
    refs = find_scenarios(folder)
    assert all(futures_file(ref.path) is None for ref in refs)
    digest = content_digest(ref.path for ref in refs)
    return ScenarioSet("tiny", tuple(ref.id for ref in refs), futures, digest, str(folder))


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reached_and_missed(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def driven(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_here(configured(tmp_path_factory.mktemp("runs") / "run", scenes)).path


@pytest.fixture
def run(scenes: Path, driven: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of a set of two scenarios, in the folder that the test stands in."""
    monkeypatch.setattr(submission, "known_sets", lambda: (a_set(scenes),))
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(driven, "run"))


def edit(run: Path, change: Edit) -> None:
    manifest = read_json(run / "run.json")
    change(manifest)
    write_json(run / "run.json", manifest)


def refused(run: Path, capsys: pytest.CaptureFixture[str], *options: str) -> list[str]:
    """The reasons for which a run is refused; nothing was written."""
    assert main(["submit", str(run), *options]) == BAD_INPUT
    assert not Path("results").exists()
    told = capsys.readouterr().err.splitlines()
    # Before them, how far the scoring is.
    lines = [line for line in told if not re.match(r"\d+ of \d+ episodes", line)]
    assert all(line.startswith(f"dosplan: error: {run}: ") for line in lines)
    return [line.removeprefix(f"dosplan: error: {run}: ") for line in lines]


def test_a_run_becomes_a_row_and_the_rows_a_page(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about = ["--name", "My *coast*", "--authors", "Ada | Co", "--url", "https://example.org/c"]
    assert main(["submit", str(run), *about, "--json", "row.json"]) == OK
    (path,) = Path("results/leaderboard").iterdir()
    assert path.name == "tiny_replay_ideal_1-futures_my-coast.json"
    assert str(path) in capsys.readouterr().out
    row = read_json(path)
    assert {**row, "row": str(path)} == read_json(Path("row.json"))
    assert row["arms"]["with_dos"]["episodes"] == {
        "ZAM_Test-0_1_T-1": "S10.0",
        "ZAM_Test-1_1_T-1": "G10.0",
    }
    summary = read_json(run / "summary.json")
    for arm in Arm:
        figures = row["arms"][arm]["figures"]
        assert figures["success"]["value"] == summary[arm]["success_rate"] == 0.5
        assert figures["safe"]["value"] == 1.0
        assert figures["velocity"]["value"] == pytest.approx(summary[arm]["velocity"])
    assert row["digests"].keys() == {"planner file", "predictor file", "traffic file", "weights"}

    assert main(["leaderboard", "--out", "page.md"]) == OK
    page = Path("page.md").read_text()
    assert "## tiny: traffic replay, loop ideal" in page
    lines = [line for line in page.splitlines() if line.startswith("| [My ")]
    assert len(lines) == 2
    assert r"[My \*coast\*](https://example.org/c)" in lines[0]
    assert r", Ada \| Co |" in lines[0]
    assert "| with DOS | 50.0 [" in lines[0]
    assert main(["leaderboard", "--out", "page.md", "--check"]) == OK
    Path("page.md").write_text(page.replace("50.0", "99.0"))
    assert main(["leaderboard", "--out", "page.md", "--check"]) == FAILED


def test_the_function_is_the_command(run: Path) -> None:
    path = dosplan.submit(run, authors="Ada")
    assert path.name == "tiny_replay_ideal_1-futures_coast-v1-still-v1.json"
    assert read_submission(path).about.authors == "Ada"
    assert dosplan.submit(dosplan.open_run(run), authors="Ada") == path  # Again: in its own place.
    edit(run, lambda m: m["config"].update(ranked=False))
    with pytest.raises(SubmissionError, match="not ranked") as found:
        dosplan.submit(run)
    assert len(found.value.reasons) == 1


def test_the_row_of_another_is_not_overwritten(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = dosplan.submit(run, name="Coast", authors="Ada")
    before = path.read_bytes()
    assert main(["submit", str(run), "--name", "coast", "--authors", "Bob"]) == BAD_INPUT
    assert "holds another submission by Ada (Coast); choose another" in capsys.readouterr().err
    assert path.read_bytes() == before
    nobodys = dosplan.submit(run, name="free")
    edit(run, lambda m: m["digests"].update({"planner file": "0" * 64}))
    with pytest.raises(SubmissionError, match="another submission"):
        dosplan.submit(run, name="free")
    assert read_submission(nobodys).digests["planner file"] != "0" * 64


def test_check_writes_nothing(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["submit", str(run), "--check"]) == OK
    assert "coast-v1 with still-v1 on tiny, traffic replay, loop ideal: taken" in (
        capsys.readouterr().out
    )
    assert not Path("results").exists()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: m["config"].update(ranked=False), "it is not ranked: it was driven with --unr"),
        (lambda m: m.update(reproducible=False), "it is not ranked: it depends on the time"),
        (lambda m: m["config"].update(predictor="ground-truth"), "is shown the future"),
        (lambda m: m["config"].update(predictor="gone.py:Mine"), "its predictor cannot be loaded"),
        (lambda m: m["config"].update(traffic="mine.py:Calm"), "its traffic mine.py:Calm is not"),
        (lambda m: m["versions"].update(dosplan="0.1.0"), "scored by dosplan 0.1.0, and this is"),
        (lambda m: m["digests"].update({"scenario files": "0"}), "it drove other files than tho"),
    ],
)
def test_what_run_json_says_is_looked_at(
    run: Path, capsys: pytest.CaptureFixture[str], change: Edit, reason: str
) -> None:
    edit(run, change)
    (line,) = refused(run, capsys)
    assert reason in line


def test_every_reason_has_a_line(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(run, lambda m: (m["config"].update(ranked=False), m["versions"].update(dosplan="9")))
    assert len(refused(run, capsys)) == 2


def test_a_part_of_a_set_or_more_than_a_set_is_refused(
    run: Path, scenes: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = a_set(scenes)
    several = replace(whole, futures=5, scenarios=(*whole.scenarios, "ZAM_More-1_1_T-1"))
    monkeypatch.setattr(submission, "known_sets", lambda: (several,))
    few, futures = refused(run, capsys)
    assert few.startswith("it drives 2 of the 3 scenarios of tiny: the same command without")
    assert futures == (
        "it drives 1 of the 5 futures of tiny, where at least 2 are asked for: the same command "
        "with --futures 2 drives the rest"
    )
    fewer = replace(whole, scenarios=whole.scenarios[:1])
    monkeypatch.setattr(submission, "known_sets", lambda: (fewer,))
    (more,) = refused(run, capsys)
    assert more.startswith("it drives 1 scenarios that tiny does not hold, as ZAM_Test-1_1_T-1")
    other = replace(whole, scenarios=("ZAM_More-1_1_T-1",))
    monkeypatch.setattr(submission, "known_sets", lambda: (other,))
    (unknown,) = refused(run, capsys)
    assert unknown == "its scenarios are of no set that the leaderboard has (tiny)"


def test_files_are_told_by_their_content(
    run: Path, scenes: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = replace(a_set(scenes), source=None)
    monkeypatch.setattr(submission, "known_sets", lambda: (elsewhere,))
    changed = Path(shutil.copytree(scenes, "changed"))
    file = changed / "ZAM_Test-1_1_T-1.xml"
    file.write_text(file.read_text() + "\n")
    (line,) = refused(run, capsys, "--source", "changed")
    assert line.startswith("the files in changed are not those of tiny")
    (line,) = refused(run, capsys, "--source", "nowhere")
    assert "nowhere" in line
    shutil.copytree(scenes, "moved")
    assert main(["submit", str(run), "--source", "moved", "--check"]) == OK


def test_rows_are_those_of_their_recordings(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = read_rows(run / "scenarios.jsonl")
    better = replace(rows[2], outcome=Outcome.SUCCESS, goal_step=5)
    assert rows[2].outcome is Outcome.GOAL_MISSED
    write_rows(run / "scenarios.jsonl", [*rows[:2], better, rows[3]])
    (line,) = refused(run, capsys)
    assert line.startswith("1 rows are not what scoring their recordings gives (ZAM_Test-1_1_T-1")
    assert line.endswith(f"see dosplan score {run}")
    velocity = float(rows[2].velocity)
    nearly = replace(rows[2], velocity=velocity * (1.0 + 1e-6))
    write_rows(run / "scenarios.jsonl", [*rows[:2], nearly, rows[3]])
    (line,) = refused(run, capsys)
    assert f"velocity was {nearly.velocity}, is {velocity}" in line
    # As another processor or version of numpy rounds it.
    rounded = replace(rows[2], velocity=float(np.nextafter(velocity, 0.0)))
    write_rows(run / "scenarios.jsonl", [*rows[:2], rounded, rows[3]])
    assert main(["submit", str(run), "--check"]) == OK
    assert main(["score", str(run)]) == OK
    write_rows(run / "scenarios.jsonl", rows)
    next((run / "episodes").glob("*.npz")).unlink()
    (line,) = refused(run, capsys)
    assert line.endswith("is missing")


def test_what_no_recording_stands_behind_is_a_failure_without_figures(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = read_rows(run / "scenarios.jsonl")
    for path in (run / "episodes").glob("ZAM_Test-1_1_T-1*"):
        path.unlink()
    for outcome, reason in (
        (Outcome.UNUSABLE, "(are called unusable): drive them again"),
        (Outcome.TRAFFIC_FAILURE, "(the traffic failed): drive them again"),
        (Outcome.PLANNER_FAILURE, "2 rows of failures without a recording have figures"),
    ):
        claimed = [replace(row, outcome=outcome, velocity=20.0, error="x") for row in rows[2:]]
        write_rows(run / "scenarios.jsonl", [*rows[:2], *claimed])
        (line,) = refused(run, capsys)
        assert reason in line


def test_a_run_that_is_not_finished_and_texts_that_are_none_are_refused(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = refused(run, capsys, "--name", "a\nb", "--url", "javascript:alert(1)")
    assert lines == [
        "name must be one line of at most 100 characters",
        "url 'javascript:alert(1)' is not of the form https://...",
    ]
    write_rows(run / "scenarios.jsonl", read_rows(run / "scenarios.jsonl")[:3])
    (line,) = refused(run, capsys)
    assert "lacks 1 episodes: run the same command again" in line
    (line,) = refused(Path("nowhere"), capsys)
    assert "is not a run folder" in line


def test_a_row_that_was_changed_by_hand_is_told(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = dosplan.submit(run)
    row = read_json(path)
    changes: list[Edit] = [
        lambda r: r["arms"]["with_dos"]["figures"]["success"].update(value=1.0),
        lambda r: r["arms"]["with_dos"]["figures"].pop("safe"),
        lambda r: r["arms"]["with_dos"]["episodes"].update({"ZAM_Test-0_1_T-1": "X1"}),
        lambda r: r["arms"]["with_dos"]["episodes"].update({"ZAM_Test-0_1_T-1": "S10 S10"}),
        lambda r: r.update(seed="one"),
        lambda r: r.update(seed=1),  # Its name says otherwise.
    ]
    for change in changes:
        changed = json.loads(json.dumps(row))
        change(changed)
        write_json(path, changed)
        assert main(["leaderboard", "--out", "page.md"]) == BAD_INPUT
        assert str(path) in capsys.readouterr().err
        assert not Path("page.md").exists()
    assert main(["leaderboard", "--rows", "none"]) == BAD_INPUT
