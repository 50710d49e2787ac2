"""The paper's figures, drawn from published results: each a module with a function ``draw``.

Only names are here, so that listing them imports no matplotlib.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

FIGURES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "upper-limits": "the least area that a set of each shape can have",
        "trade-off": "coverage over area of every method, each parameter as a curve",
        "representations": "the sets of each representation, and of PR, in one scene",
        "coverage-by-speed": "coverage by the speed of the road user",
        "calibration": "the coverage that is reached over the one that was asked for",
        "planning": "outcomes and velocity of both arms, with intervals",
        "cycle-time": "the planning cycle over road users, horizon and map",
    }
)
"""What each figure shows, by its name; ``trade-off`` is drawn by the module ``trade_off``."""
FRONTIER: Final = "frontier"
"""A figure of runs, which are named with it."""
