"""Sets that grow for whoever leaves them: the bound that holds whatever road users do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from dosplan_dos.adaptation import REACH, Adaptation
from dosplan_dos.predictor import DosPredictor, DosSettings
from dosplan_net.predictor import NetPredictor
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.simulation.world import watch
from dosplan.types import FloatArray, Observation, Occupancy, Scenario, SetUnion

RATE, COVERAGE = 0.2, 0.9
ALPHA = 1.0 - COVERAGE
FAR = 1000.0
"""m from one road user to the next."""


def moving_by(offsets: Sequence[FloatArray], first: Sequence[int] = ()) -> Scenario:
    """Road users that stand beside the road but for offsets (K,) along y at each step.

    One that is ``first`` seen later is not there before.
    """
    steps = len(offsets[0])
    tracks = steady_tracks([[FAR * k, 0.0, 0.0, 0.0] for k in range(len(offsets))], steps=steps)
    states, valid = np.array(tracks.states), np.array(tracks.valid)
    for k, offset in enumerate(offsets):
        states[k, :, 1] += offset
    for k, step in enumerate(first):
        valid[k, :step] = False
    return straight_scenario(replace(tracks, states=states, valid=valid))


def circles(observation: Observation, growth: FloatArray) -> Occupancy:
    """Circles of 1 m around where everybody stands but for the offsets, times the growth."""
    n = len(observation.ids)
    centre = np.zeros((n, 40, 2))
    centre[..., 0] = FAR * (observation.ids - 100)[:, None]
    axes = np.ones((n, 40, 2)) * growth[:, None, None]
    return Occupancy.from_trajectory(observation, centre, np.zeros((n, 40)), axes)


def episode(
    scenario: Scenario, every: int = 1, rate: float = RATE
) -> tuple[FloatArray, FloatArray]:
    """(K, N) growth of each road user at each step, and share of its sets that it was outside of.

    NaN before it is there, and where none of its sets was for that step.
    """
    adaptation = Adaptation(rate, COVERAGE)
    n = len(scenario.tracks.ids)
    growth, missed = [], []
    handed: list[tuple[int, FloatArray]] = []
    for observation in watch(scenario, every):
        rows = observation.ids - 100
        known = np.full(n, np.nan)
        known[rows] = adaptation.observe(observation)
        away = np.full(n, np.nan)
        away[rows] = np.abs(observation.states[:, -1, 1])
        recent = [size for step, size in handed if observation.step - step <= REACH]
        outside = np.array([np.where(np.isnan(size), np.nan, away > size) for size in recent])
        counts = np.sum(np.isfinite(outside), axis=0) if recent else np.zeros(n)
        total = np.nansum(outside, axis=0) if recent else np.zeros(n)
        missed.append(np.divide(total, counts, out=np.full(n, np.nan), where=counts > 0))
        adaptation.remember(observation, circles(observation, known[rows]))
        handed.append((observation.step, known))
        growth.append(known)
    return np.array(growth), np.array(missed)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), hostile=st.floats(0.0, 1.0), every=st.integers(1, 5))
def test_the_bound_holds_whatever_road_users_do(seed: int, hostile: float, every: int) -> None:
    rng = np.random.default_rng(seed)
    steps, most = 80, 6.0
    offset = np.where(rng.random((2, steps)) < hostile, rng.uniform(0.0, most, (2, steps)), 0.0)
    growth, missed = episode(moving_by(list(offset)), every)
    count = np.sum(np.isfinite(missed), axis=0)
    mean = np.nanmean(missed, axis=0)
    # The growth that the last comparison leads to is that of the last step.
    start, end = np.log(growth[0]), np.log(growth[-1])
    assert np.all(mean <= ALPHA + (end - start) / (RATE * count) + 1e-9)
    assert np.all(end <= np.log(most) + (1 - ALPHA) * RATE * REACH + 1e-9)
    assert np.all(growth >= 1.0)


def test_one_that_leaves_its_sets_has_them_grow_until_they_hold_and_others_do_not() -> None:
    growth, missed = episode(moving_by([np.full(120, 3.0), np.zeros(120)]))
    np.testing.assert_array_equal(growth[:, 1], 1.0)
    assert np.all(missed[1:5, 0] == 1.0)
    assert np.nanmean(missed[:, 0]) < 0.25
    settled = growth[40:, 0]
    assert settled.min() > 2.0
    assert settled.max() < 3.0 * np.exp(RATE * REACH)


def test_it_goes_back_when_nothing_happens_any_more() -> None:
    growth, _ = episode(moving_by([np.where(np.arange(300) < 20, 3.0, 0.0)]))
    assert growth[:40].max() > 2.0
    assert growth[-1, 0] == 1.0
    # Each calm step takes rate alpha off the logarithm.
    falling = np.diff(np.log(growth[40:60, 0]))
    np.testing.assert_allclose(falling, -RATE * ALPHA)


def test_who_comes_later_begins_with_the_mean_of_those_there() -> None:
    offsets = [np.full(40, 3.0), np.zeros(40), np.zeros(40)]
    growth, _ = episode(moving_by(offsets, first=(0, 0, 30)))
    assert growth[30, 2] == pytest.approx(np.exp(np.mean(np.log(growth[30, :2]))))
    assert growth[30, 2] > 1.2


def test_who_cannot_move_says_nothing_of_newcomers() -> None:
    """Many parked cars, whose sets are points, and one that leaves its sets."""
    scenario = moving_by([np.full(40, 3.0), np.zeros(40), *[np.zeros(40)] * 20], first=(0, 30))
    adaptation = Adaptation(RATE, COVERAGE)
    growth = np.zeros((40, 22))
    for observation in watch(scenario, 1):
        found = adaptation.observe(observation)
        rows = observation.ids - 100
        growth[observation.step, rows] = found
        sets = circles(observation, found)
        moves = (rows < 2)[:, None, None]
        adaptation.remember(observation, replace(sets, semi_axes=sets.semi_axes * moves))
    assert growth[30, 1] == pytest.approx(growth[30, 0])
    assert growth[30, 1] > 1.5


def test_nothing_is_learned_twice_at_a_step() -> None:
    adaptation = Adaptation(RATE, COVERAGE)
    for observation in watch(moving_by([np.full(10, 3.0)]), 1):
        once = adaptation.observe(observation)
        adaptation.remember(observation, circles(observation, once))
        np.testing.assert_array_equal(adaptation.observe(observation), once)
        adaptation.remember(observation, circles(observation, 100.0 * once))
    assert once[0] > 1.5


def test_inside_any_ellipse_of_a_union_is_inside() -> None:
    adaptation = Adaptation(RATE, COVERAGE)
    for observation in watch(moving_by([np.full(10, 3.0)]), 1):
        growth = adaptation.observe(observation)
        sets = circles(observation, growth)
        apart = np.stack((sets.centre, sets.centre + np.array([0.0, 3.0])), axis=1)
        both = [np.stack((part, part), axis=1) for part in (sets.semi_axes, sets.angle)]
        union = SetUnion(np.full((1, 2), 0.5), apart, both[0], both[1], both[1])
        adaptation.remember(observation, replace(sets, union=union))
    assert growth[0] == 1.0


def test_a_shift_is_met_as_by_mapie() -> None:
    # Scores of one road user that triple half way: split conformal goes on as before.
    regression = pytest.importorskip("mapie.regression", reason="needs mapie")
    dummy = pytest.importorskip("sklearn.dummy", reason="needs scikit-learn")
    rng = np.random.default_rng(5)
    steps = 400
    scale = np.where(np.arange(steps) < steps // 2, 1.0, 3.0)
    truth = rng.exponential(size=steps) * scale
    past = rng.exponential(size=500)
    place, late = np.zeros((500, 1)), np.arange(steps) >= steps // 2 + 40
    zero = dummy.DummyRegressor(strategy="constant", constant=0.0).fit(place, past)
    theirs = regression.TimeSeriesRegressor(zero, method="aci", cv="prefit")
    theirs.fit(place, past)
    held = []
    for t in range(steps):
        x, y = np.zeros((1, 1)), truth[t : t + 1]
        _, interval = theirs.predict(x, confidence_level=COVERAGE, allow_infinite_bounds=True)
        held.append(y[0] <= interval[0, 1, 0])
        theirs.adapt_conformal_inference(x, y, gamma=0.05, confidence_level=COVERAGE)
    quantile = np.quantile(past, COVERAGE)
    growth, missed = episode(moving_by([truth / quantile]))
    own = truth <= quantile * growth[:, 0]
    fixed = truth <= quantile
    assert fixed[late].mean() < 0.65
    # MAPIE moves the level instead of the size, and follows more slowly.
    assert np.mean(np.array(held)[late]) > 0.75
    assert own[late].mean() == pytest.approx(COVERAGE, abs=0.06)
    assert np.nanmean(missed) < ALPHA + 0.06


def test_sets_of_dos_grow_in_an_episode_and_a_new_one_begins_as_calibrated() -> None:
    # A car that the network takes for one that drives on, and that jumps to the side at each step.
    tracks = steady_tracks([[0.0, 0.0, 0.0, 10.0]], steps=30)
    states = np.array(tracks.states)
    states[0, ::2, 1] += 4.0
    scenario = straight_scenario(replace(tracks, states=states))
    fixed, adaptive = (
        DosPredictor(settings=DosSettings(sets="coverage", coverage=0.9, adaptation=rate))
        for rate in (0.0, RATE)
    )

    def drive() -> list[FloatArray]:
        for predictor in (fixed, adaptive):
            predictor.reset(scenario.task, scenario.road_map)
        return [
            adaptive.predict(o).semi_axes[0] / fixed.predict(o).semi_axes[0]
            for o in watch(scenario, 1)
        ]

    ratio = drive()
    np.testing.assert_allclose(ratio[0], 1.0)
    assert ratio[-1].min() > 1.5
    np.testing.assert_allclose(np.ptp(ratio[-1]), 0.0, atol=1e-9)
    np.testing.assert_array_equal(drive(), ratio)
    assert isinstance(fixed.base, NetPredictor)
