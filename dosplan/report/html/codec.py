"""Compresses numbers for a page: whole multiples of a grain, then differences, then gzip.

Smooth motion has small second differences, and gzip stores small numbers that repeat in a few
bits each. ``static/codec.js`` decodes them.
"""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any, Final

import numpy as np
import numpy.typing as npt

METRE: Final = 0.05
"""Grain of a position, m: less than a pixel at the player's usual scale."""

AXIS: Final = 0.1
"""Grain of a semi-axis, m."""

RADIAN: Final = 0.02
"""Grain of an angle, rad: about one degree."""

SPEED: Final = 0.1
"""Grain of a velocity, m/s."""


def differences(values: npt.ArrayLike, grain: float, order: int) -> list[int]:
    """Writes a series as whole multiples of a grain, then as differences.

    Args:
        values: (K,) finite numbers.
        grain: Value of a unit.
        order: How often neighbours are subtracted; the first of each round stays as it is, so
            that as many cumulative sums give the multiples back.

    Returns:
        K integers.
    """
    whole = np.rint(np.asarray(values, dtype=np.float64) / grain).astype(np.int64)
    for _ in range(order):
        whole = np.diff(whole, prepend=0)
    return [int(value) for value in whole]


def polyline(points: npt.ArrayLike) -> list[int]:
    """Writes a line as ``x, y`` of its first point and the steps to each further one.

    Args:
        points: (P, 2) relative to the episode's origin, m.

    Returns:
        2 P integers; points that fall together are written once.
    """
    whole = np.rint(np.asarray(points, dtype=np.float64) / METRE).astype(np.int64)
    moved = np.any(np.diff(whole, axis=0) != 0, axis=1)
    kept = whole[np.concatenate([[True], moved])]
    return [int(value) for value in np.diff(kept, axis=0, prepend=[[0, 0]]).ravel()]


def pack(payload: Any) -> str:
    """Packs what the browser is to unpack.

    Args:
        payload: What JSON can hold.

    Returns:
        Base64 of gzip of JSON; the same for the same payload.
    """
    text = json.dumps(payload, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(gzip.compress(text.encode(), compresslevel=9, mtime=0)).decode()
