"""What the README says is what the code does."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

import dosplan.scoring.score
from dosplan.cli.main import main
from dosplan.results.rows import read_rows
from dosplan.system.files import read_json
from dosplan.types import Arm, Outcome
from tests.support.scenes import write_scenario_xml

ROOT = Path(__file__).parents[2]


def test_definitions_are_those_of_the_scorer() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.split("## Definitions", 1)[1].split("\n## ", 1)[0].strip()
    assert section.startswith("- **Two arms.**")
    assert section in (dosplan.scoring.score.__doc__ or "")


def test_own_planner_of_the_readme_is_checked_and_driven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.split("## Your own planner", 1)[1].split("\n## ", 1)[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (commands,) = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    check, drive = (shlex.split(line, comments=True)[1:] for line in commands.splitlines())
    assert len((code + commands).splitlines()) < 40
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(code, encoding="utf-8")
    assert main(check) == 0, capsys.readouterr().out

    write_scenario_xml(Path("ZAM_Test-0_1_T-1.xml"), benchmark_id="ZAM_Test-0_1_T-1")
    small = ["ZAM_Test-0_1_T-1.xml", "--predictor", "constant-velocity", "--in-process"]
    assert main([*drive, *small, "--out", "run"]) == 0
    assert read_json(Path("run/run.json"))["config"]["planner_options"] == {"gap": 12}
    wrong = [*drive[:-1], "planner.gab=12", *small]
    assert main(wrong) == 2
    assert "did you mean 'gap'?" in capsys.readouterr().err


@pytest.mark.parametrize("run", ["suite-1", "recorded"])
def test_tables_are_those_of_the_published_runs(run: str) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = text.split(f"<!-- {run} table: begin -->", 1)[1].split(f"<!-- {run} table: end -->")[0]
    summary = (ROOT / "results" / run / "summary.md").read_text(encoding="utf-8")
    blocks = [block for block in summary.split("\n\n") if block.startswith("| Arm")]
    assert shown.strip() == "\n\n".join(blocks[:2])


@pytest.mark.parametrize("run", ["suite-1", "recorded"])
def test_published_figures_follow_from_their_rows(run: str) -> None:
    folder = ROOT / "results" / run
    rows = read_rows(folder / "scenarios.jsonl")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for arm in Arm:
        mine = [row for row in rows if row.arm is arm]
        assert len(mine) == summary[arm]["n"] == 150
        share = sum(row.outcome is Outcome.SUCCESS for row in mine) / 150
        assert summary[arm]["success_rate"] == pytest.approx(share)
        share = sum(row.outcome is Outcome.COLLISION for row in mine) / 150
        assert summary[arm]["collision_rate"] == pytest.approx(share)
