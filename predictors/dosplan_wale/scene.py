"""Wale-Net's inputs for each road user: its past, its neighbours' and an image of the road.

All three are made by Wale-Net's own functions, in a frame with the road user at the origin and its
heading along y. What they read of a CommonRoad scenario is made of dosplan's map and observation.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Final

import numpy as np
import numpy.typing as npt

from dosplan.types import FloatArray, Lanelet, RoadMap
from dosplan_wale import INSTALL

try:
    from prediction.utils.geometry import transform_trajectories
    from prediction.utils.preprocessing import generate_nbr_array, generate_self_rendered_sc_img
except ImportError as error:
    raise ImportError(f"{error}; {INSTALL}") from error

Float32Array = npt.NDArray[np.float32]

# m; lanelets in opposite directions share a bound where its ends are no further apart than this;
# in recorded maps they do not meet exactly.
_SHARED: Final = 0.5


@dataclass(frozen=True)
class RoadLines:
    """What Wale-Net reads of a lanelet; the names are CommonRoad's.

    Attributes:
        left_vertices: (P, 2) left bound, m.
        right_vertices: (P, 2) right bound, m.
        adj_left: Lanelet beyond the left bound, in whichever direction, or None: that bound is
            the edge of the road, which is drawn brighter.
        adj_right: The same on the right.
    """

    left_vertices: FloatArray
    right_vertices: FloatArray
    adj_left: int | None = None
    adj_right: int | None = None


class RoadImages:
    """Draws the road around road users."""

    def __init__(self, road_map: RoadMap, radius: float) -> None:
        """Reads the map.

        Args:
            road_map: The map.
            radius: Half the side of an image, m.
        """
        self._radius = radius
        lanelets = road_map.lanelets
        facing_left = facing([lanelet.left for lanelet in lanelets])
        facing_right = facing([lanelet.right for lanelet in lanelets])
        self._lines = [
            _lines(lanelet, left, right)
            for lanelet, left, right in zip(lanelets, facing_left, facing_right, strict=True)
        ]
        bounds = [np.concatenate((lanelet.left, lanelet.right)) for lanelet in lanelets]
        self._points = np.concatenate((*bounds, np.zeros((0, 2))))
        self._owner = np.repeat(np.arange(len(bounds)), [len(points) for points in bounds])

    def draw(self, position: FloatArray, rotation: float) -> FloatArray:
        """Draws the bounds of the lanelets.

        Args:
            position: (2,) the middle of the image, m.
            rotation: How far the image is turned against the scenario's frame, rad.

        Returns:
            (256, 256) brightness, 0 to 255; black where there is no road.
        """
        # A line without a point inside the square would not be drawn; to leave it out saves most
        # of the time on a large map.
        distance = np.linalg.norm(self._points - position, axis=1)
        near = np.unique(self._owner[distance <= np.sqrt(2.0) * self._radius])
        # Wale-Net's function fails where no point is inside. One point alone makes no line.
        middle = RoadLines(position[None], position[None])
        lanelets = [middle, *(self._lines[lanelet] for lanelet in near)]
        scene = SimpleNamespace(lanelet_network=SimpleNamespace(lanelets=lanelets))
        image: FloatArray = generate_self_rendered_sc_img(self._radius, scene, position, rotation)
        return image


def facing(bounds: list[FloatArray]) -> list[bool]:
    """Which bounds are also a bound, on the same side, of a lanelet in the opposite direction.

    dosplan's map links neighbours in the same direction only.

    Args:
        bounds: The bounds of all lanelets on one side, (P, 2) each, m.

    Returns:
        For each whether another one has the same ends the other way round.
    """
    first = np.array([line[0] for line in bounds]).reshape(-1, 2)
    last = np.array([line[-1] for line in bounds]).reshape(-1, 2)
    gap = np.linalg.norm(first[:, None] - last, axis=-1)
    meets = np.maximum(gap, gap.T) < _SHARED
    np.fill_diagonal(meets, False)
    return [bool(found) for found in meets.any(axis=1)]


def _lines(lanelet: Lanelet, facing_left: bool, facing_right: bool) -> RoadLines:
    """The lines of a lanelet; Wale-Net only asks whether a neighbour's id is None."""
    left, right = lanelet.left_neighbour, lanelet.right_neighbour
    return RoadLines(
        lanelet.left,
        lanelet.right,
        lanelet.id if left is None and facing_left else left,
        lanelet.id if right is None and facing_right else right,
    )


@dataclass(frozen=True)
class Inputs:
    """What the network reads, for B road users.

    Attributes:
        history: (H, B, 2) own positions, the present one last; 0 where it was not on the scene.
        neighbours: (H, 39 B, 2) positions of a neighbour in each cell of a grid of 3 x 13 cells
            around each road user; 0 where there is none.
    """

    history: Float32Array
    neighbours: Float32Array


def describe(past: FloatArray, rotation: FloatArray) -> Inputs:
    """Makes the inputs of the network, but for the road.

    Args:
        past: (B, H, 2) positions of the road users, the present ones last, m; NaN where one was
            not on the scene.
        rotation: (B,) how far their frames are turned against the scenario's, rad.

    Returns:
        The inputs.
    """
    steps = past.shape[1]
    histories, neighbours = [], []
    for row, turn in enumerate(rotation.tolist()):
        (local,) = transform_trajectories([past], past[row, -1], turn)
        cells, *_ = generate_nbr_array(local, steps - 1, pp=steps)
        histories.append(local[row])
        neighbours.append(cells.reshape(-1, steps, 2))
    return Inputs(_by_step(np.stack(histories)), _by_step(np.concatenate(neighbours)))


def _by_step(positions: FloatArray) -> Float32Array:
    """(B, H, 2) as (H, B, 2), with 0 for NaN."""
    return np.nan_to_num(positions.swapaxes(0, 1)).astype(np.float32)
