"""Windows of whom the ego of a run met: nobody else is learned from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dosplan_net.features import HORIZON
from dosplan_net.training.cache import CacheError, WindowCache, build_cache

from dosplan.cli.main import main
from dosplan.evaluation.met import read_drives
from dosplan.results.folder import RunFolder
from dosplan.running.config import RunConfig
from dosplan.scenario import load_scenario
from dosplan.scenario.futures import write_futures
from dosplan.system.files import FileError
from dosplan.types import Arm, FloatArray
from tests.support import scenes
from tests.support.futures import stopped
from tests.support.runs import run_here
from tests.support.scenes import Goal, Problem, User, driving

START, STEPS, EVERY = 50, 111, 10
BESIDE, COMES, FAR = 7, 8, 9
NAME = "ZAM_Met-1_1_T-1"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ego at 10 m/s from step 50 on, somebody beside it, and somebody who comes or stops."""
    folder = tmp_path_factory.mktemp("met") / "files"
    folder.mkdir()
    users = [
        User(BESIDE, driving(-30.0, 3.5, 10.0, STEPS)),
        User(COMES, driving(180.0, 3.5, 10.0, STEPS, np.pi)),
        User(FAR, driving(300.0, 3.5, 10.0, STEPS)),
    ]
    goal = Goal(last_step=STEPS - 1, position=scenes.rectangle(4.0, 3.5, 350.0))  # Too far.
    path = scenes.write_scenario_xml(
        folder / f"{NAME}.xml",
        scenes.straight_road(lanes=1, oncoming=1, length=400.0),
        users,
        [Problem(start_step=START, goals=(goal,))],
        benchmark_id=NAME,
    )
    scenario = load_scenario(path)
    others = (stopped(scenario.tracks, COMES, START),)
    write_futures(folder.parent / "futures" / f"{NAME}.npz", scenario, others)
    return folder


@pytest.fixture(scope="module")
def run(source: Path) -> RunFolder:
    out = source.parent / "run"
    return drive(source, out, "replay", futures=2)


def drive(source: Path, out: Path, traffic: str, futures: int) -> RunFolder:
    config = RunConfig(
        source=str(source), out=out, planner="cruise", predictor="none", traffic=traffic,
        futures=futures, arms=(Arm.WITHOUT_DOS,),
    )  # fmt: skip
    return run_here(config)


def learned(cache: WindowCache) -> list[set[int]]:
    """Whom there is something to learn from, scene after scene: by their places at the start."""
    names = np.array([BESIDE, COMES, FAR])
    found = []
    for first, last in zip(cache.scene_start[:-1], cache.scene_start[1:], strict=True):
        assert last - first == len(names)  # The others are there as neighbours.
        found.append(set(names[cache.future_valid[first:last].any(axis=1)].tolist()))
    return found


def ego(run: RunFolder, future: int) -> FloatArray:
    (path,) = read_drives(run.path)[NAME][future]
    assert path.start == START
    return path.centres


def test_only_who_was_near_within_the_horizon_is_learned_from(source: Path, run: RunFolder) -> None:
    for future in (0, 1):
        x = ego(run, future)[:, 0]
        np.testing.assert_allclose(x, 10.0 + np.arange(len(x)), atol=1e-6)
    out = source.parent / "cache"
    build_cache([source], out, every=EVERY, met=run.path)
    # Nobody is met before the start. Who comes is nearer than 20 m from step 101 on, which is
    # within the four seconds after step 70; after step 110 nothing is recorded.
    assert HORIZON == 40
    assert learned(WindowCache.open(out)) == [
        {BESIDE},  # 50
        {BESIDE},  # 60
        {BESIDE, COMES},
        {BESIDE, COMES},
        {BESIDE, COMES},
        {BESIDE, COMES},  # 100
    ]


def test_in_each_future_it_is_who_was_met_there(source: Path, run: RunFolder) -> None:
    out = source.parent / "cache-2"
    build_cache([source], out, every=EVERY, futures=2, met=run.path)
    cache = WindowCache.open(out)
    both = {BESIDE, COMES}
    first = [{BESIDE}, {BESIDE}, both, both, both, both]
    assert learned(cache) == first + [{BESIDE}] * 6  # It stops 50 m before the ego's last place.
    np.testing.assert_allclose(cache.scene_weight, 0.5)


def test_another_run_makes_other_windows_in_the_same_folder(source: Path, run: RunFolder) -> None:
    out = source.parent / "cache-3"
    build_cache([source], out, every=EVERY)
    everybody = WindowCache.open(out)
    assert learned(everybody)[0] == {BESIDE, COMES, FAR}
    build_cache([source], out, every=EVERY, met=run.path)
    met = WindowCache.open(out)
    assert met.digest != everybody.digest
    assert learned(met)[0] == {BESIDE}


def test_a_run_of_other_recordings_or_of_traffic_that_reacted_is_refused(
    source: Path, run: RunFolder, tmp_path: Path
) -> None:
    other = tmp_path / "files"
    other.mkdir()
    text = (source / f"{NAME}.xml").read_text().replace(NAME, "ZAM_Other-1_1_T-1")
    (other / "ZAM_Other-1_1_T-1.xml").write_text(text)
    with pytest.raises(CacheError, match="drove none of these recordings"):
        build_cache([other], tmp_path / "cache", met=run.path)
    reacted = drive(source, tmp_path / "run", "reactive", futures=1)
    with pytest.raises(FileError, match="driven in traffic reactive"):
        build_cache([source], tmp_path / "cache", met=reacted.path)


def test_the_command_says_what_is_wrong_with_the_run(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(
        ["data", "build", str(source), "--out", str(tmp_path / "c"), "--met", str(tmp_path / "no")]
    )
    assert code == 2
    assert str(tmp_path / "no") in capsys.readouterr().err
