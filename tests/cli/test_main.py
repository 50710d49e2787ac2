"""The command line: what it prints, writes and returns, and how quickly it starts."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from dosplan import __version__
from dosplan.cli import main as cli
from dosplan.cli.listing import ListCommand
from dosplan.cli.main import main
from dosplan.report.progress import show_progress
from dosplan.report.tables import ERRORS_SHOWN, error_lines
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.rows import read_rows
from dosplan.running.run import RunConfig
from dosplan.scenario import find_scenarios
from dosplan.scenario.sources.catalogue import find_ids
from dosplan.scoring.score import failed_score
from dosplan.system.files import read_json
from dosplan.types import Arm, EpisodeKey
from tests.support.plugins import PLUGINS
from tests.support.runs import write_followed, write_reached_and_missed

COAST = ["--planner", f"{PLUGINS}:CoastPlanner", "--predictor", f"{PLUGINS}:StillPredictor"]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_reached_and_missed(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def finished(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run of both scenarios in both arms, and its ``--json`` file."""
    folder = tmp_path_factory.mktemp("finished")
    out, figures = folder / "run", folder / "figures.json"
    arguments = ["--workers", "1", "--out", str(out), "--json", str(figures)]
    assert main(["run", str(scenes), *COAST, *arguments]) == cli.OK
    return out, figures


def _complaint(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one line on stderr with which a command refuses its input."""
    try:
        code = main(arguments)
    except SystemExit as stop:  # argparse's own way.
        code = int(str(stop.code))
    assert code == cli.BAD_INPUT
    captured = capsys.readouterr()
    assert captured.out == ""
    line, *_ = captured.err.splitlines()
    return line


def _seconds_of_children() -> float:
    """What child processes have computed; a clock would tell how busy the machine is."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_help_is_immediate_and_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom dosplan.cli.main import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "heavy = {'casadi', 'commonroad', 'numpy', 'pebble', 'rich', 'scipy', 'shapely', 'torch'}\n"
        "print('heavy:', sorted(heavy & sys.modules.keys()))"
    )
    seconds = []
    for _ in range(3):
        started = _seconds_of_children()
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        seconds.append(_seconds_of_children() - started)
    assert "heavy: []" in done.stdout
    assert "exit codes:" in done.stdout
    assert min(seconds) < 0.5


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"dosplan {__version__}\n"


def test_the_program_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dosplan", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("dosplan ")


def test_run_writes_the_promised_names(finished: tuple[Path, Path]) -> None:
    out, figures = finished
    summary = read_json(figures)
    assert summary == read_json(out / "summary.json")
    for arm in ("with_dos", "without_dos"):
        assert {
            "n", "success_rate", "safe_rate", "collision_rate", "at_fault_collision_rate",
            "out_of_bounds_rate", "goal_missed_rate", "planner_failure_rate", "velocity",
            "cycle_ms_p50", "cycle_ms_p99", "comfortable_rate", "progress", "min_time_to_collision",
        } <= summary[arm].keys()  # fmt: skip
        assert summary[arm]["n"] == 2
        assert summary[arm]["success_rate"] == summary[arm]["goal_missed_rate"] == 0.5
        assert summary[arm]["velocity"] == pytest.approx(10.0)
    assert "| Success % | 50.0 | 50.0 | +0.0 |" in (out / "summary.md").read_text()


def test_run_prints_the_table_of_a_finished_run(
    scenes: Path, finished: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    out, _ = finished
    assert main(["run", str(scenes), *COAST, "--out", str(out)]) == cli.OK
    captured = capsys.readouterr()
    assert "coast-v1 with still-v1" in captured.out
    for heading in ("Success %", "Collision %", "Out of bounds %", "Velocity m/s", "Safe %"):
        assert heading in captured.out
    assert "Difference: with DOS minus without" in captured.out
    line, *_ = captured.err.splitlines()
    assert line.startswith("4 of 4 episodes; with DOS: 2 of 2, success 50.0 %, collisions 0, ")


def test_run_tells_planner_failures_by_its_exit_code_and_on_stderr(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = write_followed(tmp_path)
    planner = ["--planner", f"{PLUGINS}:FaultyPlanner", "--limit", "1", "--with-dos"]
    out = ["--out", str(tmp_path / "run"), "--in-process"]
    assert main(["run", str(scenes), *COAST, *planner, *out]) == cli.FAILED
    assert read_json(tmp_path / "run" / "run.json")["config"]["arms"] == ["with_dos"]
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("1 x planner faulty-v1: SystemExit: enough (plugins.py:")
    assert line.endswith("[ZAM_Test-0_1_T-1, with_dos]")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "planner.acceleration=fast"], "option 'acceleration' is 'fast', expected float"),
        (["--set", "planner.acceleration=10"], "acceleration is 10.0, expected -9 to 9"),
        (["--set", "planner.aceleration=1"], "did you mean 'acceleration'?"),
        (["--planner", f"{PLUGINS}:UnbuildablePlanner"], "OSError: the weights are missing"),
        (["--predictor", "dos", "--set", "predictor.threads=many"], "option 'threads' is 'many'"),
        (["--predictor", "dos", "--set", "predictor.threads=0"], "threads is 0, expected 1 or mo"),
        (["--predictor", "dos", "--set", "predictor.sets=x"], "there are no sets called 'x'"),
        (["--predictor", "net", "--set", "predictor.weights=x"], "weights is x, and there is no"),
        (["--predictor", "dos", "--set", "predictor.base.horizon=40"], "set base=NAME as well"),
        (["--planner", "mpc", "--set", "planner.horizon=many"], "option 'horizon' is 'many'"),
        (
            ["--planner", "mpc", "--set", "predictor.horizon=20"],
            "planner mpc-v12 looks 30 steps ahead, predictor still-v1 predicts 20; raise",
        ),
    ],
)
def test_a_wrong_option_is_one_line_and_leaves_no_folder(
    arguments: list[str],
    message: str,
    scenes: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    tuned = ["--planner", f"{PLUGINS}:TunedPlanner"]
    out = ["--out", str(tmp_path / "run"), "--workers", "1"]
    assert main(["run", str(scenes), *COAST, *tuned, *arguments, *out]) == cli.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert list(tmp_path.iterdir()) == []


def test_sets_are_driven_around_any_predictor(tmp_path: Path) -> None:
    scenes = write_followed(tmp_path)
    nested = [
        "--predictor", "dos", "--set", "predictor.base=constant-velocity",
        "--set", "predictor.base.horizon=50",
    ]  # fmt: skip
    out = ["--out", str(tmp_path / "run"), "--in-process"]
    arguments = ["run", str(scenes), *COAST, *nested, *out]
    assert main(arguments) == cli.OK
    run = RunFolder(tmp_path / "run")
    manifest = read_json(run.manifest)
    options = {"base": "constant-velocity", "base.horizon": 50}
    assert manifest["config"]["predictor_options"] == options
    recorded = manifest["settings"]["predictor"]
    assert recorded["base"] == {"predictor": "constant-velocity", "options": {"horizon": 50}}
    assert (recorded["threads"], recorded["engine"]) == (1, "torch")
    rows = read_rows(run.rows)
    assert len(rows) == 4
    for row in (row for row in rows if row.arm is Arm.WITH_DOS):
        recording = Recording.load(run.recording(row.key))
        # The car ahead is at 60 m and drives on at 5 m/s; its sets have an extent.
        ahead = 60.0 + 0.5 * recording.set_offsets
        np.testing.assert_allclose(recording.set_centres[0, :, 0], ahead, atol=0.01)
        np.testing.assert_allclose(recording.set_centres[0, :, 1], 0.0, atol=0.01)
        assert recording.set_semi_axes[0].all()
    # Everything is there: the same command resumes, another base is another run.
    assert main(arguments) == cli.OK
    assert main([*arguments, "--set", "predictor.base.horizon=40"]) == cli.BAD_INPUT


def test_each_distinct_error_is_told_once_the_most_frequent_first() -> None:
    rows = [failed_score(EpisodeKey(f"s{i}", Arm.WITH_DOS), "ab"[i > 0]) for i in range(3)]
    assert error_lines(rows) == ["2 x b [s1, with_dos]", "1 x a [s0, with_dos]"]
    rows = [failed_score(EpisodeKey("s", Arm.WITH_DOS), str(i)) for i in range(ERRORS_SHOWN + 2)]
    assert len(error_lines(rows)) == ERRORS_SHOWN + 1
    assert error_lines(rows)[-1] == "and 2 further errors; the rows hold them all"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="only Linux has such a device")
def test_a_full_disk_behind_stdout_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "dosplan", "list"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == cli.BAD_INPUT
    (line,) = done.stderr.splitlines()
    assert line == "dosplan: error: cannot write to standard output: No space left on device"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["fly"], "invalid choice: 'fly'"),
        (["run", "--with-dos", "--without-dos"], "not allowed with argument"),
        (["run", "--workers", "many"], "invalid int value: 'many'"),
        (["run", "--workers", "0"], "workers is 0; it must be more than 0"),
        (["run", "--futures", "1000000000"], "futures is 1000000000; it must be 10000 or less"),
        (["run", "--timeout", "nan"], "episode_timeout is nan; it must be more than 0"),
        (["run", "--timeout", "inf"], "episode_timeout is inf; it must be more than 0"),
        (["run", "--timeout", "0"], "episode_timeout is 0.0; it must be more than 0"),
        (["run", "x" * 5000], "File name too long"),
        (["run", "{scenes}", *COAST, "--out", "x" * 5000], "File name too long"),
        (["compare", "x" * 5000], "File name too long"),
        (["run", "no/such/folder"], "no/such/folder"),
        (["run", "{scenes}", "--planner", "mcp"], "did you mean 'mpc'?"),
        (["run", "--set", "gain"], "'gain' is not of the form planner.NAME=VALUE, predictor"),
        (["run", "--set", "planner.gain"], "'planner.gain' is not of the form planner.NAME=VALUE"),
        (["run", "--set", "planner.=1"], "'planner.=1' is not of the form planner.NAME=VALUE"),
        (["run", "--set", "vehicle.mass=1"], "is not of the form planner.NAME=VALUE"),
        (["run", "--set", "planner.gain=[1"], "the value is not YAML: while parsing"),
        (["run", "--set", "planner.day=2024-13-01"], "is not YAML: month must be in 1..12"),
        (["run", "--set", "planner.day=2024-12-01"], "planner_options: day must be made of finite"),
        (["run", "--set", "planner.gain=.nan"], "planner_options: gain must be made of finite"),
        (["run", "{scenes}", *COAST, "--set", "planner.gain=1"], "takes no option 'gain'"),
        (["run", "{scenes}", *COAST, "--set", "predictor.horzion=9"], "did you mean 'horizon'?"),
        (["run", "{scenes}", "--predictor", f"{PLUGINS}:SeerPredictor"], "--unranked allows it"),
        (["run", "{scenes}", *COAST, "--out", "{scenes}"], "is not empty and holds no run"),
        (["list", "scenarios", "no/such/folder"], "no/such/folder"),
        (["check", "no-such-plugin"], "no planner or predictor or traffic is called 'no-such-pl"),
        (["check", "dosplan.types:Plan"], "is not a subclass of dosplan.api.Planner"),
        (["compare", "no/such/run"], "no/such/run is not a run folder"),
        (["compare", "{scenes}"], "is not a run folder"),
    ],
)
def test_bad_input_is_one_line(
    scenes: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in _complaint(capsys, [part.format(scenes=scenes) for part in arguments])
    assert list(tmp_path.iterdir()) == []


def test_a_json_file_that_cannot_be_written_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["list", "planners", "--json", str(tmp_path / "file" / "x.json")]) == cli.BAD_INPUT
    assert capsys.readouterr().err.startswith("dosplan: error: cannot write")


def test_an_interrupt_outside_a_run_is_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(ListCommand, "run", interrupt)
    assert main(["list"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == "dosplan: interrupted\n"


def test_an_interrupt_of_a_run_says_how_to_resume(
    scenes: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("dosplan.running.run.run", interrupt)
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(scenes)]) == cli.INTERRUPTED
    assert "the same command with --out runs/2" in capsys.readouterr().err


def _configured(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> RunConfig:
    """The configuration that ``dosplan run`` makes of arguments."""
    configs = []

    def record(config: RunConfig, *_: object) -> None:
        configs.append(config)
        raise KeyboardInterrupt

    monkeypatch.setattr("dosplan.running.run.run", record)
    assert main(["run", *arguments]) == cli.INTERRUPTED
    return configs[0]


def test_run_without_arguments_has_the_defaults_of_the_configuration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = _configured(monkeypatch)
    assert config == RunConfig(out=config.out, workers=config.workers, cache=True)
    assert (config.planner, config.predictor) == ("mpc", "dos")


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], ("suite", ())),
        (["suite"], ("suite", ())),
        (["my/folder"], ("my/folder", ())),
        (["a.xml", "b.zip", "s3://bucket/c"], (("a.xml", "b.zip", "s3://bucket/c"), ())),
        (["ZAM_A-1_1_T-1"], ("suite", ("ZAM_A-1_1_T-1",))),
        (
            ["ZAM_A-1_1_T-1@7", "B:sub/b.xml", "--source", "x"],
            ("x", ("ZAM_A-1_1_T-1@7", "B:sub/b.xml")),
        ),
        (["--source", "x.zip"], ("x.zip", ())),
        (["a.xml", "ZAM_A-1_1_T-1"], (("a.xml", "ZAM_A-1_1_T-1"), ())),
    ],
)
def test_run_takes_sources_and_ids(
    monkeypatch: pytest.MonkeyPatch, words: list[str], wanted: object
) -> None:
    chosen = ["--only", "a", "--only", "b", "--sample", "3"]
    config = _configured(monkeypatch, *words, *chosen)
    assert (config.source, config.ids) == wanted
    assert (config.only, config.sample) == (("a", "b"), 3)


def test_run_drives_ids_and_extends_a_run(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    asked = ["--source", str(scenes), *COAST, "--workers", "1", "--out", str(out), "--quiet"]
    assert main(["run", "ZAM_Test-1_1_T-1", *asked]) == cli.OK
    assert [row.scenario for row in read_rows(out / "scenarios.jsonl")] == ["ZAM_Test-1_1_T-1"] * 2
    assert main(["run", *asked]) == cli.OK
    assert len(read_rows(out / "scenarios.jsonl")) == 4
    capsys.readouterr()
    assert "holds a run of 2 scenarios" in _complaint(capsys, ["run", "ZAM_Test-1_1_T-1", *asked])
    assert "holds no scenario ZAM_Tset" in _complaint(capsys, ["run", "ZAM_Tset", *asked])
    assert "is no id" in _complaint(capsys, ["run", str(scenes), *asked])
    assert "--only snow: none of 2" in _complaint(capsys, ["run", *asked, "--only", "snow"])


def test_set_hands_options_to_planner_and_predictor(monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["planner.gain=2", "predictor.coverage=0.9", "predictor.sets=free"]
    given += ["predictor.fast=true", "predictor.base=", "planner.term=a=b.c", "planner.gain=3"]
    config = _configured(monkeypatch, *(f"--set={setting}" for setting in given))
    assert config.planner_options == {"gain": 3, "term": "a=b.c"}  # The last one counts.
    assert config.predictor_options == {
        "coverage": 0.9, "sets": "free", "fast": True, "base": None,
    }  # fmt: skip


def test_list_shows_plugins_and_writes_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "list.json"
    assert main(["list", "--json", str(path)]) == cli.OK
    shown = capsys.readouterr().out
    assert "dosplan_mpc.planner:MpcPlanner" in shown
    figures = read_json(path)
    assert figures.keys() == {"planners", "predictors", "traffic"}
    assert {
        "name": "mpc",
        "target": "dosplan_mpc.planner:MpcPlanner",
        "distribution": "dosplan",
    } in (figures["planners"])
    assert main(["list", "predictors"]) == cli.OK
    assert "MpcPlanner" not in capsys.readouterr().out


def test_list_scenarios(scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "list.json"
    assert main(["list", "scenarios", str(scenes), "--json", str(path)]) == cli.OK
    assert "2 scenarios" in capsys.readouterr().out
    assert read_json(path)["scenarios"][0] == {
        "id": "ZAM_Test-0_1_T-1",
        "file": "ZAM_Test-0_1_T-1.xml",
    }


def test_check_passes_a_good_predictor_and_fails_a_bad_planner(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "check.json"
    assert main(["check", f"{PLUGINS}:StillPredictor", "--json", str(path)]) == cli.OK
    assert "still-v1 keeps the contract" in capsys.readouterr().out
    report = read_json(path)
    assert report["ok"]
    assert all(check["ok"] for check in report["checks"])

    assert main(["check", f"{PLUGINS}:UnbuildablePlanner"]) == cli.FAILED
    shown = capsys.readouterr().out
    assert "FAILED" in shown
    assert "the weights are missing" in shown


def test_check_takes_a_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "constant-velocity"]) == cli.OK
    assert "keeps the contract" in capsys.readouterr().out


def test_compare_shows_and_writes_the_same_figures(
    finished: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, _ = finished
    path = tmp_path / "compare.json"
    assert main(["compare", str(out), "--json", str(path)]) == cli.OK
    shown = capsys.readouterr().out
    assert "McNemar" in shown
    assert "n = 2, places = 2" in shown
    assert "No outcome differs." in shown
    (comparison,) = read_json(path)["comparisons"]
    assert comparison["n"] == 2
    assert comparison["places"] == 2
    # Without a pair that differs the score interval of two pairs ends at z^2 / (2 + z^2).
    bound = 3.8414588 / 5.8414588
    assert comparison["success"] == {
        "n": 2, "places": 2, "a": 0.5, "b": 0.5, "difference": 0.0, "low": pytest.approx(-bound),
        "high": pytest.approx(bound), "only_a": 0, "only_b": 0, "p": 1.0, "p_places": 1.0,
    }  # fmt: skip


def test_progress_is_a_bar_on_a_terminal_and_a_line_per_tenth_elsewhere() -> None:
    terminal = Console(force_terminal=True, width=80, record=True)
    with terminal.capture() as captured, show_progress(terminal, "files") as progress:
        progress(3, 4)
    assert "3/4" in captured.get()

    pipe = Console(force_terminal=False, width=80)
    with pipe.capture() as captured, show_progress(pipe, "files") as progress:
        for done in range(101):
            progress(done, 100)
    lines = captured.get().splitlines()
    assert lines == [f"{done} of 100 files" for done in range(0, 101, 10)]


def test_json_is_json(finished: tuple[Path, Path]) -> None:
    out, _ = finished
    for line in (out / "scenarios.jsonl").read_text().splitlines():
        assert json.loads(line)["outcome"] in ("success", "goal_missed")


def test_ids_are_looked_up_in_the_suites(monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = "ZAM_Zebra-7_1_T-1", find_scenarios("suite")[0].id
    for names, source in (
        ([old], "suite-1"),
        ([new], "suite"),
        ([new, old], ("suite", "suite-1")),
        ([new, "ZAM_None-1_1_T-1"], "suite"),
    ):
        config = _configured(monkeypatch, *names)
        assert (config.source, config.ids) == (source, tuple(names))
    assert find_ids(("suite", "suite-1"), [new, old])[1].path.parts[-3] == "suite-1"


def test_suites_are_sources_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "scenarios", "suite-1"]) == cli.OK
    assert "150 scenarios" in capsys.readouterr().out
    assert "a suite: suite or suite-1" in _complaint(capsys, ["list", "scenarios", "suite-2"])
