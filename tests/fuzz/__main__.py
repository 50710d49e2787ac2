"""Repeats one case by itself: ``python -m tests.fuzz damaged_trees 17``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fuzz.families import FAMILIES
from tests.fuzz.harness import run_case


def main(name: str, seed: str) -> None:
    """Runs the case and prints what it finds."""
    (attempt,) = (family.attempt for family in FAMILIES if family.attempt.__name__ == name)
    with TemporaryDirectory() as place:
        os.environ["DOSPLAN_CACHE"] = str(Path(place, "cache"))
        print(run_case(attempt, int(seed), Path(place, seed)) or "nothing wrong is found")


if __name__ == "__main__":
    main(*sys.argv[1:])
