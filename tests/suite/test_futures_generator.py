"""The generator of scenes with several futures."""

from __future__ import annotations

import csv
import gzip
import io
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest
from dosplan_sumo.acts import read_acts
from suitegen.futures.verdict import in_future
from suitegen.verdict import recorded_episode

from dosplan.scenario import load_scenario
from dosplan.scenario.sources.sumo import ACTS
from dosplan.scoring.score import score
from dosplan.types import FloatArray, Outcome

SCENARIOS = Path(__file__).resolve().parents[2] / "scenarios"
SUMO_VERSION = "1.28.0"
SOME = ("--seed", "7", "--count", "2", "--kinds", "OncomingTurn,Jaywalker")


def _has_sumo() -> bool:
    try:
        return all(version(name) == SUMO_VERSION for name in ("eclipse-sumo", "libsumo"))
    except PackageNotFoundError:
        return False


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not _has_sumo(), reason=f"needs eclipse-sumo=={SUMO_VERSION} (dosplan[suite])"
    ),
]


def _build(out: Path, hash_seed: str, *arguments: str) -> None:
    subprocess.run(
        [sys.executable, str(SCENARIOS / "suite.py"), "--out", str(out), *arguments],
        cwd=out.parent,
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        check=True,
    )


def _contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few scenarios of a seed that the shipped ones are not of."""
    out = tmp_path_factory.mktemp("made") / "out"
    _build(out, "0", *SOME)
    return out


def _rows(made: Path) -> list[dict[str, str]]:
    with (made / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_same_bytes_elsewhere_in_two_processes_and_resumed(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere"
    _build(out, "4711", *SOME, "--jobs", "2", "--resume")
    assert _contents(out) == _contents(made)


def test_every_future_has_the_same_past_and_its_own_intention(made: Path) -> None:
    for row in _rows(made):
        scenario = load_scenario(made / row["file"])
        intentions = row["intentions"].split("; ")
        assert len(intentions) == 1 + len(scenario.futures) == 5
        assert len(set(intentions)) > 1
        start, recorded = scenario.task.start_step, scenario.tracks
        parted = []
        for future in scenario.futures:
            rows = [int(np.flatnonzero(future.ids == name)[0]) for name in recorded.ids]
            past = future.states[rows, : start + 1]
            np.testing.assert_array_equal(past, recorded.states[:, : start + 1])
            apart = np.abs(future.states[rows] - recorded.states)[..., :2]
            parted.append(float(np.nanmax(apart)))
        for intention, distance in zip(intentions[1:], parted, strict=True):
            assert intention == intentions[0] or distance > 1.0


def test_drives_of_the_table_solve_their_futures(made: Path) -> None:
    for row in _rows(made):
        scenario = load_scenario(made / row["file"])
        for k, drive in enumerate(_drives(made, row["id"])):
            future = in_future(scenario, k)
            assert score(future, recorded_episode(future, drive)).outcome is Outcome.SUCCESS


def _drives(made: Path, name: str) -> list[FloatArray]:
    text = gzip.decompress((made / "drives.csv.gz").read_bytes()).decode()
    drives: dict[str, list[list[float]]] = {}
    for row in csv.DictReader(io.StringIO(text)):
        if row["id"] == name:
            values = [float(row[key]) for key in ("x", "y", "heading", "velocity")]
            drives.setdefault(row["future"], []).append(values)
    return [np.array(drives[str(k)]) for k in range(5)]


def test_scripts_of_the_futures_are_kept(made: Path) -> None:
    for row in _rows(made):
        acts = read_acts(made / "sumo-files" / f"{row['id']}{ACTS}")
        assert [act.intention for act in acts.futures] == row["intentions"].split("; ")
        assert any(act.script for act in acts.futures)
