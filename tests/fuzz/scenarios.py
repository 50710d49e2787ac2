"""Cases of damaged scenario files: each gives a scenario that can be driven, or one line."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import tarfile
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from dosplan.convert.commonroad import convert_commonroad
from dosplan.scenario import find_scenarios, load_recording, load_scenario
from tests.fuzz.byte_damage import damage_binary, damage_bytes
from tests.fuzz.driving import check_usable, drive
from tests.fuzz.harness import Case, one_line_at_most
from tests.fuzz.originals import original
from tests.fuzz.tree_damage import damage_tree

SECRET: Final = "7a1c-canary"
_EPISODES: Final = 3
_gzip = partial(gzip.compress, mtime=0)  # Without the time, so that the bytes are the same.
_PACKERS: Final[dict[str, Callable[[bytes], bytes]]] = {
    ".gz": _gzip,
    ".xz": lzma.compress,
    ".bz2": bz2.compress,
}


def damaged_trees(case: Case) -> None:
    """Elements, texts and attributes that are absent, doubled, moved or nonsense."""
    root = ElementTree.fromstring(original(case.random))
    case.about = damage_tree(case.random, root, case.random.choice((1, 1, 1, 2, 4)))
    try:
        data = ElementTree.tostring(root)
    except RecursionError:  # Python's own writer gives up where its reader does not.
        return
    _drive_all(case.write("scene.xml", data))


def converted_trees(case: Case) -> None:
    """Damaged recordings that are converted: what is written can be read and driven."""
    root = ElementTree.fromstring(original(case.random))
    case.about = damage_tree(case.random, root, case.random.choice((1, 1, 2, 4)))
    root.set("timeStepSize", case.random.choice(("0.1", "0.04", "0.1001")))
    step = case.random.choice((None, 0.1, 0.04))
    try:
        data = ElementTree.tostring(root)
    except RecursionError:  # As above.
        return
    path, out = case.write("scene.xml", data), case.folder / "out"
    with one_line_at_most(path.name):
        convert_commonroad(path, out, step)
        for made in (out / "recordings").iterdir():
            load_recording(made)
        if any((out / "scenarios").glob("*.xml.gz")):
            _drive_all(out / "scenarios")


def damaged_texts(case: Case) -> None:
    """Cut files, other encodings, entities, and files that are something else."""
    canary = case.folder / "canary"
    if case.random.random() < 0.5:
        os.mkfifo(canary)  # Who opens it for reading waits for ever.
    else:
        canary.write_text(SECRET)
    data, case.about = damage_bytes(case.random, original(case.random), case.folder)
    _drive_all(case.write("scene.xml", data))


def damaged_gzip(case: Case) -> None:
    """Compressed files that are damaged, or are not what their names say."""
    data = original(case.random)
    kind = case.random.randrange(4)
    if kind == 0:
        damaged, case.about = data, "not compressed"
    elif kind == 1:
        part, case.about = damage_bytes(case.random, data, case.folder)
        damaged = _gzip(part)
    else:
        damaged, case.about = damage_binary(case.random, _gzip(data))
    name = case.random.choice(("scene.xml.gz", "scene.xml.gz", "scene.xml", "scene.gz", "scene"))
    _drive_all(case.write(name, damaged))


def damaged_archives(case: Case) -> None:
    """Archives that are damaged: their scenarios are listed, or they are refused in one line."""
    members = {f"part/scene{i}.xml": original(case.random) for i in range(2)}
    name = case.random.choice(("a.zip", "a.tar", "a.tar.gz", "a.tar.xz", "a.tar.bz2"))
    data = _packed(name, members)
    if name == "a.zip" and case.random.random() < 0.3:  # The directory, which is little of it.
        tail, case.about = damage_binary(case.random, data[-300:])
        damaged = data[:-300] + tail
    else:
        damaged, case.about = damage_binary(case.random, data)
    case.about += f" {name}"
    _drive_all(case.write(name, damaged))


def _packed(name: str, members: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    if name.endswith(".zip"):
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            for member, data in members.items():
                archive.writestr(zipfile.ZipInfo(member), data, zipfile.ZIP_DEFLATED)
        return out.getvalue()
    with tarfile.open(fileobj=out, mode="w") as tar:
        for member, data in members.items():
            info = tarfile.TarInfo(member)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    pack = _PACKERS.get(Path(name).suffix)
    return out.getvalue() if pack is None else pack(out.getvalue())


def _drive_all(path: Path) -> None:
    """Reads, checks and drives all episodes of a file that was named."""
    with one_line_at_most(path.name, "scene"):  # Of an archive, its member's.
        refs = find_scenarios(path)
        assert refs, "a file that was named is not listed"
        for ref in refs[:_EPISODES]:
            with one_line_at_most(ref.path.name):
                scenario = load_scenario(ref, cached=True)
                assert SECRET not in repr(scenario)
                check_usable(scenario)
                drive(scenario)
