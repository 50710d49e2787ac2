"""Finding scenarios: a file, a folder, or the suite that comes with the package."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

from dosplan.scenario.document import SUFFIXES, ScenarioError, scan

SUITE: Final = "suite"


@dataclass(frozen=True)
class ScenarioRef:
    """One episode to be run.

    Attributes:
        path: The scenario file; for one behind a URL, what ``universal-pathlib`` makes of it.
        id: Benchmark id, with ``@<problem id>`` appended where the file holds several planning
            problems; the file's stem where it cannot be read, or the file's path in the source
            where that stem is taken.
        problem_id: The planning problem, or None where the file holds one only.
    """

    path: Path
    id: str
    problem_id: int | None = None


def find_scenarios(source: str | Path) -> list[ScenarioRef]:
    """Lists the episodes of a source, in the order of their paths.

    A file that is broken is listed too, so that its failure becomes a result and is not lost.
    Hidden files of a folder and XML files that are something else (solutions) are passed over.

    Args:
        source: A ``.xml`` or ``.xml.gz`` file, a folder that is searched with its subfolders, the
            URL of one (``s3://bucket/folder``, whatever fsspec reads), or ``"suite"`` for the
            embedded suite.

    Returns:
        The episodes, ids unique.

    Raises:
        ScenarioError: Nothing is found, or two files have the same id.
    """
    if source == SUITE:
        refs = _suite()
    else:
        path = _place(source)
        if path.is_dir():
            refs = _folder(path)
        elif path.is_file():
            refs = _refs(path, others=True) or [ScenarioRef(path, stem(path))]
        else:
            raise ScenarioError(path, 'does not exist; name a file, a folder or "suite"')
    if not refs:
        raise ScenarioError(_place(source), f"holds no scenario ({' or '.join(SUFFIXES)})")
    known: dict[str, Path] = {}
    for ref in refs:
        if known.get(ref.id) == ref.path:
            raise ScenarioError(
                ref.path, f"names planning problem {ref.problem_id} twice; give one another id"
            )
        if ref.id in known:
            raise ScenarioError(
                ref.path, f"has the same id, {ref.id}, as {known[ref.id]}; remove one of them"
            )
        known[ref.id] = ref.path
    return refs


def _place(source: str | Path) -> Path:
    """The path of a source, or what behaves like one for a URL."""
    if "://" not in str(source):
        return Path(source)
    try:
        from upath import UPath  # Of an optional dependency.

        place = UPath(source)
        place.exists()  # Shows whether the URL's file system is installed and answers.
    except Exception as error:  # Whatever a file system raises, from anywhere.
        reason = f"{type(error).__name__}: {error}"
        raise ScenarioError(
            Path(source),
            f"cannot be reached ({reason}); URLs need pip install 'dosplan[cluster]' "
            "and fsspec's package for theirs",
        ) from error
    return cast(Path, place)


def stem(path: Path) -> str:
    """Name of a scenario file without ``.xml`` or ``.xml.gz``."""
    return path.name.removesuffix(".gz").removesuffix(".xml")


def _folder(folder: Path) -> list[ScenarioRef]:
    files = sorted(
        file
        for file in folder.rglob("*.xml*")
        if file.name.endswith(SUFFIXES) and not file.name.startswith(".")
    )
    found = {file: _refs(file, others=False) for file in files}
    ids = Counter(ref.id for refs in found.values() if refs is not None for ref in refs)
    ids.update(stem(file) for file, refs in found.items() if refs is None)
    listed: list[ScenarioRef] = []
    for file, refs in found.items():
        if refs is None:
            name = stem(file) if ids[stem(file)] == 1 else file.relative_to(folder).as_posix()
            refs = [ScenarioRef(file, name)]
        listed.extend(refs)
    return listed


def _refs(path: Path, others: bool) -> list[ScenarioRef] | None:
    """The episodes of a file, or None where it cannot be read."""
    try:
        tag, benchmark_id, problems = scan(path)
    except ScenarioError:
        return None
    if tag != "commonRoad" and not others:
        return []
    name = benchmark_id or stem(path)
    if len(problems) < 2:
        return [ScenarioRef(path, name)]
    return [ScenarioRef(path, f"{name}@{p}", p) for p in problems]


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
