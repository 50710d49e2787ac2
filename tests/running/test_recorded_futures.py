"""Runs over recorded futures: each is driven, seen, kept, scored and told as what it is."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dosplan_reactive.traffic import ReactiveTraffic
from dosplan_simple.predictors import GroundTruthPredictor

from dosplan.cli.command import BAD_INPUT, FAILED, OK
from dosplan.cli.main import main
from dosplan.results.drive import find_drives
from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_rows
from dosplan.results.summary import read_summary
from dosplan.running.config import RunError
from dosplan.running.progress import Observer
from dosplan.scenario import find_scenarios, load_scenario
from dosplan.scenario.futures import write_futures
from dosplan.scoring.score import score
from dosplan.simulation.loop import known_drive, run_episode
from dosplan.simulation.traffic import Replay, Traffic, users_at
from dosplan.simulation.world import World
from dosplan.types import USER_X, Arm, EpisodeKey, Outcome, Scenario, Score
from tests.support.futures import appended, stopped
from tests.support.plugins import PLUGINS, CoastPlanner, StillPredictor
from tests.support.runs import configured, run_here, untimed
from tests.support.scenes import Goal, Problem, User, driving, rectangle, write_scenario_xml

START = 5
LAST = 40
IDS = ("ZAM_Test-0_1_T-1", "ZAM_Test-1_1_T-1")
GOAL = Goal(last_step=LAST, position=rectangle(6.0, 3.0, 44.0, 0.0))
COUNT = 3
"""Futures of each scenario: all go on; the leader brakes; somebody comes, far away."""


def write_place(folder: Path, name: str) -> Path:
    """Writes a scenario in which a leader goes on or brakes; the ego coasts at 10 m/s.

    Args:
        folder: Where; made.
        name: Id of the scenario.

    Returns:
        The scenario file.
    """
    path = folder / "files" / f"{name}.xml"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_scenario_xml(
        path,
        users=[User(7, driving(20.0, 0.0, 10.0, LAST + 1))],
        problems=[Problem(start_step=START, goals=(GOAL,))],
        benchmark_id=name,
    )
    scenario = load_scenario(path)
    brakes, comes = stopped(scenario.tracks, 7, START), appended(scenario.tracks, 90, START + 1)
    write_futures(folder / "futures" / f"{name}.npz", scenario, [brakes, comes])
    return path


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded") / "places"
    for name in IDS:
        write_place(folder, name)
    return folder


@pytest.fixture(scope="module")
def scenario(places: Path) -> Scenario:
    return load_scenario(places / "files" / f"{IDS[0]}.xml")


@pytest.fixture(scope="module")
def finished(places: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    out = tmp_path_factory.mktemp("run") / "out"
    return run_here(configured(out, places, futures=COUNT))


def test_every_future_is_driven_and_scored_as_itself(finished: RunFolder) -> None:
    rows = read_rows(finished.rows)
    assert len(rows) == len(IDS) * len(Arm) * COUNT
    for row in rows:
        assert row.outcome is (Outcome.COLLISION if row.future == 1 else Outcome.SUCCESS)
    comparison = read_summary(finished).comparison
    assert comparison is not None
    assert (comparison.n, comparison.futures) == (len(IDS) * COUNT, COUNT)


def test_episodes_of_a_recording_keep_no_copy_of_it(
    finished: RunFolder, places: Path, scenario: Scenario
) -> None:
    drives = list(find_drives(finished.path, IDS[0], source=str(places)))
    assert len(drives) == len(Arm) * COUNT
    for row, drive in drives:
        assert drive is not None
        assert drive.recording.tracks is None
        recorded = scenario.recorded(row.future)
        np.testing.assert_array_equal(drive.tracks.states, recorded.states)
        assert (drive.contact is not None) == (row.future == 1)


def test_scores_and_explanations_are_of_the_future_that_was_driven(
    finished: RunFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", str(finished.path)]) == OK
    assert "12 of 12 rows agree" in capsys.readouterr().out
    assert main(["explain", str(finished.path), IDS[0], "--future", "1", "--arm", "with_dos"]) == OK
    told = capsys.readouterr().out
    assert "collision" in told
    assert "with car 7" in told
    assert main(["explain", str(finished.path), IDS[0], "--future", "2"]) == OK
    assert "collision" not in capsys.readouterr().out


def test_solutions_of_other_futures_say_so(places: Path, tmp_path: Path) -> None:
    """A solution is checked against the scenario file, which records future 0."""
    config = configured(tmp_path / "out", places, futures=2, solutions=True, ids=(IDS[0],))
    folder = run_here(config)
    for future in (0, 1):
        key = EpisodeKey(IDS[0], Arm.WITH_DOS, future)
        text = folder.solution(IDS[0], key).read_text(encoding="utf-8")
        assert ("driven among replay in future 1, not the recorded" in text) == (future == 1)


def test_futures_that_are_gone_are_named(
    finished: RunFolder, places: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(places / "files", tmp_path / "files")
    command = ["score", str(finished.path), "--source", str(tmp_path)]
    assert main(command) != OK
    told = "".join(capsys.readouterr())
    assert "has 1 recorded future, and future 1 is asked for" in told


def test_a_run_grows_to_the_futures_that_are_recorded_and_no_further(
    finished: RunFolder, places: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_here(configured(out, places, futures=1))
    driven: list[int] = []

    class Listing(Observer):
        def add(self, row: Score) -> None:
            driven.append(row.future)

    assert untimed(run_here(configured(out, places, futures=COUNT), Listing())) == untimed(finished)
    assert set(driven) == {1, 2}
    manifest = RunFolder(out).manifest.read_bytes()
    for traffic in ("replay", "reactive"):
        with pytest.raises(RunError, match=r"has 3 for 2 of the 2 scenarios, as ZAM_Test-0_1_T-1"):
            run_here(configured(tmp_path / traffic, places, futures=COUNT + 1, traffic=traffic))
        assert not (tmp_path / traffic).exists()
    with pytest.raises(RunError, match="the traffic replay has 3 for"):
        run_here(configured(out, places, futures=COUNT + 1))
    assert RunFolder(out).manifest.read_bytes() == manifest


def test_a_run_does_not_go_on_with_other_futures(tmp_path: Path) -> None:
    path = write_place(tmp_path / "places", IDS[0])
    run_here(configured(tmp_path / "out", tmp_path / "places", futures=2))
    scenario = load_scenario(path)
    file = tmp_path / "places" / "futures" / f"{IDS[0]}.npz"
    write_futures(file, replace(scenario, futures=()), [scenario.tracks, scenario.tracks])
    with pytest.raises(RunError, match="scenario files"):
        run_here(configured(tmp_path / "out", tmp_path / "places", futures=2))


@pytest.mark.parametrize("futures", ["1", "2"])
def test_a_damaged_file_of_futures_costs_its_own_scenario_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], futures: str
) -> None:
    for name in IDS[:2]:
        write_place(tmp_path / "places", name)
    file = tmp_path / "places" / "futures" / f"{IDS[0]}.npz"
    file.write_bytes(file.read_bytes()[:300])
    command = ["run", str(tmp_path / "places"), "--out", str(tmp_path / "out"), "--in-process"]
    plugins = ["--planner", f"{PLUGINS}:CoastPlanner", "--predictor", f"{PLUGINS}:StillPredictor"]
    assert main([*command, *plugins, "--futures", futures]) == FAILED
    assert "is no file of futures of this version" in capsys.readouterr().out
    outcomes = [row.outcome for row in read_rows(tmp_path / "out" / "scenarios.jsonl")]
    assert outcomes.count(Outcome.UNUSABLE) == len(outcomes) // 2 > 0


@pytest.mark.parametrize("made_by", [Replay, ReactiveTraffic])
def test_traffic_drives_the_recorded_future_of_its_number(
    scenario: Scenario, made_by: type[Traffic]
) -> None:
    """An ego far behind is in nobody's way: who reacts then drives as recorded, to the last bit."""
    behind = replace(scenario.task, start=np.array([-30.0, 0.0, 0.0, 1.0, 0.0]))
    alone = replace(scenario, task=behind)
    for future in range(COUNT):
        world = World(alone, made_by(future=future, seed=3))
        recorded = alone.recorded(future)
        for step in range(START + 1, LAST + 1):
            world.step(np.zeros(2))
            met, meant = users_at(world.tracks, step), users_at(recorded, step)
            assert met.ids.tolist() == meant.ids.tolist()
            np.testing.assert_array_equal(met.states, meant.states)


def test_who_reacts_does_so_along_its_future(scenario: Scenario) -> None:
    """A follower that is recorded to go on brakes for the ego; one that stops does not reach it."""
    task = scenario.task
    start = np.array(task.start)
    start[0] = scenario.tracks.states[0, START, USER_X] + 8.0  # The leader has become a follower.
    start[3] = 4.0
    slow = replace(scenario, task=replace(task, start=start))
    way = {}
    for future in (0, 1):
        traffic = ReactiveTraffic(future=future)
        episode = run_episode(slow, CoastPlanner(), StillPredictor(), Arm.WITH_DOS, traffic=traffic)
        row = score(slow, episode)
        assert episode.future == row.future == future
        assert row.collision_step is None
        way[future] = row.measures["imposed_braking"]
    assert way[0] is not None
    assert way[0] > 1.0
    assert way[1] == 0.0


@pytest.mark.parametrize("future", range(COUNT))
def test_the_truth_that_is_shown_is_that_of_the_episode(scenario: Scenario, future: int) -> None:
    episode = run_episode(
        scenario,
        CoastPlanner(),
        GroundTruthPredictor(),
        Arm.WITH_DOS,
        traffic=Replay(future=future),
    )
    recorded = scenario.recorded(future)
    shown, step = episode.occupancies[0], int(episode.cycle_steps[0])
    for row, name in enumerate(shown.ids):
        states = recorded.states[recorded.ids == name][0]
        for k in range(10):
            np.testing.assert_allclose(shown.centre[row, k], states[step + 1 + k, :2], atol=1e-9)


def test_observations_are_the_same_until_futures_part(scenario: Scenario) -> None:
    seen = [World(scenario, Replay(future=future)).observation() for future in range(COUNT)]
    for one in seen[1:]:
        for field in ("ids", "states", "valid", "size"):
            np.testing.assert_array_equal(getattr(one, field), getattr(seen[0], field))


def test_a_known_drive_is_scored_in_its_future(scenario: Scenario) -> None:
    steps = np.arange(LAST - START + 1)
    states = np.array(scenario.task.start)[None] + np.outer(steps, [1.0, 0.0, 0.0, 0.0, 0.0])
    outcomes = [
        score(scenario, known_drive(scenario, Arm.WITH_DOS, START, states, future)).outcome
        for future in range(COUNT)
    ]
    assert outcomes == [Outcome.SUCCESS, Outcome.COLLISION, Outcome.SUCCESS]


def test_sets_are_measured_over_recorded_futures(
    places: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["evaluate", str(places), "--predictor", "constant-velocity", "--workers", "1"]
    assert main([*asked, "--traffic", "replay", "--futures", str(COUNT)]) == OK
    assert "3 futures of each by the traffic replay" in capsys.readouterr().out
    assert main([*asked, "--traffic", "replay", "--futures", "4"]) == BAD_INPUT
    assert "has 3 recorded futures, and 4 are asked for" in capsys.readouterr().err


def test_archives_bring_the_futures(places: Path, tmp_path: Path) -> None:
    archive = shutil.make_archive(str(tmp_path / "places"), "zip", places)
    refs = find_scenarios(archive)
    assert len(refs) == len(IDS)
    for ref in refs:
        assert len(load_scenario(ref).futures) == COUNT - 1
