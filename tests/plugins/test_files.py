"""Plug-ins from files: their neighbours are theirs alone, and belong to what is run."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from dosplan.cli.command import OK
from dosplan.cli.main import main
from dosplan.plugins.files import local_modules
from dosplan.plugins.registry import (
    RegistryError,
    choose_planner,
    choose_predictor,
    create_planner,
    find_planner,
    record,
    source_files,
)
from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_rows
from dosplan.running.config import RunConfig, RunError
from dosplan.running.run import run
from dosplan.types import Outcome
from tests.support.runs import write_reached_and_missed

PLANNER = """\
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dosplan.api import Planner
from dosplan.types import Plan
from dosplan.vehicle import VehicleParameters
{imports}

@dataclass(frozen=True)
class Settings:
    steps: int = 5


class Mine(Planner):
    name = "mine-v1"
    settings = Settings

    def __init__(self, *, seed=0, settings=Settings()):
        super().__init__(seed=seed, settings=settings)
        self.steps = settings.steps

    def compute_plan(self, observation, occupancy):
        {late}
        states, inputs = [observation.ego], np.tile([0.0, {acceleration}], (self.steps, 1))
        for u in inputs:
            states.append(VehicleParameters().step(states[-1], u, observation.dt))
        return Plan(states=np.stack(states), inputs=inputs)
"""


def write_plugin(
    folder: Path,
    imports: str = "import tuning",
    acceleration: str = "tuning.ACCELERATION",
    late: str = "",
    value: float = 1.0,
) -> str:
    """A planner in a folder of its own, and the neighbour that says how it accelerates."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "mine.py").write_text(
        PLANNER.format(imports=imports, acceleration=acceleration, late=late)
    )
    (folder / "tuning.py").write_text(f"ACCELERATION = {value}\n")
    return f"{folder / 'mine.py'}:Mine"


def tuning_of(spec: str) -> float:
    value = vars(sys.modules[find_planner(spec).__module__])["tuning"].ACCELERATION
    assert isinstance(value, float)
    return value


def test_neighbours_of_one_name_do_not_meet(tmp_path: Path) -> None:
    one = write_plugin(tmp_path / "one", value=1.0)
    two = write_plugin(tmp_path / "two", value=2.0)
    before = list(sys.path)
    assert (tuning_of(one), tuning_of(two), tuning_of(one)) == (1.0, 2.0, 1.0)
    assert "tuning" not in sys.modules
    assert sys.path == before
    assert not list(tmp_path.rglob("*.pyc"))


def test_files_of_names_that_are_alike_do_not_meet(tmp_path: Path) -> None:
    plugin = write_plugin(tmp_path, imports="", acceleration="1.0").partition(":")[0]
    wanted = {"a.b.py": 3, "a_b.py": 4, "a-b.py": 5}
    for name, steps in wanted.items():
        text = Path(plugin).read_text().replace("steps: int = 5", f"steps: int = {steps}")
        (tmp_path / name).write_text(text)
    found = {name: create_planner(f"{tmp_path / name}:Mine", 0, {}) for name in wanted}
    assert {name: vars(planner)["steps"] for name, planner in found.items()} == wanted


@pytest.mark.parametrize(
    ("imports", "acceleration", "late"),
    [
        ("from tuning import ACCELERATION as A", "A", ""),
        ("from . import tuning", "tuning.ACCELERATION", ""),
        ("from .tuning import ACCELERATION", "ACCELERATION", ""),
        ("import parts.engine", "parts.engine.tuning.ACCELERATION", ""),
        ("import parts.engine as engine", "engine.tuning.ACCELERATION", ""),
        ("from parts import engine", "engine.tuning.ACCELERATION", ""),
        ("from parts.engine import tuning", "tuning.ACCELERATION", ""),
        ("", "tuning.ACCELERATION", "import tuning"),
        ("", "A", "from tuning import ACCELERATION as A"),
    ],
)
def test_every_way_to_import_a_neighbour(
    imports: str, acceleration: str, late: str, tmp_path: Path
) -> None:
    spec = write_plugin(tmp_path, imports, acceleration, late)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "__init__.py").write_text("import numpy\n")
    (tmp_path / "parts" / "engine.py").write_text("from . import other\nimport tuning\n")
    (tmp_path / "parts" / "other.py").write_text("")
    (tmp_path / "unused.py").write_text("raise AssertionError\n")
    assert main(["check", spec]) == OK
    files = {path.relative_to(tmp_path).as_posix() for path in source_files(choose_planner(spec))}
    package = {"parts/__init__.py", "parts/engine.py", "parts/other.py"}
    assert files == {"mine.py", "tuning.py"} | (package if "parts" in imports else set())


def test_a_neighbour_comes_before_what_is_installed(tmp_path: Path) -> None:
    spec = write_plugin(tmp_path, "import shapely\nimport dosplan_mpc", "shapely.ACCELERATION")
    (tmp_path / "shapely.py").write_text("ACCELERATION = 3.0\n")
    (tmp_path / "dosplan_mpc.py").write_text("raise AssertionError\n")
    module = sys.modules[find_planner(spec).__module__]
    assert vars(module)["shapely"].ACCELERATION == 3.0
    assert not hasattr(sys.modules["shapely"], "ACCELERATION")
    assert vars(module)["dosplan_mpc"] is sys.modules["dosplan_mpc"]  # Plug-ins are shared.


def test_a_folder_that_holds_dosplan_too_does_not_load_it_twice(tmp_path: Path) -> None:
    (tmp_path / "dosplan").mkdir()
    (tmp_path / "dosplan" / "__init__.py").write_text("raise AssertionError\n")
    assert find_planner(write_plugin(tmp_path)).name == "mine-v1"


def test_what_was_changed_is_loaded_anew_and_nothing_else(tmp_path: Path) -> None:
    spec = write_plugin(tmp_path, value=1.0)
    first = find_planner(spec)
    assert find_planner(spec) is first
    write_plugin(tmp_path, value=2.0)
    assert find_planner(spec) is not first
    assert tuning_of(spec) == 2.0


def test_two_plugins_of_a_folder_share_their_neighbours(tmp_path: Path) -> None:
    one = write_plugin(tmp_path)
    shutil.copy(tmp_path / "mine.py", tmp_path / "other.py")
    planners = [find_planner(one), find_planner(f"{tmp_path / 'other.py'}:Mine")]
    modules = [vars(sys.modules[planner.__module__])["tuning"] for planner in planners]
    assert modules[0] is modules[1]
    assert find_planner(one) is planners[0]


def test_a_neighbour_that_fails_is_told_and_forgotten(tmp_path: Path) -> None:
    spec = write_plugin(tmp_path, "import tuning, broken")
    (tmp_path / "broken.py").write_text("import no_such_module\n")
    with pytest.raises(RegistryError, match="No module named 'no_such_module'"):
        find_planner(spec)
    (tmp_path / "broken.py").write_text("")
    (tmp_path / "tuning.py").write_text("ACCELERATION = 2.0\n")
    assert tuning_of(spec) == 2.0


def test_files_that_import_each_other_are_named_once(tmp_path: Path) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.py").write_text(f"import {other}\n")
    both = [tmp_path / "a.py", tmp_path / "b.py"]
    assert local_modules(tmp_path / "a.py", frozenset()) == both
    assert local_modules(tmp_path / "a.py", frozenset({"b"})) == both[:1]


def test_workers_drive_with_the_neighbours_and_a_changed_one_is_another_run(tmp_path: Path) -> None:
    write_plugin(tmp_path / "elsewhere", value=-5.0)
    # From 10 m/s the goal is reached at this acceleration, and not at -5 m/s2.
    late = "import tuning"
    spec = write_plugin(tmp_path / "mine", "", late=late, value=0.0)
    (tmp_path / "scenes").mkdir()
    scenes = write_reached_and_missed(tmp_path / "scenes")
    config = RunConfig(
        out=tmp_path / "run", source=str(scenes), planner=spec, predictor="none", limit=1
    )
    folder = run(config)
    assert {row.outcome for row in read_rows(folder.rows)} == {Outcome.SUCCESS}
    other = replace(config, out=tmp_path / "other", planner=f"{tmp_path}/elsewhere/mine.py:Mine")
    rows = read_rows(run(other).rows)
    assert {row.outcome for row in rows} != {Outcome.SUCCESS}
    (tmp_path / "mine" / "tuning.py").write_text("ACCELERATION = 0.0  # As before.\n")
    with pytest.raises(RunError, match="another content of its plug-in, weight or"):
        run(config)
    assert read_rows(RunFolder(config.out).rows)


def test_a_file_within_a_plugin_is_part_of_it(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("")
    (tmp_path / "mine.py").write_text(
        "import helper\n"
        "from dosplan_simple.predictors import ConstantVelocityPredictor\n"
        "class Mine(ConstantVelocityPredictor): name = 'mine-v1'\n"
    )
    chosen = choose_predictor("growing-circle", {"base": f"{tmp_path / 'mine.py'}:Mine"})
    assert source_files(chosen) == [tmp_path / "helper.py", tmp_path / "mine.py"]
    again = choose_predictor("growing-circle", record(chosen))
    assert again == chosen
    assert create_planner("cruise", 0).look_ahead == 1
