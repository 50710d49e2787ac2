"""Writes the page of a run, and that of a comparison of two."""

from __future__ import annotations

import os
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from dosplan.report.html.page import build_page
from dosplan.report.html.scenarios import find_scenes
from dosplan.report.html.sides import Pairing, Side
from dosplan.results.comparison import compare_rows, paired_sides
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest, read_manifest
from dosplan.results.markdown import ARM_TITLES, ARMS_SIDE_BY_SIDE, unranked_reason
from dosplan.results.rows import read_run
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
            listed = ", ".join(_facts(manifest).values())
            facts[f"Run {side.name}"] = f"{side.folder.path}: {listed}"
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
    title: str, sides: tuple[Side, ...], manifest: RunManifest, source: str | None
) -> Pairing:
    comparison = None
    if len(sides) > 1:
        a, b = sides
        comparison = compare_rows([*a.rows.values()], [*b.rows.values()], a.name, b.name)
    unusable = unusable_scenarios(row for side in sides for row in side.rows.values())
    left_out = {one.scenario for one in unusable}
    usable = [driven for driven in sides[0].rows if driven.scenario not in left_out]
    return Pairing(
        title=title,
        sides=tuple(replace(side, rows={s: side.rows[s] for s in usable}) for side in sides),
        comparison=comparison,
        driven=tuple(usable),
        unusable=unusable,
        scenes=find_scenes(
            manifest.config.source if source is None else source, cached=manifest.config.cache
        ),
    )


def _facts(manifest: RunManifest) -> dict[str, str]:
    """What was run, for a reader who has the page alone."""
    config = manifest.config
    options = {
        f"{plugin}.{name}": value
        for plugin, chosen in (
            ("planner", config.planner_options),
            ("predictor", config.predictor_options),
            ("traffic", config.traffic_options),
        )
        for name, value in chosen.items()
    }
    facts = {
        "Planner": manifest.planner,
        "Predictor": manifest.predictor,
        "Sets and predictions": _settings(manifest.settings.get("predictor", {})),
        "Traffic": manifest.traffic,
        "Futures": str(config.futures) if config.futures > 1 else "",
        "Loop": manifest.loop,
        "Options": ", ".join(f"{name} = {value}" for name, value in options.items()),
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
