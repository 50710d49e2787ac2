"""Windows of several futures of one past: what is added, and that the past counts once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dosplan_net.features import HORIZON
from dosplan_net.network import RecurrentNetwork
from dosplan_net.training.batches import read_scenes
from dosplan_net.training.cache import CacheError, WindowCache, build_cache
from dosplan_net.training.train import assign_folds, displacement, shares_of

from dosplan.scenario import load_scenario
from dosplan.scenario.futures import write_futures
from dosplan.types import IntArray, Scenario, Tracks
from tests.support.futures import appended, stopped, without
from tests.support.models import TINY
from tests.support.scenes import Goal, Problem, User, driving, write_scenario_xml

START, STEPS, EVERY = 50, 111, 10
FUTURES = 5
NAME = "ZAM_Several-1_1_T-1"


def write(folder: Path, name: str = NAME) -> Scenario:
    """Two cars, of whom the first may brake after the start, and a third that drives away."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.xml"
    users = [
        User(7, driving(60.0, 0.0, 5.0, STEPS)),
        User(8, driving(5.0, 3.5, 12.0, STEPS)),
        User(9, driving(20.0, 3.5, 12.0, STEPS)),
    ]
    problem = Problem(start_step=START, goals=(Goal(last_step=STEPS - 1),))
    write_scenario_xml(path, users=users, problems=[problem], benchmark_id=name)
    return load_scenario(path)


def others(scenario: Scenario) -> Sequence[Tracks]:
    """Futures 1 to 4: it brakes, brakes again, somebody on foot comes, and as in future 0."""
    brakes = stopped(scenario.tracks, 7, START)
    comes = appended(without(scenario.tracks, 9, START + 3), 90, START + 3)
    return brakes, brakes, comes, scenario.tracks


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("several") / "files"
    scenario = write(folder)
    write_futures(folder.parent / "futures" / f"{NAME}.npz", scenario, others(scenario))
    return folder


@pytest.fixture(scope="module")
def several(source: Path) -> WindowCache:
    out = source.parent / "cache"
    build_cache([source], out, every=EVERY, futures=FUTURES)
    return WindowCache.open(out)


def steps_of(cache: WindowCache) -> IntArray:
    """The step of each scene: by where car 8, the second, is then."""
    x = cache.pose[cache.scene_start[:-1] + 1, 0]
    return np.asarray(np.rint((x - x.min()) / 1.2), dtype=np.int64)


def test_every_step_counts_once_however_many_futures_follow(several: WindowCache) -> None:
    steps = steps_of(several)
    for step in range(0, STEPS - 5, EVERY):
        weights = several.scene_weight[steps == step]
        # Nobody is elsewhere in the four seconds after step 0; later three of the five futures
        # differ from the first, which stands for the last one as well.
        expected = [1.0] if step + HORIZON <= START else [0.4, 0.2, 0.2, 0.2]
        np.testing.assert_allclose(weights, expected, atol=1e-6)
    assert len(steps) == sum(steps == 0) + sum(steps == 10) + 4 * sum(
        s % 10 == 0 for s in range(20, 106)
    )


def test_what_was_is_the_same_and_what_comes_is_not(several: WindowCache) -> None:
    steps = steps_of(several)
    scenes = np.flatnonzero(steps == START - 10)
    first, *rest = [slice(*several.scene_start[s : s + 2]) for s in scenes]
    braked = []
    for rows in rest:
        for name in ("pose", "history", "static", "moves", "lights"):
            part = getattr(several, name)
            np.testing.assert_array_equal(part[rows], part[first])
        apart = np.abs(several.future[rows] - several.future[first]).max(axis=(1, 2))
        braked.append(apart > 1.0)
    # Who is where they are in future 0 is there again, with the same outcome.
    np.testing.assert_array_equal(
        braked, [[True, False, False], [True, False, False], [False, False, True]]
    )
    gone = several.future_valid[rest[2]][2]
    assert gone[: 10 + 3].all()
    assert not gone[10 + 3 :].any()


def test_all_futures_of_a_scenario_are_in_one_fold(source: Path, tmp_path: Path) -> None:
    files = tmp_path / "files"
    for number in (1, 2, 3):
        name = f"ZAM_Several-{number}_1_T-1"
        scenario = write(files, name)
        write_futures(tmp_path / "futures" / f"{name}.npz", scenario, others(scenario))
    build_cache([files], tmp_path / "cache", every=EVERY, futures=FUTURES)
    cache = WindowCache.open(tmp_path / "cache")
    assert len(cache.recordings) == len(cache.groups) == 3
    (fold,) = assign_folds([cache], 3)
    assert sorted(fold) == [0, 1, 2]
    # A step of one recording with its futures lies in one recording.
    for recording in range(3):
        own = cache.scene_recording == recording
        assert cache.scene_weight[own].sum() == pytest.approx(len(range(0, STEPS - 5, EVERY)))


def test_one_future_alone_is_stored_as_if_there_were_no_others(
    source: Path, tmp_path: Path
) -> None:
    write(tmp_path / "alone")
    for name, folder in (("one", source), ("other", tmp_path / "alone")):
        build_cache([folder], tmp_path / name, every=EVERY)
    kept = [
        {path.name: path.read_bytes() for path in (tmp_path / name).glob("*.*")}
        for name in ("one", "other")
    ]
    assert kept[0] == kept[1]
    assert "scene_weight.npy" not in kept[0]
    assert WindowCache.open(tmp_path / "one").scene_weight.tolist() == [1.0] * 11


def test_a_scenario_without_other_futures_counts_in_full(tmp_path: Path) -> None:
    write(tmp_path / "alone")
    build_cache([tmp_path / "alone"], tmp_path / "cache", every=EVERY, futures=FUTURES)
    assert WindowCache.open(tmp_path / "cache").scene_weight.tolist() == [1.0] * 11


def test_other_futures_make_other_windows(tmp_path: Path) -> None:
    """What an earlier build left is not taken for those of a file of futures that was changed."""
    scenario, out = write(tmp_path / "files"), tmp_path / "cache"
    found = []
    for futures in ([scenario.tracks], others(scenario)):
        write_futures(tmp_path / "futures" / f"{NAME}.npz", scenario, futures)
        found.append(build_cache([tmp_path / "files"], out, every=EVERY, futures=FUTURES).scenes)
    assert found[0] == 11 < found[1]
    # Fewer are asked for: the first that brakes is there once.
    assert (
        found[0] < build_cache([tmp_path / "files"], out, every=EVERY, futures=2).scenes < found[1]
    )


def test_figures_weigh_the_outcomes_of_a_past(several: WindowCache) -> None:
    torch.manual_seed(0)
    network = RecurrentNetwork(TINY)
    with torch.no_grad():  # Constant velocity, exactly.
        network.get_parameter("decoder.2.weight").zero_()
    batch = read_scenes(several, range(several.scenes))
    path = batch.pose[:, 3, None] * 0.1 * torch.arange(1, HORIZON + 1)
    apart = several.future[..., :2] - np.stack([path.numpy(), np.zeros(path.shape)], axis=-1)
    error = np.sqrt(np.square(apart).sum(axis=-1) + 1e-6)
    weight = np.repeat(several.scene_weight, np.diff(several.scene_start))[:, None]
    np.testing.assert_array_equal(batch.weight, weight[:, 0])
    counted = several.future_valid & batch.instructive.numpy()[:, None]
    expected = (error * counted * weight).sum() / (counted * weight).sum()
    assert displacement(network, several)["ade"] == pytest.approx(expected, rel=1e-4)
    # All of them alike would be another figure.
    plain = replace(several, scene_weight=np.ones_like(several.scene_weight))
    assert displacement(network, plain)["ade"] > 1.2 * expected


def test_shares_divide_what_is_drawn(several: WindowCache) -> None:
    weights = [np.array([1.0, 2.0, 1.0]), np.array([0.2, 0.2])]
    first, second = shares_of([several, several], weights, [3.0, 1.0])
    assert first.sum() == pytest.approx(3.0 * second.sum())
    assert first.sum() + second.sum() == pytest.approx(4.4)
    np.testing.assert_allclose(first / first[0], [1.0, 2.0, 1.0])
    assert shares_of([several, several], weights, []) == weights
    for wrong in ([1.0], [1.0, 0.0], [1.0, 1.0, 1.0]):
        with pytest.raises(CacheError, match=f"shares has {len(wrong)} entries for 2 caches"):
            shares_of([several, several], weights, wrong)
