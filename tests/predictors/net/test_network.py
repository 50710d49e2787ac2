"""The trajectory network: what its answer may and may not depend on."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from dosplan_net.build import build_network
from dosplan_net.features import HORIZON, NEIGHBOURS, PIECES
from dosplan_net.network import (
    MODAL,
    NetworkConfig,
    Prediction,
    Scene,
    TrajectoryNetwork,
    constant_velocity,
    step_seconds,
)
from dosplan_net.training.batches import RawBatch, read_scenes
from dosplan_net.training.cache import WindowCache
from dosplan_net.training.losses import TrajectoryLoss
from torch import Tensor

from tests.support.models import MODES, TINY, tiny_network

FULL_MODES = NetworkConfig(architecture=MODAL, modes=3)
assert_close = partial(torch.testing.assert_close, atol=1e-4, rtol=1e-4)
"""Single precision, m."""


@pytest.fixture
def batch(window_cache: Path) -> RawBatch:
    """A few scenes of two recordings: cars, pedestrians and parked cars."""
    return read_scenes(WindowCache.open(window_cache), [0, 15, 25])


def scene_of(network: TrajectoryNetwork, batch: RawBatch, targets: Tensor | None = None) -> Scene:
    everyone = torch.arange(len(batch.pose))
    return batch.scene(network.map_encoder, everyone if targets is None else targets)


def run(network: TrajectoryNetwork, scene: Scene) -> tuple[Tensor, Tensor]:
    """All trajectories, and all else that is said of the targets."""
    with torch.no_grad():
        found: Prediction = network(scene)
    return found.trajectory, torch.cat([found.features, found.log_weight], -1)


each_network = pytest.mark.parametrize("config", [TINY, MODES], ids=["recurrent", "modal"])


@each_network
def test_other_scenes_of_a_batch_do_not_matter(window_cache: Path, config: NetworkConfig) -> None:
    cache = WindowCache.open(window_cache)
    network = tiny_network(config=config)
    alone, _ = run(network, scene_of(network, read_scenes(cache, [15])))
    together = read_scenes(cache, [3, 15, 25])
    trajectory, _ = run(network, scene_of(network, together))
    rows = np.isin(together.windows, np.arange(*cache.scene_start[15:17]))
    assert_close(trajectory[rows], alone)


@each_network
def test_the_order_of_road_users_and_of_what_they_see_does_not_matter(
    batch: RawBatch, config: NetworkConfig
) -> None:
    network = tiny_network(config=config)
    scene = scene_of(network, batch)
    trajectory, features = run(network, scene)
    torch.manual_seed(1)
    order = torch.randperm(len(scene.pose))
    place = torch.argsort(order)  # Where each row goes.
    neighbours = torch.where(scene.neighbours < 0, -1, place[scene.neighbours])[order]
    shuffled = replace(
        scene,
        pose=scene.pose[order],
        history=scene.history[order],
        static=scene.static[order],
        neighbours=neighbours[:, torch.randperm(NEIGHBOURS)],
        pieces=scene.pieces[order][:, torch.randperm(PIECES)],
    )
    other_trajectory, other_features = run(network, shuffled)
    assert_close(other_trajectory, trajectory[order])
    assert_close(other_features, features[order])


@each_network
def test_targets_choose_rows_of_the_answer(batch: RawBatch, config: NetworkConfig) -> None:
    network = tiny_network(config=config)
    everyone, _ = run(network, scene_of(network, batch))
    targets = torch.tensor([7, 0, 3])
    some, features = run(network, scene_of(network, batch, targets))
    assert_close(some, everyone[targets])
    assert features.shape == (3, TINY.hidden + config.modes)
    nobody, _ = run(network, scene_of(network, batch, targets[:0]))
    assert nobody.shape == (0, config.modes, HORIZON, 2)


@each_network
def test_the_answer_turns_with_the_scene(batch: RawBatch, config: NetworkConfig) -> None:
    """In the road users' own frames nothing changes."""
    network = tiny_network(config=config)
    scene = scene_of(network, batch)
    angle, shift = 0.8, torch.tensor([30.0, -12.0])
    turn = torch.tensor([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def placed(pose: Tensor) -> Tensor:
        place = pose[:, :2] @ turn.float() + shift
        return torch.cat([place, pose[:, 2:3] + angle, pose[:, 3:]], -1)

    moved = replace(scene, pose=placed(scene.pose), piece_pose=placed(scene.piece_pose))
    assert_close(run(network, moved)[0], run(network, scene)[0])


@each_network
def test_neighbours_and_map_matter_only_where_they_are_looked_at(
    batch: RawBatch, config: NetworkConfig
) -> None:
    for part in ("neighbours", "pieces"):
        for used in (True, False):
            road, others = used or part == "neighbours", used or part == "pieces"
            network = tiny_network(config=replace(config, use_map=road, use_neighbours=others))
            scene = scene_of(network, batch)
            blind = replace(scene, **{part: torch.full_like(getattr(scene, part), -1)})
            gap = (run(network, scene)[0] - run(network, blind)[0]).abs().amax()
            assert (gap > 1e-3) == used, (part, used)


@each_network
def test_no_neighbours_no_pieces_and_nobody(config: NetworkConfig) -> None:
    network = tiny_network(config=config)
    count = 3
    scene = Scene(
        pose=torch.tensor([[0.0, 0.0, 0.0, 8.0]]).repeat(count, 1),
        history=torch.zeros(count, 31, 6),
        static=torch.zeros(count, 9),
        targets=torch.arange(count),
        neighbours=torch.full((count, NEIGHBOURS), -1),
        pieces=torch.full((count, PIECES), -1),
        piece_code=torch.zeros(0, TINY.map),
        piece_pose=torch.zeros(0, 3),
    )
    trajectory, features = run(network, scene)
    assert torch.isfinite(trajectory).all()
    assert torch.isfinite(features).all()
    # A map of which nobody is told is no map.
    with_map = replace(scene, piece_code=torch.ones(5, TINY.map), piece_pose=torch.ones(5, 3))
    assert_close(run(network, with_map)[0], trajectory)


@pytest.mark.parametrize("config", [TINY, NetworkConfig(), MODES, FULL_MODES])
def test_an_untrained_network_drives_on_at_constant_velocity(
    batch: RawBatch, config: NetworkConfig
) -> None:
    torch.manual_seed(0)
    network = build_network(config).eval()
    trajectory, _ = run(network, scene_of(network, batch))
    gap = (trajectory - constant_velocity(batch.pose[:, 3])[:, None]).norm(dim=-1)
    assert gap[..., 0].max() < 0.05
    assert gap[..., -1].max() < 1.0


def test_constant_velocity_is_velocity_times_time() -> None:
    path = constant_velocity(torch.tensor([10.0, -2.0]))
    assert_close(step_seconds()[[0, 9, 39]], torch.tensor([0.1, 1.0, 4.0]))
    assert_close(path[0, [0, 9, 39], 0], torch.tensor([1.0, 10.0, 40.0]))
    assert_close(path[1, 39], torch.tensor([-8.0, 0.0]))


@each_network
def test_every_parameter_learns(batch: RawBatch, config: NetworkConfig) -> None:
    torch.manual_seed(0)
    network = build_network(replace(config, dropout=0.0)).train()
    found = network(scene_of(network, batch))
    total, count = TrajectoryLoss().total(found, batch.future, batch.future_valid)
    (total / count).backward()  # type: ignore[no-untyped-call]
    for name, parameter in network.named_parameters():
        if name == "likelihood.bias":
            continue  # What all courses have in common makes none of them likelier.
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().max() > 0, name


def test_dropout_is_for_training_only(batch: RawBatch) -> None:
    network = tiny_network(config=replace(TINY, dropout=0.5))
    scene = scene_of(network, batch)
    assert torch.equal(run(network, scene)[0], run(network, scene)[0])
    network.train()
    torch.manual_seed(0)
    assert not torch.equal(run(network, scene)[0], run(network, scene)[0])
