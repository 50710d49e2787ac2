"""Groups of windows: kinds, speeds, families, and families by speed.

A *family* is where a recording comes from. It follows from the scenario alone: the tag
``simulated`` makes it ``simulated``; otherwise it is the location in the benchmark id
(``USA_US101`` of ``USA_US101-3_2_T-1``, a leading ``C-`` aside); an id without one makes ``other``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from dosplan.types import BoolArray, IntArray, RoadUserKind

MOVING: Final = 0.3  # m/s; slower road users count as standing.
SPEED_EDGES: Final = (0.0, MOVING, 4.0, 8.0, 16.0, np.inf)  # m/s
SPEED_BINS: Final = ("<0.3 m/s", "0.3-4 m/s", "4-8 m/s", "8-16 m/s", ">=16 m/s")
KINDS: Final = tuple(kind for kind in RoadUserKind if kind.moves)  # The others are not predicted.
SIMULATED: Final = "simulated"  # The tag, and the family that it makes.
CELL_WINDOWS: Final = 500  # Fewer windows than this make no cell of family and speed.

_LOCATION: Final = re.compile(r"(?:C-)?([A-Z]{3}_[A-Za-z0-9]+)-")


def family_of(benchmark_id: str, tags: frozenset[str]) -> str:
    """Names a scenario's family.

    Args:
        benchmark_id: CommonRoad scenario id.
        tags: The scenario's tags.

    Returns:
        ``simulated``, a location or ``other``.
    """
    if SIMULATED in tags:
        return SIMULATED
    location = _LOCATION.match(benchmark_id)
    return location[1] if location else "other"


def group_windows(
    kind: npt.NDArray[np.int8],
    speed: npt.NDArray[np.float32],
    family: Sequence[str],
    scenario: IntArray,
) -> dict[str, IntArray]:
    """Sorts windows into groups; a window is in several.

    Args:
        kind: (W,) index into ``KINDS``.
        speed: (W,) present speed, m/s, >= 0.
        family: Family of each scenario.
        scenario: (W,) index of the scenario.

    Returns:
        Indices of the windows of each group that has any: ``all``, ``moving``, kinds, speed
        bins, families, then cells ``family, speed bin`` of ``CELL_WINDOWS`` windows or more.
    """
    everything = np.ones(len(speed), dtype=np.bool_)
    kinds = {k.value: kind == i for i, k in enumerate(KINDS)}
    bins = {
        name: (speed >= low) & (speed < high)
        for name, (low, high) in zip(SPEED_BINS, pairwise(SPEED_EDGES), strict=True)
    }
    names = np.array(family, dtype=np.str_)[scenario]
    families = {str(name): names == name for name in np.unique(names)}
    cells = {
        f"{place}, {name}": here & fast
        for place, here in families.items()
        for name, fast in bins.items()
    }
    main = {"all": everything, "moving": speed >= MOVING, **kinds, **bins, **families}
    return {**_indices(main.items(), 1), **_indices(cells.items(), CELL_WINDOWS)}


def _indices(masks: Iterable[tuple[str, BoolArray]], at_least: int) -> dict[str, IntArray]:
    found = {name: np.flatnonzero(mask) for name, mask in masks}
    return {name: indices for name, indices in found.items() if len(indices) >= at_least}
