"""Where the published results lie that come with dosplan."""

from __future__ import annotations

from pathlib import Path
from typing import Final

LEADERBOARD: Final = Path("results/leaderboard")
"""The rows of the leaderboard, in a checkout."""


def default_results() -> Path:
    """The results that came with the package, or those of the source tree it runs from.

    Returns:
        The folder; it need not exist.
    """
    package = Path(__file__).resolve().parents[1]
    installed, source = package / "_results", package.parent / "results"
    return installed if installed.is_dir() else source
