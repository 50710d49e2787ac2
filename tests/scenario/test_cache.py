"""A scenario from the cache is the scenario, whatever happened to the cache."""

from __future__ import annotations

import os
import pickle
import shutil
import statistics
import time
import zipfile
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from dosplan.scenario import ScenarioRef, cache, find_scenarios, load_scenario
from dosplan.scenario.synthetic import straight_scenario
from dosplan.system.arrays_file import pack, unpack
from dosplan.system.folders import cache_folder
from dosplan.types import Scenario
from tests.support.scenes import Goal, Problem, User, circle, driving, polygon, write_scenario_xml
from tests.support.suite import ROWS, SUITE, each


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DOSPLAN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scenario with all that a scenario may hold: shapes, goals with every part and without."""
    walker = User(8, driving(40.0, 3.0, 1.0, 20), 5, "pedestrian", circle(0.4))
    odd = User(9, driving(60.0, 0.0, 5.0, 31), shape=polygon([[-2, -1], [2, -1], [0, 1]]))
    goals = (
        Goal(20, 30, polygon([[50, -1], [60, -1], [60, 1]]), (-0.2, 0.3), (5.0, 12.5)),
        Goal(10, 40),
    )
    problems = [Problem(goals=goals), Problem(1001, (20.0, 3.5, 0.0, 9.0))]
    return write_scenario_xml(tmp_path / "all.xml", users=[walker, odd], problems=problems)


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.npz"))


def assert_equal(a: Any, b: Any, where: str = "scenario") -> None:
    """Same type, same values, bit by bit, through every field."""
    assert type(a) is type(b), where
    if is_dataclass(a):
        for field in fields(a):
            assert_equal(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape), where
        assert a.tobytes() == b.tobytes(), where
        assert a.flags.writeable == b.flags.writeable, where
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_equal(x, y, f"{where}[{i}]")
    elif isinstance(a, shapely.Geometry):
        assert shapely.to_wkb(a) == shapely.to_wkb(b), where
    else:
        assert a == b, where


def test_the_comparison_sees_a_difference(scene: Path) -> None:
    scenario = load_scenario(find_scenarios(scene)[0])
    assert_equal(scenario, scenario)
    for change in (
        {"tags": frozenset({"new"})},
        {"tracks": replace(scenario.tracks, states=scenario.tracks.states + 1e-12)},
        {"task": replace(scenario.task, goals=scenario.task.goals[:1])},
    ):
        with pytest.raises(AssertionError):
            assert_equal(scenario, replace(scenario, **change))


def test_every_field_comes_back(scene: Path, folder: Path) -> None:
    for ref in find_scenarios(scene):
        plain = load_scenario(ref)
        assert_equal(load_scenario(ref, cached=True), plain)
        assert_equal(load_scenario(ref, cached=True), plain)
    assert len(_entries(folder)) == 2


@pytest.mark.parametrize("row", each())
def test_every_field_of_a_suite_scenario_comes_back(row: dict[str, str]) -> None:
    scenario = load_scenario(SUITE / row["file"])
    assert_equal(unpack(pack(scenario), Scenario), scenario)


def test_another_vehicle_comes_back() -> None:
    scenario = straight_scenario()
    van = replace(scenario.task.vehicle, length=6.0, max_steering=0.6)
    scenario = replace(scenario, task=replace(scenario.task, vehicle=van))
    assert unpack(pack(scenario), Scenario).task.vehicle == van


def test_a_hit_parses_nothing(scene: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ref = find_scenarios(scene)[0]
    load_scenario(ref, cached=True)
    monkeypatch.setattr("dosplan.scenario.parse_scenario", None)  # Parsing would raise.
    assert load_scenario(ref, cached=True).id == ref.id


def test_a_hit_takes_a_small_part_of_what_parsing_takes(folder: Path) -> None:
    ratios = []
    for ref in find_scenarios("suite-1")[:: len(ROWS) // 10]:
        seconds = []
        for _ in range(2):  # A miss and a hit, in processor time: others may be busy.
            started = time.process_time()
            load_scenario(ref, cached=True)
            seconds.append(time.process_time() - started)
        ratios.append(seconds[1] / seconds[0])
    assert statistics.median(ratios) < 0.1


def test_an_entry_follows_from_content_name_and_code(
    scene: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ref, other = find_scenarios(scene)
    load_scenario(ref, cached=True)
    copy = scene.with_name("copy.xml")
    copy.write_bytes(scene.read_bytes())
    load_scenario(replace(ref, path=copy), cached=True)
    assert len(_entries(folder)) == 1  # The same content elsewhere is the same scenario.
    load_scenario(replace(ref, id="another name"), cached=True)
    load_scenario(other, cached=True)
    assert len(_entries(folder)) == 3
    scene.write_bytes(scene.read_bytes() + b"\n")
    load_scenario(ref, cached=True)
    assert len(_entries(folder)) == 4
    monkeypatch.setattr(cache, "_code_digest", lambda: "other code")
    load_scenario(ref, cached=True)
    assert len(_entries(folder)) == 5


@pytest.mark.parametrize(
    "module",
    ["geometry/plane.py", "scenario/commonroad/reader.py", "types/arrays.py", "types/vehicle.py"],
)
def test_an_entry_follows_from_the_code_of_every_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    package = tmp_path / "dosplan"
    shutil.copytree(Path(cache.__file__).parents[1], package)
    monkeypatch.setattr(cache, "__file__", str(package / "scenario" / "cache.py"))
    before = cache._code_digest.__wrapped__()
    (package / module).write_bytes((package / module).read_bytes() + b"\n")
    assert cache._code_digest.__wrapped__() != before


class _Bomb:
    def __reduce__(self) -> Any:
        return Path.touch, (Path("bomb"),)


def _pickled(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.array([_Bomb()], dtype=object), allow_pickle=True)


def _pickled_inside(path: Path) -> None:
    np.savez(path, allow_pickle=True, header=np.array([_Bomb()], dtype=object))


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)


def _of_other_lengths(path: Path) -> None:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    arrays["data"] = arrays["data"][:-7]
    np.savez(path, **arrays)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "truncated": lambda path: os.truncate(path, path.stat().st_size // 2),
    "last byte": lambda path: os.truncate(path, path.stat().st_size - 1),
    "flipped": _flip,
    "something else": lambda path: path.write_text("<xml/>"),
    "pickle": lambda path: path.write_bytes(pickle.dumps(_Bomb())),
    "pickled array": _pickled,
    "pickle inside": _pickled_inside,
    "other lengths": _of_other_lengths,
    "deep header": lambda path: np.savez(
        path, header=np.frombuffer(b"[" * 100_000, dtype=np.uint8), data=[]
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_entry_is_made_anew(
    scene: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    monkeypatch.chdir(folder.parent)
    ref = find_scenarios(scene)[0]
    plain = load_scenario(ref, cached=True)
    (entry,) = _entries(folder)
    good = entry.read_bytes()
    DAMAGES[damage](entry)
    assert entry.read_bytes() != good
    assert_equal(load_scenario(ref, cached=True), plain)
    assert_equal(unpack(entry.read_bytes(), Scenario), plain)
    assert not (folder.parent / "bomb").exists()


@pytest.mark.parametrize("obstacle", ["file", "link to nowhere"])
def test_a_cache_that_cannot_be_written_is_done_without(
    scene: Path, folder: Path, obstacle: str
) -> None:
    if obstacle == "file":
        folder.write_text("in the way")
    else:
        folder.symlink_to("/proc/nowhere")
    ref = find_scenarios(scene)[0]
    assert_equal(load_scenario(ref, cached=True), load_scenario(ref))


def test_the_cache_drops_what_was_not_read_for_longest(
    scene: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # All in one folder, which is allowed three entries.
    monkeypatch.setattr(cache, "_entry", lambda ref, content: folder / "00" / f"{ref.id}.npz")
    refs = [ScenarioRef(scene, f"scene-{i}", 1000) for i in range(5)]
    load_scenario(refs[0], cached=True)
    size = (folder / "00" / "scene-0.npz").stat().st_size
    monkeypatch.setattr(cache, "MAX_BYTES", 256 * int(3.5 * size))
    for i, ref in enumerate(refs[:3]):
        load_scenario(ref, cached=True)
        os.utime(folder / "00" / f"{ref.id}.npz", (i, i))
    load_scenario(refs[0], cached=True)  # Read again: not the oldest any more.
    for ref in refs[3:]:
        load_scenario(ref, cached=True)
    assert [entry.stem for entry in _entries(folder)] == ["scene-0", "scene-3", "scene-4"]


def test_the_cache_is_where_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOSPLAN_CACHE", "/a/b")
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")
    assert cache_folder() == Path("/a/b")
    monkeypatch.delenv("DOSPLAN_CACHE")
    assert cache_folder() == Path("/x/dosplan")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/somebody")
    assert cache_folder() == Path("/home/somebody/.cache/dosplan")


def test_an_entry_is_a_zip_of_plain_arrays(scene: Path, folder: Path) -> None:
    scenario: Scenario = load_scenario(find_scenarios(scene)[0], cached=True)
    (entry,) = _entries(folder)
    with zipfile.ZipFile(entry) as file:
        assert sorted(file.namelist()) == ["data.npy", "header.npy"]
    assert scenario.id.encode() in entry.read_bytes()
