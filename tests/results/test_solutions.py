"""Solutions say what was driven, in the steps and under the names of the scenario's file."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from commonroad.common.solution import CommonRoadSolutionReader

from dosplan.cli.main import main
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.running.run import RunError
from dosplan.scenario import ScenarioError, load_scenario
from dosplan.scenario.commonroad.solution import Trajectory, solution_xml
from dosplan.types import Arm, EpisodeKey, FloatArray
from dosplan.vehicle import VehicleParameters
from tests.support.plugins import PLUGINS
from tests.support.runs import STILL, configured, run_here, write_scenes
from tests.support.scenes import Goal, Problem, rectangle, write_scenario_xml

VEHICLE = VehicleParameters()
DATE = datetime(2026, 3, 1, 12, 30, 5, tzinfo=UTC)
NAME = "ZAM_Test-1_1_T-1"


def driven(steps: int, start_step: int = 0, seconds: float = 0.5) -> Trajectory:
    """A drive through a bend that gets faster."""
    inputs = np.tile([0.1, 1.0], (steps, 1))
    states = [VEHICLE.state_at(np.array([10.0, 0.0]), 3.5, 10.0)]
    for u in inputs:
        states.append(VEHICLE.step(states[-1], u, 0.1))
    return Trajectory(start_step, np.array(states), inputs, seconds)


def read(xml: bytes) -> tuple[str, dict[int, tuple[list[int], FloatArray]]]:
    """Benchmark id, and steps and (K, 5) states of each problem, as commonroad-io reads them."""
    solution = CommonRoadSolutionReader.fromstring(xml.decode())
    trajectories: dict[int, tuple[list[int], FloatArray]] = {}
    for part in solution.planning_problem_solutions:
        rows = part.trajectory.state_list
        states = [[*s.position, s.steering_angle, s.velocity, s.orientation] for s in rows]
        trajectories[part.planning_problem_id] = [s.time_step for s in rows], np.array(states)
    return solution.benchmark_id, trajectories


def as_written(states: FloatArray) -> FloatArray:
    """Ego states with the rectangle's centre for their position."""
    return np.column_stack([VEHICLE.centre(states), states[:, 2:]])


@pytest.mark.parametrize("version", ["2018b", "2020a"])
@pytest.mark.parametrize("name", [NAME, "C-USA_US101-3_3_T-1", "USA_Lanker-1_1_S-1"])
def test_a_solution_is_named_after_its_file(tmp_path: Path, version: str, name: str) -> None:
    path = write_scenario_xml(tmp_path / "x.xml.gz", version=version, benchmark_id=name)
    drive = driven(7, start_step=3)
    xml = solution_xml(path, {None: drive}, DATE)
    benchmark_id, trajectories = read(xml)
    assert benchmark_id == f"KS2:WX1:{name}:{version}"
    ((problem, (steps, states)),) = trajectories.items()
    assert problem == 1000
    assert steps == list(range(3, 11))
    np.testing.assert_array_equal(states, as_written(drive.states))  # Exactly: nothing is rounded.
    root = ElementTree.fromstring(xml)
    assert root.get("date") == "2026-03-01T12:30:05"
    assert root.get("computation_time") == "0.500"


def test_an_id_that_is_not_of_commonroads_form_is_kept(tmp_path: Path) -> None:
    path = write_scenario_xml(tmp_path / "x.xml", benchmark_id="my scene &lt;1&gt;")
    root = ElementTree.fromstring(solution_xml(path, {None: driven(1, seconds=0.0)}, DATE))
    assert root.get("benchmark_id") == "KS2:WX1:my scene <1>:2020a"
    assert root.get("computation_time") is None


def test_a_drive_of_no_step_is_its_start(tmp_path: Path) -> None:
    path = write_scenario_xml(tmp_path / "x.xml")
    steps, states = read(solution_xml(path, {None: driven(0, start_step=4)}, DATE))[1][1000]
    assert steps == [4]
    np.testing.assert_allclose(states[0, :2], [10.0, 0.0])


def test_longer_steps_of_a_file_take_every_other_state(tmp_path: Path) -> None:
    path = write_scenario_xml(tmp_path / "x.xml", dt=0.2)
    drive = driven(7, start_step=4)  # Steps 4 .. 11 of 0.1 s; those of the file are 2, 3, 4, 5.
    steps, states = read(solution_xml(path, {None: drive}, DATE))[1][1000]
    assert steps == [2, 3, 4, 5]
    np.testing.assert_array_equal(states, as_written(drive.states[::2]))


def test_shorter_steps_of_a_file_follow_from_the_model(tmp_path: Path) -> None:
    path = write_scenario_xml(tmp_path / "x.xml", dt=0.05)
    drive = driven(3, start_step=2)
    steps, states = read(solution_xml(path, {None: drive}, DATE))[1][1000]
    assert steps == [4, 5, 6, 7, 8, 9, 10]
    np.testing.assert_array_equal(states[::2], as_written(drive.states))
    # The velocity grows by 1 m/s2, the steering angle by 0.1 rad/s, in half steps of 0.05 s.
    np.testing.assert_allclose(np.diff(states[:, 3]), 0.05)
    np.testing.assert_allclose(np.diff(states[:, 2]), 0.005)
    gaps = np.hypot(*np.diff(states[:, :2], axis=0).T)
    np.testing.assert_allclose(gaps, 0.5 * (states[1:, 3] + states[:-1, 3]) * 0.05, rtol=1e-3)


def test_steps_that_no_multiple_meets_begin_where_the_ego_starts(tmp_path: Path) -> None:
    """Steps of 0.04 s: from step 7, 0.28 s, four steps of 0.1 s are ten, up to step 17."""
    path = write_scenario_xml(tmp_path / "x.xml", problems=[Problem(1000, start_step=7)], dt=0.04)
    drive = driven(4, start_step=load_scenario(path).task.start_step)
    steps, states = read(solution_xml(path, {None: drive}, DATE))[1][1000]
    assert steps == list(range(7, 18))
    np.testing.assert_array_equal(states[::5], as_written(drive.states[::2]))
    np.testing.assert_allclose(np.diff(states[:, 3]), 0.04)


def test_problems_are_in_the_order_of_the_file(tmp_path: Path) -> None:
    problems = [Problem(id=9), Problem(id=4), Problem(id=6)]
    path = write_scenario_xml(tmp_path / "x.xml", problems=problems)
    xml = solution_xml(path, {4: driven(2), 9: driven(3)}, DATE)
    benchmark_id, trajectories = read(xml)
    assert benchmark_id == f"[KS2,KS2]:[WX1,WX1]:{NAME}:2020a"
    assert [(name, len(steps)) for name, (steps, _) in trajectories.items()] == [(9, 4), (4, 3)]
    assert ElementTree.fromstring(xml).get("computation_time") == "1.000"
    for odd in (7, None):
        with pytest.raises(ScenarioError, match=f"holds no planning problem {odd}"):
            solution_xml(path, {odd: driven(2)}, DATE)


def shared_scene(folder: Path) -> Path:
    """Two egos in two lanes of one file, beside a broken file and one of a single problem."""
    write_scenes(folder, 1)
    goals = [(Goal(last_step=10, position=rectangle(4.0, 3.0, 20.0, y)),) for y in (0.0, 3.5)]
    problems = [
        Problem(id=5, start=(10.0, 0.0, 0.0, 10.0), goals=goals[0]),
        Problem(id=3, start=(10.0, 3.5, 0.0, 10.0), goals=goals[1]),
    ]
    write_scenario_xml(folder / "shared.xml", problems=problems, benchmark_id=NAME)
    (folder / "broken.xml").write_text("<commonRoad")
    return folder


def test_a_run_writes_one_solution_per_file_and_arm(tmp_path: Path) -> None:
    scenes = shared_scene(tmp_path / "scenes")
    folder = run_here(configured(tmp_path / "run", scenes, solutions=True))
    single = "ZAM_Fault-00_1_T-1"
    found = {path.name: path for path in (folder.path / "solutions").iterdir()}
    assert sorted(found) == sorted(f"{n}.{arm}.xml" for n in (single, NAME) for arm in Arm)
    for arm in Arm:
        benchmark_id, trajectories = read(found[f"{NAME}.{arm}.xml"].read_bytes())
        assert benchmark_id == f"[KS2,KS2]:[WX1,WX1]:{NAME}:2020a"
        assert list(trajectories) == [5, 3]
        for problem, (_, states) in trajectories.items():
            recording = Recording.load(folder.recording(EpisodeKey(f"{NAME}@{problem}", arm)))
            np.testing.assert_array_equal(states, as_written(recording.states))
        root = ElementTree.fromstring(found[f"{single}.{arm}.xml"].read_bytes())
        assert root.get("benchmark_id") == f"KS2:WX1:{single}:2020a"


def test_solutions_can_be_asked_for_when_all_is_driven(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes, out = write_scenes(tmp_path / "scenes", 2), tmp_path / "run"
    plugins = ["--planner", f"{PLUGINS}:CoastPlanner", "--predictor", STILL]
    arguments = ["run", str(scenes), *plugins, "--with-dos", "--out", str(out), "--in-process"]
    assert main(arguments) == 0, capsys.readouterr().err
    assert not (out / "solutions").exists()
    rows = (out / "scenarios.jsonl").read_bytes()
    assert main([*arguments, "--solutions"]) == 0, capsys.readouterr().err
    assert (out / "scenarios.jsonl").read_bytes() == rows
    written = {path: path.read_bytes() for path in (out / "solutions").iterdir()}
    assert len(written) == 2
    assert main([*arguments, "--solutions"]) == 0
    assert {path: path.read_bytes() for path in (out / "solutions").iterdir()} == written


def test_a_link_in_place_of_the_solutions_is_refused(tmp_path: Path) -> None:
    config: Any = configured(tmp_path / "run", write_scenes(tmp_path / "scenes", 1), solutions=True)
    folder: RunFolder = run_here(config)
    outside = (folder.path / "solutions").rename(tmp_path / "outside")
    (folder.path / "solutions").symlink_to(outside)
    with pytest.raises(RunError, match="solutions is a link"):
        run_here(config)


def test_a_drive_among_others_than_the_recorded_is_marked(tmp_path: Path) -> None:
    path = write_scenario_xml(tmp_path / "scene.xml")
    plain = solution_xml(path, {None: driven(3)}, DATE)
    marked = solution_xml(path, {None: driven(3)}, DATE, "reactive-v1")
    assert b"<!--" not in plain
    assert b"<!-- driven among reactive-v1, not the recorded road users -->" in marked
    assert read(marked)[0] == read(plain)[0]
