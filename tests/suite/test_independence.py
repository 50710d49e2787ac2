"""No planner that is compared and no trained predictor has a say in what the suite holds."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"
COMPARED = {"dosplan_mpc", "dosplan_dos", "dosplan_net", "dosplan_wale", "dosplan_peers"}
"""The planner and the predictors whose worth the suite is to show, and those of others."""
LEARNT = {"torch", "casadi", "onnxruntime"}
"""What they cannot do without."""

IMPORT_ALL = """
import importlib, pkgutil
import suite, suitegen
for module in pkgutil.walk_packages(suitegen.__path__, "suitegen."):
    importlib.import_module(module.name)
"""
JUDGE = """
from suitegen.futures.search import find_drive
from suitegen.futures.verdict import Accepted, in_future, judge
from tests.support.futures import steps_out
scenario = steps_out(20.0)
drive = find_drive(in_future(scenario, 0))
assert isinstance(judge(scenario, [drive, drive]), Accepted)
"""


def loaded_by(code: str) -> set[str]:
    """Packages that are loaded after some code has run in an interpreter of its own."""
    told = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(SCENARIOS), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    return {name.partition(".")[0] for name in told.stdout.split()}


def test_the_generator_loads_nothing_that_is_compared() -> None:
    pytest.importorskip("sumo", reason="the generator needs dosplan[suite]")
    pytest.importorskip("libsumo", reason="the generator needs dosplan[suite]")
    loaded = loaded_by(IMPORT_ALL)
    assert {"suitegen", "dosplan_baseline", "dosplan_simple"} <= loaded
    assert not loaded & (COMPARED | LEARNT)


def test_a_verdict_is_reached_without_what_is_compared() -> None:
    """Whatever is imported or found by its name only on the way is seen here."""
    loaded = loaded_by(JUDGE)
    assert "suitegen" in loaded
    assert not loaded & (COMPARED | LEARNT)


@pytest.mark.parametrize(
    "file",
    [SCENARIOS / "suite.py", *sorted((SCENARIOS / "suitegen").rglob("*.py"))],
    ids=lambda file: file.relative_to(SCENARIOS).as_posix(),
)
def test_no_import_names_what_is_compared(file: Path) -> None:
    """Imports inside functions as well."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names = {node.module or ""}
        else:
            continue
        assert not {name.partition(".")[0] for name in names} & (COMPARED | LEARNT)
        # By name, a plug-in would be found among the entry points.
        assert not any(name.startswith(("dosplan.plugins", "dosplan.running")) for name in names)
