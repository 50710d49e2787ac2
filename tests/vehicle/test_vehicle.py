"""The vehicle model against closed forms, its order of convergence and CommonRoad's own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.geometry import rectangle_corners
from dosplan.types import EGO_HEADING, EGO_STEERING, EGO_VELOCITY, FloatArray
from dosplan.vehicle import VehicleParameters

VEHICLE = VehicleParameters()

states = st.builds(
    lambda *values: np.array(values),
    st.floats(-100.0, 100.0),
    st.floats(-100.0, 100.0),
    st.floats(-1.066, 1.066),
    st.floats(0.0, 50.8),
    st.floats(-10.0, 10.0),
)
inputs = st.builds(lambda *u: np.array(u), st.floats(-3.0, 3.0), st.floats(-30.0, 30.0))


def lateral(state: FloatArray) -> float:
    """Lateral acceleration of the rear axle, m/s2."""
    turned = math.tan(state[EGO_STEERING])
    return float(state[EGO_VELOCITY] ** 2 * turned / VEHICLE.wheelbase)


def drive(state: FloatArray, u: FloatArray, seconds: float, dt: float) -> FloatArray:
    for _ in range(round(seconds / dt)):
        state = VEHICLE.step(state, u, dt)
    return state


def test_straight_line_is_exact() -> None:
    # x = v t + a t^2 / 2 = 10 * 2 - 3 * 4 / 2 = 14 m along the heading; v = 10 - 3 * 2 = 4 m/s.
    end = drive(np.array([1.0, 2.0, 0.0, 10.0, 0.5]), np.array([0.0, -3.0]), 2.0, 0.1)
    wanted = [1.0 + 14.0 * math.cos(0.5), 2.0 + 14.0 * math.sin(0.5), 0.0, 4.0, 0.5]
    np.testing.assert_allclose(end, wanted, atol=1e-12)


def circle(steering: float, velocity: float, seconds: float) -> FloatArray:
    """Constant steering: a circle of radius l_wb / tan(delta) around a point on the left."""
    radius = VEHICLE.wheelbase / math.tan(steering)
    angle = velocity * seconds / radius
    return np.array(
        [radius * math.sin(angle), radius * (1 - math.cos(angle)), steering, velocity, angle]
    )


@pytest.mark.parametrize("steering", [0.3, -0.3, 0.05])
def test_constant_steering_is_a_circle(steering: float) -> None:
    end = drive(np.array([0.0, 0.0, steering, 8.0, 0.0]), np.zeros(2), 3.0, 0.1)
    np.testing.assert_allclose(end, circle(steering, 8.0, 3.0), atol=1e-4)


def test_runge_kutta_is_of_fourth_order() -> None:
    steps = np.array([0.2, 0.1, 0.05, 0.025])
    start = np.array([0.0, 0.0, 0.3, 8.0, 0.0])
    error = [
        np.linalg.norm(drive(start, np.zeros(2), 2.0, dt) - circle(0.3, 8.0, 2.0)) for dt in steps
    ]
    order = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert order == pytest.approx(4.0, abs=0.1)


def test_runge_kutta_is_of_fourth_order_while_steering_and_braking() -> None:
    start, u = np.array([0.0, 0.0, 0.2, 12.0, 0.3]), np.array([-0.3, -2.0])
    reference = drive(start, u, 2.0, 0.0025)
    steps = np.array([0.2, 0.1, 0.05])
    error = [np.linalg.norm(drive(start, u, 2.0, dt) - reference) for dt in steps]
    order = np.polyfit(np.log(steps), np.log(error), 1)[0]
    assert order == pytest.approx(4.0, abs=0.25)


@pytest.fixture(scope="module")
def vehicle_2() -> Any:
    """CommonRoad's own parameters of the vehicle, from its package of vehicle models."""
    return pytest.importorskip("vehiclemodels.parameters_vehicle2").parameters_vehicle2()


@settings(deadline=None)
@given(state=states, u=inputs)
def test_derivative_is_commonroads(vehicle_2: Any, state: FloatArray, u: FloatArray) -> None:
    dynamics = pytest.importorskip("vehiclemodels.vehicle_dynamics_ks")
    # Inputs that can be delivered, for vehicle_dynamics_ks itself cuts those beyond the limits.
    u = VEHICLE.clip_input(state, u, 0.1)
    theirs = dynamics.vehicle_dynamics_ks(list(state), list(u), vehicle_2)
    np.testing.assert_allclose(VEHICLE.derivative(state, u), theirs, rtol=1e-9, atol=1e-9)


def test_parameters_are_those_of_commonroads_vehicle_2(vehicle_2: Any) -> None:
    theirs = vehicle_2
    assert VEHICLE.length == pytest.approx(theirs.l)
    assert VEHICLE.width == pytest.approx(theirs.w)
    assert VEHICLE.wheelbase == pytest.approx(theirs.a + theirs.b)
    assert VEHICLE.rear_to_centre == pytest.approx(theirs.b)
    assert VEHICLE.max_steering == pytest.approx(theirs.steering.max)
    assert -VEHICLE.max_steering == pytest.approx(theirs.steering.min)
    assert VEHICLE.max_steering_rate == pytest.approx(theirs.steering.v_max)
    assert VEHICLE.max_acceleration == pytest.approx(theirs.longitudinal.a_max)
    assert VEHICLE.switching_velocity == pytest.approx(theirs.longitudinal.v_switch)
    assert VEHICLE.max_velocity == pytest.approx(theirs.longitudinal.v_max)


@settings(deadline=None)
@given(velocity=st.floats(0.1, 50.0), asked=st.floats(-30.0, 30.0))
def test_acceleration_limits_are_commonroads(vehicle_2: Any, velocity: float, asked: float) -> None:
    utils = pytest.importorskip("vehiclemodels.utils.acceleration_constraints")
    theirs = utils.acceleration_constraints(velocity, asked, vehicle_2.longitudinal)
    # A tiny step, within which neither standstill nor top speed is reached.
    ours = VEHICLE.clip_input(np.array([0, 0, 0, velocity, 0.0]), np.array([0.0, asked]), 1e-9)
    assert ours[1] == pytest.approx(theirs)


@given(state=states, u=inputs)
def test_what_actuators_deliver_stays_within_every_limit(state: FloatArray, u: FloatArray) -> None:
    clipped = VEHICLE.clip_input(state, u, 0.1)
    after = VEHICLE.step(state, clipped, 0.1)
    assert abs(clipped[0]) <= VEHICLE.max_steering_rate + 1e-9
    assert abs(after[EGO_STEERING]) <= VEHICLE.max_steering + 1e-9
    assert -1e-9 <= after[EGO_VELOCITY] <= VEHICLE.max_velocity + 1e-9
    if abs(lateral(state)) <= VEHICLE.max_acceleration:
        assert math.hypot(lateral(state), clipped[1]) <= VEHICLE.max_acceleration + 1e-9
        assert abs(lateral(after)) <= VEHICLE.max_acceleration + 1e-6
    else:
        assert clipped[1] == 0.0  # All grip is used up.
        assert abs(lateral(after)) <= abs(lateral(state))
    np.testing.assert_allclose(VEHICLE.clip_input(state, clipped, 0.1), clipped, atol=1e-9)


def test_grip_limits_how_far_the_wheels_turn() -> None:
    # At 20 m/s, 11.5 m/s2 are reached at atan(11.5 * 2.579 / 400) = 0.074 rad.
    state = np.array([0.0, 0.0, 0.0, 20.0, 0.0])
    for _ in range(10):
        state = VEHICLE.step(state, VEHICLE.clip_input(state, np.array([0.4, 0.0]), 0.1), 0.1)
    assert state[EGO_STEERING] == pytest.approx(0.074, abs=1e-3)
    assert lateral(state) == pytest.approx(VEHICLE.max_acceleration)
    # Half of it leaves sqrt(3) / 2 of the circle to the brakes, and none is left at all of it.
    half = np.array([0.0, 0.0, math.atan(0.5 * math.tan(state[EGO_STEERING])), 20.0, 0.0])
    hard = VEHICLE.clip_input(half, np.array([0.0, -30.0]), 0.1)
    np.testing.assert_allclose(hard, [0.0, -math.sqrt(0.75) * 11.5], atol=1e-6)
    for asked in (-30.0, 30.0):
        _, acceleration = VEHICLE.clip_input(state, np.array([0.0, asked]), 0.1)
        assert acceleration == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("asked", [-0.4, 0.0, 0.4])
def test_wheels_beyond_the_grip_go_back_at_the_full_rate(asked: float) -> None:
    # v^2 tan(delta) / l_wb = 400 * 0.309 / 2.579 = 48 m/s2.
    for side in (1.0, -1.0):
        state = np.array([0.0, 0.0, side * 0.3, 20.0, 0.0])
        assert abs(lateral(state)) == pytest.approx(48.0, abs=0.1)
        u = VEHICLE.clip_input(state, np.array([asked, -30.0]), 0.1)
        np.testing.assert_allclose(u, [-side * VEHICLE.max_steering_rate, 0.0])


def test_nobody_accelerates_into_a_bend_beyond_its_speed() -> None:
    # A radius of 10 m is good for sqrt(11.5 * 10) = 10.724 m/s; 10.5 m/s are driven.
    state = np.array([0.0, 0.0, math.atan(VEHICLE.wheelbase / 10.0), 10.5, 0.0])
    u = VEHICLE.clip_input(state, np.array([0.0, 11.5]), 0.1)
    assert VEHICLE.step(state, u, 0.1)[EGO_VELOCITY] == pytest.approx(math.sqrt(115.0))


def test_braking_stops_and_does_not_reverse() -> None:
    state = np.array([0.0, 0.0, 0.0, 0.5, 0.0])
    u = VEHICLE.clip_input(state, np.array([0.0, -11.0]), 0.1)
    assert u[1] == pytest.approx(-5.0)  # 0.5 m/s are gone after 0.1 s.
    assert VEHICLE.step(state, u, 0.1)[EGO_VELOCITY] == pytest.approx(0.0, abs=1e-12)


@given(state=states)
def test_centre_and_state_are_each_others_inverse(state: FloatArray) -> None:
    back = VEHICLE.state_at(
        VEHICLE.centre(state), state[EGO_HEADING], state[EGO_VELOCITY], state[EGO_STEERING]
    )
    np.testing.assert_allclose(back, state, atol=1e-9)


def test_rectangle_reaches_from_rear_overhang_to_front_bumper() -> None:
    # Rear axle in the origin, heading +y: the centre is 1.4227 m up, the car 4.508 m long.
    corners = rectangle_corners(
        VEHICLE.poses(np.array([0.0, 0.0, 0.0, 0.0, math.pi / 2.0])), VEHICLE.size
    )
    assert corners[:, 1].max() == pytest.approx(1.4227170936 + 2.254)
    assert corners[:, 1].min() == pytest.approx(1.4227170936 - 2.254)
    assert np.ptp(corners[:, 0]) == pytest.approx(1.61)


def test_many_states_at_once_are_one_by_one() -> None:
    rng = np.random.default_rng(3)
    many, u = rng.uniform(-1.0, 1.0, (6, 5)), rng.uniform(-1.0, 1.0, (6, 2))
    one = np.stack([VEHICLE.step(x, w, 0.1) for x, w in zip(many, u, strict=True)])
    np.testing.assert_array_equal(VEHICLE.step(many, u, 0.1), one)


def limits_one_by_one(state: FloatArray, u: FloatArray, dt: float) -> list[float]:
    """The limits of one state in plain Python, as the docstring of ``clip_input`` has them."""
    steering, velocity = float(state[EGO_STEERING]), float(state[EGO_VELOCITY])
    grip = VEHICLE.max_acceleration
    turned = min(VEHICLE.max_steering, math.atan2(grip * VEHICLE.wheelbase, velocity**2))
    rate = min(max(u[0], (-turned - steering) / dt), (turned - steering) / dt)
    rate = min(max(rate, -VEHICLE.max_steering_rate), VEHICLE.max_steering_rate)
    curvature = math.tan(max(abs(steering), abs(steering + rate * dt))) / VEHICLE.wheelbase
    left = math.sqrt(max(grip**2 - (velocity**2 * curvature) ** 2, 0.0))
    engine = grip * VEHICLE.switching_velocity / max(velocity, VEHICLE.switching_velocity)
    bend = max(math.sqrt(grip / max(curvature, 1e-9)) - velocity, 0.0) / dt
    acceleration = min(max(u[1], -velocity / dt), (VEHICLE.max_velocity - velocity) / dt)
    return [rate, min(max(acceleration, -left), left, engine, bend)]


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), dt=st.sampled_from([0.05, 0.1, 0.2]))
def test_many_inputs_are_limited_as_one_by_one(seed: int, dt: float) -> None:
    """To the last bit: what is sampled with many at once is driven with one."""
    rng = np.random.default_rng(seed)
    many = rng.uniform([-9, -9, -1.1, 0, -4], [9, 9, 1.1, 50.8, 4], (4, 7, 5))
    many[..., EGO_STEERING] *= rng.choice([0.0, 0.05, 1.0], (4, 7))
    many[..., EGO_VELOCITY] *= rng.choice([0.0, 0.1, 1.0], (4, 7))
    u = rng.uniform([-1, -20], [1, 20], (4, 7, 2)) * rng.choice([0.0, 0.2, 1.0], (4, 7, 1))
    limited = VEHICLE.clip_input(many, u, dt)
    assert limited.shape == u.shape
    for place in np.ndindex(4, 7):
        one = VEHICLE.clip_input(many[place], u[place], dt)
        assert one.tobytes() == limited[place].tobytes()
        # Near the end of the grip a root makes much of how a product is rounded.
        np.testing.assert_allclose(
            one, limits_one_by_one(many[place], u[place], dt), rtol=1e-12, atol=1e-6
        )
    # Each state with each input; one input for many states, and many inputs for one state.
    each = VEHICLE.clip_input(many[0][:, None], u[1], dt)
    assert each.shape == (7, 7, 2)
    np.testing.assert_array_equal(each[2, 5], VEHICLE.clip_input(many[0, 2], u[1, 5], dt))
    np.testing.assert_array_equal(
        VEHICLE.clip_input(many, u[0, 0], dt)[1, 2], VEHICLE.clip_input(many[1, 2], u[0, 0], dt)
    )
    np.testing.assert_array_equal(
        VEHICLE.clip_input(many[0, 0], u, dt)[1, 2], VEHICLE.clip_input(many[0, 0], u[1, 2], dt)
    )


@given(state=states)
def test_lateral_acceleration_and_engine_are_their_formulas(state: FloatArray) -> None:
    velocity, steering = state[EGO_VELOCITY], state[EGO_STEERING]
    assert VEHICLE.lateral_acceleration(velocity, steering) == pytest.approx(lateral(state))
    at_power = VEHICLE.engine_power / max(velocity, VEHICLE.switching_velocity)
    assert VEHICLE.engine_acceleration(velocity) == pytest.approx(at_power)
