"""Traffic that SUMO drives around the ego."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from dosplan.geometry import rectangle_corners
from dosplan.plugins.traffic_conformance import check_traffic
from dosplan.scenario import load_scenario
from dosplan.simulation.world import World
from dosplan.types import (
    EGO_VELOCITY,
    USER_VELOCITY,
    FloatArray,
    RoadMap,
    RoadUserKind,
    Scenario,
    Tracks,
)
from tests.support.suite import drives
from tests.support.sumo import ZEBRA, driven_around, interactive_folder, suite_file

libsumo = pytest.importorskip("libsumo", reason="needs dosplan[sumo]")

from dosplan_sumo.lanes import Lanes  # noqa: E402
from dosplan_sumo.scene import User, users  # noqa: E402
from dosplan_sumo.simulator import SumoError  # noqa: E402
from dosplan_sumo.traffic import SumoTraffic  # noqa: E402

MERGE = "ZAM_OnRamp-2_1_T-1"


@pytest.fixture
def traffic() -> Iterator[SumoTraffic]:
    """A traffic that is closed at the end."""
    made = SumoTraffic()
    yield made
    made.close()


def _recorded_drive(name: str) -> tuple[Scenario, FloatArray]:
    return load_scenario(suite_file(name)), drives()[name][1:]


def _braking(scenario: Scenario, steps: int) -> FloatArray:
    """The ego brakes on its way with 6 m/s2, from the start on."""
    x, y, heading = scenario.task.vehicle.poses(scenario.task.start[None])[0]
    velocity, rows = float(scenario.task.start[EGO_VELOCITY]), []
    for _ in range(steps):
        velocity = max(0.0, velocity - 0.6)
        x, y = x + 0.1 * velocity * np.cos(heading), y + 0.1 * velocity * np.sin(heading)
        rows.append((x, y, heading, velocity))
    return np.array(rows)


def _same(one: Tracks, other: Tracks) -> bool:
    return (
        one.ids.tolist() == other.ids.tolist()
        and np.array_equal(one.states, other.states, equal_nan=True)
        and np.array_equal(one.valid, other.valid)
    )


@pytest.mark.skipif("1.28.0" not in libsumo.getVersion()[1], reason="another SUMO than the suite's")
@pytest.mark.parametrize("name", [ZEBRA, MERGE])
def test_around_the_recorded_ego_the_recording_comes_back(name: str, traffic: SumoTraffic) -> None:
    scenario, drive = _recorded_drive(name)
    tracks = driven_around(traffic, scenario, drive)
    gaps = []
    there = scenario.tracks.valid[:, scenario.task.start_step]
    for row in np.flatnonzero(there):  # Who comes later has a number of SUMO's demand.
        (driven,) = np.flatnonzero(tracks.ids == scenario.tracks.ids[row])
        both = tracks.valid[driven] & scenario.tracks.valid[row, : tracks.steps]
        away = tracks.states[driven] - scenario.tracks.states[row, : tracks.steps]
        gaps.append(np.hypot(*away[both, :2].T))
    gap = np.concatenate(gaps)
    assert gap.mean() < 0.05
    assert gap.max() < 0.75


def test_the_scene_at_the_start_is_that_of_the_file(traffic: SumoTraffic) -> None:
    scenario = load_scenario(suite_file(ZEBRA))
    start = scenario.task.start_step
    past = traffic.begin(scenario, start)
    for row in np.flatnonzero(scenario.tracks.valid[:, : start + 1].any(axis=1)):
        (there,) = np.flatnonzero(past.ids == scenario.tracks.ids[row])
        np.testing.assert_array_equal(past.states[there], scenario.tracks.states[row, : start + 1])


@pytest.mark.parametrize("walks", [True, False])
def test_who_leaps_sideways_in_sumo_slides_there(
    walks: bool, traffic: SumoTraffic, monkeypatch: pytest.MonkeyPatch
) -> None:
    def leaping(*args: object) -> Iterator[User]:
        for user in users(*args):  # type: ignore[arg-type]
            heading = user.state[2]
            aside = 3.0 * np.array([-np.sin(heading), np.cos(heading)])
            state = user.state + np.array([*aside, 0.0, 0.0]) * (user.walks is walks)
            yield replace(user, state=state)

    scenario, drive = _recorded_drive(ZEBRA)
    plain = driven_around(traffic, scenario, drive[:40])
    start = scenario.task.start_step
    begun = traffic.begin(scenario, start)
    monkeypatch.setattr("dosplan_sumo.traffic.users", leaping)
    states = [np.array(scenario.task.start)]
    places: dict[int, list[FloatArray]] = {
        int(i): [s] for i, s in zip(begun.ids, begun.states[:, -1], strict=True)
    }
    for step, (x, y, heading, velocity) in enumerate(drive[:40], start=start + 1):
        states.append(scenario.task.vehicle.state_at(np.array([x, y]), heading, velocity, 0.0))
        users_now = traffic.step(step, np.stack(states))
        for user, state in zip(users_now.ids, users_now.states, strict=True):
            places.setdefault(int(user), []).append(state)
    kinds = dict(zip(plain.ids.tolist(), plain.kinds, strict=True))
    moved = []
    for user, rows in places.items():
        if (kinds[user] is RoadUserKind.PEDESTRIAN) is not walks or len(rows) < 41:
            continue
        way = np.hypot(*np.diff(np.stack(rows)[:, :2], axis=0).T)
        assert np.all(way < 0.1 * (1.25 * np.stack(rows)[1:, 3] + 2.5)), user
        (row,) = np.flatnonzero(plain.ids == user)
        moved.append(np.hypot(*(rows[-1][:2] - plain.states[row, -1, :2])))
    assert moved
    assert max(moved) == pytest.approx(3.0, abs=0.3)


def test_the_others_brake_for_the_ego(traffic: SumoTraffic) -> None:
    scenario, _ = _recorded_drive(MERGE)
    ego = _braking(scenario, 60)
    tracks = driven_around(traffic, scenario, ego)
    at_end = tracks.states[tracks.valid[:, -1], -1]
    sizes = tracks.size[tracks.valid[:, -1]]
    boxes = shapely.polygons(rectangle_corners(at_end[:, :3], sizes))
    x, y, heading, _ = ego[-1]
    own = shapely.Polygon(rectangle_corners(ego[-1, :3], scenario.task.vehicle.size))
    assert not shapely.intersects(boxes, own).any()
    behind = (at_end[:, :2] - (x, y)) @ np.array([np.cos(heading), np.sin(heading)])
    assert (at_end[(behind < 0.0) & (behind > -30.0), USER_VELOCITY] < 2.0).any()


def test_the_same_seed_gives_the_same_road_users_and_another_future_others() -> None:
    scenario, drive = _recorded_drive(ZEBRA)
    driven = []
    for future in (0, 0, 1, 1, 2):
        traffic = SumoTraffic(seed=3, future=future)
        driven.append(driven_around(traffic, scenario, drive))
        traffic.close()
    assert _same(driven[0], driven[1])
    assert _same(driven[2], driven[3])
    assert not _same(driven[0], driven[2])
    assert not _same(driven[2], driven[4])
    start = scenario.task.start_step + 1
    for other in driven:  # One past.
        np.testing.assert_array_equal(other.states[:, :start], driven[0].states[:, :start])


def test_the_lights_are_those_of_sumo(traffic: SumoTraffic) -> None:
    # They change during the drive; the cycles of the file were taken from SUMO.
    scenario = load_scenario(suite_file("ZAM_Signal-5_1_T-1"))
    world = World(scenario, traffic)
    changed = False
    for step in range(world.now, world.now + 60):
        if step > world.now:
            traffic.step(step, np.tile(scenario.task.start, (2, 1)))
        shown, recorded = traffic.lights(step), scenario.signals.at(step)
        assert shown is not None
        assert shown.ids.tolist() == recorded.ids.tolist()
        assert shown.colours == recorded.colours
        np.testing.assert_allclose(shown.since, recorded.since, atol=1e-6)
        changed |= bool((shown.since[recorded.since == 0.0] == 0.0).any())
    assert changed
    # A light that SUMO switches otherwise than the file says is shown as SUMO has it.
    logic = libsumo.trafficlight.getIDList()[0]
    state = libsumo.trafficlight.getRedYellowGreenState(logic)
    libsumo.trafficlight.setRedYellowGreenState(logic, "r" * len(state))
    traffic.step(world.now + 60, np.tile(scenario.task.start, (2, 1)))
    now = traffic.lights(world.now + 60)
    assert now is not None
    assert {colour.value for colour in now.colours} == {"red"}


def test_sumo_sees_the_rectangle_of_the_ego(traffic: SumoTraffic) -> None:
    scenario, drive = _recorded_drive(MERGE)
    vehicle = scenario.task.vehicle
    driven_around(traffic, scenario, drive[:5])
    seen = libsumo.vehicle
    name = "egoVehicle"
    x, y, heading, velocity = drive[4]
    front = np.array([x, y]) + 0.5 * vehicle.length * np.array([np.cos(heading), np.sin(heading)])
    assert seen.getPosition(name) == pytest.approx(front, abs=1e-9)
    assert seen.getAngle(name) == pytest.approx((90.0 - np.rad2deg(heading)) % 360.0, abs=1e-9)
    assert seen.getSpeed(name) == pytest.approx(velocity)
    assert (seen.getLength(name), seen.getWidth(name)) == (vehicle.length, vehicle.width)
    assert seen.getLaneID(name)


def test_an_ego_that_leaves_the_road_and_comes_back_is_taken_out_and_in(
    traffic: SumoTraffic,
) -> None:
    scenario, drive = _recorded_drive(ZEBRA)
    away = drive[:30].copy()
    away[10:20, 0] += 500.0
    assert driven_around(traffic, scenario, away).steps == scenario.task.start_step + 31
    assert libsumo.vehicle.getLaneID("egoVehicle")


def test_a_second_simulation_in_the_process_is_refused(traffic: SumoTraffic) -> None:
    scenario = load_scenario(suite_file(ZEBRA))
    traffic.begin(scenario, scenario.task.start_step)
    other = SumoTraffic()
    with pytest.raises(SumoError, match="another simulation"):
        other.begin(scenario, scenario.task.start_step)
    other.close()
    traffic.step(scenario.task.start_step + 1, np.tile(scenario.task.start, (2, 1)))  # It goes on.
    traffic.close()
    other.begin(scenario, scenario.task.start_step)
    other.close()


def test_a_folder_without_trajectories_starts_as_its_file_says(
    tmp_path: Path, traffic: SumoTraffic
) -> None:
    scenario = load_scenario(interactive_folder(tmp_path))
    assert scenario.interactive
    assert scenario.task.start_step == 0
    tracks = driven_around(traffic, scenario, _braking(scenario, 30))
    for row, user in enumerate(scenario.tracks.ids):
        (there,) = np.flatnonzero(tracks.ids == user)
        np.testing.assert_array_equal(tracks.states[there, 0], scenario.tracks.states[row, 0])
        moved = np.hypot(*np.diff(tracks.states[there, :, :2], axis=0).T)
        assert np.nanmax(moved) < 2.0, "nobody leaps"
    assert tracks.valid[:, -1].sum() > len(scenario.tracks.ids) // 2


def test_road_users_that_sumo_does_not_have_there_are_put_there(
    tmp_path: Path, traffic: SumoTraffic
) -> None:
    scene = interactive_folder(tmp_path, MERGE)
    configuration = scene.with_name(f"{MERGE}.sumo.cfg")
    text = configuration.read_text()
    seed = text.partition('<seed value="')[2].partition('"')[0]
    configuration.write_text(text.replace(f'<seed value="{seed}"', '<seed value="12345"'))
    scenario = load_scenario(scene)
    traffic.begin(scenario, 0)
    ego = np.tile(scenario.task.start, (2, 1))
    users = traffic.step(1, ego)
    tracks = scenario.tracks
    for row in np.flatnonzero(tracks.valid[:, 0]):
        (there,) = np.flatnonzero(users.ids == tracks.ids[row])
        way = np.hypot(*(users.states[there, :2] - tracks.states[row, 0, :2]))
        expected = 0.1 * tracks.states[row, 0, USER_VELOCITY]
        assert way == pytest.approx(expected, abs=0.15)
        assert users.kinds[there] is tracks.kinds[row]


def test_map_and_network_have_to_lie_on_each_other(traffic: SumoTraffic) -> None:
    scenario = load_scenario(suite_file(MERGE))
    traffic.begin(scenario, scenario.task.start_step)
    lanes = Lanes(libsumo)

    def moved(x: float, y: float) -> RoadMap:
        way = np.array([x, y])
        lanelets = (
            replace(lanelet, left=lanelet.left + way, right=lanelet.right + way)
            for lanelet in scenario.road_map.lanelets
        )
        return replace(scenario.road_map, lanelets=tuple(lanelets))

    stated = np.array([300.0, -50.0])
    np.testing.assert_array_equal(lanes.offset(scenario.road_map, stated), np.zeros(2))
    np.testing.assert_array_equal(lanes.offset(moved(-300.0, 50.0), stated), stated)
    with pytest.raises(SumoError, match="do not lie on each other"):
        lanes.offset(moved(40.0, 90.0), stated)


def test_it_keeps_the_contract_of_a_traffic(tmp_path: Path) -> None:
    for scene in (suite_file(ZEBRA), interactive_folder(tmp_path)):
        report = check_traffic(SumoTraffic, load_scenario(scene))
        assert not report.failures


DATA = Path(os.environ.get("DOSPLAN_DATA", "/nowhere")) / "interactive"


@pytest.mark.skipif(not DATA.is_dir(), reason="needs interactive/ in DOSPLAN_DATA")
def test_an_official_interactive_scenario(traffic: SumoTraffic) -> None:
    name = "DEU_Frankfurt-34_11_I-1"
    scenario = load_scenario(DATA / name / f"{name}.cr.xml")
    past = traffic.begin(scenario, 0)
    assert set(scenario.tracks.ids.tolist()) <= set(past.ids.tolist())
    tracks = driven_around(traffic, scenario, _braking(scenario, 50))
    known = np.isin(tracks.ids, scenario.tracks.ids)
    assert tracks.valid[known].all()
    assert all(kind is RoadUserKind.CAR for kind in tracks.kinds)
    np.testing.assert_array_equal(tracks.states[known, 0], scenario.tracks.states[:, 0])
    way = np.hypot(*np.diff(tracks.states[known, :, :2], axis=1).transpose(2, 0, 1))
    assert way.max() < 4.0
    assert way.max() > 2.5
