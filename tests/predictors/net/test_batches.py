"""Batches: references between their rows, the mirror image and the order of the windows."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dosplan_net.features import HISTORY
from dosplan_net.network import TrajectoryNetwork, neighbour_relation, piece_relation
from dosplan_net.training.batches import (
    RawBatch,
    Selection,
    cut_histories,
    disturbed,
    in_order,
    mirrored,
    read_scenes,
    retimed,
)
from dosplan_net.training.cache import WindowCache

from dosplan.simulation.settings import SensingSettings
from tests.support.models import tiny_network


@pytest.fixture
def cache(window_cache: Path) -> WindowCache:
    return WindowCache.open(window_cache)


def predicted(network: TrajectoryNetwork, batch: RawBatch) -> torch.Tensor:
    with torch.no_grad():
        everyone = torch.arange(len(batch.pose))
        trajectory: torch.Tensor = network(batch.scene(network.map_encoder, everyone))[0]
    return trajectory


def test_rows_refer_to_what_the_cache_does(cache: WindowCache) -> None:
    scenes = [20, 3, 20, 32]
    batch = read_scenes(cache, scenes)
    windows = batch.windows.numpy()
    expected = [np.arange(*cache.scene_start[s : s + 2]) for s in scenes]
    np.testing.assert_array_equal(windows, np.concatenate(expected))
    np.testing.assert_array_equal(batch.pose, cache.pose[windows])
    neighbours = batch.neighbours.numpy()
    stored = cache.neighbours[windows]
    np.testing.assert_array_equal(neighbours >= 0, stored >= 0)
    known = neighbours >= 0
    assert known.any()
    np.testing.assert_array_equal(windows[neighbours[known]], stored[known])
    # A scene that comes twice refers to itself, not to its twin.
    part = np.repeat(np.arange(4), [len(rows) for rows in expected])
    np.testing.assert_array_equal(
        part[neighbours[known]], np.broadcast_to(part[:, None], known.shape)[known]
    )
    pieces = batch.pieces.numpy()
    assert (pieces >= 0).any()
    np.testing.assert_array_equal(pieces >= 0, cache.pieces[windows] >= 0)
    some = pieces >= 0
    np.testing.assert_array_equal(
        batch.piece_pose.numpy()[pieces[some]], cache.piece_pose[cache.pieces[windows][some]]
    )
    np.testing.assert_array_equal(
        batch.recording, np.repeat(cache.scene_recording[scenes], [len(r) for r in expected])
    )


def test_a_repeated_scene_is_predicted_alike(cache: WindowCache) -> None:
    network = tiny_network()
    once = predicted(network, read_scenes(cache, [20]))
    twice = predicted(network, read_scenes(cache, [20, 5, 20]))
    torch.testing.assert_close(twice[: len(once)], once)
    torch.testing.assert_close(twice[-len(once) :], once)


@pytest.mark.parametrize("size", [1, 10, 50, 10_000])
def test_every_window_comes_once_and_in_order(cache: WindowCache, size: int) -> None:
    batches = list(in_order(Selection(cache, np.arange(cache.scenes)), size))
    windows = np.concatenate([batch.windows.numpy() for batch in batches])
    np.testing.assert_array_equal(windows, np.arange(len(cache.pose)))
    longest = int(np.diff(cache.scene_start).max())
    assert all(len(batch.windows) < size + longest for batch in batches)


def test_nothing_selected_gives_no_batch(cache: WindowCache) -> None:
    assert list(in_order(Selection(cache, np.array([], dtype=np.int64)), 10)) == []


def test_twice_mirrored_is_the_batch(cache: WindowCache) -> None:
    batch = read_scenes(cache, range(cache.scenes))
    twice = mirrored(mirrored(batch))
    for field in fields(batch):
        assert torch.equal(getattr(twice, field.name), getattr(batch, field.name)), field.name
    assert not torch.equal(mirrored(batch).future, batch.future)


def test_a_mirror_changes_sides_and_nothing_else(cache: WindowCache) -> None:
    """What the network sees of others and of the road: same ahead, opposite aside."""
    batch = read_scenes(cache, [0, 20, 30])
    network = tiny_network()
    everyone = torch.arange(len(batch.pose))
    one, other = (b.scene(network.map_encoder, everyone) for b in (batch, mirrored(batch)))
    ahead, aside = 1.0, -1.0
    for relation, signs in (
        (neighbour_relation, [ahead, aside, 1.0, 1.0, -1.0, ahead, aside]),
        (piece_relation, [ahead, aside, 1.0, 1.0, -1.0]),
    ):
        torch.testing.assert_close(
            relation(other), relation(one) * torch.tensor(signs), atol=1e-5, rtol=1e-5
        )
    attributes = mirrored(batch).piece_attributes
    assert torch.equal(attributes[:, 2], batch.piece_attributes[:, 3])
    assert torch.equal(attributes[:, [0, 1, 4]], batch.piece_attributes[:, [0, 1, 4]])
    assert torch.equal(mirrored(batch).instructive, batch.instructive)


def test_forgetting_cuts_beginnings_only(cache: WindowCache) -> None:
    batch = read_scenes(cache, range(cache.scenes))
    cut = cut_histories(batch, 0.5, np.random.default_rng(0))
    known, before = cut.history[..., 5], batch.history[..., 5]
    changed = (known != before).any(1)
    # Of those whose history is longer than the cut only some change: between 30 % and 60 %.
    assert 0.3 < changed.float().mean() < 0.6
    assert torch.equal(known[:, -1], before[:, -1])
    dropped = known < before
    steps = torch.arange(HISTORY)
    last_dropped = torch.where(dropped, steps, -1).amax(1)
    first_known = torch.where(known > 0, steps, HISTORY).amin(1)
    assert torch.all(last_dropped < first_known)
    assert not cut.history[dropped].any()
    assert torch.equal(cut.history[~dropped], batch.history[~dropped])
    torch.testing.assert_close(cut.static[:, -1], known.mean(1))
    assert torch.equal(cut.static[:, :-1], batch.static[:, :-1])
    same = cut_histories(batch, 0.0, np.random.default_rng(0))
    assert torch.equal(same.history, batch.history)


def test_instructive_are_those_that_move_or_will(cache: WindowCache) -> None:
    # One that drives, one that stands, one that starts, one that is parked and one that vanishes.
    whole = read_scenes(cache, [0])
    assert len(whole.pose) >= 5
    future = torch.zeros_like(whole.future)
    future[2, 30:, 0] = 1.1
    future_valid = torch.ones_like(whole.future_valid)
    future_valid[4] = False
    pose = torch.zeros_like(whole.pose)
    pose[[0, 3, 4], 3] = 5.0
    moves = torch.ones_like(whole.moves)
    moves[3] = False
    batch = replace(whole, pose=pose, future=future, future_valid=future_valid, moves=moves)
    assert batch.instructive[:5].tolist() == [True, False, True, False, False]
    # A way that is not recorded does not count.
    future_valid[2, 30:] = False
    assert not batch.instructive[2]


def test_other_times_are_other_speeds_on_the_same_ways(cache: WindowCache) -> None:
    batch = read_scenes(cache, [5, 20, 30])
    same = retimed(batch, 0.0, np.random.default_rng(0))
    for name in ("pose", "history", "static", "future_valid"):
        torch.testing.assert_close(getattr(same, name), getattr(batch, name))
    other = retimed(batch, 0.3, np.random.default_rng(1))
    factor = other.pose[:, 3] / batch.pose[:, 3]
    moving = batch.pose[:, 3].abs() > 1.0
    for scene in range(3):
        ours = factor[moving & (batch.scene_of == scene)]
        torch.testing.assert_close(ours, ours[:1].expand_as(ours))
        assert 1 / 1.31 < float(ours[0]) < 1.31
    assert not torch.allclose(factor[moving], torch.ones(()))
    # After a time t, a road user is where it was after t times the factor.
    row = int(torch.where(moving & batch.future_valid.all(1))[0][0])
    at = np.arange(1, 41) * float(factor[row])
    known = at <= 40
    path = np.vstack([np.zeros(2), batch.future[row, :, :2].numpy()])
    for axis in (0, 1):
        expected = np.interp(at[known], np.arange(41), path[:, axis])
        np.testing.assert_allclose(other.future[row, known, axis], expected, atol=1e-4)
    assert torch.equal(other.future_valid[row], torch.from_numpy(known))


def in_the_world(batch: RawBatch) -> torch.Tensor:
    cosine, sine = (f(batch.pose[:, None, 2]) for f in (torch.cos, torch.sin))
    x, y = batch.future[..., 0], batch.future[..., 1]
    turned = torch.stack([x * cosine - y * sine, x * sine + y * cosine], -1)
    return turned + batch.pose[:, None, :2]


def test_sensors_err_about_the_past_and_not_about_what_comes(cache: WindowCache) -> None:
    batch = read_scenes(cache, range(cache.scenes))
    errors = SensingSettings(position=0.2, speed=0.4, heading=0.1)
    seen = disturbed(batch, 1.0, errors, np.random.default_rng(0))
    torch.testing.assert_close(in_the_world(seen), in_the_world(batch), atol=1e-3, rtol=0)
    off = (seen.pose - batch.pose)[batch.moves]
    for column, size in enumerate((0.2, 0.2, 0.1, 0.4)):
        assert float(off[:, column].std()) == pytest.approx(size, rel=0.15)
    assert torch.equal(seen.pose[~batch.moves], batch.pose[~batch.moves])
    torch.testing.assert_close(seen.history[:, -1, 4], seen.pose[:, 3])
    assert seen.history[:, -1, :2].abs().max() < 1e-5  # One's own frame is where one is seen.
    nobody = disturbed(batch, 0.0, errors, np.random.default_rng(0))
    torch.testing.assert_close(nobody.history, batch.history, atol=1e-4, rtol=1e-4)
