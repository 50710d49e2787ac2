"""Reads golden scenes.

A scene file is a road, road users, an ego and a goal, and a list of cases. Each case may change
values of the scene (``change``: dotted path to a new value) and states what the score must be
(``expected``: columns of ``Score``). Movers keep their velocity: ``position`` is the centre at
``first_step``, ``direction`` the way they move where it is not their heading.
"""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from dosplan.types import (
    Arm,
    Episode,
    EpisodeEnd,
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

DT = 0.1
VEHICLE = VehicleParameters()


@dataclass(frozen=True)
class Case:
    """One case of a scene file."""

    name: str
    scenario: Scenario
    episode: Episode
    expected: dict[str, Any]


def read_cases(path: Path) -> Iterator[Case]:
    """Yields the cases of a scene file."""
    base = tomllib.loads(path.read_text())
    for case in base.pop("case"):
        scene = copy.deepcopy(base)
        for where, value in case.get("change", {}).items():
            _set(scene, where.split("."), value)
        name = f"{path.stem}: {case['name']}"
        scenario = _scenario(scene, name)
        episode = _episode(scene, name, scenario.tracks)
        yield Case(name, scenario, episode, case["expected"])


def _set(tree: Any, keys: list[str], value: Any) -> None:
    *parents, last = [int(key) if key.isdigit() else key for key in keys]
    for key in parents:
        tree = tree[key]
    if last not in tree:
        raise KeyError(f"{'.'.join(keys)} names nothing in the scene")
    tree[last] = value


def _drive(mover: dict[str, Any]) -> FloatArray:
    """(K, 4) states of a mover."""
    heading, velocity = np.deg2rad(mover["heading"]), mover["velocity"]
    direction = np.deg2rad(mover.get("direction", mover["heading"]))
    way = velocity * DT * np.arange(mover["steps"])
    states = np.empty((mover["steps"], 4))
    states[:, 0] = mover["position"][0] + way * np.cos(direction)
    states[:, 1] = mover["position"][1] + way * np.sin(direction)
    states[:, 2] = heading
    states[:, 3] = velocity
    return states


def _tracks(users: list[dict[str, Any]]) -> Tracks:
    steps = max((user["first_step"] + user["steps"] for user in users), default=0)
    states = np.full((len(users), steps, 4), np.nan)
    for row, user in zip(states, users, strict=True):
        row[user["first_step"] : user["first_step"] + user["steps"]] = _drive(user)
    outlines = tuple(np.array(user["outline"]) if "outline" in user else None for user in users)
    return Tracks(
        ids=np.array([user["id"] for user in users], dtype=np.int64),
        kinds=tuple(RoadUserKind(user["kind"]) for user in users),
        size=np.array([user["size"] for user in users]).reshape(-1, 2),
        states=states,
        valid=np.isfinite(states[..., 0]),
        outlines=outlines,
    )


def _scenario(scene: dict[str, Any], name: str) -> Scenario:
    lanelets = tuple(
        Lanelet(
            id=x["id"],
            left=np.array(x["left"], dtype=np.float64),
            right=np.array(x["right"], dtype=np.float64),
            successors=tuple(x.get("successors", ())),
        )
        for x in scene["lanelets"]
    )
    drivable = shapely.union_all(
        [shapely.Polygon(np.concatenate([x.left, x.right[::-1]])) for x in lanelets]
    )
    goal = scene["goal"]
    x = np.arange(0.0, 301.0)
    path = np.stack([x, np.zeros_like(x)], axis=-1)
    flat = np.zeros_like(x)
    ego = _ego(scene["ego"])
    task = PlanningTask(
        scenario_id=name,
        dt=DT,
        start_step=scene["ego"]["first_step"],
        start=ego[0],
        goals=(GoalState(goal["first_step"], goal["last_step"], shapely.box(*goal["box"])),),
        final_step=goal["last_step"],
        route=Route(
            (1,),
            x,
            path,
            heading=flat,
            curvature=flat,
            left=flat + 1.75,
            right=flat - 1.75,
            outer_left=flat + 1.75,
            outer_right=flat - 1.75,
            speed_limit=flat + np.inf,
        ),
    )
    road_map = RoadMap(lanelets, drivable)
    tracks = _tracks(scene.get("users", []))
    return Scenario(name, name, 1, DT, road_map, tracks, task)


def _ego(ego: dict[str, Any]) -> FloatArray:
    return np.array([VEHICLE.state_at(x[:2], x[2], x[3]) for x in _drive(ego)])


def _episode(scene: dict[str, Any], name: str, tracks: Tracks) -> Episode:
    states = _ego(scene["ego"])
    return Episode(
        scenario_id=name,
        arm=Arm.WITH_DOS,
        start_step=scene["ego"]["first_step"],
        states=states,
        inputs=np.zeros((len(states) - 1, 2)),
        tracks=tracks,
        end=EpisodeEnd(scene["ego"]["end"]),
        predict_seconds=np.zeros(0),
        plan_seconds=np.zeros(0),
        plans=(),
        occupancies=(),
        cycle_steps=np.zeros(0, dtype=np.int64),
    )
