"""A scene as files: the scenario, its futures, and what SUMO needs to drive it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from dosplan_sumo.acts import Acts

from dosplan.scenario import load_scenario
from dosplan.scenario.commonroad.drafts import (
    Goal,
    Header,
    LaneletMap,
    ProblemDraft,
    UserDraft,
)
from dosplan.scenario.commonroad.writer import scenario_xml
from dosplan.scenario.futures import with_futures, write_futures
from dosplan.types import RoadUserKind, Scenario, Tracks
from suitegen.commonroad_xml import OBSTACLE_TYPES, with_lights_from
from suitegen.futures.scene import Scene
from suitegen.futures.simulate import Simulated
from suitegen.futures.staging import EGO, Act, Staging
from suitegen.sumo_inputs import EGO as EGO_IN_SUMO
from suitegen.traffic import STEP


def write_scene(
    folder: Path,
    header: Header,
    lanelet_map: LaneletMap,
    staging: Staging,
    simulated: Simulated,
    scene: Scene,
) -> Scenario:
    """Writes a scenario and its futures.

    Args:
        folder: Where ``files/NAME.xml`` and ``futures/NAME.npz`` go.
        header: Metadata.
        lanelet_map: The map; the cycles of its signals begin at SUMO's time 0.
        staging: The scene as it was drawn.
        simulated: As it was driven.
        scene: What was made of it.

    Returns:
        The scenario, read from the files.
    """
    recorded = scene.futures[0]
    names = sorted({name for future in scene.futures for name in future} - {EGO})
    ids = {name: next(lanelet_map.free_ids) for name in names}
    users = [_user(scene, name, ids[name]) for name in names if name in recorded]
    goal = np.array([*simulated.goal, 0.0])
    problem = ProblemDraft(
        np.vstack([scene.drives[0][:2], goal]),
        scene.start,
        scene.start,
        scene.last,
        Goal(*staging.goal_size, heading_window=None, velocity=None),
    )
    begin = round(simulated.begin / STEP) + scene.first
    path = folder / "files" / f"{header.benchmark_id}.xml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(
        scenario_xml(
            header,
            with_lights_from(lanelet_map, begin),
            (user for user in users if user is not None),
            problem,
        )
    )
    scenario = load_scenario(path)
    futures = [_tracks(scenario, scene, k, ids) for k in range(1, len(scene.futures))]
    target = folder / "futures" / f"{header.benchmark_id}.npz"
    target.parent.mkdir(exist_ok=True)
    write_futures(target, scenario, futures)
    return with_futures(scenario, target)


def _user(scene: Scene, name: str, id: int) -> UserDraft | None:
    motion = scene.futures[0][name]
    kind, there, rests = motion.trace.kind, scene.window(motion), name in scene.resting
    if there is None:
        return None
    first, states = there
    word = "parkedVehicle" if rests else _word(kind)
    return UserDraft(word, motion.trace.size, first, states, static=rests, id=id)


def _tracks(scenario: Scenario, scene: Scene, k: int, ids: Mapping[str, int]) -> Tracks:
    """Future ``k``; up to the ego's start it is the recording, from the file."""
    recorded = scenario.tracks
    known = set(recorded.ids.tolist())
    new = [name for name, id in ids.items() if name in scene.futures[k] and id not in known]
    traces = [scene.futures[k][name].trace for name in new]
    room = ((0, len(new)), (0, 0))
    tracks = Tracks(
        ids=np.array([*recorded.ids, *(ids[name] for name in new)]),
        kinds=(*recorded.kinds, *(RoadUserKind(_word(trace.kind)) for trace in traces)),
        size=np.vstack([recorded.size, *(trace.size for trace in traces)]),
        states=np.pad(recorded.states, (*room, (0, 0)), constant_values=np.nan),
        valid=np.pad(recorded.valid, room),
    )
    states, valid = np.array(tracks.states), np.array(tracks.valid)
    rows = {int(name): row for row, name in enumerate(tracks.ids)}
    for name, id in ids.items():
        if id in rows and name not in scene.resting:
            row = rows[id]
            states[row, scene.start + 1 :], valid[row, scene.start + 1 :] = np.nan, False
            there = scene.window(scene.futures[k][name]) if name in scene.futures[k] else None
            if there is not None:
                begin = max(there[0], scene.start + 1)
                part = there[1][begin - there[0] :]
                states[row, begin : begin + len(part)] = part
                valid[row, begin : begin + len(part)] = True
    return replace(tracks, states=states, valid=valid)


def _word(kind: str) -> str:
    """CommonRoad's word for who moves."""
    return OBSTACLE_TYPES.get(kind, kind)


def acts_json(staging: Staging, simulated: Simulated, acts: Sequence[Act]) -> bytes:
    """What the cast of a scene is told, for traffic that SUMO drives again.

    Args:
        staging: The scene.
        simulated: As it was driven.
        acts: What happens in each future.

    Returns:
        The file's content. From the branch on, the stand-in is told nothing: the ego drives.
    """
    prelude = tuple(
        replace(action, actor=EGO_IN_SUMO) if action.actor == EGO else action
        for action in simulated.demand.prelude
    )
    futures = tuple(
        replace(act, script=tuple(action for action in act.script if action.actor != EGO))
        for act in acts
    )
    branch = round(simulated.start_time + staging.branch, 3)
    return Acts(staging.warmup, prelude, branch, futures).json()
