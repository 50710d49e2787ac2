"""Calibration: its guarantees on scores whose law is known, its groups and its file."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from dosplan_dos.calibration import (
    GROUPS,
    LEVELS,
    MIN_WINDOWS,
    SMALLEST,
    Calibration,
    Group,
    KindClass,
    Mode,
    estimate_coverage,
    load_calibrations,
    save_calibrations,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.types import FloatArray, IntArray, RoadUserKind

CAR, PEDESTRIAN = RoadUserKind.CAR, RoadUserKind.PEDESTRIAN
SPEEDS = (0.0, 1.0, 5.0, 10.0, 20.0)
"""A speed in each bin."""

ROUNDING = 1 + 1 / 2048
"""By how much a kept quantile may exceed the exact one: twelve binary digits, rounded up."""


def fitted(
    scores: FloatArray,
    *,
    speed: FloatArray | float = 10.0,
    kinds: list[RoadUserKind] | None = None,
    recording: IntArray | None = None,
    mode: Mode = Mode.PER_STEP,
) -> Calibration:
    """A calibration on cars of one speed, each window a recording of its own, unless told."""
    n = len(scores)
    return Calibration.fit(
        scores,
        np.broadcast_to(speed, n),
        kinds or [CAR] * n,
        np.arange(n) if recording is None else recording,
        mode,
    )


def car_factors(calibration: Calibration, level: float, speed: float = 10.0) -> FloatArray:
    """(T,) factors of a car."""
    return np.asarray(calibration.factors(level, np.array([speed]), [CAR])[0])


def exact_quantile(scores: FloatArray, level: float) -> float:
    """Split conformal's definition, by itself: the ceil((n + 1) level)-th smallest score."""
    return float(np.sort(scores)[math.ceil((len(scores) + 1) * level - 1e-9) - 1])


def walks(rng: np.random.Generator, n: int, growth: FloatArray) -> FloatArray:
    """(n, T) scores that are as correlated over time as a prediction error is."""
    steps = np.arange(1, len(growth) + 1)
    path = np.cumsum(rng.normal(size=(n, len(growth))), axis=1) / np.sqrt(steps)
    return np.asarray(np.abs(path) * growth)


@pytest.mark.parametrize(
    ("n", "level"), [(9, 0.9), (19, 0.5), (95, 0.9), (99, 0.9), (99, 0.95), (250, 0.99)]
)
def test_mean_coverage_is_the_one_theory_names(n: int, level: float) -> None:
    # 1500 steps are 1500 independent calibrations on n scores. With d_M ~ Exp(1) the coverage of a
    # factor q is 1 - exp(-q), Beta(k, n + 1 - k) distributed with mean k / (n + 1).
    repeats = 1500
    scores = np.random.default_rng(n).exponential(size=(n, repeats))
    coverage = 1 - np.exp(-car_factors(fitted(scores), level))
    k = math.ceil((n + 1) * level - 1e-9)
    expected = k / (n + 1)
    assert level - 1e-12 <= expected <= level + 1 / (n + 1)
    error = math.sqrt(expected * (1 - expected) / (n + 2) / repeats)
    assert abs(coverage.mean() - expected) < 4 * error + 5e-4  # The second term is rounding.


def test_each_group_is_covered_where_one_factor_for_everybody_fails_the_fast() -> None:
    rng = np.random.default_rng(1)
    n = 2000
    fast = np.arange(n) % 4 == 0
    speed = np.where(fast, 20.0, 1.0)

    def draw() -> FloatArray:
        return np.asarray(rng.exponential(size=(n, 20)) * np.where(fast, 3.0, 1.0)[:, None])

    scores, fresh = draw(), draw()
    common = fresh <= car_factors(fitted(scores), 0.9)
    # P(covered) = 1 - 0.75 exp(-q) - 0.25 exp(-q / 3) is 0.9 at q = 3.49: 97 % and 69 %.
    assert common.mean() == pytest.approx(0.9, abs=0.01)
    assert common[fast].mean() == pytest.approx(0.69, abs=0.02)
    assert common[~fast].mean() == pytest.approx(0.97, abs=0.01)

    by_group = fresh <= fitted(scores, speed=speed).factors(0.9, speed, [CAR] * n)
    assert by_group[fast].mean() == pytest.approx(0.9, abs=0.015)
    assert by_group[~fast].mean() == pytest.approx(0.9, abs=0.01)


def test_pedestrians_and_cars_of_one_speed_have_factors_of_their_own() -> None:
    rng = np.random.default_rng(2)
    kinds = [CAR, PEDESTRIAN] * 300
    scores = rng.exponential(size=(600, 3)) * np.tile([1.0, 5.0], 300)[:, None]
    calibration = fitted(scores, speed=1.0, kinds=kinds)
    both = calibration.factors(
        0.9, np.full(4, -1.0), [CAR, RoadUserKind.TRUCK, PEDESTRIAN, RoadUserKind.BICYCLE]
    )
    np.testing.assert_array_equal(both[0], both[1])
    np.testing.assert_array_equal(both[2], both[3])
    assert np.all(both[2] > 3 * both[0])


def test_all_steps_are_covered_at_once_as_often_as_asked() -> None:
    rng = np.random.default_rng(3)
    growth = np.linspace(0.2, 2.0, 20)
    fresh = walks(rng, 4000, growth)
    rates, per_step_rates = [], []
    for _ in range(60):
        scores = walks(rng, 400, growth)
        profile = car_factors(fitted(scores, mode=Mode.SIMULTANEOUS), 0.9)
        rates.append(np.mean(np.all(fresh <= profile, axis=1)))
        per_step_rates.append(np.mean(np.all(fresh <= car_factors(fitted(scores), 0.9), axis=1)))
    # 300 windows calibrate (every fourth shapes): each rate scatters by sqrt(0.09 / 302) = 0.017,
    # and 4000 fresh windows, common to all, add 0.005.
    assert 0.9 - 0.015 < np.mean(rates) < 0.9 + 1 / 301 + 0.015
    assert np.mean(per_step_rates) < 0.8


def test_no_step_rules_the_simultaneous_profile() -> None:
    # The scores of the last step are a thousand times those of the first; without a shape, the
    # maximum would be that of the last step alone and the first would be covered always.
    rng = np.random.default_rng(4)
    growth = np.geomspace(0.1, 100.0, 20)
    profile = car_factors(fitted(walks(rng, 4000, growth), mode=Mode.SIMULTANEOUS), 0.9)
    by_step = np.mean(walks(rng, 4000, growth) <= profile, axis=0)
    assert np.ptp(by_step) < 0.03
    assert np.all(by_step < 0.995)


def test_windows_that_end_early_do_not_count_for_all_steps_at_once() -> None:
    rng = np.random.default_rng(5)
    scores = walks(rng, 800, np.ones(10))
    shaping = np.arange(800) % 4 == 0
    short = np.where(np.arange(10) < 9, 1e3, np.nan) * np.ones((600, 1))
    padded = np.concatenate([scores, short])
    recording = np.concatenate([np.arange(800), np.flatnonzero(~shaping)])
    np.testing.assert_array_equal(
        car_factors(fitted(padded, recording=recording, mode=Mode.SIMULTANEOUS), 0.9),
        car_factors(fitted(scores, mode=Mode.SIMULTANEOUS), 0.9),
    )


def group_scores(sizes: dict[tuple[RoadUserKind, int], tuple[int, int]]) -> Calibration:
    """Windows per group, spread evenly over its recordings; scores tell the groups apart."""
    scores, speed, kinds, recording = [], [], [], []
    for i, ((kind, speed_bin), (windows, recordings)) in enumerate(sizes.items()):
        scores += [10.0 ** (i - 1)] * windows
        speed += [SPEEDS[speed_bin]] * windows
        kinds += [kind] * windows
        recording += [w % recordings for w in range(windows)]
    return Calibration.fit(
        np.array(scores)[:, None],
        np.array(speed),
        kinds,
        np.array(recording),
        Mode.PER_STEP,
    )


def source(calibration: Calibration, kind: KindClass, speed_bin: int) -> Group:
    return calibration.sources[Group(kind, speed_bin)]


VEHICLE, VULNERABLE = KindClass


@pytest.mark.parametrize(
    ("size", "own"),
    [
        ((MIN_WINDOWS, 10), True),
        ((MIN_WINDOWS - 1, 10), False),  # Too few windows.
        ((MIN_WINDOWS * 5, 9), False),  # Too few recordings, however many windows.
    ],
)
def test_a_group_uses_its_own_scores_from_the_minimum_on(size: tuple[int, int], own: bool) -> None:
    calibration = group_scores({(CAR, 4): size, (CAR, 0): (600, 30)})
    assert source(calibration, VEHICLE, 4) == Group(VEHICLE, 4 if own else None)
    assert source(calibration, VEHICLE, 0) == Group(VEHICLE, 0)


def test_a_small_group_borrows_in_the_stated_order() -> None:
    # Vehicles: bin 4 is small, all speeds are not. Pedestrians: too few even at all speeds, but
    # their speed bin is full of cars, save for bin 3, where only everybody is left.
    calibration = group_scores(
        {(CAR, 0): (600, 30), (CAR, 4): (20, 10), (PEDESTRIAN, 0): (20, 10)},
    )
    assert source(calibration, VEHICLE, 4) == Group(VEHICLE, None)
    assert source(calibration, VULNERABLE, 0) == Group(None, 0)
    assert source(calibration, VULNERABLE, 3) == Group(None, None)
    # Enough pedestrians at all speeds come before the cars of their bin.
    calibration = group_scores({(CAR, 0): (600, 30), (PEDESTRIAN, 1): (300, 30)})
    assert source(calibration, VULNERABLE, 0) == Group(VULNERABLE, None)


def test_factors_of_a_small_group_are_those_of_the_coarser_group() -> None:
    calibration = group_scores({(CAR, 0): (600, 30), (CAR, 4): (20, 10)})
    # Scores are 0.1 for bin 0 and 1 for bin 4; of all 620, the upper 20 hold 0.98's quantile.
    assert car_factors(calibration, 0.98, SPEEDS[0]) == pytest.approx(0.1, rel=1e-3)
    assert car_factors(calibration, 0.98, SPEEDS[4]) == pytest.approx(1.0, rel=1e-3)
    assert car_factors(calibration, 0.9, SPEEDS[4]) == pytest.approx(0.1, rel=1e-3)


def test_one_crowded_recording_does_not_make_a_group_large() -> None:
    # 11 recordings, but one holds 990 of 1000 windows: (sum m)^2 / sum m^2 = 1.02.
    n = 1000
    recording = np.maximum(np.arange(n) - 989, 0)
    calibration = fitted(np.ones((n, 1)), recording=recording)
    assert calibration.recordings[0] == pytest.approx(n**2 / (990**2 + 10))
    assert source(calibration, VEHICLE, 3) == Group(None, None)


def test_a_speed_on_a_bound_belongs_to_the_faster_bin_and_reversing_counts_alike() -> None:
    calibration = group_scores({(CAR, b): (300, 30) for b in range(5)})
    asked = np.array([0.29, 0.3, 3.9, 4.0, 7.9, 8.0, 15.9, 16.0, -5.0])
    factors = calibration.factors(0.9, asked, [CAR] * len(asked))[:, 0]
    expected = [10.0 ** (b - 1) for b in (0, 1, 1, 2, 2, 3, 3, 4, 2)]
    np.testing.assert_allclose(factors, expected, rtol=1e-3)


def test_groups_have_names() -> None:
    assert str(GROUPS[0]) == "vehicle, 0 to 0.3 m/s"
    assert str(GROUPS[-1]) == "vulnerable, 16 to inf m/s"
    assert str(Group(None, None)) == "all kinds, all speeds"


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 300),
    level=st.floats(0.001, 0.999),
    other=st.floats(0.001, 0.999),
)
def test_a_factor_is_never_below_the_exact_quantile_and_close_above(
    seed: int, n: int, level: float, other: float
) -> None:
    scores = np.random.default_rng(seed).lognormal(sigma=2.0, size=(n, 1))
    calibration = fitted(scores)
    level, other = (min(x, n / (n + 1)) for x in sorted((level, other)))
    factor = car_factors(calibration, level)[0]
    assert factor >= exact_quantile(scores[:, 0], level)
    kept = LEVELS[np.searchsorted(LEVELS, level)]
    upper = exact_quantile(scores[:, 0], min(kept, n / (n + 1)))
    assert factor <= max(upper * ROUNDING, SMALLEST * ROUNDING)
    assert factor <= car_factors(calibration, other)[0]


def test_simultaneous_factors_do_not_fall_as_the_level_rises() -> None:
    scores = walks(np.random.default_rng(6), 900, np.ones(10))
    calibration = fitted(scores, mode=Mode.SIMULTANEOUS)
    profiles = np.stack([car_factors(calibration, x) for x in np.linspace(0.01, 0.99, 197)])
    assert np.all(np.diff(profiles, axis=0) >= 0)


def test_levels_are_fine_and_hold_those_that_are_asked_for() -> None:
    gaps = np.diff(LEVELS, prepend=0.0)
    assert np.all(gaps > 0)
    assert gaps.max() < 0.0051
    assert gaps[LEVELS > 0.9001].max() < 0.0021
    assert gaps[LEVELS > 0.9801].max() < 0.0006
    assert {0.5, 0.8, 0.9, 0.95, 0.99, 0.999} <= set(LEVELS.tolist())


def test_a_level_is_refused_from_where_the_windows_do_not_suffice() -> None:
    calibration = fitted(np.arange(1.0, 100.0)[:, None])  # n = 99: up to 99 / 100.
    assert calibration.highest_level == pytest.approx(0.99)
    assert car_factors(calibration, 0.99)[0] == pytest.approx(99.0, rel=1e-3)
    with pytest.raises(ValueError, match=r"level 0\.991 .* the 99 of .* at most 0\.99 or"):
        car_factors(calibration, 0.991)


def test_the_smallest_group_in_use_bounds_the_level_for_everyone() -> None:
    calibration = group_scores({(CAR, 0): (2000, 30), (CAR, 4): (200, 30)})
    with pytest.raises(ValueError, match="the 200 of the smallest"):
        car_factors(calibration, 0.996, SPEEDS[0])
    car_factors(calibration, 0.995, SPEEDS[0])


@pytest.mark.parametrize("level", [0.0, 1.0, -0.1, math.nan])
def test_a_level_that_is_no_share_is_refused(level: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        car_factors(fitted(np.ones((50, 1))), level)


def test_scores_that_are_not_recorded_are_as_if_not_given() -> None:
    rng = np.random.default_rng(7)
    scores = rng.exponential(size=(400, 2))
    scores[rng.permutation(400)[:250], 1] = np.nan
    calibration = fitted(scores)
    factor = car_factors(calibration, 0.9)
    for t in range(2):
        exact = exact_quantile(scores[np.isfinite(scores[:, t]), t], 0.9)
        assert exact <= factor[t] <= exact * ROUNDING
    assert int(calibration.windows.min()) == 150


def test_one_group_that_ends_early_borrows_for_the_whole_horizon() -> None:
    scores = np.ones((800, 2))
    scores[:400] = 5.0
    scores[:390, 1] = np.nan
    calibration = fitted(scores, speed=np.repeat([20.0, 0.0], 400))
    assert source(calibration, VEHICLE, 4) == Group(VEHICLE, None)
    assert source(calibration, VEHICLE, 0) == Group(VEHICLE, 0)


@pytest.mark.parametrize(
    ("scores", "mode", "match"),
    [
        (np.array([[1.0, np.nan]] * 300), Mode.PER_STEP, "a step of the horizon"),
        (np.array([[1.0, np.nan], [np.nan, 1.0]] * 150), Mode.SIMULTANEOUS, "a step of the horiz"),
        (np.ones((100, 2)), Mode.SIMULTANEOUS, "a step of the horizon"),  # 25 cannot shape.
        (np.zeros((0, 2)), Mode.PER_STEP, "a step of the horizon"),
        (np.array([[1.0, -0.1]]), Mode.PER_STEP, "negative or an infinite"),
        (np.array([[1.0, np.inf]]), Mode.PER_STEP, "negative or an infinite"),
        (np.ones(3), Mode.PER_STEP, r"shape \(3,\)"),
        (np.ones((3, 0)), Mode.PER_STEP, r"shape \(3, 0\)"),
    ],
)
def test_scores_that_cannot_be_used_are_refused(scores: FloatArray, mode: Mode, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        fitted(scores, mode=mode)


def test_arguments_that_do_not_fit_together_are_refused() -> None:
    scores, speed, recording = np.ones((5, 2)), np.ones(5), np.arange(5)
    with pytest.raises(ValueError, match=r"recording \(4,\)"):
        Calibration.fit(scores, speed, [CAR] * 5, recording[:4], Mode.PER_STEP)
    with pytest.raises(ValueError, match="for 4 kinds, expected 5"):
        Calibration.fit(scores, speed, [CAR] * 4, recording, Mode.PER_STEP)
    calibration = fitted(scores)
    with pytest.raises(ValueError, match="finite speeds"):
        calibration.factors(0.5, np.array([np.nan]), [CAR])
    assert calibration.factors(0.5, np.zeros(0), []).shape == (0, 2)


def both_modes(horizon: int = 40) -> list[Calibration]:
    rng = np.random.default_rng(8)
    n = 4000
    scores = walks(rng, n, np.linspace(0.1, 3.0, horizon)) * rng.lognormal(size=(n, 1))
    speed, kinds = rng.choice(SPEEDS, n), [CAR if x else PEDESTRIAN for x in rng.random(n) < 0.5]
    return [Calibration.fit(scores, speed, kinds, np.arange(n), mode) for mode in Mode]


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    path, again = tmp_path / "calibration.npz", tmp_path / "again.npz"
    originals = both_modes()
    save_calibrations(path, originals)
    loaded = load_calibrations(path)
    assert list(loaded) == list(Mode)
    for original in originals:
        copy = loaded[original.mode]
        assert copy.sources == original.sources == {group: group for group in GROUPS}
        for field in ("windows", "recordings", "shape", "quantiles"):
            np.testing.assert_array_equal(getattr(copy, field), getattr(original, field))
            assert not getattr(copy, field).flags.writeable
        kinds = [CAR] * len(SPEEDS)
        np.testing.assert_array_equal(
            copy.factors(0.937, np.array(SPEEDS), kinds),
            original.factors(0.937, np.array(SPEEDS), kinds),
        )
    save_calibrations(again, loaded.values())
    assert again.read_bytes() == path.read_bytes()
    # Every group has scores of its own: no file of 40 steps is larger than this one.
    assert path.stat().st_size < 300_000


def test_a_file_holds_its_arrays_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An old numpy takes every keyword of ``savez`` for the name of an array."""
    given: list[set[str]] = []
    save = np.savez_compressed

    def noted(file: IO[bytes], **keywords: Any) -> None:
        given.append(set(keywords))
        save(file, **keywords)

    monkeypatch.setattr(np, "savez_compressed", noted)
    path = tmp_path / "calibration.npz"
    save_calibrations(path, both_modes())
    with np.load(path, allow_pickle=False) as content:
        assert given == [set(content.files)]


def test_a_file_may_hold_one_mode(tmp_path: Path) -> None:
    path = tmp_path / "calibration.npz"
    save_calibrations(path, [fitted(np.ones((50, 2)))])
    assert list(load_calibrations(path)) == [Mode.PER_STEP]


def test_a_damaged_file_is_refused_in_one_line(tmp_path: Path) -> None:
    whole, path = tmp_path / "whole.npz", tmp_path / "damaged.npz"
    originals, refused = both_modes(horizon=2), 0
    save_calibrations(whole, originals)
    content = whole.read_bytes()
    for size in (0, 1, 4, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(ValueError, match=r"^.*damaged\.npz: not a file .*save_calibrations$"):
            load_calibrations(path)
    for place in np.random.default_rng(9).integers(len(content), size=40):
        path.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            loaded = load_calibrations(path)
        except ValueError as error:
            assert re.match(r"^.*damaged\.npz: not a file .*save_calibrations$", str(error))  # noqa: PT017
            refused += 1
        else:  # The byte meant nothing, like those of a member's date.
            for original in originals:
                for field in ("source", "windows", "recordings", "shape", "quantiles"):
                    copy = getattr(loaded[original.mode], field)
                    np.testing.assert_array_equal(copy, getattr(original, field))
    assert refused > 20


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    calibration = fitted(np.ones((50, 2)))

    def refused(reason: str) -> None:
        with pytest.raises(ValueError, match=f"foreign.npz: not a file of calibr.*{reason}"):
            load_calibrations(path)

    refused("FileNotFoundError")
    path.write_text("weights")
    refused("another kind of file")
    np.savez(path, weights=np.ones(3))
    refused("format")
    np.savez(path, format=np.array("dosplan-calibration-0"))
    refused("expected dosplan-calibration-1")
    np.savez(path, format=np.array([{}], dtype=object))  # Would need pickle.
    refused("allow_pickle=False")
    save_calibrations(path, [])
    refused("holds no calibration")
    save_calibrations(path, [calibration])
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays["per_step.quantiles"] = arrays["per_step.quantiles"][:, :, 1:]
    np.savez(path, allow_pickle=False, **arrays)
    refused("quantiles has shape")


def test_coverage_counts_recordings_where_windows_are_alike_and_windows_where_not() -> None:
    rng = np.random.default_rng(10)
    recordings, each = 400, 25
    recording = np.repeat(np.arange(recordings), each)
    alike = np.repeat(rng.random(recordings) < 0.9, each)
    apart = rng.random(recordings * each) < 0.9
    found = estimate_coverage(np.stack([alike, apart], axis=1).astype(float), recording)
    np.testing.assert_array_equal(found.windows, recordings * each)
    np.testing.assert_array_equal(found.recordings, recordings)
    # Of R alike: p (1 - p) / (R - 1) squared error exactly, so R - 1 effective windows.
    assert found.effective_windows[0] == pytest.approx(recordings - 1)
    assert found.effective_windows[1] == pytest.approx(recordings * each, rel=0.25)


def test_the_error_of_coverage_agrees_with_a_bootstrap_of_recordings() -> None:
    rng = np.random.default_rng(11)
    sizes = rng.integers(1, 40, size=60)
    recording = rng.permutation(np.repeat(np.arange(60), sizes))
    covered = (rng.random(len(recording)) < rng.beta(9, 1, size=60)[recording]).astype(float)
    covered[rng.random(len(covered)) < 0.2] = np.nan
    found = estimate_coverage(covered[:, None], recording)
    hits = np.bincount(recording, np.nan_to_num(covered), 60)
    recorded = np.bincount(recording, np.isfinite(covered), 60)
    drawn = rng.integers(60, size=(4000, 60))
    rates = hits[drawn].sum(axis=1) / recorded[drawn].sum(axis=1)
    assert found.rate[0] == pytest.approx(np.nanmean(covered))
    assert found.standard_error[0] == pytest.approx(rates.std(), rel=0.1)


def test_coverage_says_where_it_cannot_tell() -> None:
    covered = np.array([[1.0, 1.0, np.nan], [1.0, 0.0, np.nan], [1.0, np.nan, np.nan]])
    found = estimate_coverage(covered, np.array([0, 1, 2]))
    np.testing.assert_array_equal(found.rate, [1.0, 0.5, np.nan])
    np.testing.assert_array_equal(found.windows, [3, 2, 0])
    assert found.standard_error[0] == 0
    assert np.isnan(found.effective_windows[0])
    assert np.isnan(estimate_coverage(covered, np.zeros(3, int)).standard_error).all()
