"""The road kinds of the suite, each drawn at random from its family.

Widths, radii and limits follow German practice (RASt 06, RAA 2008): 3.0 to 3.5 m lanes in town,
3.5 to 3.75 m on motorways, kerb radii of 6 to 12 m.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from .crossings import (
    cycle_crossing,
    plain_crossing,
    roundabout,
    signalised_crossing,
    t_junction,
)
from .motorways import lane_drop, on_ramp, weaving
from .roads import Rng, Road
from .streets import arterial, grid, narrow_street, pedestrian_crossing

Builder = Callable[[Rng, float], Road]
"""Draws a road from a generator for its geometry and a demand factor (1 is dense traffic)."""

ROAD_KINDS: Mapping[str, tuple[str, Builder]] = MappingProxyType(
    {
        "Signal": ("signalised crossing", signalised_crossing),
        "OnRamp": ("on-ramp merge", on_ramp),
        "Roundabout": ("roundabout", roundabout),
        "TJunction": ("T-junction", t_junction),
        "LaneDrop": ("lane drop", lane_drop),
        "Zebra": ("pedestrian crossing", pedestrian_crossing),
        "Arterial": ("urban arterial", arterial),
        "Crossing": ("crossing without signals", plain_crossing),
        "Weaving": ("motorway with weaving section", weaving),
        "CycleLane": ("crossing with cycle lanes", cycle_crossing),
        "Grid": ("urban grid", grid),
        "Parked": ("narrow street with parked cars", narrow_street),
    }
)
