"""The occupancy-set module: features and a trajectory in, ellipses out.

After the paper: the features H, repeated over time, go through a GRU (H1); the predicted
trajectory goes through a linear layer and a GRU (H2); a decoder turns [H1, H2] into the ellipse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import torch
from dosplan_net.modal import MOTION_SIZE, motion
from dosplan_net.network import DISTANCE_UNIT, VELOCITY_UNIT, constant_velocity
from torch import Tensor, nn
from torch.nn import functional

from dosplan_dos.losses import LossConfig
from dosplan_dos.shapes import (
    Ellipses,
    Unions,
    Variant,
    ellipses,
    grid_seconds,
    grid_steps,
    half_angle,
    legs,
)

OUTPUTS: Final = 4  # Two lengths, cosine and sine of the double angle.
TRAJECTORY_INPUTS: Final = 8
CONSTANT_VELOCITY = "constant-velocity"
BASES = ("net", CONSTANT_VELOCITY)


@dataclass(frozen=True)
class SetConfig:
    """A module and how it is trained.

    Attributes:
        variant: The ellipses' representation.
        loss: What it is trained for.
        base: The trajectory predictor whose errors it has learned, by its name.
        features: Width of the features H; training takes the width that the network has.
        hidden: Width of the GRUs, or of a union's layers.
        modes: Number M of ellipses of a union, one around each trajectory of the network; 1 for
            the paper's module, which puts one around the most likely trajectory.
        shifted: Whether a union's ellipses may lie beside their trajectories.
        dropout: Share of what a union is made from that is set to zero in training.
    """

    variant: Variant = Variant.FREE
    loss: LossConfig = field(default_factory=LossConfig)
    base: str = "net"
    features: int = 128
    hidden: int = 48
    modes: int = 1
    shifted: bool = False
    dropout: float = 0.1

    def __post_init__(self) -> None:
        if self.base not in BASES:
            raise ValueError(f"there is no base {self.base!r}; choose {' or '.join(BASES)}")
        if self.modes > 1 and (self.loss.name != "coverage" or self.base != BASES[0]):
            raise ValueError("unions, of modes above 1, have the loss coverage and the base net")


class OccupancyModule(nn.Module):
    """H1, H2 and the decoder."""

    def __init__(self, config: SetConfig) -> None:
        super().__init__()
        self.config = config
        hidden = config.hidden
        self.features = nn.Linear(config.features, hidden)
        self.repeated = nn.GRU(hidden, hidden, batch_first=True)
        self.trajectory = nn.Linear(TRAJECTORY_INPUTS, hidden)
        self.travelled = nn.GRU(hidden, hidden, batch_first=True)
        self.decoder = nn.Sequential(
            nn.Linear(2 * hidden, hidden), nn.ReLU(), nn.Linear(hidden, OUTPUTS)
        )

    def forward(
        self, features: Tensor, trajectory: Tensor, velocity: Tensor, history: Tensor
    ) -> Ellipses:
        """Makes the sets.

        Args:
            features: (B, features) H of the encoder.
            trajectory: (B, HORIZON, 2) predicted centres in the road user's frame, m.
            velocity: (B,) m/s.
            history: (B, HISTORY, 6) see ``dosplan_net.features.SceneFeatures``.

        Returns:
            Ellipses at ``shapes.grid_steps()``.
        """
        steps = grid_steps()
        path = trajectory[:, steps]
        seconds = grid_seconds(path).expand(path.shape[:2])[..., None]
        straight = constant_velocity(velocity)[:, steps]
        pace = legs(path)
        speed = (velocity[:, None, None] / VELOCITY_UNIT).expand_as(seconds)
        inputs = torch.cat(
            [path / DISTANCE_UNIT, (path - straight) / 10.0, pace / 4.0, seconds / 4.0, speed], -1
        )
        own = functional.relu(self.features(features))[:, None].expand(-1, len(steps), -1)
        first, _ = self.repeated(own)
        second, _ = self.travelled(functional.relu(self.trajectory(inputs)))
        raw = self.decoder(torch.cat([first, second], -1))
        return ellipses(self.config.variant, raw, path, history)


class UnionModule(nn.Module):
    """Features H, motion and M trajectories with their weights in, M ellipses each step out.

    Without GRUs: all steps of a trajectory are read and all steps of its ellipse are made at once.
    Each ellipse is told of the others through what is largest over all of them.
    """

    def __init__(self, config: SetConfig) -> None:
        super().__init__()
        self.config = config
        hidden, steps = config.hidden, len(grid_steps())
        outputs = OUTPUTS + 2 * config.shifted
        self.known = nn.Linear(config.features + MOTION_SIZE + 1, hidden)
        self.course = nn.Linear(4 * steps + 1 + hidden, hidden)
        self.alone = nn.Linear(hidden, hidden)
        self.together = nn.Linear(2 * hidden, hidden)
        self.dropout = nn.Dropout(config.dropout)
        self.out = nn.Linear(hidden, steps * outputs)

    def forward(
        self,
        features: Tensor,
        trajectory: Tensor,
        log_weight: Tensor,
        velocity: Tensor,
        history: Tensor,
    ) -> Unions:
        """Makes the sets.

        Args:
            features: (B, features) H of the encoder.
            trajectory: (B, M, HORIZON, 2) predicted centres in the road user's frame, m.
            log_weight: (B, M) logarithms of how likely they are.
            velocity: (B,) m/s.
            history: (B, HISTORY, 6) see ``dosplan_net.features.SceneFeatures``.

        Returns:
            Unions at ``shapes.grid_steps()``.
        """
        steps, modes = grid_steps(), trajectory.shape[1]
        path = trajectory[:, :, steps]
        straight = constant_velocity(velocity)[:, None, steps]
        told = [self.dropout(features), motion(history), velocity[:, None] / VELOCITY_UNIT]
        known = functional.relu(self.known(torch.cat(told, -1)))
        seconds = grid_seconds(path)[:, None]
        middle = (log_weight.exp()[:, :, None, None] * path).sum(1, keepdim=True)
        against = [(path - straight) / (2.0 + 2.0 * seconds), (path - middle) / (0.5 + seconds)]
        told = [
            torch.cat(against, -1).flatten(2),
            log_weight.clamp(min=-6.0)[..., None] / 2.0,
            known[:, None].expand(-1, modes, -1),
        ]
        read = functional.relu(self.course(torch.cat(told, -1)))
        own = functional.relu(self.alone(self.dropout(read)))
        others = own.amax(1, keepdim=True).expand(-1, modes, -1)
        made = functional.relu(self.together(self.dropout(torch.cat([own, others], -1))))
        raw = self.out(made).view(-1, len(steps), self.out.out_features // len(steps))
        flat = path.flatten(0, 1)
        past = history[:, None].expand(-1, modes, -1, -1).flatten(0, 1)
        sets = ellipses(self.config.variant, raw, flat, past)
        centre = flat
        if self.config.shifted:
            cosine, sine = half_angle(sets.double_angle)
            a, b = (torch.tanh(raw[..., OUTPUTS:]) * sets.semi_axes).unbind(-1)
            centre = flat + torch.stack([a * cosine - b * sine, a * sine + b * cosine], -1)
        shape = (-1, modes, len(steps), 2)
        return Unions(sets.semi_axes.view(shape), sets.double_angle.view(shape), centre.view(shape))
