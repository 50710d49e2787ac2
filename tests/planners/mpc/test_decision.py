"""What the planner decides before it optimises: gaps between others, and in which words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from dosplan_mpc.config import GapSettings, MpcConfig
from dosplan_mpc.decision import Decisions
from dosplan_mpc.goal_window import GoalWindow
from dosplan_mpc.lane_change import Gap, GapDecision, lane_changes
from dosplan_mpc.planner import MpcPlanner
from dosplan_mpc.reference import EgoOnPath, aligned_path
from dosplan_mpc.speed_profile import SpeedLimit, SpeedProfile
from dosplan_simple.sets import ErrorCirclePredictor

from dosplan.geometry import Wait
from dosplan.scenario import load_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.types import (
    Arm,
    Observation,
    Occupancy,
    Outcome,
    RoadUserKind,
    Scenario,
    StopCause,
)
from dosplan.vehicle import VehicleParameters
from tests.support import scenes

PARKED = "<rectangle><length>4.6</length><width>1.9</width></rectangle>"
STEPS = 80
DEFAULT = GapSettings()


def column_scene(
    folder: Path,
    speed: float,
    places: Sequence[float],
    start: float,
    left: bool,
    pieces: int = 1,
    bulge: float = 0.0,
) -> Scenario:
    """The ego has to go to the other of two lanes, on which a column drives.

    Args:
        folder: Where the file is written.
        speed: Speed of the column, m/s.
        places: Where its cars are at the beginning, m.
        start: Where the ego stands.
        left: Whether the ego has to go to the left.
        pieces: Number of lanelets of each lane, of 400 m.
        bulge: How far the outer edge of the other lane bulges out in the middle of the first, m.
    """
    own, other = (0.0, 3.5) if left else (3.5, 0.0)
    users = [
        scenes.User(100 + i, scenes.driving(x, other, speed, STEPS + 1))
        for i, x in enumerate(places)
    ]
    parked = scenes.User(
        500, [(start + 12.0, own, 0.0, 0.0)], kind="parkedVehicle", shape=PARKED, static=True
    )
    goal = scenes.Goal(STEPS, STEPS, scenes.on_lanelets(100 * pieces + (1 if left else 0)))
    road = list(scenes.straight_road(lanes=2, length=400.0, pieces=pieces))
    first = road[1] if left else road[0]
    edge = np.array(first.left if left else first.right)
    edge[len(edge) // 2, 1] += bulge if left else -bulge
    road[1 if left else 0] = replace(first, left=edge) if left else replace(first, right=edge)
    path = scenes.write_scenario_xml(
        folder / "column.xml",
        road,
        [*users, parked],
        [scenes.Problem(start=(start, own, 0.0, 0.0), goals=(goal,))],
    )
    return load_scenario(path)


def without_repeats(words: Sequence[str | None]) -> list[str]:
    said = [word for word in words if word is not None]
    return [word for i, word in enumerate(said) if i == 0 or word != said[i - 1]]


@pytest.mark.parametrize("left", [False, True], ids=["to the right", "to the left"])
def test_the_one_gap_of_a_column_is_taken_and_kept(tmp_path: Path, left: bool) -> None:
    # 16 m from centre to centre; the ego stands beside its end, a parked car blocks its own lane.
    places = [140.0, 132.0, 124.0, 108.0, 100.0, 92.0]
    scenario = column_scene(tmp_path, 2.0, places, 120.0, left)
    episode = run_episode(scenario, MpcPlanner(), ErrorCirclePredictor(), Arm.WITH_DOS)
    row = score(scenario, episode)
    assert row.outcome is Outcome.SUCCESS, row
    decisions = without_repeats([plan.report.decision for plan in episode.plans])
    assert decisions == ["change lanes behind 102 and in front of 103"]


class Decider:
    """A decision for a gap on a straight road, cycle by cycle, with the ego where it is put."""

    def __init__(
        self,
        folder: Path,
        settings: GapSettings = DEFAULT,
        windows: Sequence[GoalWindow] = (),
        limit: float = 100.0,
    ) -> None:
        self.scenario = column_scene(folder, 8.0, [0.0], 100.0, left=True)
        self.path = aligned_path(self.scenario.task, MpcConfig().path)
        self.limit = limit
        self.decision = GapDecision(
            settings,
            self.path,
            self.scenario.task.route,
            self.scenario.road_map,
            windows,
            VehicleParameters(),
            0.1,
        )

    def decide(self, places: Sequence[float], speed: float = 8.0) -> Gap | None:
        """Others are that far ahead of the ego, on the lane that it goes to; it drives as fast."""
        gap = self.decision.decide(*self.scene(places, speed))
        assert gap is None or isinstance(gap, Gap)
        return gap

    def scene(
        self, places: Sequence[float], speed: float = 8.0, x: float = 120.0, y: float = 0.0
    ) -> tuple[Observation, Occupancy, EgoOnPath, SpeedProfile, SpeedLimit]:
        """The same as the decision is shown it; the ego is at (x, y)."""
        task, n = self.scenario.task, len(places)
        ahead = np.array(places)
        now = np.column_stack([x + ahead, np.full(n, 3.5), np.zeros(n), np.full(n, speed)])
        ego = task.start.copy()
        ego[0] = x - VehicleParameters().rear_to_centre
        observation = Observation(
            step=0,
            dt=0.1,
            ego=ego,
            ego_history=np.tile(ego, (2, 1)),
            ids=np.arange(n) + 1,
            kinds=(RoadUserKind.CAR,) * n,
            size=np.tile([4.6, 1.9], (n, 1)),
            states=np.repeat(now[:, None], 2, axis=1),
            valid=np.ones((n, 2), dtype=np.bool_),
            road_map=self.scenario.road_map,
            task=task,
        )
        seconds = 0.1 * np.arange(1, 31)
        centre = np.repeat(now[:, None, :2], 30, axis=1)
        centre[..., 0] += speed * seconds
        occupancy = Occupancy.from_trajectory(observation, centre, np.zeros((n, 30)))
        position = float(self.path.locate(np.array([x, 0.0])))
        offset = float(self.path.project(np.array([x, y]), np.array(position))[1])
        place = EgoOnPath(0, position - VehicleParameters().rear_to_centre, offset, position, speed)
        steps = np.arange(31)
        profile = SpeedProfile(
            velocity=np.full(31, speed),
            arclength=np.asarray(position + 0.1 * speed * steps, dtype=np.float64),
            station_weight=np.zeros(31),
            offset=np.zeros(31),
            right=np.full(31, -np.inf),
            left=np.full(31, np.inf),
            heading=np.zeros(31),
            heading_weight=np.zeros(31),
            comfort=np.ones(31),
        )
        grid, most = position + np.arange(200.0), np.full(200, self.limit)
        limit = SpeedLimit(grid, most, MpcConfig().calm, most)
        return observation, occupancy, place, profile, limit


def test_a_gap_is_entered_within_the_speed_limit(tmp_path: Path) -> None:
    """The gap is ahead of the ego, which speeds up to be beside it."""
    fastest = {}
    for limit in (8.5, 100.0):
        gap = Decider(tmp_path, limit=limit).decide([-6.0, 1.5, 30.0])
        assert gap is not None
        fastest[limit] = float(gap.velocity.max())
    assert fastest[8.5] <= 8.5 + 1e-9
    assert fastest[100.0] > 9.0


def test_a_change_of_lanes_has_its_place_along_the_path(tmp_path: Path) -> None:
    scenario = column_scene(tmp_path, 8.0, [0.0], 100.0, left=True)
    path = aligned_path(scenario.task, MpcConfig().path)
    (change,) = lane_changes(scenario.task.route, scenario.road_map, path)
    for x in (90.0, 200.0):
        for at, y in ((change.before, 0.0), (change.after, 3.5)):
            point = np.array([x, y])
            along = path.locate(point)
            assert float(at(along)) == pytest.approx(float(path.project(point, along)[1]), abs=0.1)
    assert change.width == pytest.approx(3.5)
    assert change.until - change.begin > 250.0


@pytest.mark.parametrize("left", [False, True], ids=["to the right", "to the left"])
def test_a_change_of_lanes_is_possible_before_the_lanelet_at_which_the_route_has_it(
    tmp_path: Path, left: bool
) -> None:
    # The other lane bulges by 2 m at x = 50 m, which makes it 0.1 m longer there: the route, the
    # shortest one, changes lanes from the second lanelets on, at x = 100 m.
    scenario = column_scene(tmp_path, 8.0, [0.0], 20.0, left, pieces=4, bulge=2.0)
    own, other = (0, 1) if left else (1, 0)
    route = scenario.task.route
    assert route.lanelet_ids == (100 + own, 200 + own, 200 + other, 300 + other, 400 + other)
    path = aligned_path(scenario.task, MpcConfig().path)
    (change,) = lane_changes(route, scenario.road_map, path)
    assert change.width == pytest.approx(3.5)  # That of 200 + other; the one before is wider.
    # Side by side they are from x = 0 to 400 m, or to where the path ends.
    begin, end = (path.locate(np.array([x, 3.5 * own])) for x in (0.0, 400.0))
    assert change.begin == pytest.approx(float(begin), abs=0.1)
    assert change.until == pytest.approx(float(end), abs=0.1)
    outwards = 1.0 if left else -1.0
    for x, aside in ((20.0, 0.0), (50.0, 1.0), (150.0, 0.0), (290.0, 0.0)):
        # The middle of the lane that bulges out by 2 m on one side is 1 m farther out.
        for at, y in ((change.before, 3.5 * own), (change.after, 3.5 * other + outwards * aside)):
            point = np.array([x, y])
            along = path.locate(point)
            assert float(at(along)) == pytest.approx(float(path.project(point, along)[1]), abs=0.1)


def test_nothing_is_decided_where_nobody_is_in_the_way(tmp_path: Path) -> None:
    assert Decider(tmp_path).decide([-60.0, 80.0]) is None


def test_a_gap_is_kept_while_another_one_is_hardly_better(tmp_path: Path) -> None:
    # Who is abeam is passed or let by; which is better changes with every cycle's noise.
    noise = np.random.default_rng(4).normal(0.0, 0.4, (20, 3))
    places = np.array([-20.0, 1.0, 20.0]) + noise

    def sides(settings: GapSettings) -> set[tuple[int | None, int | None]]:
        decider = Decider(tmp_path, settings)
        gaps = [decider.decide(row) for row in places.tolist()]
        assert all(gap is not None for gap in gaps)
        return {(gap.behind, gap.front) for gap in gaps if gap is not None}

    assert len(sides(GapSettings(keeping=0.0))) > 1
    assert len(sides(DEFAULT)) == 1


def test_a_gap_is_given_up_when_it_closes(tmp_path: Path) -> None:
    decider = Decider(tmp_path)
    first = decider.decide([-20.0, 1.5, 20.0])
    assert first is not None
    assert (first.behind, first.front) == (2, 1)
    # The last one closes up.
    other = decider.decide([-6.0, 1.5, 20.0])
    assert other is not None
    assert (other.behind, other.front) == (3, 2)


def test_a_gap_is_not_kept_while_the_ego_stops(tmp_path: Path) -> None:
    near, past = [-20.0, 1.5, 20.0], [-20.0, 0.5, 20.0]
    lines: list[Wait | None] = []

    def chosen(stopped: bool) -> tuple[str | None, str | None]:
        """The gap that is chosen first, and the one that is when another is hardly better."""
        decider = Decider(tmp_path)
        rules = SimpleNamespace(wait=lambda *_: lines.pop(0))
        nothing = SimpleNamespace(decide=lambda *_: None)
        decisions = Decisions(cast(Any, rules), cast(Any, nothing), decider.decision, 2.2)
        red = Wait(StopCause.LIGHT, 150.0, 149.5, "light 31")
        words = []
        for places, wait in ((near, None), (near, red if stopped else None), (past, None)):
            lines.append(wait)
            scene = decider.scene(places)
            words.append(decisions.about_gaps(decisions.about_stops(*scene[:3]), *scene).words)
        assert not stopped or words[1] == "stop: light 31"
        return words[0], words[-1]

    first, other = (
        "change lanes behind 2 and in front of 1",
        "change lanes behind 3 and in front of 2",
    )
    assert chosen(stopped=False) == (first, first)
    assert chosen(stopped=True) == (first, other)


def test_who_is_pushed_back_from_a_lane_decides_anew(tmp_path: Path) -> None:
    """At x = 100 m the path is still on the lane that the route leaves."""
    decider, places = Decider(tmp_path), [-20.0, 1.5, 20.0]

    def decided(y: float) -> str:
        return type(decider.decision.decide(*decider.scene(places, x=100.0, y=y))).__name__

    assert decided(0.0) == "Gap"
    assert [decided(y) for y in (3.2, 3.6, 2.4)] == ["OnLane"] * 3
    assert [decided(y) for y in (0.9, 0.2)] == ["Gap"] * 2


def test_a_gap_in_which_the_goal_is_missed_is_passed_over(tmp_path: Path) -> None:
    # To drop back behind all of them costs least, and some metres of way.
    places = [0.5, 14.0, 28.0]
    anytime = Decider(tmp_path).decide(places)
    assert anytime is not None
    assert anytime.front is None
    start = float(Decider(tmp_path).path.locate(np.array([120.0, 0.0])))
    begin = start + 8.0 * 8.0 - 2.0  # The ego is there in 8 s if it loses no more than 2 m.
    goal = GoalWindow(0, 80, begin, begin + 10.0, 0.0, -1.0, 1.0, None, None)
    in_time = Decider(tmp_path, windows=[goal]).decide(places)
    assert in_time is not None
    assert (in_time.behind, in_time.front) == (2, 1)
