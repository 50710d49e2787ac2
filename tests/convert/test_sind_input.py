"""What cannot be converted: one line says which file, what is wrong with it and what to do."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from dosplan.cli.main import BAD_INPUT, OK, main
from dosplan.convert.sind import find_map, read_record
from dosplan.scenario import ScenarioError
from tests.support.sind_record import MOTIONS, write_map, write_record

VEHICLES, PEDESTRIANS = "Veh_smoothed_tracks.csv", "Ped_smoothed_tracks.csv"
LIGHTS = "TrafficLight_test.csv"
POINTER = (
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:f3011d7dc1786f940981a9d49c7f83c7860beda9d14ed0e06c995f7b7e590692\n"
    "size 129987853\n"
)
SHORT = [m for m in MOTIONS if m.name in ("1", "P1")]


@pytest.fixture
def record(tmp_path: Path) -> Path:
    return write_record(tmp_path / "town" / "r", SHORT)


def _cell(line: int, column: int, value: str) -> Callable[[str], str]:
    """Replaces a cell of a table."""

    def change(text: str) -> str:
        lines = text.splitlines()
        cells = lines[line - 1].split(",")
        cells[column] = value
        return "\n".join([*lines[: line - 1], ",".join(cells), *lines[line:]])

    return change


BAD: dict[str, tuple[str, Callable[[str], str], str]] = {
    "LFS pointer": (
        VEHICLES,
        lambda _: POINTER,
        "is a Git LFS pointer, not the table; fetch it with `git lfs pull`",
    ),
    "empty": (PEDESTRIANS, lambda _: "", "has no column track_id; a table of SinD has"),
    "no yaw": (VEHICLES, lambda t: t.replace("yaw_rad", "yaw"), "has no column yaw_rad"),
    "semicolons": (VEHICLES, lambda t: t.replace(",", ";"), "has no column track_id"),
    "cut": (VEHICLES, lambda t: t[: t.rfind("\n", 0, -1) + 30], "does not hold a number in each"),
    "text for a number": (
        VEHICLES, _cell(5, 4, "abc"), "line 5 does not hold a number in each of timestamp_ms",
    ),
    "NaN": (VEHICLES, _cell(5, 4, "nan"), "track 1 is not within 10000 m and 100 m/s"),
    "far": (PEDESTRIANS, _cell(5, 5, "10001"), "track P1 is not within 10000 m"),
    "fast": (PEDESTRIANS, _cell(5, 6, "-101"), "track P1 is not within 10000 m"),
    "kind": (VEHICLES, _cell(7, 3, "boat"), "line 7: 'boat' is no agent_type; known: car, truck"),
    "back in time": (VEHICLES, _cell(9, 2, "0"), "track 1 does not go on in time"),
    "no size": (
        VEHICLES,
        lambda t: t.replace(",4.5,1.8,", ",0,1.8,"),
        r"track 1 has a size of \(0.0, 1.8\) m; correct it",
    ),
    "a long field": (VEHICLES, _cell(3, 0, "1" * 200_000), "is no table"),
    "colour": (LIGHTS, _cell(3, 2, "2"), "line 3 does not hold a time and a state, 0 .red., 1"),
    "no time of a light": (LIGHTS, _cell(3, 1, ""), "line 3 does not hold a time"),
    "a light at no time": (LIGHTS, _cell(3, 1, "nan"), "line 3 does not hold a time"),
    "two colours at once": (LIGHTS, _cell(4, 1, "2002.002"), "line 4 contradicts an earlier one"),
    "no light times": (LIGHTS, lambda t: t.replace("(ms)", ""), r"has no column timestamp\(ms\)"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_table_gets_one_line(name: str, record: Path) -> None:
    table, change, message = BAD[name]
    path = record / table
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(ScenarioError, match=message) as raised:
        read_record(record)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_table_in_another_encoding_is_named(record: Path) -> None:
    (record / VEHICLES).write_bytes(b"track_id,\xff\xfe\n")
    with pytest.raises(ScenarioError, match=f"{VEHICLES}: is no table"):
        read_record(record)


def test_lights_in_any_order_and_twice_are_put_in_order(record: Path) -> None:
    path = record / LIGHTS
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    before = read_record(record).lights
    path.write_text("\n".join([header, rows[0], rows[2], rows[1], rows[2], ""]), encoding="utf-8")
    assert read_record(record).lights == before


def test_one_kind_of_track_is_enough(record: Path) -> None:
    (record / VEHICLES).unlink()
    assert [track.name for track in read_record(record).tracks] == ["P1"]
    (record / LIGHTS).unlink()
    assert read_record(record).lights.names == ()
    table = record / PEDESTRIANS
    table.write_text(table.read_text(encoding="utf-8").splitlines()[0], encoding="utf-8")
    with pytest.raises(ScenarioError, match="holds no track of two steps or more"):
        read_record(record)
    table.unlink()
    with pytest.raises(ScenarioError, match=f"holds neither {VEHICLES} nor {PEDESTRIANS}"):
        read_record(record)


def test_a_folder_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="is no folder; name the folder of one record"):
        read_record(tmp_path / "missing")


def test_the_map_of_the_folder_goes_before_that_beside_it(record: Path) -> None:
    beside = record.parent / "map.osm"
    assert find_map(record) == beside
    within = write_map(record / "own.osm")
    assert find_map(record) == within
    write_map(record / "second.osm")
    with pytest.raises(ScenarioError, match=r"several maps \(own.osm, second.osm\); name one"):
        find_map(record)
    for path in (within, record / "second.osm", beside):
        path.unlink()
    with pytest.raises(ScenarioError, match=r"has no map .* name one with --map FILE"):
        find_map(record)


def test_the_command_says_what_it_made(
    record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = shutil.move(record.parent / "map.osm", tmp_path / "elsewhere.osm")
    arguments = ["convert", "sind", str(record), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--map", str(chosen), "--json", str(tmp_path / "made.json")]) == OK
    shown = " ".join(capsys.readouterr().out.split())  # Long lines are folded.
    assert "r: 1 car, 1 pedestrian in 15 s on 7 lanelets with 2 lights" in shown
    assert f"wrote 1 to {tmp_path / 'out' / 'recordings'}, 1 to" in shown
    assert '"map": "elsewhere.osm"' in (tmp_path / "made.json").read_text(encoding="utf-8")


def test_a_git_lfs_pointer_ends_the_command_with_one_line(
    record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (record / VEHICLES).write_text(POINTER, encoding="utf-8")
    assert main(["convert", "sind", str(record), "--out", str(tmp_path / "out")]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"dosplan: error: {record / VEHICLES}: is a Git LFS pointer")
    assert not (tmp_path / "out").exists()
