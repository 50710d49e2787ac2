"""SinD records against the motions that they were written from."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import commonroad
import numpy as np
import pytest
import shapely
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.util import FileFormat
from hypothesis import given
from hypothesis import strategies as st

from dosplan.convert.sind import PEDESTRIAN_SIZE, Lights, read_record
from dosplan.convert.sind_files import EPISODES_FROM, USER_IDS, convert_sind
from dosplan.convert.windows import EARLY, PIECE, SLACK, moments, pieces
from dosplan.evaluation.evaluate import EvaluationConfig, evaluate
from dosplan.evaluation.methods import Method
from dosplan.geometry import wrap_angle
from dosplan.scenario import ScenarioError, find_scenarios, load_recording, load_scenario
from dosplan.types import FloatArray, IntArray, RoadUserKind, Scenario
from dosplan.vehicle import VehicleParameters
from tests.support.sind_record import CAR, LIGHTS, MOTIONS, Motion, straight, write_record

SCHEMA = (
    Path(commonroad.__file__).parent
    / "scenario_definition/xml_definition_files/XML_commonRoad_XSD.xsd"
)
IDS = {motion.name: USER_IDS + index for index, motion in enumerate(MOTIONS)}
KINDS = {
    "car": RoadUserKind.CAR,
    "truck": RoadUserKind.TRUCK,
    "bus": RoadUserKind.BUS,
    "motorcycle": RoadUserKind.MOTORCYCLE,
    "tricycle": RoadUserKind.MOTORCYCLE,
    "bicycle": RoadUserKind.BICYCLE,
    "pedestrian": RoadUserKind.PEDESTRIAN,
}


@dataclass(frozen=True)
class Converted:
    """What became of the record: its folder, the figures and the files."""

    out: Path
    figures: dict[str, Any]

    def files(self, folder: str) -> list[Path]:
        return sorted((self.out / folder).iterdir())

    @property
    def recording(self) -> Path:
        return self.out / "recordings" / "CHN_townrecord1-1_1_T-1.xml.gz"

    @property
    def episode(self) -> Path:
        return self.out / "scenarios" / f"CHN_townrecord1-1_{EPISODES_FROM}_T-1.xml.gz"


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Converted:
    folder = tmp_path_factory.mktemp("sind")
    record = write_record(folder / "town" / "record_1")
    return Converted(folder / "out", convert_sind(record, folder / "out"))


def _by_name(scenario: Scenario) -> Iterator[tuple[Motion, int]]:
    """The motions that are there and their rows of the tracks."""
    for row, name in enumerate(scenario.tracks.ids):
        yield MOTIONS[name - USER_IDS], row


def test_says_what_was_made(converted: Converted) -> None:
    assert converted.figures == {
        "record": "record_1",
        "map": "map.osm",
        "lanelets": 7,
        "lights": 2,
        "tracks": dict.fromkeys(KINDS, 1),
        "seconds": 59.9,  # The bicycle's last frame is at 599 * 0.1001 s = 59.96 s.
        "recordings": 1,
        "scenarios": 1,
        "refused": {},
    }
    assert converted.files("recordings") == [converted.recording]
    assert converted.files("scenarios") == [converted.episode]


def test_everyone_is_where_they_were(converted: Converted) -> None:
    """Positions at 0.1 s are those of the motion, not of a frame that is near."""
    scenario = load_recording(converted.recording)
    tracks = scenario.tracks
    assert sorted(tracks.ids) == sorted(IDS.values())
    for motion, row in _by_name(scenario):
        steps = np.flatnonzero(tracks.valid[row])
        truth = motion.states(_seconds(steps))
        state = tracks.states[row, steps]
        # A file has mm, mm/s and 0.1 mrad.
        assert np.abs(state[:, :2] - truth[:, :2]).max() < 0.001, motion.name
        assert np.abs(wrap_angle(state[:, 2] - truth[:, 2])).max() < 0.0002, motion.name
        assert np.abs(state[:, 3] - truth[:, 3]).max() < 0.001, motion.name
        assert tracks.kinds[row] is KINDS[motion.kind]
        np.testing.assert_allclose(tracks.size[row], motion.size)
        # Every step between the first and the last frame, and no other.
        assert np.all(np.diff(steps) == 1)
        assert motion.begin <= 0.1 * steps[0] < motion.begin + 0.21
        assert motion.end - 0.21 < 0.1 * steps[-1] <= motion.end


def test_steps_are_found_by_time(tmp_path: Path) -> None:
    """After ten minutes frame 6000 is at 600.6 s: counting frames would be off by six steps."""
    late = Motion("7", "car", straight(-6000.0, 0.0, 0.0, 10.0), begin=598.0, end=602.0)
    record = read_record(write_record(tmp_path / "town" / "late", [late]))
    (track,) = record.tracks
    assert track.first == 5981
    np.testing.assert_allclose(
        track.states[:, 0], -6000.0 + track.first + np.arange(len(track.states)), atol=1e-6
    )


def test_a_gap_makes_two_tracks_and_a_lost_frame_is_filled(tmp_path: Path) -> None:
    record = write_record(tmp_path / "town" / "gaps", [CAR])
    table = record / "Veh_smoothed_tracks.csv"
    lines = table.read_text(encoding="utf-8").splitlines(keepends=True)
    # Two frames lost make 0.3003 s between two rows, three 0.4004 s.
    table.write_text("".join([*lines[:20], *lines[22:60], *lines[63:]]), encoding="utf-8")
    first, second = read_record(record).tracks
    assert first.name == second.name == "1"
    for track in (first, second):
        time = _seconds(track.first + np.arange(len(track.states)))
        np.testing.assert_allclose(track.states, CAR.states(time), atol=1e-6)
    assert second.first - first.last == pytest.approx(4, abs=1)


def test_a_pedestrian_who_stands_faces_where_they_walked(tmp_path: Path) -> None:
    def place(t: np.ndarray[Any, Any]) -> Any:
        walking = t < 5.0
        return np.minimum(t, 5.0), 0.0 * t, 0.0 * t + 1.0 * walking, np.where(walking, 1.0, 0.0)

    walker = Motion("P1", "pedestrian", place, end=10.0)
    (track,) = read_record(write_record(tmp_path / "town" / "stop", [walker])).tracks
    assert track.size == PEDESTRIAN_SIZE
    np.testing.assert_allclose(track.states[:, 2], 1.0, atol=1e-9)
    assert track.states[60:, 3] == pytest.approx(0.0)


def test_commonroad_reads_what_was_recorded(converted: Converted) -> None:
    for path, problems in ((converted.recording, 0), (converted.episode, 1)):
        source, planning = _open(path)
        assert len(planning.planning_problem_dict) == problems
        assert str(source.scenario_id) == path.name.removesuffix(".xml.gz")
        assert len(source.lanelet_network.lanelets) == 7
        assert source.dt == pytest.approx(0.1)
    source, _ = _open(converted.recording)
    types = {o.obstacle_id: o.obstacle_type.value for o in source.dynamic_obstacles}
    assert types[IDS["6"]] == "motorcycle"  # The tricycle.


def test_lights_are_as_in_the_table_at_every_step(converted: Converted) -> None:
    colours = {0: "red", 1: "green", 3: "yellow"}
    source, _ = _open(converted.recording)
    steps = range(0, 120)
    for light in source.lanelet_network.traffic_lights:
        shown = [light.get_state_at_time_step(step).value for step in steps]
        changes = [(float(time or "-inf") / 1000.0, states) for time, *states in LIGHTS]
        rows = [[states for time, states in changes if time <= 0.1 * step][-1] for step in steps]
        assert shown == [colours[row[light.traffic_light_id - 1]] for row in rows]
    assert [light.traffic_light_id for light in source.lanelet_network.traffic_lights] == [1, 2]
    places = {x.traffic_light_id: x.position for x in source.lanelet_network.traffic_lights}
    np.testing.assert_allclose(places[2], (102.0, 2.0), atol=0.002)
    np.testing.assert_allclose(places[1], (0.0, 0.0), atol=0.002)  # Amid the stop lines.


@given(
    st.lists(st.tuples(st.integers(-30, 90), st.sampled_from(["red", "green"])), max_size=8),
    st.integers(0, 40),
    st.integers(0, 40),
)
def test_a_cycle_lasts_as_long_as_its_window(
    changes: list[tuple[int, str]], first: int, length: int
) -> None:
    known = dict(sorted(changes))
    lights = Lights(
        ("a",), tuple(0.1 * step for step in known), tuple((c,) for c in known.values())
    )
    cycle = lights.cycle(0, first, first + length)
    shown = [colour for colour, steps in cycle for _ in range(steps)]
    assert len(shown) == length + 1
    assert all(a[0] != b[0] for a, b in pairwise(cycle))
    for step, colour in enumerate(shown, start=first):
        before = [known[at] for at in known if at <= step]
        assert colour == (before[-1] if before else "inactive")


@pytest.mark.parametrize("folder", ["recordings", "scenarios"])
def test_files_obey_the_schema(folder: str, converted: Converted) -> None:
    etree = pytest.importorskip("lxml.etree", reason="lxml validates the schema")
    text = SCHEMA.read_text(encoding="utf-8")
    # It lets everyone begin at step 0 only and wants a planning problem, which a recording that
    # nobody plans in does not have; commonroad-io and dosplan insist on neither.
    for strict, relaxed in (
        ('<xs:maxInclusive value="0"/>', ""),
        (
            '"planningProblem" type="planningProblem" minOccurs="1"',
            '"planningProblem" type="planningProblem" minOccurs="0"',
        ),
    ):
        assert strict in text
        text = text.replace(strict, relaxed, 1)
    schema = etree.XMLSchema(etree.fromstring(text.encode()))
    for path in converted.files(folder):
        schema.assertValid(etree.fromstring(gzip.decompress(path.read_bytes())))


def test_the_ego_stands_in_for_a_recorded_car(converted: Converted) -> None:
    scenario = load_scenario(converted.episode)
    task, vehicle = scenario.task, VehicleParameters()
    assert IDS[CAR.name] not in scenario.tracks.ids
    assert {IDS["2"], IDS["3"], IDS["4"]} <= set(scenario.tracks.ids)
    # The car's first step is 6 and it starts there: file and record begin at the same time.
    truth = CAR.states(np.array([0.6, 0.6 + 8.0]))
    assert task.start_step == 6
    np.testing.assert_allclose(vehicle.centre(task.start), truth[0, :2], atol=0.001)
    np.testing.assert_allclose(task.start[[3, 4]], (10.0, 0.0), atol=0.001)
    (goal,) = task.goals
    assert (goal.first_step, goal.last_step) == (86 - EARLY, 86 + SLACK)
    assert goal.region is not None
    assert goal.region.contains(shapely.Point(truth[1, :2]))
    assert not goal.region.contains(shapely.Point(truth[0, :2]))


def test_everyone_else_in_an_episode_is_where_they_were(converted: Converted) -> None:
    scenario = load_scenario(converted.episode)
    for motion, row in _by_name(scenario):
        steps = np.flatnonzero(scenario.tracks.valid[row])
        state = scenario.tracks.states[row, steps]
        assert np.abs(state[:, :2] - motion.states(_seconds(steps))[:, :2]).max() < 0.001


def test_a_car_whose_own_drive_fails_makes_no_episode(tmp_path: Path) -> None:
    """The second car drives through the first: whoever of the two is the ego collides."""
    through = Motion("2", "car", straight(-60.0, 0.0, 0.0, 5.0), end=15.0)
    aside = Motion("3", "car", straight(-90.0, -12.0, 0.0, 10.0), end=12.0)
    record = write_record(tmp_path / "town" / "bad", [CAR, through, aside])
    figures = convert_sind(record, tmp_path / "out")
    # Later starts of the first car, past the second, are fine.
    assert figures["scenarios"] == 2
    assert figures["refused"].keys() == {"collision", "unusable"}


def test_moments_ask_for_driving(tmp_path: Path) -> None:
    def found(speed: float, acceleration: float, end: float) -> list[int]:
        motion = Motion("1", "car", straight(-90.0, 0.0, 0.0, speed, acceleration), end=end)
        name = f"r{speed:g}{acceleration:g}{end:g}".replace(".", "").replace("-", "m")
        (track,) = read_record(write_record(tmp_path / name / "r", [motion])).tracks
        return [moment.start for moment in moments(track, 0.1)]

    assert found(10.0, 0.0, 12.0) == [0, 20, 40, 60]  # 45 steps are left after 6 s, not after 8.
    assert found(10.0, 0.0, 4.0) == []  # Too short.
    assert found(2.9, 0.0, 12.0) == []  # Too slow.
    # 9 m/s stop within 13.5 m at 3 m/s2, and 12 m more are asked for: 27 m in 6 s are enough at
    # -1.5 m/s2, the 23.1 m at -1.75 m/s2 (until it stands, after 5.14 s) are not.
    assert found(9.0, -1.5, 6.0) == [0]
    assert found(9.0, -1.75, 5.14) == []


def test_a_record_is_cut_without_overlap(tmp_path: Path) -> None:
    motions = [
        Motion("1", "car", straight(0.0, 0.0, 0.0, 0.1), begin=10.0, end=70.0),
        Motion("2", "car", straight(9.0, 0.0, 0.0, 0.1), begin=190.0, end=200.0),
    ]
    tracks = read_record(write_record(tmp_path / "town" / "long", motions)).tracks
    found = list(pieces(tracks))
    assert [piece[:2] for piece in found] == [(1, 0), (2, PIECE), (4, 3 * PIECE)]
    assert [last for *_, last in found] == [PIECE - 1, 2 * PIECE - 1, tracks[1].last]


def test_converting_again_replaces_what_was_there(tmp_path: Path) -> None:
    record, out = write_record(tmp_path / "town" / "r"), tmp_path / "out"
    convert_sind(record, out)
    before = {path: path.read_bytes() for path in out.rglob("*.gz")}
    stale = out / "scenarios" / "CHN_townr-1_1999_T-1.xml.gz"
    other = out / "scenarios" / "CHN_townr2-1_1999_T-1.xml.gz"
    for path in (stale, other):
        path.write_bytes(b"")
    convert_sind(record, out)
    other.unlink()
    assert {path: path.read_bytes() for path in out.rglob("*.gz")} == before


def test_a_recording_without_planning_problem_is_for_predictors_alone(
    converted: Converted,
) -> None:
    with pytest.raises(ScenarioError, match="has no planning problem; add one"):
        load_scenario(converted.recording)
    (ref,) = find_scenarios(converted.recording.parent)
    assert ref.id == load_recording(ref).id == "CHN_townrecord1-1_1_T-1"


def test_recordings_are_evaluated_like_any_other(converted: Converted) -> None:
    figures = evaluate(
        EvaluationConfig(
            source=str(converted.recording.parent),
            methods=(Method("cv", "constant-velocity"),),
            every=10,
        )
    )
    rows = {(row["group"], row["n"]) for row in figures["trajectories"] if row["model"] == "cv"}
    groups = {group for group, _ in rows}
    assert groups >= {"all", "car", "bus", "bicycle", "pedestrian", "CHN_townrecord1"}
    # Whoever keeps their velocity is predicted to the millimetre.
    for row in figures["trajectories"]:
        if row["group"] in ("car", "bus", "pedestrian"):
            assert row["fde"] < 0.02


def _seconds(steps: IntArray) -> FloatArray:
    return np.asarray(0.1 * steps, dtype=np.float64)


def _open(path: Path) -> Any:
    return CommonRoadFileReader(gzip.decompress(path.read_bytes()), FileFormat.XML).open()
