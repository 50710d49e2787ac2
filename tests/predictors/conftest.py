"""A cache of training windows that several tests read."""

from __future__ import annotations

from pathlib import Path

import pytest
from dosplan_net.training.cache import build_cache

from tests.support.suite import SUITE

CACHED = ("ZAM_Parked-1_1_T-1", "ZAM_Parked-3_2_T-1", "ZAM_TJunction-3_2_T-1")
EVERY = 10


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of three small files of the suite."""
    folder = tmp_path_factory.mktemp("recordings")
    for name in CACHED:
        file = SUITE / "files" / f"{name}.xml.gz"
        (folder / file.name).write_bytes(file.read_bytes())
    return folder


@pytest.fixture(scope="session")
def window_cache(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their windows; nobody may write to it."""
    folder = tmp_path_factory.mktemp("windows")
    build_cache([recordings], folder, every=EVERY)
    return folder
