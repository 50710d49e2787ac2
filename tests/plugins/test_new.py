"""``dosplan new`` writes plug-ins that work as they are, and nothing over anything."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from dosplan_simple.predictors import NonePredictor

from dosplan.cli.command import BAD_INPUT, OK
from dosplan.cli.main import main
from dosplan.plugins.conformance import check_planner, check_predictor
from dosplan.plugins.registry import (
    PluginKind,
    RegistryError,
    create_planner,
    create_traffic,
    find_plugin,
)
from dosplan.plugins.traffic_conformance import check_traffic
from dosplan.results.rows import read_rows
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.simulation.loop import run_episode
from dosplan.simulation.world import World
from dosplan.types import EGO_VELOCITY, EGO_X, USER_VELOCITY, Arm, LightColour, Outcome, StopCause
from tests.support.factories import ruled_scenario, stop_at
from tests.support.scenes import Goal, Problem, rectangle, write_scenario_xml
from tests.support.traffic import braking_before


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["new", *arguments]) == BAD_INPUT
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    return line


@pytest.mark.parametrize(
    ("kind", "name", "class_name"),
    [
        ("planner", "careful", "CarefulPlanner"),
        ("planner", "my_idea2", "MyIdea2Planner"),
        ("planner", "plan", "PlanPlanner"),  # Hides nothing that its file imports.
        ("planner", "near_planner", "NearPlanner"),
        ("predictor", "straight", "StraightPredictor"),
        ("predictor", "settings", "SettingsPredictor"),
        ("traffic", "hasty", "HastyTraffic"),
    ],
)
def test_what_is_written_passes_the_check(
    kind: str,
    name: str,
    class_name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind, name]) == OK
    spec = f"{name}.py:{class_name}"
    check = {"planner": check_planner, "predictor": check_predictor, "traffic": check_traffic}
    report = check[kind](find_plugin(PluginKind[kind.upper()], spec))
    assert report.failures == ()
    assert report.plugin == f"{name.replace('_', '-')}-v1"
    assert "$" not in Path(f"{name}.py").read_text(encoding="utf-8")
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith(f"wrote {name}.py")
    assert shlex.split(shown[1]) == ["dosplan", "check", spec]
    assert shlex.split(shown[2]) == ["dosplan", "run", f"--{kind}", spec, "--limit", "1"]


@pytest.mark.parametrize(("colour", "stops"), [(LightColour.RED, True), (LightColour.GREEN, False)])
def test_planner_that_is_written_reads_a_light(
    tmp_path: Path, colour: LightColour, stops: bool
) -> None:
    assert main(["new", "planner", "mine", "--out", str(tmp_path)]) == OK
    planner = create_planner(f"{tmp_path}/mine.py:MinePlanner", seed=0)
    line = stop_at(StopCause.LIGHT, 40.0, 60.0, lights=(7,))
    scenario = ruled_scenario(line, lights={7: [colour]}, seconds=8.0)
    episode = run_episode(scenario, planner, NonePredictor(), Arm.WITH_DOS)
    vehicle = scenario.task.vehicle
    front = episode.states[:, EGO_X] + vehicle.rear_to_centre + 0.5 * vehicle.length
    assert (front.max() < 40.0) == stops
    assert (episode.states[-1, EGO_VELOCITY] < 0.1) == stops


def test_the_pair_of_them_reaches_a_goal(tmp_path: Path) -> None:
    # The goal begins 5 m ahead of the ego, which starts at 10 m/s and has 4 s.
    goal = Goal(first_step=0, last_step=40, position=rectangle(10.0, 3.0, 20.0, 0.0))
    scene = tmp_path / "scenes" / "ZAM_Test-0_1_T-1.xml"
    scene.parent.mkdir()
    write_scenario_xml(scene, problems=[Problem(goals=(goal,))], benchmark_id=scene.stem)
    folder = tmp_path / "with space"
    assert main(["new", "planner", "mine", "--out", str(folder)]) == OK
    assert main(["new", "predictor", "theirs", "--out", str(folder)]) == OK
    plugins = ["--planner", f"{folder}/mine.py:MinePlanner"]
    plugins += ["--predictor", f"{folder}/theirs.py:TheirsPredictor"]
    options = ["--set", "planner.gap=12", "--set", "predictor.spread=0.3"]
    out = tmp_path / "run"
    arguments = [*plugins, *options, "--in-process", "--limit", "1", "--out", str(out)]
    assert main(["run", str(scene.parent), *arguments]) == OK
    rows = read_rows(out / "scenarios.jsonl")
    assert [row.outcome for row in rows] == [Outcome.SUCCESS, Outcome.SUCCESS]


def test_its_options_are_typed(tmp_path: Path) -> None:
    assert main(["new", "planner", "mine", "--out", str(tmp_path)]) == OK
    spec = f"{tmp_path}/mine.py:MinePlanner"
    assert vars(create_planner(spec, 0, {"gap": 12}))["chosen"].gap == 12.0
    with pytest.raises(RegistryError, match=r"no option 'gab'; did you mean 'gap'\?"):
        create_planner(spec, 0, {"gab": 12})
    with pytest.raises(RegistryError, match="option 'gap' is 'wide', expected float"):
        create_planner(spec, 0, {"gap": "wide"})
    with pytest.raises(RegistryError, match="steps is 0; a plan needs 1 or more"):
        create_planner(spec, 0, {"steps": 0})


@pytest.mark.parametrize("name", ["", "My", "my-idea", "2nd", "_mine", "class", "a/b", "naïve"])
def test_a_name_that_is_none_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal(capsys, "planner", name, "--out", str(tmp_path))
    assert f"the name {name!r} must be lower-case letters" in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["numpy", "json", "dosplan", "dosplan_mpc"])
def test_a_name_that_would_hide_a_module_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal(capsys, "predictor", name, "--out", str(tmp_path))
    assert f"Python has a module {name} already" in line
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text("precious")
    line = refusal(capsys, "planner", "mine", "--out", str(tmp_path))
    assert f"{mine} exists already; choose another name" in line
    assert mine.read_text() == "precious"


def test_nothing_is_written_through_a_link(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").symlink_to(tmp_path / "elsewhere.py")
    assert "cannot write" in refusal(capsys, "planner", "mine", "--out", str(tmp_path))
    assert not (tmp_path / "elsewhere.py").exists()


def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.touch()
    line = refusal(capsys, "planner", "mine", "--out", str(file / "folder"))
    assert f"cannot write {file / 'folder' / 'mine.py'}: Not a directory" in line


def test_traffic_that_is_written_reacts_and_has_futures(tmp_path: Path) -> None:
    assert main(["new", "traffic", "mine", "--out", str(tmp_path)]) == OK
    spec = f"{tmp_path}/mine.py:MineTraffic"
    episode = braking_before(create_traffic(spec, 0))
    assert episode.tracks.states[0, -1, USER_VELOCITY] == 0.0
    ways = {way_of(spec, future) for future in range(6)}
    assert len(ways) > 2


def way_of(spec: str, future: int) -> float:
    """Where somebody is in the end who is far from the ego."""
    scenario = straight_scenario(steady_tracks([[-100.0, 0.0, 0.0, 8.0]]))
    world = World(scenario, create_traffic(spec, 0, future=future))
    for _ in range(50):
        world.wait()
    return float(world.observation().states[0, -1, 0])
