"""The occupancy-set module: features and a trajectory in, ellipses out.

After the paper: the features H, repeated over time, go through a GRU (H1); the predicted
trajectory goes through a linear layer and a GRU (H2); a decoder turns [H1, H2] into the ellipse.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from dosplan_net.network import DISTANCE_UNIT, VELOCITY_UNIT, constant_velocity
from torch import Tensor, nn
from torch.nn import functional

from dosplan_dos.losses import LossConfig
from dosplan_dos.shapes import Ellipses, Variant, ellipses, grid_seconds, grid_steps, legs

OUTPUTS = 4  # Two lengths, cosine and sine of the double angle.
TRAJECTORY_INPUTS = 8
CONSTANT_VELOCITY = "constant-velocity"
BASES = ("net", CONSTANT_VELOCITY)


@dataclass(frozen=True)
class SetConfig:
    """A module and how it is trained.

    Attributes:
        variant: The ellipses' representation.
        loss: What it is trained for.
        base: The trajectory predictor whose errors it has learned, by its name.
        features: Width of the features H.
        hidden: Width of the GRUs.
    """

    variant: Variant = Variant.FREE
    loss: LossConfig = field(default_factory=LossConfig)
    base: str = "net"
    features: int = 128
    hidden: int = 48

    def __post_init__(self) -> None:
        if self.base not in BASES:
            raise ValueError(f"there is no base {self.base!r}; choose {' or '.join(BASES)}")


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
        seconds = grid_seconds().expand(path.shape[:2])[..., None]
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
