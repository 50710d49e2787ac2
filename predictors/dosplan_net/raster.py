"""The network with another map encoder: an image of the road around each road user.

The pieces that the polyline network attends to are drawn into a grid in the road user's frame,
which 2-D convolutions read. It is here for comparison; the shipped network reads polylines.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from dosplan_net.features import PIECE_CHANNELS, PIECE_POINTS
from dosplan_net.network import DISTANCE_UNIT, NetworkConfig, RecurrentNetwork

SIDE: Final = 64  # Cells along and across.
CELL_AHEAD: Final = 1.5  # m
CELL_ASIDE: Final = 1.0  # m
BEHIND: Final = 16.0  # m from the grid's near edge to the road user, who is midway across.
CHANNELS: Final = 5  # drawn or not, cos and sin of the piece's heading, half width, for cars

_POINT_VALUES: Final = PIECE_POINTS * PIECE_CHANNELS
_FOR_CARS: Final = _POINT_VALUES + 1  # Column of a kept piece; see ``features.MapPieces``.


class RasterNetwork(RecurrentNetwork):
    """``RecurrentNetwork`` that sees the road as an image."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.map_encoder = PieceKeeper()
        self.road = RasterReader(2 * config.map)


class PieceKeeper(nn.Module):
    """Takes the place of the polyline encoder: keeps the pieces as they are, to be drawn."""

    def forward(self, shape: Tensor, attributes: Tensor) -> Tensor:
        """(P, points, 3) pieces and (P, attributes) -> (P, points * 3 + attributes)."""
        return torch.cat([shape.flatten(1), attributes], -1)


class RasterReader(nn.Module):
    """Takes the place of the attention to pieces: draws the pieces and reads the image."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(CHANNELS, 16, 5, stride=2, padding=2),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, stride=2, padding=1),
            nn.ReLU(),
        )
        self.out = nn.Linear(32 * (SIDE // 8) ** 2, width)

    def forward(self, query: Tensor, things: Tensor, rows: Tensor, relation: Tensor) -> Tensor:
        """See ``network.Attention``; the query is not used."""
        read = self.convolutions(draw(things, rows, relation)).flatten(1)
        return functional.relu(self.out(read))


def draw(things: Tensor, rows: Tensor, relation: Tensor) -> Tensor:
    """Draws centre lines as each road user sees them.

    Args:
        things: (P, points * 3 + attributes) pieces; see ``PieceKeeper``.
        rows: (N, K) the pieces of each of N road users, -1 for none.
        relation: (N, K, 5) where they are; see ``network.piece_relation``.

    Returns:
        (N, CHANNELS, SIDE, SIDE) the mean over the points in each cell; ahead is the third axis,
        to the left the fourth.
    """
    if not len(things):
        return relation.new_zeros(len(rows), CHANNELS, SIDE, SIDE)
    drawn = things[rows.clamp(min=0)]
    points = drawn[..., :_POINT_VALUES].reshape(*rows.shape, PIECE_POINTS, PIECE_CHANNELS)
    # Points are up to 2.2 m apart; with the midpoints added, a line has no gaps in the grid.
    points = torch.cat([points, 0.5 * (points[..., 1:, :] + points[..., :-1, :])], -2)
    ahead, aside, _, cosine, sine = relation[..., None].unbind(-2)
    x = ahead * DISTANCE_UNIT + points[..., 0] * cosine - points[..., 1] * sine
    y = aside * DISTANCE_UNIT + points[..., 0] * sine + points[..., 1] * cosine
    row = torch.floor((x + BEHIND) / CELL_AHEAD).long()
    column = torch.floor(y / CELL_ASIDE).long() + SIDE // 2
    inside = (row >= 0) & (row < SIDE) & (column >= 0) & (column < SIDE)
    inside = inside & (rows >= 0)[..., None]
    user = torch.arange(len(rows))[:, None, None]
    cell = ((user * SIDE + row) * SIDE + column)[inside]
    value = torch.stack(
        [
            torch.ones_like(x),
            cosine.expand_as(x),
            sine.expand_as(x),
            points[..., 2] / 2.0,
            drawn[..., _FOR_CARS, None].expand_as(x),
        ],
        -1,
    )[inside]
    total = value.new_zeros(len(rows) * SIDE * SIDE, CHANNELS).index_add(0, cell, value)
    mean = total / total[:, :1].clamp(min=1)
    return mean.view(len(rows), SIDE, SIDE, CHANNELS).permute(0, 3, 1, 2)
