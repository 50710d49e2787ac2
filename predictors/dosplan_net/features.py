"""The network's inputs for a scene; the same code makes them in training and in an episode.

Every road user is described in its own frame: origin at its centre now, x axis along its heading
now. The road is cut into short centre-line pieces once per map; each piece is described in its
own frame as well, so that its encoding can be kept for a whole episode, and only
the pose of a piece as a road user sees it changes from step to step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dosplan.geometry import to_body
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    FloatArray,
    IntArray,
    Lanelet,
    Observation,
    RoadMap,
    RoadUserKind,
)

Float32Array = npt.NDArray[np.float32]

HISTORY: Final = 31  # Steps of the past that are used, the present one included: 3 s.
HORIZON: Final = 40  # Steps that are predicted: 4 s.
NEIGHBOURS: Final = 16
NEIGHBOUR_RANGE: Final = 80.0  # m
PIECES: Final = 40
PIECE_POINTS: Final = 10
PIECE_LENGTH: Final = 20.0  # m; a lanelet is cut into equal pieces that are no longer than this.
PIECE_RANGE: Final = 60.0  # m from the stretch that the road user covers at its present speed.
LOOK_AHEAD: Final = 4.0  # s

HISTORY_SIZE: Final = 6  # x, y, cos and sin of the heading, velocity, valid
POSE_SIZE: Final = 4  # x, y, heading, velocity
PIECE_CHANNELS: Final = 3  # x, y, half width
PIECE_ATTRIBUTES: Final = 5  # length, for cars, neighbour left, neighbour right, speed limit

KINDS: Final = (
    RoadUserKind.CAR,
    RoadUserKind.TRUCK,
    RoadUserKind.BUS,
    RoadUserKind.MOTORCYCLE,
    RoadUserKind.BICYCLE,
    RoadUserKind.PEDESTRIAN,
)
STATIC_SIZE: Final = len(KINDS) + 3  # kind, length, width, share of the history that is known


@dataclass(frozen=True)
class MapPieces:
    """The road, cut into pieces.

    Attributes:
        shape: (P, PIECE_POINTS, 3) centre line in the piece's own frame and half width there, m.
        attributes: (P, PIECE_ATTRIBUTES) length / ``PIECE_LENGTH``, flags 0 or 1, speed limit in
            units of 30 m/s (0 where the map names none).
        pose: (P, 3) x, y, m, of the piece's point number PIECE_POINTS // 2, which is near its
            middle, and the piece's heading, rad, in the scenario's frame.
    """

    shape: Float32Array
    attributes: Float32Array
    pose: FloatArray


@dataclass(frozen=True)
class SceneFeatures:
    """The road users of one observation.

    Attributes:
        pose: (N, 4) x, y, m, heading, rad, and velocity, m/s, in the scenario's frame.
        history: (N, HISTORY, 6) x, y, m, cos and sin of the heading in the road user's frame,
            velocity, m/s, and whether it is known; zeros where it is not.
        static: (N, STATIC_SIZE) kind, size and how much of the history is known.
        neighbours: (N, NEIGHBOURS) rows of the nearest others, -1 for none.
        pieces: (N, PIECES) rows of the pieces nearest to where it is heading, -1 for none; nobody
            who cannot move has any.
    """

    pose: FloatArray
    history: Float32Array
    static: Float32Array
    neighbours: IntArray
    pieces: IntArray


def cut_map(road_map: RoadMap) -> MapPieces:
    """Cuts every lanelet of a map into pieces.

    Args:
        road_map: The map.

    Returns:
        The pieces.
    """
    shapes, attributes, poses = [], [], []
    for lanelet in road_map.lanelets:
        points, half_width, length = _sampled(lanelet)
        for piece, half in zip(points, half_width, strict=True):
            chord = piece[-1] - piece[0]
            heading = float(np.arctan2(chord[1], chord[0]))
            middle = piece[PIECE_POINTS // 2]
            local = to_body(piece, np.array([*middle, heading]))
            shapes.append(np.column_stack((local, half)))
            poses.append((*middle, heading))
            attributes.append(
                (
                    length / PIECE_LENGTH,
                    float(lanelet.for_cars),
                    float(lanelet.left_neighbour is not None),
                    float(lanelet.right_neighbour is not None),
                    (lanelet.speed_limit or 0.0) / 30.0,
                )
            )
    return MapPieces(
        shape=np.array(shapes, dtype=np.float32).reshape(-1, PIECE_POINTS, PIECE_CHANNELS),
        attributes=np.array(attributes, dtype=np.float32).reshape(-1, PIECE_ATTRIBUTES),
        pose=np.array(poses, dtype=np.float64).reshape(-1, 3),
    )


def describe(observation: Observation, pieces: MapPieces) -> SceneFeatures:
    """Describes every road user of an observation.

    Args:
        observation: What is known now.
        pieces: The map of its scenario.

    Returns:
        The features, a row for each of ``observation.ids``.
    """
    states, valid = observation.states[:, -HISTORY:], observation.valid[:, -HISTORY:]
    now = states[:, -1]
    pose = np.array(now)
    history = np.zeros((len(now), HISTORY, HISTORY_SIZE), dtype=np.float32)
    past = history[:, HISTORY - states.shape[1] :]
    turned = states[..., USER_HEADING] - now[:, None, USER_HEADING]
    past[..., :2] = to_body(states[..., :2], now[:, :3])
    past[..., 2] = np.cos(turned)
    past[..., 3] = np.sin(turned)
    past[..., 4] = states[..., USER_VELOCITY]
    past[..., 5] = 1.0
    past[~valid] = 0.0
    ahead = np.full((len(now), PIECES), -1, dtype=np.int64)
    ahead[observation.moves] = _pieces_ahead(pose[observation.moves], pieces.pose)
    return SceneFeatures(
        pose=pose,
        history=history,
        static=_static(observation.kinds, observation.size, history[..., 5].mean(axis=1)),
        neighbours=_nearest_others(pose),
        pieces=ahead,
    )


def kinds_of(static: npt.ArrayLike) -> list[RoadUserKind]:
    """Reads the kinds back from the features.

    Args:
        static: (N, STATIC_SIZE) see ``SceneFeatures``.

    Returns:
        N kinds; ``UNKNOWN`` for those that the network does not tell apart.
    """
    known = np.asarray(static)[:, : len(KINDS)]
    column = np.where(known.any(axis=1), known.argmax(axis=1), len(KINDS))
    return [(*KINDS, RoadUserKind.UNKNOWN)[index] for index in column]


def _sampled(lanelet: Lanelet) -> tuple[FloatArray, FloatArray, float]:
    """(C, PIECE_POINTS, 2) centre line and (C, PIECE_POINTS) half width of a lanelet's C pieces."""
    centre = lanelet.centre
    half_width = 0.5 * np.linalg.norm(lanelet.left - lanelet.right, axis=1)
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))))
    count = max(int(np.ceil(along[-1] / PIECE_LENGTH)), 1)
    ends = np.linspace(0.0, along[-1], count + 1)
    at = np.linspace(ends[:-1], ends[1:], PIECE_POINTS, axis=1)
    points = np.stack([np.interp(at, along, centre[:, axis]) for axis in (0, 1)], axis=-1)
    return points, np.interp(at, along, half_width), float(along[-1] / count)


def _static(kinds: Sequence[RoadUserKind], size: FloatArray, known: Float32Array) -> Float32Array:
    static = np.zeros((len(kinds), STATIC_SIZE), dtype=np.float32)
    for row, kind in enumerate(kinds):
        if kind in KINDS:
            static[row, KINDS.index(kind)] = 1.0
    static[:, -3] = size[:, 0] / 5.0
    static[:, -2] = size[:, 1] / 2.0
    static[:, -1] = known
    return static


def _nearest_others(pose: FloatArray) -> IntArray:
    """(N, NEIGHBOURS) rows of the nearest others within range, -1 for none."""
    gap = np.hypot(pose[:, None, 0] - pose[None, :, 0], pose[:, None, 1] - pose[None, :, 1])
    np.fill_diagonal(gap, np.inf)
    return _smallest(gap, NEIGHBOURS, NEIGHBOUR_RANGE)


def _pieces_ahead(pose: FloatArray, pieces: FloatArray) -> IntArray:
    """(N, PIECES) rows of the pieces nearest to the stretch ahead of each road user."""
    ahead, aside = np.moveaxis(to_body(pieces[None, :, :2], pose[:, :3]), -1, 0)
    reach = np.maximum(pose[:, 3, None], 0.0) * LOOK_AHEAD
    return _smallest(np.hypot(ahead - np.clip(ahead, 0.0, reach), aside), PIECES, PIECE_RANGE)


def _smallest(distance: FloatArray, count: int, limit: float) -> IntArray:
    """(N, count) columns of each row's smallest entries below ``limit``, -1 for none."""
    rows, columns = distance.shape
    found = np.full((rows, count), -1, dtype=np.int64)
    taken = min(count, columns)
    if taken == 0:
        return found
    chosen = np.argpartition(distance, taken - 1, axis=1)[:, :taken]
    near = np.take_along_axis(distance, chosen, axis=1)
    found[:, :taken] = np.where(near < limit, chosen, -1)
    return found
