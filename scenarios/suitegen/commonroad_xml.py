"""A moment of simulated traffic as a CommonRoad file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from dosplan.scenario.commonroad.drafts import (
    Goal,
    Header,
    LaneletMap,
    Light,
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
    lights = tuple(_shifted(light, moment.first) for light in lanelet_map.lights)
    problem = ProblemDraft(moment.drive(), moment.start, moment.goal_first, moment.last, goal)
    header = Header(benchmark_id, source, frozenset({*tags, "simulated"}))
    return scenario_xml(header, replace(lanelet_map, lights=lights), _users(moment), problem)


def _shifted(light: Light, first_step: int) -> Light:
    """The signal with its cycle counted from step 0, before which SUMO's time 0 lies."""
    total = sum(steps for _, steps in light.cycle)
    return replace(light, offset=-(round(RECORD_FROM / STEP) + first_step) % total)


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
