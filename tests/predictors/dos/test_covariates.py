"""What is known of road users: of tracks whose noise is known, and alike in training and in use."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dosplan_dos.covariates import NAMES, covariates, track_noise
from dosplan_dos.predictor import DosPredictor, DosSettings
from dosplan_dos.sizes import ConditionalSizes, covariates_of
from dosplan_dos.training import encode_windows
from dosplan_net.encoder import shared_encoder, shipped_weights
from dosplan_net.engine import Engine
from dosplan_net.features import PIECES, cut_map, describe
from dosplan_net.training.cache import WindowCache

from dosplan.scenario import find_scenarios, load_recording
from dosplan.scenario.synthetic import busy_scenario, steady_tracks, straight_map, straight_scenario
from dosplan.simulation.world import watch
from dosplan.types import FloatArray, Observation
from tests.predictors.conftest import CACHED, EVERY
from tests.support.models import save_network, seen

STEP = 30
TRACKS = steady_tracks([[0.0, 0.0, 0.0, 10.0], [25.0, 0.0, 0.0, 8.0]], steps=60)


def known(observation: Observation) -> FloatArray:
    """Covariates of all road users."""
    pieces = cut_map(observation.road_map)
    of = describe(observation, pieces)
    rows = np.arange(len(of.pose))
    return covariates(of.pose, of.history, of.static, of.neighbours, of.pieces, pieces.pose, rows)


def column(values: FloatArray, name: str) -> FloatArray:
    return np.asarray(values[:, NAMES.index(name)])


def observed(position: float = 0.0, speed: float = 0.0) -> FloatArray:
    """Mean over moments of what is known of two cars whose recording errs by that much."""
    rng = np.random.default_rng(3)
    states = np.array(TRACKS.states)
    states[..., :2] += position * rng.normal(size=states[..., :2].shape)
    states[..., 3] += speed * rng.normal(size=states[..., 3].shape)
    scenario = straight_scenario(replace(TRACKS, states=states))
    return np.asarray(np.mean([known(o) for o in watch(scenario, 1) if o.step >= STEP], axis=0))


def test_noise_of_a_track_shows_in_decades_above_a_centimetre() -> None:
    exact, noisy = observed(), observed(position=0.3)
    for name in ("noise of position, along", "noise of position, across"):
        np.testing.assert_allclose(column(exact, name), 0.0, atol=0.01)
        np.testing.assert_allclose(column(noisy, name), np.log10(0.31) + 2.0, atol=0.15)
    np.testing.assert_allclose(track_noise(exact), 0.0, atol=1e-3)
    assert np.all(track_noise(noisy) > 0.2)
    only_speed = observed(speed=0.5)
    np.testing.assert_allclose(column(only_speed, "noise of position, along"), 0.0, atol=0.01)
    assert np.all(column(only_speed, "speed against motion") > 1.0)


def test_the_leader_and_the_speed_are_known() -> None:
    values = known(seen(straight_scenario(TRACKS)))
    # The second drives 25 m ahead of the first, which comes closer by 2 m/s; nobody leads it.
    gap, speed = 25.0, np.array([10.0, 8.0])
    assert column(values, "gap to leader")[0] == pytest.approx(1.0 / (1.0 + gap / 10.0), abs=0.05)
    assert column(values, "gap to leader")[1] == 0.0
    np.testing.assert_allclose(column(values, "speed"), np.log1p(speed))
    np.testing.assert_array_equal(column(values, "road ahead turns"), 0.0)


def test_a_road_user_that_is_seen_for_the_first_time_has_no_noise() -> None:
    values = known(next(watch(straight_scenario(TRACKS), 1)))
    assert np.all(np.isfinite(values))
    np.testing.assert_allclose(column(values, "noise of position, along"), 0.0, atol=1e-9)
    assert np.all(column(values, "steps seen") < 0.2)


def test_no_road_and_no_others_are_no_obstacle() -> None:
    observation = seen(straight_scenario(steady_tracks([[0.0, 0.0, 0.0, 10.0]])))
    bare = replace(observation, road_map=replace(straight_map(), lanelets=()))
    of = describe(bare, cut_map(bare.road_map))
    assert of.pieces.shape == (1, PIECES)
    assert np.all(np.isfinite(known(bare)))


def test_training_and_episode_know_the_same(
    recordings: Path, window_cache: Path, tmp_path: Path
) -> None:
    network = save_network(tmp_path / "net.safetensors")
    windows = encode_windows([WindowCache.open(window_cache)], network, "net")
    rows = windows.recording.numpy() == 0
    trained = windows.covariates.numpy()[rows]
    encoder = shared_encoder(network, Engine.TORCH, 1, lights=True)
    scenario = load_recording(find_scenarios(recordings / f"{CACHED[0]}.xml.gz")[0])
    used = np.concatenate([covariates_of(encoder.encode(o)) for o in watch(scenario, EVERY)])
    # Of every window there is a road user in the episode of which the same is known.
    apart = np.abs(trained[:, None] - used[None]).max(axis=2)
    assert np.all(apart.min(axis=1) < 2e-3)


def test_sets_follow_what_is_known() -> None:
    settings = DosSettings(sets="coverage", coverage=0.9, conditional=True)
    predictor = DosPredictor(settings=settings)
    assert isinstance(predictor._sizes, ConditionalSizes)
    encoder = shared_encoder(shipped_weights(), Engine.TORCH, 1, lights=True)
    observation = seen(busy_scenario())
    encoded = encoder.encode(observation)
    factors = predictor._sizes.factors(observation, encoded)
    by_group = DosPredictor(settings=replace(settings, conditional=False))
    plain, conditional = by_group.predict(observation), predictor.predict(observation)
    np.testing.assert_array_equal(plain.centre, conditional.centre)
    grown = conditional.semi_axes[encoded.moving, 1::2] / plain.semi_axes[encoded.moving, 1::2]
    expected = factors / by_group._sizes.factors(observation, encoded)
    np.testing.assert_allclose(grown[..., 0], expected, rtol=1e-6)
    assert np.ptp(expected) > 0.1
