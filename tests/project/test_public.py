"""What ``import dosplan`` offers is what the commands do, and costs nothing until it is used."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dosplan
from dosplan._public import Results, _spec
from dosplan.cli.main import main
from dosplan.plugins.registry import RegistryError
from dosplan.results.comparison import CompareError
from dosplan.running.config import RunError
from dosplan.running.executor import SerialExecutor
from dosplan.system.files import FileError
from dosplan.types import Arm, Score
from tests.support.plugins import PLUGINS, CoastPlanner, StillPredictor
from tests.support.runs import STILL, untimed, write_scenes


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"), 2)


@pytest.fixture
def results(scenes: Path, tmp_path: Path) -> Results:
    found: Results = dosplan.run_suite(
        scenes, CoastPlanner, STILL, out=tmp_path / "run", executor=SerialExecutor()
    )
    return found


def test_importing_it_imports_nothing_else() -> None:
    code = (
        "import sys, dosplan; dir(dosplan); "
        "assert not {'numpy', 'shapely', 'torch', 'casadi', 'commonroad'} & sys.modules.keys(); "
        "dosplan.run_suite, dosplan.load_scenario; "
        "assert not {'torch', 'casadi', 'commonroad', 'polars', 'pandas'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_name_it_lists_is_there() -> None:
    assert set(dosplan.__all__) <= set(dir(dosplan))
    for name in dosplan.__all__:
        assert callable(getattr(dosplan, name))
    with pytest.raises(AttributeError, match="module 'dosplan' has no attribute 'run_sweet'"):
        _ = dosplan.run_sweet


def test_an_episode_is_that_of_a_run(scenes: Path, results: Results) -> None:
    ref = dosplan.find_scenarios(scenes)[0]
    scenario = dosplan.load_scenario(ref)
    for arm in Arm:
        driven = dosplan.run_episode(scenario, CoastPlanner(), StillPredictor(), arm.value)
        (row,) = (row for row in results.rows if (row.scenario, row.arm) == (ref.id, arm))
        untimed_row = replace(driven.row, cycle_ms_p50=None, cycle_ms_p99=None)
        assert untimed_row == replace(row, cycle_ms_p50=None, cycle_ms_p99=None)
        recording = results.recording(ref.id, arm.value)
        np.testing.assert_array_equal(recording.states, driven.episode.states)


def test_plug_ins_of_an_episode_may_be_names(scenes: Path) -> None:
    scenario = dosplan.load_scenario(dosplan.find_scenarios(scenes)[0])
    named = dosplan.run_episode(scenario, "cruise", "none", loop_options={"period": 0.5})
    assert len(named.episode.plans) == -(-named.row.steps // 5)
    with pytest.raises(RegistryError, match="did you mean 'cruise'"):
        dosplan.run_episode(scenario, "cruize", "none")
    with pytest.raises(ValueError, match="sideways"):
        dosplan.run_episode(scenario, "cruise", "none", "sideways")


def test_a_run_is_that_of_the_command(
    scenes: Path, results: Results, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plugins = ["--planner", "tests.support.plugins:CoastPlanner", "--predictor", STILL]
    assert (
        main(["run", str(scenes), *plugins, "--out", str(tmp_path / "command"), "--in-process"])
        == 0
    )
    assert untimed(tmp_path / "command") == untimed(results.path)
    assert results.manifest.config.planner == "tests.support.plugins:CoastPlanner"
    assert results.manifest.config.cache
    opened = dosplan.open_run(results.path)
    assert opened == results
    assert opened.summary.arms[Arm.WITH_DOS]["n"] == 2


def test_settings_are_those_of_a_run(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done: list[int] = []
    found = dosplan.run_suite(
        scenes,
        CoastPlanner,
        STILL,
        limit=1,
        solutions=True,
        progress=lambda d, _: done.append(d),
        executor=SerialExecutor(),
    )
    assert len(found.rows) == 2
    assert done == [0, 1, 2]
    assert found.path.parent == Path("runs")
    assert len(list((found.path / "solutions").iterdir())) == 2
    with pytest.raises(TypeError, match="limits"):
        dosplan.run_suite(scenes, limits=1)
    with pytest.raises(RunError, match="limit is 0"):
        dosplan.run_suite(scenes, limit=0)


def test_runs_are_compared_however_they_are_given(
    scenes: Path, results: Results, tmp_path: Path
) -> None:
    (arms,) = dosplan.compare(results)
    assert (arms.n, arms.differences["success"].difference) == (2, 0.0)
    slow = dosplan.run_suite(
        scenes,
        f"{PLUGINS}:CoastPlanner",
        STILL,
        out=tmp_path / "other",
        executor=SerialExecutor(),
    )
    for a, b in ((results, slow), (results.path, str(slow.path))):
        assert [(c.a, c.b) for c in dosplan.compare(a, b)] == [
            (f"{results.path}:{arm}", f"{slow.path}:{arm}") for arm in Arm
        ]
    assert len(dosplan.compare(f"{results.path}:with_dos", f"{slow.path}:without_dos")) == 1
    with pytest.raises(FileError, match="is not a run folder"):
        dosplan.compare(tmp_path)
    one = dosplan.run_suite(scenes, CoastPlanner, STILL, out=tmp_path / "one", arms=(Arm.WITH_DOS,))
    with pytest.raises(CompareError, match="holds one arm"):
        dosplan.compare(one)


def test_a_class_of_a_console_cannot_reach_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    class Mine(CoastPlanner):
        name = "mine-v1"

    Mine.__module__, Mine.__qualname__ = "__main__", "Mine"
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "/a/script.py", raising=False)
    assert _spec(Mine) == "/a/script.py:Mine"
    monkeypatch.delattr(sys.modules["__main__"], "__file__")
    with pytest.raises(RegistryError, match=r"cannot import Mine.*write it to a file"):
        _spec(Mine)


def expected(rows: tuple[Score, ...]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(json.dumps([row.columns() for row in rows]))
    return found


def test_rows_as_a_polars_frame(results: Results) -> None:
    polars = pytest.importorskip("polars", reason="polars is an optional dependency")
    frame = results.to_polars()
    assert frame.to_dicts() == expected(results.rows)
    types = dict(frame.schema)
    for column, kind in (
        ("arm", polars.String),
        ("safe", polars.Boolean),
        ("collision_step", polars.Int64),  # Null in every row, and of its type nevertheless.
        ("velocity", polars.Float64),
        ("error", polars.String),
    ):
        assert types[column] == kind
    means = frame.group_by("arm").agg(polars.col("velocity").mean()).sort("arm")
    assert means["arm"].to_list() == ["with_dos", "without_dos"]
    np.testing.assert_allclose(means["velocity"], 10.0)


def test_rows_as_a_pandas_frame(results: Results) -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is an optional dependency")
    frame = results.to_pandas()
    for row, record in zip(expected(results.rows), frame.to_dict("records"), strict=True):
        assert {k: None if pandas.isna(v) else v for k, v in record.items()} == row
    kinds = [str(frame[column].dtype) for column in ("arm", "safe", "collision_step", "velocity")]
    assert kinds == ["string", "boolean", "Int64", "Float64"]
    np.testing.assert_allclose(frame.groupby("arm")["velocity"].mean().astype(float), 10.0)


@pytest.mark.parametrize("library", ["polars", "pandas"])
def test_a_library_that_is_not_there_is_one_line(
    results: Results, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"{library} .*pip install 'dosplan\[frames\]'"):
        getattr(results, f"to_{library}")()
