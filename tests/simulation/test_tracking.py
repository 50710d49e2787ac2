"""The controller between a plan and actuators that lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from dosplan.scenario.synthetic import straight_scenario
from dosplan.simulation.actuators import Actuators
from dosplan.simulation.settings import REALISTIC, ActuatorSettings, LoopSettings
from dosplan.simulation.tracking import Command, Tracker
from dosplan.simulation.world import World
from dosplan.types import EGO_HEADING, EGO_STEERING, EGO_VELOCITY, FloatArray, Plan
from dosplan.vehicle import VehicleParameters

DT = 0.1
VEHICLE = VehicleParameters()
LAGGING = Actuators(REALISTIC.actuators, VEHICLE, DT)


def feasible(start: FloatArray, inputs: FloatArray) -> Plan:
    """A plan that the vehicle without a lag drives exactly."""
    states, applied = [start], []
    for wanted in inputs:
        applied.append(VEHICLE.clip_input(states[-1], wanted, DT))
        states.append(VEHICLE.step(states[-1], applied[-1], DT))
    return Plan(np.stack(states), np.stack(applied))


def lane_change() -> Plan:
    """To the lane 3.5 m beside, within 4 s at 15 m/s: a sine of lateral acceleration."""
    way, duration, velocity = 3.5, 4.0, 15.0
    t = DT * np.arange(41)
    lateral = 2.0 * np.pi * way / duration**2 * np.sin(2.0 * np.pi * t / duration)
    steering = np.arctan(lateral * VEHICLE.wheelbase / velocity**2)
    inputs = np.stack([np.diff(steering) / DT, np.zeros(40)], axis=1)
    return feasible(np.array([0.0, 0.0, 0.0, velocity, 0.0]), inputs)


def tight_corner() -> Plan:
    """From 8 to 3 m/s, round a corner of 5 m at nearly the full steering rate, and off again."""
    inputs = np.zeros((90, 2))
    inputs[:20, 1], inputs[65:, 1] = -2.5, 1.5
    inputs[20:34, 0], inputs[55:69, 0] = 0.35, -0.35
    return feasible(np.array([0.0, 0.0, 0.0, 8.0, 0.0]), inputs)


def s_curve() -> Plan:
    """From right to left at 9.5 m/s, at the full steering rate for more than a second."""
    steering = np.concatenate(
        [np.linspace(0.0, -0.25, 8), np.full(6, -0.25), -0.25 + 0.0395 * np.arange(1, 12)]
    )
    steering = np.concatenate([steering, np.full(4, 0.185), np.linspace(0.185, 0.0, 6)])
    inputs = np.stack([np.diff(steering) / DT, np.zeros(len(steering) - 1)], axis=1)
    return feasible(np.array([0.0, 0.0, 0.0, 9.5, 0.0]), inputs)


def driven(
    commands: Sequence[Command], start: FloatArray, actuators: Actuators = LAGGING
) -> FloatArray:
    """(T + 1, 5) the states that an ego with lagging actuators gets to."""
    states, output = [start], actuators.at_rest
    for command in commands:
        wanted = command.wanted(states[-1], output)
        applied, output = actuators.follow(states[-1], wanted, output)
        states.append(VEHICLE.step(states[-1], applied, DT))
    return np.stack(states)


def farthest(states: FloatArray, planned: FloatArray) -> float:
    return float(np.hypot(*(states - planned)[:, :2].T).max())


def untracked(plan: Plan) -> list[Command]:
    """The plan's inputs, whatever comes of them."""
    return Tracker(Actuators(ActuatorSettings(), VEHICLE, DT), VEHICLE, DT).commands(plan)


@pytest.mark.parametrize(
    ("plan", "off", "off_untracked"),
    [(lane_change(), 0.01, 0.4), (tight_corner(), 0.04, 1.5), (s_curve(), 0.12, 2.0)],
    ids=["lane change at 15 m/s", "tight corner", "s-curve"],
)
def test_a_plan_is_followed_through_the_lag(plan: Plan, off: float, off_untracked: float) -> None:
    states = driven(Tracker(LAGGING, VEHICLE, DT).commands(plan), plan.states[0])
    assert farthest(states, plan.states) < off
    assert farthest(driven(untracked(plan), plan.states[0]), plan.states) > off_untracked


def test_without_a_lag_the_plans_own_inputs_are_asked_for() -> None:
    plan = replace(lane_change(), states=np.ones((41, 5)))
    ego = np.array([3.0, 2.0, 0.1, 5.0, 1.0])
    asked = [command.wanted(ego, np.ones(2)) for command in untracked(plan)]
    np.testing.assert_array_equal(asked, plan.inputs)


def test_with_hardly_a_lag_hardly_more_is_asked_for_than_is_planned() -> None:
    barely = Actuators(ActuatorSettings(acceleration=1e-3, steering=1e-3), VEHICLE, DT)
    plan, output = tight_corner(), np.zeros(2)
    for command, state, planned in zip(
        Tracker(barely, VEHICLE, DT).commands(plan), plan.states, plan.inputs, strict=False
    ):
        np.testing.assert_allclose(command.wanted(state, output), planned, atol=0.02)
        output = planned


def test_the_states_are_followed_and_not_the_inputs() -> None:
    """States of a lane change beside inputs that say nothing of it, as a planner may have them."""
    plan = lane_change()
    silent = replace(plan, inputs=np.zeros_like(plan.inputs))
    states = driven(Tracker(LAGGING, VEHICLE, DT).commands(silent), plan.states[0])
    assert farthest(states, plan.states) < 0.05


@pytest.mark.parametrize("heading", [0.0, 3.1, -3.1])
def test_an_ego_beside_its_plan_comes_back_to_it(heading: float) -> None:
    """Half a metre beside and 0.1 rad off, with headings on both sides of the turn at pi."""
    plan = feasible(np.array([0.0, 0.0, 0.0, 10.0, heading]), np.zeros((60, 2)))
    start = plan.states[0] + np.array([-np.sin(heading), np.cos(heading), 0, -1.0, 0.1]) * 0.5
    start[EGO_HEADING] = heading + 0.1 - 2.0 * np.pi * np.sign(heading)
    start[EGO_VELOCITY] = 9.0
    error = driven(Tracker(LAGGING, VEHICLE, DT).commands(plan), start) - plan.states
    beside = np.cos(heading) * error[:, 1] - np.sin(heading) * error[:, 0]
    assert abs(beside[-20:]).max() < 0.03
    assert abs(beside).max() < 1.0
    assert beside.min() > -0.15
    assert abs(error[-10:, EGO_VELOCITY]).max() < 0.1


def test_more_than_the_vehicle_can_do_is_asked_for_and_cut() -> None:
    """A plan that steers and brakes at once as no vehicle can: limits hold, and it is caught up."""
    start = np.array([0.0, 0.0, 0.0, 15.0, 0.0])
    wild = np.tile([3.0, -40.0], (5, 1))
    states = [start]
    for wanted in wild:
        states.append(VEHICLE.step(states[-1], wanted, DT))
    rest = feasible(states[-1] * [1, 1, 0, 0, 1], np.zeros((40, 2)))
    plan = Plan(np.concatenate([states[:-1], rest.states]), np.concatenate([wild, rest.inputs]))
    reached = driven(Tracker(LAGGING, VEHICLE, DT).commands(plan), start)
    assert np.isfinite(reached).all()
    assert reached[:, EGO_VELOCITY].min() >= 0.0
    rates = np.abs(np.diff(reached[:, EGO_STEERING])) / DT
    assert rates.max() <= VEHICLE.max_steering_rate + 1e-9
    assert reached[-1, EGO_VELOCITY] == pytest.approx(0.0, abs=1e-6)


def test_a_stop_ends_where_it_is_planned_and_stays_there() -> None:
    inputs = np.zeros((60, 2))
    inputs[:20, 1] = -3.0
    plan = feasible(np.array([0.0, 0.0, 0.0, 6.0, 0.0]), inputs)
    states = driven(Tracker(LAGGING, VEHICLE, DT).commands(plan), plan.states[0])
    assert farthest(states, plan.states) < 0.05
    assert abs(states[30:, EGO_VELOCITY]).max() < 0.02
    assert farthest(driven(untracked(plan), plan.states[0]), plan.states) > 0.5


def test_an_ego_starts_from_rest_with_its_wheels_turned() -> None:
    inputs = np.zeros((40, 2))
    inputs[10:, 1] = 2.0
    plan = feasible(np.array([0.0, 0.0, 0.2, 0.0, 1.0]), inputs)
    states = driven(Tracker(LAGGING, VEHICLE, DT).commands(plan), plan.states[0])
    np.testing.assert_allclose(states[:7], plan.states[:7], atol=0.01)  # Nothing before its time.
    assert farthest(states, plan.states) < 0.03


def test_the_world_drives_commands_as_it_foresaw_them() -> None:
    loop = LoopSettings(actuators=REALISTIC.actuators)
    scenario = straight_scenario()
    world = World(scenario, loop=loop)
    wheel = np.tile([0.05, 0.5], (10, 1)) * np.sign(np.arange(10) - 4.5)[:, None]
    plan = feasible(np.array(scenario.task.start), wheel)
    commands = world.commands(plan)
    foreseen = world.foresee(commands)
    for command in commands:
        world.drive(command)
    np.testing.assert_array_equal(world.driven, foreseen)
    assert farthest(world.driven, plan.states) < 0.05
