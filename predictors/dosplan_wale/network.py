"""Wale-Net's network, with the weights and the configuration that its package ships."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from torch import nn

from dosplan_wale import INSTALL

try:
    from prediction.utils.model import predictionNet
except ImportError as error:
    raise ImportError(f"{error}; {INSTALL}") from error


def shipped(name: str) -> Path:
    """A file of Wale-Net's package.

    Args:
        name: Its path there.

    Returns:
        The file.
    """
    return Path(str(resources.files("prediction") / name))


def shipped_weights() -> Path:
    """The weights that ``WaleNet`` uses by default.

    Returns:
        The file.
    """
    return shipped("trained_models/best_model.tar")


def read_config() -> dict[str, Any]:
    """The configuration that these weights belong to.

    Returns:
        Wale-Net's arguments: without a graphics card and without learning while it drives, as
        in its ``configs/online/default.json``.
    """
    config = json.loads(shipped("configs/best_config.json").read_text(encoding="utf-8"))
    return {**config, "use_cuda": False, "on_pred_learn_method": None, "online_layer": None}


@dataclass(frozen=True)
class Network:
    """Wale-Net, with the layers that read the image apart: they look at nothing else.

    Attributes:
        road: (B, 1, 256, 256) images of the road to their codes, (B, C, 1, 1).
        rest: Past, (H, B, 2), neighbours, (H, 39 B, 2), and codes to (T, B, 5) Gaussians.
    """

    road: nn.Module
    rest: nn.Module


def open_network(config: dict[str, Any], weights: Path) -> Network:
    """Builds the network.

    The weights are a pickle, which can run code; torch's reader for tensors alone is used.

    Args:
        config: Wale-Net's arguments.
        weights: The file.

    Returns:
        The network, for prediction only.

    Raises:
        ValueError: The file holds no such weights, or something else beside them.
    """
    with torch.random.fork_rng(devices=[]):  # The constructor sets the seed of the whole process.
        whole: nn.Module = predictionNet(config)
    try:
        whole.load_state_dict(torch.load(weights, map_location="cpu", weights_only=True))
    except (OSError, RuntimeError, TypeError, EOFError, pickle.UnpicklingError) as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(f"{weights}: not the weights of Wale-Net ({reason}); {INSTALL}") from None
    whole.eval().requires_grad_(False)
    parts = dict(whole.named_children())
    convolutions = [name for name in parts if name.startswith("sc_conv")]
    road = nn.Sequential(*(x for name in convolutions for x in (parts[name], parts["sc_maxpool"])))
    for name in (*convolutions, "sc_maxpool"):
        setattr(whole, name, nn.Identity())
    for weight in road.parameters():
        # With channels last, the convolutions, which take most of the time, are four times as
        # fast. ``contiguous`` would not change the strides of a single channel.
        if weight.ndim == 4:
            weight.data = weight.data.to(memory_format=torch.channels_last)
    return Network(road, whole)
