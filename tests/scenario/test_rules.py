"""What regulates the traffic: read from files, and found on the route."""

from __future__ import annotations

import enum
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commonroad.scenario import traffic_light as oracle_lights
from commonroad.scenario import traffic_sign as oracle_signs
from commonroad.scenario.lanelet import LineMarking as OracleMarking
from hypothesis import example, given
from hypothesis import strategies as st

from dosplan.scenario import load_scenario
from dosplan.scenario.commonroad.obstacles import Resampling
from dosplan.scenario.commonroad.regulation import LightProgram, signals
from dosplan.scenario.route.stops import stops_on
from dosplan.scenario.sources.catalogue import ScenarioRef
from dosplan.simulation.world import World
from dosplan.system.arrays_file import pack
from dosplan.types import (
    COLOURS,
    FloatArray,
    LightColour,
    LightStates,
    LineMarking,
    Scenario,
    SignRule,
    StopCause,
)
from tests.support.scenes import Problem, junction, scenario_xml, straight_lane

LIGHT = """<trafficLight id="700"><cycle>{cycle}<timeOffset>{offset}</timeOffset></cycle>
<position><point><x>{x}</x><y>-3</y></point></position><direction>{direction}</direction>
<active>true</active></trafficLight>"""


def cycle(*parts: tuple[str, int]) -> str:
    return "".join(
        f"<cycleElement><duration>{steps}</duration><color>{colour}</color></cycleElement>"
        for colour, steps in parts
    )


def light(*parts: tuple[str, int], direction: str = "all", offset: int = 0, x: str = "60") -> str:
    return LIGHT.format(cycle=cycle(*parts), direction=direction, offset=offset, x=x)


def sign(code: str, name: int = 50, value: str | None = None) -> str:
    given = "" if value is None else f"<additionalValue>{value}</additionalValue>"
    return (
        f'<trafficSign id="{name}"><trafficSignElement><trafficSignID>{code}</trafficSignID>'
        f"{given}</trafficSignElement><position><point><x>1</x><y>2</y></point></position>"
        "<virtual>false</virtual></trafficSign>"
    )


def two_lanelets(**inside: str) -> str:
    """A road along x that is cut at x = 60, where lanelet 1 ends and 2 begins."""
    lanes = (
        straight_lane(1, (-50.0, 0.0, 0.0), 110.0, 3.5, successors=(2,)),
        straight_lane(2, (60.0, 0.0, 0.0), 190.0, 3.5, predecessors=(1,)),
    )
    text = scenario_xml(lanes, problems=(Problem(start=(0.0, 0.0, 0.0, 10.0)),))
    return with_parts(text, **inside)


def with_parts(text: str, *, lanelet: str = "", bound: str = "", other: str = "") -> str:
    """Adds elements to lanelet 1, to its left bound, and beside the lanelets."""
    begin = text.index('<lanelet id="1"')
    end = text.index("</lanelet>", begin)
    first = text[begin:end].replace("</leftBound>", bound + "</leftBound>") + lanelet
    place = text.index("<planningProblem")
    return text[:begin] + first + text[end:place] + other + text[place:]


def read(folder: Path, text: str) -> Scenario:
    path = folder / "scene.xml"
    path.write_text(text, encoding="utf-8")
    return load_scenario(ScenarioRef(path, ""), cached=False)


@pytest.mark.parametrize("word", [marking.value for marking in OracleMarking])
def test_every_marking_of_commonroad_is_known(tmp_path: Path, word: str) -> None:
    scenario = read(tmp_path, two_lanelets(bound=f"<lineMarking>{word}</lineMarking>"))
    lanelet = scenario.road_map.lanelets[0]
    assert lanelet.left_marking.value == word
    assert lanelet.right_marking is LineMarking.UNKNOWN


def test_of_two_lines_the_one_that_is_met_first_counts() -> None:
    # Leftwards, from right to left, the right one of the two is met first.
    assert LineMarking.SOLID_DASHED.may_be_crossed(leftwards=True)
    assert not LineMarking.SOLID_DASHED.may_be_crossed(leftwards=False)
    assert LineMarking.DASHED_SOLID.may_be_crossed(leftwards=False)
    assert not LineMarking.DASHED_SOLID.may_be_crossed(leftwards=True)
    for side in (True, False):
        assert LineMarking.DASHED.may_be_crossed(side)
        assert not LineMarking.SOLID.may_be_crossed(side)


def test_neighbours_of_both_directions_are_kept(tmp_path: Path) -> None:
    lanes = (
        replace(straight_lane(1, (0.0, 0.0, 0.0), 200.0, 3.5), left_neighbour=(2, False)),
        replace(straight_lane(2, (200.0, 3.5, np.pi), 200.0, 3.5), left_neighbour=(1, False)),
    )
    road_map = read(tmp_path, scenario_xml(lanes)).road_map
    assert [x.left_opposite for x in road_map.lanelets] == [2, 1]
    assert [x.left_neighbour for x in road_map.lanelets] == [None, None]


RULES_OF_COMMONROAD = {
    "YIELD": SignRule.GIVE_WAY,
    "STOP": SignRule.STOP,
    "STOP_4_WAY": SignRule.STOP,
    "PRIORITY": SignRule.PRIORITY,
    "RIGHT_OF_WAY": SignRule.PRIORITY,
    "WARNING_RIGHT_BEFORE_LEFT": SignRule.RIGHT_BEFORE_LEFT,
    "NO_OVERTAKING_START": SignRule.NO_OVERTAKING,
    "MAX_SPEED": SignRule.SPEED_LIMIT,
    "MAX_SPEED_ZONE_START": SignRule.SPEED_ZONE,
}


def signs_of_commonroad() -> list[tuple[str, SignRule]]:
    """Numbers in the catalogues of every country that commonroad-io knows, by their names there."""
    catalogues = [
        kind
        for name, kind in vars(oracle_signs).items()
        if name.startswith("TrafficSignID") and name != "TrafficSignID"
    ]
    return sorted(
        {
            (member.value, RULES_OF_COMMONROAD[member.name])
            for kind in catalogues
            if isinstance(kind, type) and issubclass(kind, enum.Enum)
            for member in kind
            if member.name in RULES_OF_COMMONROAD
        }
    )


@pytest.mark.parametrize(("code", "rule"), signs_of_commonroad())
def test_signs_of_all_countries_that_regulate_are_known(
    tmp_path: Path, code: str, rule: SignRule
) -> None:
    text = two_lanelets(lanelet='<trafficSignRef ref="50"/>', other=sign(code, value="10"))
    (plate,) = read(tmp_path, text).road_map.signs
    assert (plate.id, plate.rule, plate.lanelets) == (50, rule, (1,))
    assert plate.position is not None
    assert plate.position.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("code", "value", "limit", "source"),
    [
        ("274", "13.9", 13.9, "sign 50 (274)"),
        ("274.1", None, 30 / 3.6, "zone sign 50 (274.1)"),
        ("274.1-20", None, 20 / 3.6, "zone sign 50 (274.1-20)"),
        ("205", None, None, None),
        ("274", "fast", None, None),
    ],
)
def test_a_limit_names_its_source(
    tmp_path: Path, code: str, value: str | None, limit: float | None, source: str | None
) -> None:
    text = two_lanelets(lanelet='<trafficSignRef ref="50"/>', other=sign(code, value=value))
    lanelet = read(tmp_path, text).road_map.lanelets[0]
    assert lanelet.speed_limit == pytest.approx(limit)
    assert lanelet.speed_limit_source == source


def test_the_lowest_of_several_limits_counts(tmp_path: Path) -> None:
    refs = '<trafficSignRef ref="50"/><trafficSignRef ref="51"/>'
    both = sign("274", 50, "13.9") + sign("274.1", 51)
    lanelet = read(tmp_path, two_lanelets(lanelet=refs, other=both)).road_map.lanelets[0]
    assert lanelet.speed_limit_source == "zone sign 51 (274.1)"
    assert lanelet.signs == (50, 51)


@pytest.mark.parametrize(
    "broken",
    [
        light(("red", 100), ("purple", 10)),
        light(("red", -5)),
        light(("red", 100)).replace("<duration>100", "<duration>soon"),
        light(("red", 100)).replace('id="700"', 'id="here"'),
        light(("red", 100)) * 2,
        sign("274", value="5").replace('id="50"', 'id="x"'),
        '<intersection id="80"><incoming id="?"/></intersection>',
    ],
)
def test_what_regulates_and_cannot_be_read_is_left_out_and_noted(
    tmp_path: Path, broken: str
) -> None:
    scenario = read(tmp_path, two_lanelets(other=broken))
    assert any("left out" in note for note in scenario.notes), scenario.notes
    assert len(scenario.road_map.lanelets) == 2


def test_a_light_without_a_place_has_none(tmp_path: Path) -> None:
    scenario = read(tmp_path, two_lanelets(other=light(("red", 10), ("green", 10), x="inf")))
    (found,) = scenario.road_map.lights
    assert found.position is None
    assert found.id == 700


parts_of_a_cycle = st.lists(
    st.tuples(st.sampled_from([colour.value for colour in LightColour]), st.integers(1, 60)),
    min_size=1,
    max_size=6,
)


@given(parts=parts_of_a_cycle, offset=st.integers(0, 200))
def test_lights_show_what_commonroad_says(parts: list[tuple[str, int]], offset: int) -> None:
    theirs = oracle_lights.TrafficLightCycle(
        [
            oracle_lights.TrafficLightCycleElement(oracle_lights.TrafficLightState(word), steps)
            for word, steps in parts
        ],
        time_offset=offset,
    )
    ours = program(parts, offset).at(np.arange(400.0))[0]
    for step in range(offset, 400):
        assert COLOURS[int(ours[step])].value == theirs.get_state_at_time_step(step).value


def program(parts: list[tuple[str, int]], offset: int = 0) -> LightProgram:
    return LightProgram(
        id=1,
        direction="all",
        position=None,
        colours=tuple(LightColour(word) for word, _ in parts),
        ends=np.cumsum([float(steps) for _, steps in parts]),
        offset=float(offset),
    )


@given(parts=parts_of_a_cycle, offset=st.integers(0, 200))
@example(parts=[("red", 10), ("green", 5), ("red", 5)], offset=20)
def test_a_light_has_shown_its_colour_since_it_changed(
    parts: list[tuple[str, int]], offset: int
) -> None:
    colours, since = program(parts, offset).at(np.arange(600.0))
    for step in range(1, 600):
        if colours[step] == colours[step - 1]:
            assert since[step] == since[step - 1] + 1.0
        else:
            assert since[step] == 0.0
    assert np.all(since >= 0.0)


def test_a_recording_as_long_as_its_cycle_has_no_time_before_it() -> None:
    # Red for 3 s, green, and red again at the end: nothing is known of the time before step 0.
    _, since = program([("red", 30), ("green", 20), ("red", 50)]).at(np.arange(100.0))
    assert since[0] == 0.0
    assert since[29] == 29.0
    assert since[99] == 49.0


def test_lights_are_resampled_with_the_file() -> None:
    # Steps of 0.04 s: 100 of them are 4 s, step 40 of 0.1 s.
    shown = signals((program([("red", 100), ("green", 900)]),), Resampling.of(0.04), 60)
    assert [COLOURS[k].value for k in shown.colours[0, [0, 39, 40, 60]]] == [
        "red",
        "red",
        "green",
        "green",
    ]
    assert shown.since[0, 39] == pytest.approx(3.9)
    assert shown.since[0, 45] == pytest.approx(0.5)


def test_the_strictest_of_several_lights_counts() -> None:
    states = LightStates(
        ids=np.array([1, 2, 3]),
        colours=(LightColour.GREEN, LightColour.RED, LightColour.INACTIVE),
        since=np.array([1.0, 2.0, 3.0]),
    )
    assert states.shown((1, 2)) is LightColour.RED
    assert states.shown((1, 3)) is LightColour.GREEN
    assert states.shown((3,)) is LightColour.INACTIVE
    assert states.shown(()) is LightColour.INACTIVE
    assert states.shown((99,)) is LightColour.INACTIVE
    assert states.seconds(2) == 2.0


def test_an_observation_has_the_lights_of_now_and_not_of_later(tmp_path: Path) -> None:
    parts = (("red", 30), ("green", 1000))
    early, late = (
        read(tmp_path, two_lanelets(lanelet=LIGHT_REF, other=light(*shown)))
        for shown in (parts, (("red", 30), ("yellow", 1000)))
    )
    for step in range(30):
        seen, other = (World(s, first_step=step).observation() for s in (early, late))
        assert seen.lights.colours == (LightColour.RED,)
        assert pack(seen) == pack(other)
        array: Any
        for array in (seen.lights.ids, seen.lights.since):
            while array is not None:  # What lies under a view is no longer than the view.
                assert array.size == 1
                array = array.base
    assert World(early, first_step=30).observation().lights.colours == (LightColour.GREEN,)


LIGHT_REF = '<trafficLightRef ref="700"/>'
STOP_LINE = (
    "<stopLine><point><x>{x}</x><y>1.75</y></point><point><x>{x}</x><y>-1.75</y></point>"
    '<lineMarking>solid</lineMarking><trafficLightRef ref="700"/></stopLine>'
)


def start_of(scenario: Scenario) -> float:
    """Arc length of the ego's centre at its start, at x = 0, m."""
    route = scenario.task.route
    return float(route.arclength[int(np.argmin(np.hypot(*route.path.T)))])


def test_a_light_stops_at_its_line(tmp_path: Path) -> None:
    text = two_lanelets(lanelet=STOP_LINE.format(x=57), other=light(("red", 10)))
    scenario = read(tmp_path, text)
    (stop,) = scenario.task.route.stops
    assert (stop.cause, stop.lights) == (StopCause.LIGHT, (700,))
    assert stop.arclength - start_of(scenario) == pytest.approx(57.0, abs=0.3)


def test_without_a_line_a_light_stops_at_the_end_of_its_lanelet(tmp_path: Path) -> None:
    scenario = read(tmp_path, two_lanelets(lanelet=LIGHT_REF, other=light(("red", 10))))
    (stop,) = scenario.task.route.stops
    assert stop.arclength - start_of(scenario) == pytest.approx(60.0, abs=0.3)


@pytest.mark.parametrize(
    ("direction", "holds"),
    [("all", True), ("straight", True), ("leftStraight", True), ("left", False), ("right", False)],
)
def test_only_a_light_for_the_way_of_the_route_counts(
    tmp_path: Path, direction: str, holds: bool
) -> None:
    text = two_lanelets(lanelet=LIGHT_REF, other=light(("red", 10), direction=direction))
    assert len(read(tmp_path, text).task.route.stops) == holds


def lane_map(folder: Path, *, lanelet: str, other: str) -> Scenario:
    """A junction at which lanelet 1 comes in, goes on in 2 and turns in 3 and 4."""
    text = scenario_xml(junction(), problems=(Problem(start=(10.0, 0.0, 0.0, 8.0)),))
    return read(folder, with_parts(text, lanelet=lanelet, other=other))


def test_an_intersection_says_which_way_a_lanelet_takes(tmp_path: Path) -> None:
    crossing = (
        '<intersection id="80"><incoming id="81"><incomingLanelet ref="1"/>'
        '<successorsRight ref="4"/><successorsStraight ref="2"/><successorsLeft ref="3"/>'
        "</incoming></intersection>"
    )
    scenario = lane_map(
        tmp_path, lanelet=LIGHT_REF, other=light(("red", 9), direction="left") + crossing
    )
    turns = [scenario.road_map.turn(1, name) for name in (2, 3, 4, 5)]
    assert turns == ["straight", "left", "right", None]
    (intersection,) = scenario.road_map.intersections
    assert intersection.inside == {2, 3, 4}
    ways: dict[int, FloatArray] = {x.id: x.centre for x in scenario.road_map.lanelets}
    for name, stops in ((2, 0), (3, 1), (4, 0)):
        path = np.concatenate([ways[1], ways[name][1:]])
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
        assert len(stops_on(path, along, (1, name), scenario.road_map)) == stops


def crossing_roads(folder: Path, code: str, other_code: str | None = None) -> Scenario:
    """The ego's road 1, 2 along x, and another, 11, 12, that crosses it at x = 65 along y."""
    lanes = (
        straight_lane(1, (-50.0, 0.0, 0.0), 110.0, 3.5, successors=(2,)),
        straight_lane(2, (60.0, 0.0, 0.0), 190.0, 3.5, predecessors=(1,)),
        straight_lane(11, (65.0, -60.0, np.pi / 2), 55.0, 3.5, successors=(12,)),
        straight_lane(12, (65.0, -5.0, np.pi / 2), 80.0, 3.5, predecessors=(11,)),
    )
    text = scenario_xml(lanes, problems=(Problem(start=(0.0, 0.0, 0.0, 10.0)),))
    text = with_parts(text, lanelet='<trafficSignRef ref="50"/>', other=sign(code))
    if other_code is not None:
        place = text.index("</lanelet>", text.index('<lanelet id="11"'))
        text = text[:place] + '<trafficSignRef ref="51"/>' + text[place:]
        place = text.index("<planningProblem")
        text = text[:place] + sign(other_code, 51) + text[place:]
    return read(folder, text)


@pytest.mark.parametrize(
    ("code", "cause"), [("205", StopCause.GIVE_WAY), ("206", StopCause.STOP_SIGN)]
)
def test_a_sign_makes_the_ego_give_way_where_the_ways_cross(
    tmp_path: Path, code: str, cause: StopCause
) -> None:
    scenario = crossing_roads(tmp_path, code)
    (stop,) = scenario.task.route.stops
    assert stop.cause is cause
    assert stop.conflict.bounds == pytest.approx((63.25, -1.75, 66.75, 1.75), abs=0.05)


def test_who_has_to_stop_as_well_does_not_go_first(tmp_path: Path) -> None:
    (stop,) = crossing_roads(tmp_path, "205", other_code="206").task.route.stops
    assert stop.conflict.is_empty


def test_a_priority_sign_stops_nobody(tmp_path: Path) -> None:
    assert crossing_roads(tmp_path, "306").task.route.stops == ()


def with_crosswalk(folder: Path, x: float, *, lanelet: str = "", other: str = "") -> Scenario:
    """A crosswalk of 4 m across the road, from x on."""
    lanes = (
        straight_lane(1, (-50.0, 0.0, 0.0), 110.0, 3.5, successors=(2,)),
        straight_lane(2, (60.0, 0.0, 0.0), 190.0, 3.5, predecessors=(1,)),
        replace(
            straight_lane(9, (x + 2.0, -4.0, np.pi / 2), 8.0, 4.0),
            kind="crosswalk",
            user="pedestrian",
        ),
    )
    text = scenario_xml(lanes, problems=(Problem(start=(0.0, 0.0, 0.0, 10.0)),))
    return read(folder, with_parts(text, lanelet=lanelet, other=other))


def test_a_crosswalk_stops_a_metre_before_it(tmp_path: Path) -> None:
    scenario = with_crosswalk(tmp_path, 40.0)
    (stop,) = scenario.task.route.stops
    assert stop.cause is StopCause.CROSSWALK
    assert stop.arclength - start_of(scenario) == pytest.approx(39.0, abs=0.3)
    assert stop.until - start_of(scenario) == pytest.approx(44.0, abs=0.3)
    assert stop.conflict.area == pytest.approx(32.0)


@pytest.mark.parametrize("x", [60.0, 59.99, 62.0])
def test_a_crosswalk_behind_a_stop_line_has_its_lights_and_its_line(
    tmp_path: Path, x: float
) -> None:
    scenario = with_crosswalk(tmp_path, x, lanelet=LIGHT_REF, other=light(("green", 10)))
    stops = {stop.cause: stop for stop in scenario.task.route.stops}
    light_stop, crosswalk = stops[StopCause.LIGHT], stops[StopCause.CROSSWALK]
    assert crosswalk.lights == light_stop.lights == (700,)
    assert crosswalk.arclength == pytest.approx(light_stop.arclength)
