"""Where the ego has to stop: what is kept in mind from cycle to cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import box

from dosplan.geometry import StopRules, StopSettings, Wait
from dosplan.scenario.synthetic import growing_sets
from dosplan.simulation.world import World
from dosplan.types import (
    EGO_VELOCITY,
    LightColour,
    LightStates,
    Observation,
    RouteStop,
    StopCause,
)
from tests.support.factories import ruled_scenario, stop_at, union_of

LINE = 60.0  # Arc length; x is 20 m less.
LIGHT = stop_at(StopCause.LIGHT, 40.0, 60.0, lights=(7,))
SIGN = stop_at(StopCause.STOP_SIGN, 40.0, 60.0)


def begun(
    *stops: RouteStop, users: Sequence[Sequence[float]] = ()
) -> tuple[StopRules, Observation]:
    scenario = ruled_scenario(*stops, users=users)
    return StopRules(scenario.task), World(scenario, first_step=0, history=5).observation()


def at(
    observation: Observation, velocity: float, colour: LightColour | None = None, step: int = 0
) -> Observation:
    ego = observation.ego.copy()
    ego[EGO_VELOCITY] = velocity
    lights = observation.lights
    if colour is not None:
        lights = LightStates(np.array([7]), (colour,), np.zeros(1))
    return replace(observation, ego=ego, lights=lights, step=step)


def ask(rules: StopRules, observation: Observation, front: float) -> Wait | None:
    return rules.wait(observation, growing_sets(observation), front)


def test_who_has_begun_to_stop_at_yellow_does_not_change_its_mind() -> None:
    rules, seen = begun(LIGHT)
    yellow = LightColour.YELLOW
    assert ask(rules, at(seen, 10.0, yellow), LINE - 18.0) is not None
    # 3.1 m/s2 now, since it braked a little late; for another, that is too much.
    assert ask(rules, at(seen, 10.0, yellow), LINE - 15.0) is not None
    other, _ = begun(LIGHT)
    assert ask(other, at(seen, 10.0, yellow), LINE - 16.0) is None


def test_who_stands_a_little_over_the_line_stays_there_and_who_came_over_it_goes_on() -> None:
    rules, seen = begun(LIGHT)
    red = LightColour.RED
    assert ask(rules, at(seen, 2.0, red), LINE - 1.0) is not None
    assert ask(rules, at(seen, 0.0, red), LINE + 0.4) is not None
    assert ask(rules, at(seen, 0.0, LightColour.GREEN), LINE + 0.4) is None
    assert ask(rules, at(seen, 0.0, red), LINE + 0.4) is None


@pytest.mark.parametrize(("before", "counts"), [(2.4, True), (2.6, False)])
def test_a_stand_counts_where_it_is_near_the_line(before: float, counts: bool) -> None:
    rules, seen = begun(SIGN)
    ask(rules, at(seen, 0.0), LINE - before)
    assert (ask(rules, at(seen, 1.0), LINE - 1.0) is None) == counts


def test_the_nearest_line_that_asks_is_the_one() -> None:
    crosswalk = stop_at(
        StopCause.CROSSWALK, 40.0, 45.0, lights=(7,), conflict=box(41.0, -2.0, 45.0, 5.0)
    )
    beyond = stop_at(StopCause.LIGHT, 70.0, 90.0, lights=(7,))
    rules, seen = begun(crosswalk, LIGHT, beyond)
    wait = ask(rules, at(seen, 10.0, LightColour.RED), LINE - 30.0)
    assert wait == Wait(StopCause.LIGHT, LINE, LINE - 0.5, "light 7")
    passed = ask(rules, at(seen, 10.0, LightColour.RED), LINE + 3.0)
    assert passed is not None
    assert passed.line == LINE + 30.0


def test_prediction_that_is_short_goes_on_as_it_ends() -> None:
    """From a standstill, the ego is on the others' way for longer than sets are known."""
    way = box(43.0, -10.0, 49.0, 10.0)
    stop = stop_at(StopCause.GIVE_WAY, 40.0, 60.0, conflict=way)
    comes = [46.0, -45.0, np.pi / 2.0, 10.0]  # Is there after 3.5 s; sets reach 2 s.
    rules, seen = begun(stop, users=[comes])
    wait = rules.wait(at(seen, 0.0), growing_sets(seen, 20), LINE - 1.0)
    assert wait is not None
    assert wait.reason == "give way to 100"


def test_way_is_given_to_any_component_of_a_union() -> None:
    stop = stop_at(StopCause.GIVE_WAY, 40.0, 60.0, conflict=box(43.0, -10.0, 49.0, 10.0))
    rules, seen = begun(stop, users=[[46.0, -30.0, np.pi / 2.0, 10.0]])
    comes, aside = growing_sets(seen), np.array([60.0, 0.0])
    turns = replace(comes, centre=comes.centre + aside)
    assert rules.wait(at(seen, 0.0), turns, LINE - 1.0) is None
    both = union_of([0.9, 0.1], turns, comes)
    assert rules.wait(at(seen, 0.0), both, LINE - 1.0) is not None
    # Nobody is in the room between the components.
    other = replace(comes, centre=comes.centre - aside)
    beside = union_of([0.5, 0.5], turns, other)
    assert rules.wait(at(seen, 0.0), beside, LINE - 1.0) is None
    assert rules.wait(at(seen, 0.0), replace(beside, union=None), LINE - 1.0) is not None


@pytest.mark.parametrize(("delay", "waits"), [(0, True), (3, False)])
def test_who_has_left_by_the_time_at_which_a_plan_acts_is_not_waited_for(
    delay: int, waits: bool
) -> None:
    stop = stop_at(StopCause.GIVE_WAY, 40.0, 60.0, conflict=box(40.2, -10.0, 49.0, 10.0))
    leaves = [45.0, 11.25, np.pi / 2.0, 10.0]  # Its rear is 1 m before the end of the place.
    rules, seen = begun(stop, users=[leaves])
    late = replace(at(seen, 2.0), step=delay, delay=delay)
    wait = rules.wait(late, growing_sets(seen).later(delay), LINE - 0.5)
    assert (wait is not None) == waits


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="margin is -1"):
        StopSettings(margin=-1)
    with pytest.raises(ValueError, match="hardest is 0"):
        StopSettings(hardest=0.0)
