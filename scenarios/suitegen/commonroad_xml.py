"""A moment of simulated traffic as a CommonRoad file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from dosplan.scenario.commonroad.drafts import (
    Goal,
    Header,
    LaneletMap,
    ProblemDraft,
    UserDraft,
)
from dosplan.scenario.commonroad.writer import scenario_xml
from dosplan.types import FloatArray

from .motion import Motion
from .selection import Moment
from .traffic import RECORD_FROM, STEP

OBSTACLE_TYPES = {"ego": "car", "van": "car", "parked": "car"}
"""Names that CommonRoad has another word for."""
AT_REST = 0.02
"""Largest movement, m, of a parked vehicle that stays."""


def moment_xml(
    benchmark_id: str,
    source: str,
    tags: Iterable[str],
    lanelet_map: LaneletMap,
    moment: Moment,
    goal: Goal,
) -> bytes:
    """A CommonRoad file.

    Args:
        benchmark_id: Its id.
        source: Where it comes from.
        tags: CommonRoad tags.
        lanelet_map: The map; the cycles of its signals begin at SUMO's time 0.
        moment: Traffic and ego.
        goal: The goal.

    Returns:
        The XML.
    """
    begin = round(RECORD_FROM / STEP) + moment.first
    problem = ProblemDraft(moment.drive(), moment.start, moment.goal_first, moment.last, goal)
    header = Header(benchmark_id, source, frozenset({*tags, "simulated"}))
    return scenario_xml(header, with_lights_from(lanelet_map, begin), _users(moment), problem)


def with_lights_from(lanelet_map: LaneletMap, begin: int) -> LaneletMap:
    """A map whose signals count from a file's step 0.

    Args:
        lanelet_map: The map; the cycles of its signals begin at SUMO's time 0.
        begin: Steps from then to the file's step 0.

    Returns:
        The map.
    """
    lights = tuple(
        replace(light, offset=-begin % sum(steps for _, steps in light.cycle))
        for light in lanelet_map.lights
    )
    return replace(lanelet_map, lights=lights)


def _stays(motion: Motion, states: FloatArray) -> bool:
    return motion.trace.kind == "parked" and bool(np.ptp(states[:, :2], axis=0).max() < AT_REST)


def _users(moment: Moment) -> Iterator[UserDraft]:
    for motion in moment.others:
        begin = max(motion.first, moment.first)
        end = min(motion.last, moment.first + moment.last)
        states, trace = motion.window(begin, end), motion.trace
        stays = _stays(motion, states)
        kind = "parkedVehicle" if stays else OBSTACLE_TYPES.get(trace.kind, trace.kind)
        yield UserDraft(kind, trace.size, begin - moment.first, states, static=stays)
