"""`dosplan sweep` and `dosplan table`: what they drive, print, write and refuse."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from dosplan.cli.main import BAD_INPUT, FAILED, INTERRUPTED, OK, main
from dosplan.running import run as running
from dosplan.system.files import read_json
from tests.support.plugins import PLUGINS
from tests.support.runs import STILL, rows_in, write_followed, write_reached_and_missed

SWEEP = f"""
base: {{source: SCENES, predictor: "{STILL}"}}
axes:
  speed:
    steady: {{planner: "{PLUGINS}:CoastPlanner"}}
    faster: {{planner: "{PLUGINS}:TunedPlanner", planner.acceleration: 1}}
"""


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return _write(tmp_path)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sweep in ``runs/mine``."""
    folder = tmp_path_factory.mktemp("finished")
    assert _sweep(_write(folder), "--quiet", "--out", str(folder / "runs" / "mine")) == OK
    return folder


def _write(folder: Path) -> Path:
    (folder / "scenes").mkdir()
    write_reached_and_missed(folder / "scenes")
    path = folder / "mine.yaml"
    path.write_text(SWEEP.replace("SCENES", str(folder / "scenes")))
    return path


def _sweep(file: Path, *options: str) -> int:
    return main(["sweep", str(file), "--workers", "1", *options])


def test_a_dry_run_lists_what_is_left_and_writes_nothing(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _sweep(file, "--dry-run") == OK
    shown = capsys.readouterr()
    assert "2 runs, 8 episodes left to drive" in shown.out
    assert "about 0:00:24 of planning on 1 workers, if an episode takes 3 s" in shown.out
    assert shown.err == ""
    assert not Path("runs").exists()


def test_a_trial_goes_on_to_the_whole_sweep(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _sweep(file, "--limit", "1") == OK
    out = Path("runs/mine")
    assert sorted(path.name for path in out.iterdir()) == [
        "speed=faster",
        "speed=steady",
        "sweep.json",
    ]
    assert "run 2 of 2: speed=faster (2 episodes left of the sweep, about 0:" in (
        capsys.readouterr().err
    )
    assert _sweep(file, "--dry-run", "--json=-") == OK
    plan = json.loads(capsys.readouterr().out)
    assert [(one["name"], one["left"]) for one in plan["runs"]] == [
        ("speed=steady", 2),
        ("speed=faster", 2),
    ]
    assert plan["episodes_left"] == 4
    assert 0.0 < plan["planning_s"] < 4.0
    # A part of it first; the table tells what is not finished.
    assert _sweep(file, "--runs", "speed=f*") == OK
    assert (rows_in(out / "speed=steady"), rows_in(out / "speed=faster")) == (2, 4)
    assert _sweep(file, "--json", "all.json", "--quiet") == OK
    assert rows_in(out / "speed=steady") == 4
    shown = capsys.readouterr()
    assert f"results in {out}" in shown.out
    rows = read_json(Path("all.json"))["blocks"][0]["rows"]
    assert [(row["run"], row["arm"], row["n"]) for row in rows] == [
        ("speed=steady", "with_dos", 2),
        ("speed=steady", "without_dos", 2),
        ("speed=faster", "with_dos", 2),
        ("speed=faster", "without_dos", 2),
    ]
    assert [row["figures"]["success"]["value"] for row in rows] == [0.5] * 4


def test_a_changed_file_or_an_unknown_run_is_one_line(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _sweep(file, "--limit", "1", "--runs", "speed=steady") == OK
    before = rows_in(Path("runs/mine/speed=steady"))
    for changed, options, message in (
        (("acceleration: 1", "acceleration: 2"), (), "run speed=faster has another planner_option"),
        (
            ("steady", "calm"),
            (),
            "with a run speed=steady, which this one leaves out",
        ),
        (("speed", "speed"), ("--runs", "x*"), "no run fits --runs x*; the first is speed=steady"),
        (("speed", "speed"), ("--futures", "2"), "and the traffic replay has 1 for"),
    ):
        other = file.with_name("other.yaml")
        other.write_text(file.read_text().replace(*changed))
        capsys.readouterr()
        assert _sweep(other, "--limit", "1", "--out", "runs/mine", *options) == BAD_INPUT
        shown = capsys.readouterr()
        (line,) = shown.err.splitlines()
        assert message in line
        assert shown.out == ""
    assert rows_in(Path("runs/mine/speed=steady")) == before


def test_failures_are_told_with_their_run_and_by_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.yaml"
    text = SWEEP.replace("SCENES", str(write_followed(tmp_path))).replace("steady", "faulty")
    path.write_text(text.replace("CoastPlanner", "FaultyPlanner"))
    out = str(tmp_path / "out")
    assert _sweep(path, "--limit", "1", "--out", out, "--runs", "speed=faulty") == FAILED
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("speed=faulty: 1 x planner faulty-v1: SystemExit: enough (plugins.py:")


def test_an_interrupt_says_how_to_go_on(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(running, "run", interrupt)
    assert _sweep(file, "--limit", "1") == INTERRUPTED
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.endswith("the same command with --out runs/mine resumes")


def test_a_table_is_written_in_every_format(
    finished: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(finished)
    run = "runs/mine/speed=steady"
    command = ["table", "runs/mine", "--baseline", "speed=steady:without_dos"]
    capsys.readouterr()
    for written, words in (
        ("markdown", "| Minus speed=steady:without_dos | Arm | Success % |"),
        ("latex", r"speed=steady & with DOS & 2 & 50.0 [9.5, 90.5] &"),
    ):
        assert main([*command, "--format", written]) == OK
        assert words in capsys.readouterr().out
    assert main([*command, "--format", "csv", "--json", str(tmp_path / "table.json")]) == OK
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [row["values.speed"] for row in rows] == ["steady", "steady", "faster", "faster"]
    assert rows[1]["velocity_difference"] == ""
    assert float(rows[2]["velocity_difference"]) > 0.0
    assert main([*command, "--format", "json"]) == OK
    assert json.loads(capsys.readouterr().out) == read_json(tmp_path / "table.json")
    # The same run by its folder, one arm of it.
    assert main(["table", f"{run}:with_dos", "--columns", "safe,progress", "--json"]) == OK
    (block,) = json.loads(capsys.readouterr().out)["blocks"]
    (row,) = block["rows"]
    assert (row["run"], list(row["figures"])) == (run, ["safe", "progress"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no/such/run"], "no/such/run is not a run folder"),
        (
            ["runs/mine", "--columns", "succes"],
            "no metric 'succes'; did you mean 'success'",
        ),
        (["runs/mine", "--baseline", "x"], "the baseline x is none of the runs"),
        (
            ["runs/mine", "--baseline", "speed=steady"],
            "two arms; name one, as speed=steady:with",
        ),
        (["runs/mine", "--format", "csv", "--json"], "both write to standard output"),
        (["runs/mine", "--format", "word"], "invalid choice: 'word'"),
    ],
)
def test_a_table_that_cannot_be_made_is_one_line(
    finished: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(finished)
    try:
        code = main(["table", *arguments])
    except SystemExit as stop:
        code = int(str(stop.code))
    assert code == BAD_INPUT
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert message in line
    assert shown.out == ""
