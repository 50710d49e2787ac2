"""Records in the format of SinD, written from motions that are known at any time.

The tables have the columns that the data set's description lists, one row for every third frame
of a video of 29.97 Hz. The map is a Lanelet2 file of a straight road; its lines are drawn in both
directions, as people draw them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Place = Callable[[Array], tuple[Array, Array, Array, Array]]
"""(K,) times to x, y, yaw and the velocity along the yaw."""

FRAME = 3.0 / 29.97
"""Seconds from one frame of a table to the next."""
DEGREE = (111428.70136495912, 110682.65408006413)
"""Metres of a degree of longitude and latitude by Lanelet2 1.2.3's UtmProjector at (0, 0)."""
VEHICLE_COLUMNS = (
    "track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy", "yaw_rad",
    "heading_rad", "length", "width", "ax", "ay", "v_lon", "v_lat", "a_lon", "a_lat",
)  # fmt: skip
PEDESTRIAN_COLUMNS = (*VEHICLE_COLUMNS[:8], "ax", "ay")


@dataclass(frozen=True)
class Motion:
    """Where somebody is at any time: ``place(t)`` is ``(x, y, yaw, velocity along the yaw)``."""

    name: str
    kind: str
    place: Place
    begin: float = 0.0
    end: float = 12.0
    size: tuple[float, float] = (4.5, 1.8)

    def states(self, time: Array) -> Array:
        """(K, 4) states at some times, s."""
        return np.column_stack(np.broadcast_arrays(*self.place(time)))


def straight(x: float, y: float, yaw: float, speed: float, acceleration: float = 0.0) -> Place:
    """From a place along a line, with ``speed`` at time 0."""

    def place(t: Array) -> tuple[Array, Array, Array, Array]:
        way = speed * t + 0.5 * acceleration * t**2
        heading = np.full_like(t, yaw)
        return x + way * np.cos(yaw), y + way * np.sin(yaw), heading, speed + acceleration * t

    return place


def round_and_round(x: float, y: float, radius: float, speed: float) -> Place:
    """Counter-clockwise around a centre, through every heading."""

    def place(t: Array) -> tuple[Array, Array, Array, Array]:
        turn = speed / radius * t
        at = x + radius * np.sin(turn), y - radius * np.cos(turn)
        return *at, turn, np.full_like(t, speed)

    return place


CAR = Motion("1", "car", straight(-90.0, 0.0, 0.0, 10.0), begin=0.5, end=15.0)
MOTIONS = (
    CAR,
    Motion("2", "truck", straight(-80.0, 3.5, 0.0, 0.0, 1.2), size=(9.0, 2.5)),
    Motion("3", "bus", straight(70.0, 7.0, np.pi, 8.0), size=(12.0, 2.5)),
    Motion("4", "motorcycle", straight(-60.0, 3.5, 0.0, 12.0), begin=3.03, size=(2.1, 0.8)),
    Motion("5", "bicycle", round_and_round(0.0, 60.0, 12.0, 4.0), end=60.0, size=(1.8, 0.6)),
    Motion("6", "tricycle", straight(40.0, -30.0, 0.5, -1.5), size=(2.9, 1.3)),
    Motion("P1", "pedestrian", straight(50.0, 20.0, -1.3, 1.4), begin=2.0, size=(0.5, 0.5)),
)
LIGHTS = (("", 1, 0), ("2002.002", 3, 0), ("5005.005", 0, 1))
"""Rows of a table of lights: time, ms, and the states of two lights."""


def write_record(
    folder: Path,
    motions: Sequence[Motion] = MOTIONS,
    lights: Sequence[tuple[str, int, int]] = LIGHTS,
) -> Path:
    """Writes the tables of a record, and its map beside its folder.

    Args:
        folder: The record's folder; made.
        motions: Who is there; pedestrians are named ``P...``.
        lights: See ``LIGHTS``.

    Returns:
        The folder.
    """
    folder.mkdir(parents=True)
    walkers = [motion for motion in motions if motion.name.startswith("P")]
    drivers = [motion for motion in motions if motion not in walkers]
    _write_table(folder / "Veh_smoothed_tracks.csv", VEHICLE_COLUMNS, drivers)
    _write_table(folder / "Ped_smoothed_tracks.csv", PEDESTRIAN_COLUMNS, walkers)
    with (folder / "TrafficLight_test.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["RawFrameID", "timestamp(ms)", "Traffic light 1", "Traffic light 2"])
        rows.writerows([row, *light] for row, light in enumerate(lights))
    write_map(folder.parent / "map.osm")
    return folder


def _write_table(path: Path, columns: Sequence[str], motions: Sequence[Motion]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore")
        writer.writeheader()
        for motion in motions:
            writer.writerows(_rows(motion))


def _rows(motion: Motion) -> list[dict[str, object]]:
    frames = np.arange(np.ceil(motion.begin / FRAME), np.floor(motion.end / FRAME) + 1)
    rows = []
    for frame, (x, y, yaw, speed) in zip(frames, motion.states(frames * FRAME), strict=True):
        # The tables give angles within a turn, so that they leap from pi to -pi.
        wrapped = float(np.arctan2(np.sin(yaw), np.cos(yaw)))
        rows.append(
            dict.fromkeys(VEHICLE_COLUMNS, 0.0)
            | {
                "track_id": motion.name,
                "frame_id": int(frame),
                "timestamp_ms": 1000.0 * frame * FRAME,
                "agent_type": motion.kind,
                "x": x,
                "y": y,
                "vx": speed * np.cos(yaw),
                "vy": speed * np.sin(yaw),
                "yaw_rad": wrapped,
                "heading_rad": wrapped,
                "length": motion.size[0],
                "width": motion.size[1],
                "v_lon": speed,
            }
        )
    return rows


@dataclass
class Osm:
    """A Lanelet2 file in the making; places are in metres."""

    parts: list[str] = field(default_factory=list)

    def node(self, ref: int, x: float, y: float) -> None:
        """Adds a node."""
        lon, lat = x / DEGREE[0], y / DEGREE[1]
        self.parts.append(f'<node id="{ref}" lat="{lat:.11f}" lon="{lon:.11f}"/>')

    def way(self, ref: int, nodes: Sequence[int], **tags: str) -> None:
        """Adds a line through nodes."""
        inside = "".join(f'<nd ref="{node}"/>' for node in nodes) + _tags(tags)
        self.parts.append(f'<way id="{ref}">{inside}</way>')

    def lanelet(self, ref: int, left: int, right: int, **tags: str) -> None:
        """Adds a lanelet between two lines."""
        inside = "".join(
            f'<member type="way" ref="{way}" role="{role}"/>'
            for role, way in (("left", left), ("right", right))
        )
        text = _tags({"type": "lanelet", **tags})
        self.parts.append(f'<relation id="{ref}">{inside}{text}</relation>')

    def __str__(self) -> str:
        return f'<?xml version="1.0"?>\n<osm version="0.6">{"".join(self.parts)}</osm>\n'


def _tags(tags: Mapping[str, str]) -> str:
    return "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())


def road() -> Osm:
    """Three lanes, 3.5 m wide, from x = -100 m to 100 m, and a crosswalk at their end.

    The lanes about y = 0 and y = 3.5 lead along +x, the one about y = 7 back; each is cut at
    x = 0. Lanelets: -1, -2 along y = 0; -3, -4 along y = 3.5; -5, -6 against x; -7 crosses.
    """
    osm = Osm()
    for line, y in enumerate((-1.75, 1.75, 5.25, 8.75)):
        for column, x in enumerate((-100.0, -50.0, 0.0, 100.0)):
            osm.node(-10 * line - column - 1, x, y)
    for line in range(4):
        first, second = [-10 * line - k for k in (1, 2, 3)], [-10 * line - k for k in (3, 4)]
        osm.way(-100 - line, first if line % 2 else first[::-1], type="line_thin")
        osm.way(-200 - line, second, type="line_thin")
    for name, line in ((-1, 0), (-3, 1)):
        osm.lanelet(name, -101 - line, -100 - line, subtype="road", one_way="yes")
        osm.lanelet(name - 1, -201 - line, -200 - line, subtype="road")
    osm.lanelet(-5, -102, -103)  # Looking along -x, the line at 5.25 is its left bound.
    osm.lanelet(-6, -202, -203)
    for name, x in ((-51, 90.0), (-53, 93.0)):
        osm.node(name, x, -1.75)
        osm.node(name - 1, x, 8.75)
        osm.way(name, (name, name - 1), type="zebra")
    osm.lanelet(-7, -51, -53, subtype="crosswalk")
    osm.node(-61, 101.0, 0.0)
    osm.node(-62, 103.0, 4.0)
    osm.way(-61, (-61, -62), type="traffic_light", name="Traffic light 2")
    osm.way(-63, (-3, -13), type="stop_line")
    return osm


def write_map(path: Path) -> Path:
    """Writes ``road``."""
    path.write_text(str(road()), encoding="utf-8")
    return path
