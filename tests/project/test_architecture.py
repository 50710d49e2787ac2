"""The one-way imports that the design promises."""

from __future__ import annotations

import ast
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from dosplan.plugins.registry import PluginKind, find_plugin
from tests.support.peers import is_missing

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "dosplan"
PLUGIN_PACKAGES = {
    folder.name
    for parent in ("planners", "predictors")
    for folder in (ROOT / parent).iterdir()
    if (folder / "__init__.py").is_file()
}
PEERS = "dosplan_peers"  # The adapters of planners that are CommonRoad's themselves.
FILES = sorted(PACKAGE.rglob("*.py"))


def _imports(file: Path) -> set[str]:
    """Top-level names of everything a file imports, at whatever depth."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file} imports relatively"
            names.add(str(node.module))
    return {name.partition(".")[0] for name in names}


def test_the_walk_sees_imports_at_any_depth(tmp_path: Path) -> None:
    file = tmp_path / "probe.py"
    file.write_text("import a.b\ndef f():\n    from c.d import e\n")
    assert _imports(file) == {"a", "c"}


def test_the_plugin_packages_are_found() -> None:
    assert {"dosplan_mpc", "dosplan_baseline", "dosplan_simple"} <= PLUGIN_PACKAGES


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_the_benchmark_imports_no_plugin(file: Path) -> None:
    assert not _imports(file) & PLUGIN_PACKAGES


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_only_the_scenario_package_imports_commonroad(file: Path) -> None:
    foreign = {name for name in _imports(file) if name.startswith(("commonroad", "crcommonroad"))}
    assert not foreign or file.is_relative_to(PACKAGE / "scenario")


@pytest.mark.parametrize(
    "file",
    sorted(f for p in PLUGIN_PACKAGES for f in ROOT.glob(f"*/{p}/**/*.py")),
    ids=lambda file: str(file.relative_to(ROOT)),
)
def test_no_plugin_imports_another_kind_of_plugin_or_commonroad(file: Path) -> None:
    parent = file.relative_to(ROOT).parts[0]
    siblings = {folder.name for folder in (ROOT / parent).iterdir()}
    assert not _imports(file) & (PLUGIN_PACKAGES - siblings)
    assert PEERS in file.parts or not any(n.startswith("commonroad") for n in _imports(file))


@pytest.mark.parametrize("kind", list(PluginKind))
def test_every_entry_point_of_this_distribution_resolves(kind: PluginKind) -> None:
    ours = [e for e in entry_points(group=kind.group) if e.dist and e.dist.name == "dosplan"]
    assert ours
    here = [e for e in ours if not is_missing(e.name)]
    names = [find_plugin(kind, e.name).name for e in here]
    assert len(set(names)) == len(names), "versioned names must tell plug-ins apart"
    assert all(e.module.partition(".")[0] in sys.modules for e in here)
