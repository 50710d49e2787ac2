"""Sets in a loop whose sensors err: what calibration on such windows gives, and who takes which."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dosplan_dos.calibration import (
    LEVELS,
    CalibratedFor,
    Calibration,
    Mode,
    calibration_file,
    load_calibrations,
)
from dosplan_dos.predictor import (
    DEFAULT_COVERAGE,
    DEFAULT_SETS,
    DosPredictor,
    DosSettings,
    shipped_sets,
)

from dosplan.evaluation.windows import moments
from dosplan.plugins.registry import (
    RegistryError,
    choose_predictor,
    create_predictor,
    portable_options,
    record,
)
from dosplan.running.config import RunConfig
from dosplan.running.job import make_plugins
from dosplan.scenario.synthetic import busy_scenario, steady_tracks, straight_scenario
from dosplan.simulation.settings import IDEAL, REALISTIC, LoopSettings, SensingSettings
from dosplan.types import FloatArray, Occupancy, RoadUserKind
from tests.support.models import seen

SIGMA = 0.4
NOISY = LoopSettings(sensing=SensingSettings(position=SIGMA, correlation=0.0))
CAR = RoadUserKind.CAR


def errors(seed: int, loop: LoopSettings = NOISY) -> FloatArray:
    """(W, 4) how far cars of constant velocity are from where they are predicted, at four steps.

    That is their distance to circles of radius 1.
    """
    first = [[30.0 * k, 30.0 * k, 0.0, 10.0] for k in range(40)]
    found = []
    for moment in moments(straight_scenario(steady_tracks(first, steps=60)), 1, loop, seed=seed):
        now = moment.observation.states[moment.rows, -1]
        time = 0.1 * np.arange(1, 5)
        expected = now[:, None, :2] + (10.0 * time)[:, None] * np.array([1.0, 0.0])
        found.append(np.linalg.norm(moment.truth[:, :4, :2] - expected, axis=-1))
    return np.concatenate(found)


def calibration_of(scores: FloatArray) -> Calibration:
    n = len(scores)
    return Calibration.fit(scores, np.full(n, 10.0), [CAR] * n, np.arange(n), Mode.PER_STEP)


@pytest.mark.parametrize("level", [0.5, 0.9, 0.99])
def test_sets_that_are_calibrated_on_what_the_sensors_see_cover_what_comes(level: float) -> None:
    noisy = calibration_of(errors(seed=1))
    factors = noisy.factors(level, np.array([10.0]), [CAR])[0]
    # A plane normal error of known standard deviation has a Rayleigh distribution; of what is
    # measured, the filter takes a part away.
    unfiltered = SIGMA * math.sqrt(-2.0 * math.log(1.0 - level))
    assert np.all((0.2 * unfiltered < factors) & (factors < 0.8 * unfiltered))
    new = errors(seed=2)
    for step in range(4):
        scores = new[np.isfinite(new[:, step]), step]
        four_errors = 4.0 * math.sqrt(2.0 * level * (1.0 - level) / len(scores))
        assert np.mean(scores <= factors[step]) == pytest.approx(level, abs=four_errors)
    # Those that are calibrated on exact states cover none of it.
    exact = calibration_of(errors(seed=1, loop=IDEAL)).factors(level, np.array([10.0]), [CAR])[0]
    assert np.nanmean(new <= exact) < 0.01


def test_a_scale_stands_for_the_coverage_that_it_has_in_the_ideal_loop() -> None:
    rng = np.random.default_rng(3)
    there = rng.exponential(size=(20_000, 2))
    here = 3.0 * rng.weibull(2.0, size=(20_000, 2))
    ideal, noisy = calibration_of(there), calibration_of(here)
    row = 3  # Cars of 8 to 16 m/s.
    before = np.zeros(2)
    for scale in (0.001, 0.5, 1.0, 3.0):
        factors = noisy.table_like(ideal, scale)[row]
        assert np.mean(here <= factors, axis=0) == pytest.approx(
            np.mean(there <= scale, axis=0), abs=0.006
        )
        assert np.all(factors > before)
        before = factors
        # To itself, a scale is what it is.
        np.testing.assert_allclose(ideal.table_like(ideal, scale)[row], scale, rtol=1e-12)
    assert not noisy.table_like(ideal, 0.0).any()
    far = 2.0 * ideal.quantiles[row, :, -1].astype(np.float64)
    assert noisy.table_like(ideal, float(far[0]))[row, 0] == pytest.approx(
        2.0 * float(noisy.quantiles[row, 0, -1])
    )
    assert len(LEVELS) == noisy.quantiles.shape[2]


def test_the_calibration_follows_the_errors_of_the_loop() -> None:
    late = LoopSettings(latency=0.3, sensing=SensingSettings(range=50.0, occlusion=True))
    for loop, expected in ((IDEAL, "ideal"), (late, "ideal"), (REALISTIC, "realistic")):
        assert record(choose_predictor("dos", {}, loop))["calibration"] == expected
        # That of a predictor within another one, too.
        nested = record(choose_predictor("growing-circle", {"base": "dos"}, loop))
        assert nested["base"]["options"]["calibration"] == expected
        for asked in ("ideal", "realistic"):
            chosen = choose_predictor("dos", {"calibration": asked}, loop)
            assert record(chosen)["calibration"] == asked
    with pytest.raises(RegistryError, match="expected 'auto' or 'ideal' or 'realistic'"):
        choose_predictor("dos", {"calibration": "noisy"})


def test_a_module_without_a_calibration_for_the_loop_keeps_a_scale_and_no_coverage() -> None:
    found = choose_predictor("dos", {"sets": "pr"}, REALISTIC)
    assert record(found)["calibration"] == "ideal"
    with pytest.raises(RegistryError, match=r"pr\.realistic\.calibration\.npz: .* loop realistic"):
        create_predictor("dos", 0, {"sets": "pr", "coverage": 0.9}, REALISTIC)


@pytest.mark.parametrize(
    ("loop", "options", "name"),
    [
        (IDEAL, {}, "union"),
        (REALISTIC, {}, "union-realistic"),
        (REALISTIC, {"coverage": 0.9, "conditional": True}, "union-realistic"),
        (REALISTIC, {"sets": "union"}, "union"),
        (REALISTIC, {"calibration": "ideal"}, "union"),
        (REALISTIC, {"scale": 0.5}, "union"),  # It has no coverage in the ideal loop to stand for.
        (LoopSettings(latency=0.3), {}, "union"),
    ],
)
def test_where_sensors_err_the_sets_are_those_that_were_trained_for_it(
    loop: LoopSettings, options: dict[str, object], name: str
) -> None:
    files = set(create_predictor("dos", 0, options, loop).weight_files())
    both = {shipped_sets(one) for one in DEFAULT_SETS.values()}
    assert files & both == {shipped_sets(name)}


def test_a_module_may_be_calibrated_for_the_realistic_loop_alone(tmp_path: Path) -> None:
    shipped = shipped_sets("coverage")
    weights = tmp_path / shipped.name
    shutil.copy(shipped, weights)
    own, theirs = (calibration_file(x, CalibratedFor.REALISTIC) for x in (weights, shipped))
    shutil.copy(theirs, own)
    options: dict[str, object] = {"sets": str(weights)}
    observation = seen(busy_scenario())

    def semi_axes(loop: LoopSettings, **more: object) -> FloatArray:
        predictor = create_predictor("dos", 0, options | more, loop)
        assert (own in predictor.weight_files()) == (loop is REALISTIC)
        return predictor.predict(observation).semi_axes

    wanted = DEFAULT_COVERAGE[CalibratedFor.REALISTIC]
    np.testing.assert_array_equal(semi_axes(REALISTIC), semi_axes(REALISTIC, coverage=wanted))
    np.testing.assert_array_equal(semi_axes(IDEAL), semi_axes(IDEAL, scale=1.0))  # As trained.


def test_a_run_hands_its_loop_to_the_predictor(tmp_path: Path) -> None:
    config = RunConfig(out=tmp_path, planner="idm", loop="realistic")
    _, predictor, _ = make_plugins(config)
    ideal, realistic = (
        calibration_file(shipped_sets(DEFAULT_SETS[loop]), loop)
        for loop in (CalibratedFor.IDEAL, CalibratedFor.REALISTIC)
    )
    assert {ideal, realistic} & set(predictor.weight_files()) == {realistic}
    _, predictor, _ = make_plugins(replace(config, loop="ideal"))
    assert {ideal, realistic} & set(predictor.weight_files()) == {ideal}


def test_each_loop_has_its_coverage_and_the_same_needs_larger_sets_where_sensors_err() -> None:
    observation = seen(busy_scenario())
    one = DosSettings(sets="coverage")
    sets: dict[tuple[CalibratedFor, float | None], Occupancy] = {
        (loop, coverage): DosPredictor(
            settings=replace(one, calibration=loop, coverage=coverage)
        ).predict(observation)
        for loop in (CalibratedFor.AUTO, *DEFAULT_COVERAGE)
        for coverage in (None, 0.9, 0.8)
    }
    exact = sets[CalibratedFor.IDEAL, 0.9]
    for loop, coverage in ((CalibratedFor.AUTO, 0.9), *DEFAULT_COVERAGE.items()):
        expected = sets[loop, coverage].semi_axes
        np.testing.assert_array_equal(sets[loop, None].semi_axes, expected)
    moving = exact.semi_axes[..., 0] > 0.0
    for coverage in (0.9, 0.8):
        seen_badly = sets[CalibratedFor.REALISTIC, coverage]
        seen_exactly = sets[CalibratedFor.IDEAL, coverage]
        assert np.all(seen_badly.semi_axes[moving] > seen_exactly.semi_axes[moving])
        np.testing.assert_array_equal(seen_badly.centre, seen_exactly.centre)


def test_a_scale_is_a_factor_on_the_sets_as_they_were_trained() -> None:
    observation = seen(busy_scenario())
    half, trained = (
        DosPredictor(settings=DosSettings(sets="coverage", scale=scale)).predict(observation)
        for scale in (0.5, 1.0)
    )
    np.testing.assert_array_equal(half.semi_axes, 0.5 * trained.semi_axes)


def test_the_shipped_calibrations_are_of_the_same_steps_and_modes() -> None:
    for name in ("union", "coverage", "free"):
        found = [
            load_calibrations(calibration_file(shipped_sets(name), loop))
            for loop in (CalibratedFor.IDEAL, CalibratedFor.REALISTIC)
        ]
        assert found[0].keys() == found[1].keys() == set(Mode)
        assert found[0][Mode.PER_STEP].horizon == found[1][Mode.PER_STEP].horizon == 20
        assert min(c.highest_level for c in found[1].values()) > 0.99


def test_what_is_sent_to_a_cluster_is_left_to_the_loop_there() -> None:
    sent = portable_options(choose_predictor("dos", {"coverage": 0.9}))
    assert sent["calibration"] == "auto"
    assert record(choose_predictor("dos", sent, REALISTIC))["calibration"] == "realistic"
