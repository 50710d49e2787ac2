"""CommonRoad's cost functions by hand; ``tests/oracle/test_cost_functions.py`` is their oracle."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dosplan.geometry import wrap_angle
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import known_drive
from dosplan.types import Arm, GoalState, Scenario, Tracks
from dosplan.vehicle import VehicleParameters

STEPS = 20
T = 0.1 * STEPS


def costs(
    velocity: npt.NDArray[Any],
    steering: npt.NDArray[Any] | float = 0.0,
    heading: float = 0.0,
    aside: float = 0.0,
    tracks: Tracks | None = None,
    wanted: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """The costs of a drive along a straight road."""
    goal = GoalState(STEPS, STEPS, velocity=wanted)
    scenario: Scenario = straight_scenario(
        *(() if tracks is None else (tracks,)), goals=[goal], final_step=STEPS, velocity=10.0
    )
    vehicle = VehicleParameters()
    start = vehicle.centre(scenario.task.start)
    way = np.concatenate([[0.0], np.cumsum(0.05 * (velocity[1:] + velocity[:-1]))])
    states = np.array(
        [
            vehicle.state_at(start + np.array([s, aside]), heading, v, d)
            for s, v, d in zip(
                way, velocity, np.broadcast_to(steering, velocity.shape), strict=True
            )
        ]
    )
    found = score(scenario, known_drive(scenario, Arm.WITH_DOS, 0, states)).measures
    return {name[5:].upper(): value for name, value in found.items() if name.startswith("cost_")}


def test_a_drive_at_constant_speed() -> None:
    found = costs(np.full(STEPS + 1, 10.0))
    assert found == pytest.approx(
        {
            "JB1": T,
            "MW1": 1.0 / T,
            "SA1": 0.0,
            "SM1": 10.0 * T,
            "SM2": 10.0 * T,
            "SM3": 0.0,
            "TR1": 0.0,
            "WX1": 10.0 * T + 10.0 * 10.0 * T,
        }
    )


def test_braking_and_the_velocity_that_is_wanted() -> None:
    """Integrals are Simpson's over the samples: of the acceleration there is one less."""
    velocity = 10.0 - 2.0 * 0.1 * np.arange(STEPS + 1)
    found = costs(velocity, wanted=(5.0, 7.0))
    length = 10.0 * T - 0.5 * 2.0 * T**2
    offset = ((10.0 - 5.0) ** 3 - (6.0 - 5.0) ** 3) / (3.0 * 2.0)
    braking = 4.0 * (T - 0.1)
    assert found["SM1"] == pytest.approx(50.0 * braking + length + 20.0 * offset)
    assert found["SM2"] == pytest.approx(50.0 * braking + length)
    assert found["SM3"] == pytest.approx(50.0 * braking + 20.0 * offset)
    assert found["WX1"] == pytest.approx(10.0 * T + offset + 0.1 * braking + 10.0 * length)
    assert found["MW1"] == pytest.approx(0.2 * offset + 1.0 / T)


def test_an_interval_from_zero_on_is_a_limit_and_wants_no_velocity() -> None:
    assert costs(np.full(STEPS + 1, 10.0), wanted=(0.0, 12.0))["SM3"] == 0.0


def test_jerk() -> None:
    """The acceleration grows by 1 m/s3: 50 a2 is small, the third difference is 1."""
    t = 0.1 * np.arange(STEPS + 1)
    found, plain = costs(10.0 + 0.5 * t**2), costs(np.full(STEPS + 1, 10.0))
    assert found["TR1"] == pytest.approx(0.01 * (T - 0.2))
    assert found["MW1"] == pytest.approx(plain["MW1"] + 0.5 * (T - 0.2))


def test_steering() -> None:
    steering = 0.01 * 0.1 * np.arange(STEPS + 1)
    found = costs(np.full(STEPS + 1, 10.0), steering)
    angle, rate = 0.01**2 * T**3 / 3.0, 0.01**2 * (T - 0.1)
    assert found["SA1"] == pytest.approx(0.1 * (angle + rate))
    assert found["SM3"] == pytest.approx(50.0 * (angle + rate))
    assert found["TR1"] == pytest.approx(22.0 * rate)


def test_lane() -> None:
    found = costs(np.full(STEPS + 1, 10.0), heading=0.02, aside=0.3)
    assert found["SM3"] == pytest.approx(50.0 * wrap_angle(0.02) ** 2 * T)
    assert found["TR1"] == pytest.approx(0.5 * 0.3**2 * T)


@pytest.mark.parametrize(
    ("x", "y", "counts"), [(30.0, 0.0, True), (30.0, 2.9, False), (-30.0, 0.0, False)]
)
def test_only_somebody_ahead_is_near(x: float, y: float, counts: bool) -> None:
    """Everybody drives at 10 m/s, so that the distance stays."""
    scenario = straight_scenario(velocity=10.0)
    start = VehicleParameters().centre(scenario.task.start)
    tracks = steady_tracks([[start[0] + x, start[1] + y, 0.0, 10.0]], steps=60)
    near = np.exp(-0.2 * (30.0 - 1.61 / 2.5)) * T
    found = costs(np.full(STEPS + 1, 10.0), tracks=tracks)
    assert found["SA1"] == pytest.approx(1e5 * near if counts else 0.0, rel=1e-3)


def test_a_drive_that_solves_nothing_has_no_cost() -> None:
    scenario = straight_scenario(goals=[GoalState(STEPS, STEPS)], final_step=STEPS)
    states = np.repeat(scenario.task.start[None], STEPS + 1, axis=0)
    found = score(scenario, known_drive(scenario, Arm.WITH_DOS, 0, states)).measures
    assert found["cost_sm1"] is None
