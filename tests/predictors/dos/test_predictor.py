"""Occupancy sets as a predictor: the contract, frames, bases and options."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dosplan_dos.predictor import DosPredictor, DosSettings
from dosplan_dos.shapes import Variant
from dosplan_dos.training import load_module
from dosplan_net.predictor import NetPredictor, NetSettings
from dosplan_simple.predictors import ConstantVelocityPredictor, NonePredictor
from dosplan_simple.sets import FixedCirclePredictor

from dosplan.api import PluginSpec, Predictor, PredictorSettings
from dosplan.plugins.conformance import check_predictor
from dosplan.scenario.synthetic import (
    busy_scenario,
    crowded_scenario,
    steady_tracks,
    straight_scenario,
)
from dosplan.simulation.world import watch
from dosplan.types import FloatArray, Observation, Occupancy, RoadUserKind
from tests.support.models import MODES, moved, save_network, save_sets, save_unions, seen, turned

CONSTANT: PluginSpec[Predictor] = PluginSpec(ConstantVelocityPredictor)


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> DosSettings:
    """Settings with a network and a module of random weights."""
    folder = tmp_path_factory.mktemp("weights")
    return DosSettings(
        network=save_network(folder / "net.safetensors"),
        sets=str(save_sets(folder / "free.safetensors")),
    )


def predict(settings: DosSettings, observation: Observation) -> Occupancy:
    return DosPredictor(settings=settings).predict(observation)


def covariance(sets: Occupancy) -> FloatArray:
    """(N, T, 2, 2) the sets as matrices, which know nothing of the order of axes."""
    cosine, sine = np.cos(sets.angle), np.sin(sets.angle)
    turn = np.stack([np.stack([cosine, -sine], -1), np.stack([sine, cosine], -1)], -2)
    return np.asarray((turn * sets.semi_axes[..., None, :] ** 2) @ np.swapaxes(turn, -1, -2))


def test_it_keeps_the_contract(settings: DosSettings) -> None:
    report = check_predictor(PluginSpec(DosPredictor, settings))
    assert report.ok, report.failures


def test_it_keeps_the_contract_on_another_base(settings: DosSettings) -> None:
    report = check_predictor(PluginSpec(DosPredictor, replace(settings, base=CONSTANT)))
    assert report.ok, report.failures


def test_sets_lie_around_the_networks_centres_and_parked_cars_have_none(
    settings: DosSettings,
) -> None:
    observation = seen(busy_scenario())
    sets = predict(settings, observation)
    base = NetPredictor(settings=NetSettings(weights=settings.network)).predict(observation)
    np.testing.assert_array_equal(sets.centre, base.centre)
    np.testing.assert_array_equal(sets.heading, base.heading)
    moves = [kind.moves for kind in observation.kinds]
    assert moves == [True, True, True, False]
    assert np.all(sets.semi_axes[:3] > 0.0)
    assert not sets.semi_axes[3].any()


@pytest.mark.parametrize("variant", list(Variant))
def test_sets_turn_with_the_scene(settings: DosSettings, tmp_path: Path, variant: Variant) -> None:
    weights = save_sets(tmp_path / f"{variant}.safetensors", variant)
    predictor = DosPredictor(settings=replace(settings, sets=str(weights)))
    here = seen(crowded_scenario())
    angle, shift = 1.3, np.array([200.0, 80.0])
    one, other = (predictor.predict(o) for o in (here, moved(here, angle, shift)))
    np.testing.assert_allclose(other.centre, turned(one.centre, angle) + shift, atol=1e-3)
    np.testing.assert_allclose(other.semi_axes, one.semi_axes, atol=1e-3)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose(covariance(other), turn @ covariance(one) @ turn.T, atol=2e-3)


def test_scale_is_a_factor_on_the_axes(settings: DosSettings) -> None:
    observation = seen(busy_scenario())
    one = predict(settings, observation)
    twice = predict(replace(settings, scale=2.0), observation)
    # Those of a module that is not calibrated are as they were trained.
    np.testing.assert_allclose(twice.semi_axes, 2.0 * one.semi_axes)
    np.testing.assert_array_equal(twice.angle, one.angle)


def test_another_base_keeps_its_centres(settings: DosSettings) -> None:
    observation = seen(busy_scenario())
    sets = predict(replace(settings, base=CONSTANT), observation)
    expected = ConstantVelocityPredictor().predict(observation)
    np.testing.assert_array_equal(sets.centre, expected.centre)
    np.testing.assert_array_equal(sets.heading, expected.heading)
    assert np.all(sets.semi_axes[:3] > 0.0)
    assert not sets.semi_axes[3].any()
    own = predict(settings, observation)
    assert not np.allclose(sets.semi_axes[:3], own.semi_axes[:3], atol=1e-3)


def test_a_base_of_the_same_network_changes_nothing(settings: DosSettings, tmp_path: Path) -> None:
    """Centres that come from a copy of the weights take the way through the scenario's frame."""
    observation = seen(busy_scenario())
    weights = save_network(tmp_path / "copy.safetensors")
    copy: PluginSpec[Predictor] = PluginSpec(NetPredictor, NetSettings(weights=weights))
    sets = predict(replace(settings, base=copy), observation)
    own = predict(settings, observation)
    np.testing.assert_allclose(sets.semi_axes, own.semi_axes, atol=1e-3)
    np.testing.assert_allclose(covariance(sets), covariance(own), atol=2e-3)


def test_a_base_that_says_nothing_is_no_obstacle(settings: DosSettings) -> None:
    sets = predict(replace(settings, base=PluginSpec(NonePredictor)), seen(busy_scenario()))
    assert not sets.valid.any()
    assert np.all(np.isfinite(sets.semi_axes))


@pytest.mark.parametrize("horizon", [1, 2, 7])
def test_a_shorter_horizon_is_the_beginning(settings: DosSettings, horizon: int) -> None:
    observation = seen(busy_scenario())
    whole = predict(settings, observation)
    part = predict(replace(settings, horizon=horizon), observation)
    np.testing.assert_allclose(part.semi_axes, whole.semi_axes[:, :horizon], atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scale": 1.0, "coverage": 0.9}, "give a scale or a coverage, not both"),
        ({"scale": -1.0}, "scale is -1.0, expected 0 or more"),
        ({"coverage": 1.5}, "coverage is 1.5, expected a share between 0 and 1"),
        ({"coverage": 0.0}, "coverage is 0.0, expected a share between 0 and 1"),
        ({"conditional": True, "scale": 1.0}, "conditional goes with a coverage, not with a scale"),
        ({"adaptation": 0.2, "scale": 1.0}, "adaptation goes with a coverage, not with a scale"),
        ({"simultaneous": True, "scale": 1.0}, "simultaneous goes with a coverage, not with a"),
        ({"adaptation": 2.0, "coverage": 0.9}, "adaptation is 2.0, expected 0 to 1"),
        ({"horizon": 41}, "horizon is 41, expected 40 or less"),
        ({"horizon": 0}, "horizon is 0, expected 1 or more"),
        ({"threads": 0}, "threads is 0, expected 1 or more"),
        (
            {"base": PluginSpec(ConstantVelocityPredictor, PredictorSettings(horizon=20))},
            "base predicts 20 steps, horizon is 40; raise base.horizon as well",
        ),
        ({"network": Path("no/where.safetensors")}, "network is no/where.safetensors, and there"),
        ({"sets": "no/where.safetensors"}, "sets is no/where.safetensors, and there is no such"),
    ],
)
def test_settings_that_cannot_work_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        DosSettings(**change)


def test_what_is_missing_is_refused_when_it_is_built(settings: DosSettings) -> None:
    with pytest.raises(ValueError, match="never calibrated"):
        DosPredictor(settings=replace(settings, adaptation=0.2))
    with pytest.raises(ValueError, match="never calibrated"):
        DosPredictor(settings=replace(settings, coverage=0.9))
    with pytest.raises(ValueError, match="never calibrated"):
        DosPredictor(settings=replace(settings, simultaneous=True))
    with pytest.raises(ValueError, match="there are no sets called 'absent'"):
        DosPredictor(settings=replace(settings, sets="absent"))


def test_a_coverage_that_no_calibration_reaches_is_refused_at_once() -> None:
    with pytest.raises(ValueError, match="level"):
        DosPredictor(settings=DosSettings(coverage=0.999999))


def test_a_base_that_predicts_further_is_cut(settings: DosSettings) -> None:
    observation = seen(busy_scenario())
    far: PluginSpec[Predictor] = PluginSpec(
        ConstantVelocityPredictor, PredictorSettings(horizon=60)
    )
    long = predict(replace(settings, base=far), observation)
    short = predict(replace(settings, base=CONSTANT), observation)
    np.testing.assert_array_equal(long.centre, short.centre)
    np.testing.assert_array_equal(long.semi_axes, short.semi_axes)
    assert long.horizon == 40


def test_all_files_that_it_uses_are_named(settings: DosSettings, tmp_path: Path) -> None:
    assert settings.network is not None
    own = (settings.network, settings.sets_file)
    assert DosPredictor(settings=settings).weight_files() == own
    other = save_network(tmp_path / "other.safetensors")
    base: PluginSpec[Predictor] = PluginSpec(NetPredictor, NetSettings(weights=other))
    assert DosPredictor(settings=replace(settings, base=base)).weight_files() == (*own, other)


def test_shipped_sets_grow_with_the_coverage() -> None:
    observation = seen(busy_scenario())
    areas = [
        float(np.prod(predict(DosSettings(coverage=c), observation).semi_axes[:3], axis=-1).mean())
        for c in (0.5, 0.8, 0.95)
    ]
    assert areas == sorted(areas)
    assert areas[0] < 0.5 * areas[2]


def test_covering_the_whole_horizon_takes_more_than_covering_each_step() -> None:
    observation = seen(busy_scenario())
    each = predict(DosSettings(coverage=0.9), observation)
    whole = predict(DosSettings(coverage=0.9, simultaneous=True), observation)
    moving = each.semi_axes[..., 0] > 0
    assert np.mean(whole.semi_axes[moving] >= each.semi_axes[moving]) > 0.9


def test_where_nobody_can_move_a_bases_own_sets_are_not_handed_out(
    settings: DosSettings,
) -> None:
    tracks = steady_tracks([[20.0, 0.0, 0.0, 0.0]])
    parked = replace(tracks, kinds=(RoadUserKind.PARKED,))
    base: PluginSpec[Predictor] = PluginSpec(FixedCirclePredictor)
    sets = predict(replace(settings, base=base), seen(straight_scenario(parked)))
    assert not sets.semi_axes.any()


def test_adaptation_begins_where_nobody_can_move() -> None:
    """A parked car alone at first; another car comes later."""
    tracks = steady_tracks([[20.0, 0.0, 0.0, 0.0], [-20.0, 3.0, 0.0, 5.0]], steps=12)
    valid = np.array(tracks.valid)
    valid[1, :6] = False
    kinds = (RoadUserKind.PARKED, RoadUserKind.CAR)
    scenario = straight_scenario(replace(tracks, kinds=kinds, valid=valid))
    base: PluginSpec[Predictor] = PluginSpec(FixedCirclePredictor)
    predictor = DosPredictor(
        settings=DosSettings(sets="coverage", coverage=0.9, adaptation=0.2, base=base)
    )
    predictor.reset(scenario.task, scenario.road_map)
    sizes = [predictor.predict(now).semi_axes for now in watch(scenario, 1)]
    assert sizes[-1][1].any()


@pytest.fixture(scope="module", params=[False, True], ids=["around", "beside"])
def union_settings(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> DosSettings:
    """Settings with a network of three courses and a module of unions."""
    folder = tmp_path_factory.mktemp("unions")
    sets = save_unions(folder / "unions.safetensors", shifted=request.param)
    network = save_network(folder / "net.safetensors", config=MODES)
    return DosSettings(network=network, sets=str(sets), scale=1.0)


def test_unions_keep_the_contract(union_settings: DosSettings) -> None:
    report = check_predictor(PluginSpec(DosPredictor, union_settings))
    assert report.ok, report.failures


def test_a_union_has_an_ellipse_around_each_course_of_events(union_settings: DosSettings) -> None:
    observation = seen(busy_scenario())
    predictor = DosPredictor(settings=union_settings)
    union = predictor.predict(observation).union
    assert union is not None
    base = NetPredictor(settings=NetSettings(weights=union_settings.network)).predict(observation)
    moving = [row for row, kind in enumerate(observation.kinds) if kind.moves]
    likeliest = union.centre[np.arange(len(union.weight)), union.likeliest]
    gap = np.linalg.norm(likeliest - base.centre, axis=-1)
    if load_module(
        union_settings.sets_file
    ).config.shifted:  # Within the length of an axis each way.
        assert gap.max() > 1e-3
        assert gap.max() <= float(union.semi_axes.max()) * np.sqrt(2.0)
    else:
        assert gap.max() < 1e-4
    np.testing.assert_allclose(
        predictor.encoder.encode(observation).log_weight,
        np.log(union.weight[moving]),
        atol=1e-4,
    )
    assert np.all(union.semi_axes[moving] > 0.0)
    parked = [row for row in range(len(observation.ids)) if row not in moving]
    assert not union.semi_axes[parked].any()
    np.testing.assert_array_equal(union.weight[parked], [[1.0, 0.0, 0.0]] * len(parked))


def test_unions_grow_with_their_scale(union_settings: DosSettings) -> None:
    observation = seen(busy_scenario())
    once = predict(union_settings, observation).union
    twice = predict(replace(union_settings, scale=2.0), observation).union
    assert once is not None
    assert twice is not None
    np.testing.assert_allclose(twice.semi_axes, 2.0 * once.semi_axes)
    np.testing.assert_array_equal(twice.weight, once.weight)


def test_who_leaves_the_scene_by_the_base_has_no_union_there(union_settings: DosSettings) -> None:
    sets = predict(replace(union_settings, base=PluginSpec(NonePredictor)), seen(busy_scenario()))
    assert not sets.valid.any()


def test_unions_on_another_base_have_one_ellipse(union_settings: DosSettings) -> None:
    observation = seen(busy_scenario())
    sets = predict(replace(union_settings, base=CONSTANT), observation)
    assert sets.union is not None
    assert sets.union.count == 1
    base = ConstantVelocityPredictor().predict(observation)
    gap = np.linalg.norm(sets.centre - base.centre, axis=-1)
    assert np.all(gap <= sets.semi_axes.max(axis=-1) * np.sqrt(2.0) + 1e-4)
