"""Globs, lists and archives name the episodes a folder does; nothing gets out of an archive."""

from __future__ import annotations

import bz2
import gzip
import io
import os
import stat
import tarfile
import time
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from dosplan.cli.main import main
from dosplan.scenario import ScenarioError, find_scenarios, load_scenario
from dosplan.scenario.sources import archives, download
from dosplan.scenario.sources.sumo import ACTS
from dosplan.system.folders import cache_folder
from tests.support.scenes import Problem, write_scenario_xml

A, B, C = (f"ZAM_{name}-1_1_T-1" for name in "ABC")
BROKEN = b"<commonRoad"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of the test's own: what comes to lie in it is looked at."""
    monkeypatch.setenv("DOSPLAN_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """``a.xml``, ``deep/b.xml.gz`` (two problems), a broken ``deep/bad.xml`` and what is none."""
    place = tmp_path / "data"
    (place / "deep").mkdir(parents=True)
    write_scenario_xml(place / "a.xml", benchmark_id=A)
    write_scenario_xml(
        place / "deep" / "b.xml.gz", problems=[Problem(id=7), Problem(id=8)], benchmark_id=B
    )
    (place / "deep" / "bad.xml").write_bytes(BROKEN)
    (place / "deep" / "solution.xml").write_text("<CommonRoadSolution/>")
    (place / "._a.xml").write_bytes(b"\0\5\x16\7")
    (place / "readme.md").write_text("none")
    return place


def ids(source: object) -> list[str]:
    """Ids of what a source holds."""
    return [ref.id for ref in find_scenarios(str(source))]


ALL = [A, f"{B}@7", f"{B}@8", "bad"]


def test_a_folder_is_what_the_others_are_compared_with(folder: Path) -> None:
    assert ids(folder) == ALL


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("data/*", ALL),  # ``deep`` is a match, and is searched.
        ("data/**", ALL),  # Every file is matched, and is in a match, and counts once.
        ("data/**/*.xml", [A, "bad"]),
        ("data/deep/b.*", [f"{B}@7", f"{B}@8"]),
        ("data/[ab].xml", [A]),
    ],
)
def test_globs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, pattern: str, found: list[str]
) -> None:
    monkeypatch.chdir(folder.parent)
    assert ids(pattern) == found
    assert ids(folder.parent / pattern) == found


def test_a_path_that_is_there_is_no_glob(folder: Path) -> None:
    odd = folder / "[a].xml"
    write_scenario_xml(odd, benchmark_id=C)
    assert ids(odd) == [C]
    with pytest.raises(ScenarioError, match="does not exist; name a file, a folder, a quoted glob"):
        find_scenarios(folder / "[x].xml")


def test_broken_files_of_a_glob_are_told_apart_by_what_was_matched(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "bad.xml").write_bytes(BROKEN)
    monkeypatch.chdir(folder)
    assert ids("**/bad.xml") == ["bad.xml", "deep/bad.xml"]


def test_a_list_names_paths_and_ids_in_its_own_order(folder: Path) -> None:
    write_scenario_xml(folder / f"{C}.xml.gz", benchmark_id=C)
    listing = folder / "list.txt"
    listing.write_text(
        f"\ufeff# comment\r\n\r\nZAM_Signal-1_1_T-1\r\n  deep/bad.xml \r\n{C}\r\n"
        f"deep/*.gz\r\na.xml\r\na.xml\r\n{folder / 'deep'}\r\n"
    )
    assert ids(f"@{listing}") == ["ZAM_Signal-1_1_T-1", "bad", C, f"{B}@7", f"{B}@8", A]


def test_a_list_chooses_planning_problems(folder: Path) -> None:
    (folder / "deep" / "b.xml.gz").rename(folder / f"{B}.xml.gz")
    listing = folder / "list.txt"
    for entry, found in ((f"{B}@8", [f"{B}@8"]), (B, [f"{B}@7", f"{B}@8"])):
        listing.write_text(entry)
        assert ids(f"@{listing}") == found
    assert find_scenarios(f"@{listing}")[1].problem_id == 8
    listing.write_text(f"{B}@9")
    with pytest.raises(ScenarioError, match=f"does not hold {B}@9, but {B}@7, {B}@8"):
        find_scenarios(f"@{listing}")


def test_a_list_that_cannot_be_used_is_one_line(folder: Path) -> None:
    listing = folder / "list.txt"
    with pytest.raises(ScenarioError, match=r"list\.txt: cannot be read as a list \(No such file"):
        find_scenarios(f"@{listing}")
    listing.write_bytes(b"\xff\xfe\0")
    with pytest.raises(ScenarioError, match="cannot be read as a list"):
        find_scenarios(f"@{listing}")
    listing.write_text("a.xml\nZAM_Absent-1_1_T-1\n")
    with pytest.raises(ScenarioError, match=r"list\.txt: line 2: ZAM_Absent-1_1_T-1 names no scen"):
        find_scenarios(f"@{listing}")
    listing.write_text("# nothing\n")
    with pytest.raises(ScenarioError, match="holds no scenario"):
        find_scenarios(f"@{listing}")


@pytest.fixture
def served(folder: Path) -> Iterator[tuple[str, list[int]]]:
    """The URL of a folder, and the codes that its server answered."""
    codes: list[int] = []

    class Handler(SimpleHTTPRequestHandler):
        def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
            codes.append(int(code))

        def log_message(self, format: str, *args: object) -> None:
            """Keeps quiet."""

    handler = partial(Handler, directory=str(folder.parent))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", codes
        server.shutdown()
        thread.join()


def test_an_archive_behind_a_url_is_fetched_once(
    folder: Path, served: tuple[str, list[int]]
) -> None:
    url, codes = served
    archive = pack(folder, "two sets.zip")
    wanted = f"{url}/two%20sets.zip"
    refs = find_scenarios(wanted)
    assert [ref.id for ref in refs] == [ref.id for ref in find_scenarios(archive)]
    assert find_scenarios(wanted) == refs
    assert codes == [200, 304]
    assert load_scenario(refs[0]).id == A


def test_a_file_behind_a_url(folder: Path, served: tuple[str, list[int]]) -> None:
    (ref,) = find_scenarios(f"{served[0]}/{folder.name}/a.xml")
    assert ref.id == load_scenario(folder / "a.xml").id


def test_a_url_that_gives_nothing_is_one_line(served: tuple[str, list[int]]) -> None:
    with pytest.raises(ScenarioError, match=r"none\.zip: .* \(the server answers 404"):
        find_scenarios(f"{served[0]}/none.zip")
    with pytest.raises(ScenarioError, match=r"cannot be fetched \(.*refused\); fetch it yourself"):
        find_scenarios("http://127.0.0.1:9/a.zip")


class _Cut(BaseHTTPRequestHandler):
    """Announces more than it sends, or falls silent."""

    def log_message(self, format: str, *args: object) -> None:
        """Keeps quiet."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Length", "1000")
        self.end_headers()
        self.wfile.write(b"<commonRoad")
        self.wfile.flush()
        if "silent" in self.path:
            time.sleep(2.0)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("cut.xml", "it was cut off after 11 of 1000 bytes"),
        ("silent.xml", "the server went silent: timed out"),
        ("large.xml", "it has more than 10 bytes"),
    ],
)
def test_a_download_that_is_not_whole_is_no_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, reason: str
) -> None:
    monkeypatch.setenv("DOSPLAN_CACHE", str(tmp_path / "cache"))
    if name == "silent.xml":
        monkeypatch.setattr(download, "TIMEOUT", 0.3)
    if name == "large.xml":
        monkeypatch.setattr(download, "MAX_DOWNLOAD", 10)
    with ThreadingHTTPServer(("127.0.0.1", 0), _Cut) as server:
        Thread(target=server.serve_forever).start()
        url = f"http://127.0.0.1:{server.server_port}/{name}"
        with pytest.raises(ScenarioError) as caught:
            find_scenarios(url)
        server.shutdown()
    assert str(caught.value).startswith(f"{url}: cannot be fetched ({reason}")
    assert not [path for path in (tmp_path / "cache").rglob("*") if path.is_file()]


def pack(folder: Path, name: str) -> Path:
    """Packs all files of a folder into an archive beside it."""
    archive = folder.parent / name
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    if name.lower().endswith(".zip"):
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in files:
                packed.write(path, path.relative_to(folder))
    else:
        compression = name.rpartition(".")[2].replace("tgz", "gz").replace("tar", "")
        with tarfile.open(archive, f"w:{compression}") as packed:  # type: ignore[call-overload]
            for path in files:
                packed.add(path, path.relative_to(folder))
    return archive


@pytest.mark.parametrize("name", ["x.zip", "X.ZIP", "x.tar", "x.tar.gz", "x.tgz", "x.tar.xz"])
def test_an_archive_holds_what_the_folder_holds(folder: Path, name: str) -> None:
    refs = find_scenarios(pack(folder, name))
    assert [ref.id for ref in refs] == ALL
    assert load_scenario(refs[1]).problem_id == 7
    with pytest.raises(ScenarioError, match=r"deep/bad\.xml: is not complete XML"):
        load_scenario(refs[3])
    names = {path.name for path in refs[0].path.parent.rglob("*") if path.is_file()}
    assert names == {"a.xml", "b.xml.gz", "bad.xml", "solution.xml", "listing.json"}


def test_broken_members_of_two_archives_are_told_apart(folder: Path) -> None:
    for name in ("x.zip", "y.tar"):
        pack(folder / "deep", name)
        listing = folder / "list.txt"
        listing.write_text(f"deep/bad.xml\n{name}")
        assert {"deep/bad.xml", f"{name}/bad.xml"} < set(ids(f"@{listing}"))


def test_an_archive_is_unpacked_once_and_again_when_files_are_gone(folder: Path) -> None:
    archive = pack(folder, "x.zip")
    first = find_scenarios(archive)[0].path
    inode = first.stat().st_ino
    moved = archive.rename(archive.with_name("moved.zip"))
    assert find_scenarios(moved)[0].path == first
    assert first.stat().st_ino == inode
    first.unlink()
    assert ids(moved) == ALL
    assert find_scenarios(moved)[0].path == first
    assert not [path for path in first.parents[1].iterdir() if path.name.startswith(".")]


def test_archives_that_were_not_used_for_long_are_removed(folder: Path) -> None:
    old = find_scenarios(pack(folder, "x.zip"))[0].path.parent
    recent = find_scenarios(pack(folder / "deep", "y.zip"))[0].path.parent
    for place, age in ((old, 1.01), (recent, 0.99)):
        used = time.time() - age * archives.KEPT_SECONDS
        os.utime(place, (used, used))
    find_scenarios(pack(folder, "z.tar"))
    assert not old.exists()
    assert recent.exists()


def test_damage_costs_a_member_of_a_zip_its_row_only(folder: Path) -> None:
    archive = pack(folder, "x.zip")
    with zipfile.ZipFile(archive) as packed:
        info = packed.getinfo("a.xml")
    data = bytearray(archive.read_bytes())
    middle = info.header_offset + 30 + len("a.xml") + info.compress_size // 2
    data[middle] ^= 0xFF
    archive.write_bytes(data)
    refs = find_scenarios(archive)
    assert [ref.id for ref in refs] == ["a", *ALL[1:]]
    with pytest.raises(ScenarioError, match=r"a\.xml: is not complete XML .* fetch it again"):
        load_scenario(refs[0])


@pytest.mark.parametrize("name", ["x.zip", "x.tar", "x.tar.gz", "x.tar.xz", "x.tar.bz2"])
def test_a_damaged_archive_is_one_line_and_leaves_nothing(folder: Path, name: str) -> None:
    whole = pack(folder, name).read_bytes()
    for data in (whole[: len(whole) // 2], b"", b"no archive at all", bz2.compress(b"x")[:8]):
        (folder.parent / name).write_bytes(data)
        with pytest.raises(ScenarioError, match="cannot be unpacked into") as caught:
            find_scenarios(folder.parent / name)
        assert "\n" not in str(caught.value)
    assert not list((cache_folder() / "archives").glob(".*"))


@pytest.mark.parametrize("name", ["x.tar.gz", "x.tar.xz", "x.tar.bz2"])
def test_a_compressed_archive_cut_anywhere_loses_no_scenario_unnoticed(
    tmp_path: Path, name: str
) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    drawn = np.random.default_rng(0)
    for member in "ab":  # Hardly compressible, so that the first one is long read by the second.
        (folder / f"{member}.xml").write_text(f"<commonRoad/><!--{drawn.bytes(150).hex()}-->")
    whole = pack(folder, name).read_bytes()
    assert len(find_scenarios(tmp_path / name)) == 2
    refused = 0
    for end in range(1, len(whole)):
        (tmp_path / name).write_bytes(whole[:end])
        try:
            assert len(find_scenarios(tmp_path / name)) == 2
        except ScenarioError:
            refused += 1
    assert refused > len(whole) // 2


def zipped(path: Path, name: str, mode: int = 0, content: bytes = b"<x/>") -> None:
    """A ``.zip`` of a single member."""
    info = zipfile.ZipInfo(name)
    info.external_attr = mode << 16
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr(info, content)


def tarred(path: Path, name: str, kind: bytes = tarfile.REGTYPE, link: str = "") -> None:
    """A ``.tar`` of a single member."""
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, link
    info.size = 4 if kind == tarfile.REGTYPE else 0
    with tarfile.open(path, "w") as packed:
        packed.addfile(info, io.BytesIO(b"<x/>"))


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("x.zip", lambda p: zipped(p, "../evil.xml"), r"outside of its folder \(\.\./evil\.xml\)"),
        ("x.zip", lambda p: zipped(p, "/tmp/evil.xml"), "outside of its folder"),
        ("x.zip", lambda p: zipped(p, "l.xml", stat.S_IFLNK, b"/etc/hosts"), "no regular file"),
        ("x.tar", lambda p: tarred(p, "a/../../evil.xml"), "outside of its folder"),
        ("x.tar", lambda p: tarred(p, "/evil.xml"), "outside of its folder"),
        ("x.tar", lambda p: tarred(p, "l.xml", tarfile.SYMTYPE, "/etc/hosts"), "no regular file"),
        ("x.tar", lambda p: tarred(p, "l.xml", tarfile.LNKTYPE, "/etc/hosts"), "no regular file"),
        ("x.tar", lambda p: tarred(p, "l.xml", tarfile.FIFOTYPE), "no regular file"),
        ("x.tar", lambda p: tarred(p, "l.xml", tarfile.CHRTYPE), "no regular file"),
    ],
)
def test_what_reaches_out_of_an_archive_is_refused(
    tmp_path: Path, name: str, make: Callable[[Path], None], message: str
) -> None:
    make(tmp_path / name)
    before = {path for path in cache_folder().rglob("*") if path.is_file()}
    with pytest.raises(ScenarioError, match=message):
        find_scenarios(tmp_path / name)
    assert {path for path in cache_folder().rglob("*") if path.is_file()} == before
    assert not Path("/tmp/evil.xml").exists()


def test_members_that_are_no_scenarios_are_never_written(folder: Path, tmp_path: Path) -> None:
    archive = tmp_path / "x.tar"
    with tarfile.open(archive, "w") as packed:
        packed.add(folder / "a.xml", "a.xml")
        link = tarfile.TarInfo("../../link")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc"
        packed.addfile(link)
    (ref,) = find_scenarios(archive)
    assert sorted(path.name for path in ref.path.parent.iterdir()) == ["a.xml", "listing.json"]


@pytest.mark.parametrize("name", ["x.zip", "x.tar"])
def test_limits_of_what_is_unpacked(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    archive = pack(folder, name)
    total = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    monkeypatch.setattr(archives, "MAX_UNPACKED", total - 1)
    with pytest.raises(ScenarioError, match=f"holds more than {total - 1} bytes"):
        find_scenarios(archive)
    monkeypatch.setattr(archives, "MAX_UNPACKED", total)
    monkeypatch.setattr(archives, "MAX_MEMBERS", 5)
    with pytest.raises(ScenarioError, match="or 5 members; split it"):
        find_scenarios(archive)
    monkeypatch.setattr(archives, "MAX_MEMBERS", 6)
    assert ids(archive) == ALL


def test_a_member_too_large_for_a_scenario_is_a_row(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = (folder / "a.xml").stat().st_size - 1
    for module in ("sources.archives", "commonroad.document"):
        monkeypatch.setattr(f"dosplan.scenario.{module}.MAX_BYTES", limit)
    refs = find_scenarios(pack(folder, "x.tar.gz"))
    assert refs[0].id == "a"
    with pytest.raises(ScenarioError, match=f"holds more than {limit} bytes; split it"):
        load_scenario(refs[0])


def test_members_of_one_name_and_encryption_are_refused(folder: Path, tmp_path: Path) -> None:
    twice = tmp_path / "x.tar"
    with tarfile.open(twice, "w") as packed:
        packed.add(folder / "a.xml", "a.xml")
        packed.add(folder / "a.xml", "./deep/../a.xml")
    with pytest.raises(ScenarioError, match=r"holds a\.xml twice"):
        find_scenarios(twice)
    archive = pack(folder, "x.zip")
    data = bytearray(archive.read_bytes())
    central = data.index(b"PK\1\2")
    data[central + 8] |= 1  # The flag of encryption in the first entry of the directory.
    archive.write_bytes(data)
    with pytest.raises(ScenarioError, match="is encrypted; unpack it yourself"):
        find_scenarios(archive)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_cache_that_cannot_be_written_is_one_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    monkeypatch.setenv("DOSPLAN_CACHE", str(closed))
    with pytest.raises(ScenarioError, match=r"unpacked into .*closed \(Permission denied\)"):
        find_scenarios(pack(folder, "x.zip"))


def test_the_command_line_takes_them_all(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder.parent)
    pack(folder, "x.zip")
    Path("list.txt").write_text("data\n")
    for source in ("data", "data/*", "x.zip", "@list.txt"):
        assert main(["list", "scenarios", source]) == 0
        assert "4 scenarios" in capsys.readouterr().out
    assert main(["list", "scenarios", "@absent.txt"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_archive_keeps_what_sumo_needs(folder: Path, tmp_path: Path) -> None:
    beside = folder / "sumo-files"
    beside.mkdir()
    names = ("a.sumo.cfg", "a.net.xml.gz", "a.rou.xml", f"a{ACTS}")
    for name in names:
        (beside / name).write_bytes(b"x")
    packed = tmp_path / "all.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    (first, *_) = find_scenarios(str(packed))
    kept = first.path.parent / "sumo-files"
    assert sorted(path.name for path in kept.iterdir()) == sorted(names)


def test_what_is_no_url_is_told() -> None:
    with pytest.raises(ScenarioError, match="it is no URL"):
        find_scenarios("http://[::1/x.zip")


def test_endings_in_upper_case_are_endings(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "upper"
    place.mkdir()
    content = (folder / "a.xml").read_bytes()
    (place / "A.XML").write_bytes(content)
    (place / "B.XML.GZ").write_bytes(gzip.compress(content))
    found = find_scenarios(place)
    assert [ref.path.name for ref in found] == ["A.XML", "B.XML.GZ"]
    assert [load_scenario(ref).benchmark_id for ref in found] == [A, A]
