"""Runs in an imperfect loop: what is written of it, what is refused, what is compared."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from dosplan.cli.main import BAD_INPUT, OK, main
from dosplan.results.comparison import compare_runs, world_lines
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import read_manifest
from dosplan.results.recording import Recording
from dosplan.results.rescore import rescore
from dosplan.results.rows import read_rows
from dosplan.results.summary import read_summary
from dosplan.running.config import RunError
from dosplan.types import Arm, EpisodeKey
from tests.support.plugins import PLUGINS
from tests.support.runs import configured, run_here, untimed, write_followed, write_scenes

VELOCITY = {"predictor": "constant-velocity"}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("loops") / "scenes", 2, "ZAM_Test-{}_1_T-1")


@pytest.fixture(scope="module")
def realistic(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    out = tmp_path_factory.mktemp("run") / "out"
    return run_here(configured(out, scenes, loop="realistic", **VELOCITY))


def test_everything_that_is_written_names_the_loop(realistic: RunFolder) -> None:
    manifest = read_manifest(realistic)
    assert (manifest.loop, manifest.reproducible) == ("realistic", True)
    assert manifest.settings["loop"]["sensing"]["range"] == 120.0
    assert {row.loop for row in read_rows(realistic.rows)} == {"realistic"}
    assert read_summary(realistic).run.loop == "realistic"
    assert ", loop realistic, " in realistic.summary_text.read_text()
    recording = Recording.load(realistic.recording(EpisodeKey("ZAM_Test-0_1_T-1", Arm.WITH_DOS)))
    assert recording.loop == "realistic"
    assert recording.sightings is not None
    assert list(recording.cycle_steps[1:] - recording.sightings.steps[1:]) == [3] * (
        len(recording.cycle_steps) - 1
    )


def test_the_same_run_again_has_the_same_rows(
    realistic: RunFolder, scenes: Path, tmp_path: Path
) -> None:
    again = run_here(configured(tmp_path / "again", scenes, loop="realistic", **VELOCITY))
    assert untimed(again) == untimed(realistic)


def test_scoring_again_changes_nothing(realistic: RunFolder) -> None:
    assert rescore(realistic.path).changes == ()


def test_a_run_goes_on_in_its_own_loop_only(realistic: RunFolder, scenes: Path) -> None:
    config = configured(realistic.path, scenes, loop="ideal", **VELOCITY)
    with pytest.raises(RunError, match=r"holds a run with another loop; nothing was changed"):
        run_here(config)
    later = {"latency": 0.4}
    with pytest.raises(RunError, match=r"holds a run with another loop_options;"):
        run_here(
            configured(realistic.path, scenes, loop="realistic", loop_options=later, **VELOCITY)
        )


def test_a_run_that_charges_the_time_of_plans_is_marked(scenes: Path, tmp_path: Path) -> None:
    options = ["--real-time", "--with-dos", "--planner", f"{PLUGINS}:CoastPlanner", "--quiet"]
    out = tmp_path / "timed"
    assert main(["run", str(scenes), *options, "--in-process", "--out", str(out)]) == OK
    written = json.loads((out / "run.json").read_text())
    assert written["reproducible"] is False
    assert written["config"]["loop_options"] == {"real_time": True}
    run = read_summary(RunFolder(out)).run
    assert (run.ranked, run.reproducible) == (False, False)
    text = RunFolder(out).summary_text.read_text()
    assert "(unranked: it depends on the time that plans took, so the run cannot" in text
    assert "may see the future" not in text


@pytest.mark.parametrize(
    ("options", "deadline", "reproducible"),
    [
        ([], None, True),
        (["--real-time"], 0.08, False),  # Four fifths of the period.
        (["--real-time", "--set", "loop.period=0.5"], 0.4, False),
        (["--real-time", "--set", "planner.deadline=0.05"], 0.05, False),
        (["--set", "planner.deadline=0.05"], 0.05, False),
    ],
)
def test_a_deadline_follows_the_loop(
    scenes: Path, tmp_path: Path, options: list[str], deadline: float | None, reproducible: bool
) -> None:
    """A run whose plans depend on the clock cannot be repeated, whoever asked for it."""
    planner = ["--planner", f"{PLUGINS}:TimelyPlanner", "--with-dos", "--quiet", "--in-process"]
    out = tmp_path / "out"
    assert main(["run", str(scenes), *planner, *options, "--out", str(out)]) == OK
    manifest = read_manifest(RunFolder(out))
    assert manifest.settings["planner"] == {"deadline": deadline}
    assert manifest.reproducible is reproducible


def test_sets_that_do_not_reach_far_enough_are_refused_at_once(
    scenes: Path, tmp_path: Path
) -> None:
    """The planner looks 30 steps ahead; of the 40 that are predicted, 1.1 s take 11."""
    config = configured(
        tmp_path / "out", scenes, "FarSightedPlanner", loop_options={"latency": 1.1}, **VELOCITY
    )
    told = "looks 30 steps ahead, .* predicts 40, of which the loop's latency takes 11; raise"
    with pytest.raises(RunError, match=told):
        run_here(config)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("loop", "told"),
    [
        ({"period": 3.1}, r"plans 30 steps, the loop drives 31 from the first plan \(period 3.1 s"),
        ({"period": 2.5, "latency": 0.6}, r".*drives 31 .*latency 0.6 s\); lower loop.period or"),
    ],
)
@pytest.mark.parametrize("planner", ["mpc", "idm", "cruise", "brake"])
def test_a_loop_that_plans_do_not_last_for_is_refused_at_once(
    planner: str, loop: dict[str, float], told: str, scenes: Path, tmp_path: Path
) -> None:
    config = configured(tmp_path / "out", scenes, loop_options=loop, **VELOCITY)
    with pytest.raises(RunError, match=rf"planner {planner}-v\d+ {told}"):
        run_here(replace(config, planner=planner))
    assert not (tmp_path / "out").exists()


def test_a_comparison_says_that_the_loops_differ(
    realistic: RunFolder, scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ideal = run_here(configured(tmp_path / "ideal", scenes, **VELOCITY))
    specs = [str(ideal.path), str(realistic.path)]
    line = f"the loop differs: ideal in {ideal.path}, realistic in {realistic.path}"
    assert len(compare_runs(specs)) == 2
    assert world_lines(specs) == [line]
    assert world_lines([str(realistic.path)]) == []
    assert main(["compare", *specs]) == OK
    assert "the loop differs: ideal in" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--loop", "idael"], "there is no loop 'idael'; did you mean 'ideal'?"),
        (["--set", "loop.latncy=0.3"], "loop 'ideal': takes no option 'latncy'"),
        (["--set", "loop.period=0.25"], "loop 'ideal': period is 0.25 s, expected a multiple"),
        (["--set", "loop.sensing.range=-1"], "option 'sensing': range is -1.0, expected more"),
    ],
)
def test_a_wrong_loop_is_one_line(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *options, "--out", str(tmp_path / "out")]) == BAD_INPUT
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert told in lines[0]


def test_report_and_explain_take_a_late_loop(tmp_path: Path) -> None:
    scenes = write_followed(tmp_path / "scenes")
    folder = run_here(configured(tmp_path / "out", scenes, loop="realistic", **VELOCITY))
    assert main(["report", str(folder.path)]) == OK
    page = (folder.path / "report.html").read_text()
    assert "realistic" in page
    name = read_rows(folder.rows)[0].scenario
    assert main(["explain", str(folder.path), name]) == OK
