"""What the README says is what the code does."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dosplan.results.rows import read_rows
from dosplan.types import Arm, Outcome

ROOT = Path(__file__).parents[2]


PROOF = ROOT / "results" / "proof"


@pytest.mark.parametrize("run", ["suite", "recorded"])
def test_tables_are_those_of_the_published_runs(run: str) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = text.split(f"<!-- {run} table: begin -->", 1)[1].split(f"<!-- {run} table: end -->")[0]
    summary = (ROOT / "results" / run / "summary.md").read_text(encoding="utf-8")
    first = next(block for block in summary.split("\n\n") if block.startswith("|"))
    assert shown.strip() == first


def test_the_proof_is_told_as_it_was_judged() -> None:
    table = (PROOF / "proof.md").read_text(encoding="utf-8").strip()
    assert table in (PROOF / "README.md").read_text(encoding="utf-8")
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
        ("suite/five-futures", 750),
        ("suite-1", 150),
        ("recorded", 150),
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
