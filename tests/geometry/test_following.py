"""Following poses in time: lines, bends, stops, and what is no trajectory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.geometry import follow_poses
from dosplan.types import EGO_HEADING, EGO_VELOCITY, FloatArray, Plan, ShapeError
from dosplan.vehicle import VehicleParameters

DT = 0.1
VEHICLE = VehicleParameters()


def ego_at(velocity: float, y: float = 0.0) -> FloatArray:
    return np.array([0.0, y, 0.0, velocity, 0.0])


def moments(last: float, every: float) -> FloatArray:
    """Times up to ``last``, ``every`` so often, s."""
    return np.asarray(every * np.arange(1, round(last / every) + 1), dtype=float)


def along_arc(way: FloatArray, radius: float) -> FloatArray:
    """(K, 3) poses on an arc to the left that begins at the origin, along x."""
    angle = way / radius
    return np.stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle], axis=1)


def off(plan: Plan, poses: FloatArray, every: int) -> float:
    """Largest distance to the poses when the ego should be there, m."""
    reached = plan.states[every::every, :2]
    return float(np.linalg.norm(reached - poses[:, :2], axis=1).max())


@given(
    radius=st.sampled_from([15.0, 40.0, -25.0, 1e6]),
    velocity=st.floats(2.0, 6.0),
    every=st.sampled_from([1, 2, 5]),
)
@settings(max_examples=40, deadline=None)
def test_who_can_be_there_in_time_is(radius: float, velocity: float, every: int) -> None:
    times = moments(4.0, every * DT)
    poses = along_arc(velocity * times, radius)
    plan = follow_poses(VEHICLE, ego_at(velocity), poses, times, DT)
    assert len(plan.inputs) == round(times[-1] / DT)
    assert off(plan, poses, every) < 0.35  # The wheels begin straight, and need 0.2 s to turn.
    assert abs(plan.states[-1, EGO_HEADING] - poses[-1, 2]) < 0.06


def test_it_brakes_and_stands_where_the_poses_do() -> None:
    times = moments(5.0, 0.5)
    way = np.where(times < 2.5, 5.0 * times - 1.0 * times**2, 6.25)  # At 2 m/s2 from 5 m/s.
    plan = follow_poses(VEHICLE, ego_at(5.0), along_arc(way, 1e6), times, DT)
    assert plan.states[-1, 0] == pytest.approx(6.25, abs=0.1)
    assert np.abs(plan.states[30:, EGO_VELOCITY]).max() < 0.2
    assert plan.inputs[:, 1].min() > -4.5  # Between poses 0.5 s apart, the stop is one of a cubic.


def test_who_is_to_stand_stands() -> None:
    poses = np.zeros((8, 3))
    plan = follow_poses(VEHICLE, ego_at(0.0), poses, moments(4.0, 0.5), DT)
    assert np.allclose(plan.states, ego_at(0.0))


def test_it_comes_back_to_poses_beside_it() -> None:
    times = moments(4.0, DT)
    poses = along_arc(8.0 * times, 1e6)[9:]
    plan = follow_poses(VEHICLE, ego_at(8.0, y=0.5), poses, times[9:], DT)
    assert abs(plan.states[-1, 1]) < 0.1
    possible = VEHICLE.clip_input(plan.states[:-1], plan.inputs, DT)
    assert np.allclose(possible, plan.inputs)


@pytest.mark.parametrize(
    ("poses", "times", "told"),
    [
        (np.zeros((3, 2)), np.arange(1.0, 4.0), "shapes .3, 2. and .3,., expected"),
        (np.zeros((3, 3)), np.arange(1.0, 5.0), "shapes .3, 3. and .4,., expected"),
        (np.full((3, 3), np.nan), np.arange(1.0, 4.0), "holds a NaN"),
        (np.zeros((3, 3)), np.array([0.0, 1.0, 2.0]), "must increase from 0 on"),
        (np.zeros((3, 3)), np.array([1.0, 1.0, 2.0]), "must increase from 0 on"),
        (np.zeros((0, 3)), np.zeros(0), "last for a step or more"),
    ],
)
def test_what_is_no_trajectory_is_named(poses: FloatArray, times: FloatArray, told: str) -> None:
    with pytest.raises(ShapeError, match=told):
        follow_poses(VEHICLE, ego_at(5.0), poses, times, DT)
