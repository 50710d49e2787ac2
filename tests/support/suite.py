"""The embedded suites as they lie in the repository, for the tests that check them."""

from __future__ import annotations

import csv
import gzip
import io
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.types import USER_VELOCITY, FloatArray, Tracks

SUITE = Path(__file__).resolve().parents[2] / "scenarios" / "suite-1"
FUTURES_SUITE = SUITE.parent / "suite"
"""The suite whose scenarios have several futures."""
Row = dict[str, str]


def _table(text: str) -> list[Row]:
    return list(csv.DictReader(io.StringIO(text)))


def manifest(suite: Path) -> list[Row]:
    """Rows of the manifest of a suite."""
    return _table((suite / "manifest.csv").read_text(encoding="utf-8"))


ROWS = manifest(SUITE)
_FIRST = {row["road_kind"]: row["id"] for row in reversed(ROWS)}.values()


def each(*road_kinds: str) -> list[Any]:
    """Parameters of a test of every scenario, or of every one of some road kinds.

    All but the first of each road kind are slow.
    """
    return [
        pytest.param(row, id=row["id"], marks=() if row["id"] in _FIRST else pytest.mark.slow)
        for row in ROWS
        if row["road_kind"] in road_kinds or not road_kinds
    ]


def check_motion(tracks: Tracks, dt: float) -> None:
    """Checks that road users move as their velocities say, and that these change as they can."""
    both = tracks.valid[:, 1:] & tracks.valid[:, :-1]
    change = np.diff(tracks.states, axis=1)
    moved = np.hypot(change[..., 0], change[..., 1])[both]
    speed = tracks.states[..., USER_VELOCITY]
    mean = 0.5 * (speed[:, 1:] + speed[:, :-1])[both]
    # Positions and velocities tell the same story: 0.3 m/s, of which 0.02 is rounding.
    assert np.abs(moved / dt - mean).max() < 0.3
    assert np.abs(change[..., USER_VELOCITY][both]).max() <= 9.0 * dt + 1e-3


def baselines(suite: Path = SUITE) -> list[Row]:
    """Rows of ``baselines.csv``."""
    return _table((suite / "baselines.csv").read_text(encoding="utf-8"))


@cache
def drives() -> dict[str, FloatArray]:
    """The recorded drive of each scenario: (K, 4) centre x, y, heading and velocity."""
    return {name: drive for (name, _), drive in drives_by_future(SUITE).items()}


@cache
def drives_by_future(suite: Path) -> dict[tuple[str, int], FloatArray]:
    """The drives of a suite that succeed, by scenario and future."""
    data = gzip.decompress((suite / "drives.csv.gz").read_bytes()).decode()
    states: dict[tuple[str, int], list[list[float]]] = {}
    for row in _table(data):
        values = [float(row[name]) for name in ("x", "y", "heading", "velocity")]
        states.setdefault((row["id"], int(row.get("future", "0"))), []).append(values)
    return {name: np.array(rows) for name, rows in states.items()}


def drive_of(suite: Path, name: str, future: int) -> FloatArray:
    """The drive of a scenario in a future, without reading those of all others."""
    lines = gzip.decompress((suite / "drives.csv.gz").read_bytes()).decode().splitlines()
    rows = _table("\n".join([lines[0], *(line for line in lines if line.startswith(f"{name},"))]))
    columns = ("x", "y", "heading", "velocity")
    own = (row for row in rows if int(row.get("future", "0")) == future)
    return np.array([[float(row[column]) for column in columns] for row in own])
