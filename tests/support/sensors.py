"""Sensors whose errors reach the observation as they are set."""

from __future__ import annotations

import pytest

from dosplan.simulation.sensing import Sensors
from dosplan.types import FloatArray, IntArray


def leave_unfiltered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Takes the filter away, so that what is seen errs as it is measured, by a known law."""

    def as_measured(self: Sensors, step: int, rows: IntArray, measured: FloatArray) -> FloatArray:
        return measured

    monkeypatch.setattr(Sensors, "_filtered", as_measured)
