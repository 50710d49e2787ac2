"""The rooms of ``docs/architecture.md``: which may import which, and what plug-ins build on."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

import pytest

from dosplan.plugins.registry import PluginKind, find_plugin
from tests.support.peers import is_missing

ROOT: Final = Path(__file__).parents[2]
FLOORS: Final = (
    ("system",),
    ("types",),
    ("geometry", "vehicle"),
    ("api", "scenario"),
    ("simulation", "scoring"),
    ("plugins", "results", "convert"),
    ("running", "evaluation"),
    ("explain", "_public"),
    ("report",),
    ("cli",),
    ("__main__",),
)
"""The rooms, lowest floor first; a room imports rooms of lower floors only."""

PLUGINS_MAY_IMPORT: Final = {
    # The public root, and what is not about driving.
    "api": "*", "types": "*", "vehicle": "*", "geometry": "*", "system": "*",
    # Options, and plug-ins around others.
    "plugins.registry": "*", "plugins.settings": "*",
    # Subcommands that a plug-in's package adds.
    "cli.command": "*/commands.py", "cli.arguments": "*/commands.py",
    "report.progress": "*/commands.py", "plugins.loops": "*/commands.py",
    # What is learned or measured on recordings before a plug-in is used.
    "scenario": "*/training/*, */measure.py, traffic/dosplan_sumo/*",
    "simulation.world": "*/training/*, */measure.py", "simulation.settings": "*/training/*",
    "evaluation.groups": "*/training/*, */calibration.py, */calibrating.py",
    "evaluation.met": "*/training/*",
    # What a traffic is.
    "simulation.traffic": "traffic/*",
}  # fmt: skip
"""What of ``dosplan`` the files of plug-ins may import, and which files may do so."""

PEERS: Final = "dosplan_peers"  # The adapters of planners that are CommonRoad's themselves.


class Sources:
    """The modules below a checkout's root, by name, and what each imports at whatever depth."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.files = dict(self._modules(root, root / "dosplan"))
        self.kinds: dict[str, str] = {}  # Of each plug-in package: the folder that it lies in.
        for kind in ("planners", "predictors", "traffic"):
            for package in sorted((root / kind).glob("*/__init__.py")):
                self.kinds[package.parent.name] = kind
                self.files.update(self._modules(root / kind, package.parent))
        self.imports = {name: set(self._imports(file)) for name, file in self.files.items()}

    @staticmethod
    def _modules(base: Path, package: Path) -> Iterator[tuple[str, Path]]:
        for file in sorted(package.rglob("*.py")):
            name = ".".join(file.relative_to(base).with_suffix("").parts)
            yield name.removesuffix(".__init__"), file

    def _imports(self, file: Path) -> Iterator[str]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{file} imports relatively"
                for alias in node.names:
                    name = f"{node.module}.{alias.name}"
                    # The root's names but its version are for scripts: they are all of dosplan.
                    facade = node.module == "dosplan" and alias.name != "__version__"
                    yield name if name in self.files or facade else str(node.module)

    def core(self) -> Iterable[tuple[str, set[str]]]:
        """The modules of ``dosplan``; not its root, which imports nothing before it is asked."""
        return ((name, to) for name, to in self.imports.items() if name.startswith("dosplan."))

    def plugins(self) -> Iterable[tuple[str, str, set[str]]]:
        """The plug-ins' modules, each after its package."""
        split = ((name.partition(".")[0], name, to) for name, to in self.imports.items())
        return ((package, name, to) for package, name, to in split if package in self.kinds)


def upward_imports(sources: Sources) -> list[str]:
    """Imports of a room on the same floor or above."""
    floor = {room: height for height, rooms in enumerate(FLOORS) for room in rooms}
    found = []
    for name, imported in sources.core():
        room = name.split(".")[1]
        if room not in floor:
            found.append(f"{name} is in no room")
            continue
        for other in sorted(i.split(".")[1] for i in imported if i.startswith("dosplan.")):
            if other != room and floor.get(other, len(FLOORS)) >= floor[room]:
                found.append(f"{name} imports {other}, which is not below {room}")
    return found


def circle(sources: Sources) -> list[str]:
    """Modules that import one another in a circle."""
    graph = {
        name: {i for i in imported if i in sources.files and i != "dosplan"}
        for name, imported in sources.imports.items()
        if name != "dosplan"
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def foreign_imports(sources: Sources) -> list[str]:
    """What ``dosplan`` imports of plug-ins, and of CommonRoad outside of ``scenario``."""
    return [
        f"{name} imports {other}"
        for name, imported in sources.core()
        for other in sorted(imported)
        if other.partition(".")[0] in sources.kinds
        or (other.startswith("commonroad") and not name.startswith("dosplan.scenario."))
    ]


def private_imports(sources: Sources) -> list[str]:
    """What plug-ins import beyond what they may."""
    found = []
    for package, name, imported in sources.plugins():
        file = sources.files[name].relative_to(sources.root).as_posix()
        for other in sorted(imported):
            top, _, rest = other.partition(".")
            if top == "dosplan":
                allowed = not rest or any(
                    f"{rest}.".startswith(f"{may}.")
                    and any(fnmatch(file, pattern) for pattern in where.split(", "))
                    for may, where in PLUGINS_MAY_IMPORT.items()
                )
            elif top in sources.kinds:
                allowed = sources.kinds[top] == sources.kinds[package]
            else:
                allowed = package == PEERS or not top.startswith("commonroad")
            if not allowed:
                found.append(f"{name} imports {other}")
    return found


@pytest.fixture(scope="module")
def sources() -> Sources:
    return Sources(ROOT)


def test_the_sources_are_all_there(sources: Sources) -> None:
    ours = {"dosplan_mpc", "dosplan_baseline", "dosplan_simple", "dosplan_reactive", "dosplan_sumo"}
    assert ours <= sources.kinds.keys()
    assert {room for rooms in FLOORS for room in rooms} <= {
        name.split(".")[1] for name, _ in sources.core()
    }


def test_a_room_imports_only_rooms_below(sources: Sources) -> None:
    assert upward_imports(sources) == []


def test_no_modules_import_one_another_in_a_circle(sources: Sources) -> None:
    assert circle(sources) == []


def test_the_benchmark_imports_no_plugin_and_its_scenarios_alone_commonroad(
    sources: Sources,
) -> None:
    assert foreign_imports(sources) == []


def test_plugins_import_what_is_public_and_nothing_of_the_other_kind(sources: Sources) -> None:
    assert private_imports(sources) == []


BROKEN: Final = {
    "dosplan/__init__.py": "from dosplan._public import run",
    "dosplan/_public.py": "import dosplan.report",
    "dosplan/types.py": "from dosplan.system.errors import Error",
    "dosplan/system/errors.py": "def f():\n    from dosplan import scoring, __version__, run",
    "dosplan/scoring.py": "import dosplan.simulation\nimport dosplan_a.planner\nimport commonroad",
    "dosplan/simulation.py": "",
    "dosplan/report.py": "",
    "dosplan/scenario/reader.py": "import commonroad.scenario",
    "dosplan/attic.py": "",
    "planners/dosplan_a/__init__.py": "",
    "planners/dosplan_a/planner.py": "from dosplan_a.other import x\nimport dosplan.types.planning",
    "planners/dosplan_a/other.py": "if TYPE_CHECKING:\n    from dosplan_a.planner import y",
    "planners/dosplan_a/commands.py": "from dosplan.cli.command import OK\nimport dosplan_b",
    "planners/dosplan_a/deep/x.py": "from dosplan.cli.command import OK\nimport commonroad_dc",
    "predictors/dosplan_b/__init__.py": "import dosplan.scenario.cache, dosplan.apis",
    "predictors/dosplan_b/worlds.py": "from dosplan.simulation.traffic import Traffic",
    "traffic/dosplan_c/__init__.py": "from dosplan.simulation.traffic import Traffic",
}


def test_each_violation_is_seen(tmp_path: Path) -> None:
    for name, text in BROKEN.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    sources = Sources(tmp_path)
    assert upward_imports(sources) == [
        "dosplan._public imports report, which is not below _public",
        "dosplan.attic is in no room",
        "dosplan.scoring imports simulation, which is not below scoring",
        "dosplan.system.errors imports run, which is not below system",
        "dosplan.system.errors imports scoring, which is not below system",
    ]
    assert set(circle(sources)) == {"dosplan_a.other", "dosplan_a.planner"}
    assert foreign_imports(sources) == [
        "dosplan.scoring imports commonroad",
        "dosplan.scoring imports dosplan_a.planner",
    ]
    assert private_imports(sources) == [
        "dosplan_a.commands imports dosplan_b",
        "dosplan_a.deep.x imports commonroad_dc",
        "dosplan_a.deep.x imports dosplan.cli.command",
        "dosplan_b imports dosplan.apis",
        "dosplan_b imports dosplan.scenario.cache",
        "dosplan_b.worlds imports dosplan.simulation.traffic",
    ]


@pytest.mark.parametrize("kind", list(PluginKind))
def test_every_entry_point_of_this_distribution_resolves(kind: PluginKind) -> None:
    ours = [e for e in entry_points(group=kind.group) if e.dist and e.dist.name == "dosplan"]
    assert ours
    here = [e for e in ours if kind is PluginKind.TRAFFIC or not is_missing(e.name)]
    names = [find_plugin(kind, e.name).name for e in here]
    assert len(set(names)) == len(names), "versioned names must tell plug-ins apart"
    assert all(e.module.partition(".")[0] in sys.modules for e in here)
