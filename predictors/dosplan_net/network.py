"""A trajectory network: convolution for space, GRU for time, attention for interaction.

Its parts, after F of "Towards Safe and Reliable Autonomous Driving: Dynamic Occupancy Set
Prediction" (Shao, Xu, Yu, Li, Wang):

* every map piece is read by 1-D convolutions along its centre line, once per map;
* the history of every road user is read by a convolution and a GRU;
* a road user attends to the pieces ahead of it, then to its neighbours, which have attended to
  theirs;
* a decoder adds what it has learned to driving on at constant velocity.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from dosplan.types import STEP_SECONDS
from dosplan_net.features import (
    HISTORY_SIZE,
    HORIZON,
    PIECE_ATTRIBUTES,
    PIECE_CHANNELS,
    PIECE_LENGTH,
    STATIC_SIZE,
)

RELATION_SIZE: Final = 7  # x, y, distance, cos and sin of the heading, velocity ahead and aside
PIECE_RELATION_SIZE: Final = 5  # x, y, distance, cos and sin of the heading
DISTANCE_UNIT: Final = 20.0  # m
VELOCITY_UNIT: Final = 10.0  # m/s
MAP_ENCODERS: Final = ("polylines", "raster")
RECURRENT: Final = "recurrent"
MODAL: Final = "modal"
ARCHITECTURES: Final = (RECURRENT, MODAL)


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network.

    Attributes:
        history: Width of the history's GRU.
        map: Width of the map encoder.
        hidden: Width of the features H that the decoder and the occupancy sets are made from.
        heads: Attention heads.
        decoder: Width of the decoder.
        dropout: Share of the features that is set to zero in training.
        use_map: Whether the map is used.
        use_neighbours: Whether the other road users are used.
        map_encoder: How the map is read: ``polylines``, or as a ``raster``; see ``raster``.
        architecture: ``recurrent``, the network of this module, or ``modal``, that of ``modal``.
        modes: Number M of trajectories that it predicts for each road user.
    """

    history: int = 96
    map: int = 64
    hidden: int = 128
    heads: int = 4
    decoder: int = 256
    dropout: float = 0.1
    use_map: bool = True
    use_neighbours: bool = True
    map_encoder: str = "polylines"
    architecture: str = RECURRENT
    modes: int = 1

    def __post_init__(self) -> None:
        if self.map_encoder not in MAP_ENCODERS:
            raise ValueError(
                f"there is no map encoder {self.map_encoder!r}; choose {' or '.join(MAP_ENCODERS)}"
            )
        if self.architecture not in ARCHITECTURES:
            raise ValueError(
                f"there is no architecture {self.architecture!r}; "
                f"choose {' or '.join(ARCHITECTURES)}"
            )
        if self.map_encoder != MAP_ENCODERS[0] and self.architecture != RECURRENT:
            raise ValueError(
                f"the map encoder {self.map_encoder!r} goes with the architecture {RECURRENT} only"
            )
        if self.modes < 1 or (self.modes > 1 and self.architecture == RECURRENT):
            raise ValueError(
                f"modes is {self.modes}, expected 1 or, with the architecture {MODAL}, more"
            )


@dataclass(frozen=True)
class Scene:
    """A batch of road users; they may come from many scenes. N road users, T targets, P pieces.

    Attributes:
        pose: (N, 4) x, y, m, heading, rad, velocity, m/s.
        history: (N, HISTORY, 6) see ``features.SceneFeatures``.
        static: (N, STATIC_SIZE).
        targets: (T,) rows of the road users to predict.
        neighbours: (T, K) rows of other road users of the batch, -1 for none.
        pieces: (T, M) rows of ``piece_code`` and ``piece_pose``, -1 for none.
        piece_code: (P, map) encoding of each piece by ``MapEncoder``.
        piece_pose: (P, 3) x, y, m, and heading, rad.
    """

    pose: Tensor
    history: Tensor
    static: Tensor
    targets: Tensor
    neighbours: Tensor
    pieces: Tensor
    piece_code: Tensor
    piece_pose: Tensor


class Prediction(NamedTuple):
    """What a network says of T targets; M trajectories each.

    Attributes:
        trajectory: (T, M, HORIZON, 2) in each road user's frame, m.
        log_weight: (T, M) logarithms of how likely each is; their exponentials sum to 1.
        features: (T, hidden) features H.
    """

    trajectory: Tensor
    log_weight: Tensor
    features: Tensor

    def likeliest(self) -> Tensor:
        """(T, HORIZON, 2) the most likely trajectory of each, m."""
        best = self.log_weight.argmax(1)
        return self.trajectory[torch.arange(len(best), device=best.device), best]


class MapEncoder(nn.Module):
    """Reads map pieces by 1-D convolutions along their centre lines."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv1d(PIECE_CHANNELS, 32, 3, padding=1),
            nn.ReLU(),
            nn.Conv1d(32, width, 3, stride=2, padding=1),
            nn.ReLU(),
        )
        self.out = nn.Linear(width + PIECE_ATTRIBUTES, width)

    def forward(self, shape: Tensor, attributes: Tensor) -> Tensor:
        """(P, points, 3) pieces and (P, attributes) -> (P, width)."""
        scale = shape.new_tensor([PIECE_LENGTH / 2, PIECE_LENGTH / 2, 2.0])
        read = self.convolutions((shape / scale).transpose(1, 2)).amax(-1)
        return functional.relu(self.out(torch.cat([read, attributes], -1)))


class Attention(nn.Module):
    """Attention of each road user to its own list of things, with their relation to it."""

    def __init__(self, query: int, thing: int, relation: int, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(query, width)
        self.thing = nn.Linear(thing, width)
        self.relation = nn.Linear(relation, width)
        self.key_value = nn.Linear(width, 2 * width)

    def forward(self, query: Tensor, things: Tensor, rows: Tensor, relation: Tensor) -> Tensor:
        """(N, query), (Q, thing), (N, K) rows of things, (N, K, relation) -> (N, 2 width)."""
        known = rows >= 0
        read = self.relation(relation)
        if len(things):
            # An embedding's gradient is much quicker than that of an index.
            read = read + functional.embedding(rows.clamp(min=0), self.thing(things))
        read = functional.relu(read)
        key, value = self.key_value(read).chunk(2, -1)
        n, k, width = key.shape
        split = (n, k, self.heads, width // self.heads)
        asked = self.query(query).view(n, 1, self.heads, width // self.heads)
        weight = (asked * key.view(split)).sum(-1) / (width // self.heads) ** 0.5
        weight = weight.masked_fill(~known[..., None], -1e4).softmax(1)
        mixed = (weight[..., None] * value.view(split)).sum(1).reshape(n, width)
        strongest = read.masked_fill(~known[..., None], 0.0).amax(1)
        anything = known.any(1, keepdim=True)
        return torch.cat([mixed * anything, strongest], -1)


class TrajectoryNetwork(nn.Module, ABC):
    """F: the features H of every road user, and its trajectories.

    Attributes:
        config: Its sizes.
        map_encoder: Reads the pieces of the map.
    """

    map_encoder: nn.Module

    def __init__(self, config: NetworkConfig = NetworkConfig()) -> None:
        super().__init__()
        self.config = config

    @abstractmethod
    def forward(self, scene: Scene) -> Prediction:
        """Predicts the targets of a scene."""


class RecurrentNetwork(TrajectoryNetwork):
    """A GRU over the history, one trajectory."""

    def __init__(self, config: NetworkConfig = NetworkConfig()) -> None:
        super().__init__(config)
        c = config
        self.map_encoder = MapEncoder(c.map)
        self.step = nn.Conv1d(HISTORY_SIZE + 2, 48, 3, stride=2, padding=1)
        self.time = nn.GRU(48, c.history, batch_first=True)
        self.static = nn.Linear(STATIC_SIZE + 1, 32)
        seen = c.history + 32
        self.road: nn.Module = Attention(seen, c.map, PIECE_RELATION_SIZE, c.map, c.heads)
        self.located = nn.Linear(seen + 2 * c.map, c.hidden)
        self.interaction = Attention(c.hidden, seen, RELATION_SIZE, c.map, c.heads)
        self.fused = nn.Linear(c.hidden + 2 * c.map, c.hidden)
        self.dropout = nn.Dropout(c.dropout)
        last = nn.Linear(c.decoder, 2 * HORIZON)
        with torch.no_grad():  # To begin with, drive on at constant velocity.
            last.weight.mul_(0.1)
            last.bias.zero_()
        self.decoder = nn.Sequential(nn.Linear(c.hidden + 1, c.decoder), nn.ReLU(), last)

    def encode(self, scene: Scene) -> Tensor:
        """Features H of the targets: (T, hidden)."""
        velocity = scene.pose[:, 3:] / VELOCITY_UNIT
        kind = functional.relu(self.static(torch.cat([scene.static, velocity], -1)))
        seen = torch.cat([self._read_history(scene.history), kind], -1)
        own = seen[scene.targets]
        road = self.road(own, scene.piece_code, scene.pieces, piece_relation(scene))
        road = road * float(self.config.use_map)
        located = functional.relu(self.located(self.dropout(torch.cat([own, road], -1))))
        others = self.interaction(located, seen, scene.neighbours, neighbour_relation(scene))
        others = others * float(self.config.use_neighbours)
        fused = self.fused(self.dropout(torch.cat([located, others], -1)))
        return functional.relu(located + fused)

    def decode(self, features: Tensor, velocity: Tensor) -> Tensor:
        """(T, hidden) features, (T,) m/s -> (T, HORIZON, 2) m in each road user's frame."""
        read = torch.cat([self.dropout(features), velocity[:, None] / VELOCITY_UNIT], -1)
        return constant_velocity(velocity) + grown(self.decoder(read))

    def forward(self, scene: Scene) -> Prediction:
        """Predicts the targets of a scene."""
        features = self.encode(scene)
        trajectory = self.decode(features, scene.pose[scene.targets, 3])
        return Prediction(trajectory[:, None], torch.zeros_like(trajectory[:, 0, :1]), features)

    def _read_history(self, history: Tensor) -> Tensor:
        known = history[..., 5:]
        moved = (history[:, 1:, :2] - history[:, :-1, :2]) * known[:, :-1] * known[:, 1:]
        moved = functional.pad(moved, (0, 0, 1, 0))
        scale = history.new_tensor([DISTANCE_UNIT, DISTANCE_UNIT, 1, 1, VELOCITY_UNIT, 1])
        steps = torch.cat([history / scale, moved], -1).transpose(1, 2)
        last: Tensor = self.time(functional.relu(self.step(steps)).transpose(1, 2))[1]
        return last[0]


def step_seconds(like: Tensor | None = None) -> Tensor:
    """(HORIZON,) time of each predicted step, s, where ``like`` is."""
    device = None if like is None else like.device
    return STEP_SECONDS * torch.arange(1, HORIZON + 1, dtype=torch.float32, device=device)


def grown(learned: Tensor) -> Tensor:
    """(N, 2 HORIZON) -> (N, HORIZON, 2) m: it grows with time, so that first steps start exact."""
    share = (0.05 + 0.5 * step_seconds(learned))[:, None]
    return learned.reshape(-1, HORIZON, 2) * share * learned.new_tensor([4.0, 2.0])


def constant_velocity(velocity: Tensor) -> Tensor:
    """(N,) m/s -> (N, HORIZON, 2) driving straight on, m, in each road user's frame."""
    ahead = velocity[:, None] * step_seconds(velocity)
    return torch.stack([ahead, torch.zeros_like(ahead)], -1)


def piece_relation(scene: Scene) -> Tensor:
    """(T, M, PIECE_RELATION_SIZE): each piece as its road user sees it."""
    if not len(scene.piece_pose):
        return scene.pose.new_zeros(*scene.pieces.shape, PIECE_RELATION_SIZE)
    pose = scene.piece_pose[scene.pieces.clamp(min=0)]
    ahead, aside, cosine, sine = _seen_from(scene.pose[scene.targets], pose)
    distance = (ahead * ahead + aside * aside).sqrt()
    return torch.stack(
        [ahead / DISTANCE_UNIT, aside / DISTANCE_UNIT, distance / DISTANCE_UNIT, cosine, sine], -1
    )


def neighbour_relation(scene: Scene) -> Tensor:
    """(T, K, RELATION_SIZE): each neighbour as its road user sees it."""
    own = scene.pose[scene.targets]
    pose = scene.pose[scene.neighbours.clamp(min=0)]
    ahead, aside, cosine, sine = _seen_from(own, pose)
    velocity = pose[..., 3]
    return torch.stack(
        [
            ahead / DISTANCE_UNIT,
            aside / DISTANCE_UNIT,
            (ahead * ahead + aside * aside).sqrt() / DISTANCE_UNIT,
            cosine,
            sine,
            (velocity * cosine - own[:, None, 3]) / VELOCITY_UNIT,
            velocity * sine / VELOCITY_UNIT,
        ],
        -1,
    )


def _seen_from(pose: Tensor, other: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Position ahead and aside, and cos and sin of the heading, of (N, K, .) in (N, .) frames."""
    offset = other[..., :2] - pose[:, None, :2]
    cosine, sine = torch.cos(pose[:, None, 2]), torch.sin(pose[:, None, 2])
    ahead = offset[..., 0] * cosine + offset[..., 1] * sine
    aside = offset[..., 1] * cosine - offset[..., 0] * sine
    turn = other[..., 2] - pose[:, None, 2]
    return ahead, aside, torch.cos(turn), torch.sin(turn)
