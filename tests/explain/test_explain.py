"""Explanations of episodes whose cause is known, because the scene was made for it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from dosplan.api import Planner, Predictor, PredictorSettings
from dosplan.cli.main import BAD_INPUT, OK, main
from dosplan.explain import Explanation, explain_drive
from dosplan.explain.collision import CollisionFacts, Course
from dosplan.explain.goal import GoalFacts
from dosplan.explain.planning import PlanningFacts
from dosplan.explain.road import RoadFacts
from dosplan.results.drive import Drive
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.rows import read_rows, row_line
from dosplan.scenario.synthetic import (
    CAR_SIZE,
    LANE_WIDTH,
    steady_tracks,
    straight_scenario,
)
from dosplan.scoring.metrics import METRICS, SLACK_SEEN, Group, measured_kinds
from dosplan.scoring.score import failed_score, score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import IDEAL, LoopSettings, SensingSettings
from dosplan.simulation.traffic import Replay, Traffic
from dosplan.system.files import FileError
from dosplan.types import (
    USER_VELOCITY,
    USER_X,
    Arm,
    CollisionClass,
    EpisodeKey,
    GoalState,
    Observation,
    Occupancy,
    Outcome,
    Plan,
    RoadMap,
    RoadUserKind,
    Scenario,
    SolveReport,
    SolveStatus,
    Tracks,
)
from dosplan.vehicle import VehicleParameters
from tests.support.factories import arc_route, union_of
from tests.support.old_files import save_as_version_0_4
from tests.support.plugins import CoastPlanner, GrowingPredictor
from tests.support.runs import run_leaky, write_followed
from tests.support.traffic import ShyTraffic, braking_before, followed

VEHICLE = VehicleParameters()


class Coast(CoastPlanner):
    """Reports what the test wants."""

    def __init__(self, reports: dict[int, SolveReport] | None = None) -> None:
        super().__init__()
        self.reports = reports or {}

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        report = self.reports.get(observation.step, SolveReport(SolveStatus.SOLVED, 10))
        return replace(super().compute_plan(observation, occupancy), report=report)


class Discs(GrowingPredictor):
    """Discs of one radius in place of the ellipses."""

    def __init__(self, radius: float, horizon: int = 40) -> None:
        super().__init__(settings=PredictorSettings(horizon=horizon))
        self.radius = radius

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        sets = super().compute_occupancy(observation)
        return replace(sets, semi_axes=np.full_like(sets.semi_axes, self.radius))


def explained(
    tmp_path: Path,
    scenario: Scenario,
    planner: Planner | None = None,
    predictor: Predictor | None = None,
    arm: Arm = Arm.WITH_DOS,
    loop: LoopSettings = IDEAL,
) -> Explanation:
    """Drives, scores, records and explains."""
    episode = run_episode(scenario, planner or Coast(), predictor or Discs(1.0), arm, loop)
    drive = Drive.of(scenario, episode)
    drive.recording.save(tmp_path / "episode.npz")
    back = Recording.load(tmp_path / "episode.npz")
    found = explain_drive(Drive(drive.row, back, scenario))
    assert found == explain_drive(drive)  # From a folder as from memory.
    return found


def braking_car(steps: int = 61) -> Tracks:
    """A car 12.4 m before the ego's bumper that brakes by 4 m/s2 from the ego's 15 m/s on."""
    time = 0.1 * np.arange(steps)
    tracks = steady_tracks([[0.0, 0.0, 0.0, 15.0]], steps=steps)
    front = VEHICLE.rear_to_centre + VEHICLE.length / 2.0
    states = np.array(tracks.states)
    states[0, :, USER_X] = front + 12.4 + CAR_SIZE[0] / 2.0 + 15.0 * time - 2.0 * time**2
    states[0, :, USER_VELOCITY] = 15.0 - 4.0 * time
    return replace(tracks, states=states)


def collision_of(found: Explanation) -> CollisionFacts:
    assert found.collision is not None
    return found.collision


# Constant velocity is off by 1/2 4 h^2 = 2 h^2 m at a lead time of h: 0.5 m, 2 m, 4.5 m, 8 m and
# 12.5 m at 0.5 s, 1 s, ... A disc holds it exactly where its radius is more than that.
@pytest.mark.parametrize(
    ("radius", "held", "failed"),
    [
        (0.45, None, 0.5),
        (0.55, 0.5, 1.0),
        (3.0, 1.0, 1.5),
        (4.4, 1.0, 1.5),
        (4.6, 1.5, 2.0),
        (13.0, 2.5, None),
    ],
)
def test_a_collision_tells_at_which_lead_time_the_set_failed(
    tmp_path: Path, radius: float, held: float | None, failed: float | None
) -> None:
    scenario = straight_scenario(braking_car(), velocity=15.0)
    found = explained(tmp_path, scenario, predictor=Discs(radius))
    facts = collision_of(found)
    # The gap of 12.4 m closes by 2 t^2: at 2.49 s, on the way to step 25.
    assert (found.outcome, found.step, found.seconds) == (Outcome.COLLISION, 25, 2.5)
    assert [check.lead for check in facts.sets] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5])
    errors = [check.error for check in facts.sets]
    assert errors == pytest.approx([0.5, 2.0, 4.5, 8.0, 12.5], abs=0.02)
    reaches = [check.reach for check in facts.sets]
    assert reaches == pytest.approx([error / radius for error in errors], rel=0.02)
    assert (facts.held, facts.failed) == (held, failed)


class Unions(Discs):
    """A disc as wide, and a likelier one beside the road."""

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        sets = super().compute_occupancy(observation)
        aside = replace(sets, centre=sets.centre + np.array([0.0, 30.0]))
        return union_of([0.25, 0.75], sets, aside)


def test_of_a_union_the_component_tells_that_held_or_failed_by_the_least(tmp_path: Path) -> None:
    scenario = straight_scenario(braking_car(), velocity=15.0)
    alone = collision_of(explained(tmp_path, scenario, predictor=Discs(3.0)))
    several = collision_of(explained(tmp_path, scenario, predictor=Unions(3.0)))
    assert several.sets == alone.sets
    assert (several.held, several.failed) == (1.0, 1.5)


def test_a_collision_names_who_and_how(tmp_path: Path) -> None:
    scenario = straight_scenario(braking_car(), velocity=15.0)
    found = explained(tmp_path, scenario, predictor=Discs(3.0))
    facts = collision_of(found)
    assert (facts.road_user, facts.kind, facts.at_fault) == (100, "car", True)
    assert facts.collision_class is CollisionClass.ACTIVE_FRONT
    # The contact is between 2.4 s and 2.5 s, where the car is 9.6 m/s and 10 m/s slower.
    assert 9.6 <= facts.relative_speed <= 10.0
    assert facts.ego_speed == pytest.approx(15.0)
    # Two seconds before, at 0.5 s, it had come 0.5 m closer; centres are half the lengths apart.
    assert facts.before == 2.0
    assert facts.ahead == pytest.approx(11.9 + (VEHICLE.length + CAR_SIZE[0]) / 2.0)
    assert facts.left == pytest.approx(0.0, abs=1e-9)
    text = "\n".join(found.lines())
    assert "straight, with_dos: collision at step 25, 2.5 s after the start" in text
    assert "the ego's front struck it (active_front); the ego is to blame" in text
    assert "1.0 s in (2.0 m off, 0.7 x), 1.5 s OUT (4.5 m off, 1.5 x)" in text
    assert "held it up to 1.0 s ahead; the one predicted 1.5 s before the contact failed" in text


def test_a_collision_tells_how_late_the_ego_saw_it(tmp_path: Path) -> None:
    """The car's centre is 14.65 m ahead at first, then 2 t^2 closer; sensors reach 11 m."""
    scenario = straight_scenario(braking_car(), velocity=15.0)
    assert collision_of(explained(tmp_path, scenario)).sight is None
    late = LoopSettings(latency=0.3)
    sight = collision_of(explained(tmp_path, scenario, loop=late)).sight
    assert sight is not None
    # Contact at step 25: the last plan acts from step 24 on, made from what was seen at step 21.
    assert sight.known
    assert sight.error == pytest.approx(0.0, abs=0.02)
    assert (sight.first, sight.unseen, sight.age) == pytest.approx((2.5, 0.0, 0.4))

    near = LoopSettings(latency=0.3, sensing=SensingSettings(range=11.0, memory=0.0))
    found = explained(tmp_path, scenario, loop=near)
    sight = collision_of(found).sight
    assert sight is not None
    gap = 12.4 + (VEHICLE.length + CAR_SIZE[0]) / 2.0
    first = next(k for k in range(26) if gap - 2.0 * (0.1 * k) ** 2 <= 11.0)
    assert (sight.first, sight.unseen) == pytest.approx((2.5 - 0.1 * first, 0.1 * first))
    text = "\n".join(found.lines())
    assert (
        f"the ego saw it first {2.5 - 0.1 * first:.1f} s before, {0.1 * first:.1f} s after" in text
    )
    assert "made from what was seen 0.4 s before, and took it to be 0.0 m off" in text

    blind = LoopSettings(sensing=SensingSettings(range=1.0))
    found = explained(tmp_path, scenario, loop=blind)
    assert "the ego never saw it, in the 2.5 s for which it was on the scene" in "\n".join(
        found.lines()
    )


def test_the_arm_without_sets_is_told_the_errors_alone(tmp_path: Path) -> None:
    scenario = straight_scenario(braking_car(), velocity=15.0)
    found = explained(tmp_path, scenario, arm=Arm.WITHOUT_DOS)
    assert all(check.reach is None and not check.inside for check in collision_of(found).sets)
    text = "\n".join(found.lines())
    assert "no sets in this arm; its centre was predicted, by lead time, off by 0.5 m at" in text
    assert "OUT" not in text


# At 10 m/s the ego's front is at x = 3.68 + 10 t; the others are met near x = 25.
@pytest.mark.parametrize(
    ("first", "course", "relative"),
    [
        ([26.0, 10.0, -np.pi / 2.0, 5.0], Course.FROM_LEFT, np.hypot(10.0, 5.0)),
        ([26.0, -10.0, np.pi / 2.0, 5.0], Course.FROM_RIGHT, np.hypot(10.0, 5.0)),
        ([45.0, 0.0, np.pi, 10.0], Course.ONCOMING, 20.0),
        ([26.0, 0.0, 0.0, 0.0], Course.STANDING, 10.0),
        ([20.0, 0.0, 0.0, 4.0], Course.ALONG, 6.0),
    ],
)
def test_where_a_road_user_came_from(
    tmp_path: Path, first: list[float], course: Course, relative: float
) -> None:
    facts = collision_of(explained(tmp_path, straight_scenario(steady_tracks([first]))))
    assert facts.course is course
    assert facts.relative_speed == pytest.approx(relative, abs=1e-3)
    assert facts.seen_for == pytest.approx(facts.seconds)
    assert np.sign(round(facts.left, 3)) == np.sign(first[1])


def test_who_was_never_predicted_is_said_to_be(tmp_path: Path) -> None:
    tracks = steady_tracks([[20.0, 0.0, 0.0, 0.0]])
    valid = np.array(tracks.valid)
    valid[0, :13] = False  # It appears 0.3 s before the contact: too late for a set at 0.5 s.
    found = explained(tmp_path, straight_scenario(replace(tracks, valid=valid)))
    facts = collision_of(found)
    assert (found.step, facts.sets, facts.held, facts.failed) == (15, (), None, None)
    assert facts.seen_for == pytest.approx(0.2)
    assert "no prediction of it for this moment was kept" in "\n".join(found.lines())


def road_of(found: Explanation) -> RoadFacts:
    assert found.out_of_bounds is not None
    return found.out_of_bounds


@pytest.mark.parametrize(("heading", "part"), [(-0.1, "front right"), (0.3, "front left")])
def test_off_the_road_tells_side_and_depth(tmp_path: Path, heading: float, part: str) -> None:
    scenario = straight_scenario()
    start = VEHICLE.state_at(np.array([10.0, 0.0]), heading, 10.0)
    scenario = replace(scenario, task=replace(scenario.task, start=start))
    found = explained(tmp_path, scenario)
    facts = road_of(found)
    assert found.outcome is Outcome.OUT_OF_BOUNDS
    # The road reaches from y = -1.75 m to y = 5.25 m; the corner that leads is ahead and aside.
    turn = abs(heading)
    corner = np.sin(turn) * VEHICLE.length / 2.0 + np.cos(turn) * VEHICLE.width / 2.0
    edge = 1.75 if heading < 0.0 else 5.25
    way = np.sin(turn) * facts.seconds * 10.0
    assert facts.depth == pytest.approx(way + corner - edge, abs=1e-6)
    assert 0.01 <= facts.depth < 0.02 + np.sin(turn)  # At the first step beyond the hairline.
    assert facts.worst_depth == pytest.approx(np.sin(turn) * 50.0 + corner - edge, abs=1e-6)
    assert (facts.part, facts.corners_outside, facts.centre_outside) == (part, 1, False)
    assert (facts.lanelet, facts.curvature) == (1 if heading < 0.0 else 2, 0.0)
    assert facts.offset == pytest.approx(np.sign(heading) * way, abs=1e-6)
    assert (facts.free_left, facts.free_right) == (5.25, -1.75)
    text = "\n".join(found.lines())
    assert f"its {part} is {facts.depth:.3f} m outside; at worst" in text
    assert "on a straight, at 10.0 m/s" in text


def test_an_open_end_of_the_map_is_no_edge(tmp_path: Path) -> None:
    # The map ends where the ego starts, and 60 m further: beyond both, the road goes on.
    scenario = straight_scenario()
    start = VEHICLE.state_at(np.array([10.0, 0.0]), 0.3, 10.0)
    ends = shapely.box(11.0, -1.75, 100.0, 5.25)
    road = shapely.box(-50.0, -1.75, 11.0, 5.25)
    road_map = replace(scenario.road_map, drivable=road, open_ends=ends)
    task = replace(scenario.task, start=start)
    facts = road_of(explained(tmp_path, replace(scenario, task=task, road_map=road_map)))
    assert (facts.part, facts.corners_outside, facts.centre_outside) == ("front left", 1, False)
    goal = GoalState(10, 50, shapely.box(20.0, -2.0, 40.0, 2.0))
    straight = replace(straight_scenario(goals=[goal]), road_map=road_map)
    left = explained(tmp_path / "straight", straight).margins
    assert left is not None
    assert left.road == pytest.approx(LANE_WIDTH / 2.0 - VEHICLE.width / 2.0)


def test_off_the_road_in_a_bend(tmp_path: Path) -> None:
    # A left bend of 30 m: who drives straight on leaves it on the outside, which is the right.
    road = shapely.Point(0.0, 30.0).buffer(31.75, 256) - shapely.Point(0.0, 30.0).buffer(28.25, 256)
    scenario = straight_scenario()
    task = replace(scenario.task, route=arc_route(30.0))
    road_map = RoadMap(scenario.road_map.lanelets, road)
    found = explained(tmp_path, replace(scenario, task=task, road_map=road_map))
    facts = road_of(found)
    assert facts.curvature == pytest.approx(1.0 / 30.0)
    assert (facts.part, facts.free_right) == ("front right", -1.75)
    assert facts.offset == pytest.approx(
        -(np.hypot(1.4227 + facts.seconds * 10.0, 30.0) - 30.0), abs=0.02
    )
    assert "in a bend to the left (radius 30 m)" in "\n".join(found.lines())


@pytest.mark.parametrize("cut", [0.3, 0.06])
def test_a_notch_of_the_road_is_told_from_a_drive_off_it(tmp_path: Path, cut: float) -> None:
    # A wedge 2 m wide at the road's edge, whose tip lies under the ego's right side as it passes.
    height = 1.75 - VEHICLE.width / 2.0 + cut
    notch = shapely.Polygon([(25.0, -1.75), (26.0, height - 1.75), (27.0, -1.75)])
    scenario = straight_scenario()
    road_map = RoadMap(scenario.road_map.lanelets, scenario.road_map.drivable - notch)
    found = explained(tmp_path, replace(scenario, road_map=road_map))
    facts = road_of(found)
    # The side's farthest point is ``cut`` below the tip; a flank runs 1 m aside on its height.
    assert facts.worst_depth == pytest.approx(cut / np.hypot(height, 1.0), abs=0.01)
    assert (facts.corners_outside, facts.centre_outside) == (0, False)
    assert "outside, but no corner is (an inner edge, a notch or a gap" in "\n".join(found.lines())


def goal_of(found: Explanation) -> GoalFacts:
    assert found.outcome is Outcome.GOAL_MISSED
    (facts,) = found.goals
    return facts


# The ego's centre is at x = 1.4227 + 10 t, its heading 0, its velocity 10 m/s, for 5 s.
@pytest.mark.parametrize(
    ("goal", "failed", "figures", "words"),
    [
        (
            GoalState(0, 50, shapely.box(20.0, -2.0, 40.0, 2.0), velocity=(4.0, 6.0)),
            ("velocity",),
            {"velocity_off": 4.0, "distance": 0.0},
            "4.00 m/s too fast at best: 10.00 m/s, wanted 4.00 to 6.00",
        ),
        (
            GoalState(0, 50, shapely.box(20.0, -2.0, 40.0, 2.0), heading=(0.5, 1.0)),
            ("heading",),
            {"heading_off": -0.5},
            "28.6 degrees too far to the right",
        ),
        (
            GoalState(0, 50, heading=(-1.0, -0.2), velocity=(12.0, 15.0)),
            ("heading", "velocity"),
            {"heading_off": 0.2, "velocity_off": -2.0},
            "2.00 m/s too slow",
        ),
        (
            GoalState(0, 50, shapely.box(60.0, -2.0, 70.0, 2.0), velocity=(4.0, 6.0)),
            ("position",),
            {"distance": 60.0 - 51.4227, "seconds": 5.0},
            "position never reached: closest 8.58 m, 5.0 s after the start, at the last step, "
            "driving 10.0 m/s; it still lay ahead: the ego would have come too late",
        ),
        (
            GoalState(0, 50, shapely.box(20.0, 3.0, 30.0, 5.0)),
            ("position",),
            {"distance": 3.0, "side": "left"},
            "the ego passed beside it, which lay to the left",
        ),
        (  # Left behind after step 28.
            GoalState(40, 50, shapely.box(20.0, -2.0, 30.0, 2.0)),
            ("time",),
            {"late": -1.2, "seconds": 2.8},
            "2.8 s after the start at best, 1.2 s too early: it counts from 4.0 s to 5.0 s "
            "(driving through it before that is a miss)",
        ),
        (  # Reached at step 47.
            GoalState(0, 40, shapely.box(48.0, -2.0, 60.0, 2.0)),
            ("time",),
            {"late": 0.7, "seconds": 4.7},
            "0.7 s too late",
        ),
    ],
)
def test_a_missed_goal_tells_which_condition_failed(
    tmp_path: Path,
    goal: GoalState,
    failed: tuple[str, ...],
    figures: dict[str, float],
    words: str,
) -> None:
    found = explained(tmp_path, straight_scenario(goals=[goal]))
    facts = goal_of(found)
    assert facts.failed == failed
    assert {name: getattr(facts, name) for name in figures} == pytest.approx(figures, abs=1e-3)
    assert words in "\n".join(found.lines())


def test_who_stood_until_the_end_has_not_passed_beside_the_goal() -> None:
    goal = GoalState(0, 30, shapely.box(15.0, 20.0, 25.0, 25.0))
    scenario = straight_scenario(goals=[goal], final_step=30)
    states = np.repeat(scenario.task.start[None], 31, axis=0)
    states[:, 0] += np.minimum(np.arange(31.0), 5.0)
    episode = run_episode(scenario, Coast(), Discs(1.0), Arm.WITH_DOS)
    facts = goal_of(explain_drive(Drive.of(scenario, replace(episode, states=states))))
    assert (facts.side, facts.at_end, facts.seconds) == ("left", True, 3.0)
    assert "at the last step" in facts.lines()[0]
    assert facts.lines()[0].endswith("it still lay to the left when the drive ended")


def test_every_alternative_goal_is_told(tmp_path: Path) -> None:
    near, far = (GoalState(0, 50, shapely.box(x, -2.0, x + 5.0, 2.0)) for x in (60.0, 90.0))
    found = explained(tmp_path, straight_scenario(goals=[near, far]))
    assert [facts.distance for facts in found.goals] == pytest.approx([8.5773, 38.5773], abs=1e-3)


def test_a_time_that_is_waited_for_tells_the_progress_that_lacks() -> None:
    scenario = straight_scenario(goals=[GoalState(30, 30)], final_step=30)
    states = np.repeat(scenario.task.start[None], 31, axis=0)
    states[:, 0] += np.minimum(np.arange(31.0), 5.0)
    episode = run_episode(scenario, Coast(), Discs(1.0), Arm.WITH_DOS)
    found = explain_drive(Drive.of(scenario, replace(episode, states=states)))
    facts = goal_of(found)
    assert (facts.failed, facts.distance, facts.late) == (("progress",), 0.0, 0.0)
    assert (facts.progress, facts.expected_progress) == pytest.approx((5.0, 30.0))
    words = "goal 1: a time alone, which standing still does not reach: 5.0 m along the route"
    assert words in "\n".join(found.lines())


def test_a_success_tells_its_margins(tmp_path: Path) -> None:
    # A car beside the ego, as fast: 3.5 m between the middles less both half widths.
    tracks = steady_tracks([[VEHICLE.rear_to_centre, LANE_WIDTH, 0.0, 10.0]])
    goal = GoalState(10, 50, shapely.box(20.0, -2.0, 40.0, 2.0))
    found = explained(tmp_path, straight_scenario(tracks, goals=[goal]))
    assert (found.outcome, found.goals, found.collision) == (Outcome.SUCCESS, (), None)
    left = found.margins
    assert left is not None
    assert left.clearance is not None
    assert left.clearance.metres == pytest.approx(LANE_WIDTH - 0.5 * (1.8 + VEHICLE.width))
    assert left.clearance.road_user == 100
    assert left.road == pytest.approx(LANE_WIDTH / 2.0 - VEHICLE.width / 2.0)
    assert (left.reached, left.spare) == pytest.approx((1.9, 3.1))  # x = 20.4 m at step 19.


@pytest.mark.parametrize(("count", "last"), [(5, "lanelet 4: turned"), (8, "3 more notes")])
def test_what_reading_put_right_is_told(tmp_path: Path, count: int, last: str) -> None:
    notes = tuple(f"lanelet {i}: turned" for i in range(count))
    scenario = replace(straight_scenario(braking_car(), velocity=15.0), notes=notes)
    found = explained(tmp_path, scenario)
    assert found.notes == notes
    told = [line.strip() for line in found.lines() if "the scenario file: " in line]
    assert told[0] == "the scenario file: lanelet 0: turned"
    assert told[-1] == f"the scenario file: {last}"
    assert len(told) == min(count, 6)


def test_who_reacted_is_explained_as_it_was_driven() -> None:
    scenario = followed()

    def explain_among(traffic: Traffic) -> Explanation:
        return explain_drive(Drive.of(scenario, braking_before(traffic)))

    assert collision_of(explain_among(Replay())).road_user == 100
    found = explain_among(ShyTraffic())
    assert (found.outcome, found.collision) == (Outcome.SUCCESS, None)
    left = found.margins
    assert left is not None
    assert left.clearance is not None
    assert (left.clearance.road_user, left.clearance.kind) == (100, RoadUserKind.CAR)
    # It stands within 12 m of the ego's centre, and came a step of 1 m further at most.
    between = 0.5 * (scenario.task.vehicle.length + 4.5)
    assert 11.0 - between - 1.0 < left.clearance.metres < 12.0 - between


def test_a_success_on_an_empty_road(tmp_path: Path) -> None:
    found = explained(tmp_path, straight_scenario())
    assert found.margins is not None
    assert found.margins.clearance is None
    assert "nobody else on the scene" in "\n".join(found.lines())


def planning_of(found: Explanation) -> PlanningFacts:
    assert found.planning is not None
    return found.planning


def test_the_last_seconds_of_planning_are_summed_up(tmp_path: Path) -> None:
    pressed = {
        step: SolveReport(SolveStatus.SOLVED, 20 + step, slack=0.1 * step, active_ids=(100, 7))
        for step in (3, 12, 20, 21)
    }
    failing = SolveReport(
        SolveStatus.MAX_ITERATIONS, 200, slack=0.5, active_ids=(100,), fallback="brake"
    )
    reports = {
        **pressed,
        22: failing,
        23: replace(failing, road_slack=0.25),
        24: replace(
            failing,
            waits_for="light 31",
            unreachable="heading 20 degrees off",
            decision="change lanes behind 7",
        ),
    }
    scenario = straight_scenario(braking_car(), velocity=15.0)
    found = explained(tmp_path, scenario, planner=Coast(reports))
    facts = planning_of(found)
    # The contact is at step 25: cycles 5 to 24 count, so that the slack of step 3 does not.
    assert (facts.window, facts.cycles, facts.slack_cycles) == (2.0, 20, 6)
    assert facts.slack_since == pytest.approx(0.5)  # Steps 20 to 24 without a break.
    assert facts.max_slack == pytest.approx(2.1)
    assert facts.max_road_slack == 0.25
    assert facts.statuses == {"solved": 17, "max_iterations": 3}
    assert (facts.iterations_max, facts.fallbacks) == (200, {"brake": 3})
    assert facts.pressing == {100: 6, 7: 3}
    text = "\n".join(found.lines())
    assert "6 of 20 plans enter a set, slack up to 2.10, all of them since 0.5 s" in text
    assert "fallback: brake in 3 cycles" in text
    assert "rules for which the ego stopped (cycles): light 31 (1)" in text
    assert (facts.unreachable, facts.unreachable_since) == ("heading 20 degrees off", 0.1)
    assert "no goal can be reached, all of the last 0.1 s: heading 20 degrees off" in text
    assert "decisions (cycles): change lanes behind 7 (1)" in text
    assert f"max_iterations: {SolveStatus.MAX_ITERATIONS.advice}" in text


@pytest.mark.parametrize(("slack", "since"), [(0.9 * SLACK_SEEN, None), (1.1 * SLACK_SEEN, 0.1)])
def test_what_a_solver_leaves_of_zero_is_no_slack(
    tmp_path: Path, slack: float, since: float | None
) -> None:
    scenario = straight_scenario(final_step=30)
    facts = planning_of(
        explained(tmp_path, scenario, planner=Coast({29: SolveReport(slack=slack)}))
    )
    assert facts.slack_since == (None if since is None else pytest.approx(since))
    assert facts.slack_cycles == (since is not None)


@pytest.mark.parametrize("arm", list(Arm))
def test_of_a_planner_without_a_solver_it_is_computed_which_plans_enter_a_set(
    tmp_path: Path, arm: Arm
) -> None:
    silent = dict.fromkeys(range(60), SolveReport())
    scenario = straight_scenario(braking_car(), velocity=15.0)
    found = explained(tmp_path / "hit", scenario, planner=Coast(silent), arm=arm)
    facts = planning_of(found)
    assert found.outcome is Outcome.COLLISION
    assert facts.computed
    assert facts.slack_cycles > 0
    assert facts.slack_since is not None
    assert facts.pressing == {100: facts.slack_cycles}
    assert (facts.max_slack, facts.max_road_slack, facts.iterations_max) == (None, None, None)
    text = "\n".join(found.lines())
    assert f"{facts.slack_cycles} of {facts.cycles} plans enter a set" in text
    assert "(computed from the plans and the sets that are kept)" in text
    assert "no solver: the planner does not optimise; fallback: never" in text
    assert "0.00" not in text.partition("planning,")[2].partition("smallest")[0]


def test_a_plan_beside_a_set_does_not_enter_it(tmp_path: Path) -> None:
    # The car drives beside the ego; sides 2 m wide, the sets discs of 1 m around its centre.
    silent = dict.fromkeys(range(60), SolveReport())
    for beside, entering in ((6.0, False), (2.6, True)):
        tracks = steady_tracks([[0.0, beside, 0.0, 10.0]], steps=60)
        scenario = straight_scenario(tracks, final_step=30)
        drive = Drive.of(scenario, run_episode(scenario, Coast(silent), Discs(1.0), Arm.WITH_DOS))
        facts = planning_of(explain_drive(drive))
        assert (facts.slack_cycles == facts.cycles) is entering
        assert (facts.slack_cycles > 0) is entering


def test_a_planner_without_a_solver_has_no_figures_of_one() -> None:
    scenario = straight_scenario(final_step=30)
    silent = Coast(dict.fromkeys(range(60), SolveReport()))
    row = score(scenario, run_episode(scenario, silent, Discs(1.0), Arm.WITH_DOS))
    solver = [metric for metric in METRICS if metric.group is Group.SOLVER and metric.measure]
    assert len(solver) == 6
    assert [row.measures[metric.name] for metric in solver] == [None] * 6
    assert '"max_slack": null' in row_line(row)


def test_telemetry_reaches_the_row_over_the_drive_alone() -> None:
    reports = {
        step: SolveReport(
            SolveStatus.SOLVER_ERROR if step == 2 else SolveStatus.SOLVED,
            iterations=step,
            slack=np.float64(0.01 * step),
            road_slack=0.001 * step,
            fallback="brake" if step == 2 else None,
        )
        for step in range(50)
    }
    scenario = straight_scenario(braking_car(), velocity=15.0)
    episode = run_episode(scenario, Coast(reports), Discs(1.0), Arm.WITH_DOS)
    row = score(scenario, episode)
    assert row.steps == 25  # Cycles 0 to 24.
    told = {
        "iterations_p50": 12.0,
        "iterations_max": 24,
        "max_slack": pytest.approx(0.24),
        "slack_cycles": 24,
        "max_road_slack": pytest.approx(0.024),
        "solver_failures": 1,
        "off_commonroad_road": False,
        "imposed_braking": None,
    }
    assert {name: row.measures[name] for name in told} == told
    assert row.fallback_cycles == 1
    row_line(row)  # Figures of numpy would not be JSON.


def test_rows_of_earlier_versions_are_read(tmp_path: Path) -> None:
    failed = failed_score(EpisodeKey("s", Arm.WITH_DOS), "")
    row = json.loads(row_line(failed))
    for name in measured_kinds():
        del row[name]
    path = tmp_path / "scenarios.jsonl"
    path.write_text(json.dumps(row) + "\n")
    assert read_rows(path) == [replace(failed, measures=dict.fromkeys(measured_kinds()))]


def test_what_the_solver_said_survives_the_episode_file(tmp_path: Path) -> None:
    reports = {0: SolveReport(road_slack=0.5, active_ids=(4, 2)), 2: SolveReport(active_ids=(9,))}
    scenario = straight_scenario(final_step=4)
    episode = run_episode(scenario, Coast(reports), Discs(1.0), Arm.WITH_DOS)
    path = tmp_path / "e.npz"
    Recording.of(scenario, episode).save(path)
    back = Recording.load(path)
    assert back.active_ids == ((4, 2), (), (9,), ())
    assert back.road_slack.tolist() == [0.5, 0.0, 0.0, 0.0]


def test_episode_files_of_earlier_versions_are_read(tmp_path: Path) -> None:
    scenario = straight_scenario(final_step=10)
    episode = run_episode(scenario, Coast(), Discs(1.0), Arm.WITH_DOS)
    path = tmp_path / "e.npz"
    save_as_version_0_4(path, Recording.of(scenario, episode), first=True)
    back = Recording.load(path)
    assert np.isnan(back.road_slack).all()
    assert back.active_ids == ((),) * 10
    found = explain_drive(Drive(score(scenario, episode), back, scenario))
    assert planning_of(found).max_road_slack is None
    assert "road slack was not kept" in "\n".join(found.lines())


def test_another_scenario_is_refused(tmp_path: Path) -> None:
    scenario = straight_scenario(braking_car(), velocity=15.0)
    episode = run_episode(scenario, Coast(), Discs(1.0), Arm.WITH_DOS)
    row, recording = score(scenario, episode), Recording.of(scenario, episode)
    with pytest.raises(FileError, match="its ego starts elsewhere"):
        Drive(row, recording, straight_scenario(velocity=14.0))
    with pytest.raises(FileError, match="does not touch road user 100 at step 25"):
        explain_drive(Drive(row, recording, straight_scenario(velocity=15.0)))


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_followed(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def folder(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run of them; in the second, the planner raises."""
    return run_leaky(tmp_path_factory.mktemp("run") / "mine", scenes)


def test_the_command_tells_both_arms_and_writes_the_same(
    folder: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "why.json"
    asked = ["explain", str(folder.path), "ZAM_Test-0_1_T-1"]
    assert main([*asked, "--json", str(figures)]) == OK
    shown = capsys.readouterr().out
    titles = [line for line in shown.splitlines() if not line.startswith(" ")]
    assert titles == [
        f"ZAM_Test-0_1_T-1, {arm}: goal_missed at step 10, 1.0 s after the start" for arm in Arm
    ]
    written = json.loads(figures.read_text())["explanations"]
    assert [found["arm"] for found in written] == ["with_dos", "without_dos"]
    # The ego's centre ends at x = 20 m; the goal begins at 38 m.
    assert written[0]["goals"][0]["distance"] == pytest.approx(18.0)
    assert "closest 18.00 m" in shown
    assert main([*asked, "--arm", "without_dos"]) == OK
    assert "with_dos:" not in capsys.readouterr().out.replace("without_dos:", "")


def test_the_command_tells_a_failure_and_its_traceback(
    folder: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["explain", str(folder.path), "ZAM_Test-1_1_T-1", "--arm", "with_dos"]) == OK
    shown = capsys.readouterr().out
    assert "planner_failure at step 0, 0.0 s after the start" in shown
    assert "planner leaky-v1: RuntimeError: broken for good (plugins.py:" in shown
    assert "the traceback is in episodes/ZAM_Test-1_1_T-1.with_dos.txt" in shown


def test_an_episode_that_never_began_needs_no_scenario(
    folder: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = RunFolder(tmp_path)
    copy.manifest.write_bytes(folder.manifest.read_bytes())
    copy.rows.write_text(
        row_line(failed_score(EpisodeKey("ZAM_Test-0_1_T-1", Arm.WITH_DOS), "it hung"))
    )
    asked = ["explain", str(tmp_path), "ZAM_Test-0_1_T-1", "--source", "nowhere"]
    assert main(asked) == OK
    shown = capsys.readouterr().out.splitlines()
    assert shown == [
        "ZAM_Test-0_1_T-1, with_dos: planner_failure before the first step",
        "  it hung",
    ]
    assert main([*asked, "--arm", "without_dos"]) == BAD_INPUT
    assert "holds no finished episode of" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ["RUN", "ZAM_Test-9_1_T-1"],
            "no scenario ZAM_Test-9_1_T-1; did you mean 'ZAM_Test-",
        ),
        (["RUN", "other"], "holds no scenario other"),
        (["SCENES", "ZAM_Test-0_1_T-1"], "is not a run folder: it has no run.json"),
        (["RUN", "ZAM_Test-0_1_T-1", "--source", "nowhere"], "nowhere: does not exist"),
        (["RUN", "ZAM_Test-0_1_T-1", "--source", "suite"], "suite holds no scenario"),
    ],
)
def test_bad_input_is_one_line(
    folder: RunFolder,
    scenes: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    complaint: str,
) -> None:
    places = {"RUN": str(folder.path), "SCENES": str(scenes)}
    assert main(["explain", *(places.get(word, word) for word in arguments)]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line
