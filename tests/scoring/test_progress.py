"""What progress is expected, and what is made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from dosplan.scenario.synthetic import straight_scenario
from dosplan.scoring.progress import (
    is_time_alone,
    makes_progress,
    needed_progress,
    progress_ratio,
)
from dosplan.scoring.score import score
from dosplan.simulation.loop import known_drive
from dosplan.types import (
    COLOURS,
    EGO_HEADING,
    EGO_VELOCITY,
    Arm,
    GoalState,
    LightColour,
    Outcome,
    RouteStop,
    Scenario,
    Signals,
    StopCause,
)
from tests.support.factories import arc_route

BOX = shapely.box(40.0, -2.0, 60.0, 2.0)


def needed(scenario: Scenario) -> float:
    return needed_progress(scenario, scenario.tracks, scenario.signals)


@pytest.mark.parametrize(
    ("goal", "alone"),
    [
        (GoalState(0, 9), True),
        (GoalState(0, 9, heading=(-1.0, 1.0)), True),
        (GoalState(0, 9, BOX), False),
        (GoalState(0, 9, velocity=(0.0, 0.1)), False),
    ],
)
def test_only_a_goal_that_asks_for_nothing_else_is_a_time_alone(
    goal: GoalState, alone: bool
) -> None:
    assert is_time_alone(goal) is alone


@pytest.mark.parametrize(
    ("progress", "expected", "ratio"),
    [
        (30.0, 30.0, 1.0),
        (40.0, 30.0, 1.0),
        (15.0, 30.0, 0.5),
        (0.0, 30.0, 2.0 / 30.0),
        (-2.0, 30.0, 2.0 / 30.0),
        (-2.1, 30.0, 0.0),
        (0.0, 0.0, 1.0),
        (0.0, 2.0, 1.0),
        (-2.1, 0.0, 0.0),
    ],
)
def test_nuplans_ratio(progress: float, expected: float, ratio: float) -> None:
    assert progress_ratio(progress, expected) == pytest.approx(ratio)


def test_a_fifth_is_progress() -> None:
    assert makes_progress(6.0, 30.0)
    assert not makes_progress(5.99, 30.0)


def test_the_nearest_of_several_goals_is_expected() -> None:
    scenario = straight_scenario(goals=[GoalState(0, 50, BOX)], velocity=10.0)
    start = scenario.task.vehicle.centre(scenario.task.start)[0]
    # The path has a point every so often; the first in the region counts.
    assert needed(scenario) == pytest.approx(40.0 - start, abs=0.5)
    soon = replace(scenario.task, goals=(GoalState(0, 50, BOX), GoalState(20, 50)))
    assert needed(replace(scenario, task=soon)) == pytest.approx(20.0)
    behind = replace(scenario.task, goals=(GoalState(0, 50, shapely.box(-40, -2, -30, 2)),))
    assert needed(replace(scenario, task=behind)) == 0.0


def at_light(colour: LightColour, from_step: int = 0) -> Scenario:
    """A start at 10 m/s, a line 12 m before the ego's front, and a goal in 3 s."""
    scenario = straight_scenario(goals=[GoalState(30, 30)], final_step=30, velocity=10.0)
    task = scenario.task
    front = task.vehicle.centre(task.start)[0] + 0.5 * task.vehicle.length
    at = float(front - task.route.path[0, 0]) + 12.0
    stop = RouteStop(StopCause.LIGHT, at, at + 20.0, lights=(3,))
    colours = np.full((1, 31), COLOURS.index(LightColour.GREEN))
    colours[0, from_step:] = COLOURS.index(colour)
    return replace(
        scenario,
        task=replace(task, route=replace(task.route, stops=(stop,))),
        signals=Signals(np.array([3]), colours, np.zeros((1, 31))),
    )


@pytest.mark.parametrize(
    ("scenario", "way"),
    [
        (at_light(LightColour.RED), 12.0),
        (at_light(LightColour.RED, 30), 12.0),
        (at_light(LightColour.YELLOW), 30.0),
        (at_light(LightColour.GREEN), 30.0),
    ],
)
def test_nobody_has_to_pass_a_red_light(scenario: Scenario, way: float) -> None:
    assert needed(scenario) == pytest.approx(way, abs=1e-6)


def test_who_waits_at_a_red_light_succeeds_where_the_goal_is_a_time() -> None:
    """Two metres and a half, then standing: a fifth of the way to the line, not of 30 m."""
    outcomes = {}
    for colour in (LightColour.RED, LightColour.GREEN):
        scenario = at_light(colour)
        states = np.repeat(scenario.task.start[None], 31, axis=0)
        states[:, 0] += np.minimum(np.arange(31), 2.5)
        states[3:, 3] = 0.0
        outcomes[colour] = score(scenario, known_drive(scenario, Arm.WITH_DOS, 0, states)).outcome
    assert outcomes == {LightColour.RED: Outcome.SUCCESS, LightColour.GREEN: Outcome.GOAL_MISSED}


def test_progress_round_a_ring_is_the_way_that_was_driven() -> None:
    """A lap and a half, half a metre beside the path: the first lap is as near as the second."""
    radius, velocity, dt = 30.0, 10.0, 0.1
    straight = straight_scenario(velocity=velocity, final_step=400)
    route = arc_route(radius, length=2.4 * 2.0 * np.pi * radius)
    road_map = replace(straight.road_map, drivable=shapely.box(-200, -200, 200, 200))
    angle = (5.0 + velocity * dt * np.arange(1.5 * 2.0 * np.pi * radius)) / radius
    centre = np.stack([np.sin(angle), -np.cos(angle)], axis=1) * (radius + 0.5) + [0.0, radius]
    vehicle = straight.task.vehicle
    forward = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    states = np.zeros((len(angle), 5))
    states[:, :2] = centre - vehicle.rear_to_centre * forward
    states[:, EGO_HEADING], states[:, EGO_VELOCITY] = angle, velocity
    task = replace(straight.task, route=route, start=states[0], goals=(GoalState(400, 400),))
    scenario = replace(straight, road_map=road_map, task=task)
    found = score(scenario, known_drive(scenario, Arm.WITH_DOS, 0, states))
    assert found.progress == pytest.approx(radius * (angle[-1] - angle[0]), abs=0.5)
