"""Where dosplan keeps its cache."""

from __future__ import annotations

import os
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
