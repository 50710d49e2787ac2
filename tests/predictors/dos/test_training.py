"""The module of sets and its training: what it learns from, and the figures it is judged by."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dosplan_dos.calibration import CalibratedFor, calibration_file
from dosplan_dos.losses import LossConfig
from dosplan_dos.module import OccupancyModule, SetConfig
from dosplan_dos.shapes import Variant
from dosplan_dos.training import (
    SetTraining,
    Windows,
    coverage_figures,
    describe_config,
    encode_windows,
    load_module,
    read_config,
    scores,
    train_module,
)
from dosplan_net.network import constant_velocity
from dosplan_net.training.cache import WindowCache
from dosplan_net.training.optimise import FitSettings
from dosplan_net.training.train import Foretold
from dosplan_net.weights import WeightsError

from tests.support.models import TINY, save_network, save_sets

CONFIG = SetConfig(features=TINY.hidden, hidden=8)
SOURCES = {"data": ["a"], "validation": ["b"]}


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_network(tmp_path_factory.mktemp("weights") / "net.safetensors")


@pytest.fixture
def windows(window_cache: Path, network: Path) -> Windows:
    return encode_windows([WindowCache.open(window_cache)], network, "net")


def test_windows_are_of_those_that_can_move(window_cache: Path, network: Path) -> None:
    cache = WindowCache.open(window_cache)
    kept = cache.moves & cache.future_valid[:, 0]
    owner = np.repeat(cache.scene_recording, np.diff(cache.scene_start))
    windows = encode_windows([cache, cache], network, "constant-velocity")
    np.testing.assert_array_equal(windows.future[: kept.sum()], cache.future[kept][..., :2])
    # Recordings of the second cache come after those of the first.
    expected = np.concatenate([owner[kept], owner[kept] + len(cache.recordings)])
    np.testing.assert_array_equal(windows.recording, expected)
    assert torch.equal(windows.trajectory, constant_velocity(windows.velocity)[:, None])


def test_cross_fitted_trajectories_replace_the_networks_own(
    window_cache: Path, network: Path
) -> None:
    cache = WindowCache.open(window_cache)
    trajectories = np.arange(len(cache.pose) * 80, dtype=np.float32).reshape(-1, 1, 40, 2)
    foretold = Foretold(trajectories, np.zeros((len(cache.pose), 1), dtype=np.float32))
    kept = cache.moves & cache.future_valid[:, 0]
    windows = encode_windows([cache], network, "net", [foretold])
    np.testing.assert_array_equal(windows.trajectory, trajectories[kept])
    own = encode_windows([cache], network, "net")
    assert torch.equal(windows.features, own.features)
    assert not torch.equal(windows.trajectory, own.trajectory)


@pytest.mark.parametrize("variant", [Variant.FREE, Variant.V2])
def test_every_parameter_of_the_module_learns(windows: Windows, variant: Variant) -> None:
    torch.manual_seed(0)
    module = OccupancyModule(replace(CONFIG, variant=variant))
    sets, error, valid = windows.sets(module, torch.arange(40))
    LossConfig("paper").make()(sets, error, valid).backward()
    for name, parameter in module.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


def test_scores_are_distances_and_nan_where_nothing_is_recorded(
    windows: Windows, tmp_path: Path
) -> None:
    module = load_module(save_sets(tmp_path / "sets.safetensors"))
    found, areas = scores(module, windows)
    assert areas.shape == found.shape
    assert np.all(areas > 0.0)
    known = windows.valid[:, 1::2].numpy()
    assert not known.all()
    np.testing.assert_array_equal(np.isfinite(found), known)
    row = int(np.flatnonzero(known.all(axis=1))[0])
    with torch.no_grad():
        sets, _, _ = windows.sets(module, torch.tensor([row]))
    a, b = sets.semi_axes[0, -1].tolist()
    angle = 0.5 * math.atan2(*reversed(sets.double_angle[0, -1].tolist()))
    x, y = (windows.future[row, -1] - windows.trajectory[row, 0, -1]).tolist()
    ahead = x * math.cos(angle) + y * math.sin(angle)
    aside = y * math.cos(angle) - x * math.sin(angle)
    assert found[row, -1] == pytest.approx(math.hypot(ahead / a, aside / b), rel=1e-4)


def test_figures_are_shares_and_mean_areas(windows: Windows, tmp_path: Path) -> None:
    module = load_module(save_sets(tmp_path / "sets.safetensors"))
    figures = coverage_figures(module, windows)
    distance, _ = scores(module, windows)
    for second in (1, 2, 3, 4):
        at = distance[:, 5 * second - 1]
        at = at[np.isfinite(at)]
        assert figures[f"cr_{second}"] == pytest.approx(np.mean(at <= 1))
        factor = np.quantile(at, 0.9)
        expected = factor**2 * figures[f"osa_{second}"]
        assert figures[f"osa90_{second}"] == pytest.approx(expected, rel=1e-4)
    mean = np.exp(np.mean([np.log(figures[f"osa90_{s}"]) for s in (1, 2, 3, 4)]))
    assert next(iter(figures)) == "osa90"  # What training selects by.
    assert figures["osa90"] == pytest.approx(mean)


def test_training_resumes_and_the_seed_makes_it_the_same(windows: Windows, tmp_path: Path) -> None:
    fit = FitSettings(steps=12, validate_every=4, learning_rate=0.01)
    training = SetTraining(fit=fit, batch=32)
    whole = train_module("a", CONFIG, training, windows, [windows], SOURCES, tmp_path / "whole")

    def interrupt(line: str) -> None:
        if " step 8 " in line:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_module(
            "a", CONFIG, training, windows, [windows], SOURCES, tmp_path / "parts", interrupt
        )
    parts = train_module("a", CONFIG, training, windows, [windows], SOURCES, tmp_path / "parts")
    assert parts == whole
    # The loss has multipliers of its own, which must survive the interruption as well.
    one, other = (load_module(tmp_path / p / "a.safetensors") for p in ("whole", "parts"))
    for name, value in one.state_dict().items():
        assert torch.equal(other.state_dict()[name], value), name


def test_a_config_comes_back() -> None:
    config = SetConfig(Variant.V1, LossConfig("paper", k=0.5), "constant-velocity", 12, 8)
    assert read_config(describe_config(config)) == config
    assert read_config({}) == SetConfig()


def test_windows_of_an_unseen_cache_keep_the_networks_own_trajectories(
    window_cache: Path, network: Path
) -> None:
    cache = WindowCache.open(window_cache)
    trajectories = np.zeros((len(cache.pose), 1, 40, 2), dtype=np.float32)
    foretold = Foretold(trajectories, np.zeros((len(cache.pose), 1), dtype=np.float32))
    windows = encode_windows([cache, cache], network, "net", [foretold, None])
    own = encode_windows([cache], network, "net").trajectory
    assert not windows.trajectory[: len(own)].any()
    assert torch.equal(windows.trajectory[len(own) :], own)


def test_draws_follow_the_weights(windows: Windows) -> None:
    everyone = windows.drawn(0)
    assert torch.equal(everyone.future, windows.future)
    light = replace(windows, weight=torch.where(windows.recording > 0, 0.2, 1.0))
    drawn = light.drawn(3)
    assert torch.equal(drawn.weight, torch.ones(len(drawn.weight)))
    assert drawn.places == windows.places
    assert (drawn.recording == 0).sum() == (windows.recording == 0).sum()
    rest = int((windows.recording > 0).sum())
    counts = [int((light.drawn(seed).recording > 0).sum()) for seed in range(100)]
    assert np.mean(counts) == pytest.approx(0.2 * rest, rel=0.1)


def test_windows_of_no_weight_teach_nothing(windows: Windows, tmp_path: Path) -> None:
    training = SetTraining(fit=FitSettings(steps=3, validate_every=3), batch=64)
    rest = windows.recording > 0
    light = replace(windows, weight=torch.where(rest, 0.0, 1.0))
    changed = replace(light, future=torch.where(rest[:, None, None], 50.0, windows.future))
    for name, part in (("one", light), ("other", changed)):
        train_module("a", CONFIG, training, part, [windows], SOURCES, tmp_path / name)
    one, other = (load_module(tmp_path / p / "a.safetensors") for p in ("one", "other"))
    for name, value in one.state_dict().items():
        assert torch.equal(other.state_dict()[name], value), name


def test_sets_are_trained_on_from_weights_that_are_there(windows: Windows, tmp_path: Path) -> None:
    begin = save_sets(tmp_path / "begin.safetensors", seed=4)
    still = SetTraining(fit=FitSettings(steps=1, validate_every=1, learning_rate=0.0), batch=32)
    train_module("a", CONFIG, still, windows, [windows], SOURCES, tmp_path, init=begin)
    first, kept = (load_module(path) for path in (begin, tmp_path / "a.safetensors"))
    for name, value in first.state_dict().items():
        assert torch.equal(kept.state_dict()[name], value), name
    larger = replace(CONFIG, hidden=16)
    with pytest.raises(WeightsError, match="of other sizes"):
        train_module("b", larger, still, windows, [windows], SOURCES, tmp_path, init=begin)


def test_what_is_there_is_gone_on_with_by_the_same_training_alone(
    windows: Windows, tmp_path: Path
) -> None:
    training = SetTraining(fit=FitSettings(steps=2, validate_every=2), batch=32)
    begin = save_sets(tmp_path / "begin.safetensors", seed=4)

    def train(
        config: SetConfig = CONFIG,
        training: SetTraining = training,
        sources: dict[str, list[str]] = SOURCES,
        init: Path | None = None,
    ) -> dict[str, float]:
        return train_module("a", config, training, windows, [windows], sources, tmp_path, init=init)

    def refused(differs: str, train: Callable[[], object]) -> None:
        line = rf"{tmp_path}/a.*: was trained with other {differs}; name another --out, or delete"
        with pytest.raises(WeightsError, match=line):
            train()

    train()
    for _ in ("weights", "checkpoint"):
        refused(r"module\.hidden", lambda: train(replace(CONFIG, hidden=16)))
        refused(r"module\.loss\.k", lambda: train(replace(CONFIG, loss=LossConfig(k=0.7))))
        refused("standing_share", lambda: train(training=replace(training, standing_share=0.1)))
        refused("data", lambda: train(sources=SOURCES | {"data": ["c"]}))
        refused("init", lambda: train(init=begin))
        # What else is trained, and what is calibrated, makes no difference to it.
        train(training=replace(training, modules={"b": CONFIG}, calibrated=["a"]))
        (tmp_path / "a.safetensors").unlink()


def test_calibrations_of_weights_before_are_removed(windows: Windows, tmp_path: Path) -> None:
    training = SetTraining(fit=FitSettings(steps=1, validate_every=1), batch=32)
    target = tmp_path / "a.safetensors"
    made = [
        calibration_file(target, loop) for loop in (CalibratedFor.IDEAL, CalibratedFor.REALISTIC)
    ]
    others = tmp_path / "b.calibration.npz"
    for path in (*made, others):
        path.write_bytes(b"of the weights before")
    train_module("a", CONFIG, training, windows, [windows], SOURCES, tmp_path)
    assert not any(path.exists() for path in made)
    assert others.exists()
    # Those that are made for these weights stay.
    made[0].write_bytes(b"of these weights")
    train_module("a", CONFIG, training, windows, [windows], SOURCES, tmp_path)
    assert made[0].exists()
