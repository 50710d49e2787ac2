"""The registry finds plug-ins in every form it promises, and says in one line why it does not."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from dosplan.api import Planner, Predictor
from dosplan.plugins import registry
from dosplan.plugins.registry import (
    PluginInfo,
    PluginKind,
    RegistryError,
    create_planner,
    create_predictor,
    create_traffic,
    find_planner,
    find_predictor,
    list_plugins,
)
from tests.support.plugins import PLUGINS


def _offer(monkeypatch: pytest.MonkeyPatch, *targets: tuple[str, str]) -> None:
    """Makes ``entry_points`` return planners of these names and targets."""
    found = EntryPoints(EntryPoint(name, value, "dosplan.planners") for name, value in targets)
    monkeypatch.setattr(registry, "entry_points", lambda group: found.select(group=group))


def test_built_in_plugins_are_listed_with_their_distribution() -> None:
    assert PluginInfo("mpc", "dosplan_mpc.planner:MpcPlanner", "dosplan") in list_plugins(
        PluginKind.PLANNER
    )
    assert "growing-circle" in {plugin.name for plugin in list_plugins(PluginKind.PREDICTOR)}


def test_listing_imports_no_plugin() -> None:
    code = (
        "import sys; from dosplan.plugins.registry import *; "
        "[list_plugins(kind) for kind in PluginKind]; "
        "print([m for m in sys.modules if m.startswith('dosplan_')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_entry_point_name_is_found() -> None:
    found = find_predictor("constant-velocity")
    assert issubclass(found, Predictor)
    assert found.__module__ == "dosplan_simple.predictors"


def test_module_and_class_are_found() -> None:
    found = find_planner("tests.support.plugins:CoastPlanner")
    assert found.__name__ == "CoastPlanner"


def test_file_and_class_are_found_and_built_with_the_seed() -> None:
    planner = create_planner(f"{PLUGINS}:CoastPlanner", seed=7)
    predictor = create_predictor(f"{PLUGINS}:StillPredictor", seed=8)
    assert isinstance(planner, Planner)
    assert (planner.name, planner.seed, predictor.seed) == ("coast-v1", 7, 8)


def test_a_file_can_use_its_own_dataclasses(tmp_path: Path) -> None:
    # dataclasses with postponed annotations look their module up in sys.modules.
    file = tmp_path / "mine.py"
    file.write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "from typing import ClassVar\n"
        "from dosplan.api import Planner\n"
        "@dataclass\n"
        "class Tuning:\n"
        "    kind: ClassVar[int] = 1\n"
        "    gain: float = 2.0\n"
        "class Mine(Planner):\n"
        "    name = 'mine-v1'\n"
        "    def compute_plan(self, observation, occupancy):\n"
        "        raise NotImplementedError\n"
    )
    assert find_planner(f"{file}:Mine").name == "mine-v1"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("growing-circle", "no planner is called 'growing-circle'"),
        ("mcp", "no planner is called 'mcp'; did you mean 'mpc'?"),
        ("no.such.module:Planner", "cannot be imported: ModuleNotFoundError"),
        ("no_such.py:Planner", "there is no file no_such.py"),
        (":Planner", "expected a name, module:Class or path/to/file.py:Class"),
        ("dosplan.api:", "expected a name"),
        (f"{PLUGINS}:CoastPlaner", "has no CoastPlaner; did you mean 'CoastPlanner'?"),
        (f"{PLUGINS}:Coast", f"{PLUGINS} has no Coast; it has CoastPlanner"),
        (f"{PLUGINS}", f"{PLUGINS}: name the class, too, as {PLUGINS}:CoastPlanner"),
        ("no_such.py", "there is no file no_such.py"),
        (f"{PLUGINS}:StillPredictor", "is not a subclass of dosplan.api.Planner"),
        (f"{PLUGINS}:HORIZON", "is not a subclass of dosplan.api.Planner"),
        ("dosplan.api:Planner", "is not a subclass of dosplan.api.Planner"),
    ],
)
def test_a_wrong_spec_is_explained_in_one_line(spec: str, message: str) -> None:
    with pytest.raises(RegistryError) as caught:
        find_planner(spec)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("1 / 0", "cannot be imported: ZeroDivisionError: division by zero"),
        ("import sys; sys.exit(5)", "cannot be imported: SystemExit: 5"),
        ("class P(Planner): name = 'p-v1'", "does not implement compute_plan"),
        ("class P(Planner):\n def compute_plan(self, o, s): ...", "has no name; give its class"),
    ],
)
def test_a_broken_file_is_explained_in_one_line(tmp_path: Path, source: str, message: str) -> None:
    file = tmp_path / "broken.py"
    file.write_text(f"from dosplan.api import Planner\n{source}\n")
    with pytest.raises(RegistryError) as caught:
        find_planner(f"{file}:P")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_constructor_that_raises_is_explained() -> None:
    with pytest.raises(RegistryError, match=r"cannot be built: OSError: the weights are missing"):
        create_planner(f"{PLUGINS}:UnbuildablePlanner", seed=0)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["def __init__(self, gap=10.0):", " super().__init__()", " self.gap = gap"],
            r"unexpected keyword argument 'seed'.*; its constructor must take seed, settings\. "
            r"Options are the fields of a frozen dataclass.*: settings = MySettings",
        ),
        (
            ["def __init__(self, *, seed=0, settings=NoSettings()):", " self.gap = settings.gap"],
            r"'NoSettings' object has no attribute 'gap' .*\. Options are the fields of a frozen",
        ),
    ],
)
def test_options_that_are_declared_otherwise_are_explained(
    tmp_path: Path, lines: list[str], message: str
) -> None:
    file = tmp_path / "odd.py"
    body = "\n ".join(["name = 'odd-v1'", *lines, "def compute_plan(self, o, s): ..."])
    file.write_text(f"from dosplan.api import NoSettings, Planner\nclass P(Planner):\n {body}\n")
    with pytest.raises(RegistryError, match=message):
        create_planner(f"{file}:P", seed=0)
    with pytest.raises(RegistryError, match=r"options: none\. Options are the fields of a frozen"):
        create_planner(f"{file}:P", seed=0, options={"gap": 5.0})


def test_the_settings_of_an_instance_are_its_own() -> None:
    assert create_planner("mpc", 0, {"sampler.lane": 2.0}).settings.sampler.lane == 2.0
    assert create_predictor("fixed-circle", 0, {"r": 3.0}).settings.r == 3.0
    reactive = create_traffic("reactive", 0, {"full_braking": 7.0})
    assert reactive.settings.full_braking == 7.0


def test_a_name_offered_twice_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _offer(monkeypatch, ("mine", "first.module:Mine"), ("mine", "second.module:Mine"))
    assert len(list_plugins(PluginKind.PLANNER)) == 2
    with pytest.raises(RegistryError, match=r"'mine' is offered 2 times \(first.*second.*\)"):
        find_planner("mine")


def test_an_installed_plugin_that_is_broken_costs_only_those_who_name_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _offer(monkeypatch, ("bad", "no.such:Thing"), ("good", "tests.support.plugins:CoastPlanner"))
    assert find_planner("good").name == "coast-v1"
    with pytest.raises(RegistryError, match="planner 'bad' cannot be imported"):
        find_planner("bad")
