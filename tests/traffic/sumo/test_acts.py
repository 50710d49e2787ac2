"""Traffic of SUMO whose cast acts the futures of a scenario."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import numpy as np
import pytest

from dosplan.scenario import ScenarioError, load_scenario
from dosplan.scenario.sources.sumo import ACTS, configuration_of, read_configuration
from dosplan.types import USER_VELOCITY, FloatArray, Scenario, Tracks
from tests.support.suite import FUTURES_SUITE, SUITE, drive_of
from tests.support.sumo import ZEBRA, driven_around

pytest.importorskip("libsumo", reason="needs dosplan[sumo]")

from dosplan_sumo.acts import Act, Acts, acts_file, read_acts
from dosplan_sumo.demand import read_demand, write_demand
from dosplan_sumo.script import Action, Verb
from dosplan_sumo.traffic import SumoTraffic

STEPS = 25


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The file of a scenario with SUMO's files, in a folder of its own."""
    (tmp_path / "files").mkdir()
    shutil.copy(SUITE / "files" / f"{ZEBRA}.xml.gz", tmp_path / "files")
    (tmp_path / "sumo-files").mkdir()
    geometry = ZEBRA.partition("_T-")[0].rpartition("_")[0]
    for name in (f"{geometry}.net.xml.gz", f"{ZEBRA}.rou.xml.gz", f"{ZEBRA}.sumo.cfg"):
        shutil.copy(SUITE / "sumo-files" / name, tmp_path / "sumo-files")
    return tmp_path / "files" / f"{ZEBRA}.xml.gz"


def _drive(scenario: Scenario, future: int) -> tuple[dict[str, int], dict[int, FloatArray]]:
    """Ids by SUMO's names, and the velocity of each road user, around an ego that stands."""
    traffic = SumoTraffic(future=future)
    try:
        first = scenario.task.start_step
        traffic.begin(scenario, first)
        names = {name: known.id for name, known in traffic._known.items()}
        ego = np.tile(scenario.task.start, (1, 1))
        speeds: dict[int, list[float]] = {}
        for step in range(first + 1, first + 1 + STEPS):
            ego = np.vstack([ego, scenario.task.start])
            users = traffic.step(step, ego)
            for name, state in zip(users.ids.tolist(), users.states, strict=True):
                speeds.setdefault(name, []).append(state[USER_VELOCITY])
        return names, {name: np.array(each) for name, each in speeds.items()}
    finally:
        traffic.close()


@pytest.fixture
def braking(place: Path) -> tuple[Scenario, int, dict[int, FloatArray]]:
    """A scenario in whose future 1 the fastest brakes, its id, and the velocities without that."""
    scenario = load_scenario(place)
    names, plain = _drive(scenario, 0)
    whole = {name: id for name, id in names.items() if len(plain.get(id, ())) == STEPS}
    actor = max(whole, key=lambda name: plain[whole[name]].min())
    start = float(_start(place))
    script = (Action(0.0, actor, Verb.BRAKE, 0.0, over=1.0),)
    acts = Acts(0.0, (), start + 1.0, (Act("goes on", ()), Act("brakes", script)))
    path = place.parents[1] / "sumo-files" / f"{ZEBRA}{ACTS}"
    path.write_bytes(acts.json())
    assert read_acts(path) == acts
    return scenario, whole[actor], plain


def _start(place: Path) -> float:
    configuration = configuration_of(place)
    assert configuration is not None
    folder = place.parent / "demand"
    folder.mkdir()
    start = write_demand(read_demand(read_configuration(configuration)), folder).start
    assert start is not None
    return start


def test_the_cast_acts_its_future_from_the_branch_on(
    braking: tuple[Scenario, int, dict[int, FloatArray]],
) -> None:
    scenario, actor, plain = braking
    for future, brakes in ((0, False), (1, True)):
        _, speeds = _drive(scenario, future)
        np.testing.assert_array_equal(speeds[actor][:10], plain[actor][:10])
        assert bool(speeds[actor][-1] < 0.1) is brakes
        others = [name for name in plain if name != actor and len(plain[name]) == STEPS]
        assert any(np.array_equal(speeds[name], plain[name]) for name in others)


def test_where_the_scene_is_not_recognised_futures_differ_by_their_drivers(
    braking: tuple[Scenario, int, dict[int, FloatArray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, _, _ = braking
    monkeypatch.setattr(SumoTraffic, "_recognised", lambda *_: False)
    (_, first), (_, second) = (_drive(scenario, future) for future in (0, 1))
    assert any(
        len(first[name]) == len(second[name]) and not np.array_equal(first[name], second[name])
        for name in first.keys() & second.keys()
    )


@pytest.mark.skipif(
    SumoTraffic.versions() != {"libsumo": "1.28.0"}, reason="another SUMO than the suite's"
)
@pytest.mark.parametrize(
    ("name", "futures"),
    [
        ("ZAM_BusStop-1_1_T-1", (0, 1)),  # A bus stays at its stop, or pulls out.
        ("ZAM_OncomingTurn-1_1_T-1", (0, 1)),  # A car goes straight on, or turns left.
        ("ZAM_AmberTurn-1_1_T-1", (0, 2)),  # A car runs the amber light, or stops at it.
    ],
)
def test_the_cast_of_the_suite_drives_as_it_is_recorded_in_each_future(
    name: str, futures: tuple[int, int]
) -> None:
    """Around the recorded ego everybody is where it is recorded, and not where another future is.

    The recording is smoothed, by up to 0.4 m; the two futures are metres apart.
    """
    scenario = load_scenario(FUTURES_SUITE / "files" / f"{name}.xml.gz")
    for future, other in (futures, futures[::-1]):
        traffic = SumoTraffic(future=future)
        try:
            drive = drive_of(FUTURES_SUITE, name, future)
            driven = driven_around(traffic, scenario, drive[1:])
        finally:
            traffic.close()
        assert _apart(driven, scenario.recorded(future), scenario.task.start_step) < 0.2
        assert _apart(driven, scenario.recorded(other), scenario.task.start_step) > 2.0


def _apart(one: Tracks, other: Tracks, start: int) -> float:
    """Mean distance of the road user that is farthest off, of those on the scene at the start."""
    steps = min(one.steps, other.steps)
    means = []
    for row in np.flatnonzero(other.valid[:, start]):
        (own,) = np.flatnonzero(one.ids == other.ids[row])
        both = one.valid[own, :steps] & other.valid[row, :steps]
        both[: start + 1] = False
        away = one.states[own, :steps] - other.states[row, :steps]
        means.append(float(np.hypot(*away[both, :2].T).mean()))
    return max(means)


def test_the_file_is_one_of_those_that_a_run_depends_on(
    braking: tuple[Scenario, int, dict[int, FloatArray]], place: Path
) -> None:
    configuration = place.parents[1] / "sumo-files" / f"{ZEBRA}.sumo.cfg"
    assert acts_file(configuration) in set(SumoTraffic.reads(place))


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        "{}",
        '{"appearance": 0, "prelude": [], "branch": 1, "futures": []}',
        '{"appearance": 0, "prelude": [{"at": 0, "actor": "a", "verb": "halt"}], "branch": 1, '
        '"futures": [{"intention": "", "script": []}]}',
        "[" * 100_000,
    ],
)
def test_a_broken_file_is_one_line(place: Path, content: str) -> None:
    path = place.parents[1] / "sumo-files" / f"{ZEBRA}{ACTS}"
    path.write_bytes(gzip.compress(content.encode()))
    with pytest.raises(ScenarioError, match="tells no futures"):
        read_acts(path)
    reason = SumoTraffic.refuses(load_scenario(place))
    assert reason is not None
    assert "\n" not in reason


def test_recorded_futures_without_what_happens_in_them_are_refused(tmp_path: Path) -> None:
    path = next(iter(sorted((FUTURES_SUITE / "files").iterdir())))
    name = path.name.removesuffix(".xml.gz")
    (tmp_path / "files").mkdir()
    file = Path(shutil.copy(path, tmp_path / "files"))
    for wanted in (f"futures/{name}.npz", f"sumo-files/ZAM_{name.split('_')[1]}*"):
        for of_it in FUTURES_SUITE.glob(wanted):
            place = tmp_path / of_it.relative_to(FUTURES_SUITE)
            place.parent.mkdir(exist_ok=True)
            shutil.copy(of_it, place)
    assert SumoTraffic.refuses(load_scenario(file)) is None
    (tmp_path / "sumo-files" / f"{name}{ACTS}").unlink()
    reason = SumoTraffic.refuses(load_scenario(file))
    assert reason is not None
    assert "which says what happens in the recorded futures" in reason
