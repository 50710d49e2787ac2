"""Cross-fitting: who learns from what, and that it is the same every time."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from dosplan_net.build import load_network
from dosplan_net.features import HORIZON
from dosplan_net.network import RecurrentNetwork, constant_velocity
from dosplan_net.training.batches import read_scenes
from dosplan_net.training.cache import WindowCache, build_cache
from dosplan_net.training.optimise import FitSettings
from dosplan_net.training.train import (
    NET,
    NetTraining,
    assign_folds,
    cross_fitted_trajectories,
    displacement,
    stages,
    train_stage,
)
from dosplan_net.weights import WeightsError

from tests.predictors.conftest import EVERY
from tests.support.folds import save_folds
from tests.support.models import TINY, save_network

TRAINING = NetTraining(
    network=TINY,
    fit=FitSettings(steps=20, validate_every=10),
    folds=2,
    batch=40,
)


def trained(
    stage: str, cache: Path, validation: Path, out: Path, config: NetTraining = TRAINING
) -> dict[str, torch.Tensor]:
    train_stage(stage, config, [cache], [validation], out, lambda line: None)
    return load_network(out / f"{stage}.safetensors").state_dict()


def same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> bool:
    return all(torch.equal(one[name], other[name]) for name in one)


def with_futures_mirrored(cache: Path, folder: Path, recordings: list[int]) -> Path:
    """A copy of a cache in which some recordings' road users turn to the other side."""
    shutil.copytree(cache, folder, ignore=shutil.ignore_patterns("shards"))
    opened = WindowCache.open(cache)
    owner = np.repeat(opened.scene_recording, np.diff(opened.scene_start))
    future = np.array(opened.future)
    future[np.isin(owner, recordings), :, 1:] *= -1.0
    np.save(folder / "future.npy", future)
    return folder


def test_all_stages_run_and_the_seed_makes_them_the_same(
    window_cache: Path, tmp_path: Path
) -> None:
    assert stages(TRAINING) == ["net", "fold-0", "fold-1"]
    results = {}
    for run in ("one", "again"):
        results[run] = [
            trained(stage, window_cache, window_cache, tmp_path / run) for stage in stages(TRAINING)
        ]
    for part, again in zip(*results.values(), strict=True):
        assert same(part, again)
    other = replace(TRAINING, fit=replace(TRAINING.fit, seed=2))
    net = trained(NET, window_cache, window_cache, tmp_path / "other", other)
    assert not same(net, results["one"][0])
    # No two parts of a training are the same network.
    for number, part in enumerate(results["one"]):
        assert not any(same(part, other) for other in results["one"][number + 1 :])


def test_a_part_that_is_done_is_not_trained_again(window_cache: Path, tmp_path: Path) -> None:
    config = replace(TRAINING, fit=replace(TRAINING.fit, steps=4, validate_every=4))
    lines: list[str] = []
    first = train_stage(NET, config, [window_cache], [window_cache], tmp_path, lines.append)
    assert first.keys() == {"score", "ade", "fde", "at_1", "best_ade", "best_fde"}
    assert len(lines) == 1
    assert lines[0].startswith("net: step 4 ")
    again = train_stage(NET, config, [window_cache], [window_cache], tmp_path, lines.append)
    assert again == first
    assert len(lines) == 1


def test_what_is_there_is_gone_on_with_by_the_same_training_alone(
    window_cache: Path, recordings: Path, tmp_path: Path
) -> None:
    build_cache([recordings], tmp_path / "other", every=2 * EVERY)
    begin = save_network(tmp_path / "begin" / "net.safetensors", seed=5)
    short = replace(TRAINING, fit=replace(TRAINING.fit, steps=4, validate_every=2))
    caches, others = [window_cache], [tmp_path / "other"]

    def interrupted(line: str) -> None:
        if " step 4 " in line:
            raise KeyboardInterrupt

    half, done = tmp_path / "half", tmp_path / "done"
    with pytest.raises(KeyboardInterrupt):
        train_stage(NET, short, caches, caches, half, interrupted)
    train_stage(NET, short, caches, caches, done, lambda line: None)

    def refused(
        differs: str,
        config: NetTraining = short,
        data: list[Path] = caches,
        validation: list[Path] = caches,
        init: Path | None = None,
    ) -> None:
        for out, file in ((half, f"{NET}/checkpoint.pt"), (done, f"{NET}.safetensors")):
            line = rf"{out / file}: was trained with other {differs}; name another --out, or delete"
            with pytest.raises(WeightsError, match=line):
                train_stage(NET, config, data, validation, out, init=init)

    refused(r"network\.hidden", replace(short, network=replace(TINY, hidden=16)))
    refused(r"fit\.learning_rate", replace(short, fit=replace(short.fit, learning_rate=0.1)))
    refused("batch, retiming", replace(short, batch=50, retiming=0.1))
    refused("data", data=others)
    refused("data", data=[window_cache, window_cache])
    refused("validation", validation=others)
    refused("init", init=begin)
    # How many folds there are makes no difference to it.
    for out in (half, done):
        train_stage(NET, replace(short, folds=0), caches, caches, out, lambda line: None)
    # It does to each of them.
    train_stage("fold-0", short, caches, caches, done, lambda line: None)
    with pytest.raises(WeightsError, match=r"fold-0\.safetensors: was trained with other folds;"):
        train_stage("fold-0", replace(short, folds=3), caches, caches, done)


def test_weights_that_do_not_say_what_they_are_from_are_no_result(
    window_cache: Path, tmp_path: Path
) -> None:
    save_network(tmp_path / "net.safetensors")
    caches = [window_cache]
    with pytest.raises(WeightsError, match=r"net\.safetensors: does not say what it was trained"):
        train_stage(NET, TRAINING, caches, caches, tmp_path)


def test_training_begins_from_weights_that_are_there(window_cache: Path, tmp_path: Path) -> None:
    begin = save_network(tmp_path / "begin" / "net.safetensors", seed=5)
    still = replace(
        TRAINING, folds=0, fit=FitSettings(steps=1, validate_every=1, learning_rate=0.0)
    )
    assert stages(still) == [NET]
    caches = [window_cache]
    train_stage(NET, still, caches, caches, tmp_path / "still", lambda line: None, init=begin)
    kept = load_network(tmp_path / "still" / "net.safetensors").state_dict()
    assert same(kept, load_network(begin).state_dict())
    moving = replace(still, fit=replace(still.fit, learning_rate=0.01))
    train_stage(NET, moving, caches, caches, tmp_path / "moving", lambda line: None, init=begin)
    assert not same(load_network(tmp_path / "moving" / "net.safetensors").state_dict(), kept)


def test_weights_that_a_training_cannot_begin_from(window_cache: Path, tmp_path: Path) -> None:
    begin, caches = save_network(tmp_path / "net.safetensors"), [window_cache]
    with pytest.raises(WeightsError, match=r"fold-0 cannot begin from them"):
        train_stage("fold-0", TRAINING, caches, caches, tmp_path / "out", init=begin)
    larger = replace(TRAINING, network=replace(TINY, hidden=16))
    with pytest.raises(WeightsError, match=r"net\.safetensors: .* of other sizes"):
        train_stage(NET, larger, caches, caches, tmp_path / "out", init=begin)
    with pytest.raises(WeightsError, match="absent"):
        train_stage(NET, TRAINING, caches, caches, tmp_path / "out", init=tmp_path / "absent")


def test_shares_say_how_often_a_cache_is_drawn(window_cache: Path, tmp_path: Path) -> None:
    """With a share of next to nothing, it makes no difference what a cache holds."""
    cache = WindowCache.open(window_cache)
    everyone = list(range(len(cache.recordings)))
    changed = with_futures_mirrored(window_cache, tmp_path / "changed", everyone)

    def result(name: str, second: Path, shares: list[float]) -> dict[str, torch.Tensor]:
        config, out = replace(TRAINING, folds=0, shares=shares), tmp_path / name
        caches = [window_cache, second]
        train_stage(NET, config, caches, [window_cache], out, lambda line: None)
        return load_network(out / "net.safetensors").state_dict()

    rare = [1.0, 1e-9]
    assert same(result("a", window_cache, rare), result("b", changed, rare))
    assert not same(result("c", window_cache, [1.0, 1.0]), result("d", changed, [1.0, 1.0]))


def test_several_validations_count_the_same(window_cache: Path, tmp_path: Path) -> None:
    cache = WindowCache.open(window_cache)
    other = with_futures_mirrored(window_cache, tmp_path / "other", [0, 1, 2])
    config = replace(TRAINING, folds=0, fit=FitSettings(steps=1, validate_every=1))
    found = train_stage(
        NET, config, [window_cache], [window_cache, other], tmp_path, lambda line: None
    )
    network = load_network(tmp_path / "net.safetensors")
    one, two = (displacement(network, part) for part in (cache, WindowCache.open(other)))
    assert found["ade"] == pytest.approx(0.5 * (one["ade"] + two["ade"]))
    assert one["ade"] != pytest.approx(two["ade"], rel=1e-4)


def test_cross_fitting_does_not_see_its_own_fold(window_cache: Path, tmp_path: Path) -> None:
    cache = WindowCache.open(window_cache)
    (fold,) = assign_folds([cache], 2)
    for own in (0, 1):
        recordings = np.flatnonzero(fold == own).tolist()
        changed = with_futures_mirrored(window_cache, tmp_path / f"changed-{own}", recordings)
        for other in (0, 1):
            stage, out = f"fold-{other}", tmp_path / "out"
            reference = trained(stage, window_cache, window_cache, out)
            weights = trained(stage, changed, window_cache, tmp_path / f"out-{own}")
            assert same(weights, reference) == (other == own), (other, own)


def test_each_recording_is_predicted_by_a_network_not_trained_on_it(
    window_cache: Path, tmp_path: Path
) -> None:
    cache = WindowCache.open(window_cache)
    (fold,) = assign_folds([cache], 2)
    assert set(fold) == {0, 1}
    fitted = [load_network(path) for path in save_folds(tmp_path, [window_cache])]
    (foretold,) = cross_fitted_trajectories([window_cache], tmp_path)
    labels = foretold.trajectory
    assert labels.shape == (len(cache.pose), 1, HORIZON, 2)
    for scene in range(0, cache.scenes, 4):
        batch = read_scenes(cache, [scene])
        own = fold[cache.scene_recording[scene]]
        found = labels[batch.windows.numpy()]
        with torch.no_grad():
            everyone = torch.arange(len(batch.pose))
            expected, other = (
                net(batch.scene(net.map_encoder, everyone))[0].numpy()
                for net in (fitted[own], fitted[1 - own])
            )
        np.testing.assert_allclose(found, expected, atol=1e-3)
        assert np.abs(found - other).max() > 0.1


def test_cross_fitted_trajectories_are_not_computed_again(
    window_cache: Path, tmp_path: Path
) -> None:
    save_folds(tmp_path, [window_cache])
    (first,) = cross_fitted_trajectories([window_cache], tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("cross-fitted-*.npy")}
    assert len(kept) == 2
    (again,) = cross_fitted_trajectories([window_cache], tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npy")} == kept
    np.testing.assert_array_equal(again.trajectory, first.trajectory)
    np.testing.assert_array_equal(again.log_weight, first.log_weight)


def test_other_folds_or_windows_are_foretold_anew(
    window_cache: Path, recordings: Path, tmp_path: Path
) -> None:
    def foretold(cache: Path) -> npt.NDArray[np.float32]:
        return cross_fitted_trajectories([cache], tmp_path)[0].trajectory

    build_cache([recordings], tmp_path / "cache", every=EVERY)
    save_folds(tmp_path, [tmp_path / "cache"])
    first = foretold(tmp_path / "cache")
    save_folds(tmp_path, [tmp_path / "cache"], seeds=(0, 5))
    other = foretold(tmp_path / "cache")
    assert np.abs(other - first).max() > 0.1
    # The same folder, but with other windows.
    build_cache([recordings], tmp_path / "cache", every=2 * EVERY)
    save_folds(tmp_path, [tmp_path / "cache"], seeds=(0, 5))
    assert len(foretold(tmp_path / "cache")) == len(WindowCache.open(tmp_path / "cache").pose)
    save_folds(tmp_path, [window_cache])
    cross_fitted_trajectories([window_cache], tmp_path)


def test_folds_of_another_number_or_of_other_windows_foretell_nothing(
    window_cache: Path, recordings: Path, tmp_path: Path
) -> None:
    def refused(caches: list[Path], reason: str) -> None:
        with pytest.raises(WeightsError, match=reason) as caught:
            cross_fitted_trajectories(caches, tmp_path)
        assert "\n" not in str(caught.value)

    # Of three folds the last is not trained yet: its recordings are known to the other two.
    *_, last = save_folds(tmp_path, [window_cache], seeds=(0, 1, 2))
    cross_fitted_trajectories([window_cache], tmp_path)
    last.unlink()
    refused([window_cache], r"fold-2\.safetensors: not readable .* dosplan train")
    save_folds(tmp_path, [window_cache], seeds=(0, 1))
    save_folds(tmp_path / "three", [window_cache], seeds=(0, 1, 2))
    shutil.copy(tmp_path / "three" / "fold-1.safetensors", tmp_path)
    refused([window_cache], r"fold-1\.safetensors: was trained with other folds; name the --data")
    # Other caches, one more, or another order: the folds would be others.
    save_folds(tmp_path, [window_cache])
    build_cache([recordings], tmp_path / "other", every=2 * EVERY)
    refused([tmp_path / "other"], r"fold-0\.safetensors: was trained with other data")
    refused([window_cache, tmp_path / "other"], "other data")
    save_folds(tmp_path, [window_cache, tmp_path / "other"])
    refused([tmp_path / "other", window_cache], "other data")
    # Weights of a version that did not say.
    for k in (0, 1):
        save_network(tmp_path / f"fold-{k}.safetensors", seed=k)
    refused([window_cache], r"fold-0\.safetensors: does not say what it was trained from")


def test_two_caches_of_one_name_keep_answers_of_their_own(
    window_cache: Path, tmp_path: Path
) -> None:
    caches = [tmp_path / place / "cache" for place in ("here", "there")]
    for folder in caches:
        shutil.copytree(window_cache, folder, ignore=shutil.ignore_patterns("shards"))
    save_folds(tmp_path, caches)
    cross_fitted_trajectories(caches, tmp_path)
    assert len(list(tmp_path.glob("cross-fitted-*-trajectory.npy"))) == 2


def test_without_cross_fitting_it_says_what_is_missing(window_cache: Path, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"fold-0\.safetensors"):
        cross_fitted_trajectories([window_cache], tmp_path)


def grouped(cache: WindowCache, windows: dict[str, int]) -> WindowCache:
    """A cache of one scene per recording, whose names and sizes are given."""
    counts = np.array(list(windows.values()))
    return replace(
        cache,
        scene_start=np.concatenate(([0], np.cumsum(counts))),
        scene_recording=np.arange(len(counts)),
        recordings=tuple(windows),
        groups=tuple(name.partition("_")[0] for name in windows),
        simulated=(False,) * len(counts),
    )


def test_groups_stay_together_and_folds_are_balanced(window_cache: Path) -> None:
    cache = WindowCache.open(window_cache)
    random = np.random.default_rng(0)
    parts = [
        grouped(cache, {f"{random.integers(40)}_{i}": int(random.integers(1, 100)) for i in span})
        for span in (range(100), range(100, 250))
    ]
    folds = assign_folds(parts, 4)
    fold_of: dict[str, int] = {}
    load = np.zeros(4)
    for part, fold in zip(parts, folds, strict=True):
        assert fold.shape == (len(part.recordings),)
        for group, k, size in zip(part.groups, fold, np.diff(part.scene_start), strict=True):
            assert fold_of.setdefault(group, int(k)) == k  # Across caches as well.
            load[k] += size
    # The largest first, always to the emptiest: no fold is ahead by more than the last one put in.
    assert load.max() - load.min() < 0.05 * load.sum()
    again = assign_folds(parts, 4)
    assert all(np.array_equal(a, b) for a, b in zip(again, folds, strict=True))


def test_displacement_is_the_mean_error_of_those_that_move(window_cache: Path) -> None:
    cache = WindowCache.open(window_cache)
    torch.manual_seed(0)
    network = RecurrentNetwork(TINY)
    with torch.no_grad():  # Constant velocity, exactly.
        network.get_parameter("decoder.2.weight").zero_()
    figures = displacement(network, cache)
    batch = read_scenes(cache, range(cache.scenes))
    path = constant_velocity(batch.pose[:, 3]).numpy()
    error = np.linalg.norm(path - cache.future[..., :2], axis=-1)
    counted = cache.future_valid & batch.instructive.numpy()[:, None]
    assert figures["ade"] == pytest.approx(error[counted].mean(), rel=1e-5)
    assert figures["fde"] == pytest.approx(error[:, -1][counted[:, -1]].mean(), rel=1e-5)
