"""What traffic lights show: at one step, and over an episode."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np

from dosplan.types.arrays import FloatArray, IntArray, ShapeError, frozen


class LightColour(StrEnum):
    """What a traffic light shows, in the words of CommonRoad."""

    RED = "red"
    YELLOW = "yellow"
    RED_YELLOW = "redYellow"
    GREEN = "green"
    INACTIVE = "inactive"

    @property
    def forbids(self) -> bool:
        """Whether nobody may enter: red, and red with yellow, which announces green."""
        return self in (LightColour.RED, LightColour.RED_YELLOW)


COLOURS: Final = tuple(LightColour)
"""The colours by their number in ``Signals.colours``."""


def _no_ids() -> IntArray:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class LightStates:
    """What every traffic light shows at one step. What it shows next cannot be reached from it.

    Attributes:
        ids: (L,) ids of the lights, those of ``RoadMap.lights``.
        colours: L colours.
        since: (L,) for how long each has shown its colour, s. A light is not known before step 0
            where a file records only what it showed from there on; time counts from step 0 then.
    """

    ids: IntArray = field(default_factory=_no_ids)
    colours: tuple[LightColour, ...] = ()
    since: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        frozen(self, "ids", np.int64, (None,))
        frozen(self, "since", np.float64, (len(self.ids),), finite=True)
        if len(self.colours) != len(self.ids):
            raise ShapeError(
                f"LightStates.colours has {len(self.colours)} entries, expected {len(self.ids)}"
            )
        if len(np.unique(self.ids)) != len(self.ids):
            raise ShapeError("LightStates.ids names a light twice")

    def colour(self, light: int) -> LightColour:
        """What a light shows.

        Args:
            light: Its id.

        Returns:
            The colour; ``INACTIVE`` for a light that is not known.
        """
        found = np.flatnonzero(self.ids == light)
        return self.colours[found[0]] if found.size else LightColour.INACTIVE

    def shown(self, lights: Iterable[int]) -> LightColour:
        """What lights show together, such as those of a ``RouteStop``.

        Args:
            lights: Their ids.

        Returns:
            The strictest: red before red with yellow before yellow before green; ``INACTIVE``
            where none is lit. One green arrow among lights for several ways is no green.
        """
        shown = {self.colour(light) for light in lights}
        return next((colour for colour in _STRICTEST_FIRST if colour in shown), _UNLIT)

    def seconds(self, light: int) -> float:
        """For how long a light has shown its colour.

        Args:
            light: Its id.

        Returns:
            s; zero for a light that is not known.
        """
        found = np.flatnonzero(self.ids == light)
        return float(self.since[found[0]]) if found.size else 0.0


_UNLIT: Final = LightColour.INACTIVE
_STRICTEST_FIRST: Final = (
    LightColour.RED,
    LightColour.RED_YELLOW,
    LightColour.YELLOW,
    LightColour.GREEN,
)


@dataclass(frozen=True)
class Signals:
    """Traffic lights over many steps, as they were recorded or as they were in an episode.

    It holds the future: only the simulation and the analysis of a finished episode may use it.

    Attributes:
        ids: (L,) ids of the lights, unique.
        colours: (L, K) number of the colour, an index of ``COLOURS``, at steps 0 .. K-1. The last
            holds for all later steps.
        since: (L, K) for how long it has been shown, s.
    """

    ids: IntArray = field(default_factory=_no_ids)
    colours: IntArray = field(default_factory=lambda: np.empty((0, 1), dtype=np.int64))
    since: FloatArray = field(default_factory=lambda: np.empty((0, 1)))

    def __post_init__(self) -> None:
        frozen(self, "ids", np.int64, (None,))
        frozen(self, "colours", np.int64, (len(self.ids), None))
        frozen(self, "since", np.float64, self.colours.shape, finite=True)
        if len(np.unique(self.ids)) != len(self.ids):
            raise ShapeError("Signals.ids names a light twice")
        if self.colours.shape[1] == 0:
            raise ShapeError("Signals.colours has no step; it needs one at least")
        if np.any((self.colours < 0) | (self.colours >= len(COLOURS))):
            raise ShapeError("Signals.colours holds a number that is no colour's")

    def at(self, step: int) -> LightStates:
        """What the lights show at a step.

        Args:
            step: The step, >= 0.

        Returns:
            Their colours, and since when.
        """
        k = min(step, self.colours.shape[1] - 1)
        return LightStates(
            ids=self.ids,
            colours=tuple(COLOURS[number] for number in self.colours[:, k]),
            since=self.since[:, k],
        )
