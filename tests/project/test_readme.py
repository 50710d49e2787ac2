"""What the README says is what the code does."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

from dosplan.results.rows import read_rows
from dosplan.types import Arm, Outcome

ROOT = Path(__file__).parents[2]


PROOF = ROOT / "results" / "proof"


PAGES: dict[str, Any] = runpy.run_path(str(ROOT / "results" / "pages.py"))


@pytest.mark.parametrize("page", PAGES["pages"](), ids=lambda page: page.parent.name)
def test_tables_are_those_of_the_published_runs(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert PAGES["written"](text) == text, "python results/pages.py makes them anew"


def test_every_mark_on_a_page_is_one_of_a_table() -> None:
    names: list[str] = []
    for page in (ROOT / "README.md", *(ROOT / "results").glob("*/README.md")):
        text = page.read_text(encoding="utf-8")
        found = PAGES["MARKS"].findall(text)
        assert len(found) == text.count(": begin -->") == text.count(": end -->"), page
        names += [f"{kind} {run}" for _, kind, run, *_ in found]
    assert {"summary suite", "summary recorded", "paper suite", "proof proof"} <= set(names)
    assert {"comparison suite", "comparison suite-1", "comparison recorded"} <= set(names)


def test_the_proof_is_told_as_it_was_judged() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    cells = json.loads((PROOF / "proof.json").read_text(encoding="utf-8"))["cells"]
    assert len(cells) == 10
    for cell in cells:
        if cell["traffic"] != "replay":
            continue
        scenarios = "fresh" if cell["scenarios"] == "fresh" else "public"
        (row,) = (
            line
            for line in text.splitlines()
            if line.startswith((f"| {scenarios}, ", f"| **{scenarios}, "))
            and f"{cell['loop']}" in line
        )
        assert f"| {cell['without']} → {cell['with_sets']} of {cell['n']} " in row
        assert f"{100 * cell['success']['a']:.1f} → {100 * cell['success']['b']:.1f}" in row


@pytest.mark.parametrize(
    ("run", "n"),
    [
        ("suite", 300),
        ("suite/realistic", 300),
        ("suite/five-futures", 750),
        ("suite-1", 150),
        ("recorded", 150),
        ("recorded/realistic", 150),
        *(
            (f"proof/runs/loop={loop},scenarios={scenarios},traffic={traffic}", n)
            for loop in ("late", "realistic")
            for traffic in ("replay", "reactive")
            for scenarios, n in (("fresh", 750), ("bench", 150))
        ),
        ("proof/runs/loop=late,scenarios=fresh,traffic=sumo", 750),
        ("proof/runs/loop=realistic,scenarios=fresh,traffic=sumo", 750),
    ],
)
def test_published_figures_follow_from_their_rows(run: str, n: int) -> None:
    folder = ROOT / "results" / run
    rows = read_rows(folder / "scenarios.jsonl")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for arm in Arm:
        mine = [row for row in rows if row.arm is arm]
        assert len(mine) == summary[arm]["n"] == n
        share = sum(row.outcome is Outcome.SUCCESS for row in mine) / n
        assert summary[arm]["success_rate"] == pytest.approx(share)
        share = sum(row.outcome is Outcome.COLLISION for row in mine) / n
        assert summary[arm]["collision_rate"] == pytest.approx(share)
