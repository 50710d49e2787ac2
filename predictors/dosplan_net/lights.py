"""What the network is told of the traffic light that a road user has ahead.

For how long a light has shown its colour is told up to ``MEMORY`` only. That is what a driver goes
by: whether it has just changed. Lights of one town, and those of a simulation all the more, change
after times that are always the same; a network that sees the whole time learns these.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from dosplan.geometry import LightIndex
from dosplan.types import (
    COLOURS,
    USER_VELOCITY,
    BoolArray,
    LightColour,
    Observation,
    RoadMap,
    RoadUserKind,
)
from dosplan_net.features import Float32Array

REACH: Final = 80.0  # m ahead at which a light is seen: four seconds of driving and some.
LIGHT_SIZE: Final = 6  # red, yellow, green; distance, time since the change, braking to stop there
COLOUR_SIZE: Final = 3
DISTANCE: Final = 20.0  # m, the unit of the distance
MEMORY: Final = 5.0  # s
BRAKING: Final = 5.0  # m/s2, the unit of the braking
MOST_BRAKING: Final = 2.0  # units
NEAR: Final = 0.5  # m; who is nearer to the line is taken to be so far from it.

_COLUMN: Final = np.array(
    [
        {LightColour.GREEN: 2, LightColour.YELLOW: 1}.get(colour, 0 if colour.forbids else -1)
        for colour in COLOURS
    ]
    + [-1]  # ``NO_LIGHT``, which is -1, counts from the end.
)


def describe_lights(observation: Observation, index: LightIndex) -> Float32Array:
    """Describes the light ahead of each road user.

    Args:
        observation: What is known now.
        index: The lights of its map.

    Returns:
        (N, LIGHT_SIZE): which colour is lit (red with yellow is red), the distance of the front
        to the line, for how long the colour has been shown, and how hard the road user would have
        to brake to stop at the line; each in its unit. Zeros where no lit light is ahead, and for
        pedestrians.
    """
    now = observation.states[:, -1]
    ahead = index.ahead(now, observation.size, observation.lights)
    column = _COLUMN[ahead.colour]
    walks = np.array([kind is RoadUserKind.PEDESTRIAN for kind in observation.kinds], dtype=bool)
    rows = np.flatnonzero((column >= 0) & ~walks)
    found = np.zeros((len(now), LIGHT_SIZE), dtype=np.float32)
    distance, speed = ahead.distance[rows], np.maximum(now[rows, USER_VELOCITY], 0.0)
    needed = speed**2 / (2.0 * np.maximum(distance, NEAR)) / BRAKING
    found[rows, column[rows]] = 1.0
    found[rows, COLOUR_SIZE] = distance / DISTANCE
    found[rows, COLOUR_SIZE + 1] = np.minimum(ahead.seconds[rows], MEMORY) / MEMORY
    found[rows, COLOUR_SIZE + 2] = np.minimum(needed, MOST_BRAKING)
    return found


def find_lights(road_map: RoadMap) -> LightIndex | None:
    """Finds where lights hold on a map.

    Args:
        road_map: The map.

    Returns:
        Its lights; None where it has none.
    """
    return LightIndex(road_map, REACH) if road_map.lights else None


def lit(lights: Float32Array) -> BoolArray:
    """(N,) who has a lit light ahead, of (N, LIGHT_SIZE) lights."""
    return np.asarray(lights[:, :COLOUR_SIZE].any(axis=1))
