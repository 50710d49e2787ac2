from __future__ import annotations

import dataclasses
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios, load_scenario
from dosplan.types import RoadUserKind, Scenario
from dosplan.vehicle import VehicleParameters
from tests.support import scenes
from tests.support.scenes import Goal, Problem, User, scenario_xml, write_scenario_xml

VEHICLE = VehicleParameters()


def loaded(tmp_path: Path, **kwargs: object) -> Scenario:
    return load_scenario(write_scenario_xml(tmp_path / "scene.xml", **kwargs))  # type: ignore[arg-type]


@pytest.mark.parametrize("version", ["2018b", "2020a"])
@pytest.mark.parametrize("suffix", [".xml", ".xml.gz"])
def test_versions_and_compression_give_the_same_scenario(
    tmp_path: Path, version: str, suffix: str
) -> None:
    path = write_scenario_xml(
        tmp_path / f"scene{suffix}",
        scenes.straight_road(speed_limit=13.9),
        [User(7, scenes.driving(40.0, 0.0, 5.0, 30), kind="truck")],
        version=version,
    )
    (ref,) = find_scenarios(path)
    scenario = load_scenario(ref)
    assert (ref.id, ref.problem_id, scenario.id) == ("ZAM_Test-1_1_T-1", None, "ZAM_Test-1_1_T-1")
    assert scenario.tags == {"urban"}
    assert scenario.tracks.kinds == (RoadUserKind.TRUCK,)
    # 51 steps: the goal's last one is 50; the recording has 30.
    assert scenario.tracks.states.shape == (1, 51, 4)
    assert scenario.tracks.valid.sum() == 30
    np.testing.assert_allclose(scenario.tracks.states[0, 10], [45.0, 0.0, 0.0, 5.0])
    assert {lanelet.speed_limit for lanelet in scenario.road_map.lanelets} == {13.9}
    route = scenario.task.route
    on_map = (route.path[:, 0] > 0.0) & (route.path[:, 0] < 200.0)
    np.testing.assert_array_equal(route.speed_limit, np.where(on_map, 13.9, np.inf))
    assert scenario.road_map.drivable.area == pytest.approx(200.0 * 7.0)


def test_start_is_the_centre_and_yaw_rate_gives_steering(tmp_path: Path) -> None:
    problem = Problem(start=(10.0, 0.5, 0.1, 10.0), yaw_rate=0.3)
    start = loaded(tmp_path, problems=[problem]).task.start
    np.testing.assert_allclose(VEHICLE.centre(start), [10.0, 0.5])
    # The model turns by v tan(delta) / wheelbase.
    assert VEHICLE.derivative(start, np.zeros(2))[4] == pytest.approx(0.3)
    slow = Problem(start=(10.0, 0.0, 0.0, 0.9), yaw_rate=0.3)
    slowly = loaded(tmp_path, problems=[slow]).task.start
    assert VEHICLE.derivative(slowly, np.zeros(2))[4] == pytest.approx(0.3)
    standing = Problem(start=(10.0, 0.0, 0.0, 0.05), yaw_rate=0.3)
    assert loaded(tmp_path, problems=[standing]).task.start[2] == 0.0
    spinning = Problem(start=(10.0, 0.0, 0.0, 1.1), yaw_rate=9.0)
    assert loaded(tmp_path, problems=[spinning]).task.start[2] == VEHICLE.max_steering


@pytest.mark.parametrize(("heading", "turned"), [(0.0, True), (1.0, False)])
def test_wheels_are_turned_along_a_bend_where_no_yaw_rate_is_given(
    tmp_path: Path, heading: float, turned: bool
) -> None:
    """An arc of 20 m radius asks for atan(2.579 / 20), one across it for nothing."""
    bend = scenes.curve(radius=20.0)
    x, y = 50.0 + 20.0 * np.sin(0.8), 20.0 * (1.0 - np.cos(0.8))
    problem = Problem(start=(x, y, 0.8 + heading, 5.0), yaw_rate=0.0)
    start = loaded(tmp_path, lanes=bend, problems=[problem]).task.start
    expected = np.arctan(VEHICLE.wheelbase / 20.0) if turned else 0.0
    assert start[2] == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 2])
def test_wheels_are_turned_no_further_than_the_road_can_be_kept(
    tmp_path: Path, angle: float
) -> None:
    """At 7.5 m/s into a bend of 6.25 m, beside its inner edge and turned inwards already."""
    bend = scenes.curve(radius=6.25, angle=angle)
    side = np.sign(angle)
    problem = Problem(start=(50.9, side * 0.89, side * 0.262, 7.5), yaw_rate=0.0)
    start = loaded(tmp_path, lanes=bend, problems=[problem]).task.start
    outside = replace(problem, start=(50.9, 0.0, side * 0.1, 7.5))
    free = loaded(tmp_path, lanes=bend, problems=[outside]).task.start
    assert 0.0 < side * start[2] < side * free[2] - 0.01


@pytest.mark.parametrize("heading", [0.0, np.pi / 4, np.pi / 2, -np.pi / 2, np.pi])
def test_speed_is_the_files_whatever_the_heading(tmp_path: Path, heading: float) -> None:
    """The file names one speed, along the body: it must not grow by its share along the y axis."""
    text = scenario_xml(
        scenes.straight_road(), [User(7, scenes.driving(60.0, 0.0, 8.0, 20, heading))]
    )
    told = "</velocity><acceleration><exact>0.0</exact></acceleration></state>"
    path = tmp_path / "accelerated.xml"
    path.write_text(text.replace("</velocity></state>", told))
    np.testing.assert_allclose(load_scenario(path).tracks.states[0, :20, 3], 8.0)


def test_speed_across_the_body_counts_where_the_file_names_it(tmp_path: Path) -> None:
    """3 m/s along and 4 m/s across are 5 m/s."""
    text = scenario_xml(scenes.straight_road(), [User(7, scenes.driving(50.0, 0.0, 3.0, 20))])
    head, _, tail = text.partition("<trajectory>")
    told = "</velocity><velocityY><exact>4.0</exact></velocityY></state>"
    path = tmp_path / "across.xml"
    path.write_text(f"{head}<trajectory>{tail.replace('</velocity></state>', told)}")
    np.testing.assert_allclose(load_scenario(path).tracks.states[0, 1:20, 3], 5.0)


def test_speeds_of_the_suite_are_displacements_per_step() -> None:
    """The middle step of three: (p(t + 1) - p(t - 1)) / 2 dt is v(t) to the second order."""
    for ref in find_scenarios("suite-1")[::50]:
        scenario = load_scenario(ref, cached=True)
        states, valid = scenario.tracks.states, scenario.tracks.valid
        passed = np.linalg.norm(states[:, 2:, :2] - states[:, :-2, :2], axis=-1) / 0.2
        speed = states[:, 1:-1, 3]
        drives = valid[:, 2:] & valid[:, 1:-1] & valid[:, :-2] & (speed > 3.0)
        assert drives.sum() > 100, ref.id
        ratio = passed[drives] / speed[drives]
        assert np.median(ratio) == pytest.approx(1.0, abs=0.01), ref.id
        # A jump to the next lane or into the scene is one step of hundreds.
        assert np.mean(np.abs(ratio - 1.0) < 0.05) > 0.95, ref.id


def test_several_planning_problems_are_several_episodes(tmp_path: Path) -> None:
    problems = [Problem(5, (10.0, 0.0, 0.0, 8.0)), Problem(9, (20.0, 3.5, 0.0, 9.0))]
    path = write_scenario_xml(tmp_path / "two.xml", problems=problems)
    refs = find_scenarios(tmp_path)
    assert [ref.id for ref in refs] == ["ZAM_Test-1_1_T-1@5", "ZAM_Test-1_1_T-1@9"]
    scenarios = [load_scenario(ref) for ref in refs]
    assert [s.id for s in scenarios] == [ref.id for ref in refs]
    assert [s.problem_id for s in scenarios] == [5, 9]
    assert scenarios[1].task.start[3] == 9.0
    with pytest.raises(ScenarioError, match="5, 9; name one"):
        load_scenario(path)
    with pytest.raises(ScenarioError, match="no planning problem 6"):
        load_scenario(ScenarioRef(path, "x", 6))


@pytest.mark.parametrize(
    ("position", "inside", "outside"),
    [
        (scenes.rectangle(10.0, 2.0, 60.0, 0.0, np.pi / 2), (60.9, 4.9), (61.1, 0.0)),
        (scenes.circle(3.0, 60.0, 0.0), (62.9, 0.0), (63.1, 0.0)),
        (scenes.polygon([[50, -1], [60, -1], [60, 1]]), (59.0, 0.5), (51.0, 0.5)),
        (
            scenes.circle(1.0, 60.0, 0.0) + scenes.rectangle(2.0, 2.0, 70.0, 0.0),
            (70.9, 0.9),
            (65.0, 0.0),
        ),
        (scenes.on_lanelets(101), (60.0, 1.9), (60.0, 1.6)),
    ],
)
def test_goal_areas(
    tmp_path: Path, position: str, inside: tuple[float, float], outside: tuple[float, float]
) -> None:
    import shapely

    goal = Goal(20, 40, position, heading=(-0.2, 0.3), velocity=(5.0, 12.0))
    task = loaded(tmp_path, problems=[Problem(goals=(goal, Goal(5, 60)))]).task
    first, second = task.goals
    assert first.region is not None
    assert shapely.contains_xy(first.region, *inside)
    assert not shapely.contains_xy(first.region, *outside)
    assert (first.first_step, first.last_step) == (20, 40)
    assert first.heading == pytest.approx((-0.2, 0.3))
    assert first.velocity == (5.0, 12.0)
    assert dataclasses.astuple(second) == (5, 60, None, None, None)
    assert task.final_step == 60


def test_goal_at_an_exact_time(tmp_path: Path) -> None:
    goal = Goal(last_step=33, exact_time=True)
    (read,) = loaded(tmp_path, problems=[Problem(goals=(goal,))]).task.goals
    assert (read.first_step, read.last_step) == (33, 33)


def test_shape_that_is_offset_and_turned(tmp_path: Path) -> None:
    # Reference point (50, 0) heading north; the body lies 2 m ahead of it, turned by 0.5.
    user = User(
        7, [(50.0, 0.0, np.pi / 2, 1.0)] * 2, shape=scenes.rectangle(4.0, 2.0, 2.0, 0.0, 0.5)
    )
    tracks = loaded(tmp_path, users=[user]).tracks
    np.testing.assert_allclose(tracks.states[0, 0], [50.0, 2.0, np.pi / 2 + 0.5, 1.0], atol=1e-12)
    assert tracks.outlines == (None,)


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (scenes.circle(0.4), (0.8, 0.8)),
        (scenes.polygon([[-1, -0.5], [1, -0.5], [0, 0.5]]), (2.0, 1.0)),
        (scenes.rectangle(2.0, 1.0, 1.0) + scenes.rectangle(2.0, 1.0, -1.0), (4.0, 1.0)),
    ],
)
def test_other_shapes_have_outlines_that_fill_their_box(
    tmp_path: Path, shape: str, size: tuple[float, float]
) -> None:
    user = User(7, [(50.0, 0.0, 0.0, 0.0)] * 2, shape=shape, kind="pedestrian")
    tracks = loaded(tmp_path, users=[user]).tracks
    outline = tracks.outlines[0]
    assert outline is not None
    assert tracks.kinds == (RoadUserKind.PEDESTRIAN,)
    np.testing.assert_allclose(tracks.size[0], size, rtol=0.006)
    np.testing.assert_allclose(np.ptp(outline, axis=0), tracks.size[0])
    np.testing.assert_allclose(outline.max(axis=0), -outline.min(axis=0))


def test_static_obstacle_is_there_at_every_step(tmp_path: Path) -> None:
    users = [
        User(7, [(50.0, 0.0, 0.2, 0.0)], kind="parkedVehicle", static=True),
        User(8, [(60.0, 0.0, 0.2, 0.0)], kind="constructionZone", static=True),
    ]
    tracks = loaded(tmp_path, users=users).tracks
    assert tracks.kinds == (RoadUserKind.PARKED, RoadUserKind.STATIC)
    assert tracks.valid.all()
    np.testing.assert_allclose(tracks.states[0], np.tile([50.0, 0.0, 0.2, 0.0], (51, 1)))


def test_missing_heading_and_velocity_are_derived(tmp_path: Path) -> None:
    full = scenes.driving(40.0, 0.0, 6.0, 20, heading=0.3)
    bare = [(x, y, None, None) for x, y, _, _ in full]
    tracks = loaded(tmp_path, users=[User(7, bare), User(8, full)]).tracks
    np.testing.assert_allclose(tracks.states[0, :20], tracks.states[1, :20], atol=1e-9)


@pytest.mark.parametrize("dt", [0.02, 0.04, 0.05, 0.1, 0.2, 0.25, 0.5])
def test_other_steps_are_resampled_exactly(tmp_path: Path, dt: float) -> None:
    # 6 s at 7 m/s, heading turning through pi at 0.5 rad/s; file steps of dt.
    time = dt * np.arange(round(6.0 / dt) + 1)
    states = [
        (50.0 + 7.0 * t, 0.0, float((2.5 + 0.5 * t + np.pi) % (2 * np.pi) - np.pi), 7.0)
        for t in time
    ]
    goal = Goal(round(2.0 / dt), round(5.0 / dt))
    scenario = loaded(tmp_path, dt=dt, users=[User(7, states)], problems=[Problem(goals=(goal,))])
    read = scenario.tracks.states[0]
    new = 0.1 * np.arange(61)
    assert scenario.dt == 0.1
    assert (scenario.task.goals[0].first_step, scenario.task.goals[0].last_step) == (20, 50)
    np.testing.assert_allclose(read[:, 0], 50.0 + 7.0 * new)
    np.testing.assert_allclose(np.exp(1j * read[:, 2]), np.exp(1j * (2.5 + 0.5 * new)))


def test_lanelets_of_a_network_with_missing_links(tmp_path: Path) -> None:
    lane = dataclasses.replace(
        scenes.straight_lane(1, (0, 0, 0), 100), successors=(99,), left_neighbour=(98, True)
    )
    (read,) = loaded(tmp_path, lanes=[lane]).road_map.lanelets
    assert (read.successors, read.left_neighbour) == ((), None)


def test_reading_leaves_the_console_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_scenario_xml(
        tmp_path / "a.xml", scenes.straight_road(speed_limit=9.0), benchmark_id="Odd name"
    )
    load_scenario(path)
    assert capfd.readouterr() == ("", "")


GOOD = scenario_xml(scenes.straight_road(), [User(7, scenes.driving(50.0, 0.0, 5.0, 5))])
BAD = {
    "empty": "",
    "no XML": "hello",
    "cut": GOOD[: len(GOOD) // 2],
    "document type": GOOD.replace("?>", '?>\n<!DOCTYPE a [<!ENTITY b "c">]>', 1),
    "another root": "<CommonRoadSolution/>",
    "version": GOOD.replace("2020a", "2017a"),
    "no benchmark id": GOOD.replace("benchmarkID=", "name="),
    "no planning problem": scenario_xml(scenes.straight_road(), problems=()),
    "no lanelets": scenario_xml(()),
    "lanelet twice": scenario_xml([*scenes.straight_road(), scenes.straight_road()[0]]),
    "NaN": GOOD.replace("<x>50.0</x>", "<x>NaN</x>"),
    "infinite": GOOD.replace("<x>50.0</x>", "<x>1e999</x>"),
    "text for a number": GOOD.replace("<x>50.0</x>", "<x>fifty</x>"),
    "text for a step": GOOD.replace('timeStepSize="0.1"', 'timeStepSize="fast"'),
    "step of a minute": GOOD.replace('timeStepSize="0.1"', 'timeStepSize="60"'),
    "no step": GOOD.replace('timeStepSize="0.1"', ""),
    "zero step": GOOD.replace('timeStepSize="0.1"', 'timeStepSize="0"'),
    "set-based": re.sub(
        "<trajectory>.*</trajectory>",
        "<occupancySet><occupancy><shape><circle><radius>1</radius></circle></shape>"
        "<time><exact>1</exact></time></occupancy></occupancySet>",
        GOOD,
    ),
    "far start": scenario_xml(scenes.straight_road(), problems=[Problem(start=(90.0, 40.0, 0, 5))]),
    "no start velocity": re.sub(r"(<planningProblem.*?)<velocity>.*?</velocity>", r"\1", GOOD),
    "reversing start": scenario_xml(
        scenes.straight_road(), problems=[Problem(start=(10.0, 0.0, 0.0, -0.1))]
    ),
    "start beyond top speed": scenario_xml(
        scenes.straight_road(), problems=[Problem(start=(10.0, 0.0, 0.0, 50.9))]
    ),
    "no lane for cars": scenario_xml(
        [dataclasses.replace(x, kind="sidewalk") for x in scenes.straight_road()]
    ),
    "id of a two-way lanelet": scenario_xml(
        [dataclasses.replace(x, bidirectional=True) for x in scenes.straight_road()]
    ).replace('<lanelet id="100"', '<lanelet id="one"'),
    "id of a user without heading": scenario_xml(
        scenes.straight_road(), [User(7, [(50.0, 0.0, None, 5.0)] * 5)]
    ).replace('<dynamicObstacle id="7"', '<dynamicObstacle id=""'),
    "goal before start": scenario_xml(scenes.straight_road(), problems=[Problem(start_step=60)]),
    "endless": scenario_xml(scenes.straight_road(), problems=[Problem(goals=(Goal(0, 10**8),))]),
    "goal on no lanelet": scenario_xml(
        scenes.straight_road(), problems=[Problem(goals=(Goal(position=scenes.on_lanelets(5)),))]
    ),
    "user twice": scenario_xml(
        scenes.straight_road(), [User(7, scenes.driving(50.0, 0.0, 5.0, 5))] * 2
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line_and_still_listed(tmp_path: Path, name: str) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(BAD[name])
    (ref,) = find_scenarios(path)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(ref)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message


@pytest.mark.parametrize("velocity", [0.0, 50.8])
def test_starts_at_the_limits_are_taken(tmp_path: Path, velocity: float) -> None:
    problem = Problem(start=(10.0, 0.0, 0.0, velocity))
    assert loaded(tmp_path, problems=[problem]).task.start[3] == velocity


@pytest.mark.parametrize("value", ["NaN", " -inf\n", "nan<!-- a remark -->", "<!-- x -->Infinity"])
def test_a_value_that_is_not_finite_is_named(tmp_path: Path, value: str) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(GOOD.replace("<x>50.0</x>", f"<x>{value}</x>"))
    with pytest.raises(ScenarioError, match=r"lanelet 100: the <x> is .*no finite number"):
        load_scenario(path)


def test_a_comment_may_say_what_it_likes(tmp_path: Path) -> None:
    path = tmp_path / "good.xml"
    path.write_text(GOOD.replace("<lanelet ", "<!-- was <x>NaN</x> --><lanelet ", 1))
    assert load_scenario(path).tracks.ids.tolist() == [7]


def test_bad_compression(tmp_path: Path) -> None:
    whole = write_scenario_xml(tmp_path / "good.xml.gz").read_bytes()
    for data in (whole[:-20], b"not gzip", whole[:30] + b"\0\0\0" + whole[33:]):
        path = tmp_path / "bad.xml.gz"
        path.write_bytes(data)
        assert find_scenarios(path) == [ScenarioRef(path, "bad")]
        with pytest.raises(ScenarioError):
            load_scenario(path)


def test_folder_is_searched_sorted_and_without_solutions(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    write_scenario_xml(tmp_path / "b" / "1.xml", benchmark_id="ZAM_B-1_1_T-1")
    write_scenario_xml(tmp_path / "c.xml.gz", benchmark_id="ZAM_A-1_1_T-1")
    (tmp_path / "b" / "2.xml").write_text("<commonRoad")
    (tmp_path / "b" / "solution.xml").write_text("<CommonRoadSolution/>")
    (tmp_path / "notes.txt").write_text("x")
    assert [ref.id for ref in find_scenarios(tmp_path)] == ["ZAM_B-1_1_T-1", "2", "ZAM_A-1_1_T-1"]


def test_nothing_found(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="holds no scenario"):
        find_scenarios(tmp_path)
    with pytest.raises(ScenarioError, match="does not exist"):
        find_scenarios(tmp_path / "absent")


def test_suite_lists_its_manifest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dosplan.scenario.sources import catalogue

    package = tmp_path / "dosplan"
    package.mkdir()
    module = package / "scenario" / "sources" / "catalogue.py"
    folder = tmp_path / "scenarios" / "suite-1"
    folder.mkdir(parents=True)
    manifest = "id,file,sha256\nZAM_X-1_1_T-1,files/x.xml.gz,0\nZAM_Y-1_1_T-1@4,files/y.xml.gz,0\n"
    (folder / "manifest.csv").write_text(manifest)
    monkeypatch.setattr(catalogue, "__file__", str(module))
    assert find_scenarios("suite-1") == [
        ScenarioRef(folder / "files" / "x.xml.gz", "ZAM_X-1_1_T-1"),
        ScenarioRef(folder / "files" / "y.xml.gz", "ZAM_Y-1_1_T-1@4", 4),
    ]
    with pytest.raises(ScenarioError, match=r"suite.manifest\.csv: cannot be read"):
        find_scenarios("suite")
    installed = package / "_suites" / "suite"
    installed.mkdir(parents=True)
    (installed / "manifest.csv").write_text("id,file,sha256\nZAM_Z-1_1_T-1,z.xml,0\n")
    assert find_scenarios("suite") == [ScenarioRef(installed / "z.xml", "ZAM_Z-1_1_T-1")]


@pytest.mark.slow
@pytest.mark.parametrize("part", ["train", "val", "bench"])
def test_recorded_files_load_or_are_refused_in_one_line(part: str) -> None:
    root = os.environ.get("DOSPLAN_DATA")
    if root is None:
        pytest.skip("DOSPLAN_DATA is not set")
    refs = find_scenarios(Path(root) / "commonroad" / part)
    refused = []
    for ref in refs:
        try:
            assert load_scenario(ref).id == ref.id
        except ScenarioError as error:
            refused.append(str(error))
    assert not any("\n" in line for line in refused)
    assert len(refused) <= 0.01 * len(refs), refused
