"""Quantiles of scores given covariates: on laws that are known, beside calibration by groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dosplan_dos.calibrating import Scored, calibrate, factor_for_recordings, left_out
from dosplan_dos.calibration import Calibration, Mode, load_calibrations, save_calibrations
from dosplan_dos.conditional import ConditionalScores, cross_fitted
from dosplan_dos.covariates import NAMES

from dosplan.evaluation.groups import CELL_WINDOWS
from dosplan.types import FloatArray, RoadUserKind

STEPS = 20


def drawn(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """(n, STEPS) scores whose scale and spread grow with the first covariate, and these."""
    rng = np.random.default_rng(seed)
    covariates = rng.uniform(size=(n, len(NAMES)))
    x = covariates[:, :1]
    growth = np.linspace(1.0, 2.0, STEPS)
    spread = 0.5 + 0.5 * x
    return np.exp(2.0 * x) * growth * rng.exponential(size=(n, STEPS)) ** spread, covariates


def scored(n: int, seed: int, places: int = 8) -> Scored:
    """Windows of cars of one speed, ten to a recording."""
    score, covariates = drawn(n, seed)
    place = np.arange(n) % places
    return Scored(
        score=score,
        area=np.ones_like(score),
        speed=np.full(n, 10.0),
        kinds=np.array([RoadUserKind.CAR] * n, dtype=object),
        recording=np.arange(n) // (10 * places) * places + place,
        covariates=covariates,
        place=place,
        places=tuple(f"ZAM_Place{k}" for k in range(places)),
    )


def test_a_rank_is_exponential_whatever_is_known() -> None:
    score, covariates = drawn(2000, 0)
    fitted = ConditionalScores.fit(score, covariates)
    fresh, known = drawn(4000, 1)
    rank = fitted.rank(fresh, known)
    np.testing.assert_allclose(fitted.score(rank, known), np.maximum(fresh, 1e-3), rtol=1e-9)
    for part in np.array_split(np.argsort(known[:, 0]), 5):
        for level in (0.5, 0.9, 0.95):
            below = np.mean(rank[part] <= -np.log(1.0 - level))
            assert below == pytest.approx(level, abs=0.06)


def test_what_is_further_out_than_anything_seen_counts_as_the_outermost() -> None:
    score, covariates = drawn(800, 2)
    fitted = ConditionalScores.fit(score, covariates)
    one = np.ones((2, STEPS))
    far = fitted.score(one, np.array([[50.0] + [0.5] * 17, [covariates[:, 0].max()] + [0.5] * 17]))
    np.testing.assert_array_equal(far[0], far[1])


@pytest.fixture(scope="module")
def calibrated() -> tuple[Scored, list[Calibration]]:
    some = scored(2000, 3)
    return some, calibrate(some)


def test_every_covariate_is_covered_where_groups_cover_the_mean_alone(
    calibrated: tuple[Scored, list[Calibration]],
) -> None:
    fresh = scored(3000, 4)
    most = fresh.covariates[:, 0] > 0.8
    held = {}
    for made in calibrated[1]:
        about = (fresh.speed, fresh.kinds.tolist(), fresh.covariates)
        inside = fresh.score <= made.factors(0.9, *about)
        if made.mode is Mode.SIMULTANEOUS:
            inside = np.all(inside, axis=1)
        assert inside.mean() == pytest.approx(0.9, abs=0.025)
        held[made.mode, made.given is not None] = inside[most].mean()
    assert held[Mode.PER_STEP, False] < 0.75
    assert held[Mode.PER_STEP, True] > 0.85
    assert held[Mode.SIMULTANEOUS, True] > held[Mode.SIMULTANEOUS, False] + 0.1


def test_a_place_is_ranked_by_what_the_others_say() -> None:
    score, covariates = drawn(900, 7)
    fold = np.arange(900) % 3
    score[fold == 0] *= 10.0
    _, ranks = cross_fitted(score, covariates, fold)
    # Quantiles that had seen this place would call a tenth of it rare.
    assert np.mean(ranks[fold == 0] > -np.log(0.1)) > 0.8
    with pytest.raises(ValueError, match="two places"):
        cross_fitted(score, covariates, np.zeros(900, dtype=np.int64))


def test_what_is_not_recorded_counts_for_nothing() -> None:
    score, covariates = drawn(1500, 8)
    gaps = np.array(score)
    gaps[::2, 1] = np.nan
    fitted = ConditionalScores.fit(gaps, covariates)
    np.testing.assert_array_equal(np.isnan(fitted.rank(gaps, covariates)), np.isnan(gaps))
    rank = fitted.rank(score, covariates)[1::2, 1]
    assert np.mean(rank <= -np.log(0.1)) == pytest.approx(0.9, abs=0.03)


def test_a_calibration_given_covariates_is_saved_beside_that_by_groups(
    calibrated: tuple[Scored, list[Calibration]], tmp_path: Path
) -> None:
    path, (some, made) = tmp_path / "calibration.npz", calibrated
    save_calibrations(path, made)
    about = (0.9, some.speed, some.kinds.tolist(), some.covariates)
    for original in made:
        copy = load_calibrations(path, conditional=original.given is not None)[original.mode]
        np.testing.assert_array_equal(copy.factors(*about), original.factors(*about))
    given = load_calibrations(path, conditional=True)[Mode.PER_STEP]
    with pytest.raises(ValueError, match="needs covariates"):
        given.factors(*about[:3])
    save_calibrations(path, [copy for copy in made if copy.given is None])
    with pytest.raises(ValueError, match="no calibration that depends on covariates"):
        load_calibrations(path, conditional=True)


def test_one_place_is_calibrated_by_groups_alone() -> None:
    made = calibrate(scored(800, 10, places=1))
    assert [c.given for c in made] == [None, None]


def test_the_tables_are_of_places_that_were_left_out() -> None:
    some = scored(3 * CELL_WINDOWS, 11, places=3)
    shifted = np.array(some.score)
    shifted[some.place == 0] *= 20.0
    told = left_out(Scored(**{**vars(some), "score": shifted}))
    assert "| 90 % | " in told
    assert "8-16 m/s" in told
    assert "(ZAM_Place0, 8-16 m/s" in told  # The worst cell.
    assert told.count("by what is known") == 4
    assert "those that move, by the noise of their track" in told


def test_a_whole_recording_is_held_as_often_as_asked() -> None:
    # Windows of a recording share its level, which differs from one to the next; of windows alone
    # 99 % would be held, and of recordings three in four.
    rng = np.random.default_rng(13)

    def recordings(count: int) -> tuple[FloatArray, FloatArray]:
        level = rng.lognormal(sigma=0.7, size=(count, 1, 1))
        ratio = level * rng.exponential(size=(count, 30, 5))
        ratio[:, ::3, 4] = np.nan
        return ratio.reshape(count * 30, 5), np.nanmax(ratio, axis=(1, 2))

    held, by_window = [], []
    for _ in range(150):
        ratio, _ = recordings(39)
        _, fresh = recordings(50)
        factor = factor_for_recordings(ratio, np.repeat(np.arange(39), 30), 0.9)
        held.append(np.mean(fresh <= factor))
        by_window.append(np.mean(fresh <= np.nanquantile(ratio, 0.99)))
    # 39 recordings: the 36th of 40 ranks is exactly 0.9.
    assert np.mean(held) == pytest.approx(0.9, abs=0.015)
    assert np.mean(by_window) < 0.8
    few = np.arange(60) // 30
    assert factor_for_recordings(ratio[:60], few, 0.9) == np.inf


def test_a_given_of_another_horizon_is_refused() -> None:
    score, covariates = drawn(500, 12)
    given = ConditionalScores.fit(score, covariates)
    kinds = [RoadUserKind.CAR] * 500
    with pytest.raises(ValueError, match="given is of 20 steps, expected 2"):
        Calibration.fit(score[:, :2], np.zeros(500), kinds, np.arange(500), Mode.PER_STEP, given)
