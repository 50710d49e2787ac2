"""The public sample of SinD: its maps, lights and pedestrians, and cars that were added to it."""

from __future__ import annotations

import csv
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from dosplan.convert.lanelet2 import Lanelet2Map, read_lanelet2
from dosplan.convert.sind import VEHICLES, find_map, read_record
from dosplan.convert.sind_files import USER_IDS, convert_sind
from dosplan.scenario import ScenarioError, find_scenarios, load_recording, load_scenario
from tests.support.sind_record import Array, Motion, Place, write_record

RECORDS = {
    "Chongqing": "Chongqing/6_22_NR_1",
    "Xi'an": "Xi'an/Xi'an_412_m1",
    "Changchun": "Changchun/changchun_pudong_507_009",
}
SPEED = 8.0
"""Of the cars that are added, m/s."""
SPACING = 4.0
"""Of the points of their ways, m: wide enough that a smooth line goes through them."""


def _sample() -> Path:
    root = os.environ.get("DOSPLAN_DATA")
    if not root:
        pytest.skip("set DOSPLAN_DATA to the folder that holds sind/ to run this")
    return Path(root) / "sind" / "Data"


@pytest.fixture(params=RECORDS)
def record(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A record and its map without the pointer that stands for its vehicles."""
    city = str(request.param)
    source = _sample() / RECORDS[city]
    folder = tmp_path / city / source.name
    shutil.copytree(source, folder)
    (folder / VEHICLES).unlink(missing_ok=True)
    shutil.copy(find_map(source), folder.parent)
    return folder


def test_pedestrians_are_where_the_table_has_them(record: Path, tmp_path: Path) -> None:
    figures = convert_sind(record, tmp_path / "out")
    assert figures["scenarios"] == 0
    truth = _pedestrians(record)
    assert figures["tracks"] == {"pedestrian": len(truth)}
    rows: dict[int, list[tuple[float, Array]]] = {}
    for ref in find_scenarios(tmp_path / "out" / "recordings"):
        tracks = load_recording(ref).tracks
        begin = 60.0 * (int(ref.id.split("_")[-2]) - 1)
        for name, states, valid in zip(tracks.ids, tracks.states, tracks.valid, strict=True):
            seen = np.flatnonzero(valid)
            rows.setdefault(int(name) - USER_IDS, []).extend(
                (begin + 0.1 * step, states[step]) for step in seen
            )
    for index, table in enumerate(truth.values()):
        time = np.array([t for t, _ in rows[index]])
        states = np.array([state for _, state in rows[index]])
        # All of it, but a step that is alone in its piece.
        assert len(time) >= round((table[-1, 0] - table[0, 0]) / 0.1) - 2
        # Between two frames the spline leaves the straight line by a dt^2 / 8. Some of the walks
        # have jerks of more than 10 m/s2, which makes 1.6 cm; counting frames would be metres off.
        straight = [np.interp(time, table[:, 0], table[:, k]) for k in range(1, 5)]
        assert np.hypot(states[:, 0] - straight[0], states[:, 1] - straight[1]).max() < 0.04
        # The file's velocity is along the heading of the nearest frame, within 9 degrees or so.
        speed = np.hypot(straight[2], straight[3])
        walking = speed > 0.5
        np.testing.assert_allclose(states[walking, 3], speed[walking], rtol=0.03, atol=0.02)


def test_maps_hold_the_crossing_together(record: Path) -> None:
    """Every way over the junction joins two roads, and their bounds meet."""
    lanelets = {x.id: x for x in read_lanelet2(find_map(record)).lanelets}
    assert len(lanelets) >= 30
    crossed = 0
    for lanelet in lanelets.values():
        crossed += bool(lanelet.successors and lanelet.predecessors)
        for name in lanelet.successors:
            np.testing.assert_allclose(lanelet.left[-1], lanelets[name].left[0], atol=1e-6)
            np.testing.assert_allclose(lanelet.right[-1], lanelets[name].right[0], atol=1e-6)
        width = np.linalg.norm(lanelet.left - lanelet.right, axis=1)
        assert 1.5 < width.min() < 9.0
    assert crossed >= 12


def test_lights_are_read_as_they_stand(record: Path) -> None:
    lights = read_record(record).lights
    (path,) = record.glob("Traffic*ight*.csv")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(lights.times) == len({row["timestamp(ms)"] for row in rows})
    colours = {"0": "red", "1": "green", "3": "yellow"}
    for row in rows:
        time = float(row["timestamp(ms)"] or "-inf") / 1000.0
        shown = lights.colours[lights.times.index(time)]
        assert shown == tuple(colours[row[name]] for name in lights.names)


def test_cars_along_the_lanes_make_episodes(record: Path, tmp_path: Path) -> None:
    """Cars in the documented format on the real map: each drives a way over the junction."""
    lanes = read_lanelet2(find_map(record))
    ways = _ways(lanes)[:6]
    motions = [
        Motion(str(n), "car", _along(way, 30.0 * n), 30.0 * n, 30.0 * n + _seconds(way))
        for n, way in enumerate(ways, start=1)
    ]
    made = write_record(tmp_path / "added" / "cars", motions)
    figures = convert_sind(made, tmp_path / "out", find_map(record))
    # At their first starts their tails stick out over the map's open end, which is no edge.
    assert figures["scenarios"] == len(ways) == 6
    assert figures["refused"] == {}
    for ref in find_scenarios(tmp_path / "out" / "scenarios"):
        task = load_scenario(ref).task
        assert len(task.route.lanelet_ids) >= 2


def test_the_pointer_of_a_clone_without_lfs_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"Veh_smoothed_tracks\.csv: is a Git LFS pointer"):
        read_record(_sample() / RECORDS["Changchun"])


def test_the_map_of_tianjin_places_four_lights() -> None:
    found = read_lanelet2(_sample() / "Tianjin" / "map_relink_law_save.osm")
    assert set(found.lights) == {2, 4, 6, 8}
    assert {lanelet.kind for lanelet in found.lanelets} == {"urban", "crosswalk"}


def _pedestrians(record: Path) -> dict[str, Array]:
    """(K, 5) time, s, position and velocity of each."""
    rows: dict[str, list[list[float]]] = {}
    with (record / "Ped_smoothed_tracks.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            values = [float(row[name]) for name in ("timestamp_ms", "x", "y", "vx", "vy")]
            rows.setdefault(row["track_id"], []).append([values[0] / 1000.0, *values[1:]])
    return {name: np.array(table) for name, table in rows.items()}


def _ways(lanes: Lanelet2Map) -> list[Array]:
    """Centre lines of the chains of lanelets from where a road begins, a point each ``SPACING``."""
    lanelets = {x.id: x for x in lanes.lanelets}
    lines = []
    for lanelet in lanes.lanelets:
        chain = [lanelet]
        while chain[-1].successors and len(chain) < 9:
            chain.append(lanelets[chain[-1].successors[0]])
        if not lanelet.predecessors and len(chain) > 2:
            line = np.concatenate([0.5 * (x.left + x.right) for x in chain])
            steps = np.hypot(*np.diff(line, axis=0).T)
            line = line[np.concatenate([[True], steps > 0.05])]
            way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
            metres = np.arange(0.0, way[-1], SPACING)
            lines.append(np.column_stack([np.interp(metres, way, line[:, k]) for k in (0, 1)]))
    return lines


def _seconds(way: Array) -> float:
    return (len(way) - 1) * SPACING / SPEED


def _along(way: Array, begin: float) -> Place:
    """Along a line at constant speed, from a time on."""
    curve = CubicSpline(SPACING * np.arange(len(way)), way)

    def place(t: Array) -> tuple[Array, Array, Array, Array]:
        at = SPEED * (t - begin)
        (x, y), (dx, dy) = curve(at).T, curve(at, 1).T
        return x, y, np.arctan2(dy, dx), np.full_like(t, SPEED)

    return place
