"""Makes a network: an untrained one of given sizes, or the one that a weight file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dosplan_net.modal import ModalNetwork
from dosplan_net.network import MODAL, NetworkConfig, RecurrentNetwork, TrajectoryNetwork
from dosplan_net.raster import RasterNetwork
from dosplan_net.weights import load_model

MODEL: Final = "trajectory-network"
"""The kind of model that a weight file of a network names."""
_NETWORKS: Final[dict[str, type[TrajectoryNetwork]]] = {
    "polylines": RecurrentNetwork,
    "raster": RasterNetwork,
}


def load_network(path: Path) -> TrajectoryNetwork:
    """Builds a network from its weights.

    Args:
        path: The weights.

    Returns:
        The network, ready to be used.

    Raises:
        WeightsError: The file is not such weights.
    """
    return load_model(path, MODEL, lambda about: build_network(NetworkConfig(**about["network"])))


def build_network(config: NetworkConfig) -> TrajectoryNetwork:
    """Builds an untrained network.

    Args:
        config: Its sizes, its architecture and its map encoder.

    Returns:
        The network.
    """
    if config.architecture == MODAL:
        return ModalNetwork(config)
    return _NETWORKS[config.map_encoder](config)
