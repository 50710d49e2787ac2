"""A record of SinD: its tracks at steps of 0.1 s, its traffic lights, the place of its map.

The tables are those of the data set's own description. Times are those of the tables (every third
frame of a video of 29.97 Hz is kept, one in 0.1001 s), so that steps are found by time and not by
counting frames: ten minutes of frames are six steps short.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from dosplan.convert.windows import Track
from dosplan.scenario.commonroad.document import ScenarioError
from dosplan.types import STEP_SECONDS, FloatArray, IntArray

VEHICLES: Final = "Veh_smoothed_tracks.csv"
PEDESTRIANS: Final = "Ped_smoothed_tracks.csv"
LIGHTS: Final = "Traffic*ight*.csv"
"""Pattern of the name, which differs from city to city."""
KINDS: Final[Mapping[str, str]] = {
    "car": "car",
    "truck": "truck",
    "bus": "bus",
    "motorcycle": "motorcycle",
    "tricycle": "motorcycle",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
}
"""CommonRoad obstacle types. It has none for the motorised three-wheelers of SinD."""
PEDESTRIAN_SIZE: Final = (0.5, 0.5)
"""Length and width, m: pedestrians are points in SinD, and squares of this size in its viewer."""
COLOURS: Final[Mapping[str, str]] = {"0": "red", "1": "green", "3": "yellow"}
UNKNOWN_COLOUR: Final = "inactive"
"""Colour before the first row that a table has."""
MAX_GAP: Final = 0.35
"""Longest time between two rows of a track that is filled, s: two frames may be lost."""
FASTEST: Final = 100.0
"""Largest speed, m/s, and with 10 km the largest position: what is beyond is no track."""
FARTHEST: Final = 10_000.0
WALKING: Final = 0.3
"""Speed from which on a pedestrian's heading is the direction of motion, m/s."""
LFS_HEADER: Final = b"version https://git-lfs.github.com/spec/"

_POINT: Final = ("x", "y", "vx", "vy")
_BODY: Final = ("yaw_rad", "length", "width")
_MIN_ROWS: Final = 2


@dataclass(frozen=True)
class Lights:
    """The traffic lights.

    Attributes:
        names: Names of L lights, as the table's columns have them.
        times: M times at which the table has a row, s, increasing; the first may be -inf.
        colours: M rows of L CommonRoad colours, each of which holds until the next.
    """

    names: tuple[str, ...] = ()
    times: tuple[float, ...] = ()
    colours: tuple[tuple[str, ...], ...] = ()

    def cycle(self, light: int, first: int, last: int) -> tuple[tuple[str, int], ...]:
        """Colours of a light and for how many steps each is shown, from ``first`` to ``last``."""
        rows = np.searchsorted(
            self.times, STEP_SECONDS * np.arange(first, last + 1) + 1e-6, "right"
        )
        shown = [UNKNOWN_COLOUR if row == 0 else self.colours[row - 1][light] for row in rows]
        starts = [0, *(k + 1 for k, (a, b) in enumerate(pairwise(shown)) if a != b), len(shown)]
        return tuple((shown[begin], end - begin) for begin, end in pairwise(starts))


@dataclass(frozen=True)
class Record:
    """A record.

    Attributes:
        folder: Where it lies.
        tracks: All road users, vehicles first, in the order of the tables.
        lights: Its traffic lights.
    """

    folder: Path
    tracks: tuple[Track, ...]
    lights: Lights


def read_record(folder: Path) -> Record:
    """Reads a record.

    Args:
        folder: Its folder.

    Returns:
        The record.

    Raises:
        ScenarioError: It cannot be used; one line that names the file and what to do.
    """
    if not folder.is_dir():
        raise ScenarioError(folder, "is no folder; name the folder of one record of SinD")
    tables = [(VEHICLES, (*_POINT, *_BODY)), (PEDESTRIANS, _POINT)]
    there = [(folder / name, columns) for name, columns in tables if (folder / name).exists()]
    if not there:
        raise ScenarioError(
            folder, f"holds neither {VEHICLES} nor {PEDESTRIANS}; name the folder of one record"
        )
    tracks = tuple(track for path, columns in there for track in _read_tracks(path, columns))
    if not tracks:
        raise ScenarioError(folder, "holds no track of two steps or more; fetch its tables again")
    return Record(folder, tracks, _read_lights(folder))


def find_map(folder: Path) -> Path:
    """Finds the map of a record: the one ``.osm`` file in its folder, or else beside that.

    Args:
        folder: The record's folder.

    Returns:
        The file.

    Raises:
        ScenarioError: There is none, or more than one.
    """
    for place in (folder, folder.resolve().parent):
        found = sorted(place.glob("*.osm"))
        if len(found) > 1:
            names = ", ".join(path.name for path in found)
            raise ScenarioError(place, f"holds several maps ({names}); name one with --map")
        if found:
            return found[0]
    raise ScenarioError(
        folder, "has no map (.osm), nor has the folder above; name one with --map FILE"
    )


@contextmanager
def _rows(path: Path, needed: Sequence[str]) -> Iterator[tuple[list[str], Iterator[list[str]]]]:
    """The header and the rows of a table."""
    try:
        with path.open("rb") as stream:
            if stream.read(len(LFS_HEADER)) == LFS_HEADER:
                raise ScenarioError(
                    path,
                    "is a Git LFS pointer, not the table; fetch it with `git lfs pull`, or remove "
                    "it to convert the rest of the record",
                )
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = csv.reader(stream)
            header = [name.strip() for name in next(rows, [])]
            missing = [name for name in needed if name not in header]
            if missing:
                raise ScenarioError(
                    path, f"has no column {missing[0]}; a table of SinD has {', '.join(needed)}"
                )
            yield header, rows
    except OSError as error:
        raise ScenarioError(path, f"cannot be read ({error.strerror})") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise ScenarioError(path, f"is no table ({error}); fetch it again") from None


def _read_tracks(path: Path, columns: Sequence[str]) -> Iterator[Track]:
    needed = ("track_id", "timestamp_ms", "agent_type", *columns)
    tracks: dict[str, tuple[str, array[float]]] = {}
    with _rows(path, needed) as (header, rows):
        name_at, label_at = header.index("track_id"), header.index("agent_type")
        numbers_at = [header.index(name) for name in ("timestamp_ms", *columns)]
        for line, row in enumerate(rows, start=2):
            if not row:
                continue
            try:
                values = [float(row[i]) for i in numbers_at]
                label = row[label_at]
            except (ValueError, IndexError):
                raise ScenarioError(
                    path, f"line {line} does not hold a number in each of {', '.join(needed[1:])}"
                ) from None
            if label not in KINDS:
                raise ScenarioError(
                    path, f"line {line}: {label!r} is no agent_type; known: {', '.join(KINDS)}"
                )
            tracks.setdefault(row[name_at], (label, array("d")))[1].extend(values)
    for name, (label, numbers) in tracks.items():
        table = np.frombuffer(numbers, dtype=np.float64).reshape(-1, len(columns) + 1)
        yield from _tracks(path, name, label, table)


def _tracks(path: Path, name: str, label: str, table: FloatArray) -> Iterator[Track]:
    """The stretches of a track; of a table of time, ms, position, velocity and the body."""
    time, position, velocity = table[:, 0] / 1000.0, table[:, 1:3], table[:, 3:5]
    if not np.all(np.diff(time) > 0.0):
        raise ScenarioError(path, f"track {name} does not go on in time; sort it by timestamp_ms")
    sane = np.isfinite(table).all()
    if not (sane and np.abs(position).max() <= FARTHEST and np.abs(velocity).max() <= FASTEST):
        raise ScenarioError(
            path,
            f"track {name} is not within {FARTHEST:g} m and {FASTEST:g} m/s all the time; "
            "correct it",
        )
    size, heading = PEDESTRIAN_SIZE, _facing(velocity)
    if table.shape[1] > len(_POINT) + 1:
        size = (float(np.median(table[:, 6])), float(np.median(table[:, 7])))
        heading = np.unwrap(table[:, 5])
        if min(size) <= 0.0:
            raise ScenarioError(path, f"track {name} has a size of {size} m; correct it")
    along = np.sum(velocity * np.column_stack([np.cos(heading), np.sin(heading)]), axis=1)
    states = np.column_stack([position, heading, along])
    breaks = [0, *(np.flatnonzero(np.diff(time) > MAX_GAP) + 1), len(time)]
    for begin, end in pairwise(breaks):
        if end - begin < _MIN_ROWS:
            continue
        first, stretch = _at_steps(time[begin:end], states[begin:end])
        if len(stretch) >= _MIN_ROWS:
            yield Track(name, label, KINDS[label], size, first, stretch)


def _facing(velocity: FloatArray) -> FloatArray:
    """(K,) headings of a pedestrian: the direction of motion, or when standing, the last one."""
    walking = np.flatnonzero(np.hypot(velocity[:, 0], velocity[:, 1]) > WALKING)
    if len(walking) == 0:
        walking = np.arange(len(velocity))
    latest = np.searchsorted(walking, np.arange(len(velocity)), "right") - 1
    seen = velocity[walking[np.maximum(latest, 0)]]
    return np.unwrap(np.arctan2(seen[:, 1], seen[:, 0]))


def _at_steps(time: FloatArray, states: FloatArray) -> tuple[int, FloatArray]:
    """The first of the steps that lie in a stretch of time, and the states at all of them.

    Positions follow a cubic spline, whose error at 1 m/s3 is far below a millimetre; a straight
    line would cut corners by up to 4 mm at 3 m/s2. Headings and velocities are interpolated
    linearly: those of the table need not be the derivatives of its positions.
    """
    from scipy.interpolate import CubicSpline

    first = int(np.ceil(time[0] / STEP_SECONDS - 1e-6))
    last = int(np.floor(time[-1] / STEP_SECONDS + 1e-6))
    steps: IntArray = np.arange(first, last + 1)
    at = np.clip(STEP_SECONDS * steps, time[0], time[-1])
    found: npt.NDArray[np.float64] = CubicSpline(time, states[:, :2])(at)
    rest = [np.interp(at, time, column) for column in states[:, 2:].T]
    return first, np.column_stack([found, *rest])


def _read_lights(folder: Path) -> Lights:
    """The lights of a record; none where it has no table of them."""
    found = sorted(folder.glob(LIGHTS))
    if not found:
        return Lights()
    if len(found) > 1:
        raise ScenarioError(folder, f"holds {len(found)} tables of traffic lights; keep one")
    path, time_name = found[0], "timestamp(ms)"
    known: dict[float, tuple[str, ...]] = {}
    with _rows(path, ("RawFrameID", time_name)) as (header, rows):
        at = [i for i, name in enumerate(header) if name not in ("RawFrameID", time_name, "")]
        for line, row in enumerate(rows, start=2):
            if not any(row):
                continue
            try:
                text = row[header.index(time_name)]
                # A first row without a time is what was shown before the record began.
                time = float(text) / 1000.0 if text or known else -np.inf
                if text and not np.isfinite(time):
                    raise ValueError(text)
                shown = tuple(COLOURS[row[i].strip()] for i in at)
            except (ValueError, IndexError, KeyError):
                states = ", ".join(f"{number} ({name})" for number, name in COLOURS.items())
                raise ScenarioError(
                    path, f"line {line} does not hold a time and a state, {states}, of each light"
                ) from None
            if known.setdefault(time, shown) != shown:
                raise ScenarioError(
                    path, f"line {line} contradicts an earlier one of the same time; remove one"
                )
    times = sorted(known)
    return Lights(
        names=tuple(header[i] for i in at),
        times=tuple(times),
        colours=tuple(known[time] for time in times),
    )
