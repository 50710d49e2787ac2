"""Assembles a page: one HTML file that holds its data, style and script and loads nothing else.

The page's text is filled in by Jinja2, which escapes whatever comes from files; what the script
shows comes from one block of JSON and reaches the page as text only. A content security policy
allows this one script, by its hash, and no connection.

The table of scenarios and the player are a few hundred lines of the page's own script: the browser
can sort and filter a few hundred rows and draw polygons, and a library for that would be several
times the size of everything else.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from functools import cache, partial
from hashlib import sha256
from importlib.resources import files
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from dosplan import __version__
from dosplan.report.html import findings
from dosplan.report.html.cases import FASTER, MOST_EXAMINED, OUTCOME_WORDS, Case, examine
from dosplan.report.html.figures import coverage_plot, frontier_plot, histogram
from dosplan.report.html.player import KINDS
from dosplan.report.html.sides import Pairing, View
from dosplan.report.html.thumbnails import HEIGHT, WIDTH
from dosplan.report.palette import (
    GOAL_COLOUR,
    KIND_COLOURS,
    LAMP_COLOURS,
    LAMP_RIM,
    SIGN_RED,
    SIGN_YELLOW,
)
from dosplan.results.table import Table
from dosplan.results.table_text import block_cells
from dosplan.results.table_text import notes as table_notes
from dosplan.results.unusable import unusable_title
from dosplan.scoring import metrics
from dosplan.scoring.metrics import Metric
from dosplan.types import FloatArray, place_of

MOST_BYTES: Final = 4_900_000
"""A page is no larger; episodes for which there is no room are listed, but not played."""

_HELD: Final = ("sets held, 1 s", "2 s", "3 s")  # Columns of ``findings.held_cells``.
_SCRIPTS: Final = ("codec.js", "draw.js", "player.js", "table.js", "main.js")
_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{}'; img-src data:; "
    "base-uri 'none'; form-action 'none'"
)


def build_page(
    title: str,
    facts: Mapping[str, str],
    pairings: Sequence[Pairing],
    links: Mapping[str, str] | None = None,
    lead: str = "",
) -> str:
    """Builds a page.

    Args:
        title: Its heading.
        facts: What was run, line by line: name and value.
        pairings: What is shown, in order.
        links: Further pages: addresses by their text.
        lead: Text at the beginning.

    Returns:
        The HTML.
    """
    script = "(() => {\n'use strict';\n" + "\n".join(map(_static, _SCRIPTS)) + "\n})();"
    examined = [(pairing, list(examine(pairing))) for pairing in pairings]
    sections = [_section(pairing, cases) for pairing, cases in examined]
    render = partial(
        _template().render,
        title=title,
        facts=facts,
        links=links or {},
        lead=lead,
        sections=sections,
        notes=_notes(examined),
        outcomes=[(outcome.value, word) for outcome, word in OUTCOME_WORDS.items()],
        faster=FASTER,
        version=__version__,
        policy=_POLICY.format(base64.b64encode(sha256(script.encode()).digest()).decode()),
        style=Markup(_static("style.css")),  # noqa: S704 - a file of the package
        script=Markup(script),  # noqa: S704 - likewise
    )
    # What is left of the room is known when all but the data is there.
    room = MOST_BYTES - len(render(data="").encode(errors="replace"))
    page: str = render(data=Markup(_data(examined, room)))  # noqa: S704 - see _json
    return page


def _section(pairing: Pairing, cases: Sequence[Case]) -> dict[str, Any]:
    """What the template shows of a pairing."""
    names = [side.name for side in pairing.sides]
    sides = range(len(names))
    coverages = {name: findings.coverage_of(cases, side) for side, name in enumerate(names)}
    return {
        "title": pairing.title,
        "names": names,
        "views": [_view(pairing, cases, view) for view in pairing.views],
        "overview": None if pairing.table is None else _overview(pairing, pairing.table, cases),
        "paired": bool(pairing.comparisons),
        "n": len({case.driven.scenario for case in cases}),
        "futures": pairing.futures,
        "unusable": pairing.unusable,
        "unusable_title": unusable_title(
            pairing.unusable,
            len({case.driven.scenario for case in cases}) + len(pairing.unusable),
        ),
        "held": findings.held(cases, names),
        "places": len({place_of(case.driven.scenario) for case in cases}),
        "headline": findings.headline(pairing, cases),
        "groups": group_tables(cases, len(names)),
        "coverage": {side: rows for side in sides if (rows := findings.coverage_rows(cases, side))},
        "coverage_plot": Markup(coverage_plot(coverages)) if any(coverages.values()) else None,  # noqa: S704
        "plots": _plots(pairing, cases),
    }


def _view(pairing: Pairing, cases: Sequence[Case], view: View) -> dict[str, Any]:
    """What the template shows of two sides, or of the only one."""
    names = [pairing.sides[index].name for index in view]
    return {
        "sides": view,
        "key": "-".join(map(str, view)),
        "first": names[0],
        "last": names[-1],
        "answer": findings.answer(pairing, view),
        "grounds": findings.grounds(pairing, view),
        "shortcuts": findings.shortcuts(pairing, cases, view),
    }


def _overview(pairing: Pairing, table: Table, cases: Sequence[Case]) -> dict[str, Any]:
    """What the template shows of all arms that drove the same."""
    (block,) = table.blocks
    index = {side.spec: number for number, side in enumerate(pairing.sides)}
    held = {spec: findings.held_cells(cases, side) for spec, side in index.items()}
    figures, *differences = block_cells(table, block)
    if any(cell != "-" for cells in held.values() for cell in cells):
        headings, lines = figures
        lines = [
            [*cells, *held.get(row.spec, ["-"] * len(_HELD))]
            for row, cells in zip(block.rows, lines, strict=True)
        ]
        figures = ([*headings, *_HELD], lines)
    compared = [row for row in block.rows if row.differences]
    notes = table_notes(table)
    if len(index) < len(block.rows):
        notes.append(
            f"{len(index)} arms, those with a colour, can be compared and watched below; to see "
            "others so, name fewer runs, or arms of them (RUN:with_dos)."
        )
    return {
        "tables": [
            {
                "headings": headings,
                "rows": [
                    {"side": index.get(row.spec), "cells": cells}
                    for row, cells in zip(rows, lines, strict=True)
                ],
            }
            for (headings, lines), rows in zip(
                (figures, *differences), (block.rows, compared), strict=False
            )
        ],
        "notes": notes,
        "plot": Markup(frontier_plot(table, index)),  # noqa: S704 - drawn by matplotlib
    }


def group_tables(cases: Sequence[Case], sides: int) -> list[tuple[str, list[dict[str, Any]]]]:
    """Breaks outcomes down by kind, and by family unless that is the same by another name.

    Args:
        cases: The cases.
        sides: Number of sides.

    Returns:
        Titles, with rows as of ``findings.groups``.
    """
    pairs = {(case.kind, case.family) for case in cases}
    kinds, families = ({pair[i] for pair in pairs} for i in (0, 1))
    found = [("Kind", findings.groups(cases, lambda case: case.kind, sides))]
    if not len(pairs) == len(kinds) == len(families):
        found.append(("Family", findings.groups(cases, lambda case: case.family, sides)))
    return found


def _plots(pairing: Pairing, cases: Sequence[Case]) -> list[tuple[str, Markup]]:
    names = [side.name for side in pairing.sides]

    cycles = {name: findings.pooled_cycle_ms(cases, side) for side, name in enumerate(names)}
    drawn = [
        (metric.title, histogram(_values(metric, pairing), metric.unit, bounds=metric.bounds))
        for metric in metrics.METRICS
        if metric.plotted
    ]
    if any(len(times) for times in cycles.values()):
        drawn.append(("Cycle time, predict and plan", histogram(cycles, "ms", log=True)))
    return [(title, Markup(svg)) for title, svg in drawn]  # noqa: S704 - drawn by matplotlib


def _values(metric: Metric, pairing: Pairing) -> dict[str, FloatArray]:
    return {side.name: metric.values(tuple(side.rows.values())) for side in pairing.sides}


def _notes(examined: Sequence[tuple[Pairing, Sequence[Case]]]) -> list[str]:
    """Notes on what is missing in the page."""
    notes = []
    for pairing, cases in examined:
        if pairing.scenes.problem is not None:
            notes.append(
                "The scenario files were not found, so episodes are drawn without road and road "
                f"users, and coverage is not known: {pairing.scenes.problem}"
            )
        lost = sum(case.payload is not None and not any(case.met) for case in cases)
        if lost and pairing.scenes.problem is None:
            notes.append(
                f"{lost} of {len(cases)} episodes are drawn without road and road users: their "
                "scenario files are gone, or are not those that were driven."
            )
        if len(cases) > MOST_EXAMINED:
            notes.append(
                f"{MOST_EXAMINED} of {len(cases)} {pairing.unit} can be played, those that differ "
                "or failed first; coverage and cycle times are over them."
            )
    return list(dict.fromkeys(notes))


def _data(examined: Sequence[tuple[Pairing, Sequence[Case]]], room: int) -> str:
    """The block of JSON; episodes are put in as long as there is room, the urgent ones first."""
    data: dict[str, Any] = {
        "kinds": [[kind.value, KIND_COLOURS[kind]] for kind in KINDS],
        "goal": GOAL_COLOUR,
        "lamps": LAMP_COLOURS,
        "signs": {"rim": LAMP_RIM, "red": SIGN_RED, "yellow": SIGN_YELLOW},
        "outcomes": {outcome.value: word for outcome, word in OUTCOME_WORDS.items()},
        "thumbnail": [WIDTH, HEIGHT],
        "faster": FASTER,
        "sections": [
            {
                "names": [side.name for side in pairing.sides],
                "views": pairing.views,
                "cases": [_row(case, pairing.futures > 1) for case in cases],
            }
            for pairing, cases in examined
        ],
    }
    room -= len(_json(data))
    for section, (_, cases) in zip(data["sections"], examined, strict=True):
        for row, case in zip(section["cases"], cases, strict=True):
            taken = len(f',"episode":"{case.payload}"')
            if case.payload is not None and taken <= room:
                row["episode"] = case.payload
                room -= taken
    return _json(data)


def _row(case: Case, several: bool) -> dict[str, Any]:
    return {
        "id": case.driven.scenario,
        "future": case.driven.future if several else None,
        "family": case.family,
        "road": case.kind,
        "thumb": case.thumbnail,
        "sides": [
            {
                "outcome": row.outcome.value,
                "fault": row.at_fault,
                "velocity": round(row.velocity, 2) if row.steps else None,
                "ttc": None
                if row.min_time_to_collision is None
                else round(row.min_time_to_collision, 2),
                "p99": None if row.cycle_ms_p99 is None else round(row.cycle_ms_p99),
                "why": why,
            }
            for row, why in zip(case.rows, case.why, strict=True)
        ],
        "notes": case.notes,
    }


def _json(value: Any) -> str:
    """JSON that cannot end the element it stands in, whatever its texts hold."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def _static(name: str) -> str:
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")


@cache
def _template() -> Any:
    loader = PackageLoader(__package__, "static")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    return environment.get_template("page.html.jinja")
