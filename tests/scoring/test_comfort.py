"""Comfort: known drives, and each of nuPlan's bounds from both sides."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from dosplan.scoring.comfort import comfort
from dosplan.types import EGO_HEADING, EGO_VELOCITY, FloatArray
from dosplan.vehicle import VehicleParameters

DT = 0.1


def drive(velocity: npt.ArrayLike, heading: npt.ArrayLike) -> FloatArray:
    """Ego states with these velocities and headings; comfort looks at nothing else."""
    states = np.zeros((np.size(velocity), 5))
    states[:, EGO_VELOCITY], states[:, EGO_HEADING] = velocity, heading
    return states


T = DT * np.arange(41)
STRAIGHT = np.zeros_like(T)


@pytest.mark.parametrize(
    ("acceleration", "comfortable"), [(2.39, True), (2.41, False), (-4.04, True), (-4.06, False)]
)
def test_longitudinal_acceleration(acceleration: float, comfortable: bool) -> None:
    result = comfort(drive(20.0 + acceleration * T, STRAIGHT), DT)
    assert result.comfortable is comfortable
    assert result.acceleration == pytest.approx(abs(acceleration))
    assert result.jerk == pytest.approx(0.0, abs=1e-9)


# Lateral acceleration is velocity times yaw rate; 20 m/s keeps the yaw rate in bounds.
@pytest.mark.parametrize(("lateral", "comfortable"), [(4.88, True), (4.90, False), (-4.90, False)])
def test_lateral_acceleration(lateral: float, comfortable: bool) -> None:
    result = comfort(drive(20.0 + STRAIGHT, lateral / 20.0 * T), DT)
    assert result.comfortable is comfortable
    assert result.lateral_acceleration == pytest.approx(abs(lateral))


# A quadratic velocity: the acceleration rises linearly, which the filters leave as it is. It goes
# from -j to +j, within the bounds on acceleration only for a short drive.
@pytest.mark.parametrize(("jerk", "comfortable"), [(4.12, True), (4.14, False), (-4.14, False)])
def test_longitudinal_jerk(jerk: float, comfortable: bool) -> None:
    t = DT * np.arange(11) - 0.5
    result = comfort(drive(20.0 + 0.5 * jerk * t**2, np.zeros_like(t)), DT)
    assert result.comfortable is comfortable
    assert result.jerk == pytest.approx(abs(jerk))


# Lateral acceleration v w with a yaw acceleration a has the jerk v a, here past |jerk| at
# 8.37 = 5 * 1.674; the lateral one stays below 5 * 1.674 * 0.5.
@pytest.mark.parametrize(("rate", "comfortable"), [(1.60, True), (1.70, False)])
def test_jerk_of_the_whole_acceleration(rate: float, comfortable: bool) -> None:
    t = DT * np.arange(6)
    result = comfort(drive(5.0 + 0.0 * t, 0.5 * rate * t**2), DT)
    assert result.comfortable is comfortable
    assert result.jerk == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("rate", "comfortable"), [(0.94, True), (0.96, False), (-0.96, False)])
def test_yaw_rate(rate: float, comfortable: bool) -> None:
    assert comfort(drive(1.0 + STRAIGHT, rate * T), DT).comfortable is comfortable


@pytest.mark.parametrize(("rate", "comfortable"), [(1.92, True), (1.94, False), (-1.94, False)])
def test_yaw_acceleration(rate: float, comfortable: bool) -> None:
    t = DT * np.arange(9) - 0.4
    assert comfort(drive(1.0 + 0.0 * t, 0.5 * rate * t**2), DT).comfortable is comfortable


def test_headings_are_unwrapped() -> None:
    heading = (0.2 * T + 3.0 + np.pi) % (2.0 * np.pi) - np.pi
    result = comfort(drive(5.0 + STRAIGHT, heading), DT)
    assert result.comfortable
    assert result.lateral_acceleration == pytest.approx(1.0)


@pytest.mark.parametrize("states", [1, 2, 3])
def test_a_drive_too_short_to_tell_is_comfortable(states: int) -> None:
    result = comfort(drive(np.linspace(10.0, 0.0, states), np.zeros(states)), DT)
    assert result.comfortable
    assert result.acceleration == 0.0


def test_driven_states_give_back_the_acceleration_that_was_held() -> None:
    vehicle = VehicleParameters()
    state = np.array([0.0, 0.0, 0.05, 10.0, 0.0])
    states = [state]
    for _ in range(30):
        state = vehicle.step(state, np.array([0.0, -1.5]), DT)
        states.append(state)
    result = comfort(np.array(states), DT)
    # Lateral: v^2 tan(steering) / wheelbase in the middle of the first step, v = 9.925 m/s.
    lateral = 9.925**2 * np.tan(0.05) / vehicle.wheelbase
    assert result.acceleration == pytest.approx(1.5)
    assert result.lateral_acceleration == pytest.approx(lateral, rel=1e-3)
