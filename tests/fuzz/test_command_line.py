"""``dosplan run`` over a folder of damaged files: a row for each, and not a traceback."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from dosplan.scenario import ScenarioError, find_scenarios
from dosplan.types import Outcome
from tests.fuzz.byte_damage import damage_bytes
from tests.fuzz.originals import ORIGINALS, OURS
from tests.fuzz.tree_damage import damage_tree

SECONDS = 300.0


def _write_damaged(folder: Path, count: int) -> None:
    """Writes damaged files that a folder's listing takes: each has an id of its own."""
    rng = random.Random(0)
    number = 0
    while len(list(folder.iterdir())) < count:
        number += 1
        root = ElementTree.fromstring(rng.choice(ORIGINALS[: len(OURS)]))
        root.set("benchmarkID", f"ZAM_Fuzz-{number}_1_T-1")
        if number % 2:
            damage_tree(rng, root, 1)
            data = ElementTree.tostring(root)
        else:
            data, _ = damage_bytes(rng, ElementTree.tostring(root), folder)
        path = folder / f"{number:03d}.xml"
        path.write_bytes(data)
        try:
            listed = [ref.id for ref in find_scenarios(folder) if ref.path == path]
        except ScenarioError:  # One id twice: a folder of such files is refused as a whole.
            listed = []
        if not listed:  # Or something else than a scenario, which is passed over.
            path.unlink()


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "dosplan", *arguments],
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )


def _driven(source: Path, out: Path, *options: str) -> tuple[int, list[dict[str, object]], str]:
    """Exit code, rows and what stood on the console."""
    plugins = ("--planner", "cruise", "--predictor", "constant-velocity", "--without-dos")
    done = _run("run", str(source), *plugins, "--workers", "1", "--out", str(out), *options)
    shown = done.stdout + done.stderr
    assert "Traceback" not in shown
    rows = (out / "scenarios.jsonl").read_text().splitlines()
    return done.returncode, [json.loads(row) for row in rows], shown


@pytest.mark.parametrize("count", [4, pytest.param(40, marks=pytest.mark.slow)])
def test_every_damaged_file_has_its_row(tmp_path: Path, count: int) -> None:
    folder = tmp_path / "scenes"
    folder.mkdir()
    _write_damaged(folder, count)
    refs = find_scenarios(folder)
    assert {ref.path for ref in refs} == set(folder.iterdir())
    code, rows, shown = _driven(folder, tmp_path / "run")
    assert [row["scenario"] for row in rows] == [ref.id for ref in refs]
    unusable = [row for row in rows if row["outcome"] == Outcome.UNUSABLE]
    assert unusable, "nothing was damaged"
    assert len(unusable) < len(rows), "nothing could be driven"
    assert code == 1
    assert not [row for row in rows if row["outcome"] == Outcome.PLANNER_FAILURE]
    lines = [str(row["error"]) for row in unusable]
    assert all(line.startswith(f"{folder}/") for line in lines), lines
    assert all(line in shown for line in lines[:3])  # Of many, the first ones stand for all.


def test_an_empty_folder_is_one_line(tmp_path: Path) -> None:
    done = _run("run", str(tmp_path), "--planner", "cruise", "--out", str(tmp_path / "run"))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line == f"dosplan: error: {tmp_path}: holds no scenario (.xml or .xml.gz)"
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_lanelet_of_fifty_megabytes_is_a_row(tmp_path: Path) -> None:
    root = ElementTree.fromstring(ORIGINALS[0])
    lanelet = root.find("lanelet")
    assert lanelet is not None
    for side in ("leftBound", "rightBound"):
        bound = lanelet.find(side)
        assert bound is not None
        first, last = bound.findall("point")[:2]
        ends = [[float(point.findtext(axis, "")) for axis in "xy"] for point in (first, last)]
        steps = 450_000
        points = "".join(
            f"<point><x>{ends[0][0] + (ends[1][0] - ends[0][0]) * i / steps:.12f}</x>"
            f"<y>{ends[0][1] + (ends[1][1] - ends[0][1]) * i / steps:.12f}</y></point>"
            for i in range(1, steps)
        )
        more = ElementTree.fromstring(f"<points>{points}</points>")
        at = list(bound).index(first) + 1
        bound[at:at] = list(more)
    folder = tmp_path / "scenes"
    folder.mkdir()
    path = folder / "large.xml"
    path.write_bytes(ElementTree.tostring(root))
    assert path.stat().st_size > 50e6
    code, rows, _ = _driven(folder, tmp_path / "run", "--timeout", "60", "--no-cache")
    assert len(rows) == 1
    assert code == (rows[0]["outcome"] in (Outcome.PLANNER_FAILURE, Outcome.UNUSABLE))
