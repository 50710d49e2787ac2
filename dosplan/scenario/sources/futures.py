"""The file of a scenario's other futures, by its place (``dosplan.scenario.futures`` reads it)."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Final

from dosplan.scenario.commonroad.document import stem

FOLDER: Final = "futures"
"""Folder in which such files lie: beside a scenario file, or beside its folder."""
_ENDING: Final = ".npz"


def is_of_futures(name: str) -> bool:
    """Whether a file of an archive holds the futures of a scenario, by its name.

    Args:
        name: Its name with the folders, "/" between them.

    Returns:
        Whether it has the ending, and lies in such a folder.
    """
    path = PurePosixPath(name)
    return path.parent.name == FOLDER and path.suffix == _ENDING


def futures_file(scenario: Path) -> Path | None:
    """Finds the file that holds the other futures of a scenario.

    Args:
        scenario: The scenario file, ``NAME.xml`` or ``NAME.xml.gz``.

    Returns:
        ``NAME.npz`` in a folder ``futures``; None where there is none, and for a file behind a URL.
    """
    if not isinstance(scenario, Path) or "://" in str(scenario):
        return None
    folders = (scenario.parent / FOLDER, scenario.parent.parent / FOLDER)
    return next(
        (file for f in folders if (file := f / f"{stem(scenario)}{_ENDING}").is_file()), None
    )
