"""Recordings of other data sets, by their own step, against the motions they were written from."""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.util import FileFormat
from scipy.interpolate import CubicSpline

from dosplan.cli.main import main
from dosplan.convert.commonroad import convert_commonroad
from dosplan.results.rows import read_rows
from dosplan.scenario import ScenarioError, load_recording, load_scenario
from dosplan.types import HISTORY_STEPS, FloatArray, Outcome, RoadUserKind, Scenario
from tests.support.drone_records import (
    FRAME,
    IDS,
    write_highd,
    write_ind,
    write_interaction,
    write_recording,
)
from tests.support.scenes import Problem
from tests.support.sind_record import Motion, Place, straight

EGO = Motion("1", "car", straight(10.0, 0.0, 0.0, 12.0), begin=3.48, end=16.0)
OTHERS = (
    Motion("2", "car", straight(40.0, 3.5, 0.0, 0.0, 0.5), begin=2.0, end=10.0),
    Motion("3", "truck", straight(0.0, 0.0, 0.0, 3.0), begin=4.0, end=15.0, size=(9.0, 2.5)),
    Motion("4", "pedestrian", straight(150.0, 20.0, -1.3, 1.4), begin=1.0, end=12.0),
)
MOTIONS = (EGO, *OTHERS)
SCENE = "DEU_Road-1_70"


@dataclass(frozen=True)
class Converted:
    """The recording, what was made of it, and the figures."""

    source: Path
    out: Path
    figures: dict[str, Any]

    @property
    def recording(self) -> Path:
        return self.out / "recordings" / f"{SCENE}_T-1.xml.gz"

    @property
    def episode(self) -> Path:
        return self.out / "scenarios" / f"{SCENE}_T-{IDS + 1}.xml.gz"


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Converted:
    folder = tmp_path_factory.mktemp("recording")
    source = write_recording(folder / "files" / "a.xml", MOTIONS)
    return Converted(source, folder / "out", convert_commonroad(source.parent, folder / "out"))


def test_says_what_was_made(converted: Converted) -> None:
    assert converted.figures == {
        "files": 1,
        "unreadable": [],
        "tracks": {"car": 2, "pedestrian": 1, "truck": 1},
        "seconds": 15.0,
        "recordings": 1,
        "scenarios": 1,  # The other car is too slow at first, and gone soon.
        "refused": {},
    }
    names = sorted(str(path.relative_to(converted.out)) for path in converted.out.rglob("*.xml.gz"))
    assert names == [f"recordings/{SCENE}_T-1.xml.gz", f"scenarios/{SCENE}_T-{IDS + 1}.xml.gz"]


def test_the_recording_begins_at_step_0_and_is_as_before(converted: Converted) -> None:
    scenario = load_recording(converted.recording)
    assert sorted(scenario.tracks.ids)[1:] == [IDS + int(motion.name) for motion in MOTIONS]
    assert scenario.tracks.kinds[0] is RoadUserKind.CAR
    _is_where_they_were(scenario, MOTIONS, begin=1.0)
    lasted = np.flatnonzero(scenario.tracks.valid[1:].any(axis=0))
    assert (lasted[0], lasted[-1]) == (0, 150)


def test_the_ego_is_to_get_where_its_car_got(converted: Converted) -> None:
    """It starts at the frame at which it is seen first, which no step of 0.1 s falls on."""
    scenario = load_scenario(converted.episode)
    task = scenario.task
    assert IDS + 1 not in scenario.tracks.ids
    assert task.start_step == HISTORY_STEPS - 1
    _is_where_they_were(scenario, OTHERS, EGO.begin - 0.1 * task.start_step)
    start = EGO.states(np.array([EGO.begin]))[0]
    np.testing.assert_allclose(task.vehicle.centre(task.start), start[:2], atol=0.001)
    assert task.start[3] == pytest.approx(12.0, abs=0.001)
    (goal,) = task.goals
    arrival = EGO.states(np.array([EGO.begin + 8.0]))[0]
    assert goal.region is not None
    np.testing.assert_allclose(np.array(goal.region.centroid.coords[0]), arrival[:2], atol=0.002)
    # 8 s of the drive, the goal from 2 s before its end to 2.5 s after it.
    assert goal.first_step - task.start_step == 60
    assert goal.last_step - task.start_step in (104, 105)  # 2.5 s are 62 steps of 0.04 s.


def test_lights_keep_their_time_and_all_else_stays(converted: Converted) -> None:
    before, _ = CommonRoadFileReader(str(converted.source)).open()
    after, planning = _open(converted.episode)
    assert after.dt == FRAME
    assert len(planning.planning_problem_dict) == 1
    (first,) = {_first_step(converted.source, 3) - _first_step(converted.episode, 3)}
    assert first > 0
    (old,), (new,) = (x.lanelet_network.traffic_lights for x in (before, after))
    for step in range(400):
        assert new.get_state_at_time_step(step) == old.get_state_at_time_step(step + first)
    shapes = {x.obstacle_id: type(x.obstacle_shape).__name__ for x in after.dynamic_obstacles}
    assert shapes[IDS + 4] == "Circle"
    assert [x.obstacle_id for x in after.static_obstacles] == [601]


@pytest.mark.parametrize(
    ("planner", "outcome"), [("brake", Outcome.GOAL_MISSED), ("idm", Outcome.SUCCESS)]
)
def test_planners_drive_it(
    planner: str, outcome: Outcome, converted: Converted, tmp_path: Path
) -> None:
    (row,) = _driven(converted.out / "scenarios", planner, tmp_path / "run")
    assert row.outcome is outcome


def test_predictors_are_evaluated_on_it(
    converted: Converted, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["evaluate", str(converted.out / "recordings"), "--predictor", "constant-velocity"]
    assert main(command) == 0
    assert "windows of 1 files" in capsys.readouterr().out


def test_planning_problems_of_a_file_are_left_aside(tmp_path: Path, converted: Converted) -> None:
    """A converter chose another car, at another time, and left it in its place."""
    problem = Problem(id=100_002, start=(40.0, 3.5, 0.0, 0.0))
    source = write_recording(tmp_path / "files" / "a.xml", MOTIONS, problems=(problem,))
    figures = convert_commonroad(source, tmp_path / "out")
    assert figures == converted.figures
    for made in (converted.recording, converted.episode):
        other = tmp_path / "out" / made.relative_to(converted.out)
        assert gzip.decompress(other.read_bytes()) == gzip.decompress(made.read_bytes())


def test_a_wrong_step_is_found_out_and_can_be_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Frames of 0.04 s in a file that says 0.016 s: people go 2.5 times as far as they say."""
    source = write_recording(tmp_path / "files" / "a.xml", MOTIONS, step=0.016, speed_factor=-0.3)
    command = ["convert", "commonroad", str(source), "--out", str(tmp_path / "out")]
    assert main(command) == 2
    (line,) = capsys.readouterr().err.splitlines()[-1:]
    assert line.startswith(f"dosplan: error: {source}: its road users go 8.3 times as far")
    assert line.endswith("give it with --step SECONDS")
    assert main([*command, "--step", "0.04"]) == 0
    made = load_recording(tmp_path / "out" / "recordings" / f"{SCENE}_T-1.xml.gz")
    _is_where_they_were(made, MOTIONS, begin=1.0, speed_error=0.02)


def test_a_state_of_before_the_initial_one_is_left_out(tmp_path: Path) -> None:
    source = write_recording(tmp_path / "a.xml", MOTIONS)
    tree = ElementTree.parse(source)
    (obstacle, *_) = tree.getroot().iterfind("dynamicObstacle")
    trajectory = obstacle.find("trajectory")
    assert trajectory is not None
    early = deepcopy(trajectory[0])
    begin = int(obstacle.findtext("initialState/time/exact") or "")
    for time in early.iterfind("time/exact"):
        time.text = str(begin - 5)
    trajectory.insert(0, early)
    tree.write(source)
    for step in (None, 0.1):
        figures = convert_commonroad(source, tmp_path / f"out-{step}", step_seconds=step)
        assert (figures["unreadable"], figures["recordings"]) == ([], 1)


def test_first_states_alone_are_no_recording(tmp_path: Path) -> None:
    source = write_recording(tmp_path / "a.xml", MOTIONS)
    tree = ElementTree.parse(source)
    for obstacle in tree.getroot().iterfind("dynamicObstacle"):
        begin = int(obstacle.findtext("initialState/time/exact") or "")
        for time in obstacle.iterfind("trajectory/state/time/exact"):
            time.text = str(begin - int(time.text or ""))  # All of them before the first one.
    tree.write(source)
    with pytest.raises(ScenarioError, match=r"a\.xml: gives the first states of its road users al"):
        convert_commonroad(source, tmp_path / "out")


def test_files_that_cannot_be_used_are_named_and_the_others_converted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "files" / "a.xml", MOTIONS)
    (tmp_path / "files" / "b.xml").write_text("<commonRoad", encoding="utf-8")
    write_recording(tmp_path / "files" / "c.xml", (), benchmark_id="DEU_Empty-1_1_T-1")
    command = ["convert", "commonroad", str(tmp_path / "files"), "--out", str(tmp_path / "out")]
    assert main(command) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "1 of 3 files: 2 car, 1 pedestrian, 1 truck in 15 s" in shown
    assert "b.xml: is not complete XML" in shown
    assert "c.xml: holds no dynamic obstacle; a recording has some" in shown


def test_two_files_of_one_scene_do_not_replace_each_other(tmp_path: Path) -> None:
    for name in "ab":
        write_recording(tmp_path / "files" / f"{name}.xml", MOTIONS)
    write_recording(tmp_path / "files" / "c.xml", MOTIONS, benchmark_id="DEU_Other-1_1_T-1")
    made = convert_commonroad(tmp_path / "files", tmp_path / "out")
    (line,) = made["unreadable"]
    assert re.search(rf"b\.xml: is of the scene {SCENE}, as .*a\.xml is", line)
    assert made["recordings"] == 2


def test_an_id_that_no_file_can_be_named_by_is_told(tmp_path: Path) -> None:
    source = write_recording(tmp_path / "a.xml", MOTIONS, benchmark_id=f"DEU_{'A' * 300}-1_1_T-1")
    with pytest.raises(ScenarioError, match=r"a\.xml: has a benchmarkID of 308 characters"):
        convert_commonroad(source, tmp_path / "out")


def test_a_second_conversion_leaves_no_old_episodes(tmp_path: Path) -> None:
    source = tmp_path / "files" / "a.xml"
    convert_commonroad(write_recording(source, MOTIONS), tmp_path / "out")
    convert_commonroad(write_recording(source, OTHERS), tmp_path / "out")
    assert list((tmp_path / "out" / "scenarios").iterdir()) == []


@pytest.mark.parametrize("option", [["sind", "--step", "0.1"], ["commonroad", "--map", "a.osm"]])
def test_an_option_of_the_other_format_is_refused(option: list[str], tmp_path: Path) -> None:
    name, *rest = option
    assert main(["convert", name, str(tmp_path), "--out", str(tmp_path / "out"), *rest]) == 2


# The whole way from a data set's own tables, where its converter is installed.

HIGHD = (
    Motion("1", "car", straight(0.0, -23.0, 0.0, 25.0), begin=0.04, end=14.0),
    Motion("2", "car", straight(45.0, -23.0, 0.0, 25.0), begin=0.04, end=14.0),
    Motion("3", "truck", straight(10.0, -26.6, 0.0, 22.0), begin=0.04, end=14.0, size=(12.0, 2.5)),
    Motion("4", "car", straight(400.0, -10.4, np.pi, 27.0), begin=0.04, end=14.0),
)


@pytest.fixture
def crconvert() -> Path:
    named = os.environ.get("DOSPLAN_CRCONVERT") or shutil.which("crconvert")
    if not named:
        pytest.skip(
            "commonroad-dataset-converter is not installed; docs/data-sets.md says how, and "
            "DOSPLAN_CRCONVERT names its program crconvert"
        )
    return Path(named)


def test_a_record_of_highd_becomes_episodes(crconvert: Path, tmp_path: Path) -> None:
    write_highd(tmp_path / "highD" / "data", HIGHD)
    figures = _all_the_way(crconvert, "highd", tmp_path, tmp_path / "highD")
    assert figures["files"] == 2  # One for each direction.
    assert figures["tracks"] == {"car": 3, "truck": 1}
    assert figures["scenarios"] == 3
    lower, upper = sorted((tmp_path / "out" / "recordings").iterdir())
    _is_where_they_were(load_recording(lower), HIGHD[:3], begin=0.04)
    _is_where_they_were(load_recording(upper), HIGHD[3:], begin=0.04)
    rows = _driven(tmp_path / "out" / "scenarios", "idm", tmp_path / "run")
    assert [row.outcome for row in rows] == [Outcome.SUCCESS] * 3


def test_a_record_of_ind_becomes_episodes(crconvert: Path, tmp_path: Path) -> None:
    ways = _ways_across(_maps(crconvert) / "inD" / "maps" / "DEU_AachenBendplatz-1.xml")[:3]
    cars = [
        Motion(str(n), "car", _along(way, 8.0, 10.0 * n), 10.0 * n, 10.0 * n + len(way) / 8.0 - 0.5)
        for n, way in enumerate(ways, start=1)
    ]
    walker = Motion("9", "pedestrian", straight(60.0, -20.0, 1.0, 1.2), begin=9.0, end=40.0)
    bus = Motion("8", "truck_bus", _along(ways[0], 8.0, 50.0), 50.0, 55.0, size=(12.0, 2.5))
    write_ind(tmp_path / "inD" / "data", [*cars, bus, walker])
    figures = _all_the_way(crconvert, "ind", tmp_path, tmp_path / "inD")
    assert figures["tracks"] == {"bus": 1, "car": 3, "pedestrian": 1}
    assert figures["scenarios"] == 3
    (made,) = (tmp_path / "out" / "recordings").iterdir()
    _is_where_they_were(load_recording(made), [*cars, bus, walker], begin=9.0)
    rows = _driven(tmp_path / "out" / "scenarios", "idm", tmp_path / "run")
    assert len(rows) == 3
    assert all(row.outcome is not Outcome.PLANNER_FAILURE for row in rows)


def test_a_record_of_interaction_needs_its_step(crconvert: Path, tmp_path: Path) -> None:
    """Its rows are 0.1 s apart; the converter states 0.04 s and velocities of its own."""
    ways = _ways_across(_maps(crconvert) / "INTERACTION" / "maps" / "DEU_Merging-1.xml")[:2]
    cars = [
        Motion(str(n), "car", _along(way, 8.0, 2.0 * n), 2.0 * n, 2.0 * n + len(way) / 8.0 - 0.6)
        for n, way in enumerate(ways, start=1)
    ]
    write_interaction(tmp_path / "data", cars)
    with pytest.raises(ScenarioError, match=r"its road users go .* give it with --step SECONDS"):
        _all_the_way(crconvert, "interaction", tmp_path, tmp_path / "data")
    figures = convert_commonroad(tmp_path / "commonroad", tmp_path / "out", 0.1)
    assert figures["scenarios"] == 2
    (made,) = (tmp_path / "out" / "recordings").iterdir()
    _is_where_they_were(load_recording(made), cars, begin=2.0, speed_error=0.05)


def _all_the_way(program: Path, name: str, folder: Path, source: Path) -> dict[str, Any]:
    """Through the converter, with the options that docs/data-sets.md names, and through dosplan."""
    files = folder / "commonroad"
    page = (Path(__file__).parents[2] / "docs" / "data-sets.md").read_text(encoding="utf-8")
    (options,) = re.findall(r"bin/crconvert (--.*) \\\n", page)
    command = [program, *options.split(), source, files, name]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return convert_commonroad(files, folder / "out")


def _maps(program: Path) -> Path:
    """Where the converter keeps its maps."""
    code = "import crdata.datasets as d; print(d.__path__[0])"
    found = subprocess.run(
        [program.parent / "python", "-c", code], check=True, capture_output=True, text=True
    )
    return Path(found.stdout.strip())


def _ways_across(path: Path) -> list[FloatArray]:
    """Centre lines from where a lane begins, longest first, a point each metre."""
    lanelets = {x.id: x for x in load_recording(path).road_map.lanelets}
    ways = []
    for lanelet in lanelets.values():
        chain = [lanelet]
        while chain[-1].successors and len(chain) < 9:
            chain.append(lanelets[chain[-1].successors[0]])
        if lanelet.predecessors or not lanelet.for_cars:
            continue
        line = np.concatenate([x.centre for x in chain])
        line = line[np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 0.05])]
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
        metres = np.arange(0.0, way[-1])
        ways.append(np.column_stack([np.interp(metres, way, line[:, k]) for k in (0, 1)]))
    return sorted(ways, key=len, reverse=True)


def _along(way: FloatArray, speed: float, begin: float) -> Place:
    """Along a line with a point each metre, 4 m behind its begin at first."""
    metres = np.arange(0, len(way), 5)
    curve = CubicSpline(metres, way[metres])

    def place(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        at = 4.0 + speed * (t - begin)
        (x, y), (dx, dy) = curve(at).T, curve(at, 1).T
        return x, y, np.unwrap(np.arctan2(dy, dx)), np.full_like(t, speed)

    return place


def _driven(scenarios: Path, planner: str, out: Path) -> Sequence[Any]:
    command = ["run", str(scenarios), "--planner", planner, "--predictor", "constant-velocity"]
    assert main([*command, "--without-dos", "--in-process", "--quiet", "--out", str(out)]) in (0, 1)
    return read_rows(out / "scenarios.jsonl")


def _is_where_they_were(
    scenario: Scenario, motions: Sequence[Motion], begin: float, speed_error: float = 0.002
) -> None:
    """The road users of a scenario whose step 0 is at ``begin``, s, against their motions."""
    tracks = scenario.tracks
    for motion in motions:
        (row,) = np.flatnonzero(tracks.ids == IDS + int(motion.name))
        steps = np.flatnonzero(tracks.valid[row])
        truth = motion.states(np.asarray(begin + 0.1 * steps, dtype=np.float64))
        states = tracks.states[row, steps]
        assert len(steps) > 10
        # A file has 0.1 mm; between two frames a straight line is off by a dt^2 / 8.
        np.testing.assert_allclose(states[:, :2], truth[:, :2], atol=0.003)
        turned = np.cos(states[:, 2] - truth[:, 2])
        assert turned.min() > np.cos(0.02)
        np.testing.assert_allclose(states[:, 3], truth[:, 3], atol=speed_error)


def _open(path: Path) -> Any:
    return CommonRoadFileReader(gzip.decompress(path.read_bytes()), FileFormat.XML).open()


def _first_step(path: Path, name: int) -> int:
    data = path.read_bytes()
    root = ElementTree.fromstring(gzip.decompress(data) if path.suffix == ".gz" else data)
    step = root.find(f"dynamicObstacle[@id='{IDS + name}']/initialState/time/exact")
    assert step is not None
    return int(step.text or "")
