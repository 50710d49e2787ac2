"""Files as people have them: what is read otherwise than written, left out, or told in one line."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import shapely

from dosplan.geometry import rectangle_corners, to_world
from dosplan.scenario import ScenarioError, load_recording, load_scenario
from dosplan.scenario.commonroad.reader import VELOCITY_SLACK
from dosplan.scoring.bounds import outside
from dosplan.types import Scenario, Tracks
from tests.support import scenes
from tests.support.scenes import Goal, Problem, User, scenario_xml, write_scenario_xml

Points = npt.NDArray[np.float64]
CAR = User(7, scenes.driving(60.0, 0.0, 5.0, 30))


def loaded(tmp_path: Path, **kwargs: object) -> Scenario:
    return load_scenario(write_scenario_xml(tmp_path / "scene.xml", **kwargs))  # type: ignore[arg-type]


def from_text(tmp_path: Path, text: str) -> Scenario:
    path = tmp_path / "scene.xml"
    path.write_text(text)
    return load_scenario(path)


def refusal(tmp_path: Path, text: str) -> str:
    """What is said of a file, without the path; in words that are no library's."""
    path = tmp_path / "scene.xml"
    path.write_text(text)
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert not re.search(r"\w+Error\b|Traceback|None|object has|commonroad\.|GEOS", line), line
    return line.removeprefix(f"{path}: ")


# Speed limits.


@pytest.mark.parametrize(
    ("sign", "value", "limit"),
    [
        ("274", "13.9", 13.9),
        ("274", "50kmh", 50 / 3.6),
        ("274", " 50 km/h ", 50 / 3.6),
        ("274", "50,0 KM/H", 50 / 3.6),
        ("274", "25mph", 25 * 0.44704),
        ("R2-1", "25 mph", 25 * 0.44704),
        ("274", "1.39e1 m/s", 13.9),
        ("274", "inf", None),
        ("274", "none", None),
        ("274.1", None, 30 / 3.6),
        ("274.1", "8.33", 8.33),
        ("274.1-20", None, 20 / 3.6),
        ("274-50", "13.9", 13.9),
        ("274.2", "8.33", None),
        ("205", "8.33", None),
    ],
)
def test_what_a_sign_says_is_the_limit(
    tmp_path: Path, sign: str, value: str | None, limit: float | None
) -> None:
    text = scenario_xml(scenes.straight_road(speed_limit=9.0))
    told = "" if value is None else f"<additionalValue>{value}</additionalValue>"
    text = text.replace("<additionalValue>9.0</additionalValue>", told)
    scenario = from_text(tmp_path, text.replace(">274<", f">{sign}<"))
    for lanelet in scenario.road_map.lanelets:
        assert lanelet.speed_limit == (None if limit is None else pytest.approx(limit))
    assert scenario.notes == ()


@pytest.mark.parametrize("value", ["fast", "50 furlongs", "-9.0", "0", "", "1e30"])
def test_a_limit_that_cannot_be_read_is_none_and_noted(tmp_path: Path, value: str) -> None:
    text = scenario_xml(scenes.straight_road(lanes=1, speed_limit=9.0))
    scenario = from_text(tmp_path, text.replace(">9.0<", f">{value}<"))
    assert scenario.road_map.lanelets[0].speed_limit is None
    assert np.all(np.isinf(scenario.task.route.speed_limit))
    (note,) = scenario.notes
    assert note.startswith("traffic sign 90100: its speed limit ")


def test_a_limit_of_the_old_format_has_its_unit_too(tmp_path: Path) -> None:
    text = scenario_xml(scenes.straight_road(lanes=1, speed_limit=9.0), version="2018b")
    lanelet = from_text(tmp_path, text.replace(">9.0<", ">50kmh<")).road_map.lanelets[0]
    assert lanelet.speed_limit == pytest.approx(50 / 3.6)


# Parts that nobody reads.


UNREAD = {
    "a light at infinity": (
        "<planningProblem",
        '<trafficLight id="800"><cycle><cycleElement><duration>x</duration><color>pink</color>'
        "</cycleElement></cycle><position><point><x>inf</x><y>inf</y></point></position>"
        "</trafficLight><planningProblem",
    ),
    "incomings of one id": (
        "<planningProblem",
        '<intersection id="801"><incoming id="5"/></intersection>'
        '<intersection id="802"><incoming id="5"><incomingLanelet ref="no"/></incoming>'
        "</intersection><planningProblem",
    ),
    "an unknown marking": ("</leftBound>", "<lineMarking>zigzag</lineMarking></leftBound>"),
    "an unknown lanelet type": ("<laneletType>urban<", "<laneletType>boulevard<"),
    "a stop line without a marking": ("<laneletType>", "<stopLine/><laneletType>"),
    "an unknown obstacle type": ("<type>car<", "<type>hovercraft<"),
    "no obstacle type": ("<type>car</type>", ""),
    "no tags": ("<scenarioTags><urban/></scenarioTags>", ""),
    "unknown tags": ("<urban/>", "<urban/><holiday/>"),
    "no location": ("<location>", "<place>"),
    "half a location": ("<gpsLatitude>999</gpsLatitude>", ""),
    "no author": (' author="none"', ""),
    "no date": (' date="2020-01-01"', ""),
    "a sign that no lanelet names": (
        "<planningProblem",
        '<trafficSign id="90"><trafficSignElement/></trafficSign><planningProblem',
    ),
    "a sign of no number": (
        "<planningProblem",
        '<trafficSign id="first"><trafficSignElement><trafficSignID>274</trafficSignID>'
        "<additionalValue>5</additionalValue></trafficSignElement></trafficSign><planningProblem",
    ),
    "a reference to no number": ("<laneletType>", '<trafficSignRef ref="x"/><laneletType>'),
    "a blinker": (
        "<trajectory>",
        "<initialSignalState><horn>maybe</horn></initialSignalState><trajectory>",
    ),
}


@pytest.mark.parametrize("name", UNREAD)
def test_parts_that_nobody_reads_make_no_file_unreadable(tmp_path: Path, name: str) -> None:
    before, after = UNREAD[name]
    text = scenario_xml(scenes.straight_road(), [CAR])
    assert before in text
    changed = text.replace(before, after)
    if name == "no location":
        changed = changed.replace("</location>", "</place>")
    plain, read = load_scenario(_written(tmp_path, text)), from_text(tmp_path, changed)
    np.testing.assert_array_equal(read.task.route.path, plain.task.route.path)
    np.testing.assert_array_equal(read.tracks.states, plain.tracks.states)


def _written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "plain.xml"
    path.write_text(text)
    return path


# Lanelets.


@pytest.mark.parametrize("given", ["successors", "predecessors"])
def test_links_are_completed_from_either_side(tmp_path: Path, given: str) -> None:
    lanes = [
        replace(lane, predecessors=()) if given == "successors" else replace(lane, successors=())
        for lane in scenes.curve()
    ]
    end = Goal(position=scenes.on_lanelets(3))
    scenario = loaded(tmp_path, lanes=lanes, problems=[Problem(goals=(end,))])
    assert scenario.task.route.lanelet_ids == (1, 2, 3)
    links = [(x.predecessors, x.successors) for x in scenario.road_map.lanelets]
    assert links == [((), (2,)), ((1,), (3,)), ((2,), ())]


@pytest.mark.parametrize("given", ["left", "right"])
def test_neighbours_are_completed_from_either_side(tmp_path: Path, given: str) -> None:
    lanes = [
        replace(lane, right_neighbour=None)
        if given == "left"
        else replace(lane, left_neighbour=None)
        for lane in scenes.straight_road()
    ]
    right, left = loaded(tmp_path, lanes=lanes).road_map.lanelets
    assert (right.left_neighbour, right.right_neighbour) == (101, None)
    assert (left.left_neighbour, left.right_neighbour) == (None, 100)


def test_a_ring_of_one_lanelet_is_driven_round(tmp_path: Path) -> None:
    ring = scenes.arc_lane(1, (0.0, 0.0, 0.0), 25.0, 2 * np.pi, points=91, successors=(1,))
    # From a sixth of the ring before the seam to a sixth behind it.
    x, y = 25.0 * np.sin(-np.pi / 3), 25.0 - 25.0 * np.cos(-np.pi / 3)
    goal = Goal(0, 300, scenes.circle(2.0, -x, y))
    problem = Problem(start=(x, y, -np.pi / 3, 7.0), goals=(goal,))
    route = loaded(tmp_path, lanes=[ring], problems=[problem]).task.route
    # From the seam on, which lies some metres before the ego's first one, over two laps at least.
    driven = route.path[100 : 100 + round(2 * np.pi * 25.0 / 0.5 * 2)]
    around = np.hypot(driven[:, 0], driven[:, 1] - 25.0)
    assert np.abs(around - 25.0).max() < 0.3
    beyond = np.hypot(*(route.path - np.array([-x, y])).T)
    assert beyond.min() < 1.0


def test_bounds_of_different_counts_are_matched_by_length(tmp_path: Path) -> None:
    bend = scenes.curve()
    lanes = [replace(lane, right=lane.right[::2]) for lane in bend]
    plain = loaded(tmp_path, lanes=bend)
    read = loaded(tmp_path, lanes=lanes)
    assert len(read.notes) == 3
    assert "lanelet 1: its bounds have 11 and 6 points" in read.notes[0]
    for given, lanelet in zip(lanes, read.road_map.lanelets, strict=True):
        line = shapely.LineString(lanelet.right)
        assert shapely.hausdorff_distance(line, shapely.LineString(given.right)) < 1e-9
    # Half the points of an arc of 30 m: the chords are 2 cm inside it.
    assert (
        np.abs(read.task.route.path - plain.task.route.path[: len(read.task.route.path)]).max()
        < 0.2
    )


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_bound_that_runs_against_the_other_is_turned(tmp_path: Path, side: str) -> None:
    bend = scenes.curve()
    lanes = [bend[0], replace(bend[1], **{side: getattr(bend[1], side)[::-1]}), bend[2]]
    plain, read = loaded(tmp_path, lanes=bend), loaded(tmp_path, lanes=lanes)
    np.testing.assert_array_equal(read.road_map.lanelets[1].left, plain.road_map.lanelets[1].left)
    np.testing.assert_array_equal(read.road_map.lanelets[1].right, plain.road_map.lanelets[1].right)
    assert read.notes == ("lanelet 2: its bounds run against each other; one was turned",)


# Goals.


@pytest.mark.parametrize(
    ("heading", "read"),
    [
        ((-3.14159, 3.14159), None),
        ((-np.pi, np.pi), None),
        ((0.0, 7.0), None),
        ((-20.0, 20.0), None),
        ((-3.0, 3.0), (-3.0, 3.0)),
        ((3.0, 3.5), (3.0, 3.5)),
    ],
)
def test_a_full_turn_is_any_heading(
    tmp_path: Path, heading: tuple[float, float], read: tuple[float, float] | None
) -> None:
    goal = Goal(heading=heading)
    assert loaded(tmp_path, problems=[Problem(goals=(goal,))]).task.goals[0].heading == read


@pytest.mark.parametrize("velocity", [0.0, 8.0])
def test_one_exact_velocity_has_slack(tmp_path: Path, velocity: float) -> None:
    text = scenario_xml(scenes.straight_road(), problems=[Problem(goals=(Goal(velocity=(1, 2)),))])
    interval = "<intervalStart>1</intervalStart><intervalEnd>2</intervalEnd>"
    (goal,) = from_text(tmp_path, text.replace(interval, f"<exact>{velocity}</exact>")).task.goals
    assert goal.velocity == pytest.approx((velocity - VELOCITY_SLACK, velocity + VELOCITY_SLACK))
    (goal,) = from_text(tmp_path, text).task.goals
    assert goal.velocity == (1.0, 2.0)


# Time.


@pytest.mark.parametrize("dt", [0.04, 0.03, 1 / 30, 0.15])
def test_any_step_is_resampled(tmp_path: Path, dt: float) -> None:
    """A car with a heading that turns through pi, by 0.5 rad/s, at 7 m/s along x, from 0.6 s on."""
    first = round(0.6 / dt)
    time = dt * np.arange(first, round(6.0 / dt) + 1)
    turned = (2.5 + 0.5 * time + np.pi) % (2 * np.pi) - np.pi
    states = [(50.0 + 7.0 * t, 0.0, float(h), 7.0) for t, h in zip(time, turned, strict=True)]
    goal = Goal(round(2.1 / dt), round(5.1 / dt))
    user, problem = User(7, states, first_step=first), Problem(goals=(goal,))
    scenario = loaded(tmp_path, dt=dt, users=[user], problems=[problem])
    valid = scenario.tracks.valid[0]
    new = 0.1 * np.flatnonzero(valid)
    # On the scene from the first new step at or after its first state to the last within.
    assert (new[0], new[-1]) == pytest.approx(
        (0.1 * np.ceil(time[0] / 0.1 - 1e-6), 0.1 * np.floor(time[-1] / 0.1 + 1e-6))
    )
    np.testing.assert_allclose(scenario.tracks.states[0, valid, 0], 50.0 + 7.0 * new)
    read = scenario.tracks.states[0, valid, 2]
    np.testing.assert_allclose(np.exp(1j * read), np.exp(1j * (2.5 + 0.5 * new)), atol=1e-9)
    (counts,) = scenario.task.goals
    assert 0.1 * counts.first_step == pytest.approx(2.1, abs=0.1 + dt)
    assert goal.first_step * dt <= 0.1 * counts.first_step + 1e-6
    assert 0.1 * counts.last_step <= goal.last_step * dt + 1e-6


def test_an_ego_that_starts_between_two_steps_starts_at_one(tmp_path: Path) -> None:
    """At step 7 of 0.04 s, 0.28 s, others are where they are then, and goals count from then on."""
    states = [(50.0 + 0.28 * k, 0.0, 0.0, 7.0) for k in range(150)]
    problem = Problem(start_step=7, goals=(Goal(7 + 25, 7 + 100),))
    scenario = loaded(tmp_path, dt=0.04, users=[User(7, states)], problems=[problem])
    begin, goal = scenario.task.start_step, scenario.task.goals[0]
    assert scenario.tracks.states[0, begin, 0] == pytest.approx(50.0 + 7.0 * 0.28)
    assert (goal.first_step - begin, goal.last_step - begin) == (10, 40)


def test_a_step_given_twice_is_taken_once_where_both_are_alike(tmp_path: Path) -> None:
    plain = scenario_xml(scenes.straight_road(), [CAR])
    (state,) = re.findall(r"<state><position>(?:(?!</state>).)*<exact>9</exact>.*?</state>", plain)
    twice = from_text(tmp_path, plain.replace(state, state + state)).tracks
    np.testing.assert_array_equal(twice.states, from_text(tmp_path, plain).tracks.states)
    unlike = state + state.replace("<y>0.0</y>", "<y>0.5</y>")
    assert refusal(tmp_path, plain.replace(state, unlike)) == (
        "obstacle 7: it has two different states at step 9; remove one of them"
    )


# Road users without a trajectory.


def _alone(name: int, x: float, velocity: float | None, y: float = 0.0) -> User:
    return User(name, [(x, y, 0.0, velocity)])


def test_who_stands_without_a_trajectory_stays(tmp_path: Path) -> None:
    tracks = loaded(tmp_path, users=[_alone(8, 90.0, 0.05), _alone(9, 99.0, None)]).tracks
    assert tracks.valid.all()
    np.testing.assert_array_equal(tracks.states[:, :, 0], np.tile([[90.0], [99.0]], (1, 51)))
    np.testing.assert_array_equal(tracks.states[:, :, 3], 0.0)


def test_who_moves_without_a_trajectory_has_left_a_recording(tmp_path: Path) -> None:
    tracks = loaded(tmp_path, users=[CAR, _alone(8, 90.0, 9.0), _alone(9, 99.0, 0.0)]).tracks
    assert tracks.valid.sum(axis=1).tolist() == [30, 1, 51]


def test_interactive_traffic_is_no_recording(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, users=[_alone(8, 90.0, 0.0), _alone(9, 99.0, 8.0)])
    assert scenario.interactive
    assert scenario.tracks.valid[:, 0].all()
    with pytest.raises(ScenarioError, match=r"first states .* --traffic sumo"):
        load_recording(tmp_path / "scene.xml")
    assert not loaded(tmp_path, users=[CAR, _alone(9, 99.0, 8.0)]).interactive


# One line that names the part.

_START = '<planningProblem id="1000"><initialState>'


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("<time><intervalStart>0</intervalStart><intervalEnd>50</intervalEnd></time>", "",
         "planning problem 1000: goal 1: it has no <time>; add"),
        ("<goalState>.*</goalState>", "", "planning problem 1000: it has no <goalState>; add"),
        ("<goalState>", '<goalState><position><lanelet ref="555"/></position>',
         "planning problem 1000: goal 1: it names lanelet 555, which the map does not hold"),
        ("<goalState>", "<goalState><position><point><x>1</x><y>1</y></point></position>",
         "planning problem 1000: goal 1: it asks for a single <point>"),
        ("<intervalStart>0</intervalStart>", "<intervalStart>60</intervalStart>",
         "planning problem 1000: goal 1: the <time> goes from 60 to 50; swap the two"),
        ("<goalState>", "<goalState><orientation><intervalStart>3</intervalStart>"
         "<intervalEnd>-3</intervalEnd></orientation>",
         "planning problem 1000: goal 1: the <orientation> goes from 3 to -3; add 2 pi to the end"),
        ("<rectangle>.*?</rectangle>", '<lanelet ref="100"/>',
         "obstacle 7: the <shape> holds <lanelet> and no shape"),
        (f"{_START}<position>.*?</position>", _START,
         "planning problem 1000: its initial state: it has no <position>; add it"),
        ("<leftBound>.*?</leftBound>", "<leftBound/>",
         "lanelet 100: its <leftBound> has fewer than two points"),
        ("<leftBound>.*?</leftBound>", "", "lanelet 100: it has no <leftBound>; add it"),
        ("<x>62.0</x>", "<x>far</x>",
         "obstacle 7: state 4 of its trajectory: the <x> is 'far', no number"),
        ("<length>4.5</length>", "", "obstacle 7: it has no <length>; add it"),
        ("<rectangle>.*?</rectangle>", "", "obstacle 7: the <shape> is empty"),
        ("<rectangle>.*?</rectangle>", scenes.polygon([[0, 0], [1, 1]]),
         "obstacle 7: a <polygon> has 2 points"),
        ('<dynamicObstacle id="7">', '<dynamicObstacle id="seven">', "obstacle has the id 'seven'"),
        ('timeStepSize="0.1"', 'timeStepSize="-3"', "its timeStepSize is -3 s; give it a length"),
        ('timeStepSize="0.1"', 'timeStepSize="a"', "its timeStepSize is 'a', no number"),
        (' commonRoadVersion="2020a"', "", "names no commonRoadVersion; it may be 2018b or 2020a"),
        ('commonRoadVersion="2020a"', 'commonRoadVersion="2024a"',
         "has CommonRoad version 2024a; convert it to 2018b or 2020a"),
    ],
)  # fmt: skip
def test_one_line_names_the_part_and_the_remedy(
    tmp_path: Path, before: str, after: str, line: str
) -> None:
    text = scenario_xml(scenes.straight_road(), [CAR])
    changed, count = re.subn(before, after, text, count=1, flags=re.DOTALL)
    assert count == 1
    assert refusal(tmp_path, changed).startswith(line)


def test_lanelets_without_an_area_are_no_road(tmp_path: Path) -> None:
    text = re.sub(r"<y>-?[0-9.]+</y>", "<y>0</y>", scenario_xml(scenes.straight_road(), []))
    assert refusal(tmp_path, text).startswith("has lanelets of no area, so no road; correct")


def test_a_protocol_buffer_is_called_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "scene.pb"
    path.write_bytes(b"\x0a\x10")
    with pytest.raises(ScenarioError, match="is a protocol buffer, not XML; write it as XML"):
        load_scenario(path)


# Shapes.


def covered(tracks: Tracks, step: int = 0) -> shapely.Geometry:
    """All that the road users cover, in the scenario frame."""
    shapes = []
    for size, outline, states in zip(tracks.size, tracks.outlines, tracks.states, strict=True):
        pose = states[step, :3]
        corners = rectangle_corners(pose, size) if outline is None else to_world(outline, pose)
        shapes.append(shapely.Polygon(corners))
        assert shapely.convex_hull(shapes[-1]).area == pytest.approx(shapes[-1].area)
    return shapely.union_all(shapes)


L = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [50.0, 40.0], [50.0, 10.0], [0.0, 10.0]])


def test_an_l_is_two_rectangles(tmp_path: Path) -> None:
    building = User(7, [(10.0, 20.0, 0.3, 0.0)], kind="building", shape=scenes.polygon(L),
                    static=True)  # fmt: skip
    scenario = loaded(tmp_path, users=[building])
    tracks = scenario.tracks
    assert tracks.outlines == (None, None)
    assert tracks.ids[0] == 7
    assert tracks.ids[1] > 1000  # the planning problem's, the largest of the file
    assert np.prod(tracks.size, axis=1).sum() == pytest.approx(900.0)
    true = shapely.Polygon(to_world(L, np.array([10.0, 20.0, 0.3])))
    assert shapely.symmetric_difference(covered(tracks), true).area == pytest.approx(0, abs=1e-6)
    assert scenario.notes == (
        f"obstacle 7: its shape is taken in pieces, the road users 7 and {tracks.ids[1]}",
    )


def test_what_lies_between_two_pillars_is_free(tmp_path: Path) -> None:
    pillars = scenes.rectangle(0.4, 0.4, 0.0, 2.4) + scenes.rectangle(0.4, 0.4, 0.0, -2.4)
    gate = User(7, [(60.0, 0.0, 0.0, 0.0)], kind="pillar", shape=pillars, static=True)
    tracks = loaded(tmp_path, users=[gate]).tracks
    np.testing.assert_allclose(tracks.states[:, 0, :2], [[60.0, 2.4], [60.0, -2.4]])
    np.testing.assert_allclose(tracks.size, 0.4)


def test_a_hook_that_drives_keeps_its_shape_and_heading(tmp_path: Path) -> None:
    states = scenes.driving(20.0, 0.0, 10.0, 30, heading=0.4)
    tracks = loaded(tmp_path, users=[User(7, states, shape=scenes.polygon(0.1 * L))]).tracks
    np.testing.assert_allclose(tracks.states[:, :30, 2], 0.4)
    for step in (0, 29):
        x, y, heading, _ = states[step]
        assert heading is not None
        true = shapely.Polygon(to_world(0.1 * L, np.array([x, y, heading])))
        assert shapely.symmetric_difference(covered(tracks, step), true).area < 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_any_polygon_is_covered_exactly(tmp_path: Path, seed: int) -> None:
    generator = np.random.default_rng(seed)
    angle = np.sort(generator.uniform(0.0, 2 * np.pi, 6 + 6 * seed))
    reach = generator.uniform(2.0, 9.0, len(angle))
    star = np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])
    wall = User(7, [(50.0, 30.0, 0.0, 0.0)], kind="building", shape=scenes.polygon(star),
                static=True)  # fmt: skip
    true = shapely.make_valid(shapely.Polygon(star + np.array([50.0, 30.0])))
    off = shapely.symmetric_difference(covered(loaded(tmp_path, users=[wall]).tracks), true)
    # But for bays of a centimetre.
    assert shapely.buffer(off, -0.006).is_empty


def test_the_rectangle_of_a_slanted_wall_leaves_the_road_open(tmp_path: Path) -> None:
    """A triangle whose long side lies along the road's edge, drawn from its square corner."""
    corner = scenes.polygon([[0.0, 0.0], [30.0, 0.0], [0.0, 30.0]])
    # Turned so that the long side runs along x at y = 2, a quarter of a metre off the road.
    house = User(7, [(60.0, 2.0 + 30.0 / np.sqrt(2.0), -0.75 * np.pi, 0.0)], kind="building",
                 shape=corner, static=True)  # fmt: skip
    scenario = loaded(tmp_path, lanes=scenes.straight_road(lanes=1), users=[house])
    tracks = scenario.tracks
    rectangles = shapely.polygons(rectangle_corners(tracks.states[:, 0, :3], tracks.size))
    on_road = shapely.intersection(shapely.union_all(rectangles), scenario.road_map.drivable)
    assert shapely.buffer(on_road, -0.5).is_empty
    assert covered(tracks).area == pytest.approx(450.0)


# What is road.


@pytest.mark.parametrize(
    ("kind", "user", "is_road", "for_cars"),
    [
        ("urban", None, True, True),
        ("urban", "vehicle", True, True),
        ("urban", "bus", True, False),
        ("urban", "pedestrian", False, False),
        ("busLane", None, True, False),
        ("busLane", "car", True, True),
        ("sidewalk", None, False, False),
        ("sidewalk", "pedestrian", False, False),
        ("bicycleLane", "bicycle", False, False),
        ("crosswalk", None, False, False),
        ("crosswalk", "pedestrian", False, False),
        ("crosswalk", "vehicle", True, True),
        ("shoulder", None, True, True),
    ],
)
def test_what_is_road_and_what_is_for_cars(
    tmp_path: Path, kind: str, user: str | None, is_road: bool, for_cars: bool
) -> None:
    lane, beside = scenes.straight_road()
    scenario = loaded(tmp_path, lanes=[lane, replace(beside, kind=kind, user=user)])
    _, read = scenario.road_map.lanelets
    assert (read.is_road, read.for_cars) == (is_road, for_cars)
    assert scenario.road_map.drivable.area == pytest.approx(200.0 * (7.0 if is_road else 3.5))


def test_spaces_around_a_word_of_a_lanelet_count_for_nothing(tmp_path: Path) -> None:
    text = scenario_xml(scenes.straight_road(2))
    first, rest = text.split("<laneletType>urban<", 1)
    file = tmp_path / "a.xml"
    file.write_text(f"{first}<laneletType>\n sidewalk\n <{rest}")
    own = load_scenario(file).road_map.lanelets[0]
    assert (own.kinds, own.is_road, own.for_cars) == (frozenset({"sidewalk"}), False, False)


def test_an_id_of_more_than_64_bits_is_told(tmp_path: Path) -> None:
    name = 10**20
    with pytest.raises(ScenarioError, match=f"has the id '{name}'; give it a whole number of 64 b"):
        loaded(tmp_path, users=[User(name, [(60.0, 0.0, 0.0, 0.0)] * 3)])


def test_a_crossing_on_a_lane_leaves_the_lane_road(tmp_path: Path) -> None:
    lane = scenes.straight_road(lanes=1)[0]
    crossing = replace(
        scenes.straight_lane(9, (60.0, -6.0, np.pi / 2), 12.0, 4.0), kind="crosswalk"
    )
    drivable = loaded(tmp_path, lanes=[lane, crossing]).road_map.drivable
    assert drivable.area == pytest.approx(200.0 * 3.5)


def _hangs(scenario: Scenario, *poses: tuple[float, float, float]) -> list[bool]:
    return [bool(x) for x in outside(np.array(poses), (4.5, 1.8), scenario.road_map)]


def test_an_open_end_of_the_map_is_no_edge_of_the_road_and_its_sides_are(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, lanes=scenes.straight_road(oncoming=1))
    at_ends = [(0.0, 0.0, 0.0), (200.0, 1.75, 0.0), (0.0, 7.0, np.pi), (201.0, 3.5, 0.3)]
    assert _hangs(scenario, *at_ends) == [False] * 4
    beside = [(0.0, -1.0, 0.0), (200.0, 8.0, 0.0), (204.0, 0.0, 0.0), (100.0, -1.0, 0.0)]
    assert _hangs(scenario, *beside) == [True] * 4


def test_a_lane_that_ends_beside_another_has_an_edge_there(tmp_path: Path) -> None:
    lanes = scenes.straight_road(pieces=2)[:-1]  # The left lane is half as long.
    scenario = loaded(tmp_path, lanes=[replace(x, successors=()) if x.id == 101 else x
                                       for x in lanes])  # fmt: skip
    assert _hangs(scenario, (100.0, 3.5, 0.0), (100.0, 0.0, 0.0)) == [True, False]


def test_a_lane_that_ends_on_another_road_has_no_open_end_across_it(tmp_path: Path) -> None:
    lanes = [scenes.straight_road(lanes=1)[0],
             scenes.straight_lane(9, (100.0, -50.0, np.pi / 2), 48.25)]  # fmt: skip
    scenario = loaded(tmp_path, lanes=lanes)
    # Over the far edge of the road into which lane 9 leads, and over the open begin of lane 9.
    assert _hangs(scenario, (100.0, 1.0, np.pi / 2), (100.0, -50.0, np.pi / 2)) == [True, False]


# Large maps.


def test_a_map_of_two_thousand_lanelets_takes_about_a_second(tmp_path: Path) -> None:
    """Of processor time, and three to be sure; on the machine of the developers it is one."""
    streets = [
        replace(
            lane,
            id=lane.id + 10_000 * street,
            left=_dense(lane.left, 30.0 * street),
            right=_dense(lane.right, 30.0 * street),
            successors=tuple(n + 10_000 * street for n in lane.successors),
            predecessors=tuple(n + 10_000 * street for n in lane.predecessors),
            left_neighbour=None,
            right_neighbour=None,
        )
        for street in range(250)
        for lane in scenes.straight_road(pieces=4)
    ]
    path = write_scenario_xml(tmp_path / "town.xml", streets)
    begun = time.process_time()
    scenario = load_scenario(path)
    assert time.process_time() - begun < 3.0
    assert len(scenario.road_map.lanelets) == 2000


def _dense(line: Points, aside: float) -> Points:
    dense = shapely.get_coordinates(shapely.segmentize(shapely.LineString(line), 2.0))
    return np.asarray(dense + np.array([0.0, aside]))
