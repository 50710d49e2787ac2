"""Sweeps: which runs a file makes, what it is refused for, and that its runs are those of `run`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dosplan.plugins.registry import RegistryError
from dosplan.results.sweeps import SweepFolder, SweepRun
from dosplan.running.config import RunConfig
from dosplan.running.executor import SerialExecutor
from dosplan.running.run import run
from dosplan.running.sweep import (
    SweepError,
    check_sweep,
    describe_sweep,
    open_sweep,
    read_sweep,
)
from dosplan.system.files import FileError
from dosplan.types import Arm
from tests.support.plugins import PLUGINS
from tests.support.runs import STILL, run_here, untimed, write_scenes

TWO_BY_TWO = """
base: {source: SCENES, predictor: STILL}
axes:
  speed:
    steady: {planner: "PLUGINS:CoastPlanner"}
    faster: {planner: "PLUGINS:TunedPlanner", planner.acceleration: 1}
  seed: [0, 1]
"""


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    return write_scenes(tmp_path / "scenes", 2)


def _read(folder: Path, text: str, **changes: object) -> tuple[SweepRun, ...]:
    filled = text.replace("PLUGINS", str(PLUGINS)).replace("STILL", STILL)
    (folder / "mine.yaml").write_text(filled.replace("SCENES", str(folder / "scenes")))
    return read_sweep(folder / "mine.yaml", changes)


def test_every_combination_is_a_run_named_by_its_values(tmp_path: Path) -> None:
    runs = _read(tmp_path, TWO_BY_TWO)
    assert [one.name for one in runs] == [
        "speed=steady,seed=0",
        "speed=steady,seed=1",
        "speed=faster,seed=0",
        "speed=faster,seed=1",
    ]
    assert [one.settings.seed for one in runs] == [0, 1, 0, 1]
    assert runs[3].settings.planner_options == {"acceleration": 1}
    assert runs[0].settings.planner_options == {}
    assert runs[2].values == {"speed": "faster", "seed": "0"}
    assert {one.settings.arms for one in runs} == {tuple(Arm)}


def test_what_the_command_says_takes_the_place_of_the_base_but_not_of_an_axis(
    tmp_path: Path,
) -> None:
    runs = _read(tmp_path, "base: {limit: 5}\naxes: {futures: [1, 3]}\n", limit=2, futures=9)
    assert [(one.settings.limit, one.settings.futures) for one in runs] == [(2, 1), (2, 3)]
    (of_grid,) = _read(tmp_path, "grids: [{base: {limit: 5}, axes: {seed: [0]}}]\n", limit=2)
    assert of_grid.settings.limit == 2


def test_settings_of_every_owner_are_options(tmp_path: Path) -> None:
    text = """
base: {loop.latency: 0.3, traffic: reactive, traffic.courtesy: 1, planner.a.b: [1, 2]}
axes: {loop: [ideal, realistic], predictor.coverage: [0.5]}
"""
    first, second = _read(tmp_path, text)
    assert first.name == "loop=ideal,predictor.coverage=0.5"
    assert (first.settings.loop, second.settings.loop) == ("ideal", "realistic")
    assert second.settings.loop_options == {"latency": 0.3}
    assert second.settings.traffic_options == {"courtesy": 1}
    assert second.settings.planner_options == {"a.b": [1, 2]}
    assert second.settings.predictor_options == {"coverage": 0.5}


def test_a_predictor_of_points_drives_one_arm_unless_both_are_named(tmp_path: Path) -> None:
    text = "axes: {predictor: [dos, net, constant-velocity, none, growing-circle]}\n"
    arms = {one.values["predictor"]: one.settings.arms for one in _read(tmp_path, text)}
    points = (Arm.WITHOUT_DOS,)
    assert arms == {
        "dos": tuple(Arm),
        "net": points,
        "constant-velocity": points,
        "none": points,
        "growing-circle": tuple(Arm),
    }
    both = "base: {arms: [with_dos, without_dos]}\naxes: {predictor: [net]}\n"
    assert _read(tmp_path, both)[0].settings.arms == tuple(Arm)


def test_grids_add_up_and_combinations_are_left_out(tmp_path: Path) -> None:
    text = """
base: {predictor: dos}
axes: {loop: [ideal, realistic]}
grids:
  - axes:
      sets: {union: {predictor.sets: union}, free: {predictor.sets: free}}
      predictor.coverage: [0.7, 0.9]
  - base: {predictor: net}
    axes: {sets: {points: {}}}
without:
  - {sets: [union, points], loop: realistic}
  - {predictor.coverage: 0.9}
"""
    assert [one.name for one in _read(tmp_path, text)] == [
        "loop=ideal,sets=union,predictor.coverage=0.7",
        "loop=ideal,sets=free,predictor.coverage=0.7",
        "loop=realistic,sets=free,predictor.coverage=0.7",
        "loop=ideal,sets=points",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "mine.yaml is no mapping of base, axes, without, grids"),
        ("axis: {seed: [0]}", "has the unknown key 'axis'; did you mean 'axes'?"),
        ("base: {seed: 0}", "mine.yaml has no axes; name some"),
        ("axes: {seed: []}", "axes: seed has no values"),
        ("axes: {seed: 3}", "axes: seed has no values; give a list, or names with settings"),
        ("axes: {seed: [0, 0]}", "axes: seed has a value twice"),
        ("axes: {sets: [union]}", "axes: sets is a list, and 'sets' is no setting of a run; write"),
        ("axes: {source: [my/files]}", "the value 'my/files' makes no folder's name"),
        ("axes: {source: [[a, b]]}", "axes: source: ['a', 'b'] has no name; write NAME: {"),
        ("axes: {a b: {c: {seed: 1}}}", "the axis 'a b' makes no folder's name"),
        ("axes: {a: {b: {sed: 1}}}", "run a=b: 'sed' is no setting of a run; did you mean 'seed'"),
        ("axes: {a: {b: {workers: 2}}}", "'workers' is no setting of a run"),
        ("axes: {a: {b: {planner_options: {}}}}", "'planner_options' is no setting of a run"),
        ("axes: {a: {b: {seed: x}}}", "run a=b: seed: Expected `int`, got `str`"),
        ("axes: {a: {b: {seed: -1}}}", "run a=b: seed is -1; it must not be negative"),
        ("axes: {a: {b: {loop.latncy: 1}}}", "did you mean 'latency'?"),
        ("axes: {a: {b: {seed: 1}}, seed: [1]}", "the axes a and seed both set seed"),
        ("axes: {seed: [0]}\nwithout: [{seed: 0}]", "without leaves no run"),
        ("axes: {seed: [0]}\nwithout: [{sed: 0}]", "without 1 names no axis: 'sed'; did you mean"),
        ("axes: {seed: [0]}\nwithout: [{seed: 1}]", "without 1: seed has no value '1'"),
        ("axes: {seed: [0]}\nwithout: [{}]", "without 1 names no axis"),
        ("axes: {seed: [0]}\nwithout: {seed: 0}", "without must be a list of mappings"),
        ("axes: {seed: [0]}\ngrids: []", "grids must be a list of mappings"),
        ("axes: {seed: [0]}\ngrids: [{axes: {seed: [1]}}]", "grid 1: the axis 'seed' is one of th"),
        ("grids: [{axes: {seed: [1]}}, {axes: {seed: [1]}}]", "2 runs are called seed=1"),
        ("grids: [{without: []}]", "grid 1 has the unknown key 'without'"),
        ("axes: {seed: [0], seed: [1]}", "mine.yaml is not YAML: 'seed' is given twice"),
        ("axes: {a: {b: {seed: 1}, b: {seed: 2}}}", "mine.yaml is not YAML: 'b' is given twice"),
        ("axes: {seed: &a [0], limit: *a}", "mine.yaml is not YAML: write aliases (*) out"),
        ("axes: {a: {b: {seed: !!python/name:os.sep ''}}}", "mine.yaml is not YAML"),
    ],
)
def test_a_file_that_is_wrong_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(SweepError) as raised:
        _read(tmp_path, text)
    assert message in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


def test_a_file_or_predictor_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(SweepError, match=r"cannot read .*none.yaml: No such file"):
        read_sweep(tmp_path / "none.yaml")
    with pytest.raises(RegistryError, match="no predictor is called 'dso'"):
        _read(tmp_path, "axes: {predictor: [dso]}")


def test_runs_of_a_sweep_are_those_of_run(tmp_path: Path, scenes: Path) -> None:
    runs = _read(tmp_path, TWO_BY_TWO)
    folder = SweepFolder(tmp_path / "out")
    open_sweep(folder, runs)
    assert folder.read() == runs
    for part in describe_sweep(folder, runs, workers=1, cluster=None, cache=False):
        assert (part.left, part.seconds) == (4, ())
        run(part.config, executor=SerialExecutor())
    alone = RunConfig(
        out=tmp_path / "alone",
        source=str(scenes),
        planner=f"{PLUGINS}:TunedPlanner",
        planner_options={"acceleration": 1},
        predictor=STILL,
        seed=1,
    )
    assert untimed(run_here(alone)) == untimed(folder.run(runs[3]))
    done = describe_sweep(folder, runs, workers=1, cluster=None, cache=False)
    assert [part.left for part in done] == [0] * 4
    assert all(len(part.seconds) == 4 and min(part.seconds) > 0.0 for part in done)


def test_a_run_that_cannot_start_is_found_before_anything_is_driven(
    tmp_path: Path, scenes: Path
) -> None:
    runs = _read(tmp_path, TWO_BY_TWO.replace("acceleration: 1", "acceleration: 10"))
    with pytest.raises(SweepError, match=r"run speed=faster,seed=0: .*expected -9 to 9"):
        describe_sweep(SweepFolder(tmp_path / "out"), runs, workers=1, cluster=None, cache=False)
    assert not (tmp_path / "out").exists()


def test_a_sweep_may_grow_but_not_change(tmp_path: Path) -> None:
    folder = SweepFolder(tmp_path / "out")
    runs = _read(tmp_path, TWO_BY_TWO)
    open_sweep(folder, runs)
    more = _read(tmp_path, TWO_BY_TWO.replace("[0, 1]", "[0, 1, 2]"), limit=1)
    open_sweep(folder, more)
    assert len(folder.read()) == 6
    with pytest.raises(SweepError, match=r"with a run speed=steady,seed=2, which this one leaves"):
        check_sweep(folder, runs)
    odd = tuple(
        replace(one, settings=replace(one.settings, planner_options={"acceleration": 2}))
        if one.values["speed"] == "faster"
        else one
        for one in more
    )
    with pytest.raises(
        SweepError, match=r"run speed=faster,seed=0 has another planner_options; nothing was chang"
    ):
        check_sweep(folder, odd)
    assert folder.read() == more


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    runs = _read(tmp_path, TWO_BY_TWO)
    with pytest.raises(SweepError, match="is not empty and holds no sweep; choose another --out"):
        check_sweep(SweepFolder(tmp_path), runs)
    folder = SweepFolder(tmp_path / "out")
    folder.path.mkdir()
    folder.record.write_text('{"runs": 3}')
    with pytest.raises(FileError, match=r"sweep.json is not a sweep.json of this version \(runs"):
        check_sweep(folder, runs)
