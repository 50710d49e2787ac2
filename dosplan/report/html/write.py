"""Writes the page of a run, that of several, and that of a comparison of two."""

from __future__ import annotations

import os
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from dosplan.report.html.figures import MOST_SIDES
from dosplan.report.html.page import build_page
from dosplan.report.html.scenarios import find_scenes
from dosplan.report.html.sides import Pairing, Side, View
from dosplan.results.comparison import CompareError, Comparison, compare_rows, paired_sides
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, named_options, read_manifest
from dosplan.results.markdown import ARM_TITLES, ARMS_SIDE_BY_SIDE, unranked_reason
from dosplan.results.rows import read_run
from dosplan.results.table import COLUMNS, Entry, Table, by_driven, make_block, read_entries
from dosplan.results.unusable import unusable_scenarios
from dosplan.scenario.sources.catalogue import source_text
from dosplan.system.files import write_text
from dosplan.types import Arm, ScenarioFuture, Score

_ARM_TEXTS: Final = {
    Arm.WITH_DOS: "With DOS, the planner keeps clear of dynamic occupancy sets: for every road "
    "user and every step ahead, an ellipse in which it may be.",
    Arm.WITHOUT_DOS: "Without DOS, it keeps clear of the predicted positions alone.",
}


def write_report(run: Path, out: Path | None = None, source: str | None = None) -> Path:
    """Writes the page of a run.

    Args:
        run: A run folder.
        out: The file; ``report.html`` in the folder if None.
        source: Where the scenarios are now; where the run found them if None.

    Returns:
        The file.

    Raises:
        FileError: It is not the folder of a finished run, or the file cannot be written.
    """
    manifest, rows = read_run(run)
    folder = RunFolder(run)
    sides = tuple(
        Side(ARM_TITLES[arm], folder, _by_future(row for row in rows if row.arm is arm), arm)
        for arm in ARMS_SIDE_BY_SIDE
        if arm in manifest.config.arms
    )
    pairing = _pairing("", sides, manifest, source)
    title = f"{manifest.planner} {' and '.join(side.name for side in sides[::-1])}"
    path = folder.report if out is None else out
    lead = _lead({side.arm for side in sides})
    write_text(path, build_page(title, _facts(manifest), [pairing], lead=lead))
    return path


def write_runs(specs: Sequence[str], out: Path, source: str | None = None) -> Path:
    """Writes the page of several runs: all of their arms, any two of which can be compared.

    Args:
        specs: Run folders, arms of them and folders of sweeps, as for
            ``dosplan.results.table.make_table``.
        out: The file.
        source: Where the scenarios are now; where each run found them if None.

    Returns:
        The file.

    Raises:
        CompareError: A run does not hold an arm, or none is finished.
        FileError: A run cannot be read, or the file cannot be written.
    """
    entries, missing = read_entries(specs)
    if not entries:
        raise CompareError(f"no run of {', '.join(specs)} is finished")
    called = _short_names(dict.fromkeys(entry.name for entry in entries))
    entries = [replace(entry, name=called[entry.name]) for entry in entries]
    pairings = []
    for members in by_driven(entries):
        block = make_block(members)
        ordered = sorted(members, key=lambda entry: _place(entry, members, block.baseline))
        sides = tuple(_side(entry) for entry in ordered[:MOST_SIDES])
        table = Table(COLUMNS, (block,), missing)
        pairings.append(_pairing(block.title, sides, ordered[0].manifest, source, table))
    runs = {entry.name: entry for entry in entries}
    shown = [*runs.values()][:MOST_SIDES]
    more = f" and {len(runs) - len(shown)} more" if len(runs) > len(shown) else ""
    facts = {f"Run {entry.name}": _listed(entry.manifest) for entry in shown}
    reports = {entry.name: RunFolder(entry.side.path).report for entry in shown}
    links = {
        f"Report of {name}": _address(page, out) for name, page in reports.items() if page.is_file()
    }
    names = ", ".join(entry.name for entry in shown)
    title = f"{len(runs)} run{'s' if len(runs) > 1 else ''}: {names}{more}"
    lead = _lead({entry.side.arm for entry in entries})
    write_text(out, build_page(title, facts, pairings, links, lead))
    return out


def _short_names(names: Iterable[str]) -> dict[str, str]:
    """What a page calls runs: the folder's own name where that is no other's."""
    ends = {name: Path(name).name for name in names}
    found = list(ends.values())
    return {name: end if end and found.count(end) == 1 else name for name, end in ends.items()}


def _place(entry: Entry, among: Sequence[Entry], baseline: str | None) -> tuple[bool, int, int]:
    """The baseline is first, then each run's arms beside each other, in the order of the runs."""
    runs = [other.name for other in among]
    arm = ARMS_SIDE_BY_SIDE.index(entry.side.arm)
    return entry.spec != baseline, runs.index(entry.name), arm


def _side(entry: Entry) -> Side:
    side = entry.side
    name = f"{entry.name} {ARM_TITLES[side.arm]}"
    return Side(name, RunFolder(side.path), _by_future(side.rows), side.arm, entry.spec)


def write_comparison(specs: Sequence[str], out: Path) -> Path:
    """Writes the page that compares two runs, or the arms of one.

    Args:
        specs: As for ``dosplan.results.comparison.compare_runs``.
        out: The file.

    Returns:
        The file.

    Raises:
        CompareError: The runs cannot be compared.
        FileError: A run cannot be read, or the file cannot be written.
    """
    pairs = paired_sides(specs)
    pairings, facts, links = [], {}, {}
    for pair in pairs:
        manifests = [read_manifest(RunFolder(side.path)) for side in pair]
        sides = tuple(
            Side(letter, RunFolder(side.path), _by_future(side.rows), side.arm)
            for letter, side in zip("AB", pair, strict=True)
        )
        title = ", ".join(f"{side.name}: {ARM_TITLES[side.arm]}" for side in sides)
        pairings.append(_pairing(title, sides, manifests[0], None))
        for side, manifest in zip(sides, manifests, strict=True):
            facts[f"Run {side.name}"] = f"{side.folder.path}: {_listed(manifest)}"
            if side.folder.report.is_file():
                links[f"Report of run {side.name}"] = _address(side.folder.report, out)
    lead = _lead({side.arm for pair in pairs for side in pair})
    write_text(out, build_page("What changed from A to B", facts, pairings, links, lead))
    return out


def _by_future(rows: Iterable[Score]) -> dict[ScenarioFuture, Score]:
    return {row.scenario_future: row for row in rows}


def _lead(arms: Container[Arm]) -> str:
    """Describes the arms, for a reader who knows the method only."""
    return " ".join(text for arm, text in _ARM_TEXTS.items() if arm in arms)


def _pairing(
    title: str,
    sides: tuple[Side, ...],
    manifest: RunManifest,
    source: str | None,
    table: Table | None = None,
) -> Pairing:
    comparisons: dict[View, Comparison] = {
        (i, j): compare_rows([*a.rows.values()], [*b.rows.values()], a.name, b.name)
        for (i, a), (j, b) in combinations(enumerate(sides), 2)
    }
    unusable = unusable_scenarios(row for side in sides for row in side.rows.values())
    left_out = {one.scenario for one in unusable}
    usable = [driven for driven in sides[0].rows if driven.scenario not in left_out]
    return Pairing(
        title=title,
        sides=tuple(replace(side, rows={s: side.rows[s] for s in usable}) for side in sides),
        comparisons=comparisons,
        driven=tuple(usable),
        unusable=unusable,
        scenes=find_scenes(
            manifest.config.source if source is None else source, cached=manifest.config.cache
        ),
        table=table,
    )


def _listed(manifest: RunManifest) -> str:
    return ", ".join(f"{name.lower()} {value}" for name, value in _facts(manifest).items())


def _facts(manifest: RunManifest) -> dict[str, str]:
    """What was run, for a reader who has the page alone."""
    config = manifest.config
    facts = {
        "Planner": manifest.planner,
        "Predictor": manifest.predictor,
        "Sets and predictions": _settings(manifest.settings.get("predictor", {})),
        "Traffic": manifest.traffic,
        "Futures": str(config.futures) if config.futures > 1 else "",
        "Loop": manifest.loop,
        "Options": ", ".join(f"{name} = {value}" for name, value in named_options(config).items()),
        "Scenarios": f"{len(manifest.scenarios)} of {source_text(config.source)}",
        "Seed": str(config.seed),
        "Started": manifest.started,
        "dosplan": f"{manifest.versions.get('dosplan', '')} ({str(manifest.git_revision)[:12]})",
        "Rank": ""
        if config.ranked and manifest.reproducible
        else f"unranked: {unranked_reason(manifest.reproducible)}",
    }
    return {name: value for name, value in facts.items() if value}


def _settings(settings: Mapping[str, Any]) -> str:
    """What a plug-in's settings are, defaults included, but those that are null."""
    told = {name: value for name, value in settings.items() if value is not None}
    return ", ".join(f"{name} = {value}" for name, value in told.items())


def _address(target: Path, page: Path) -> str:
    """Relative address of a file from a page, so that both can be moved together."""
    return quote(os.path.relpath(target.resolve(), page.resolve().parent))
