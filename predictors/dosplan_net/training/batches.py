"""Batches of scenes for the network, from the windows of caches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from dosplan.evaluation.groups import MOVING
from dosplan_net.features import HISTORY
from dosplan_net.network import Scene
from dosplan_net.training.cache import WindowCache

STARTING = 1.0  # m; a standing road user that moves further than this is about to drive.


@dataclass(frozen=True)
class Selection:
    """Some scenes of one cache.

    Attributes:
        cache: The cache.
        scenes: (S,) the scenes.
    """

    cache: WindowCache
    scenes: npt.NDArray[np.int64]


@dataclass(frozen=True)
class RawBatch:
    """Scenes of one cache as they are stored. B windows, P pieces.

    Attributes:
        windows: (B,) windows of the cache.
        recording: (B,) recording of each window.
        pose: (B, 4); ``history``, ``static``, ``neighbours``, ``pieces``: see ``network.Scene``.
        history: See ``network.Scene``.
        static: See ``network.Scene``.
        neighbours: See ``network.Scene``.
        pieces: See ``network.Scene``.
        piece_shape: (P, points, 3).
        piece_attributes: (P, attributes).
        piece_pose: (P, 3).
        moves: (B,) whether the road user can move.
        future: (B, HORIZON, 3) x, y, m, and heading, rad.
        future_valid: (B, HORIZON).
    """

    windows: Tensor
    recording: Tensor
    pose: Tensor
    history: Tensor
    static: Tensor
    neighbours: Tensor
    pieces: Tensor
    piece_shape: Tensor
    piece_attributes: Tensor
    piece_pose: Tensor
    moves: Tensor
    future: Tensor
    future_valid: Tensor

    def scene(self, encoder: nn.Module, targets: Tensor) -> Scene:
        """What the network takes, with the map read by ``encoder``, for some of the windows."""
        return Scene(
            pose=self.pose,
            history=self.history,
            static=self.static,
            targets=targets,
            neighbours=self.neighbours[targets],
            pieces=self.pieces[targets],
            piece_code=encoder(self.piece_shape, self.piece_attributes),
            piece_pose=self.piece_pose,
        )

    @property
    def instructive(self) -> Tensor:
        """(B,) training mask: windows of road users that move or are about to."""
        drives = self.pose[:, 3].abs() >= MOVING
        far: Tensor = (self.future[..., :2].norm(dim=-1) * self.future_valid).amax(1) > STARTING
        return (drives | far) & self.moves & self.future_valid[:, 0]


def read_scenes(cache: WindowCache, scenes: Sequence[int] | npt.NDArray[np.int64]) -> RawBatch:
    """Reads some scenes of a cache into one batch.

    Args:
        cache: The cache.
        scenes: Which; a scene may come more than once.

    Returns:
        The batch.
    """
    spans = [(int(cache.scene_start[s]), int(cache.scene_start[s + 1])) for s in scenes]
    windows = np.concatenate([np.arange(a, b) for a, b in spans])
    lengths = np.array([b - a for a, b in spans])
    # A neighbour's row in the batch: its place in its scene, after the scenes before.
    shift = np.repeat(np.cumsum(lengths) - lengths - np.array([a for a, _ in spans]), lengths)
    neighbours = cache.neighbours[windows].astype(np.int64)
    neighbours = np.where(neighbours < 0, -1, neighbours + shift[:, None])
    pieces = cache.pieces[windows].astype(np.int64)
    used, rows = np.unique(pieces, return_inverse=True)
    rows = rows.reshape(pieces.shape)
    if len(used) and used[0] == -1:
        used, rows = used[1:], rows - 1
    take = torch.from_numpy
    return RawBatch(
        windows=take(windows),
        recording=take(np.repeat(cache.scene_recording[np.asarray(scenes)], lengths)),
        pose=take(cache.pose[windows]),
        history=take(cache.history[windows]),
        static=take(cache.static[windows]),
        neighbours=take(neighbours),
        pieces=take(rows),
        piece_shape=take(cache.piece_shape[used]),
        piece_attributes=take(cache.piece_attributes[used]),
        piece_pose=take(cache.piece_pose[used]),
        moves=take(cache.moves[windows]),
        future=take(cache.future[windows]),
        future_valid=take(cache.future_valid[windows]),
    )


def mirrored(batch: RawBatch) -> RawBatch:
    """The batch as seen in a mirror along the x axis: left becomes right.

    Args:
        batch: A batch.

    Returns:
        Its mirror image.
    """
    attributes = batch.piece_attributes[:, [0, 1, 3, 2, 4]]  # Left and right neighbours change.
    return replace(
        batch,
        pose=batch.pose * torch.tensor([1.0, -1.0, -1.0, 1.0]),
        history=batch.history * torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0, 1.0]),
        piece_shape=batch.piece_shape * torch.tensor([1.0, -1.0, 1.0]),
        piece_attributes=attributes,
        piece_pose=batch.piece_pose * torch.tensor([1.0, -1.0, -1.0]),
        future=batch.future * torch.tensor([1.0, -1.0, -1.0]),
    )


def cut_histories(batch: RawBatch, share: float, random: np.random.Generator) -> RawBatch:
    """The batch with some histories cut short: their first steps are marked as not known.

    Args:
        batch: A batch.
        share: Share of the road users whose history is cut.
        random: Generator that draws them.

    Returns:
        The batch with shorter histories.
    """
    count = len(batch.pose)
    cut = random.integers(1, HISTORY, count) * (random.random(count) < share)
    keep = torch.from_numpy(np.arange(HISTORY)[None] >= cut[:, None])
    history = batch.history * keep[..., None]
    static = batch.static.clone()
    static[:, -1] = history[..., 5].mean(1)
    return replace(batch, history=history, static=static)


def in_order(selection: Selection, size: int) -> Iterator[RawBatch]:
    """Yields every scene of a selection once, in order.

    Args:
        selection: The scenes.
        size: Windows in a batch, at least.

    Yields:
        Batches.
    """
    yield from _chunks(selection.cache, selection.scenes, size)


def _chunks(cache: WindowCache, scenes: npt.NDArray[np.int64], size: int) -> Iterator[RawBatch]:
    """Groups scenes into batches of at least ``size`` windows, but for the last."""
    lengths = cache.scene_start[scenes + 1] - cache.scene_start[scenes]
    bins = np.cumsum(lengths) - lengths
    for number in range(int(bins[-1] // size) + 1 if len(bins) else 0):
        chosen = scenes[bins // size == number]
        if len(chosen):
            yield read_scenes(cache, chosen)
