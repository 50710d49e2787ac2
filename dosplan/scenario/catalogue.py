"""Finding scenarios: a file, a folder, or the suite that comes with the package."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dosplan.scenario.document import SUFFIXES, ScenarioError, scan

SUITE: Final = "suite"


@dataclass(frozen=True)
class ScenarioRef:
    """One episode to be run.

    Attributes:
        path: The scenario file.
        id: Benchmark id, with ``@<problem id>`` appended where the file holds several planning
            problems; the file's stem where it cannot be read.
        problem_id: The planning problem, or None where the file holds one only.
    """

    path: Path
    id: str
    problem_id: int | None = None


def find_scenarios(source: str | Path) -> list[ScenarioRef]:
    """Lists the episodes of a source, in the order of their paths.

    A file that is broken is listed too, so that its failure becomes a result and is not lost.
    XML files of a folder that are something else (solutions) are passed over.

    Args:
        source: A ``.xml`` or ``.xml.gz`` file, a folder that is searched with its subfolders, or
            ``"suite"`` for the embedded suite.

    Returns:
        The episodes, ids unique.

    Raises:
        ScenarioError: Nothing is found, or two files have the same id.
    """
    if source == SUITE:
        refs = _suite()
    else:
        path = Path(source)
        if path.is_dir():
            files = sorted(f for f in path.rglob("*.xml*") if f.name.endswith(SUFFIXES))
            refs = [ref for file in files for ref in _refs(file, others=False)]
        elif path.is_file():
            refs = list(_refs(path, others=True))
        else:
            raise ScenarioError(path, 'does not exist; name a file, a folder or "suite"')
    if not refs:
        raise ScenarioError(Path(source), f"holds no scenario ({' or '.join(SUFFIXES)})")
    known: dict[str, Path] = {}
    for ref in refs:
        if ref.id in known:
            raise ScenarioError(
                ref.path, f"has the same id, {ref.id}, as {known[ref.id]}; remove one of them"
            )
        known[ref.id] = ref.path
    return refs


def stem(path: Path) -> str:
    """Name of a scenario file without ``.xml`` or ``.xml.gz``."""
    return path.name.removesuffix(".gz").removesuffix(".xml")


def _refs(path: Path, others: bool) -> Iterator[ScenarioRef]:
    try:
        tag, benchmark_id, problems = scan(path)
    except ScenarioError:
        yield ScenarioRef(path, stem(path))
        return
    if tag != "commonRoad" and not others:
        return
    name = benchmark_id or stem(path)
    if len(problems) < 2:
        yield ScenarioRef(path, name)
    else:
        yield from (ScenarioRef(path, f"{name}@{p}", p) for p in problems)


def _suite() -> list[ScenarioRef]:
    package = Path(__file__).resolve().parents[1]
    installed, source = package / "_suite", package.parent / "scenarios"
    folder = installed if installed.is_dir() else source
    manifest = folder / "manifest.csv"
    try:
        with manifest.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
    except OSError as error:
        raise ScenarioError(
            manifest, f"cannot be read ({error.strerror}); install dosplan again"
        ) from None
    return [_suite_ref(folder / row["file"], row["id"]) for row in rows]


def _suite_ref(path: Path, name: str) -> ScenarioRef:
    problem = name.partition("@")[2]
    return ScenarioRef(path, name, int(problem) if problem else None)
