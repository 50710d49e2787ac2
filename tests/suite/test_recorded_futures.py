"""The futures of the suite as they lie in the repository: whole, of one past, and several."""

from __future__ import annotations

import hashlib
import tomllib

import numpy as np
import pytest

from dosplan.scenario import find_scenarios, load_scenario
from dosplan.scenario.futures import count_futures
from dosplan.scenario.sources.fetch import SUITES
from dosplan.scoring.collision import first_contacts
from dosplan.types import EGO_VELOCITY, Scenario, Tracks
from tests.support.suite import FUTURES_SUITE as SUITE
from tests.support.suite import check_motion, manifest

SCENARIOS = SUITE.parent
MAX_BYTES = 20_000_000
"""The most that both suites may weigh in the repository, pictures included."""
DRIVEN = ("manifest.csv", "files", "futures", "sumo-files")
COLUMNS = [
    "id",
    "file",
    "sha256",
    "futures_file",
    "futures_sha256",
    "kind",
    "futures",
    "intentions",
    "defeats",
    "duration_s",
    "road_users",
    "source",
    "licence",
]


ROWS = manifest(SUITE)
_FIRST = {row["kind"]: row["id"] for row in reversed(ROWS)}.values()
EACH = [
    pytest.param(row, id=row["id"], marks=() if row["id"] in _FIRST else pytest.mark.slow)
    for row in ROWS
]


def test_the_manifest_names_every_file_once_with_its_checksum() -> None:
    assert list(ROWS[0]) == COLUMNS
    for folder, column, digest in (
        ("files", "file", "sha256"),
        ("futures", "futures_file", "futures_sha256"),
    ):
        there = sorted(f"{folder}/{path.name}" for path in (SUITE / folder).iterdir())
        assert sorted(row[column] for row in ROWS) == there
        for row in ROWS:
            content = (SUITE / row[column]).read_bytes()
            assert hashlib.sha256(content).hexdigest() == row[digest], row["id"]


def test_suites_are_small_together() -> None:
    assert sum(path.stat().st_size for path in SCENARIOS.rglob("*") if path.is_file()) < MAX_BYTES


def test_what_is_driven_comes_with_the_package() -> None:
    """All that a suite is driven from is in the wheel, where it is looked for."""
    with (SCENARIOS.parent / "pyproject.toml").open("rb") as stream:
        wheel = tomllib.load(stream)["tool"]["hatch"]["build"]["targets"]["wheel"]
    included = wheel["force-include"]
    assert all((SCENARIOS.parent / source).exists() for source in included)
    for name in SUITES:
        here = {part for part in DRIVEN if (SCENARIOS / name / part).exists()}
        assert {"manifest.csv", "files"} <= here
        for part in here:
            assert included[f"scenarios/{name}/{part}"] == f"dosplan/_suites/{name}/{part}"


def test_no_id_is_in_both_suites() -> None:
    first, second = ({ref.id for ref in find_scenarios(name)} for name in ("suite", "suite-1"))
    assert not first & second


@pytest.mark.parametrize("row", EACH)
def test_futures_part_after_the_start_and_mean_different_things(row: dict[str, str]) -> None:
    scenario = load_scenario(SUITE / row["file"])
    futures, intentions = int(row["futures"]), [x.strip() for x in row["intentions"].split(";")]
    assert futures == len(intentions) == 1 + len(scenario.futures)
    assert count_futures(SUITE / row["file"]) == futures >= 2
    assert len(set(intentions)) >= 2
    assert float(row["duration_s"]) == pytest.approx(0.1 * (scenario.tracks.steps - 1))
    recordings = [scenario.recorded(k) for k in range(futures)]
    for recording in recordings[1:]:
        _check_one_past(scenario, recording)
    for k, one in enumerate(recordings):
        for j in range(k):
            if intentions[j] != intentions[k]:
                assert not _alike(one, recordings[j]), f"futures {j} and {k} are the same"


def _check_one_past(scenario: Scenario, recording: Tracks) -> None:
    """Up to the ego's start a future is the recording, to the last bit, for whoever has come."""
    start, tracks = scenario.task.start_step, scenario.tracks
    past, own = slice(0, start + 1), {int(name): i for i, name in enumerate(recording.ids)}
    seen = np.flatnonzero(tracks.valid[:, past].any(axis=1))
    for row in seen:
        other = own[int(tracks.ids[row])]
        assert recording.kinds[other] is tracks.kinds[row]
        np.testing.assert_array_equal(recording.size[other], tracks.size[row])
        np.testing.assert_array_equal(recording.valid[other, past], tracks.valid[row, past])
        np.testing.assert_array_equal(recording.states[other, past], tracks.states[row, past])
    assert np.count_nonzero(recording.valid[:, past].any(axis=1)) == len(seen)


def _alike(one: Tracks, other: Tracks) -> bool:
    same = np.array_equal(one.ids, other.ids) and np.array_equal(one.valid, other.valid)
    return same and np.array_equal(one.states, other.states, equal_nan=True)


@pytest.mark.parametrize("row", EACH)
def test_road_users_move_as_bodies_do_in_every_future(row: dict[str, str]) -> None:
    scenario = load_scenario(SUITE / row["file"])
    task, vehicle = scenario.task, scenario.task.vehicle
    start = task.start[None]
    ego = np.column_stack([vehicle.poses(start), start[:, EGO_VELOCITY]])
    for k in range(int(row["futures"])):
        tracks = scenario.recorded(k)
        check_motion(tracks, scenario.dt)
        assert not first_contacts(ego, vehicle.size, tracks, task.start_step)
