"""What a traffic light ahead changes of a trajectory.

It is added to the trajectory of a network that is trained already and stays as it is: where no
light is ahead nothing is added, and the network's weights and its features H are the same with and
without lights.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn

from dosplan_net.features import HORIZON
from dosplan_net.lights import COLOUR_SIZE, LIGHT_SIZE
from dosplan_net.network import DISTANCE_UNIT, VELOCITY_UNIT, grown
from dosplan_net.weights import WeightsError, load_model, load_weights, save_weights

MODEL: Final = "light-response"
"""The kind of model that a weight file of a response names."""


@dataclass(frozen=True)
class LightConfig:
    """Sizes of the response.

    Attributes:
        hidden: Width of its two layers.
        dropout: Share of them that is set to zero in training.
        features: Width of the network's features H.
        modes: Number M of trajectories of the network; each is answered by itself.
        use_light: Whether it is told anything of the light but that one is ahead.
    """

    hidden: int = 128
    dropout: float = 0.1
    features: int = 128
    modes: int = 1
    use_light: bool = True


class LightResponse(nn.Module):
    """Reads the light, the features H and the trajectory; what it adds begins as zero."""

    def __init__(self, config: LightConfig = LightConfig()) -> None:
        super().__init__()
        self.config = c = config
        last = nn.Linear(c.hidden, 2 * HORIZON)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(
            nn.Linear(c.features + 2 * HORIZON + 1 + LIGHT_SIZE, c.hidden),
            nn.ReLU(),
            nn.Dropout(c.dropout),
            nn.Linear(c.hidden, c.hidden),
            nn.ReLU(),
            nn.Dropout(c.dropout),
            last,
        )

    def forward(
        self, features: Tensor, trajectory: Tensor, velocity: Tensor, lights: Tensor
    ) -> Tensor:
        """(N, features), (N, M, HORIZON, 2) m, (N,) m/s, (N, LIGHT_SIZE) -> as the trajectories."""
        told = [
            features,
            trajectory.flatten(2) / DISTANCE_UNIT,
            velocity[:, None] / VELOCITY_UNIT,
            lights * float(self.config.use_light),
        ]
        modes = trajectory.shape[1]
        read = [part if part.dim() == 3 else part[:, None].expand(-1, modes, -1) for part in told]
        ahead = lights[:, :COLOUR_SIZE].sum(-1)
        added = grown(self.layers(torch.cat(read, -1)).flatten(0, 1)).view_as(trajectory)
        return trajectory + added * ahead[:, None, None, None]


def save_response(
    path: Path, response: LightResponse, network: Path, figures: Mapping[str, float], **more: Any
) -> None:
    """Writes a response's weights.

    Args:
        path: The file.
        response: The response.
        network: Weights of the network that it was trained on.
        figures: Those of its validation.
        more: Other values that JSON can hold and that belong to the weights.

    Raises:
        OSError: The network's weights cannot be read.
    """
    about = {
        "model": MODEL,
        "response": asdict(response.config),
        "network_sha256": sha256(network.read_bytes()).hexdigest(),
        "validation": dict(figures),
        **more,
    }
    save_weights(path, response.state_dict(), about)


def load_response(path: Path, network: Path) -> LightResponse:
    """Builds a response from its weights.

    Args:
        path: The weights.
        network: Weights of the network that it is to be used with.

    Returns:
        The response, ready to be used.

    Raises:
        OSError: The network's weights cannot be read.
        WeightsError: The file is not such weights, or was trained on another network.
    """
    trained_on = load_weights(path, MODEL)[1].get("network_sha256")
    if trained_on != sha256(network.read_bytes()).hexdigest():
        raise WeightsError(
            f"{path}: was not trained on the network {network.name}; "
            "train it again with dosplan train lights, or remove it"
        )
    return load_model(path, MODEL, lambda about: LightResponse(LightConfig(**about["response"])))
