"""Records of highD, inD and INTERACTION, and the CommonRoad files that a converter makes of such.

The tables have the columns that the data sets' descriptions list, a row for each frame of a video
of 25 Hz, of 10 Hz in INTERACTION. The CommonRoad files look like those of
``commonroad-dataset-converter``: obstacle ids from 10000 on, steps that count the frames of the
record, turn indicators, people as circles.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from tests.support.scenes import Problem, straight_road
from tests.support.scenes import scenario_xml as scene_xml
from tests.support.sind_record import Array, Motion

FRAME = 0.04
IDS = 10_000
HIGHD_TRACKS = (
    "frame", "id", "x", "y", "width", "height", "xVelocity", "yVelocity", "xAcceleration",
    "yAcceleration", "frontSightDistance", "backSightDistance", "dhw", "thw", "ttc",
    "precedingXVelocity", "precedingId", "followingId", "leftPrecedingId", "leftAlongsideId",
    "leftFollowingId", "rightPrecedingId", "rightAlongsideId", "rightFollowingId", "laneId",
)  # fmt: skip
HIGHD_META = (
    "id", "width", "height", "initialFrame", "finalFrame", "numFrames", "class",
    "drivingDirection", "traveledDistance", "minXVelocity", "maxXVelocity", "meanXVelocity",
    "minDHW", "minTHW", "minTTC", "numLaneChanges",
)  # fmt: skip
HIGHD_RECORDING = {
    "id": 1, "frameRate": 25, "locationId": 2, "speedLimit": -1, "month": "9.2017",
    "weekDay": "Tue", "startTime": "08:38", "duration": 15, "totalDrivenDistance": 1000,
    "totalDrivenTime": 60, "numVehicles": 5, "numCars": 4, "numTrucks": 1,
    "upperLaneMarkings": "8.50;12.25;16.00", "lowerLaneMarkings": "21.00;24.75;28.50",
}  # fmt: skip
"""Two lanes in each direction; their lines are metres down from the picture's edge."""
IND_TRACKS = (
    "recordingId", "trackId", "frame", "trackLifetime", "xCenter", "yCenter", "heading", "width",
    "length", "xVelocity", "yVelocity", "xAcceleration", "yAcceleration", "lonVelocity",
    "latVelocity", "lonAcceleration", "latAcceleration",
)  # fmt: skip
IND_META = (
    "recordingId", "trackId", "initialFrame", "finalFrame", "numFrames", "width", "length", "class",
)  # fmt: skip
IND_RECORDING = {
    "recordingId": 7, "locationId": 1, "frameRate": 25, "speedLimit": 13.89,
    "weekday": "tuesday", "startTime": 9, "duration": 30, "numTracks": 4, "numVehicles": 3,
    "numVRUs": 1, "latLocation": 50.78, "lonLocation": 6.13, "xUtmOrigin": 0.0,
    "yUtmOrigin": 0.0, "orthoPxToMeter": 0.01,
}  # fmt: skip


INTERACTION_TRACKS = (
    "track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy", "psi_rad",
    "length", "width",
)  # fmt: skip
MERGING = (904.0, 1004.5)
"""Where the converter's map of INTERACTION's DR_DEU_Merging_MT has its origin, m."""


def frames(motion: Motion, frame: float = FRAME) -> tuple[Array, Array]:
    """Frames at which somebody is there, and (K, 4) states at them."""
    first, last = np.ceil(motion.begin / frame), np.floor(motion.end / frame)
    numbers = np.arange(first, last + 1)
    return numbers, motion.states(numbers * frame)


def write_highd(folder: Path, motions: Sequence[Motion]) -> Path:
    """Writes a record of highD; y is that of CommonRoad, so that the road lies below zero.

    In the tables y points down and a place is the upper left corner of a box along the road.
    """
    folder.mkdir(parents=True)
    tracks, meta = [], []
    for motion in motions:
        numbers, states = frames(motion)
        length, width = motion.size
        for number, (x, y, yaw, speed) in zip(numbers, states, strict=True):
            tracks.append(
                {
                    "frame": int(number),
                    "id": motion.name,
                    "x": x - length / 2.0,
                    "y": -y - width / 2.0,
                    "width": length,
                    "height": width,
                    "xVelocity": speed * np.cos(yaw),
                    "yVelocity": 0.0,
                }
            )
        meta.append(
            {
                "id": motion.name,
                "width": length,
                "height": width,
                "initialFrame": int(numbers[0]),
                "finalFrame": int(numbers[-1]),
                "numFrames": len(numbers),
                "class": motion.kind.capitalize(),
                "drivingDirection": 2 if np.cos(states[0, 2]) > 0.0 else 1,
            }
        )
    _table(folder / "01_tracks.csv", HIGHD_TRACKS, tracks)
    _table(folder / "01_tracksMeta.csv", HIGHD_META, meta)
    _table(folder / "01_recordingMeta.csv", tuple(HIGHD_RECORDING), [HIGHD_RECORDING])
    return folder


def write_ind(folder: Path, motions: Sequence[Motion]) -> Path:
    """Writes a record of inD, whose places are centres and whose headings are degrees."""
    folder.mkdir(parents=True)
    tracks, meta = [], []
    for motion in motions:
        numbers, states = frames(motion)
        length, width = (0.0, 0.0) if motion.kind == "pedestrian" else motion.size
        body = {"recordingId": 7, "trackId": motion.name, "width": width, "length": length}
        for lifetime, (number, (x, y, yaw, speed)) in enumerate(zip(numbers, states, strict=True)):
            moving = {
                "frame": int(number),
                "trackLifetime": lifetime,
                "xCenter": x,
                "yCenter": y,
                "heading": np.degrees(yaw) % 360.0,
                "xVelocity": speed * np.cos(yaw),
                "yVelocity": speed * np.sin(yaw),
                "lonVelocity": speed,
            }
            tracks.append(body | moving)
        ends = {"initialFrame": int(numbers[0]), "finalFrame": int(numbers[-1])}
        meta.append(body | ends | {"numFrames": len(numbers), "class": motion.kind})
    _table(folder / "07_tracks.csv", IND_TRACKS, tracks)
    _table(folder / "07_tracksMeta.csv", IND_META, meta)
    _table(folder / "07_recordingMeta.csv", tuple(IND_RECORDING), [IND_RECORDING])
    return folder


def write_interaction(folder: Path, motions: Sequence[Motion]) -> Path:
    """Writes a record of INTERACTION, on its map DR_DEU_Merging_MT."""
    place = folder / "INTERACTION-Dataset-DR-v1_0/recorded_trackfiles/DR_DEU_Merging_MT"
    place.mkdir(parents=True)
    rows = [
        {
            "track_id": motion.name,
            "frame_id": int(number),
            "timestamp_ms": 100 * int(number),
            "agent_type": motion.kind,
            "x": x + MERGING[0],
            "y": y + MERGING[1],
            "vx": speed * np.cos(yaw),
            "vy": speed * np.sin(yaw),
            "psi_rad": yaw,
            "length": motion.size[0],
            "width": motion.size[1],
        }
        for motion in motions
        for number, (x, y, yaw, speed) in zip(*frames(motion, 0.1), strict=True)
    ]
    _table(place / "vehicle_tracks_000.csv", INTERACTION_TRACKS, rows)
    return folder


def _table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval=0)
        writer.writeheader()
        writer.writerows(rows)


LIGHT = (
    '<trafficLight id="501"><cycle>'
    "<cycleElement><duration>100</duration><color>red</color></cycleElement>"
    "<cycleElement><duration>75</duration><color>green</color></cycleElement>"
    "<timeOffset>10</timeOffset></cycle>"
    "<position><point><x>200.0</x><y>-2.0</y></point></position><active>true</active>"
    "</trafficLight>"
)
PARKED = (
    '<staticObstacle id="601"><type>parkedVehicle</type><shape><rectangle><length>4.0</length>'
    "<width>1.8</width></rectangle></shape><initialState><position><point><x>150.0</x>"
    "<y>-4.0</y></point></position><orientation><exact>0.0</exact></orientation>"
    "<time><exact>0</exact></time></initialState></staticObstacle>"
)


def write_recording(
    path: Path,
    motions: Sequence[Motion],
    *,
    benchmark_id: str = "DEU_Road-1_70_T-749",
    step: float = FRAME,
    speed_factor: float = 1.0,
    problems: Sequence[Problem] = (),
) -> Path:
    """Writes a CommonRoad recording on a straight road of two lanes, 400 m.

    Args:
        path: The file.
        motions: Who is there, named by numbers.
        benchmark_id: Its id.
        step: The step that the file states; its frames are of ``FRAME`` whatever that is.
        speed_factor: What the velocities are wrong by.
        problems: Planning problems.

    Returns:
        The file.
    """
    text = scene_xml(straight_road(length=400.0), (), problems, dt=step, benchmark_id=benchmark_id)
    users = "".join(_user(motion, speed_factor) for motion in motions)
    before = "<planningProblem" if problems else "</commonRoad>"
    path.parent.mkdir(parents=True, exist_ok=True)
    text = text.replace(before, LIGHT + users + PARKED + before, 1)
    path.write_text(text, encoding="utf-8")
    return path


def _user(motion: Motion, speed_factor: float) -> str:
    numbers, states = frames(motion)
    length, width = motion.size
    shape = f"<rectangle><length>{length}</length><width>{width}</width></rectangle>"
    if motion.kind == "pedestrian":
        shape = "<circle><radius>0.35</radius></circle>"
    listed = [
        f"<time><exact>{int(number)}</exact></time>"
        f"<position><point><x>{x:.4f}</x><y>{y:.4f}</y></point></position>"
        f"<orientation><exact>{yaw:.4f}</exact></orientation>"
        f"<velocity><exact>{speed * speed_factor:.4f}</exact></velocity>"
        "<acceleration><exact>0.0</exact></acceleration>"
        for number, (x, y, yaw, speed) in zip(numbers, states, strict=True)
    ]
    rest = "".join(f"<state>{state}</state>" for state in listed[1:])
    signal = f"<time><exact>{int(numbers[0])}</exact></time><indicatorLeft>true</indicatorLeft>"
    return (
        f'<dynamicObstacle id="{IDS + int(motion.name)}"><type>{motion.kind}</type>'
        f"<shape>{shape}</shape><initialState>{listed[0]}</initialState>"
        f"<initialSignalState>{signal}</initialSignalState><trajectory>{rest}</trajectory>"
        f"<signalSeries><signalState>{signal}</signalState></signalSeries></dynamicObstacle>"
    )
