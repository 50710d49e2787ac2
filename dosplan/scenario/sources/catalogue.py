"""Finding scenarios: from files of a source, or of an embedded suite, to episodes."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dosplan.scenario.commonroad.document import SUFFIXES, ScenarioError, scan, stem
from dosplan.scenario.sources.fetch import (
    LIST,
    SUITE,
    SUITES,
    Candidate,
    Suites,
    candidates,
    joined_candidates,
    listed_candidates,
)
from dosplan.system.errors import did_you_mean


@dataclass(frozen=True)
class ScenarioRef:
    """One episode to be run.

    Attributes:
        path: The scenario file; for one behind a URL, what ``universal-pathlib`` makes of it.
        id: Benchmark id, with ``@<problem id>`` appended where the file holds several planning
            problems, and ``:<path in the source>`` before that where several files have the same
            one; the file's stem where it cannot be read, or the file's path in the source where
            that stem is taken.
        problem_id: The planning problem, or None where the file holds one only.
    """

    path: Path
    id: str
    problem_id: int | None = None

    @property
    def scenario(self) -> str:
        """The id without the planning problem; all episodes of a file have the same."""
        if self.problem_id is None:
            return self.id
        return self.id.removesuffix(f"@{self.problem_id}")


Source = str | Path | Sequence[str | Path]
"""Where scenarios are: a source, as ``find_scenarios`` says, or several."""


def find_scenarios(source: Source) -> list[ScenarioRef]:
    """Lists the episodes of a source, in the order of their paths, or of the list.

    A file that is broken is listed too, so that its failure becomes a result and is not lost.
    Hidden files of a folder and XML files that are something else (solutions) are passed over.

    Args:
        source: ``"suite"`` for the embedded suite, ``"suite-1"`` for the first one, or one of
            these, by its path:

            * a ``.xml`` or ``.xml.gz`` file;
            * a folder, which is searched with its subfolders;
            * a glob, such as ``"data/USA_*.xml"`` or ``"data/**/*-1_T-1.xml"``;
            * a ``.zip``, ``.tar``, ``.tar.gz``, ``.tar.bz2`` or ``.tar.xz`` file, which is
              unpacked into the cache (``dosplan.scenario.sources.archives``);
            * ``@LIST``, a text file that names a path or an id on each line
              (``dosplan.scenario.sources.fetch``);
            * the http(s) URL of a file or an archive, which is fetched into the cache
              (``dosplan.scenario.sources.download``);
            * the URL of a file, a folder or an archive (``s3://bucket/folder``, whatever fsspec
              reads).

            Several sources are taken together, in their order; an id of a suite may be one.

    Returns:
        The episodes, ids unique.

    Raises:
        ScenarioError: Nothing is found, or an archive or a list cannot be used.
    """
    if not isinstance(source, str | Path):
        refs = _episodes(joined_candidates(source, _suites()))
    elif source in SUITES:
        refs = _suite(str(source))
    elif str(source).startswith(LIST):
        listing = Path(str(source).removeprefix(LIST))
        refs = _episodes(listed_candidates(listing, _suites()))
    else:
        refs = _episodes(candidates(source))
    if not refs:
        raise ScenarioError(source_text(source), f"holds no scenario ({' or '.join(SUFFIXES)})")
    return refs


def find_ids(source: Source, ids: Sequence[str]) -> list[ScenarioRef]:
    """Finds scenarios by their ids.

    Args:
        source: Where to look, as ``find_scenarios`` takes it.
        ids: Ids; one without a planning problem stands for all of its file.

    Returns:
        The episodes, each once, in the order of the ids.

    Raises:
        ScenarioError: There is no such source, or it does not hold one of them.
    """
    there: dict[str, list[ScenarioRef]] = {}
    for ref in find_scenarios(source):
        for name in {ref.id, ref.scenario}:
            there.setdefault(name, []).append(ref)
    found: dict[ScenarioRef, None] = {}
    for wanted in ids:
        if wanted not in there:
            raise ScenarioError(
                source_text(source),
                f"holds no scenario {wanted}{did_you_mean(wanted, there, 3)}; "
                "name a file or a folder that is there, or its place with --source",
            )
        found.update(dict.fromkeys(there[wanted]))
    return list(found)


def source_text(source: Source) -> str:
    """Names a source for people.

    Args:
        source: One source or several.

    Returns:
        It, or its parts with commas between them.
    """
    return str(source) if isinstance(source, str | Path) else ", ".join(map(str, source))


def suites_of(ids: Sequence[str]) -> str | tuple[str, ...]:
    """Names the embedded suite that scenarios are of.

    Args:
        ids: Their ids, with or without a planning problem.

    Returns:
        The first suite that holds all of them; several where one alone does not; the default one
        where an id is of none.
    """
    holds = {name: {i for ref in _suite(name) for i in (ref.id, ref.scenario)} for name in SUITES}
    whole = [name for name, known in holds.items() if known.issuperset(ids)]
    if whole:
        return whole[0]
    return SUITES if set[str]().union(*holds.values()).issuperset(ids) else SUITE


def suite_kinds() -> dict[str, str]:
    """The kinds of the scenarios of the embedded suites, in the suites' own words.

    Returns:
        Kinds, or kinds of road, by the id of the scenario.
    """
    rows = (row for name in SUITES for row in _suite_rows(name))
    return {row["id"]: row.get("kind") or row["road_kind"] for row in rows}


def _episodes(found: list[Candidate]) -> list[ScenarioRef]:
    """The episodes of some files, each once; a broken file is one."""
    each = [(candidate, _refs(candidate)) for candidate in found]
    files: dict[str, dict[Path, str]] = {}
    for candidate, refs in each:
        for ref in refs or ():
            files.setdefault(ref.scenario, {}).setdefault(ref.path, candidate.name or ref.path.name)
    each = [(c, refs and [_distinguished(x, files[x.scenario]) for x in refs]) for c, refs in each]
    ids = Counter({ref.id for _, refs in each for ref in refs or ()})
    ids.update({c.path: stem(c.path) for c, refs in each if refs is None}.values())
    listed: dict[ScenarioRef, None] = {}
    for candidate, refs in each:
        if refs is None:
            name = stem(candidate.path)
            refs = [ScenarioRef(candidate.path, name if ids[name] == 1 else candidate.name)]
        listed.update(dict.fromkeys(refs))
    return list(listed)


def _distinguished(ref: ScenarioRef, files: Mapping[Path, str]) -> ScenarioRef:
    """The episode with the path of its file in its id, where several files have that id."""
    if len(files) == 1:
        return ref
    problem = "" if ref.problem_id is None else f"@{ref.problem_id}"
    return replace(ref, id=f"{ref.scenario}:{files[ref.path]}{problem}")


def _refs(candidate: Candidate) -> list[ScenarioRef] | None:
    """The wanted episodes of a file, or None where it cannot be read."""
    path, wanted = candidate.path, candidate.wanted
    try:
        tag, benchmark_id, problems = scan(path)
    except ScenarioError:
        return None
    if tag != "commonRoad" and not candidate.chosen:
        return []
    name = benchmark_id or stem(path)
    if len(set(problems)) < len(problems):
        return None
    refs = [ScenarioRef(path, name)]
    if len(problems) > 1:
        refs = [ScenarioRef(path, f"{name}@{problem}", problem) for problem in problems]
    chosen = [ref for ref in refs if wanted in (None, ref.id, ref.scenario)]
    if not chosen:
        raise ScenarioError(path, f"does not hold {wanted}, but {', '.join(r.id for r in refs)}")
    return chosen


def _suites() -> Suites:
    return {name: {ref.scenario: ref.path for ref in _suite(name)} for name in SUITES}


def _suite(name: str) -> list[ScenarioRef]:
    folder = _suite_folder(name)
    return [_suite_ref(folder / row["file"], row["id"]) for row in _suite_rows(name)]


def _suite_folder(name: str) -> Path:
    package = Path(__file__).resolve().parents[2]
    installed, source = package / "_suites", package.parent / "scenarios"
    return (installed if installed.is_dir() else source) / name


def _suite_rows(name: str) -> list[dict[str, str]]:
    manifest = _suite_folder(name) / "manifest.csv"
    try:
        with manifest.open(newline="", encoding="utf-8") as stream:
            return list(csv.DictReader(stream))
    except OSError as error:
        raise ScenarioError(
            manifest, f"cannot be read ({error.strerror}); install dosplan again"
        ) from None


def _suite_ref(path: Path, name: str) -> ScenarioRef:
    problem = name.partition("@")[2]
    return ScenarioRef(path, name, int(problem) if problem else None)
