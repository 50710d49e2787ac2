"""Drives a plug-in through a few cycles of a scene and keeps what it did, to be checked.

The scenes are built in code (``dosplan.scenario.synthetic``).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from dosplan.api import OraclePredictor, Planner, Predictor
from dosplan.scenario.synthetic import growing_sets
from dosplan.simulation.world import World
from dosplan.types import HISTORY_STEPS, Observation, Occupancy, Plan, Scenario

CYCLES = 3
HORIZON = 40  # Steps that are predicted for a planner, at least.


@dataclass(frozen=True)
class Trace:
    """What a plug-in did over a few cycles.

    Attributes:
        results: What it returned, cycle by cycle.
        seconds: How long each call took, s.
        touched: Fields of what it was handed that it changed.
    """

    results: tuple[Any, ...]
    seconds: tuple[float, ...]
    touched: tuple[str, ...]


def _observation(world: World, visible: int) -> Observation:
    """What is seen now; road users have been on the scene for ``visible`` steps."""
    seen = world.observation()
    valid = np.array(seen.valid)
    valid[:, : HISTORY_STEPS - visible] = False
    return replace(seen, valid=valid, states=np.where(valid[..., None], seen.states, np.nan))


def drive_planner(
    planner: Planner,
    scenario: Scenario,
    *,
    visible: int = HISTORY_STEPS,
    sets: Callable[[Observation, int], Occupancy] = growing_sets,
) -> Trace:
    """Drives a planner for a few cycles in closed loop.

    Args:
        planner: The planner; ``reset`` is called here.
        scenario: What to drive.
        visible: Steps that road users have been on the scene for.
        sets: Makes the sets that it is handed, for a number of steps.

    Returns:
        What it did.
    """
    world = World(scenario)
    planner.reset(scenario.task, scenario.road_map, scenario.task.vehicle)
    plans: list[Plan] = []
    seconds: list[float] = []
    touched: list[str] = []
    for _ in range(CYCLES):
        observation = _observation(world, visible)
        occupancy = sets(observation, max(HORIZON, planner.look_ahead))
        before = copy.deepcopy((observation, occupancy))
        plans.append(planner.plan(observation, occupancy))
        seconds.append(planner.last_seconds)
        for old, new in zip(before, (observation, occupancy), strict=True):
            touched.extend(_differences(old, new))
        world.step(plans[-1].inputs[0])
    return Trace(tuple(plans), tuple(seconds), tuple(touched))


def drive_predictor(
    predictor: Predictor, scenario: Scenario, *, visible: int = HISTORY_STEPS
) -> Trace:
    """Calls a predictor for a few cycles; the ego keeps its speed.

    Args:
        predictor: The predictor; ``reset`` is called here.
        scenario: What it sees; an oracle is shown the future, too.
        visible: Steps that road users have been on the scene for.

    Returns:
        What it did.
    """
    if isinstance(predictor, OraclePredictor):
        predictor.reveal(scenario.tracks)
    predictor.reset(scenario.task, scenario.road_map)
    world = World(scenario)
    sets: list[Occupancy] = []
    seconds: list[float] = []
    touched: list[str] = []
    for _ in range(CYCLES):
        observation = _observation(world, visible)
        before = copy.deepcopy(observation)
        sets.append(predictor.predict(observation))
        seconds.append(predictor.last_seconds)
        touched.extend(_differences(before, observation))
        world.step(np.zeros(2))
    return Trace(tuple(sets), tuple(seconds), tuple(touched))


def changed_fields(one: Trace, other: Trace) -> list[str]:
    """Compares the results of two drives.

    Args:
        one: A drive.
        other: Another, of as many cycles.

    Returns:
        Names of the array fields in which their results differ, sorted.
    """
    pairs = zip(one.results, other.results, strict=True)
    return sorted({name for a, b in pairs for name in _differences(a, b)})


def another_future(scenario: Scenario) -> Scenario:
    """Changes the future that a plug-in cannot know while it is driven through the scene.

    Args:
        scenario: The scene.

    Returns:
        The same, but without road users once the cycles are over.
    """
    valid = np.array(scenario.tracks.valid)
    valid[:, scenario.task.start_step + CYCLES :] = False
    return replace(scenario, tracks=replace(scenario.tracks, valid=valid))


def _differences(one: Any, other: Any) -> list[str]:
    """Names of the array fields in which two values of the same type differ."""
    found: list[str] = []
    if isinstance(one, Occupancy) and (one.union is not None or other.union is not None):
        if one.union is None or other.union is None:
            found.append("Occupancy.union")
        else:
            found += _differences(one.union, other.union)
    return found + [
        f"{type(one).__name__}.{field.name}"
        for field in fields(one)
        if isinstance(getattr(one, field.name), np.ndarray)
        and not np.array_equal(
            getattr(one, field.name),
            getattr(other, field.name),
            equal_nan=getattr(one, field.name).dtype.kind == "f",
        )
    ]
