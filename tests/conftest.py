"""What holds for every test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keeps the tests, and what they start, out of the user's cache of scenarios."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOSPLAN_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
