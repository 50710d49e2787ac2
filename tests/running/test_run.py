"""A run loses no episode, whatever plug-ins do, and gives the same rows however it is driven."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.plugins.registry import RegistryError
from dosplan.results import drive
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import read_manifest
from dosplan.results.recording import KEPT_EVERY, Recording
from dosplan.results.rows import read_rows
from dosplan.running import run as runner
from dosplan.running.executor import Results, Verdicts, Workers
from dosplan.running.job import EpisodeResult, Session, Task
from dosplan.running.progress import Observer, ProgressObserver
from dosplan.running.run import RunConfig, RunError, run
from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios
from dosplan.scoring.score import failed_score
from dosplan.system import workers
from dosplan.system.files import FileError, read_json
from dosplan.types import Arm, EpisodeKey, Outcome, Score
from tests.support import traffic
from tests.support.plugins import PLUGINS
from tests.support.runs import run_here, write_scenes

SHY = f"{traffic.__file__}:ShyTraffic"
STEPS = 10


class NoExecutor:
    """Of a run that has nothing to drive."""

    def start(self, config: RunConfig) -> AbstractContextManager[Workers]:
        raise AssertionError("something is driven")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six scenarios of one second: the ego coasts at 10 m/s to a goal 8 to 12 m ahead."""
    return write_scenes(tmp_path_factory.mktemp("scenes"), 6, "ZAM_Test-{}_1_T-1")


@pytest.fixture(scope="module")
def finished(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run of two scenarios in both arms, driven by a worker process."""
    return run(_config(tmp_path_factory.mktemp("finished"), scenes, limit=2))


def _config(out: Path, scenes: Path, planner: str = "CoastPlanner", **changes: Any) -> RunConfig:
    config = RunConfig(
        out=out,
        source=str(scenes),
        planner=f"{PLUGINS}:{planner}",
        predictor=f"{PLUGINS}:StillPredictor",
    )
    return replace(config, **changes)


def _untimed_text(folder: RunFolder) -> str:
    """``scenarios.jsonl`` without the columns that hold clock times."""
    rows = [json.loads(line) for line in folder.rows.read_text().splitlines()]
    return json.dumps([{key: v for key, v in row.items() if "_ms_" not in key} for row in rows])


def test_rows_do_not_depend_on_the_number_of_workers(scenes: Path, tmp_path: Path) -> None:
    # A planner that draws from the global generator: only seeding per episode makes this hold.
    one = run(_config(tmp_path / "one", scenes, "RandomPlanner", workers=1, limit=3))
    two = run(_config(tmp_path / "two", scenes, "RandomPlanner", workers=2, limit=3))
    assert _untimed_text(one) == _untimed_text(two)
    rows = read_rows(one.rows)
    assert len({row.velocity for row in rows}) == 1  # Three equal scenes: nothing leaks along.
    assert rows[0].velocity != pytest.approx(10.0, abs=1e-6)


def test_the_seed_reaches_the_planner(scenes: Path, tmp_path: Path) -> None:
    velocities = set()
    for name, seed in (("a", 0), ("b", 1), ("c", 1)):
        folder = run_here(_config(tmp_path / name, scenes, "RandomPlanner", seed=seed, limit=1))
        velocities.add(read_rows(folder.rows)[0].velocity)
    assert len(velocities) == 2


def test_the_arms_share_everything_but_the_sets(finished: RunFolder) -> None:
    with_dos, without_dos = (
        Recording.load(finished.recording(EpisodeKey("ZAM_Test-0_1_T-1", arm))) for arm in Arm
    )
    assert (with_dos.set_semi_axes == 1.0).all()
    assert (without_dos.set_semi_axes == 0.0).all()
    assert (with_dos.states == without_dos.states).all()
    assert (with_dos.set_centres == without_dos.set_centres).all()


def test_run_json_says_what_was_run(scenes: Path, finished: RunFolder) -> None:
    manifest = read_json(finished.manifest)
    assert manifest["scenarios"] == ["ZAM_Test-0_1_T-1", "ZAM_Test-1_1_T-1"]
    assert (manifest["planner"], manifest["predictor"]) == ("coast-v1", "still-v1")
    assert manifest["config"]["arms"] == ["with_dos", "without_dos"]
    assert {"python", "dosplan", "numpy"} <= manifest["versions"].keys()
    assert manifest["machine"]["cpu_count"] == os.cpu_count()


def test_no_file_of_a_run_names_its_own_folder(finished: RunFolder) -> None:
    own, recordings = str(finished.path).encode(), 0
    for file in finished.path.rglob("*.*"):
        content = [file.read_bytes()]
        if file.suffix == ".npz":
            with zipfile.ZipFile(file) as packed:
                content = [packed.read(name) for name in packed.namelist()]
            recordings += 1
        assert all(own not in part for part in content), file
    assert recordings == 4


def test_a_finished_run_that_was_moved_is_not_driven_again(
    scenes: Path, finished: RunFolder, tmp_path: Path
) -> None:
    shutil.copytree(finished.path, tmp_path / "moved")
    calls: list[tuple[int, int]] = []
    config = _config(tmp_path / "moved", scenes, limit=2, workers=2)
    observer = ProgressObserver(lambda done, total: calls.append((done, total)))
    folder = run(config, observer, NoExecutor())
    for name in ("scenarios.jsonl", "run.json", "summary.json", "summary.md"):
        assert (folder.path / name).read_bytes() == (finished.path / name).read_bytes()
    assert calls == [(4, 4)]


def test_options_reach_the_plugins_and_run_json(scenes: Path, tmp_path: Path) -> None:
    config = _config(tmp_path / "run", scenes, "TunedPlanner", limit=1, arms=(Arm.WITH_DOS,))
    options: dict[str, Any] = {
        "planner_options": {"acceleration": 2.0},
        "predictor_options": {"horizon": 20},
    }
    config = replace(config, **options)
    folder = run(config)
    (row,) = read_rows(folder.rows)
    # From 10 m/s it goes on at 2 m/s^2 for less than a second: 10 to 12 m/s, 10 to 11 on average.
    assert 10.1 < row.velocity < 11.0
    recording = Recording.load(folder.recording(row.key))
    assert recording.set_centres.shape[1] == 20 // KEPT_EVERY
    manifest, summary = read_json(folder.manifest), read_json(folder.summary)
    assert options.items() <= manifest["config"].items()
    assert options.items() <= summary["run"].items()
    assert read_rows(run(config, executor=NoExecutor()).rows) == [row]


def test_a_run_of_another_default_is_another_run(scenes: Path, tmp_path: Path) -> None:
    config = _config(tmp_path / "run", scenes, "TunedPlanner", limit=1)
    folder = run_here(config)
    manifest = read_json(folder.manifest)
    assert manifest["settings"].pop("loop")["latency"] == 0.0
    assert manifest["settings"] == {
        "planner": {"acceleration": 0.0},
        "predictor": {"horizon": 40},
        "traffic": {},
    }
    manifest["settings"]["planner"]["acceleration"] = 1.0  # As an older planner may have had it.
    folder.manifest.write_text(json.dumps(manifest))
    with pytest.raises(RunError, match=r"a run with another value of planner\.acceleration;"):
        run_here(config)


def test_options_are_copied_and_travel_with_the_configuration() -> None:
    given = {"gain": [1, 2.5, None, {"kind": "a"}], "fast": True}
    config = RunConfig(out=Path("run"), planner_options=given)
    given["fast"] = False
    assert config.planner_options["fast"] is True
    assert pickle.loads(pickle.dumps(config)) == config
    assert hash(config) == hash(replace(config))
    assert config != replace(config, planner_options=given)


def test_one_arm_alone_has_no_comparison(scenes: Path, tmp_path: Path) -> None:
    folder = run_here(_config(tmp_path / "run", scenes, limit=1, arms=(Arm.WITHOUT_DOS,)))
    assert read_json(folder.summary).keys() == {"without_dos", "run"}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"workers": 1, "loop_options": {"period": 0.2}}, "loop_options"),
        ({"workers": 1, "loop": "realistic"}, "loop"),
        ({"seed": 1}, "seed"),
        ({"planner": f"{PLUGINS}:SlowPlanner"}, "planner"),
        ({"traffic": SHY}, "traffic"),
        ({"arms": (Arm.WITH_DOS,)}, "arms"),
        ({"ranked": False}, "ranked"),
        ({"predictor_options": {"horizon": 10}}, "predictor_options"),
    ],
)
def test_another_configuration_overwrites_nothing(
    scenes: Path, tmp_path: Path, change: dict[str, Any], named: str
) -> None:
    config = _config(tmp_path / "run", scenes, limit=1)
    refs = find_scenarios(scenes)[:1]
    runner._open_folder(RunFolder(config.out), runner._manifest(config, refs), refs)
    before = RunFolder(config.out).manifest.read_bytes()
    with pytest.raises(RunError, match=f"another {named}; nothing was changed"):
        run(replace(config, **change))
    assert RunFolder(config.out).manifest.read_bytes() == before
    assert [path.name for path in config.out.iterdir()] == ["run.json"]


def _driven(config: RunConfig) -> tuple[RunFolder, list[tuple[str, Arm]]]:
    """The run, and which episodes were driven for it this time."""
    driven: list[tuple[str, Arm]] = []

    class Watcher(Observer):
        def add(self, row: Score) -> None:
            driven.append((row.scenario, row.arm))

    return run_here(config, Watcher()), driven


def _ids(*numbers: int) -> list[str]:
    return [f"ZAM_Test-{number}_1_T-1" for number in numbers]


@pytest.mark.parametrize(
    ("first", "then", "wanted", "new"),
    [
        ({"limit": 2}, {"limit": 4}, (0, 1, 2, 3), (2, 3)),
        ({"ids": tuple(_ids(4))}, {"ids": tuple(_ids(4, 1))}, (4, 1), (1,)),
        ({"only": ("test-3",)}, {}, (0, 1, 2, 3, 4, 5), (0, 1, 2, 4, 5)),
        # The new ones may stand anywhere in the list.
        ({"only": ("test-3", "test-5")}, {"limit": 6}, (0, 1, 2, 3, 4, 5), (0, 1, 2, 4)),
    ],
)
def test_a_finished_run_is_extended(
    scenes: Path,
    tmp_path: Path,
    first: dict[str, Any],
    then: dict[str, Any],
    wanted: tuple[int, ...],
    new: tuple[int, ...],
) -> None:
    config = _config(tmp_path / "run", scenes, arms=(Arm.WITH_DOS,))
    before, _ = _driven(replace(config, **first))
    kept = before.rows.read_text().splitlines()
    folder, driven = _driven(replace(config, **then))
    assert driven == [(name, Arm.WITH_DOS) for name in _ids(*new)]
    assert [row.scenario for row in read_rows(folder.rows)] == _ids(*wanted)
    assert set(kept) <= set(folder.rows.read_text().splitlines())
    assert read_json(folder.summary)["with_dos"]["n"] == len(wanted)
    manifest = read_manifest(folder)
    assert list(manifest.scenarios) == _ids(*wanted)
    default = _config(tmp_path, scenes)
    for name in ("ids", "only", "sample", "limit"):
        assert getattr(manifest.config, name) == then.get(name, getattr(default, name))
    # What it grew to is the run now.
    with pytest.raises(RunError, match=r"may grow but not shrink; nothing was changed"):
        run_here(replace(config, **first))
    assert read_manifest(folder) == manifest
    assert _driven(replace(config, **then))[1] == []


def test_a_run_is_not_extended_by_another(scenes: Path, tmp_path: Path) -> None:
    shutil.copytree(scenes, tmp_path / "scenes")
    config = _config(tmp_path / "run", tmp_path / "scenes", limit=1)
    folder = run_here(config)
    before = folder.manifest.read_bytes()
    with pytest.raises(RunError, match=r"another seed; nothing was changed"):
        run_here(replace(config, limit=3, seed=1))
    with (tmp_path / "scenes/ZAM_Test-0_1_T-1.xml").open("a") as file:
        file.write("\n")
    with pytest.raises(RunError, match=r"another content of its plug-in, weight or scenario files"):
        run_here(replace(config, limit=3))
    assert folder.manifest.read_bytes() == before


def test_a_run_grows_with_its_source(scenes: Path, tmp_path: Path) -> None:
    source = tmp_path / "scenes"
    source.mkdir()
    shutil.copy(scenes / "ZAM_Test-1_1_T-1.xml", source)
    config = _config(tmp_path / "run", source, arms=(Arm.WITH_DOS,))
    run_here(config)
    shutil.copy(scenes / "ZAM_Test-0_1_T-1.xml", source)
    folder, driven = _driven(config)
    assert driven == [(_ids(0)[0], Arm.WITH_DOS)]
    assert [row.scenario for row in read_rows(folder.rows)] == _ids(0, 1)


def test_what_was_chosen_is_in_run_json_and_found_again(scenes: Path, tmp_path: Path) -> None:
    shutil.copytree(scenes, tmp_path / "more")
    for file in (tmp_path / "more").iterdir():
        text = file.read_text().replace("ZAM_Test", "ZAM_More")
        file.with_name(file.name.replace("Test", "More")).write_text(text)
        file.unlink()
    config = _config(tmp_path / "run", scenes, arms=(Arm.WITH_DOS,))
    config = replace(config, source=(str(scenes), str(tmp_path / "more")), sample=3, seed=4)
    folder = run_here(config)
    manifest = read_manifest(folder)
    assert manifest.config == config.settings
    assert len(manifest.scenarios) == 3
    assert read_json(folder.summary)["run"]["source"] == f"{scenes}, {tmp_path / 'more'}"
    for scenario in manifest.scenarios:
        ((_, found),) = drive.find_drives(folder.path, scenario)
        assert found is not None
        assert found.scenario.id == scenario


@pytest.mark.parametrize("changed", ["planner.py", "traffic.py", "scenes/ZAM_Test-0_1_T-1.xml"])
def test_other_content_of_the_same_files_is_another_run(
    scenes: Path, tmp_path: Path, changed: str
) -> None:
    shutil.copy(PLUGINS, tmp_path / "planner.py")
    shutil.copy(traffic.__file__, tmp_path / "traffic.py")
    shutil.copytree(scenes, tmp_path / "scenes")
    config = _config(tmp_path / "run", tmp_path / "scenes", limit=1)
    config = replace(
        config,
        planner=f"{tmp_path / 'planner.py'}:CoastPlanner",
        traffic=f"{tmp_path / 'traffic.py'}:ShyTraffic",
    )
    refs = find_scenarios(config.source)[:1]
    runner._open_folder(RunFolder(config.out), runner._manifest(config, refs), refs)
    with (tmp_path / changed).open("a") as file:
        file.write("\n")
    with pytest.raises(RunError, match="another content of its plug-in, weight or"):
        run(config)


def test_the_same_source_by_another_path_is_the_same_run(scenes: Path, tmp_path: Path) -> None:
    config = _config(tmp_path / "run", scenes, limit=1)
    text = run_here(config).rows.read_text()
    again = run_here(replace(config, source=f"{scenes}/../{scenes.name}/"))
    assert again.rows.read_text() == text


def test_an_episode_whose_file_is_gone_is_driven_again(scenes: Path, tmp_path: Path) -> None:
    config = _config(tmp_path / "run", scenes, limit=1)
    folder = run_here(config)
    recording = folder.recording(EpisodeKey("ZAM_Test-0_1_T-1", Arm.WITH_DOS))
    recording.unlink()
    run_here(config)
    assert recording.is_file()


@pytest.mark.parametrize("content", ["{}", "[]", '{"config": 3}'])
def test_a_run_json_of_another_kind_is_named(scenes: Path, tmp_path: Path, content: str) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(FileError, match=r"run\.json is not a run\.json of this version"):
        run(_config(tmp_path, scenes))


def test_a_folder_that_holds_something_else_is_left_alone(scenes: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(RunError, match="is not empty and holds no run"):
        run(_config(tmp_path, scenes))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_summary_is_headed_by_what_was_set(scenes: Path, tmp_path: Path) -> None:
    config = _config(
        tmp_path / "run", scenes, limit=1, predictor="growing-circle", predictor_options={"z": 0.7}
    )
    heading = run_here(config).summary_text.read_text().splitlines()[0]
    assert heading.endswith(", seed 0, predictor.z=0.7")


def test_the_traffic_of_a_run_is_in_its_files_and_in_every_row(
    scenes: Path, tmp_path: Path
) -> None:
    config = _config(tmp_path / "run", scenes, "LeakyPlanner", limit=2, traffic=SHY)
    folder = run_here(replace(config, traffic_options={"near": 9}))
    manifest = read_json(folder.manifest)
    assert (manifest["traffic"], manifest["config"]["traffic"]) == ("shy-v1", SHY)
    assert manifest["config"]["traffic_options"] == {"near": 9}
    assert manifest["settings"]["traffic"] == {"near": 9.0}
    assert read_json(folder.summary)["run"]["traffic"] == "shy-v1"
    assert "traffic shy-v1, seed 0, traffic.near=9" in folder.summary_text.read_text()
    assert {row.traffic for row in read_rows(folder.rows)} == {"shy-v1"}
    recording = Recording.load(folder.recording(EpisodeKey("ZAM_Test-0_1_T-1", Arm.WITH_DOS)))
    assert recording.tracks is not None
    assert 900 in recording.tracks.ids


def test_an_episode_that_never_began_names_the_traffic_and_leaves_no_old_file(
    scenes: Path, tmp_path: Path
) -> None:
    config = _config(tmp_path / "run", scenes, limit=1, traffic=SHY)
    folder = run_here(config)
    lines = folder.rows.read_bytes().splitlines(keepends=True)
    folder.rows.write_bytes(lines[1])  # As a kill leaves it: the file is written, not its row.
    file = folder.recording(EpisodeKey("ZAM_Test-0_1_T-1", Arm.WITH_DOS))
    assert file.is_file()

    class Failing:
        @contextmanager
        def start(self, config: RunConfig) -> Iterator[Workers]:
            yield FailingWorkers()

    class FailingWorkers:
        def check(self, refs: Iterable[ScenarioRef]) -> Verdicts:
            for ref in refs:
                yield ref, None

        def drive(self, tasks: Iterable[Task]) -> Results:
            for task in tasks:
                yield task, EpisodeResult(failed_score(task.key, "took too long"))

    run(config, executor=Failing())
    first, _ = read_rows(folder.rows)
    assert (first.error, first.traffic) == ("took too long", "shy-v1")
    assert not file.exists()


def test_a_predictor_that_sees_the_recording_needs_traffic_that_keeps_to_it(
    scenes: Path, tmp_path: Path
) -> None:
    seer = f"{PLUGINS}:SeerPredictor"
    config = _config(tmp_path / "run", scenes, predictor=seer, ranked=False, traffic=SHY)
    with pytest.raises(RunError, match=r"seer-v1 is shown the recording, which the traffic shy-v1"):
        run_here(config)
    assert not config.out.exists()


def test_a_predictor_that_sees_the_future_is_refused_or_marked(
    scenes: Path, tmp_path: Path
) -> None:
    config = _config(tmp_path / "run", scenes, limit=1, predictor=f"{PLUGINS}:SeerPredictor")
    with pytest.raises(RunError, match=r"seer-v1 is shown the future.*--unranked"):
        run_here(config)
    assert not config.out.exists()
    folder = run_here(replace(config, ranked=False, arms=(Arm.WITH_DOS,)))
    assert read_json(folder.summary)["run"]["ranked"] is False
    assert "unranked" in folder.summary_text.read_text()


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"planner": "no-such"}, RegistryError),
        ({"predictor": "no-such"}, RegistryError),
        ({"traffic": "no-such"}, RegistryError),
        ({"traffic": SHY, "traffic_options": {"far": 1.0}}, RegistryError),
        ({"traffic": f"{PLUGINS}:CoastPlanner"}, RegistryError),
        ({"planner_options": {"gain": 1.0}}, RegistryError),
        (
            {"planner": "TunedPlanner", "planner_options": {"acceleration": "fast"}},
            RegistryError,
        ),
        (
            {"planner": "TunedPlanner", "planner_options": {"acceleration": 10}},
            RegistryError,
        ),
        ({"predictor_options": {"horzion": 10}}, RegistryError),
        ({"predictor_options": {"horizon": 0}}, RegistryError),
        ({"planner": "UnbuildablePlanner"}, RegistryError),
        (
            {"planner": "FarSightedPlanner", "predictor_options": {"horizon": 10}},
            RunError,
        ),
        ({"source": "no-such-folder"}, ScenarioError),
    ],
)
def test_bad_input_is_refused_before_a_folder_is_made(
    scenes: Path, tmp_path: Path, change: dict[str, Any], error: type[Exception]
) -> None:
    config = _config(tmp_path / "run", scenes, **change)
    with pytest.raises(error) as caught:
        run(config)
    assert "\n" not in str(caught.value)
    assert not config.out.exists()


@pytest.mark.parametrize(
    "change",
    [
        {"workers": 0},
        {"limit": 0},
        {"sample": 0},
        {"loop": "perfect"},
        {"loop_options": {"period": 0.0}},
        {"loop_options": {"latency": 0.25}},
        {"episode_timeout": 0.0},
        {"episode_timeout": float("nan")},
        {"episode_timeout": float("inf")},
        {"seed": -1},
        {"arms": ()},
        {"arms": (Arm.WITH_DOS, Arm.WITH_DOS)},
        {"planner_options": {"gain": float("nan")}},
        {"planner_options": {"file": Path("weights")}},
        # JSON would turn these into a list and a text, and the run could never be resumed.
        {"predictor_options": {"range": (1, 2)}},
        {"predictor_options": {"by_kind": {1: 2}}},
    ],
)
def test_a_config_without_sense_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(RunError, match=next(iter(change)).removesuffix("_options")):
        RunConfig(out=Path("run"), **change)


def test_an_episode_is_driven_scored_and_recorded(scenes: Path, tmp_path: Path) -> None:
    ref = find_scenarios(scenes)[0]
    result = Session(_config(tmp_path, scenes)).drive(Task(ref, Arm.WITH_DOS))
    row = result.row
    assert (row.outcome, row.scenario) == (Outcome.SUCCESS, ref.id)
    # The goal begins at x = 18 m, the ego's centre starts at 10 m with 10 m/s: 8 steps.
    assert row.steps == 8
    assert not any(tmp_path.iterdir())  # The runner alone writes.
    (tmp_path / "episode.npz").write_bytes(result.recording or b"")
    recording = Recording.load(tmp_path / "episode.npz")
    assert len(recording.inputs) == row.steps
    assert recording.set_ids.tolist() == [7] * row.steps


def test_a_failed_plugin_is_made_anew(scenes: Path, tmp_path: Path) -> None:
    session = Session(_config(tmp_path, scenes, "LeakyPlanner"))
    first, broken, last = (
        session.drive(Task(ref, Arm.WITH_DOS)).row for ref in find_scenarios(scenes)[:3]
    )
    assert first.outcome is last.outcome is Outcome.SUCCESS
    assert "broken for good" in str(broken.error)


def test_what_a_plugin_raises_is_in_the_row_and_its_traceback_in_a_file(
    scenes: Path, tmp_path: Path
) -> None:
    config = _config(tmp_path / "run", scenes, "FaultyPlanner", arms=(Arm.WITH_DOS,))
    folder = run_here(replace(config, source=str(scenes / "ZAM_Test-5_1_T-1.xml")))
    (row,) = read_rows(folder.rows)
    assert row.outcome is Outcome.PLANNER_FAILURE
    assert "SystemExit: enough" in str(row.error)
    trace = folder.traceback(row.key).read_text()
    assert trace.startswith("Traceback")
    assert "enough" in trace


def test_a_traceback_is_of_the_attempt_that_its_row_tells(scenes: Path, tmp_path: Path) -> None:
    config = _config(tmp_path / "run", scenes, "FaultyPlanner", arms=(Arm.WITH_DOS,))
    config = replace(config, source=str(scenes / "ZAM_Test-5_1_T-1.xml"))
    folder = run_here(config)
    (row,) = read_rows(folder.rows)
    folder.rows.write_text("")
    died = EpisodeResult(failed_score(row.key, "timed out after 600 s"))

    class Dying:
        """Whatever it drives times out."""

        @contextmanager
        def start(self, config: RunConfig) -> Iterator[Workers]:
            yield self

        def check(self, refs: Iterable[ScenarioRef]) -> Verdicts:
            yield from ((ref, None) for ref in refs)

        def drive(self, tasks: Iterable[Task]) -> Results:
            yield from ((task, died) for task in tasks)

    run(config, executor=Dying())
    assert not folder.traceback(row.key).exists()


def test_a_row_that_cannot_be_written_becomes_one_that_can(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = replace(failed_score(EpisodeKey("s", Arm.WITH_DOS), ""), velocity=float("nan"))
    monkeypatch.setattr(drive, "score", lambda *_: bad)
    row = (
        Session(_config(tmp_path, scenes)).drive(Task(find_scenarios(scenes)[0], Arm.WITH_DOS)).row
    )
    assert "ValueError: Out of range float values" in str(row.error)


def test_an_episode_that_does_not_fit_its_file_is_a_row(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def save(*_: object) -> None:
        raise TypeError("a report of words")

    monkeypatch.setattr(Recording, "pack", save)
    row = (
        Session(_config(tmp_path, scenes)).drive(Task(find_scenarios(scenes)[0], Arm.WITH_DOS)).row
    )
    assert (row.outcome, row.error) == (
        Outcome.PLANNER_FAILURE,
        "TypeError: a report of words",
    )


def test_rows_do_not_depend_on_what_was_drawn_before_a_plugin_was_made(
    scenes: Path, tmp_path: Path
) -> None:
    ref, config = find_scenarios(scenes)[0], _config(tmp_path, scenes, "RandomlyMadePlanner")
    velocities = set()
    for draws in (0, 5):
        np.random.uniform(size=draws)  # noqa: NPY002
        velocities.add(Session(config).drive(Task(ref, Arm.WITH_DOS)).row.velocity)
    assert len(velocities) == 1


def test_a_broken_scenario_file_is_a_row(scenes: Path, tmp_path: Path) -> None:
    file = tmp_path / "ZAM_Broken-1_1_T-1.xml"
    file.write_text("<commonRoad")
    (ref,) = find_scenarios(file)
    session = Session(_config(tmp_path, scenes))
    assert str(session.check(ref)).startswith(f"{file}: is not complete XML (")
    row = session.drive(
        Task(ref, Arm.WITH_DOS)
    ).row  # As of a file that broke after it was checked.
    assert row.outcome is Outcome.PLANNER_FAILURE
    assert "ScenarioError" in str(row.error)


def test_an_episode_that_cannot_be_saved_ends_the_run(scenes: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    out.mkdir()
    config = _config(out, scenes, limit=1, arms=(Arm.WITH_DOS,))
    refs = find_scenarios(scenes)[:1]
    runner._open_folder(RunFolder(out), runner._manifest(config, refs), refs)
    (out / "episodes").write_text("a file where a folder should be")
    with pytest.raises(FileError, match=r"cannot write .*ZAM_Test-0_1_T-1\.with_dos\.npz"):
        run(config)


def test_workers_end_with_a_runner_that_is_killed_and_print_to_stderr(
    scenes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    plugins = ["--planner", f"{PLUGINS}:HangingPlanner", "--predictor", f"{PLUGINS}:StillPredictor"]
    command = [sys.executable, "-m", "dosplan", "run", str(scenes), *plugins, "--workers", "1"]
    command += ["--limit", "2", "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while len(read_rows(out / "scenarios.jsonl")) < 2:
        assert process.poll() is None, process.stderr and process.stderr.read()
        assert time.monotonic() < deadline, "no row appeared"
        time.sleep(0.05)
    assert process.stderr is not None
    while "hanging" not in process.stderr.readline():  # The worker hangs in the third episode now.
        assert process.poll() is None
        assert time.monotonic() < deadline, "no episode hung"
    process.kill()
    # The pipes end when the last process that holds them does: an orphan would keep them open.
    shown, _ = process.communicate(timeout=20)
    assert shown == ""


def test_workers_get_one_thread_each_and_the_environment_is_put_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with workers.environment({"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
