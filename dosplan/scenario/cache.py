"""Parsed scenarios on disk: the second run of a scenario does not parse it again.

An entry is named by a SHA-256 over all that it follows from: the file's content, the episode's
name, the source of the code that makes a ``Scenario`` of it and the versions of the libraries it
calls. So an entry never has to be told that it is out of date; nobody asks for it any more. What
cannot be read back is made anew.

An entry holds three plain arrays in an uncompressed ``.npz``, whose checksums tell damage:
``numbers``, every array of the scenario after another, ``shapes``, the polygons as WKB, and
``header``, JSON with all the rest and the place of each array. Nothing is pickled, so that an
entry that was tampered with can give a wrong scenario but cannot run code.

The cache bounds itself: each of its 256 folders drops the entries that were not read for longest
when it grows beyond its share of ``MAX_BYTES``.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from dosplan.scenario.sources.catalogue import ScenarioRef
from dosplan.system.files import FileError, write_bytes
from dosplan.system.folders import cache_folder
from dosplan.types import (
    FloatArray,
    GoalState,
    Lanelet,
    PlanningTask,
    RoadMap,
    RoadUserKind,
    Route,
    Scenario,
    Tracks,
)
from dosplan.vehicle import VehicleParameters

MAX_BYTES: Final = 4 * 1024**3
"""Size that the whole cache keeps to, about."""
_FORMAT: Final = 5
_LIBRARIES: Final = ("commonroad-io", "networkx", "numpy", "scipy", "shapely")
_ROUTE: Final = (
    "arclength", "path", "heading", "curvature", "left", "right", "outer_left", "outer_right",
    "speed_limit",
)  # fmt: skip
_LANELET: Final = (
    "id", "successors", "predecessors", "left_neighbour", "right_neighbour", "speed_limit",
    "for_cars",
)  # fmt: skip


def cached(ref: ScenarioRef, content: bytes, make: Callable[[], Scenario]) -> Scenario:
    """Reads an episode from the cache, or makes it and puts it there.

    Args:
        ref: The episode.
        content: What its file holds.
        make: Makes the scenario.

    Returns:
        The scenario, equal in every field to what ``make`` returns.
    """
    path = _entry(ref, content)
    with suppress(Exception):  # A damaged entry may raise anything; it is made anew.
        scenario = unpack_scenario(path.read_bytes())
        os.utime(path)
        return scenario
    scenario = make()
    with suppress(FileError, OSError):  # No room, no permission: it works without a cache.
        write_bytes(path, pack_scenario(scenario))
        _prune(path.parent)
    return scenario


def pack_scenario(scenario: Scenario) -> bytes:
    """Packs a scenario into an entry.

    Args:
        scenario: The scenario.

    Returns:
        The entry's content.
    """
    arrays: list[FloatArray] = []
    shapes: list[bytes] = []

    def array(values: Any) -> list[int]:
        arrays.append(np.asarray(values, dtype=np.float64))
        return list(arrays[-1].shape)

    def shape(geometry: shapely.Geometry) -> int:
        shapes.append(shapely.to_wkb(geometry))
        return len(shapes[-1])

    tracks, task = scenario.tracks, scenario.task
    header = {
        "id": scenario.id,
        "benchmark_id": scenario.benchmark_id,
        "problem_id": scenario.problem_id,
        "dt": scenario.dt,
        "tags": sorted(scenario.tags),
        "drivable": shape(scenario.road_map.drivable),
        "lanelets": [
            [getattr(lanelet, name) for name in _LANELET] for lanelet in scenario.road_map.lanelets
        ],
        "points": [array([x.left, x.right]) for x in scenario.road_map.lanelets],
        "ids": tracks.ids.tolist(),
        "kinds": [kind.value for kind in tracks.kinds],
        "size": array(tracks.size),
        "states": array(tracks.states),
        "valid": array(tracks.valid),
        "outlines": [None if x is None else array(x) for x in tracks.outlines],
        "task": [task.scenario_id, task.dt, task.start_step, task.final_step],
        "start": array(task.start),
        "vehicle": asdict(task.vehicle),
        "goals": [
            [
                goal.first_step,
                goal.last_step,
                None if goal.region is None else shape(goal.region),
                goal.heading,
                goal.velocity,
            ]
            for goal in task.goals
        ],
        "route": [list(task.route.lanelet_ids), *(array(getattr(task.route, x)) for x in _ROUTE)],
    }
    file = io.BytesIO()
    np.savez(
        file,
        allow_pickle=False,
        header=np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        shapes=np.frombuffer(b"".join(shapes), dtype=np.uint8),
        numbers=np.concatenate([values.ravel() for values in arrays]),
    )
    return file.getvalue()


def unpack_scenario(data: bytes) -> Scenario:
    """Reads an entry back.

    Args:
        data: What ``pack_scenario`` gave.

    Returns:
        The scenario.

    Raises:
        Exception: Whatever numpy, zipfile, json or shapely raise at a damaged entry.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        header = json.loads(file["header"].tobytes())
        shapes, numbers = file["shapes"].tobytes(), file["numbers"]
    read_numbers = read_shapes = 0

    # The parts lie in the order in which they are asked for here, which is that of packing.
    def array(dimensions: list[int]) -> FloatArray:
        nonlocal read_numbers
        begin, read_numbers = read_numbers, read_numbers + int(np.prod(dimensions))
        return np.asarray(numbers[begin:read_numbers].reshape(dimensions))

    def shape(length: int) -> Any:
        nonlocal read_shapes
        begin, read_shapes = read_shapes, read_shapes + length
        return shapely.from_wkb(shapes[begin:read_shapes])

    drivable = shape(header["drivable"])
    road_map = RoadMap(
        lanelets=tuple(
            _lanelet(values, *array(dimensions))
            for values, dimensions in zip(header["lanelets"], header["points"], strict=True)
        ),
        drivable=drivable,
    )
    tracks = Tracks(
        ids=np.array(header["ids"], dtype=np.int64),
        kinds=tuple(RoadUserKind(kind) for kind in header["kinds"]),
        size=array(header["size"]),
        states=array(header["states"]),
        valid=array(header["valid"]).astype(np.bool_),
        outlines=tuple(None if x is None else array(x).copy() for x in header["outlines"]),
    )
    name, dt, start_step, final_step = header["task"]
    start = array(header["start"])
    goals = tuple(
        GoalState(
            first_step=first,
            last_step=last,
            region=None if length is None else shape(length),
            heading=None if heading is None else tuple(heading),
            velocity=None if velocity is None else tuple(velocity),
        )
        for first, last, length, heading, velocity in header["goals"]
    )
    lanelet_ids, *dimensions = header["route"]
    parts = {field: array(size) for field, size in zip(_ROUTE, dimensions, strict=True)}
    return Scenario(
        id=header["id"],
        benchmark_id=header["benchmark_id"],
        problem_id=header["problem_id"],
        dt=header["dt"],
        road_map=road_map,
        tracks=tracks,
        task=PlanningTask(
            scenario_id=name,
            dt=dt,
            start_step=start_step,
            start=start,
            goals=goals,
            final_step=final_step,
            route=Route(lanelet_ids=tuple(lanelet_ids), **parts),
            vehicle=VehicleParameters(**header["vehicle"]),
        ),
        tags=frozenset(header["tags"]),
    )


def _lanelet(values: list[Any], left: FloatArray, right: FloatArray) -> Lanelet:
    fields: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in zip(_LANELET, values, strict=True)
    }
    return Lanelet(left=left, right=right, **fields)


def _entry(ref: ScenarioRef, content: bytes) -> Path:
    key = sha256(_code_digest().encode())
    key.update(f"{ref.id!r} {ref.problem_id} {len(content)}\n".encode())
    key.update(content)
    name = key.hexdigest()
    return cache_folder() / "scenarios" / name[:2] / f"{name[2:]}.npz"


@lru_cache(maxsize=1)
def _code_digest() -> str:
    """Fingerprints the code that makes a ``Scenario`` of a file."""
    package = Path(__file__).resolve().parents[1]
    rooms = ("types", "geometry", "scenario")
    modules = [path for room in rooms for path in sorted(package.glob(f"{room}/**/*.py"))]
    total = sha256(f"format {_FORMAT}\n".encode())
    for path in modules:
        total.update(path.name.encode() + sha256(path.read_bytes()).digest())
    for library in _LIBRARIES:
        total.update(f"{library} {version(library)}\n".encode())
    return total.hexdigest()


def _prune(folder: Path) -> None:
    found = [(entry.stat(), entry) for entry in folder.iterdir()]
    excess = sum(status.st_size for status, _ in found) - MAX_BYTES // 256
    for status, entry in sorted(found, key=lambda item: item[0].st_mtime):
        if excess <= 0:
            break
        entry.unlink(missing_ok=True)
        excess -= status.st_size
