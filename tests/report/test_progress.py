"""How a run shows itself: live on a terminal, in lines elsewhere, as JSON or not at all."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from dosplan.cli.main import FAILED, INTERRUPTED, OK, main
from dosplan.report.progress import show_run
from dosplan.results.rows import read_rows
from dosplan.running.progress import Observer, ProgressObserver
from dosplan.scoring.score import failed_score
from dosplan.system.files import read_json
from dosplan.types import Arm, EpisodeKey, Outcome, Score
from tests.support.plugins import PLUGINS
from tests.support.runs import write_followed, write_reached_and_missed

COAST = ("--planner", f"{PLUGINS}:CoastPlanner", "--predictor", f"{PLUGINS}:StillPredictor")
EPISODES = {Arm.WITH_DOS: 20, Arm.WITHOUT_DOS: 20}


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.seconds = 1000.0

    def __call__(self) -> float:
        return self.seconds


def _row(arm: Arm, outcome: Outcome = Outcome.SUCCESS) -> Score:
    return replace(failed_score(EpisodeKey("a", arm), ""), outcome=outcome, error=None)


def _lines(clock: Clock, seconds: float, episodes: int, left_over: int = 0) -> list[str]:
    """What a run that takes ``seconds`` for each episode of one arm writes to a pipe."""
    console = Console(force_terminal=False, width=40)
    with console.capture() as captured, show_run(console, clock) as observer:
        observer.begin({Arm.WITH_DOS: episodes}, [_row(Arm.WITH_DOS)] * left_over)
        for _ in range(episodes - left_over):
            clock.seconds += seconds
            observer.add(_row(Arm.WITH_DOS))
    assert all(len(line) < 100 for line in captured.get().splitlines())
    return captured.get().replace("\n  ", " ").splitlines()  # What goes on is indented.


def test_a_pipe_gets_a_line_per_tenth() -> None:
    lines = _lines(Clock(), 0.5, 100)
    assert [line.split(" ")[0] for line in lines] == [str(done) for done in range(0, 101, 10)]
    assert lines[0] == "0 of 100 episodes"
    assert lines[1] == (
        "10 of 100 episodes, 2.0 per second, 0:00:45 left; with DOS: 10 of 100, success 100.0 %, "
        "collisions 0, out of bounds 0, goals missed 0, failures 0"
    )


def test_a_pipe_gets_a_line_per_minute_where_a_tenth_takes_longer() -> None:
    """At 20 s each a tenth of 100 takes 200 s: after every third episode, and at each tenth."""
    done = [int(line.split(" ")[0]) for line in _lines(Clock(), 20.0, 100)]
    assert done[:8] == [0, 3, 6, 9, 10, 13, 16, 19]
    assert max(b - a for a, b in pairwise(done)) == 3
    assert [d for d in done if d % 10 == 0] == list(range(0, 101, 10))


def test_what_an_interrupted_run_left_counts_but_has_no_pace() -> None:
    first, second, *_ = _lines(Clock(), 30.0, 100, left_over=45)
    assert first.startswith("45 of 100 episodes; with DOS: 45 of 100, success 100.0 %")
    assert second.startswith("47 of 100 episodes, 2.0 per minute, 0:26:30 left")  # 53 at 30 s.


def test_a_finished_run_is_one_line() -> None:
    assert len(_lines(Clock(), 1.0, 7, left_over=7)) == 1


def test_the_table_has_every_outcome_of_each_arm() -> None:
    clock, console = Clock(), Console(force_terminal=True, width=100)
    with console.capture() as captured, show_run(console, clock) as observer:
        observer.begin(EPISODES, [])
        clock.seconds += 8.0
        for arm, outcome, times in (
            (Arm.WITH_DOS, Outcome.SUCCESS, 3),
            (Arm.WITH_DOS, Outcome.GOAL_MISSED, 1),
            (Arm.WITHOUT_DOS, Outcome.SUCCESS, 5),
            (Arm.WITHOUT_DOS, Outcome.COLLISION, 4),
            (Arm.WITHOUT_DOS, Outcome.OUT_OF_BOUNDS, 2),
            (Arm.WITHOUT_DOS, Outcome.PLANNER_FAILURE, 1),
        ):
            for _ in range(times):
                observer.add(_row(arm, outcome))
    text = captured.get()
    last = text[text.rindex("success %") :]  # Drawn once more, as the block ends.
    with_dos, without_dos = (
        next(line.split() for line in last.splitlines() if line.strip().startswith(start))
        for start in ("with DOS", "without DOS")
    )
    assert with_dos == ["with", "DOS", "4", "of", "20", "75.0", "0", "0", "1", "0"]
    assert without_dos == ["without", "DOS", "12", "of", "20", "41.7", "4", "2", "0", "1"]
    assert "16 of 40 episodes, 2.0 per second, 0:00:12 left" in last


def test_counting_starts_with_what_is_there() -> None:
    calls: list[tuple[int, int]] = []
    observer = ProgressObserver(lambda done, total: calls.append((done, total)))
    observer.begin(EPISODES, [_row(Arm.WITH_DOS)] * 3)
    observer.add(_row(Arm.WITH_DOS))
    assert calls == [(3, 40), (4, 40)]
    Observer().begin(EPISODES, [])  # Says nothing, and so needs nothing.


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reached_and_missed(tmp_path_factory.mktemp("scenes"))


@pytest.fixture
def quiet_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs without their page, which is not what is looked at here."""
    monkeypatch.setattr("dosplan.report.html.write.write_report", lambda folder: folder)


@pytest.mark.usefixtures("quiet_report")
def test_quiet_json_is_one_document_that_agrees_with_the_summary(
    scenes: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    options = ("--in-process", "--out", str(out), "--quiet", "--json")
    assert main(["run", str(scenes), *COAST, *options]) == OK
    shown = capfd.readouterr()
    assert json.loads(shown.out) == read_json(out / "summary.json")
    assert shown.err == ""

    # The run is finished: each of these shows it once more.
    assert main(["run", str(scenes), *COAST, *options[:-1]]) == OK
    shown = capfd.readouterr()
    assert "Success %" in shown.out
    assert shown.err == ""

    assert main(["run", str(scenes), *COAST, *options[:-2], "--json", "-"]) == OK
    shown = capfd.readouterr()
    assert json.loads(shown.out) == read_json(out / "summary.json")
    line, *more = shown.err.splitlines()
    assert all(each.startswith("  ") for each in more)
    assert line.startswith("4 of 4 episodes; with DOS: 2 of 2, success 50.0 %")

    assert main(["compare", str(out), "--json"]) == OK
    assert json.loads(capfd.readouterr().out)["comparisons"][0]["n"] == 2


@pytest.mark.usefixtures("quiet_report")
def test_quiet_tells_of_failures_all_the_same(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scenes = write_followed(tmp_path / "scenes")
    planner = ("--planner", f"{PLUGINS}:FaultyPlanner", *COAST[2:])
    options = ("--in-process", "--limit", "1", "--with-dos", "--quiet", "--json")
    assert main(["run", str(scenes), *planner, "--out", str(tmp_path / "run"), *options]) == FAILED
    shown = capfd.readouterr()
    assert json.loads(shown.out)["with_dos"]["planner_failure_rate"] == 1.0
    assert "planner faulty-v1: SystemExit: enough" in shown.err


def test_a_folder_is_not_taken_for_the_json_file(
    scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["run", "--json", str(scenes)])
    assert "is a folder; name a file, or write --json=-" in capsys.readouterr().err


def test_a_scenario_is_not_overwritten_by_the_figures(
    scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scenes / "ZAM_Test-0_1_T-1.xml"
    before = path.read_bytes()
    with pytest.raises(SystemExit):
        main(["list", "--json", str(path)])
    assert "is there and is no JSON; name another file" in capsys.readouterr().err
    assert path.read_bytes() == before


@pytest.mark.parametrize("content", ["", '{"a": 1}'])
def test_figures_of_before_are_replaced(tmp_path: Path, content: str) -> None:
    path = tmp_path / "figures"
    path.write_text(content)
    assert main(["list", "planners", "--json", str(path)]) == OK
    assert "planners" in read_json(path)


def test_a_terminal_has_the_table_live_and_keeps_what_was_scored_on_ctrl_c(
    scenes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    # Which would be taken for the size of the terminal.
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    terminal, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "dosplan", "run", str(scenes), "--out", str(out)),
            *("--planner", f"{PLUGINS}:HangingPlanner", *COAST[2:], "--workers", "1"),
        ],
        stdout=subprocess.PIPE,
        stderr=theirs,
        env={**environment, "TERM": "xterm"},
    )
    os.close(theirs)
    os.set_blocking(terminal, False)
    seen, until = b"", time.monotonic() + 300.0
    while b"2 of 4 episodes" not in seen and time.monotonic() < until:
        time.sleep(0.05)
        seen += _read(terminal)
    process.send_signal(signal.SIGINT)
    figures, _ = process.communicate(timeout=300.0)
    seen += _read(terminal)
    os.close(terminal)
    assert process.returncode == INTERRUPTED
    assert figures == b""  # No figures of a run that is not over.
    text = seen.decode()
    for heading in ("success %", "collisions", "out of bounds", "goals missed", "failures"):
        assert heading in text
    assert text.count("1 of 2") >= 2  # In each arm; the second scenario hangs.
    assert " left" in text
    assert text.endswith(f"dosplan: interrupted; the same command with --out {out} resumes\r\n")
    assert len(read_rows(out / "scenarios.jsonl")) == 2


def _read(terminal: int) -> bytes:
    """What has come since, nothing at the other side's end."""
    try:
        return os.read(terminal, 1 << 16)
    except OSError:
        return b""
