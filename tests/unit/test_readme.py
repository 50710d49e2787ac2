"""What the README says is what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import dosplan.scoring
from dosplan.cli import main

ROOT = Path(__file__).parents[2]


def test_definitions_are_those_of_the_scorer() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.split("## Definitions", 1)[1].split("\n## ", 1)[0].strip()
    assert section.startswith("- **Two arms.**")
    assert section in (dosplan.scoring.__doc__ or "")


def test_own_planner_of_the_readme_passes_the_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(code.splitlines()) < 40
    plugin = tmp_path / "mine.py"
    plugin.write_text(code, encoding="utf-8")
    assert main(["check", f"{plugin}:Coast"]) == 0, capsys.readouterr().out
