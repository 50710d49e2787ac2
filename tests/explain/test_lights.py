"""What is told of traffic lights, in drives whose lights are made for it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dosplan.explain import explain_drive
from dosplan.explain.lights import LightFacts, light_facts
from dosplan.results.drive import Drive
from dosplan.scenario.synthetic import straight_scenario
from dosplan.simulation.loop import run_episode
from dosplan.types import (
    COLOURS,
    USER_VELOCITY,
    USER_X,
    Arm,
    LightColour,
    RouteStop,
    Scenario,
    StopCause,
)
from tests.support.lights import LEFT, STOP_X, TURNS_GREEN, regulated_scenario
from tests.support.plugins import CoastPlanner, GrowingPredictor

GREEN_AT = TURNS_GREEN / 10.0


def _at_light(velocity: float, colour: LightColour | None = None) -> Scenario:
    """The ego with one light ahead; it turns green after two seconds, or shows a colour always."""
    scenario = regulated_scenario()
    own, *others = scenario.road_map.lanelets
    assert own.stop_line is not None
    own = replace(own, lights=(LEFT,), stop_line=replace(own.stop_line, lights=(LEFT,)))
    start = straight_scenario(velocity=velocity).task.start
    route = scenario.task.route
    line = STOP_X - route.path[0, 0]
    stop = RouteStop(StopCause.LIGHT, line, line + 20.0, lights=(LEFT,))
    signals = scenario.signals
    if colour is not None:
        colours = signals.colours.copy()
        colours[0] = COLOURS.index(colour)
        # It has been so for a second and a half when the recording begins.
        signals = replace(signals, colours=colours, since=signals.since[[1, 1, 2]] + 1.5)
    return replace(
        scenario,
        road_map=replace(scenario.road_map, lanelets=(own, *others)),
        task=replace(scenario.task, start=start, route=replace(route, stops=(stop,))),
        signals=signals,
    )


def _driven(scenario: Scenario) -> Drive:
    episode = run_episode(scenario, CoastPlanner(), GrowingPredictor(), Arm.WITH_DOS)
    return Drive.of(scenario, episode)


def _facts(drive: Drive) -> LightFacts:
    facts = light_facts(drive)
    assert facts is not None
    return facts


def test_a_wait_is_told_with_its_light_and_since_when_it_was_red() -> None:
    drive = _driven(_at_light(velocity=0.0))
    facts = _facts(drive)
    (wait,) = facts.waits
    assert not facts.runs
    front = drive.ego[0, USER_X] + 0.5 * drive.vehicle.length
    assert wait.lights == (LEFT,)
    assert wait.distance == pytest.approx(STOP_X - front, abs=1e-6)
    times = (wait.start, wait.end, wait.red_since, wait.red_until)
    assert times == pytest.approx((0.0, GREEN_AT, 0.0, GREEN_AT))
    assert wait.line() == (
        f"stood 2.0 s before light 1, {STOP_X - front:.1f} m before the line, from 0.0 s on; "
        "red since 0.0 s after the start, until 2.0 s"
    )


def test_a_light_that_stays_red_has_no_end() -> None:
    drive = _driven(_at_light(velocity=0.0, colour=LightColour.RED))
    (wait,) = _facts(drive).waits
    assert wait.red_until is None
    assert wait.end == pytest.approx(drive.seconds(drive.start + drive.row.steps))


@pytest.mark.parametrize("colour", [LightColour.RED, LightColour.RED_YELLOW])
def test_a_red_light_that_is_run_is_named_with_its_step(colour: LightColour) -> None:
    drive = _driven(_at_light(velocity=10.0, colour=colour))
    facts = _facts(drive)
    (run,) = facts.runs
    assert not facts.waits
    front = drive.ego[:, USER_X] + 0.5 * drive.vehicle.length
    index = run.step - drive.start
    assert front[index] <= STOP_X < front[index + 1]
    assert (run.lights, run.colour) == ((LEFT,), colour)
    assert run.velocity == pytest.approx(drive.ego[index, USER_VELOCITY])
    assert run.shown_since == pytest.approx(-1.5)
    word = "red since" if colour is LightColour.RED else "red with yellow since"
    (line,) = (x for x in explain_drive(drive).lines() if x.startswith("  ran light 1 at step"))
    assert line.endswith(f"{word} 1.5 s before the start")
    assert drive.row.measures["red_lights"] == 1


@pytest.mark.parametrize("colour", [None, LightColour.GREEN, LightColour.YELLOW])
def test_lights_that_let_one_pass_are_not_told(colour: LightColour | None) -> None:
    drive = _driven(_at_light(velocity=10.0, colour=colour))
    assert light_facts(drive) is None
    assert drive.row.measures["red_lights"] == 0


def test_who_stands_far_from_the_line_or_at_green_does_not_wait() -> None:
    far = _at_light(velocity=0.0, colour=LightColour.RED)
    (stop,) = far.task.route.stops
    moved = replace(stop, arclength=stop.arclength + 40.0)
    route = replace(far.task.route, stops=(moved,))
    assert light_facts(_driven(replace(far, task=replace(far.task, route=route)))) is None
    assert light_facts(_driven(_at_light(velocity=0.0, colour=LightColour.GREEN))) is None
