"""Batches of scenes for the network, from the windows of caches."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from dosplan.evaluation.groups import MOVING
from dosplan.simulation.settings import SensingSettings
from dosplan.types import STEP_SECONDS
from dosplan_net.features import HISTORY, HORIZON
from dosplan_net.network import Scene
from dosplan_net.training.cache import WindowCache

STARTING = 1.0  # m; a standing road user that moves further than this is about to drive.


@dataclass(frozen=True)
class Selection:
    """Some scenes of one cache.

    Attributes:
        cache: The cache.
        scenes: (S,) the scenes.
        device: Where their tensors are to be, as torch names it.
    """

    cache: WindowCache
    scenes: npt.NDArray[np.int64]
    device: str = "cpu"


@dataclass(frozen=True)
class RawBatch:
    """Scenes of one cache as they are stored. B windows, P pieces.

    Attributes:
        windows: (B,) windows of the cache.
        scene_of: (B,) number of each window's scene in the batch.
        recording: (B,) recording of each window.
        weight: (B,) weight of each window's scene, see ``WindowCache``.
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
    scene_of: Tensor
    recording: Tensor
    weight: Tensor
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


def read_scenes(
    cache: WindowCache, scenes: Sequence[int] | npt.NDArray[np.int64], device: str = "cpu"
) -> RawBatch:
    """Reads some scenes of a cache into one batch.

    Args:
        cache: The cache.
        scenes: Which; a scene may come more than once.
        device: Where the batch is to be.

    Returns:
        The batch.
    """
    drawn = np.asarray(scenes)
    begins, ends = cache.scene_start[drawn], cache.scene_start[drawn + 1]
    lengths = ends - begins
    scene_of = np.repeat(np.arange(len(drawn)), lengths)
    # A window's place in the cache against its place in the batch.
    shift = np.repeat(begins - (np.cumsum(lengths) - lengths), lengths)
    rows = np.arange(len(shift)) + shift
    windows, offset = (torch.from_numpy(part).to(device) for part in (rows, shift))

    def take(name: str) -> Tensor:
        return cache.tensor(name, device)[windows]

    neighbours = take("neighbours").long()
    pieces = take("pieces").long()
    used, found = torch.unique(pieces, return_inverse=True)
    nothing = int(len(used) > 0 and used[0] < 0)
    used = used[nothing:]
    return RawBatch(
        windows=windows,
        scene_of=torch.from_numpy(scene_of).to(device),
        recording=torch.from_numpy(cache.scene_recording[drawn][scene_of]).to(device),
        weight=torch.from_numpy(cache.scene_weight[drawn][scene_of]).to(device),
        pose=take("pose"),
        history=take("history"),
        static=take("static"),
        neighbours=torch.where(neighbours < 0, -1, neighbours - offset[:, None]),
        pieces=found.view_as(pieces) - nothing,
        piece_shape=cache.tensor("piece_shape", device)[used],
        piece_attributes=cache.tensor("piece_attributes", device)[used],
        piece_pose=cache.tensor("piece_pose", device)[used],
        moves=take("moves"),
        future=take("future"),
        future_valid=take("future_valid"),
    )


def mirrored(batch: RawBatch) -> RawBatch:
    """The batch as seen in a mirror along the x axis: left becomes right.

    Args:
        batch: A batch.

    Returns:
        Its mirror image.
    """
    sign = batch.pose.new_tensor
    attributes = batch.piece_attributes[:, [0, 1, 3, 2, 4]]  # Left and right neighbours change.
    return replace(
        batch,
        pose=batch.pose * sign([1.0, -1.0, -1.0, 1.0]),
        history=batch.history * sign([1.0, -1.0, 1.0, -1.0, 1.0, 1.0]),
        piece_shape=batch.piece_shape * sign([1.0, -1.0, 1.0]),
        piece_attributes=attributes,
        piece_pose=batch.piece_pose * sign([1.0, -1.0, -1.0]),
        future=batch.future * sign([1.0, -1.0, -1.0]),
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
    history = batch.history * keep.to(batch.history.device)[..., None]
    static = batch.static.clone()
    static[:, -1] = history[..., 5].mean(1)
    return replace(batch, history=history, static=static)


def retimed(batch: RawBatch, spread: float, random: np.random.Generator) -> RawBatch:
    """The batch as if time went faster or slower in each scene: other speeds on the same ways.

    States between two recorded ones are interpolated; those beyond what was recorded are not known.

    Args:
        batch: A batch.
        spread: A scene's time goes between 1 / (1 + spread) and 1 + spread times as fast.
        random: Generator that draws the factors.

    Returns:
        The batch at other speeds.
    """
    scenes = int(batch.scene_of.max()) + 1
    drawn = np.exp(np.log1p(spread) * random.uniform(-1.0, 1.0, scenes))
    factor = torch.from_numpy(drawn.astype(np.float32)).to(batch.pose.device)[batch.scene_of]
    # Future headings go where the history has their sine: both are zero now.
    x, y, heading = batch.future.chunk(3, -1)
    nothing, there = torch.zeros_like(x), batch.future_valid[..., None].float()
    ahead = torch.cat([x, y, nothing, heading, nothing, there], -1)
    track = torch.cat([batch.history, ahead], 1)
    steps = torch.arange(1 - HISTORY, HORIZON + 1, device=factor.device)
    at = steps * factor[:, None] + (HISTORY - 1)
    known = (at >= 0) & (at <= track.shape[1] - 1)
    first = at.floor().long().clamp(0, track.shape[1] - 2)
    share = (at - first).clamp(0.0, 1.0)[..., None]
    wide = (-1, -1, track.shape[2])
    before, after = (track.gather(1, row[..., None].expand(*wide)) for row in (first, first + 1))
    mixed = before + share * (after - before)
    # A state on a recorded one needs no second.
    whole = ((before[..., 5] > 0) | (share[..., 0] > 1 - 1e-4)) & (
        (after[..., 5] > 0) | (share[..., 0] < 1e-4)
    )
    known = known & whole
    history = mixed[:, :HISTORY] * known[:, :HISTORY, None]
    history[..., 4] *= factor[:, None]
    history[..., 5] = known[:, :HISTORY].float()
    static = batch.static.clone()
    static[:, -1] = history[..., 5].mean(1)
    pose = batch.pose.clone()
    pose[:, 3] *= factor
    future = mixed[:, HISTORY:, [0, 1, 3]]
    valid = known[:, HISTORY:]
    return replace(
        batch,
        pose=pose,
        history=history,
        static=static,
        future=future * valid[..., None],
        future_valid=valid,
    )


def disturbed(
    batch: RawBatch, share: float, errors: SensingSettings, random: np.random.Generator
) -> RawBatch:
    """The batch as sensors that err see some of its scenes; what comes is as recorded.

    Args:
        batch: A batch.
        share: Share of the scenes.
        errors: How they err about places, headings and speeds; nothing else of it is looked at.
        random: Generator that draws scenes and errors.

    Returns:
        The batch with errors in the states until now, in the frames of the present states as seen.
    """
    scenes = int(batch.scene_of.max()) + 1
    device, count = batch.pose.device, len(batch.pose)
    chosen = torch.from_numpy(random.random(scenes) < share).to(device)[batch.scene_of]
    kept = math.exp(-STEP_SECONDS / errors.correlation)
    generator = torch.Generator(device).manual_seed(int(random.integers(2**62)))
    noise = torch.randn(count, HISTORY, 4, generator=generator, device=device)
    process = [noise[:, 0]]
    for step in range(1, HISTORY):
        process.append(kept * process[-1] + math.sqrt(1.0 - kept**2) * noise[:, step])
    size = noise.new_tensor([errors.position, errors.position, errors.heading, errors.speed])
    error = torch.stack(process, 1) * size * (chosen & batch.moves)[:, None, None]
    now = error[:, -1]
    known = batch.history[..., 5:]
    seen = batch.history[..., :2] + error[..., :2]
    turn = (
        torch.atan2(batch.history[..., 3], batch.history[..., 2]) + error[..., 2] - now[:, None, 2]
    )
    speed = batch.history[..., 4] + error[..., 3]
    parts = [
        into(now, seen),
        torch.cos(turn)[..., None],
        torch.sin(turn)[..., None],
        speed[..., None],
    ]
    heading = batch.pose[:, 2]
    cosine, sine = torch.cos(heading), torch.sin(heading)
    pose = batch.pose + torch.stack(
        [
            now[:, 0] * cosine - now[:, 1] * sine,
            now[:, 0] * sine + now[:, 1] * cosine,
            now[:, 2],
            now[:, 3],
        ],
        -1,
    )
    future = torch.cat(
        [into(now, batch.future[..., :2]), batch.future[..., 2:] - now[:, None, 2:3]], -1
    )
    history = torch.cat([*parts, known], -1) * known
    return replace(batch, pose=pose, history=history, future=future)


def into(pose: Tensor, points: Tensor) -> Tensor:
    """(B, T, 2) points in the frames of the poses (B, 3 or more): x, y, heading."""
    offset = points - pose[:, None, :2]
    cosine, sine = torch.cos(pose[:, None, 2]), torch.sin(pose[:, None, 2])
    ahead = offset[..., 0] * cosine + offset[..., 1] * sine
    return torch.stack([ahead, offset[..., 1] * cosine - offset[..., 0] * sine], -1)


def in_order(selection: Selection, size: int) -> Iterator[RawBatch]:
    """Yields every scene of a selection once, in order.

    Args:
        selection: The scenes.
        size: Windows in a batch, at least.

    Yields:
        Batches.
    """
    cache, scenes = selection.cache, selection.scenes
    lengths = cache.scene_start[scenes + 1] - cache.scene_start[scenes]
    bins = np.cumsum(lengths) - lengths
    for number in range(int(bins[-1] // size) + 1 if len(bins) else 0):
        chosen = scenes[bins // size == number]
        if len(chosen):
            yield read_scenes(cache, chosen, selection.device)
