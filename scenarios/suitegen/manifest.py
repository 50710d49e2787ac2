"""The manifest of a suite."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path


def write_manifest(folder: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Writes ``manifest.csv``.

    Args:
        folder: Folder of the suite.
        rows: A row for each scenario, all with the same keys.
    """
    with (folder / "manifest.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
