"""The generator of the first suite rebuilds the same bytes anywhere."""

from __future__ import annotations

import csv
import gzip
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"
FIRST = SCENARIOS / "suite-1"
COUNT = 3
SUMO_VERSION = "1.28.0"


def _sumo() -> str | None:
    try:
        return version("eclipse-sumo")
    except PackageNotFoundError:
        return None


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        _sumo() != SUMO_VERSION, reason=f"needs eclipse-sumo=={SUMO_VERSION} (dosplan[suite])"
    ),
]


def _build(out: Path, folder: Path, hash_seed: str, *arguments: str) -> None:
    suite = ("--suite", "suite-1")
    subprocess.run(
        [sys.executable, str(SCENARIOS / "suite.py"), *suite, "--out", str(out), *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        check=True,
    )


def test_rebuilds_the_committed_files(tmp_path: Path) -> None:
    with (FIRST / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))[:COUNT]
    seed = rows[0]["source"].split()[-1]
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for hash_seed, folder in (("0", SCENARIOS), ("4711", elsewhere)):
        out = tmp_path / f"out{hash_seed}"
        _build(out, folder, hash_seed, "--seed", seed, "--count", str(COUNT))
        for row in rows:
            rebuilt = (out / row["file"]).read_bytes()
            assert rebuilt == (FIRST / row["file"]).read_bytes(), row["id"]
        for made in (out / "sumo-files").iterdir():
            assert made.read_bytes() == (FIRST / "sumo-files" / made.name).read_bytes()
        with (out / "manifest.csv").open(newline="", encoding="utf-8") as stream:
            assert list(csv.DictReader(stream)) == rows
        drives, committed = (
            gzip.decompress((place / "drives.csv.gz").read_bytes()) for place in (out, FIRST)
        )
        assert committed.startswith(drives)


def test_training_split_has_other_roads(tmp_path: Path) -> None:
    _build(tmp_path, tmp_path, "0", "--seed", "1", "--count", "1", "--split", "train")
    (made,) = (tmp_path / "files").iterdir()
    assert made.name == "ZAM_Signal-501_1_T-1.xml.gz"
    assert made.read_bytes() != (FIRST / "files" / "ZAM_Signal-1_1_T-1.xml.gz").read_bytes()
