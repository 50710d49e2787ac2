"""All kinds of cases, and how many of each there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import pytest

from tests.fuzz.configs import damaged_methods, damaged_trainings, strange_options, strange_settings
from tests.fuzz.harness import Attempt
from tests.fuzz.odd_files import odd_files
from tests.fuzz.plugins import broken_plugins, rude_plugins
from tests.fuzz.run_folders import damaged_manifests, damaged_recordings, damaged_rows
from tests.fuzz.scenarios import (
    converted_trees,
    damaged_archives,
    damaged_gzip,
    damaged_texts,
    damaged_trees,
)
from tests.fuzz.weights import damaged_calibrations, damaged_weights

_BATCH: Final = 50


@dataclass(frozen=True)
class Family:
    """Cases of one kind: ``quick`` of them are in every run of the tests, ``total`` in all."""

    attempt: Attempt
    total: int
    quick: int

    def batches(self) -> list[Any]:
        """Parameters ``(attempt, seeds)`` of a test: a quick batch, and slow ones."""
        name = self.attempt.__name__
        params = [pytest.param(self.attempt, range(self.quick), id=f"{name}-quick")]
        for first in range(self.quick, self.total, _BATCH):
            seeds = range(first, min(first + _BATCH, self.total))
            label = f"{name}-{seeds.start}-{seeds.stop - 1}"
            params.append(pytest.param(self.attempt, seeds, id=label, marks=pytest.mark.slow))
        return params


FAMILIES: Final = (
    Family(damaged_trees, 900, 20),
    Family(odd_files, 200, 10),
    Family(converted_trees, 150, 5),
    Family(damaged_texts, 300, 15),
    Family(damaged_gzip, 100, 8),
    Family(damaged_archives, 100, 8),
    Family(damaged_methods, 150, 10),
    Family(damaged_trainings, 120, 8),
    Family(strange_options, 400, 40),
    Family(strange_settings, 120, 8),
    Family(broken_plugins, 100, 6),
    Family(rude_plugins, 140, 8),
    Family(damaged_rows, 100, 5),
    Family(damaged_manifests, 100, 5),
    Family(damaged_recordings, 100, 5),
    Family(damaged_weights, 80, 4),
    Family(damaged_calibrations, 40, 2),
)
