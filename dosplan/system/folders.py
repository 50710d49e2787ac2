"""Where dosplan keeps its cache, and where it works."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def cache_folder() -> Path:
    """Where the cache is.

    Returns:
        ``$DOSPLAN_CACHE``, or else ``dosplan`` in ``$XDG_CACHE_HOME`` or ``~/.cache``.
    """
    if chosen := os.environ.get("DOSPLAN_CACHE"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dosplan"


@contextmanager
def folder_kept() -> Iterator[None]:
    """Goes back at the end of the block to the working folder, which a plug-in may leave."""
    before = Path.cwd()
    try:
        yield
    finally:
        os.chdir(before)
