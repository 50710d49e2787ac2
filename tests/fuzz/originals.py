"""Real CommonRoad files that the cases damage."""

from __future__ import annotations

import gzip
import os
import random
from pathlib import Path
from typing import Final

from tests.support.suite import SUITE

OURS: Final = (
    "ZAM_Parked-1_1_T-1",
    "ZAM_Parked-4_1_T-1",
    "ZAM_TJunction-3_2_T-1",
    "ZAM_Crossing-6_1_T-1",
    "ZAM_Zebra-1_1_T-1",
    "ZAM_CycleLane-1_1_T-1",
)
"""Scenarios of the suite, of several kinds of road."""
_RECORDED: Final = 6  # Small recorded files that are used where they are at hand.


def _originals() -> tuple[bytes, ...]:
    data = os.environ.get("DOSPLAN_DATA")
    recorded = list(Path(data, "commonroad", "val").glob("*.xml")) if data else []
    recorded.sort(key=lambda path: (path.stat().st_size, path.name))
    ours = (SUITE / "files" / f"{name}.xml.gz" for name in OURS)
    return (
        *(gzip.decompress(path.read_bytes()) for path in ours),
        *(path.read_bytes() for path in recorded[:_RECORDED]),
    )


# Read once and early, so that the cases themselves open nothing but their own files.
ORIGINALS: Final = _originals()
"""The XML of some small files: those of the suite first, then the recorded ones."""


def original(rng: random.Random) -> bytes:
    """The XML of a file."""
    return rng.choice(ORIGINALS)
