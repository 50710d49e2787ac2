"""What holds for every test."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest


def pytest_configure() -> None:
    """Gives every process one thread for its arithmetic, and lets Ctrl-C reach it.

    The tests run side by side, a process for each core, and their arrays are small. A shell has
    its background jobs ignore SIGINT, and what ignores it passes that on.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keeps the tests, and what they start, out of the user's cache of scenarios.

    All processes of a run of the tests share one, so that each scenario is parsed once.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # Whose folder is one of its own in that.
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOSPLAN_CACHE", str(folder / "shared-cache"))
        yield
