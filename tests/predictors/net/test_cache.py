"""The cache of training windows: what is in it, and what happens to builds that are cut off."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from dosplan_net.features import HISTORY, HORIZON, cut_map, describe
from dosplan_net.training.cache import (
    FORMAT,
    MIN_FUTURE,
    CacheError,
    WindowCache,
    _extract_to,
    _Job,
    _Writer,
    build_cache,
    recorded_together,
)

from dosplan.geometry import to_body
from dosplan.scenario import find_scenarios, load_scenario
from dosplan.simulation.settings import IDEAL, LoopSettings, SensingSettings
from dosplan.simulation.world import World, watch
from dosplan.system.files import write_json
from dosplan.types import Scenario
from tests.predictors.conftest import CACHED, EVERY
from tests.support import scenes
from tests.support.scenes import User, write_scenario_xml


def scenario_of(recordings: Path, number: int) -> Scenario:
    return load_scenario(find_scenarios(recordings / f"{CACHED[number]}.xml.gz")[0])


def arrays(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.npy"))}


def own_build(recordings: Path, tmp_path: Path) -> Path:
    build_cache([recordings], tmp_path / "cache", every=EVERY)
    return tmp_path / "cache"


@pytest.mark.parametrize("number", range(len(CACHED)))
def test_a_cache_holds_what_describe_says(
    window_cache: Path, recordings: Path, number: int
) -> None:
    cache = WindowCache.open(window_cache)
    scenario = scenario_of(recordings, number)
    origin = scenario.task.start[:2]
    pieces = cut_map(scenario.road_map)
    first_piece = sum(len(cut_map(scenario_of(recordings, i).road_map).pose) for i in range(number))
    own = np.flatnonzero(cache.scene_recording == number)
    assert len(own) == len(range(0, scenario.tracks.steps - MIN_FUTURE, EVERY))
    for index in (0, 3, len(own) - 1):
        step = index * EVERY
        observation = World(scenario, first_step=step, history=HISTORY).observation()
        expected = describe(observation, pieces)
        first = int(cache.scene_start[own[index]])
        rows = slice(first, int(cache.scene_start[own[index] + 1]))
        pose = expected.pose - np.array([*origin, 0.0, 0.0])
        np.testing.assert_array_equal(cache.pose[rows], pose.astype(np.float32))
        np.testing.assert_array_equal(cache.history[rows], expected.history)
        np.testing.assert_array_equal(cache.static[rows], expected.static)
        for stored, described, offset in (
            (cache.neighbours[rows], expected.neighbours, first),
            (cache.pieces[rows], expected.pieces, first_piece),
        ):
            np.testing.assert_array_equal(stored, np.where(described < 0, -1, described + offset))
        moves = [kind.moves for kind in observation.kinds]
        np.testing.assert_array_equal(cache.moves[rows], moves)
    mine = slice(first_piece, first_piece + len(pieces.pose))
    np.testing.assert_array_equal(cache.piece_shape[mine], pieces.shape)
    np.testing.assert_array_equal(cache.piece_attributes[mine], pieces.attributes)
    assert cache.piece_pose[mine] == pytest.approx(pieces.pose - [*origin, 0.0], abs=1e-4)


@pytest.mark.parametrize("number", range(len(CACHED)))
def test_the_future_is_the_recording(window_cache: Path, recordings: Path, number: int) -> None:
    """Turned back into the scenario's frame it is what the file says, and ends where that does."""
    cache = WindowCache.open(window_cache)
    scenario = scenario_of(recordings, number)
    tracks = scenario.tracks
    for index, scene in enumerate(np.flatnonzero(cache.scene_recording == number)):
        step = index * EVERY
        rows = slice(*cache.scene_start[scene : scene + 2])
        present = np.flatnonzero(tracks.valid[:, step])
        truth = np.full((len(present), HORIZON, 4), np.nan)
        left = tracks.states[present, step + 1 : step + 1 + HORIZON]
        truth[:, : left.shape[1]] = left
        np.testing.assert_array_equal(cache.future_valid[rows], np.isfinite(truth[..., 0]))
        pose, future = cache.pose[rows].astype(np.float64), cache.future[rows]
        # A position is a complex number: e^(i heading) turns it.
        local = future[..., 0] + 1j * future[..., 1]
        place = np.exp(1j * pose[:, 2, None]) * local + (pose[:, 0] + 1j * pose[:, 1])[:, None]
        place += complex(*scenario.task.start[:2])
        known = cache.future_valid[rows]
        expected = truth[..., 0] + 1j * truth[..., 1]
        assert np.max(np.abs(place - expected)[known]) < 1e-3
        turn = np.exp(1j * (future[..., 2] + pose[:, 2, None] - truth[..., 2]))
        assert np.max(np.abs(turn - 1.0)[known]) < 1e-4
        assert not future[~known].any()


def test_neighbours_stay_in_their_scene(window_cache: Path) -> None:
    cache = WindowCache.open(window_cache)
    lengths = np.diff(cache.scene_start)
    first = np.repeat(cache.scene_start[:-1], lengths)[:, None]
    last = np.repeat(cache.scene_start[1:], lengths)[:, None]
    known = cache.neighbours >= 0
    assert known.any()
    assert np.all((cache.neighbours >= first) & (cache.neighbours < last) | ~known)
    assert np.all(cache.neighbours != np.arange(len(known))[:, None])
    # Pieces: those of the own recording.
    owner = np.repeat(cache.scene_recording, lengths)
    lowest = [cache.pieces[owner == r][cache.pieces[owner == r] >= 0].min() for r in range(3)]
    highest = [cache.pieces[owner == r].max() for r in range(3)]
    assert lowest[0] >= 0
    assert highest[0] < lowest[1] <= highest[1] < lowest[2]
    assert highest[2] < len(cache.piece_pose)


def test_what_a_cache_says_of_itself(window_cache: Path, recordings: Path) -> None:
    cache = WindowCache.open(window_cache)
    assert cache.recordings == tuple(f"{name}.xml.gz" for name in CACHED)
    assert cache.groups == ("ZAM_Parked-1", "ZAM_Parked-3", "ZAM_TJunction-3")
    assert cache.simulated == (True, True, True)
    assert cache.scenes == len(cache.scene_start) - 1
    assert cache.scene_start[-1] == len(cache.pose) == len(cache.future)


@pytest.mark.parametrize("cut", [0, 100, -30])
def test_an_interrupted_build_goes_on(
    window_cache: Path, recordings: Path, tmp_path: Path, cut: int
) -> None:
    folder = own_build(recordings, tmp_path)
    (folder / "cache.json").unlink()
    for path in folder.glob("*.npy"):
        path.unlink()
    broken, *whole = sorted((folder / "shards").glob("*.npz"))
    broken.write_bytes(broken.read_bytes()[:cut])
    written = {path: path.stat().st_mtime_ns for path in whole}
    build_cache([recordings], folder, every=EVERY)
    assert arrays(folder) == arrays(window_cache)
    assert (folder / "cache.json").read_bytes() == (window_cache / "cache.json").read_bytes()
    assert {path: path.stat().st_mtime_ns for path in whole} == written


def test_two_processes_make_the_same_cache(
    window_cache: Path, recordings: Path, tmp_path: Path
) -> None:
    done = []
    build_cache(
        [recordings], tmp_path, every=EVERY, workers=2, progress=lambda *at: done.append(at)
    )
    assert arrays(tmp_path) == arrays(window_cache)
    assert done == [(1, 3), (2, 3), (3, 3)]


def test_broken_files_and_those_without_a_future_are_named(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    road = scenes.straight_road()
    good = User(7, scenes.driving(50.0, 0.0, 5.0, 30))
    write_scenario_xml(source / "good.xml", road, [good], benchmark_id="ZAM_A-1_1_T-1")
    brief = User(7, scenes.driving(50.0, 0.0, 5.0, MIN_FUTURE))
    write_scenario_xml(source / "brief.xml", road, [brief], benchmark_id="ZAM_B-1_1_T-1")
    (source / "half.xml").write_bytes((source / "good.xml").read_bytes()[:300])
    report = build_cache([source], tmp_path / "cache")
    assert (report.recordings, report.empty) == (1, ("brief.xml",))
    (line,) = report.unreadable
    assert "half.xml" in line
    assert "\n" not in line
    # Steps 0, 2, ... 24 have five steps of future in 30.
    assert (report.scenes, report.windows) == (13, 13)
    content = json.loads((tmp_path / "cache" / "cache.json").read_text())
    assert content["unreadable"] == [line]
    (source / "good.xml").unlink()
    with pytest.raises(CacheError, match=r"^no windows in 2 recordings; the first: .*half\.xml"):
        build_cache([source], tmp_path / "other")


def test_a_file_that_cannot_be_opened_is_left_out(recordings: Path, tmp_path: Path) -> None:
    source = tmp_path / "recordings"
    shutil.copytree(recordings, source)
    (source / "gone.xml").symlink_to(tmp_path / "nowhere.xml")
    report = build_cache([source], tmp_path / "cache")
    (line,) = report.unreadable
    assert line.startswith(f"{source / 'gone.xml'}: cannot be read (")
    assert report.windows == build_cache([recordings], tmp_path / "other").windows


def test_a_cache_that_cannot_be_written(recordings: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CacheError, match="cannot be written"):
        build_cache([recordings], tmp_path / "file")


def without_shards(folder: Path) -> None:
    content = json.loads((folder / "cache.json").read_text())
    del content["shards"]
    write_json(folder / "cache.json", content)


def cut(name: str) -> Callable[[Path], None]:
    return lambda folder: np.save(folder / f"{name}.npy", np.load(folder / f"{name}.npy")[:-1])


def test_a_rebuild_that_is_cut_off_leaves_no_mixture(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = own_build(recordings, tmp_path)
    write = _Writer.append

    def cut_off(writer: _Writer, rows: npt.NDArray[Any]) -> None:
        write(writer, rows)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(_Writer, "append", cut_off)
        with pytest.raises(KeyboardInterrupt):
            build_cache([recordings], folder, every=2 * EVERY)
    with pytest.raises(CacheError, match="not a complete cache"):
        WindowCache.open(folder)
    build_cache([recordings], folder, every=2 * EVERY)
    WindowCache.open(folder)


def test_the_digest_is_of_what_the_windows_were_made_from(
    window_cache: Path, recordings: Path, tmp_path: Path
) -> None:
    """Of the recordings' content too: names and counts alone would be the same."""
    digest = WindowCache.open(window_cache).digest
    assert WindowCache.open(own_build(recordings, tmp_path)).digest == digest
    source = tmp_path / "recordings"
    shutil.copytree(recordings, source)
    changed = source / f"{CACHED[0]}.xml.gz"
    changed.write_bytes(gzip.compress(gzip.decompress(changed.read_bytes()) + b"<!-- -->"))
    build_cache([source], tmp_path / "changed", every=EVERY)
    assert arrays(tmp_path / "changed") == arrays(window_cache)
    assert WindowCache.open(tmp_path / "changed").digest != digest


def test_a_shard_holds_its_arrays_and_nothing_else(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An old numpy takes every keyword of ``savez`` for the name of an array."""
    given: list[set[str]] = []
    save = np.savez

    def noted(file: Path, **keywords: Any) -> None:
        given.append(set(keywords))
        save(file, **keywords)

    monkeypatch.setattr(np, "savez", noted)
    # The processes of a build do not see what is patched here.
    ref = find_scenarios(recordings / f"{CACHED[0]}.xml.gz")[0]
    job = _Job(ref, tmp_path / "shard.npz", EVERY, 1, IDEAL, 0, None)
    assert _extract_to(job) is None
    with np.load(job.shard, allow_pickle=False) as content:
        assert given == [set(content.files)]


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (lambda f: (f / "cache.json").unlink(), "not a complete cache"),
        (lambda f: (f / "pose.npy").unlink(), "not a complete cache"),
        (lambda f: (f / "pose.npy").write_bytes(b"\x93NUMPY"), "not a complete cache"),
        (lambda f: (f / "cache.json").write_text("{"), "not a complete cache"),
        (lambda f: write_json(f / "cache.json", {"format": FORMAT}), "not a complete cache"),
        (lambda f: (f / "cache.json").write_text('{"format": 0}'), f"of format 0.* reads {FORMAT}"),
        (without_shards, "does not name the shards"),
        (cut("pose"), r"pose\.npy has \d+ rows where cache\.json has \d+"),
        (cut("piece_pose"), r"piece_pose\.npy has \d+ rows"),
        (cut("scene_start"), r"scene_start\.npy has \d+ rows"),
    ],
)
def test_a_damaged_cache_is_refused_in_one_line(
    window_cache: Path, tmp_path: Path, damage: object, complaint: str
) -> None:
    folder = tmp_path / "cache"
    shutil.copytree(window_cache, folder, ignore=shutil.ignore_patterns("shards"))
    WindowCache.open(folder)
    damage(folder)  # type: ignore[operator]
    with pytest.raises(CacheError, match=complaint) as caught:
        WindowCache.open(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "group"),
    [
        ("USA_US101-10_2_T-1.xml", "USA_US101-10"),
        ("C-USA_Lanker-1_10_T-1.xml.gz", "USA_Lanker-1"),
        ("ZAM_Tjunction-1_3_S-1.xml", "ZAM_Tjunction-1"),
        ("DEU_Muc-4.xml", "DEU_Muc-4.xml"),
    ],
)
def test_cuts_of_one_recording_share_a_group(name: str, group: str) -> None:
    assert recorded_together(name) == group


def test_windows_through_a_loop_are_what_its_sensors_see_and_what_really_comes(
    recordings: Path, tmp_path: Path
) -> None:
    sensing = SensingSettings(position=0.2, correlation=0.0, range=60.0)
    loop = LoopSettings(sensing=sensing)
    build_cache([recordings], tmp_path / "seen", every=EVERY, loop=loop, seed=4)
    build_cache([recordings], tmp_path / "true", every=EVERY)
    seen, true = (WindowCache.open(tmp_path / name) for name in ("seen", "true"))
    assert (seen.loop, true.loop) == (
        "ideal, sensing.position=0.2, sensing.correlation=0.0, sensing.range=60.0",
        "ideal",
    )
    assert 0 < len(seen.pose) < len(true.pose)
    # In the frame of where it is seen, the whole future is off by what the place is off by.
    scenario = scenario_of(recordings, 0)
    first = next(watch(scenario, 1, loop=loop, seed=4))
    for row, name in enumerate(first.ids.tolist()):
        of = scenario.tracks.ids.tolist().index(name)
        if seen.future_valid[row, 0]:
            expected = to_body(scenario.tracks.states[of, 1:2, :2], first.states[row, -1, :3])[0]
            np.testing.assert_allclose(seen.future[row, 0, :2], expected, atol=1e-4)
            assert np.linalg.norm(expected - true.future[row, 0, :2]) > 1e-3
