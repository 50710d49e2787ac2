"""Thumbnails: the road and the driven paths of a scenario in a box of a few whole units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import shapely

from dosplan.geometry import areas
from dosplan.results.drive import Drive
from dosplan.types import FloatArray, Scenario

WIDTH: Final = 96
HEIGHT: Final = 56
_INSET: Final = 8.0
_POINTS: Final = 16
_LEAST_METRES: Final = 20.0  # Smallest view, so that a standing ego is not magnified.


def thumbnail(scene: Scenario | None, drives: Sequence[Drive | None]) -> dict[str, Any]:
    """Draws a thumbnail.

    Args:
        scene: The scenario, or None: then there is no road.
        drives: The drive of each side; None where it has none.

    Returns:
        ``road``, the data of an SVG path, and ``drives``: for each side the ``points`` of an SVG
        polyline, or None.
    """
    driven = [drive.ego[:, :2] for drive in drives if drive is not None]
    if not driven:
        return {"road": "", "drives": [None] * len(drives)}
    points = np.concatenate(driven)
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.array([WIDTH, HEIGHT]) - 2.0 * _INSET
    scale = float(np.min(room / np.maximum(high - low, _LEAST_METRES)))
    middle = 0.5 * (low + high)
    return {
        "road": "" if scene is None else _road(scene, middle, scale),
        "drives": [
            None if drive is None else _text(_thin(_placed(drive.ego[:, :2], middle, scale)))
            for drive in drives
        ],
    }


def _placed(points: FloatArray, middle: FloatArray, scale: float) -> FloatArray:
    """Scenario frame to box, whose y axis points down."""
    return (points - middle) * scale * (1.0, -1.0) + np.array([WIDTH, HEIGHT]) / 2.0


def _road(scene: Scenario, middle: FloatArray, scale: float) -> str:
    reach = np.array([WIDTH, HEIGHT]) / 2.0 / scale
    box = shapely.box(*(middle - reach), *(middle + reach))
    clipped = shapely.intersection(scene.road_map.drivable, box)
    shape = areas(shapely.simplify(clipped, 1.0 / scale))  # Within a unit of the box.
    rings = [
        np.asarray(ring.coords)
        for polygon in shapely.get_parts(shape)
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    return "".join(f"M{_text(_placed(ring, middle, scale))}Z" for ring in rings)


def _thin(points: FloatArray) -> FloatArray:
    kept = np.unique(np.linspace(0, len(points) - 1, _POINTS).round().astype(int))
    return np.asarray(points[kept])


def _text(points: FloatArray) -> str:
    return " ".join(f"{x:.0f},{y:.0f}" for x, y in points)
