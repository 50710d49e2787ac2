"""The embedded suite as it lies in the repository, for the tests that check it."""

from __future__ import annotations

import csv
import gzip
import io
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.types import FloatArray

SUITE = Path(__file__).resolve().parents[2] / "scenarios" / "suite-1"
Row = dict[str, str]


def _table(text: str) -> list[Row]:
    return list(csv.DictReader(io.StringIO(text)))


ROWS = _table((SUITE / "manifest.csv").read_text(encoding="utf-8"))
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


def baselines() -> list[Row]:
    """Rows of ``baselines.csv``."""
    return _table((SUITE / "baselines.csv").read_text(encoding="utf-8"))


@cache
def drives() -> dict[str, FloatArray]:
    """The recorded drive of each scenario: (K, 4) centre x, y, heading and velocity."""
    data = gzip.decompress((SUITE / "drives.csv.gz").read_bytes()).decode()
    states: dict[str, list[list[float]]] = {}
    for row in _table(data):
        values = [float(row[name]) for name in ("x", "y", "heading", "velocity")]
        states.setdefault(row["id"], []).append(values)
    return {name: np.array(rows) for name, rows in states.items()}
