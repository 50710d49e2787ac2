"""Recorded futures beside a scenario file: written, read back, refused where they do not fit."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dosplan.scenario import ScenarioError, load_recording, load_scenario
from dosplan.scenario.futures import count_futures, pack_futures, with_futures, write_futures
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    USER_X,
    FloatArray,
    RoadUserKind,
    Scenario,
    ShapeError,
    Tracks,
)
from tests.support.futures import appended, moved_on, stopped, without
from tests.support.scenes import Goal, Problem, User, driving, write_scenario_xml

START = 5
STEPS = 31
PROBLEM = Problem(start_step=START, goals=(Goal(last_step=STEPS - 1),))


def _write(path: Path) -> Scenario:
    users = [User(7, driving(60.0, 0.0, 5.0, STEPS)), User(8, driving(5.0, 3.5, 12.0, STEPS))]
    write_scenario_xml(path, users=users, problems=[PROBLEM])
    return load_scenario(path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "files" / "ZAM_Test-1_1_T-1.xml.gz"


@pytest.fixture
def scenario(file: Path) -> Scenario:
    file.parent.mkdir()
    return _write(file)


def _row(tracks: Tracks, name: int) -> int:
    return int(np.flatnonzero(tracks.ids == name)[0])


@pytest.mark.parametrize("place", ["futures", "files/futures"])
def test_futures_come_back_from_beside_the_file(
    tmp_path: Path, file: Path, scenario: Scenario, place: str
) -> None:
    assert count_futures(file) == 1
    brakes = stopped(scenario.tracks, 7, START)
    comes = appended(without(scenario.tracks, 8, START), 90, START + 3)
    write_futures(tmp_path / place / "ZAM_Test-1_1_T-1.npz", scenario, [brakes, comes])
    read = load_scenario(file)
    assert count_futures(file) == 1 + len(read.futures) == 3
    assert read.recorded(0) is read.tracks
    for number, meant in enumerate((brakes, comes), start=1):
        _check_alike(read.recorded(number), meant)
    assert load_recording(file).futures == ()


def _check_alike(read: Tracks, meant: Tracks) -> None:
    """Whether tracks are those that were meant, to half a grain, and the past to the last bit."""
    there = [i for i in range(len(meant.ids)) if meant.valid[i].any()]
    assert read.ids.tolist() == meant.ids[there].tolist()
    assert read.kinds == tuple(meant.kinds[i] for i in there)
    np.testing.assert_array_equal(read.size, meant.size[there])
    np.testing.assert_array_equal(read.valid, meant.valid[there])
    gone = ~read.valid
    assert np.isnan(read.states[gone]).all()
    states = meant.states[there]
    np.testing.assert_array_equal(read.states[:, : START + 1], states[:, : START + 1])
    apart = np.where(gone[..., None], 0.0, read.states - states)
    assert np.abs(np.sin(0.5 * apart[..., USER_HEADING])).max() <= 0.26e-4
    assert np.abs(np.delete(apart, USER_HEADING, axis=-1)).max() <= 0.501e-3


def test_users_who_do_as_recorded_are_the_recorded_ones(scenario: Scenario, tmp_path: Path) -> None:
    path = tmp_path / "some.npz"
    write_futures(path, scenario, [stopped(scenario.tracks, 7, START)])
    (future,) = with_futures(scenario, path).futures
    other = _row(scenario.tracks, 8)
    np.testing.assert_array_equal(future.states[other], scenario.tracks.states[other])
    assert not np.array_equal(future.states[1 - other], scenario.tracks.states[1 - other])


def test_equal_futures_give_equal_bytes(scenario: Scenario) -> None:
    futures = [stopped(scenario.tracks, 7, START), appended(scenario.tracks, 90, START + 1)]
    data = pack_futures(scenario, futures)
    assert data == pack_futures(scenario, futures)
    turned = Tracks(
        ids=futures[1].ids[::-1],
        kinds=futures[1].kinds[::-1],
        size=futures[1].size[::-1],
        states=futures[1].states[::-1],
        valid=futures[1].valid[::-1],
    )
    with np.load(io.BytesIO(data), allow_pickle=False) as one:
        assert one["bends"].dtype == np.int16
    # The order of road users does not matter.
    assert pack_futures(scenario, [futures[0], turned]) == data


def test_a_future_like_the_recording_takes_no_room(scenario: Scenario, tmp_path: Path) -> None:
    path = tmp_path / "same.npz"
    write_futures(path, scenario, [scenario.tracks])
    (future,) = with_futures(scenario, path).futures
    np.testing.assert_array_equal(future.states, scenario.tracks.states)
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["rows"].shape == (0, 4)


def test_a_future_that_is_not_recorded_is_named(scenario: Scenario) -> None:
    with pytest.raises(ShapeError, match="has 1 recorded future, and future 1 is asked for"):
        scenario.recorded(1)
    more = replace(scenario, futures=(scenario.tracks,))
    with pytest.raises(ShapeError, match="has 2 recorded futures, and future -1 is asked for"):
        more.recorded(-1)


_walks = st.lists(
    st.tuples(
        st.floats(-400.0, 400.0), st.floats(-400.0, 400.0), st.floats(-7.0, 7.0), st.floats(0, 60)
    ),
    min_size=1,
    max_size=12,
)


@settings(max_examples=40, deadline=None)
@given(walks=st.lists(_walks, max_size=3), later=st.integers(0, 4), heading=st.floats(-10.0, 10.0))
def test_any_motion_comes_back(
    tmp_path_factory: pytest.TempPathFactory,
    walks: list[list[tuple[float, ...]]],
    later: int,
    heading: float,
) -> None:
    first = np.array([[10.0, 0.0, heading, 5.0], [30.0, 3.5, 0.0, 8.0]])
    scenario = replace(straight_scenario(steady_tracks(np.round(first, 3), steps=40)), futures=())
    scenario = replace(scenario, tracks=_whole_grains(scenario.tracks))
    start = scenario.task.start_step
    futures = []
    for k, walk in enumerate(walks):
        states = np.array(walk)[: 40 - start - 1 - later]
        future = without(scenario.tracks, 100, start)
        futures.append(_walked(future, 100 if k % 2 else 100 + k, start + 1 + later, states))
    path = tmp_path_factory.mktemp("any") / "any.npz"
    if not futures:
        with pytest.raises(ShapeError, match="0 futures"):
            pack_futures(scenario, futures)
        return
    write_futures(path, scenario, futures)
    for read, meant in zip(with_futures(scenario, path).futures, futures, strict=True):
        kept = meant.valid.any(axis=1)
        np.testing.assert_array_equal(read.valid, meant.valid[kept])
        apart = (read.states - meant.states[kept])[read.valid]
        # A full turn is no whole number of grains, so that a heading may be a grain off.
        assert np.abs(np.sin(0.5 * apart[:, USER_HEADING])).max() <= 0.51e-4
        assert np.abs(np.delete(apart, USER_HEADING, axis=1)).max() <= 0.501e-3


def _whole_grains(tracks: Tracks) -> Tracks:
    return replace(tracks, states=np.round(tracks.states, 3))


def _walked(tracks: Tracks, name: int, first: int, states: FloatArray) -> Tracks:
    """With a road user, perhaps a new one, that is at some places from a step on."""
    if name not in tracks.ids:
        tracks = appended(tracks, name, first)
    row = _row(tracks, name)
    all_states, valid = np.array(tracks.states), np.array(tracks.valid)
    end = first + len(states)
    past = tracks.valid[row] & (np.arange(tracks.steps) < first)
    valid[row] = past
    all_states[row, ~past] = np.nan
    all_states[row, first:end], valid[row, first:end] = states, True
    return replace(tracks, states=all_states, valid=valid)


def test_another_past_is_refused(scenario: Scenario) -> None:
    early = moved_on(scenario.tracks, 7, START - 1, 0.002)
    with pytest.raises(ShapeError, match="road user 7 is elsewhere in future 1 at step 5"):
        pack_futures(scenario, [early])
    with pytest.raises(ShapeError, match="road user 8 is elsewhere in future 2 at step 0"):
        pack_futures(scenario, [scenario.tracks, without(scenario.tracks, 8, -1)])
    pack_futures(scenario, [moved_on(scenario.tracks, 7, START, 0.002)])


def test_what_no_road_user_can_do_is_refused(scenario: Scenario) -> None:
    tracks = scenario.tracks
    longer = replace(tracks, size=tracks.size + np.array([[0.0], [0.1]]))
    with pytest.raises(ShapeError, match="8 has another kind or size in future 1"):
        pack_futures(scenario, [stopped(longer, 8, START)])
    back = np.array(stopped(tracks, 7, START).valid)
    back[_row(tracks, 7), START + 4] = False
    with pytest.raises(ShapeError, match="7 leaves and comes back in future 1"):
        pack_futures(scenario, [replace(stopped(tracks, 7, START), valid=back)])
    shorter = replace(tracks, states=tracks.states[:, :-1], valid=tracks.valid[:, :-1])
    with pytest.raises(ShapeError, match="future 1 has 30 steps, and the recording 31"):
        pack_futures(scenario, [shorter])
    parked = replace(tracks, kinds=(RoadUserKind.PARKED, *tracks.kinds[1:]))
    with pytest.raises(ShapeError, match="7 is parked and moves in future 1"):
        pack_futures(replace(scenario, tracks=parked), [stopped(parked, 7, START)])


def test_a_file_of_another_recording_is_refused(tmp_path: Path, file: Path) -> None:
    file.parent.mkdir()
    scenario = _write(file)
    path = tmp_path / "futures" / "ZAM_Test-1_1_T-1.npz"
    write_futures(path, scenario, [stopped(scenario.tracks, 7, START)])
    late = replace(scenario, task=replace(scenario.task, start_step=START + 1))
    with pytest.raises(ScenarioError, match="differ from step 6 on, before the ego's start at st"):
        with_futures(late, path)
    users = [User(7, driving(60.5, 0.0, 5.0, STEPS)), User(8, driving(5.0, 3.5, 12.0, STEPS))]
    write_scenario_xml(file, users=users, problems=[PROBLEM])
    with pytest.raises(ScenarioError, match=r"T-1\.npz: was made for another recording"):
        load_scenario(file)


def _changed(data: bytes, name: str, value: object) -> bytes:
    """The file with one array replaced."""
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        members = {key: arrays[key] for key in arrays.files}
    out = io.BytesIO()
    np.savez(out, allow_pickle=True, **{**members, name: np.asarray(value)})
    return out.getvalue()


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("rows", [[1, 7, 6, 3]], "bends has shape"),
        ("rows", [[2, 7, 6, 25]], "beyond those that it holds"),
        ("rows", [[1, 9, 6, 25]], "road user 9 is not in the recording"),
        ("rows", [[1, 7, 5, 25]], "not after the start"),
        ("rows", [[1, 7, 20, 25]], "moves where it cannot"),
        ("begins", np.zeros((1, 2, 3), dtype=np.int64), "begins has shape"),
        ("begins", np.zeros((1, 2, 4)), "Cannot cast"),
        ("bends", np.array([{}], dtype=object), "pickle"),
        ("new_ids", np.array([7]), "new_ids has shape"),
    ],
)
def test_damage_gives_a_line(
    scenario: Scenario, tmp_path: Path, name: str, value: object, why: str
) -> None:
    path = tmp_path / "bad.npz"
    path.write_bytes(
        _changed(pack_futures(scenario, [stopped(scenario.tracks, 7, START)]), name, value)
    )
    with pytest.raises(ScenarioError, match=why) as refused:
        with_futures(scenario, path)
    assert str(refused.value).startswith(f"{path}: is no file of futures of this version (")
    assert "\n" not in str(refused.value)


def test_what_is_no_archive_or_too_large_gives_a_line(scenario: Scenario, tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    good = pack_futures(scenario, [stopped(scenario.tracks, 7, START)])
    for data in (b"", b"no archive", good[:-30], good[:200]):
        path.write_bytes(data)
        with pytest.raises(ScenarioError, match="is no file of futures of this version"):
            with_futures(scenario, path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a", "w") as out:
        for _ in range(300):
            out.write(bytes(1024 * 1024))
    with pytest.raises(ScenarioError, match="expected 268435456 at most"):
        with_futures(scenario, path)


def test_velocities_are_kept_as_finely_as_in_scenario_files(
    scenario: Scenario, tmp_path: Path
) -> None:
    """What a predictor derives from positions must not tell one future from another."""
    path = tmp_path / "fine.npz"
    brakes = stopped(scenario.tracks, 7, START)
    write_futures(path, scenario, [brakes])
    (read,) = with_futures(scenario, path).futures
    row = _row(brakes, 7)
    moved, meant = (np.diff(t.states[row, :, USER_X]) / scenario.dt for t in (read, brakes))
    assert np.abs(moved - meant).max() < 0.011
    assert np.abs(read.states[row] - brakes.states[row])[:, USER_VELOCITY].max() < 0.0006
