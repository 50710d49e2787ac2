"""One scenario with the drives of its sides, as the player and the thumbnails draw it.

Only what can be seen is kept: the map and the road users near the drives, the sets of the
road users that came nearest, plans at every half second. Everything is relative to an origin
beside the ego's start. The scored drive ends at a contact or at the goal, and so does
what is shown.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from dosplan.geometry import areas, lanelets_off_road
from dosplan.report.html.codec import METRE, RADIAN, SPEED, differences, polyline
from dosplan.report.html.predictions import prediction_blocks
from dosplan.report.road_paint import Look, crosswalks, lamps, lines, plates, stop_lines
from dosplan.report.sight import is_elsewhere
from dosplan.results.drive import Drive
from dosplan.scoring.part import scored_cycles
from dosplan.system.files import FileError
from dosplan.types import (
    EGO_VELOCITY,
    STEP_SECONDS,
    USER_HEADING,
    FloatArray,
    IntArray,
    RoadUserKind,
    Scenario,
    Tracks,
)

MAP_METRES: Final = 60.0
"""How far beside the drives the map is kept."""

USER_METRES: Final = 70.0
"""Road users that never come nearer to a drive than this are left out."""

MOST_USERS: Final = 60
PREDICTED_METRES: Final = 40.0
MOST_PREDICTED: Final = 12
"""Sets are kept of the road users that come nearest, so many and so near."""

PLAN_STRIDE: Final = 5
"""Every fifth point of a plan is kept: half a second."""

KINDS: Final = tuple(RoadUserKind)
_TOLERANCE: Final = 0.1  # m; of a simplified outline.


def encode_episode(scene: Scenario | None, drives: Sequence[Drive | None]) -> dict[str, Any]:
    """Writes what the player draws.

    Args:
        scene: The scenario, or None where it is not there: then there is no map.
        drives: The drive of each side; None where it has none. One is there at least.

    Returns:
        The payload; ``static/player.js`` reads it.
    """
    driven = [drive for drive in drives if drive is not None]
    origin = np.rint(driven[0].ego[0, :2])
    payload: dict[str, Any] = {
        "dt": STEP_SECONDS,
        "first": min(drive.start for drive in driven),
        "ego": list(driven[0].vehicle.size),
    }
    if scene is not None:
        payload |= _encode_map(scene, driven, origin)
        payload["lights"] = _encode_lights(scene, drives, origin)
    others = _encode_others(drives, origin)
    if others.users is not None:
        payload["users"] = others.users
    payload["predictions"] = others.predictions
    payload["sides"] = [
        None
        if drive is None
        else _encode_drive(drive, origin)
        | {"predictions": block, "touched": drive.row.collision_with}
        | ({} if seen is None else {"seen": seen})
        for drive, block, seen in zip(drives, others.used, others.seen, strict=True)
    ]
    return payload


@dataclass(frozen=True)
class _Others:
    """What a page draws of the road users: lists of the payload; each side's block and sight."""

    users: list[dict[str, Any]] | None
    predictions: list[dict[str, Any]]
    used: list[dict[str, Any] | None]
    seen: list[dict[str, Any] | None]


def _encode_others(drives: Sequence[Drive | None], origin: FloatArray) -> _Others:
    """Writes road users and predictions; sides that met the same road users share them."""
    groups: dict[int, list[tuple[int, Drive]]] = {}
    for side, drive in enumerate(drives):
        if drive is not None:
            groups.setdefault(id(drive.known_tracks), []).append((side, drive))
    users: list[dict[str, Any]] = []
    blocks: list[dict[str, Any]] = []
    used: list[dict[str, Any] | None] = [None] * len(drives)
    seen: list[dict[str, Any] | None] = [None] * len(drives)
    for group in groups.values():
        sides, members = [side for side, _ in group], [drive for _, drive in group]
        tracks, wanted = members[0].known_tracks, None
        if tracks is not None:
            near = _nearest(tracks, members)
            wanted = {
                name: index + len(users)
                for name, index in _predicted(tracks, near, members).items()
            }
            for side, drive in group:
                seen[side] = _encode_seen(drive, tracks, near, len(users), origin)
            theirs = {"sides": sides} if len(groups) > 1 else {}
            users += [one | theirs for one in _encode_users(tracks, near, members, origin)]
        found, shown = prediction_blocks(
            [drive.recording for drive in members],
            [drive.row.steps for drive in members],
            wanted,
            origin,
        )
        for side, block in zip(sides, shown, strict=True):
            used[side] = None if block is None else block | {"block": block["block"] + len(blocks)}
        blocks += found
    known = any(drive is not None and drive.known_tracks is not None for drive in drives)
    return _Others(users if known else None, blocks, used, seen)


def _encode_seen(
    drive: Drive, tracks: Tracks, near: IntArray, first: int, origin: FloatArray
) -> dict[str, Any] | None:
    """Writes what the ego saw; None where that was all there was, at the step of each cycle.

    Args:
        drive: The drive.
        tracks: The road users.
        near: Rows of those that are drawn.
        first: Index in the payload of the first of these.
        origin: (2,) m.

    Returns:
        For each cycle that is shown, ``hidden``: indices of those on the scene that it does not
        know; ``at``: index, x, y and heading of each that it knows to be elsewhere.
    """
    sightings = drive.recording.sightings
    if sightings is None:
        return None
    hidden: list[list[int]] = []
    at: list[list[int]] = []
    for cycle in _shown_cycles(drive).tolist():
        step = min(int(drive.recording.cycle_steps[cycle]), tracks.steps - 1)
        known = sightings.of_cycle(cycle)
        hidden.append([])
        at.append([])
        for index, row in enumerate(near.tolist(), start=first):
            state = known.get(int(tracks.ids[row]))
            if state is None:
                hidden[-1] += [index] if tracks.valid[row, step] else []
            elif is_elsewhere(state, tracks.states[row, step]):
                place = np.rint([*(state[:2] - origin) / METRE, state[USER_HEADING] / RADIAN])
                at[-1] += [index, *(int(value) for value in place)]
    return {"hidden": hidden, "at": at}


def _shown_cycles(drive: Drive) -> IntArray:
    """Rows of the planning cycles that act before the end of the scored drive."""
    return scored_cycles(drive.recording.cycle_steps, drive.start, drive.row.steps)


def _place(drive: Drive) -> FloatArray:
    """(2,) where the outcome was decided, m; of a row that does not fit its drive, the ego."""
    try:
        return drive.place
    except FileError:
        return np.asarray(drive.ego[drive.decisive_step - drive.start, :2])


def _encode_drive(drive: Drive, origin: FloatArray) -> dict[str, Any]:
    recording, poses = drive.recording, drive.ego
    kept = _shown_cycles(drive)
    plans = recording.plan_centres[kept, PLAN_STRIDE::PLAN_STRIDE] - origin
    # A plan that is shorter than the longest stays at its last point.
    ends = np.isnan(plans[..., 0])
    for column in range(1, plans.shape[1]):
        plans[ends[:, column], column] = plans[ends[:, column], column - 1]
    whole = not np.isnan(plans).any()
    return {
        "start": drive.start,
        "x": differences(poses[:, 0] - origin[0], METRE, 2),
        "y": differences(poses[:, 1] - origin[1], METRE, 2),
        "h": differences(np.unwrap(poses[:, 2]), RADIAN, 1),
        "v": differences(recording.states[: len(poses), EGO_VELOCITY], SPEED, 1),
        "moment": drive.decisive_step - drive.start,
        "place": polyline([_place(drive) - origin]),
        "cycles": differences(recording.cycle_steps[kept], 1.0, 1),
        "plans": [
            [differences(plans[:, column, axis], METRE, 2) for axis in range(2)]
            for column in range(plans.shape[1] if whole else 0)
        ],
    }


def _encode_users(
    tracks: Tracks, users: IntArray, drives: Sequence[Drive], origin: FloatArray
) -> list[dict[str, Any]]:
    first, last = _window(drives)
    encoded = []
    for user in users:
        steps = np.flatnonzero(tracks.valid[user, first : last + 1]) + first
        # Gaps in a recording are rare: the steps between are drawn on the way across.
        there = np.arange(steps[0], steps[-1] + 1)
        states = tracks.states[user, steps]
        x, y, heading = (
            np.interp(there, steps, column)
            for column in (states[:, 0], states[:, 1], np.unwrap(states[:, 2]))
        )
        still = np.ptp(x) < METRE and np.ptp(y) < METRE and np.ptp(heading) < RADIAN
        kept = slice(0, 1) if still else slice(None)
        one: dict[str, Any] = {
            "id": int(tracks.ids[user]),
            "kind": KINDS.index(tracks.kinds[user]),
            "size": [round(float(side), 2) for side in tracks.size[user]],
            "from": int(there[0]),
            "to": int(there[-1]),
            "x": differences(x[kept] - origin[0], METRE, 2),
            "y": differences(y[kept] - origin[1], METRE, 2),
            "h": differences(heading[kept], RADIAN, 1),
        }
        outline = tracks.outlines[user]
        encoded.append(one if outline is None else one | {"outline": polyline(outline)})
    return encoded


def _encode_map(scene: Scenario, drives: Sequence[Drive], origin: FloatArray) -> dict[str, Any]:
    box = shapely.box(*_bounds(drives, MAP_METRES))
    road_map = scene.road_map
    looks: dict[tuple[int, ...], Look] = {}
    for line in lines(road_map):
        for points in _clipped(line.points, box):
            # The bound that two lanelets share is drawn once, whichever way it runs.
            key = min(tuple(polyline(p - origin)) for p in (points, points[::-1]))
            looks.setdefault(key, line.look)
    painted: dict[str, list[list[int]]] = {}
    for key, look in looks.items():
        painted.setdefault(look.value, []).append(list(key))
    goals = [goal.region for goal in scene.task.goals if goal.region is not None]
    return {
        "road": outlines(shapely.intersection(road_map.drivable, box), origin),
        "offRoad": outlines(shapely.intersection(lanelets_off_road(road_map), box), origin),
        "lines": painted.pop(Look.BOUND.value, []),
        "goals": [ring for goal in goals for ring in outlines(goal.intersection(box), origin)],
        "paint": painted,
        "crosswalks": [
            [round(walk.width / METRE), *polyline(points - origin)]
            for walk in crosswalks(road_map)
            for points in _clipped(walk.centre, box)
        ],
        "stops": [
            polyline(points - origin)
            for ends in stop_lines(road_map)
            for points in _clipped(ends, box)
        ],
        "signs": [
            [plate.rule.value, *polyline([plate.place - origin]), plate.text, plate.unit]
            for plate in plates(road_map)
            if shapely.contains_xy(box, *plate.place)
        ],
    }


def _clipped(points: FloatArray, box: Polygon) -> list[FloatArray]:
    """The parts of a line in a box, of as few points as draw it."""
    inside = shapely.intersection(shapely.LineString(points), box)
    return [
        np.asarray(part.coords)
        for part in shapely.get_parts(shapely.simplify(inside, _TOLERANCE))
        if isinstance(part, shapely.LineString) and not part.is_empty
    ]


def _encode_lights(
    scene: Scenario, drives: Sequence[Drive | None], origin: FloatArray
) -> list[dict[str, Any]]:
    """Writes the lamps by the steps at which they change; sides with the same lights share them."""
    there = [(side, drive) for side, drive in enumerate(drives) if drive is not None]
    driven = [drive for _, drive in there]
    box, (first, last) = shapely.box(*_bounds(driven, MAP_METRES)), _window(driven)
    sides: dict[str, list[int]] = {}
    for side, drive in there:
        found = []
        for lamp in lamps(scene.road_map, drive.signals):
            if not shapely.contains_xy(box, *lamp.place):
                continue
            shown = np.array([lamp.at(step) for step in range(first, last + 1)])
            changes = [0, *(np.flatnonzero(np.diff(shown)) + 1).tolist()]
            found.append(
                {
                    "at": polyline([lamp.place - origin]),
                    "from": [first + change for change in changes],
                    "shown": shown[changes].tolist(),
                }
            )
        sides.setdefault(json.dumps(found), []).append(side)
    shared = len(sides) == 1
    return [
        lamp if shared else lamp | {"sides": members}
        for text, members in sides.items()
        for lamp in json.loads(text)
    ]


def outlines(area: shapely.Geometry, origin: FloatArray) -> list[list[int]]:
    """Writes the rings of an area, holes too: to be filled by the even-odd rule.

    Args:
        area: m.
        origin: (2,) m.

    Returns:
        A ``polyline`` each.
    """
    shape: Polygon | MultiPolygon = areas(shapely.simplify(area, _TOLERANCE))
    return [
        polyline(np.asarray(ring.coords) - origin)
        for polygon in shapely.get_parts(shape)
        for ring in (polygon.exterior, *polygon.interiors)
    ]


def _bounds(drives: Sequence[Drive], margin: float) -> tuple[float, float, float, float]:
    centres = np.concatenate([drive.ego[:, :2] for drive in drives])
    (left, bottom), (right, top) = centres.min(axis=0) - margin, centres.max(axis=0) + margin
    return float(left), float(bottom), float(right), float(top)


def _window(drives: Sequence[Drive]) -> tuple[int, int]:
    """First and last step that is shown."""
    return min(d.start for d in drives), max(d.start + d.row.steps for d in drives)


def _distances(tracks: Tracks, drives: Sequence[Drive]) -> FloatArray:
    """(N,) smallest distance of each road user to an ego at the same step, m."""
    smallest = np.full(len(tracks.ids), np.inf)
    for drive in drives:
        centres = drive.ego[:, :2][: max(tracks.steps - drive.start, 0)]
        window = slice(drive.start, drive.start + len(centres))
        apart = np.linalg.norm(tracks.states[:, window, :2] - centres, axis=-1)
        apart[~tracks.valid[:, window]] = np.inf
        smallest = np.minimum(smallest, apart.min(axis=1, initial=np.inf))
    return smallest


def _nearest(tracks: Tracks, drives: Sequence[Drive]) -> IntArray:
    distances = _distances(tracks, drives)
    order = np.argsort(distances, kind="stable")
    return np.asarray(order[distances[order] < USER_METRES][:MOST_USERS])


def _predicted(tracks: Tracks, nearest: IntArray, drives: Sequence[Drive]) -> Mapping[int, int]:
    """Index in the payload of each road user whose sets are kept, by id."""
    distances = _distances(tracks, drives)[nearest]
    touched = {drive.row.collision_with for drive in drives}
    ids = tracks.ids[nearest].tolist()
    kept = [
        index
        for index, (one, distance) in enumerate(zip(ids, distances, strict=True))
        if one in touched or (index < MOST_PREDICTED and distance < PREDICTED_METRES)
    ]
    return {ids[index]: index for index in kept}
