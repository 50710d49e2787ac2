"""Several futures of one past: who meets which, what is resumed, what the commands say."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dosplan.cli.main import main
from dosplan.results.comparison import CompareError, compare_runs
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.rows import read_rows, write_rows
from dosplan.results.summary import read_summary
from dosplan.running.config import RunConfig, RunError
from dosplan.running.executor import LocalExecutor
from dosplan.running.job import Session, Task
from dosplan.running.progress import Observer
from dosplan.running.run import run
from dosplan.scenario import find_scenarios
from dosplan.types import Arm, EpisodeKey, FloatArray, Outcome, Score
from tests.support.plugins import PLUGINS
from tests.support.runs import configured, run_here, untimed, write_scenes

TRAFFIC = Path(__file__).parents[1] / "support" / "traffic.py"
FUTURES = 3
KEYS = [(arm, future) for arm in Arm for future in range(FUTURES)]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("futures") / "scenes", 2, "ZAM_Test-{}_1_T-1")


def _config(out: Path, scenes: Path, planner: str = "CoastPlanner", **changes: object) -> RunConfig:
    config = configured(out, scenes, planner, traffic=f"{TRAFFIC}:WanderingTraffic")
    return replace(config, **{"futures": FUTURES, **changes})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def finished(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return run_here(_config(tmp_path_factory.mktemp("run") / "out", scenes))


def _met(folder: RunFolder, scenario: str, arm: Arm, future: int) -> FloatArray:
    """How far the car of a scenario came, step by step."""
    recording = Recording.load(folder.recording(EpisodeKey(scenario, arm, future)))
    assert (recording.future, recording.traffic) == (future, "wandering-v1")
    assert recording.tracks is not None
    return np.asarray(recording.tracks.states[0, :, 0])


def test_a_row_for_each_scenario_arm_and_future(finished: RunFolder) -> None:
    rows = read_rows(finished.rows)
    names = [f"ZAM_Test-{i}_1_T-1" for i in range(2)]
    assert [row.key for row in rows] == [(name, *key) for name in names for key in KEYS]
    assert json.loads(finished.rows.read_text().splitlines()[1])["future"] == 1
    files = sorted(path.name for path in (finished.path / "episodes").glob("*-0_1_T-1*"))
    assert files == sorted(
        f"ZAM_Test-0_1_T-1.{arm}{end}.npz" for arm in Arm for end in ("", ".future-1", ".future-2")
    )
    summary = read_summary(finished)
    assert summary.run.futures == FUTURES
    assert summary.arms[Arm.WITH_DOS]["n"] == 2 * FUTURES
    assert summary.comparison is not None
    assert (summary.comparison.n, summary.comparison.futures) == (2 * FUTURES, FUTURES)
    assert "3 futures" in finished.summary_text.read_text()


def test_arms_and_planners_meet_the_same_futures_and_these_differ(
    finished: RunFolder, scenes: Path, tmp_path: Path
) -> None:
    other = run_here(
        _config(tmp_path / "out", scenes, "TunedPlanner", planner_options={"acceleration": -4.0})
    )
    for name in (f"ZAM_Test-{i}_1_T-1" for i in range(2)):
        found = [_met(finished, name, Arm.WITH_DOS, future) for future in range(FUTURES)]
        for future, track in enumerate(found):
            for folder in (finished, other):
                for arm in Arm:
                    again = _met(folder, name, arm, future)
                    # One of them may have reached the goal, or hit the car, first.
                    steps = min(len(again), len(track))
                    assert steps > 5
                    assert np.array_equal(again[:steps], track[:steps])
        # The past is one, what comes is not.
        assert len({track[0] for track in found}) == 1
        assert len({track[5] for track in found}) == FUTURES


def test_a_future_does_not_depend_on_how_many_are_driven_nor_where(
    finished: RunFolder, scenes: Path, tmp_path: Path
) -> None:
    alone = untimed(run_here(_config(tmp_path / "alone", scenes, futures=1)))
    assert alone == [row for row in untimed(finished) if row["future"] == 0]
    elsewhere = run(_config(tmp_path / "workers", scenes), executor=LocalExecutor(2))
    assert untimed(elsewhere) == untimed(finished)
    session, ref = Session(_config(tmp_path, scenes)), find_scenarios(scenes)[0]
    rows = [session.drive(Task(ref, Arm.WITH_DOS, future)).row for future in (2, 0)]
    held = {row.key: row for row in read_rows(finished.rows)}
    assert [row.progress for row in rows] == [held[row.key].progress for row in rows]


class _EndedError(Exception):
    """The run was ended from outside."""


class _Ending(Observer):
    """Ends a run after some rows."""

    def __init__(self, rows: int) -> None:
        self.left = rows

    def add(self, row: Score) -> None:
        self.left -= 1
        if not self.left:
            raise _EndedError


@pytest.mark.parametrize("rows", [1, 5, 11])
def test_a_run_that_was_ended_is_resumed(
    finished: RunFolder, scenes: Path, tmp_path: Path, rows: int
) -> None:
    config = _config(tmp_path / "out", scenes)
    with pytest.raises(_EndedError):
        run_here(config, _Ending(rows))
    kept = [row.key for row in read_rows(RunFolder(config.out).rows)]
    assert len(kept) == rows
    driven: list[EpisodeKey] = []

    class Listing(Observer):
        def add(self, row: Score) -> None:
            driven.append(row.key)

    assert untimed(run_here(config, Listing())) == untimed(finished)
    assert not set(driven) & set(kept)
    assert len(driven) == 12 - rows


def test_the_future_whose_file_is_lost_is_driven_again(finished: RunFolder, tmp_path: Path) -> None:
    scenes = Path(json.loads(finished.manifest.read_text())["config"]["source"])
    copy = RunFolder(tmp_path / "out")
    shutil.copytree(finished.path, copy.path)
    lost = EpisodeKey("ZAM_Test-1_1_T-1", Arm.WITHOUT_DOS, 2)
    copy.recording(lost).unlink()
    driven: list[EpisodeKey] = []

    class Listing(Observer):
        def add(self, row: Score) -> None:
            driven.append(row.key)

    run_here(_config(copy.path, scenes), Listing())
    assert driven == [lost]


def test_a_run_grows_by_futures_but_does_not_shrink(
    finished: RunFolder, scenes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_here(_config(out, scenes, futures=1))
    driven: list[int] = []

    class Listing(Observer):
        def add(self, row: Score) -> None:
            driven.append(row.future)

    assert untimed(run_here(_config(out, scenes), Listing())) == untimed(finished)
    assert set(driven) == {1, 2}
    with pytest.raises(RunError, match="holds a run of 3 futures, and this one has 2"):
        run_here(_config(out, scenes, futures=2))


def test_traffic_of_one_future_is_refused_before_anything_is_driven(
    scenes: Path, tmp_path: Path
) -> None:
    with pytest.raises(RunError, match="futures is 3, and the traffic shy-v1 has one future only"):
        run_here(_config(tmp_path / "out", scenes, traffic=f"{TRAFFIC}:ShyTraffic"))
    few = "futures is 3, and the traffic replay has 1 for 2 of the 2 scenarios, as ZAM_Test-0_1_T-1"
    with pytest.raises(RunError, match=few):
        run_here(_config(tmp_path / "out", scenes, traffic="replay"))
    assert not (tmp_path / "out").exists()
    with pytest.raises(RunError, match="futures is 0; it must be more than 0"):
        _config(tmp_path / "out", scenes, futures=0)


def test_traffic_that_does_not_keep_its_future_fails_by_name(scenes: Path, tmp_path: Path) -> None:
    config = _config(tmp_path / "out", scenes, traffic=f"{TRAFFIC}:ForgetfulTraffic")
    rows = read_rows(run_here(config).rows)
    assert [row.outcome is Outcome.TRAFFIC_FAILURE for row in rows] == [
        future > 0 for _ in range(2) for _, future in KEYS
    ]
    assert "forgetful-v1 was told future 1 and keeps 0" in str(rows[1].error)


def _changed(finished: RunFolder, out: Path, failures: Iterable[tuple[int, Arm, int]]) -> Path:
    """A copy of the run in which some episodes missed their goal, and the others reached it."""
    shutil.copytree(finished.path, out)
    failed = {EpisodeKey(f"ZAM_Test-{i}_1_T-1", arm, future) for i, arm, future in failures}
    rows = [
        replace(row, outcome=Outcome.GOAL_MISSED if row.key in failed else Outcome.SUCCESS)
        for row in read_rows(finished.rows)
    ]
    write_rows(RunFolder(out).rows, rows)
    return out


def test_comparison_takes_the_futures_of_a_scenario_together(
    finished: RunFolder, tmp_path: Path
) -> None:
    # Without sets, all three futures of the first scenario fail; with sets, one of the second.
    failures = [(0, Arm.WITHOUT_DOS, k) for k in range(3)] + [(1, Arm.WITH_DOS, 1)]
    (found,) = compare_runs([str(_changed(finished, tmp_path / "out", failures))])
    success = found.differences["success"]
    assert (success.n, success.only_a, success.only_b, found.futures) == (6, 1, 3, 3)
    # Totals of the signs of 3 and -1: 4, 2, -2, -4, so 2 or more in size in all of four.
    # McNemar over episodes would say 5/8.
    assert success.p == 1.0
    assert [(c.scenario[-7], c.future) for c in found.changes] == [
        ("0", 0),
        ("0", 1),
        ("0", 2),
        ("1", 1),
    ]


def test_runs_of_other_futures_are_not_compared(
    finished: RunFolder, scenes: Path, tmp_path: Path
) -> None:
    fewer = run_here(_config(tmp_path / "out", scenes, futures=1))
    with pytest.raises(
        CompareError, match=r"ZAM_Test-0_1_T-1, future 1 and 3 more are in .* alone; drive them"
    ):
        compare_runs([str(finished.path), str(fewer.path)])


def test_commands_know_the_futures(
    finished: RunFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_folder, scenario = str(finished.path), "ZAM_Test-0_1_T-1"
    assert main(["score", run_folder]) == 0
    assert "12 of 12 rows agree" in capsys.readouterr().out
    assert main(["compare", run_folder]) == 0
    told = capsys.readouterr().out
    assert "n = 6, futures = 3, places = 2" in told
    assert main(["explain", run_folder, scenario]) == 0
    told = capsys.readouterr().out
    assert told.count(f"{scenario}, with_dos") == told.count(f"{scenario}, without_dos") == FUTURES
    assert main(["explain", run_folder, scenario, "--future", "2", "--arm", "with_dos"]) == 0
    assert re.findall("future ([0-9])", capsys.readouterr().out) == ["2"]
    assert main(["explain", run_folder, scenario, "--future", "3"]) == 2
    assert (
        "holds no future 3 of ZAM_Test-0_1_T-1: its futures are 0 to 2" in capsys.readouterr().err
    )
    picture = tmp_path / "out.png"
    assert main(["render", f"{run_folder}:{scenario}", "--future", "1", "--out", str(picture)]) == 0
    assert picture.stat().st_size > 0


def test_the_option_of_the_command(scenes: Path, tmp_path: Path) -> None:
    plugins = ["--planner", f"{PLUGINS}:CoastPlanner", "--predictor", f"{PLUGINS}:StillPredictor"]
    traffic = ["--traffic", f"{TRAFFIC}:WanderingTraffic", "--futures", "2"]
    out = ["--limit", "1", "--in-process", "--solutions", "--out", str(tmp_path / "out")]
    assert main(["run", str(scenes), *plugins, *traffic, *out]) == 0
    assert len(read_rows(tmp_path / "out" / "scenarios.jsonl")) == 4
    solutions = sorted(path.name for path in (tmp_path / "out" / "solutions").iterdir())
    assert solutions == sorted(
        f"ZAM_Test-0_1_T-1.{arm}{end}.xml" for arm in Arm for end in ("", ".future-1")
    )


def test_the_page_folds_the_futures_of_a_scenario(finished: RunFolder) -> None:
    from dosplan.report.html.write import write_report

    html = write_report(finished.path, finished.path.parent / "report.html").read_text("utf-8")
    assert "2 scenarios, 3 futures each, of 2 places" in html
    assert re.search("[0-9] of 6 episodes", html)
    found = re.search(r'<script[^>]*id="data"[^>]*>(.*?)</script>', html, re.DOTALL)
    assert found
    (section,) = json.loads(found[1])["sections"]
    assert sorted((case["id"][-7], case["future"]) for case in section["cases"]) == [
        (scenario, future) for scenario in "01" for future in range(FUTURES)
    ]
    assert all("episode" in case for case in section["cases"])
