"""The filter between what is measured of the road users and what is seen of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dosplan.geometry import wrap_angle
from dosplan.simulation.filtering import TrackFilter
from dosplan.simulation.sensing import gauss_markov
from dosplan.simulation.settings import REALISTIC, SensingSettings
from dosplan.types import FloatArray

DT, STEPS, TRACKS = 0.1, 100, 200
SENSING = REALISTIC.sensing
DEVIATIONS = np.array([SENSING.position, SENSING.position, SENSING.heading, SENSING.speed])


def driven(velocity: FloatArray, curvature: float = 0.0, heading: float = 0.0) -> FloatArray:
    """(TRACKS, STEPS, 4) as many times the same road user: a bend at a velocity over time."""
    way = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[:-1] + velocity[1:]) * DT)])
    course = heading + curvature * way
    middle = 0.5 * (course[1:] + course[:-1])
    steps = np.stack([np.cos(middle), np.sin(middle)], axis=1) * np.diff(way)[:, None]
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.tile(np.column_stack([place, course, velocity]), (TRACKS, 1, 1))


def measured(truth: FloatArray) -> FloatArray:
    noise = np.random.default_rng(3).standard_normal((TRACKS, STEPS, 4))
    return truth + DEVIATIONS * gauss_markov(noise, DT, SENSING.correlation)


def estimated(shown: FloatArray, sensing: SensingSettings = SENSING) -> FloatArray:
    tracks = TrackFilter(sensing, DT)
    tracks.add(np.ones(TRACKS, dtype=np.bool_))
    rows = np.arange(TRACKS)
    return np.stack([tracks.measure(rows, shown[:, k]) for k in range(STEPS)], axis=1)


def errors(truth: FloatArray, shown: FloatArray) -> FloatArray:
    """(TRACKS, STEPS, 4) along, beside, heading and velocity."""
    error = shown - truth
    cos, sin = np.cos(truth[..., 2]), np.sin(truth[..., 2])
    along, beside = cos * error[..., 0] + sin * error[..., 1], cos * error[..., 1]
    beside -= sin * error[..., 0]
    return np.stack([along, beside, wrap_angle(error[..., 2]), error[..., 3]], axis=-1)


def rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values[:, 30:] ** 2, axis=(0, 1))))


@pytest.mark.parametrize(
    ("velocity", "curvature", "share"),
    [
        (12.0, 0.0, (0.9, 0.98, 0.5, 0.9)),
        (6.0, 0.05, (0.95, 1.0, 0.75, 0.95)),
        (0.0, 0.0, (0.8, 0.9, 0.6, 0.5)),
    ],
    ids=["straight", "in a bend", "standing"],
)
def test_errors_become_smaller(velocity: float, curvature: float, share: tuple[float, ...]) -> None:
    """Along, beside, heading, velocity, as a share of what was measured; and no bias."""
    truth = driven(np.full(STEPS, velocity), curvature, heading=3.0)
    found = errors(truth, estimated(measured(truth)))
    assert np.all(rms(found) < np.array(share) * DEVIATIONS)
    assert np.all(np.abs(found[:, 30:].mean(axis=(0, 1))) < 0.2 * DEVIATIONS)


def test_who_brakes_hard_is_seen_to_brake_within_half_a_second() -> None:
    """At 6 m/s2 from 12 m/s, 3 s after it was first seen: hardly more than half a second late."""
    velocity = np.maximum(12.0 - 6.0 * np.maximum(DT * np.arange(STEPS) - 3.0, 0.0), 0.0)
    truth = driven(velocity)
    found = errors(truth, estimated(measured(truth)))
    assert np.max(found[:, 31:51, 3].mean(axis=0)) < 0.6
    assert np.max(found[:, 60:, 3].mean(axis=0)) < 0.1


def test_who_starts_from_rest_is_seen_to_start_within_a_second() -> None:
    """At 2 m/s2, 3 s after it was first seen: taken to stand for about half a second at first."""
    velocity = np.clip(2.0 * (DT * np.arange(STEPS) - 3.0), 0.0, 8.0)
    truth = driven(velocity)
    found = errors(truth, estimated(measured(truth)))
    late = -found[:, 31:, 3].mean(axis=0)
    assert late[:10].max() < 0.9
    assert late[10:].max() < 0.3


def test_who_stands_does_not_begin_to_turn() -> None:
    truth = driven(np.zeros(STEPS), heading=-3.1)
    headings = estimated(measured(truth))[..., 2]
    assert np.std(wrap_angle(headings[:, -1] + 3.1)) < 0.5 * SENSING.heading


def test_hardly_an_error_is_hardly_filtered() -> None:
    exact = replace(SENSING, position=1e-3, heading=1e-3, speed=1e-3)
    truth = driven(np.linspace(0.0, 15.0, STEPS), 0.03)
    np.testing.assert_allclose(estimated(truth, exact), truth, atol=5e-3)


def test_a_heading_may_come_with_another_number_of_turns() -> None:
    truth = driven(np.full(STEPS, 8.0), 0.02)
    shown = measured(truth)
    turned = np.array(shown)
    turned[:, 50:, 2] += 2.0 * np.pi
    np.testing.assert_allclose(estimated(turned), estimated(shown), atol=1e-9)


def test_who_was_lost_for_too_long_is_begun_anew() -> None:
    tracks = TrackFilter(SENSING, DT)
    tracks.add(np.ones(2, dtype=np.bool_))
    both = np.arange(2)
    for k in range(20):
        tracks.measure(both, np.array([[0.1 * k, 0.0, 0.0, 1.0]] * 2))
    tracks.forget(np.array([True, False]))
    elsewhere = np.array([[9.0, 9.0, 2.0, 7.0]] * 2)
    found = tracks.measure(both, elsewhere)
    np.testing.assert_array_equal(found[0], elsewhere[0])
    assert np.abs(found[1] - elsewhere[1]).max() > 0.5


def test_nothing_is_kept_of_who_was_lost_for_too_long() -> None:
    again, new = TrackFilter(SENSING, DT), TrackFilter(SENSING, DT)
    for tracks in (again, new):
        tracks.add(np.ones(1, dtype=np.bool_))
    one = np.zeros(1, dtype=np.int64)
    for k in range(30):  # It speeds up by 3 m/s2 in a bend.
        again.measure(one, np.array([[0.4 * k, 0.01 * k**2, 0.03 * k, 4.0 + 0.3 * k]]))
    again.forget(np.ones(1, dtype=np.bool_))
    for k in range(10):
        shown = np.array([[50.0 + k, 5.0 + 0.1 * np.sin(k), 0.1, 10.0 + 0.2 * np.cos(k)]])
        np.testing.assert_array_equal(again.measure(one, shown), new.measure(one, shown))
