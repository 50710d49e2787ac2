"""The network as a predictor: the contract, frames and headings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dosplan_net.predictor import NetPredictor, NetSettings, placed

from dosplan.api import PluginSpec
from dosplan.plugins.conformance import check_predictor
from dosplan.scenario.synthetic import busy_scenario, crowded_scenario, steady_tracks
from dosplan.types import FloatArray, RoadUserKind
from tests.support.models import moved, save_network, seen, seen_at, turned


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_network(tmp_path_factory.mktemp("weights") / "net.safetensors")


def test_it_keeps_the_contract(network: Path) -> None:
    report = check_predictor(PluginSpec(NetPredictor, NetSettings(weights=network)))
    assert report.ok, report.failures


@pytest.mark.parametrize("kind", [RoadUserKind.PARKED, RoadUserKind.STATIC])
def test_what_cannot_move_stays(network: Path, kind: RoadUserKind) -> None:
    tracks = steady_tracks(
        [[5.0, 3.0, 0.7, 8.0], [30.0, 0.0, 0.0, 8.0]], kinds=[kind, RoadUserKind.CAR]
    )
    observation = seen_at(tracks, 40)
    sets = NetPredictor(settings=NetSettings(weights=network)).predict(observation)
    now = observation.states[:, -1]
    np.testing.assert_array_equal(sets.centre[0], np.tile(now[0, :2], (40, 1)))
    np.testing.assert_array_equal(sets.heading[0], np.full(40, 0.7))
    assert np.linalg.norm(sets.centre[1, -1] - now[1, :2]) > 10.0


def test_predictions_turn_with_the_scene(network: Path) -> None:
    here = seen(crowded_scenario())
    angle, shift = 2.1, np.array([300.0, -150.0])
    there = moved(here, angle, shift)
    one, other = (
        NetPredictor(settings=NetSettings(weights=network)).predict(o) for o in (here, there)
    )
    np.testing.assert_allclose(other.centre, turned(one.centre, angle) + shift, atol=1e-3)
    np.testing.assert_allclose(other.heading, one.heading + angle, atol=1e-3)


def test_a_shorter_horizon_is_the_beginning(network: Path) -> None:
    observation = seen(busy_scenario())
    whole = NetPredictor(settings=NetSettings(weights=network)).predict(observation)
    part = NetPredictor(settings=NetSettings(weights=network, horizon=7)).predict(observation)
    np.testing.assert_allclose(part.centre, whole.centre[:, :7], atol=1e-5)


def test_a_horizon_beyond_training_is_refused() -> None:
    with pytest.raises(ValueError, match="horizon is 41, expected 40 or less"):
        NetSettings(horizon=41)


def test_missing_weights_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"weights is .*absent\.safetensors, and there is no such"):
        NetSettings(weights=tmp_path / "absent.safetensors")


def headings(local: FloatArray, present: float = 0.4) -> FloatArray:
    """(T,) change of heading along a (T, 2) trajectory in the road user's frame."""
    observation = seen_at(steady_tracks([[5.0, 3.0, present, 0.0]]), 3)
    sets = placed(observation, np.array([0]), local[None])
    np.testing.assert_allclose(
        sets.centre[0], turned(local, present) + observation.states[0, -1, :2], atol=1e-9
    )
    return np.asarray(sets.heading[0] - present)


SECONDS = 0.1 * np.arange(1, 41)


def test_heading_along_a_straight_way_is_kept() -> None:
    np.testing.assert_allclose(headings(np.stack([8.0 * SECONDS, 0.0 * SECONDS], -1)), 0.0)


def test_heading_turns_with_the_way() -> None:
    # 10 m/s on 50 m: 0.2 rad/s, 0.8 rad in all; chords of 6 m, drawn back by 0.5 m in 6.5.
    turn = 0.2 * SECONDS
    found = headings(50.0 * np.stack([np.sin(turn), 1 - np.cos(turn)], -1))
    middle = slice(3, 37)
    np.testing.assert_allclose(found[middle], turn[middle], rtol=0.13, atol=0.02)
    assert np.all(np.diff(found[middle]) > 0)
    mirrored = headings(50.0 * np.stack([np.sin(turn), np.cos(turn) - 1], -1))
    np.testing.assert_allclose(mirrored, -found)


def test_who_stands_does_not_spin() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.02, (40, 2))
    # A chord of two such points is 0.03 m across, against half a metre of memory.
    assert np.max(np.abs(headings(noise))) < 0.2
    np.testing.assert_array_equal(headings(np.zeros((40, 2))), 0.0)


def test_who_reverses_keeps_looking_ahead() -> None:
    # Backwards and a little to the left: it looks 0.1 rad to the right, less what memory holds.
    found = headings(np.stack([-3.0 * SECONDS, 0.3 * SECONDS], -1))
    assert np.all((found < -0.05) & (found > -0.1))


def test_who_is_about_to_drive_off_looks_ahead() -> None:
    # A bus at its stop: noise of millimetres first, forwards after that.
    way = np.where(SECONDS < 1.5, -0.002, 1.5 * np.maximum(SECONDS - 1.5, 0.0) ** 2)
    for back in (-0.002, -0.05):
        way[:5] = back
        found = headings(np.stack([way, np.zeros(40)], -1))
        np.testing.assert_allclose(found, 0.0, atol=1e-6)


def test_who_turns_round_looks_back_in_the_end() -> None:
    # 5 m/s on 6 m: 0.83 rad/s, more than half a turn in 4 s.
    turn = 5.0 / 6.0 * SECONDS
    found = headings(6.0 * np.stack([np.sin(turn), 1 - np.cos(turn)], -1))
    np.testing.assert_allclose(found[3:37], turn[3:37], atol=0.35)
