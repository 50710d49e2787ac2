"""What nobody could drive is told first, not driven, outside the rates and inside the count."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from dosplan.cli.command import BAD_INPUT, FAILED, OK
from dosplan.cli.main import main
from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_rows
from dosplan.results.summary import read_summary
from dosplan.results.unusable import LISTED, Unusable, unusable_scenarios
from dosplan.running.executor import parted
from dosplan.running.job import Session
from dosplan.running.process import EpisodeProcess
from dosplan.running.progress import Observer, ProgressObserver
from dosplan.running.run import run
from dosplan.scenario import ScenarioRef, find_scenarios
from dosplan.scoring.score import failed_score
from dosplan.system.files import read_json
from dosplan.types import Arm, EpisodeKey, Outcome, Score
from tests.support.plugins import PLUGINS
from tests.support.runs import STILL, configured, run_here, write_scenes
from tests.support.scenes import (
    Goal,
    Problem,
    User,
    driving,
    rectangle,
    scenario_xml,
    straight_road,
    write_scenario_xml,
)

GOOD = ("ZAM_Good-00_1_T-1", "ZAM_Good-01_1_T-1")
REASONS = {
    "ZAM_Beside-1_1_T-1": "its goal lies beside the road",
    "ZAM_Broken-1_1_T-1": "is not complete XML (",
    "ZAM_Edge-1_1_T-1": "part of the ego is off the road at its start",
    "ZAM_Goalless-1_1_T-1": "it has no <goalState>",
    "ZAM_Interactive-1_1_T-1": "first states of its road users",
    "ZAM_Twin-1_1_T-1": "the ego's start overlaps road user 7 (car)",
}
"""What is said of each unusable file."""
PLUGINS_USED = ("--planner", f"{PLUGINS}:CoastPlanner", "--predictor", STILL)


def test_a_folder_may_have_a_colon_in_its_name() -> None:
    for file in ("/d/run: one/x.xml", "C: /x.xml.gz", "/d/x.pb"):
        row = failed_score(
            EpisodeKey("x", Arm.WITH_DOS), f"{file}: it has: no goal", Outcome.UNUSABLE
        )
        assert unusable_scenarios([row]) == (Unusable("x", file, "it has: no goal"),)


def write_unusable(folder: Path) -> Path:
    """Writes a file of each kind."""
    folder.mkdir(exist_ok=True)

    def write(name: str, user: User, problem: Problem) -> str:
        write_scenario_xml(
            folder / f"{name}.xml", users=[user], problems=[problem], benchmark_id=name
        )
        return name

    far = User(7, driving(60.0, 0.0, 5.0, 11))
    beside = Goal(0, 10, rectangle(4.0, 3.0, 20.0, -5.0))
    write("ZAM_Beside-1_1_T-1", far, Problem(goals=(beside,)))
    (folder / "ZAM_Broken-1_1_T-1.xml").write_text("<commonRoad")
    write("ZAM_Edge-1_1_T-1", far, Problem(start=(10.0, -1.2, 0.0, 10.0)))
    name = "ZAM_Goalless-1_1_T-1"
    problems = [Problem(goals=())]
    text = scenario_xml(straight_road(), problems=problems, benchmark_id=name)
    (folder / f"{name}.xml").write_text(text)
    write("ZAM_Interactive-1_1_T-1", User(7, driving(60.0, 0.0, 5.0, 1)), Problem())
    write("ZAM_Twin-1_1_T-1", User(7, driving(10.0, 0.0, 10.0, 11)), Problem())
    return folder


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two files that are driven to their goal, among one of each kind that cannot be."""
    return write_unusable(
        write_scenes(tmp_path_factory.mktemp("scenes"), 2, "ZAM_Good-{:02d}_1_T-1")
    )


@pytest.fixture(scope="module")
def hopeless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_unusable(tmp_path_factory.mktemp("hopeless"))


@pytest.fixture(scope="module")
def folder(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Their run, in worker processes."""
    return run(configured(tmp_path_factory.mktemp("run"), scenes, workers=2))


class Told(Observer):
    """Keeps what it is told, in order."""

    def __init__(self) -> None:
        self.checks: list[tuple[int, int]] = []
        self.events: list[str] = []
        self.unusable: list[Unusable] = []

    def checking(self, done: int, total: int) -> None:
        self.checks.append((done, total))

    def checked(self, rows: Sequence[Score], unusable: Sequence[Unusable]) -> None:
        self.events += [f"told {row.scenario}" for row in rows]
        self.unusable += unusable

    def add(self, row: Score) -> None:
        self.events.append(f"driven {row.scenario}")


def test_each_kind_has_its_rows_and_is_in_no_rate(folder: RunFolder, scenes: Path) -> None:
    rows = read_rows(folder.rows)
    assert len(rows) == len(Arm) * (len(GOOD) + len(REASONS))
    for row in rows:
        if row.scenario in GOOD:
            assert row.outcome is Outcome.SUCCESS
            continue
        assert (row.outcome, row.steps, row.cycle_ms_p50) == (Outcome.UNUSABLE, 0, None)
        file = scenes / f"{row.scenario}.xml"
        assert str(row.error).startswith(f"{file}: ")
        assert REASONS[row.scenario] in str(row.error)
        assert "Error" not in str(row.error)
        assert not folder.recording(row.key).exists()
    summary = read_json(folder.summary)
    for arm in Arm:
        figures = summary[arm.value]
        assert (figures["n"], figures["usable"]) == (8, 2)
        assert (figures["success_rate"], figures["planner_failure_rate"]) == (1.0, 0.0)
        assert figures["velocity"] == pytest.approx(10.0)
    assert [one["scenario"] for one in summary["unusable"]] == list(REASONS)
    for one in summary["unusable"]:
        assert one["file"] == str(scenes / f"{one['scenario']}.xml")
        assert REASONS[one["scenario"]] in one["reason"]
    assert (summary["comparison"]["n"], summary["comparison"]["unusable"]) == (2, 6)
    assert json.loads(json.dumps(read_summary(folder).content)) == summary


def test_everything_is_told_before_anything_is_driven(scenes: Path, tmp_path: Path) -> None:
    told = Told()
    run_here(configured(tmp_path / "run", scenes, arms=(Arm.WITH_DOS,)), told)
    assert told.checks == [(done, 8) for done in range(9)]
    assert told.events == [f"told {name}" for name in REASONS] + [f"driven {g}" for g in GOOD]
    assert [one.scenario for one in told.unusable] == list(REASONS)


def test_the_number_of_finished_episodes_counts_them(scenes: Path, tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    observer = ProgressObserver(lambda done, total: calls.append((done, total)))
    run_here(configured(tmp_path / "run", scenes, arms=(Arm.WITH_DOS,)), observer)
    assert calls == [(0, 8), (6, 8), (7, 8), (8, 8)]


def test_a_resumed_run_checks_only_what_has_no_row(
    folder: RunFolder, scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configured(tmp_path / "run", scenes)
    whole = run_here(config).rows.read_bytes()
    rows = whole.splitlines(keepends=True)
    # Killed: of a good and of an unusable scenario one arm is left, of one of each kind neither.
    left = [row for row in rows if b"ZAM_Good-01" not in row and b"ZAM_Twin" not in row]
    left.remove(next(row for row in left if b"ZAM_Good-00" in row))
    left.remove(next(row for row in left if b"ZAM_Edge" in row))
    config.out.joinpath("scenarios.jsonl").write_bytes(b"".join(left))
    checked: list[str] = []
    check = Session.check

    def watched(session: Session, ref: ScenarioRef) -> str | None:
        checked.append(ref.id)
        return check(session, ref)

    monkeypatch.setattr(Session, "check", watched)
    told = Told()
    again = run_here(config, told)
    assert checked == ["ZAM_Good-01_1_T-1", "ZAM_Twin-1_1_T-1"]
    assert len(told.unusable) == len(REASONS)  # Also those of which rows were left.
    assert [row.outcome for row in read_rows(again.rows)] == [
        Outcome(json.loads(row)["outcome"]) for row in rows
    ]
    checked.clear()
    run_here(config)
    assert checked == []


def test_a_file_that_ends_the_worker_is_unusable(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fall(*_: object) -> None:
        raise RecursionError("too deep")

    monkeypatch.setattr("dosplan.running.job.unusable", fall)
    source = scenes / f"{GOOD[0]}.xml"
    (row, _) = read_rows(run_here(configured(tmp_path / "run", source)).rows)
    assert row.outcome is Outcome.UNUSABLE
    assert row.error == f"{source}: cannot be read (RecursionError: too deep); leave it out"


def test_the_command_tells_both_counts_and_the_reasons(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["run", str(scenes), *PLUGINS_USED, "--in-process", "--out", str(out)]) == FAILED
    shown = capsys.readouterr()
    told = "6 of 8 scenarios are unusable: nobody could drive them, and no figure counts them"
    for text in (shown.err, shown.out, (out / "summary.md").read_text()):
        assert told in text
    lines = shown.err.splitlines()
    assert lines[:2] == ["0 of 16 episodes", told]
    driven = [line[:17] for line in lines[2 + len(REASONS) :] if "episodes" in line]
    assert [driven[0], driven[-1]] == ["12 of 16 episodes", "16 of 16 episodes"]
    for name, reason in REASONS.items():
        (line,) = [line for line in lines if line.startswith(f"  {scenes / name}.xml: ")]
        assert reason in line
        assert " x " not in line  # It is told once, not among the planners' failures.
    assert "| usable | 2 | 2 |" in (out / "summary.md").read_text()
    page = (out / "report.html").read_text()
    assert told in page
    assert "the ego&#39;s start overlaps road user 7 (car)" in page
    assert "Success with DOS in 2 of 2" in page or "success in 2 of 2 scenarios" in page

    # What is there already is told again, also where nothing else is shown.
    again = ["run", str(scenes), *PLUGINS_USED, "--out", str(out), "--quiet", "--json"]
    assert main(again) == FAILED
    shown = capsys.readouterr()
    assert json.loads(shown.out)["with_dos"]["usable"] == 2
    assert told in shown.err


def test_a_run_of_which_nothing_is_usable_has_no_rates(
    hopeless: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    arguments = ["run", str(hopeless), *PLUGINS_USED, "--in-process", "--out", str(out)]
    assert main([*arguments, "--solutions"]) == FAILED
    assert "report in" in capsys.readouterr().out
    summary = read_json(out / "summary.json")
    for arm in Arm:
        figures = summary[arm.value]
        assert (figures.pop("n"), figures.pop("usable")) == (6, 0)
        assert set(figures.values()) == {None}
    assert summary["comparison"]["n"] == 0
    assert "| Success % | - | - |" in (out / "summary.md").read_text()
    assert "Nothing was driven." in (out / "report.html").read_text()
    for command, code in (("report", OK), ("compare", OK), ("score", OK)):
        assert main([command, str(out)]) == code
    assert "left out as unusable or failed by the traffic: 6" in capsys.readouterr().out


def test_other_commands_know_what_to_do_with_them(
    folder: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_path, twin = str(folder.path), "ZAM_Twin-1_1_T-1"
    assert main(["explain", run_path, twin, "--arm", "with_dos"]) == OK
    title, *body = capsys.readouterr().out.splitlines()
    assert title == f"{twin}, with_dos: unusable for everybody, so not driven"
    assert "the ego's start overlaps road user 7" in " ".join(" ".join(body).split())
    assert main(["score", run_path]) == OK
    assert "12 of them were never driven and are kept" in capsys.readouterr().out
    assert main(["compare", run_path, run_path, "--html", str(tmp_path / "page.html")]) == OK
    shown = capsys.readouterr().out
    assert "n = 2, places = 2; left out as unusable or failed by the traffic: 6" in shown
    assert main(["render", f"{run_path}:{twin}", "--out", str(tmp_path / "x.png")]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert "nothing was driven of ZAM_Twin-1_1_T-1" in line
    assert "overlaps road user 7" in line


def test_only_the_first_are_told_and_all_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "scenes", tmp_path / "run"
    source.mkdir()
    for number in range(LISTED + 3):
        (source / f"broken-{number:02d}.xml").write_text("<commonRoad")
    arguments = ["run", str(source), *PLUGINS_USED, "--in-process", "--with-dos", "--quiet"]
    assert main([*arguments, "--out", str(out)]) == FAILED
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("13 of 13 scenarios are unusable")
    assert [line.startswith(f"  {source}") for line in lines[1:-1]] == [True] * LISTED
    assert lines[-1] == "  and 3 more; summary.json lists them all"
    assert len(read_json(out / "summary.json")["unusable"]) == 13


def test_a_summary_without_the_count_takes_every_scenario_as_usable(
    folder: RunFolder, scenes: Path, tmp_path: Path
) -> None:
    old = read_json(folder.summary)
    del old["with_dos"]["usable"], old["unusable"], old["comparison"]["unusable"]
    (tmp_path / "summary.json").write_text(json.dumps(old))
    read = read_summary(RunFolder(tmp_path))
    assert read.arms[Arm.WITH_DOS]["usable"] == 8
    assert read.unusable == ()
    assert read.comparison is not None
    assert read.comparison.unusable == 0


def test_a_file_that_ends_the_process_is_found_among_others(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refs = find_scenarios(scenes)[:5]
    asked: list[int] = []

    def attempt(
        self: EpisodeProcess,
        call: object,
        arguments: tuple[Sequence[ScenarioRef]],
        lost: Callable[[str], list[str | None]],
    ) -> list[str | None]:
        (part,) = arguments
        asked.append(len(part))
        return lost("ended by SIGSEGV") if refs[2] in part else [None] * len(part)

    monkeypatch.setattr(EpisodeProcess, "_attempt", attempt)
    found = EpisodeProcess(configured(tmp_path / "run", scenes)).check(refs)
    line = f"{refs[2].path}: cannot be read (ended by SIGSEGV); leave it out"
    assert found == [None, None, line, None, None]
    assert asked == [5, 1, 1, 1, 1, 1]


@pytest.mark.parametrize(
    ("count", "workers", "sizes"),
    [(0, 2, []), (1, 4, [1]), (3, 2, [1, 1, 1]), (8, 2, [2] * 4), (100, 2, [16] * 6 + [4])],
)
def test_every_worker_checks_some(count: int, workers: int, sizes: list[int]) -> None:
    refs = [ScenarioRef(Path(f"{number}.xml"), str(number)) for number in range(count)]
    parts = list(parted(refs, workers))
    assert [len(part) for part in parts] == sizes
    assert [ref for part in parts for ref in part] == refs
