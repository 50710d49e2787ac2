"""Whatever a file holds: a usable result or one clear line, within the time, and no other file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from pebble import ProcessPool

from dosplan.system.workers import worker_pool
from tests.fuzz.families import FAMILIES
from tests.fuzz.harness import Attempt, judge


@pytest.fixture(scope="module")
def worker() -> Iterator[ProcessPool]:
    """One process; a case that hangs or kills it gets a new one."""
    with worker_pool(1) as pool:
        yield pool


@pytest.mark.parametrize(
    ("attempt", "seeds"), [param for family in FAMILIES for param in family.batches()]
)
def test_fuzz(worker: ProcessPool, attempt: Attempt, seeds: range, tmp_path: Path) -> None:
    found = judge(worker, attempt, seeds, tmp_path)
    assert not found, f"{len(found)} of {len(seeds)}:\n" + "\n".join(found)


def test_there_are_two_thousand_cases_and_a_hundred_of_them_are_quick() -> None:
    assert sum(family.total for family in FAMILIES) >= 2000
    assert 100 <= sum(family.quick for family in FAMILIES) <= 200
