"""Where real CommonRoad files are found, for the tests that need them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def commonroad_root() -> Path:
    """The folder ``commonroad`` of the data; skips the test where ``DOSPLAN_DATA`` is unset."""
    data = os.environ.get("DOSPLAN_DATA")
    if not data:
        pytest.skip("set DOSPLAN_DATA to the folder that holds commonroad/ to run this")
    return Path(data) / "commonroad"


def scenario_file(name: str) -> Path | None:
    """The file of a scenario, whichever part it is in."""
    places = (commonroad_root() / part / f"{name}.xml" for part in ("train", "val", "bench"))
    return next((path for path in places if path.is_file()), None)
