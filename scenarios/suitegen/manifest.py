"""The manifest of a suite, and that no other scenarios lie beside those that it names."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path

FOLDERS = ("files", "futures", "sumo-files")
"""Where the files of scenarios lie in the folder of a suite."""


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


def remove_left_over(folder: Path, ids: Set[str], kinds: Iterable[str]) -> None:
    """Removes what is left of scenarios that a suite in the folder had before.

    Only files in ``FOLDERS`` whose names are those of the generator go.

    Args:
        folder: Folder of the suite.
        ids: The scenarios of the suite that was made now.
        kinds: Codes of all kinds that the generator may have made there.
    """
    # A file is named by its scenario, or by the map alone, which several scenarios may share.
    made = re.compile(rf"(ZAM_(?:{'|'.join(kinds)})-\d+(?:_\d+_T-1)?)\..+")
    kept = {*ids, *(id.rsplit("_", 2)[0] for id in ids)}
    for name in FOLDERS:
        for path in sorted((folder / name).glob("*")):
            found = made.fullmatch(path.name)
            if found is not None and found[1] not in kept and path.is_file():
                path.unlink()
