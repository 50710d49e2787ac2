"""The examples do what they say, in a folder of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
SHOWN = {
    "own_planner": "runs/example-coast:with_dos against runs/example-idm:with_dos: success",
    "own_predictor": "widest set 0.0 m",  # In the arm without sets.
    "own_scenarios": "runs/busy/solutions/ZAM_",
    "coverage_ablation": "    0.90  ",
}


def test_every_example_is_tried() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SHOWN)


@pytest.mark.parametrize("name", SHOWN)
def test_an_example_is_short_and_runs(name: str, tmp_path: Path) -> None:
    path = EXAMPLES / f"{name}.py"
    assert len(path.read_text(encoding="utf-8").splitlines()) < 40
    done = subprocess.run(
        [sys.executable, str(path)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert SHOWN[name] in done.stdout
    assert "planner_failure" not in done.stdout
