"""The planners that keep the rules of the road, on both sides of each rule's threshold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dosplan_baseline.idm import IdmPlanner, IdmSettings
from dosplan_mpc.config import MpcConfig, SpeedSettings
from dosplan_mpc.planner import MpcPlanner
from dosplan_simple.predictors import ConstantVelocityPredictor
from shapely.geometry import box

from dosplan.api import Planner
from dosplan.simulation.loop import run_episode
from dosplan.types import (
    EGO_VELOCITY,
    EGO_X,
    Arm,
    Episode,
    FloatArray,
    GoalState,
    LightColour,
    RoadUserKind,
    Scenario,
    StopCause,
)
from dosplan.vehicle import VehicleParameters
from tests.support.factories import ruled_scenario, stop_at

VEHICLE = VehicleParameters()
FRONT = VEHICLE.rear_to_centre + 0.5 * VEHICLE.length
LINE = 45.0
WAY = box(LINE + 3.0, -30.0, LINE + 9.0, 30.0)  # Of those who cross.
CROSSWALK = box(LINE + 1.0, -1.75, LINE + 5.0, 5.25)
WALKER = RoadUserKind.PEDESTRIAN
LEFTWARDS = np.pi / 2.0

both = pytest.mark.parametrize("planner", [MpcPlanner, IdmPlanner])
Make = Callable[[], Planner]


def drive(planner: Planner, scenario: Scenario) -> Episode:
    episode = run_episode(scenario, planner, ConstantVelocityPredictor(), Arm.WITH_DOS)
    assert episode.error is None, episode.error
    return episode


def front(episode: Episode) -> FloatArray:
    return episode.states[:, EGO_X] + FRONT


def velocity(episode: Episode) -> FloatArray:
    return episode.states[:, EGO_VELOCITY]


def stands_before(episode: Episode, line: float = LINE) -> bool:
    """It came to stand near the line, and never was beyond it."""
    near = (front(episode) > line - 2.5) & (velocity(episode) < 0.3)
    return bool(front(episode).max() <= line and near.any())


def at_light(*colours: LightColour, line: float = LINE, **more: Any) -> Scenario:
    stop = stop_at(StopCause.LIGHT, line, line + 20.0, lights=(7,))
    return ruled_scenario(stop, lights={7: colours}, **more)


@both
@pytest.mark.parametrize("colour", [LightColour.RED, LightColour.RED_YELLOW])
def test_red_light_stops_the_ego(planner: Make, colour: LightColour) -> None:
    episode = drive(planner(), at_light(colour))
    assert stands_before(episode)
    assert episode.plans[20].report.waits_for == "light 7"


@both
@pytest.mark.parametrize("colour", [LightColour.GREEN, LightColour.INACTIVE])
def test_other_lights_do_not_slow_it_down(planner: Make, colour: LightColour) -> None:
    episode = drive(planner(), at_light(colour))
    assert velocity(episode).min() > 9.8
    assert all(plan.report.waits_for is None for plan in episode.plans)


@both
def test_plans_without_a_stop_are_the_same_to_the_last_bit(planner: Make) -> None:
    users = [[30.0, 0.0, 0.0, 8.0], [60.0, 3.5, 0.0, 6.0]]
    free = drive(planner(), ruled_scenario(users=users, seconds=4.0))
    green = drive(planner(), at_light(LightColour.GREEN, users=users, limit=10.5, seconds=4.0))
    for one, other in zip(free.plans, green.plans, strict=True):
        np.testing.assert_array_equal(one.states, other.states)
        np.testing.assert_array_equal(one.inputs, other.inputs)


@both
def test_a_light_for_another_way_does_not_stop_it(planner: Make) -> None:
    stop = stop_at(StopCause.LIGHT, LINE, LINE + 20.0, lights=(7,))
    lights = {7: [LightColour.GREEN], 8: [LightColour.RED]}
    episode = drive(planner(), ruled_scenario(stop, lights=lights))
    assert velocity(episode).min() > 9.8


@both
def test_it_goes_on_when_the_light_turns_green(planner: Make) -> None:
    colours = [LightColour.RED] * 80 + [LightColour.GREEN]
    episode = drive(planner(), at_light(*colours, seconds=14.0))
    assert front(episode)[:81].max() <= LINE
    assert velocity(episode)[:81].min() < 0.5
    assert front(episode)[-1] > LINE + 5.0


@both
def test_a_follower_does_not_push_it_over_the_line(planner: Make) -> None:
    """It comes nearer than mpc keeps from a set, and stands there."""
    behind = FRONT - 1.0 - VEHICLE.length - 0.3 - 2.25
    scenario = at_light(
        LightColour.RED,
        line=FRONT + 1.0,
        users=[[behind, 0.0, 0.0, 0.0]],
        velocity=0.0,
        seconds=3.0,
    )
    assert front(drive(planner(), scenario)).max() <= FRONT + 1.0


@both
@pytest.mark.parametrize(("way", "stops"), [(13.0, False), (20.0, True)])
def test_yellow_light_stops_who_can_brake_comfortably(
    planner: Make, way: float, stops: bool
) -> None:
    """At 10 m/s and 3 m/s2 it takes 16.7 m to stop."""
    line = FRONT + way
    episode = drive(planner(), at_light(LightColour.YELLOW, line=line))
    if stops:
        assert stands_before(episode, line)
    else:
        assert velocity(episode).min() > 9.5


@both
@pytest.mark.parametrize(("way", "stops"), [(5.0, False), (11.0, True)])
def test_red_light_that_is_too_near_does_not_stop_it_in_the_crossing(
    planner: Make, way: float, stops: bool
) -> None:
    """At 10 m/s and 8 m/s2 it takes 6.25 m to stop."""
    line = FRONT + way
    episode = drive(planner(), at_light(LightColour.RED, line=line))
    assert (front(episode).max() <= line) == stops
    if not stops:
        assert velocity(episode).min() > 9.0


@both
def test_stop_sign_asks_for_a_standstill_and_no_more(planner: Make) -> None:
    stop = stop_at(StopCause.STOP_SIGN, LINE, LINE + 15.0, conflict=WAY)
    episode = drive(planner(), ruled_scenario(stop, seconds=14.0))
    stands = velocity(episode) < 0.3
    assert stands.any()
    assert np.all(np.abs(front(episode)[stands] - LINE) < 2.5)
    assert front(episode)[-1] > LINE + 5.0
    assert episode.plans[20].report.waits_for == "stop sign"


@both
def test_light_that_is_lit_overrules_a_stop_sign(planner: Make) -> None:
    stop = stop_at(StopCause.STOP_SIGN, LINE, LINE + 15.0, lights=(7,), conflict=WAY)
    episode = drive(planner(), ruled_scenario(stop, lights={7: [LightColour.GREEN]}))
    assert velocity(episode).min() > 9.8


@both
@pytest.mark.parametrize(("distance", "stops"), [(35.0, True), (140.0, False)])
def test_it_gives_way_to_who_comes(planner: Make, distance: float, stops: bool) -> None:
    """At 8 m/s, one is on the ego's way when the ego would be, the other long after it."""
    stop = stop_at(StopCause.GIVE_WAY, LINE, LINE + 15.0, conflict=WAY)
    user = [LINE + 6.0, -distance, LEFTWARDS, 8.0]
    episode = drive(planner(), ruled_scenario(stop, users=[user], seconds=12.0))
    if not stops:
        assert velocity(episode).min() > 9.5
        return
    y = -distance + 0.8 * np.arange(len(episode.states))
    in_the_way = np.abs(y) < 1.75 + 2.25
    assert front(episode)[in_the_way].max() < LINE
    assert front(episode)[-1] > LINE + 5.0
    assert episode.plans[15].report.waits_for == "give way to 100"


@both
def test_it_does_not_give_way_to_its_own_leader(planner: Make) -> None:
    stop = stop_at(StopCause.GIVE_WAY, LINE, LINE + 15.0, conflict=WAY)
    episode = drive(planner(), ruled_scenario(stop, users=[[30.0, 0.0, 0.0, 10.0]]))
    assert all(plan.report.waits_for is None for plan in episode.plans)


@both
@pytest.mark.parametrize(
    ("walker", "stops"),
    [
        pytest.param([LINE + 3.0, -6.5, LEFTWARDS, 1.2], True, id="is about to cross"),
        pytest.param([LINE + 3.0, -2.0, LEFTWARDS, 0.0], True, id="stands at the edge"),
        pytest.param([LINE + 3.0, -5.0, LEFTWARDS, 0.0], False, id="stands farther away"),
        pytest.param([LINE - 20.0, -4.0, 0.0, 1.4], False, id="walks along the road"),
        pytest.param([LINE + 3.0, 2.5, LEFTWARDS, 1.4], False, id="has crossed"),
    ],
)
def test_crosswalk_is_for_who_is_on_it_or_before_it(
    planner: Make, walker: list[float], stops: bool
) -> None:
    stop = stop_at(StopCause.CROSSWALK, LINE, LINE + 5.0, conflict=CROSSWALK)
    scenario = ruled_scenario(stop, users=[walker], kinds=[WALKER], seconds=15.0)
    episode = drive(planner(), scenario)
    reasons = {plan.report.waits_for for plan in episode.plans}
    assert ("crosswalk, for 100" in reasons) == stops
    if stops:
        assert velocity(episode)[front(episode) < LINE + 1.0].min() < 3.0
        assert front(episode)[-1] > LINE + 5.0


@both
def test_who_waits_at_a_green_light_does_not_hold_it(planner: Make) -> None:
    stop = stop_at(StopCause.CROSSWALK, LINE, LINE + 5.0, lights=(7,), conflict=CROSSWALK)
    scenario = ruled_scenario(
        stop,
        users=[[LINE + 3.0, -2.5, LEFTWARDS, 0.0]],
        kinds=[WALKER],
        lights={7: [LightColour.GREEN]},
    )
    assert all(p.report.waits_for is None for p in drive(planner(), scenario).plans)


@pytest.mark.parametrize(
    ("strict", "loose"),
    [
        (
            lambda: MpcPlanner(),
            lambda: MpcPlanner(settings=MpcConfig(speed=SpeedSettings(limit_factor=1.3))),
        ),
        (lambda: IdmPlanner(), lambda: IdmPlanner(settings=IdmSettings(limit_factor=1.3))),
    ],
    ids=["mpc", "idm"],
)
def test_speed_limit_is_kept_as_strictly_as_it_is_set(strict: Make, loose: Make) -> None:
    scenario = ruled_scenario(limit=8.0)
    assert velocity(drive(strict(), scenario))[50:].max() < 8.3
    assert velocity(drive(loose(), scenario)).min() > 9.5


@pytest.mark.parametrize(
    ("lax", "strict"),
    [
        (
            lambda: MpcPlanner(),
            lambda: MpcPlanner(settings=MpcConfig(speed=SpeedSettings(limit_first=True))),
        ),
        (lambda: IdmPlanner(), lambda: IdmPlanner(settings=IdmSettings(limit_first=True))),
    ],
    ids=["mpc", "idm"],
)
def test_deadline_of_a_goal_goes_before_the_limit_unless_it_is_set_otherwise(
    lax: Make, strict: Make
) -> None:
    goal = GoalState(0, 80, box(70.0, -1.0, 90.0, 1.0))
    scenario = ruled_scenario(limit=7.0, goals=[goal], seconds=8.0)
    assert drive(lax(), scenario).end.value == "goal_reached"
    assert velocity(drive(strict(), scenario))[-1] < 7.3
