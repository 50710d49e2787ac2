"""Reads golden scenes.

A scene file is a road, road users, an ego and a goal, and a list of cases. Each case may change
values of the scene (``change``: dotted path to a new value) and states what the score must be
(``expected``: columns of ``Score``). Movers keep their velocity: ``position`` is the centre at
``first_step``, ``direction`` the way they move where it is not their heading. With ``pause``, a
first state and a number of steps, they stand still from that state on for so long. A light shows
its ``colours`` one after the other, each for a number of steps.
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
    COLOURS,
    Arm,
    Episode,
    EpisodeEnd,
    FloatArray,
    GoalState,
    Lanelet,
    LightColour,
    LineMarking,
    PlanningTask,
    RoadMap,
    RoadUserKind,
    Route,
    Scenario,
    Signals,
    SignRule,
    StopLine,
    Tracks,
    TrafficLight,
    TrafficSign,
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
    if last not in tree and last not in _OPTIONAL:
        raise KeyError(f"{'.'.join(keys)} names nothing in the scene")
    tree[last] = value


_OPTIONAL = ("box", "pause", "stop_line")


def _drive(mover: dict[str, Any]) -> FloatArray:
    """(K, 4) states of a mover."""
    heading, velocity = np.deg2rad(mover["heading"]), mover["velocity"]
    direction = np.deg2rad(mover.get("direction", mover["heading"]))
    velocities = np.full(mover["steps"], velocity, dtype=np.float64)
    first, count = mover.get("pause", (0, 0))
    velocities[first : first + count] = 0.0
    way = DT * np.concatenate([[0.0], np.cumsum(velocities[:-1])])
    states = np.empty((mover["steps"], 4))
    states[:, 0] = mover["position"][0] + way * np.cos(direction)
    states[:, 1] = mover["position"][1] + way * np.sin(direction)
    states[:, 2] = heading
    states[:, 3] = velocities
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
            predecessors=tuple(x.get("predecessors", ())),
            speed_limit=x.get("speed_limit"),
            left_marking=LineMarking(x.get("left_marking", "unknown")),
            right_marking=LineMarking(x.get("right_marking", "unknown")),
            stop_line=StopLine(np.array(x["stop_line"])) if "stop_line" in x else None,
            lights=tuple(x.get("lights", ())),
            signs=tuple(x.get("signs", ())),
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
        goals=(
            GoalState(
                goal["first_step"],
                goal["last_step"],
                shapely.box(*goal["box"]) if "box" in goal else None,
            ),
        ),
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
    lights, signs = scene.get("lights", []), scene.get("signs", [])
    road_map = RoadMap(
        lanelets,
        drivable,
        lights=tuple(TrafficLight(x["id"], x.get("direction", "all")) for x in lights),
        signs=tuple(TrafficSign(x["id"], x["code"], SignRule(x["rule"])) for x in signs),
    )
    tracks = _tracks(scene.get("users", []))
    return Scenario(name, name, 1, DT, road_map, tracks, task, signals=_signals(lights))


def _signals(lights: list[dict[str, Any]]) -> Signals:
    colours = [
        [COLOURS.index(LightColour(word)) for word, steps in x["colours"] for _ in range(steps)]
        for x in lights
    ]
    steps = max((len(row) for row in colours), default=1)
    shown = np.array([row + row[-1:] * (steps - len(row)) for row in colours], dtype=np.int64)
    return Signals(
        ids=np.array([x["id"] for x in lights], dtype=np.int64),
        colours=shown.reshape(-1, steps),
        since=np.zeros((len(lights), steps)),
    )


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
