"""Groups of windows: kinds, speeds, lights ahead, families, and families by speed.

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

from dosplan.types import COLOURS, BoolArray, IntArray, LightColour, RoadUserKind

MOVING: Final = 0.3  # m/s; slower road users count as standing.
SPEED_EDGES: Final = (0.0, MOVING, 4.0, 8.0, 16.0, np.inf)  # m/s
SPEED_BINS: Final = ("<0.3 m/s", "0.3-4 m/s", "4-8 m/s", "8-16 m/s", ">=16 m/s")
KINDS: Final = tuple(kind for kind in RoadUserKind if kind.moves)  # The others are not predicted.
SIMULATED: Final = "simulated"  # The tag, and the family that it makes.
LIGHTS: Final = ("red light", "yellow light", "green light")
"""What the light within 50 m ahead on the road user's lane shows; red with yellow is red."""
NO_LIGHT: Final = "no light"  # None is ahead, or none is lit.
CELL_WINDOWS: Final = 500  # Fewer windows than this make no cell of family and speed.

_NAMES: Final = {
    LightColour.RED: 0, LightColour.RED_YELLOW: 0, LightColour.YELLOW: 1, LightColour.GREEN: 2
}  # fmt: skip
_OF_COLOUR: Final = np.array(
    [*(_NAMES.get(colour, -1) for colour in COLOURS), -1],  # The last is found by ``NO_LIGHT``.
    dtype=np.int8,
)
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
    light: npt.NDArray[np.int8],
    family: Sequence[str],
    scenario: IntArray,
) -> dict[str, IntArray]:
    """Sorts windows into groups; a window is in several.

    Args:
        kind: (W,) index into ``KINDS``.
        speed: (W,) present speed, m/s, >= 0.
        light: (W,) index into ``LIGHTS``; -1 where none of these is ahead.
        family: Family of each scenario.
        scenario: (W,) index of the scenario.

    Returns:
        Indices of the windows of each group that has any: ``all``, ``moving``, kinds, speed
        bins, lights and ``no light`` where there are lights at all, families, then cells
        ``family, speed bin`` of ``CELL_WINDOWS`` windows or more.
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
    lights = {name: light == i for i, name in enumerate(LIGHTS)}
    if np.any(light >= 0):
        lights[NO_LIGHT] = light < 0
    main = {"all": everything, "moving": speed >= MOVING, **kinds, **bins, **lights, **families}
    return {**_indices(main.items(), 1), **_indices(cells.items(), CELL_WINDOWS)}


def lights_of(colour: IntArray) -> npt.NDArray[np.int8]:
    """Sorts road users by the light ahead of them.

    Args:
        colour: (N,) as of ``dosplan.geometry.LightsAhead``.

    Returns:
        (N,) index into ``LIGHTS``; -1 where none of these is ahead.
    """
    return np.asarray(_OF_COLOUR[colour])


def _indices(masks: Iterable[tuple[str, BoolArray]], at_least: int) -> dict[str, IntArray]:
    found = {name: np.flatnonzero(mask) for name, mask in masks}
    return {name: indices for name, indices in found.items() if len(indices) >= at_least}
