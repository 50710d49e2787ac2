"""The embedded suite as it lies in the repository: complete, intact and fit for use."""

from __future__ import annotations

import hashlib
import re
from collections import Counter

import numpy as np
import pytest
import shapely

from dosplan.scenario import load_scenario
from dosplan.scoring.bounds import outside
from dosplan.scoring.collision import first_contacts
from dosplan.scoring.usable import unusable
from dosplan.types import EGO_VELOCITY, Lanelet, Scenario
from dosplan.vehicle import VehicleParameters
from tests.support.suite import ROWS, SUITE, Row, check_motion, each

MAX_FILE_BYTES = 200_000
MAX_BYTES = 12_000_000
"""The most the suite may weigh in the repository, pictures included."""
EXPECTED_COLUMNS = {
    "id",
    "file",
    "sha256",
    "road_kind",
    "density",
    "road_users",
    "duration_s",
    "defeats_constant_speed",
    "source",
    "licence",
}


def test_manifest_names_every_file_once() -> None:
    assert set(ROWS[0]) == EXPECTED_COLUMNS
    assert len({row["id"] for row in ROWS}) == len(ROWS)
    files = sorted(f"files/{path.name}" for path in (SUITE / "files").glob("*.gz"))
    assert sorted(row["file"] for row in ROWS) == files


def test_files_are_those_of_the_manifest() -> None:
    for row in ROWS:
        digest = hashlib.sha256((SUITE / row["file"]).read_bytes()).hexdigest()
        assert digest == row["sha256"], row["id"]


def test_files_are_small() -> None:
    assert max((SUITE / row["file"]).stat().st_size for row in ROWS) <= MAX_FILE_BYTES
    assert sum(path.stat().st_size for path in SUITE.rglob("*") if path.is_file()) < MAX_BYTES


def test_ids_follow_commonroad() -> None:
    for row in ROWS:
        assert re.fullmatch(r"ZAM_[A-Z][A-Za-z]+-[1-9]\d*_[1-9]\d*_T-1", row["id"])


def test_suite_is_diverse() -> None:
    kinds = Counter(row["road_kind"] for row in ROWS)
    geometries = {row["id"].partition("_")[2].partition("_")[0] for row in ROWS}
    assert len(kinds) >= 10
    assert min(kinds.values()) >= 12
    assert len(geometries) >= 5 * len(kinds)
    assert {row["density"] for row in ROWS} == {"light", "dense"}
    users = {part.split(":")[0] for row in ROWS for part in row["road_users"].split()}
    assert users >= {"car", "van", "truck", "bus", "motorcycle", "bicycle", "pedestrian"}
    conflicts = {row["defeats_constant_speed"].split()[0] for row in ROWS}
    assert conflicts == {"crossing", "merging", "leading"}


@pytest.mark.parametrize("row", each())
def test_scenario_is_fit_for_use(row: Row) -> None:
    scenario = load_scenario(SUITE / row["file"], cached=True)
    assert scenario.id == row["id"]
    assert unusable(scenario) is None
    _check_times(scenario, float(row["duration_s"]))
    _check_start(scenario)
    _check_traffic(scenario, row["road_users"])
    _check_map(scenario)


def _check_times(scenario: Scenario, duration: float) -> None:
    tracks, task = scenario.tracks, scenario.task
    assert scenario.dt == pytest.approx(0.1)
    assert 6.0 <= duration <= 15.0
    # K steps last (K - 1) * 0.1 s, and the recording reaches the end of the goal's window.
    assert tracks.steps == round(duration / 0.1) + 1
    assert task.final_step == tracks.steps - 1
    # Step 10 is the first that has a second of history before it.
    assert task.start_step >= 10
    assert bool(tracks.valid[:, 0].any())
    (goal,) = task.goals
    assert goal.last_step - goal.first_step >= 30


def _check_start(scenario: Scenario) -> None:
    vehicle, task = VehicleParameters(), scenario.task
    assert task.start[EGO_VELOCITY] >= 3.0
    (goal,) = task.goals
    assert goal.region is not None
    assert not goal.region.intersects(shapely.Point(vehicle.centre(task.start)))
    assert not outside(vehicle.poses(task.start[None]), vehicle.size, scenario.road_map)[0]
    standing = np.column_stack([vehicle.poses(task.start[None]), [task.start[EGO_VELOCITY]]])
    assert not first_contacts(standing, vehicle.size, scenario.tracks, task.start_step)


def _check_traffic(scenario: Scenario, users: str) -> None:
    tracks = scenario.tracks
    assert len(tracks.ids) == sum(int(part.split(":")[1]) for part in users.split())
    check_motion(tracks, scenario.dt)
    # No gaps: whoever has left does not come back.
    assert np.all(np.diff(tracks.valid.astype(int), axis=1).clip(0).sum(axis=1) <= 1)


def _check_map(scenario: Scenario) -> None:
    lanelets = {lanelet.id: lanelet for lanelet in scenario.road_map.lanelets}
    for lanelet in lanelets.values():
        for name in lanelet.successors:
            after = lanelets[name]
            assert lanelet.id in after.predecessors
            np.testing.assert_allclose(lanelet.left[-1], after.left[0], atol=1e-9)
            np.testing.assert_allclose(lanelet.right[-1], after.right[0], atol=1e-9)
        if lanelet.left_neighbour is not None:
            beside = lanelets[lanelet.left_neighbour]
            assert beside.right_neighbour == lanelet.id
            np.testing.assert_allclose(lanelet.left, beside.right, atol=1e-9)
        # Where a lane ends it runs out in a wedge.
        assert _narrowest(lanelet) > (1.2 if lanelet.successors else 0.25)


def _narrowest(lanelet: Lanelet) -> float:
    return float(np.linalg.norm(lanelet.left - lanelet.right, axis=1).min())
