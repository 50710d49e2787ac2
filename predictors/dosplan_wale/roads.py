"""What Wale-Net's network makes of the road around road users, kept by pose.

Its layers for the road take most of the time, and look at the map and a pose alone: whoever stands
has one code, and whoever is replayed has the same ones in both arms and in every future that it is
in. A code does not depend on what was asked before, so results do not either.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from dosplan.types import FloatArray, RoadMap
from dosplan_wale.scene import Float32Array, RoadImages

_KEPT: Final = 100_000
"""Codes that are kept, some 30 MB."""


class RoadCodes:
    """Codes of the road around poses on a map."""

    def __init__(self, layers: nn.Module, radius: float) -> None:
        """Keeps the layers.

        Args:
            layers: (1, 1, 256, 256) image to (1, C, 1, 1) code.
            radius: Half the side of an image, m.
        """
        self._layers = layers
        self._radius = radius
        self._map = b""
        self._row: dict[bytes, int] = {}
        # One array, not one for each: they would lie between the layers' large outputs, whose
        # memory could not be used again.
        self._codes = np.empty((0, 0), dtype=np.float32)

    def read(self, road_map: RoadMap) -> None:
        """Reads a map; the codes of another one are forgotten.

        Args:
            road_map: The map.
        """
        self._images = RoadImages(road_map, self._radius)
        digest = sha256()
        for lanelet in road_map.lanelets:
            neighbours = (lanelet.left_neighbour is None, lanelet.right_neighbour is None)
            digest.update(repr((len(lanelet.left), neighbours)).encode())
            digest.update(lanelet.left.tobytes() + lanelet.right.tobytes())
        if digest.digest() != self._map:
            self._map = digest.digest()
            self._row.clear()

    def codes(self, position: FloatArray, rotation: FloatArray) -> Tensor:
        """Looks at the road around road users.

        Args:
            position: (B, 2) where they are, m.
            rotation: (B,) how far their images are turned against the scenario's frame, rad.

        Returns:
            (B, C, 1, 1) codes.
        """
        poses = np.column_stack([position, rotation])
        found = np.stack([self._code(pose) for pose in poses])
        return torch.from_numpy(found)[:, :, None, None]

    def _code(self, pose: FloatArray) -> Float32Array:
        key = pose.tobytes()
        if key not in self._row:
            image = self._images.draw(pose[:2], float(pose[2])).astype(np.float32)
            # One at a time: with more, the first layer's output, 8 MB each, exceeds the processor's
            # cache, and a code's last digits would depend on who else is new.
            code = self._layers(torch.from_numpy(image)[None, None]).numpy().ravel()
            if not len(self._codes):
                self._codes = np.empty((_KEPT, len(code)), dtype=np.float32)
            if len(self._row) == _KEPT:
                self._row.clear()
            self._codes[len(self._row)] = code
            self._row[key] = len(self._row)
        return np.array(self._codes[self._row[key]])
