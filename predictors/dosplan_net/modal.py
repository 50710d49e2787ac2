"""A trajectory network that foretells several courses of events for each road user.

In place of a GRU, the history is read at once, together with what can be said of the motion from
it: mean velocities, accelerations and rates of turning over several spans, and how rough it is,
which tells the network how far to trust them. A road user attends to the road ahead, to its
neighbours, and to the road again; each of its M trajectories then asks the road a question of its
own, so that one may follow the way straight on and another the turn.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from dosplan.types import STEP_SECONDS
from dosplan_net.features import HISTORY, HISTORY_SIZE, HORIZON, STATIC_SIZE
from dosplan_net.network import (
    DISTANCE_UNIT,
    PIECE_RELATION_SIZE,
    RELATION_SIZE,
    VELOCITY_UNIT,
    MapEncoder,
    NetworkConfig,
    Prediction,
    Scene,
    TrajectoryNetwork,
    constant_velocity,
    grown,
    neighbour_relation,
    piece_relation,
)

SPANS: Final = (1, 2, 3, 5, 8, 12, 20, 30)  # Steps over which the motion is averaged.
ROUGHNESS_SPANS: Final = (10, 30)  # Steps over which the roughness of the history is averaged.
MOTION_SIZE: Final = 5 * len(SPANS) + 2 * len(ROUGHNESS_SPANS)
LEADER_SIZE: Final = 3  # Nearness, difference of the velocities, whether there is one.
LEADER_ASIDE: Final = 1.8  # m; who is further aside is not in the way.
LEADER_RANGE: Final = 4.0  # In units of ``DISTANCE_UNIT``.
NEAR: Final = 4.0  # Factor on distances, so that those of a few metres are told apart well.


def motion(history: Tensor) -> Tensor:
    """Describes how a road user has moved.

    Args:
        history: (N, HISTORY, HISTORY_SIZE) see ``features.SceneFeatures``.

    Returns:
        (N, MOTION_SIZE): over each of ``SPANS`` the mean velocity ahead, against the present one,
        and aside, the mean acceleration, the mean rate of turning, and whether that is known; over
        each of ``ROUGHNESS_SPANS`` the mean second difference of position and of speed.
    """
    now, before = history[:, -1:], history[:, [HISTORY - 1 - span for span in SPANS]]
    known = before[..., 5]
    seconds = STEP_SECONDS * history.new_tensor(SPANS)
    velocity = -before[..., :2] / seconds[:, None]
    ahead = (velocity[..., 0] - now[..., 4]) / 2.0
    aside = velocity[..., 1] / 2.0
    acceleration = (now[..., 4] - before[..., 4]) / seconds / 3.0
    turning = -before[..., 3] / seconds / 0.5
    parts = [(part * known).clamp(-5.0, 5.0) for part in (ahead, aside, acceleration, turning)]
    bend = history[:, 2:] - 2.0 * history[:, 1:-1] + history[:, :-2]
    whole = history[:, 2:, 5] * history[:, 1:-1, 5] * history[:, :-2, 5]
    for rough in (bend[..., :2].norm(dim=-1) / 0.05, bend[..., 4].abs() / 0.5):
        for span in ROUGHNESS_SPANS:
            last = slice(HISTORY - 1 - span, None)
            total = (rough * whole)[:, last].sum(1) / whole[:, last].sum(1).clamp(min=1.0)
            parts.append(torch.log1p(total)[:, None])
    return torch.cat([*parts, known], -1)


def leader(relation: Tensor, present: Tensor) -> Tensor:
    """Finds who is next on the way straight on.

    Args:
        relation: (T, K, RELATION_SIZE) see ``network.neighbour_relation``.
        present: (T, K) whether there is such a neighbour.

    Returns:
        (T, LEADER_SIZE) how near it is, how much faster it drives, and whether there is one.
    """
    ahead, aside = relation[..., 0], relation[..., 1]
    blocks = present & (ahead > 0.0) & (aside.abs() < LEADER_ASIDE / DISTANCE_UNIT)
    gap = torch.where(blocks, ahead, torch.full_like(ahead, LEADER_RANGE))
    nearest, which = gap.min(1, keepdim=True)
    there = (nearest < LEADER_RANGE).float()
    faster = relation[..., 5].gather(1, which)
    return torch.cat([torch.exp(-nearest) * there, faster * there, there], -1)


class Surroundings(nn.Module):
    """Things around each road user, to which it can attend several times."""

    def __init__(self, thing: int, relation: int, width: int, heads: int) -> None:
        super().__init__()
        self.heads, self.width = heads, width
        self.thing = nn.Linear(thing, width)
        self.relation = nn.Linear(relation + 2, width)
        self.joint = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)

    def forward(
        self, things: Tensor, rows: Tensor, relation: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Reads the things.

        Args:
            things: (Q, thing) encoded things.
            rows: (N, K) rows of them, -1 for none.
            relation: (N, K, relation) how each road user sees its own; it begins with the distances
                ahead and aside.

        Returns:
            (N, K, width) keys, (N, K, width) values, and (N, width) the strongest of each channel.
        """
        here = torch.tanh(NEAR * relation[..., :2])
        read = self.relation(torch.cat([relation, here], -1))
        if len(things):
            # An embedding's gradient is much quicker than that of an index.
            read = read + functional.embedding(rows.clamp(min=0), self.thing(things))
        read = functional.relu(self.joint(functional.relu(read)))
        key, value = self.key_value(read).chunk(2, -1)
        known = (rows >= 0)[..., None]
        return key, value, (read * known).amax(1)

    def ask(self, query: Tensor, key: Tensor, value: Tensor, known: Tensor) -> Tensor:
        """(N, Q, width) queries, (N, K, width) keys and values, (N, K) -> (N, Q, width)."""
        n, asked, width = query.shape
        things, share = key.shape[1], width // self.heads
        q = query.view(n, asked, self.heads, share).transpose(1, 2)
        k = key.view(n, things, self.heads, share).permute(0, 2, 3, 1)
        v = value.view(n, things, self.heads, share).transpose(1, 2)
        score = (q @ k) / share**0.5
        weight = score.masked_fill(~known[:, None, None], -1e4).softmax(-1)
        mixed: Tensor = (weight @ v).transpose(1, 2).reshape(n, asked, width)
        return mixed * known.any(1)[:, None, None]


class ModalNetwork(TrajectoryNetwork):
    """Reads the history at once; M trajectories."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        c = config
        self.map_encoder = MapEncoder(c.map)
        own = HISTORY * HISTORY_SIZE + MOTION_SIZE + STATIC_SIZE + 1
        self.past = nn.Sequential(
            nn.Linear(own, c.decoder),
            nn.ReLU(),
            nn.Dropout(c.dropout),
            nn.Linear(c.decoder, c.hidden),
            nn.LayerNorm(c.hidden),
            nn.ReLU(),
        )
        self.road = Surroundings(c.map, PIECE_RELATION_SIZE, c.map, c.heads)
        self.others = Surroundings(c.hidden, RELATION_SIZE, c.map, c.heads)
        self.questions = nn.ModuleList(nn.Linear(c.hidden, c.map) for _ in range(3))
        self.own = nn.Linear(c.hidden + LEADER_SIZE, c.hidden)
        self.steps = nn.ModuleList(
            nn.Linear(c.hidden + width, c.hidden) for width in (2 * c.map, 2 * c.map, c.map)
        )
        self.norms = nn.ModuleList(nn.LayerNorm(c.hidden) for _ in range(3))
        self.mode = nn.Parameter(torch.randn(c.modes, c.hidden))
        self.question = nn.Linear(c.hidden, c.map)
        self.course = nn.Linear(c.hidden + c.map + MOTION_SIZE + 1, c.decoder)
        self.dropout = nn.Dropout(c.dropout)
        self.path = nn.Linear(c.decoder, 2 * HORIZON)
        self.likelihood = nn.Linear(c.decoder, 1)
        with torch.no_grad():  # To begin with, drive on at constant velocity.
            self.path.weight.mul_(0.1)
            self.path.bias.zero_()

    def forward(self, scene: Scene) -> Prediction:
        """Predicts the targets of a scene."""
        c = self.config
        moved = motion(scene.history)
        speed = scene.pose[:, 3:] / VELOCITY_UNIT
        seen = self.past(torch.cat([_flat(scene.history), moved, scene.static, speed], -1))
        on_road, present = scene.pieces >= 0, scene.neighbours >= 0
        relation = neighbour_relation(scene)
        road = self.road(scene.piece_code, scene.pieces, piece_relation(scene))
        others = self.others(seen, scene.neighbours, relation)
        if not c.use_map:
            road, on_road = tuple(part * 0.0 for part in road), on_road & False
        front = leader(relation, present)
        if not c.use_neighbours:
            others, present = tuple(part * 0.0 for part in others), present & False
            front = front * 0.0
        x = functional.relu(self.own(torch.cat([seen[scene.targets], front], -1)))
        for number, (around, known) in enumerate(
            ((road, on_road), (others, present), (road, on_road))
        ):
            key, value, strongest = around
            asker = self.others if number == 1 else self.road
            found = asker.ask(self.questions[number](x)[:, None], key, value, known)[:, 0]
            parts = [x, found] if number == 2 else [x, found, strongest]
            step = functional.relu(self.steps[number](self.dropout(torch.cat(parts, -1))))
            x = self.norms[number](x + step)
        features = functional.relu(x)
        modes = features[:, None] + self.mode
        asked = self.road.ask(self.question(modes), road[0], road[1], on_road)
        own = torch.cat([moved, speed], -1)[scene.targets]
        own = own[:, None].expand(-1, c.modes, -1)
        course = functional.relu(self.course(self.dropout(torch.cat([modes, asked, own], -1))))
        velocity = scene.pose[scene.targets, 3]
        learned = grown(self.path(course).flatten(0, 1)).view(-1, c.modes, HORIZON, 2)
        trajectory = constant_velocity(velocity)[:, None] + learned
        return Prediction(trajectory, self.likelihood(course)[..., 0].log_softmax(-1), features)


def _flat(history: Tensor) -> Tensor:
    """(N, HISTORY, HISTORY_SIZE) history -> (N, HISTORY * HISTORY_SIZE) against driving straight.

    Positions and speeds are differences from those of constant velocity, so that what is small and
    matters is not lost beside what is large and known.
    """
    known = history[..., 5:]
    now = history[:, -1:, 4:5]
    seconds = STEP_SECONDS * torch.arange(
        1 - HISTORY, 1, dtype=torch.float32, device=history.device
    )
    ahead = history[..., :1] - now * seconds[:, None]
    parts = [
        ahead / 4.0,
        history[..., 1:2] / 4.0,
        history[..., 2:3] - 1.0,
        history[..., 3:4],
        (history[..., 4:5] - now) / 4.0,
    ]
    return torch.cat([*(part * known for part in parts), known], -1).flatten(1)
