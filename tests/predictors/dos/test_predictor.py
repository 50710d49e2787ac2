"""Occupancy sets as a predictor: the contract, frames, bases and options."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dosplan_dos.predictor import DosPredictor
from dosplan_dos.shapes import Variant
from dosplan_net.predictor import NetPredictor
from dosplan_simple.predictors import ConstantVelocityPredictor, NonePredictor

from dosplan.plugins.conformance import check_predictor
from dosplan.scenario.synthetic import busy_scenario, crowded_scenario
from dosplan.types import FloatArray, Occupancy
from tests.support.models import moved, save_network, save_sets, seen, turned


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("weights")
    return {
        "network": save_network(folder / "net.safetensors"),
        "sets": save_sets(folder / "free.safetensors"),
    }


def covariance(sets: Occupancy) -> FloatArray:
    """(N, T, 2, 2) the sets as matrices, which know nothing of the order of axes."""
    cosine, sine = np.cos(sets.angle), np.sin(sets.angle)
    turn = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    return np.asarray((turn * sets.semi_axes[..., None, :] ** 2) @ np.swapaxes(turn, -1, -2))


def test_it_keeps_the_contract(files: dict[str, Path]) -> None:
    report = check_predictor(partial(DosPredictor, **files))  # type: ignore[arg-type]
    assert report.ok, report.failures


def test_it_keeps_the_contract_on_another_base(files: dict[str, Path]) -> None:
    def build(*, seed: int, horizon: int) -> DosPredictor:
        options: dict[str, Any] = {**files, "base": ConstantVelocityPredictor(horizon=horizon)}
        return DosPredictor(seed=seed, horizon=horizon, **options)

    report = check_predictor(build)
    assert report.ok, report.failures


def test_sets_lie_around_the_networks_centres_and_parked_cars_have_none(
    files: dict[str, Path],
) -> None:
    observation = seen(busy_scenario())
    sets = DosPredictor(**files).predict(observation)  # type: ignore[arg-type]
    base = NetPredictor(weights=files["network"]).predict(observation)
    np.testing.assert_array_equal(sets.centre, base.centre)
    np.testing.assert_array_equal(sets.heading, base.heading)
    moves = [kind.moves for kind in observation.kinds]
    assert moves == [True, True, True, False]
    assert np.all(sets.semi_axes[:3] > 0.0)
    assert not sets.semi_axes[3].any()


@pytest.mark.parametrize("variant", list(Variant))
def test_sets_turn_with_the_scene(files: dict[str, Path], tmp_path: Path, variant: Variant) -> None:
    weights = save_sets(tmp_path / f"{variant}.safetensors", variant)
    predictor = DosPredictor(network=files["network"], sets=weights)
    here = seen(crowded_scenario())
    angle, shift = 1.3, np.array([200.0, 80.0])
    one, other = (predictor.predict(o) for o in (here, moved(here, angle, shift)))
    np.testing.assert_allclose(other.centre, turned(one.centre, angle) + shift, atol=1e-3)
    np.testing.assert_allclose(other.semi_axes, one.semi_axes, atol=1e-3)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose(covariance(other), turn @ covariance(one) @ turn.T, atol=2e-3)


def test_scale_is_a_factor_on_the_axes(files: dict[str, Path]) -> None:
    observation = seen(busy_scenario())
    one = DosPredictor(**files).predict(observation)  # type: ignore[arg-type]
    twice = DosPredictor(**files, scale=2.0).predict(observation)  # type: ignore[arg-type]
    # Driving takes half the axes that were trained.
    np.testing.assert_allclose(twice.semi_axes, 4.0 * one.semi_axes)
    np.testing.assert_array_equal(twice.angle, one.angle)


def test_another_base_keeps_its_centres(files: dict[str, Path]) -> None:
    observation = seen(busy_scenario())
    base = ConstantVelocityPredictor(horizon=40)
    sets = DosPredictor(**files, base=base).predict(observation)  # type: ignore[arg-type]
    expected = base.predict(observation)
    np.testing.assert_array_equal(sets.centre, expected.centre)
    np.testing.assert_array_equal(sets.heading, expected.heading)
    assert np.all(sets.semi_axes[:3] > 0.0)
    assert not sets.semi_axes[3].any()
    own = DosPredictor(**files).predict(observation)  # type: ignore[arg-type]
    assert not np.allclose(sets.semi_axes[:3], own.semi_axes[:3], atol=1e-3)


def test_a_base_of_the_same_network_changes_nothing(files: dict[str, Path], tmp_path: Path) -> None:
    """Centres that come from a copy of the weights take the way through the scenario's frame."""
    observation = seen(busy_scenario())
    copy = NetPredictor(weights=save_network(tmp_path / "copy.safetensors"))
    sets = DosPredictor(**files, base=copy).predict(observation)  # type: ignore[arg-type]
    own = DosPredictor(**files).predict(observation)  # type: ignore[arg-type]
    np.testing.assert_allclose(sets.semi_axes, own.semi_axes, atol=1e-3)
    np.testing.assert_allclose(covariance(sets), covariance(own), atol=2e-3)


def test_a_base_that_says_nothing_is_no_obstacle(files: dict[str, Path]) -> None:
    sets = DosPredictor(**files, base=NonePredictor(horizon=40)).predict(  # type: ignore[arg-type]
        seen(busy_scenario())
    )
    assert not sets.valid.any()
    assert np.all(np.isfinite(sets.semi_axes))


@pytest.mark.parametrize("horizon", [1, 2, 7])
def test_a_shorter_horizon_is_the_beginning(files: dict[str, Path], horizon: int) -> None:
    observation = seen(busy_scenario())
    whole = DosPredictor(**files).predict(observation)  # type: ignore[arg-type]
    part = DosPredictor(**files, horizon=horizon).predict(observation)  # type: ignore[arg-type]
    np.testing.assert_allclose(part.semi_axes, whole.semi_axes[:, :horizon], atol=1e-5)


def test_what_cannot_work_is_refused(files: dict[str, Path]) -> None:
    options: dict[str, Any] = dict(files)
    with pytest.raises(ValueError, match="give a scale or a coverage, not both"):
        DosPredictor(scale=1.0, coverage=0.9, **options)
    with pytest.raises(ValueError, match="dos-v1 predicts 40 steps at most, asked for 41"):
        DosPredictor(horizon=41, **options)
    with pytest.raises(ValueError, match="base predicts 20 steps, horizon is 40"):
        DosPredictor(base=ConstantVelocityPredictor(horizon=20), **options)
    with pytest.raises(ValueError, match="never calibrated"):
        DosPredictor(coverage=0.9, **options)
    with pytest.raises(ValueError, match="there are no sets called 'absent'"):
        DosPredictor(network=files["network"], sets="absent")


@pytest.mark.parametrize("level", [0.0, 1.0, 1.5, 0.999999])
def test_a_coverage_that_cannot_be_had_is_refused_at_once(level: float) -> None:
    with pytest.raises(ValueError, match="level"):
        DosPredictor(coverage=level)


def test_shipped_sets_grow_with_the_coverage() -> None:
    observation = seen(busy_scenario())
    areas = [
        float(np.prod(DosPredictor(coverage=c).predict(observation).semi_axes[:3], axis=-1).mean())
        for c in (0.5, 0.8, 0.95)
    ]
    assert areas == sorted(areas)
    assert areas[0] < 0.5 * areas[2]


def test_covering_the_whole_horizon_takes_more_than_covering_each_step() -> None:
    observation = seen(busy_scenario())
    each = DosPredictor(coverage=0.9).predict(observation)
    whole = DosPredictor(coverage=0.9, simultaneous=True).predict(observation)
    moving = each.semi_axes[..., 0] > 0
    assert np.mean(whole.semi_axes[moving] >= each.semi_axes[moving]) > 0.9
