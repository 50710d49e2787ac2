"""The rules of the road: red lights, stop signs, speed limits, wrong way, solid lines.

All of them are judged on the lanelets that the ego really drives along, not on those of its route.
The ego's front is the middle of its front edge.

Sources: German StVO, section 37 (lights), sign 206 (stop), sign 295 (solid line); Maierhofer,
Moosbrugger, Althoff, "Formalization of Intersection Traffic Rules in Temporal Logic", IV 2022,
whose rules for a stop sign and a red light are about the front passing the stop line as well;
nuplan-devkit, ``speed_limit_compliance`` and ``driving_direction_compliance``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from dosplan.scenario.route.stops import turn_by_shape
from dosplan.scoring.lanes import DrivenLanes
from dosplan.scoring.part import DrivenPart, ScoredPart
from dosplan.types import (
    USER_HEADING,
    USER_VELOCITY,
    FloatArray,
    IntArray,
    Lanelet,
    LightColour,
    LineMarking,
    RoadMap,
    SignRule,
)

STANDING: Final = 0.5
"""Speed below which a car stands before a line, m/s: slower than a walk, and faster than what is
left of a braking that ends at the line."""

STOP_ZONE: Final = 5.0
"""How far before the line of a stop sign standing counts, m: a car's length, as the place is where
the driver sees, or behind who stands at the line."""

OVERSPEED: Final = 0.1
"""Excess of a speed limit from which on it is exceeded, m/s: more than the error of a controller
that holds the limit."""

DIRECTION_SECONDS: Final = 1.0
"""For how long a drive against the lane's direction is summed up, s (nuPlan's)."""


@dataclass(frozen=True)
class _Crossing:
    """The ego's front passes a line in the direction of the lanelet.

    Attributes:
        lanelet: The lanelet whose line it is.
        line: (2, 2) ends of the line, m.
        step: Index of the last state before the line.
    """

    lanelet: Lanelet
    line: FloatArray
    step: int


@dataclass(frozen=True)
class RedLightRun:
    """A red light that the ego runs.

    Attributes:
        step: The last step of the scenario at which its front is before the line.
        lanelet: Id of the lanelet at whose end the lights are.
        lights: Ids of the lights that forbid every way which it may take there.
    """

    step: int
    lanelet: int
    lights: tuple[int, ...]


def red_lights(part: DrivenPart) -> int | None:
    """Counts the red lights that the ego runs, see ``red_light_runs``.

    Args:
        part: What is scored.

    Returns:
        The number; None where the map has no traffic lights, or no step was driven.
    """
    if not part.scenario.road_map.lights or not part.drove:
        return None
    return len(red_light_runs(part))


def red_light_runs(part: DrivenPart) -> list[RedLightRun]:
    """Finds the red lights that the ego runs.

    The front passes the stop line of a lanelet, or the lanelet's end where there is no line, in
    driving direction, between two steps at both of which the lights forbid it: red, or red with
    yellow. Those lights of the lanelet count that hold for the way that the ego takes from there,
    which is the successor it enters; of several, the strictest. Where the drive ends before that
    shows, all ways must be forbidden. Yellow is no red.

    It is no run where the ego stops beyond the line but before the intersection, and does not
    enter that while it is forbidden: it stands too far ahead then, and in nobody's way (StVO
    section 37: red asks to stop before the intersection).

    Args:
        part: What was driven.

    Returns:
        One for each time.
    """
    if not part.drove:
        return []
    front = _front(part)
    at_lights = (lanelet for lanelet in part.lanes.lanelets if lanelet.lights)
    by_step: dict[int, list[_Crossing]] = {}
    for crossing in _crossings(front, at_lights):
        by_step.setdefault(crossing.step, []).append(crossing)
    return [
        RedLightRun(part.start_step + step, crossings[0].lanelet.id, lights)
        for step, crossings in sorted(by_step.items())
        if (lights := _run_lights(part, front, crossings))
    ]


def _run_lights(
    part: DrivenPart, front: FloatArray, crossings: Sequence[_Crossing]
) -> tuple[int, ...]:
    """Ids of the lights that the ego runs where it passes the lines of lanelets at once.

    These are several where lanelets overlap; those whose successor it enters are the ones on which
    it is.
    """
    road_map = part.scenario.road_map
    ways = [_ways(part.lanes, road_map, crossing) for crossing in crossings]
    entered = [way for way, known in ways if known]
    taken = entered or [way for way, _ in ways]
    lights = tuple(dict.fromkeys(x for way in taken for holding in way for x in holding))
    if not all(_forbidden(part, x, crossings[0].step) for way in taken for x in way):
        return ()
    first = crossings[0]
    entry = next(
        (x.step for x in _crossings(front, [first.lanelet], ends=True) if x.step >= first.step),
        None,
    )
    last = len(front) - 1 if entry is None else entry
    stood = bool(np.any(part.ego[first.step + 1 : last + 1, USER_VELOCITY] < STANDING))
    if not stood:
        return lights
    if entry is None or not all(_forbidden(part, x, entry) for way in taken for x in way):
        return ()
    return lights


def _ways(
    lanes: DrivenLanes, road_map: RoadMap, crossing: _Crossing
) -> tuple[list[tuple[int, ...]], bool]:
    """The lights that hold for each way the ego may take from a line, and whether that is known."""
    lanelet, own = crossing.lanelet, {x.id: x for x in road_map.lanelets}
    successors = [name for name in lanelet.successors if name in own]
    later = slice(crossing.step + 1, None)
    # On which successor the ego is for most of the time, running along with it.
    spent = {
        name: int(np.sum(lanes.along[later, lanes.index[name]] > _ALONG))
        for name in successors
        if name in lanes.index
    }
    most = max(spent.values(), default=0)
    known = [name for name, steps in spent.items() if steps == most] if most else []
    turns = {
        road_map.turn(lanelet.id, name) or turn_by_shape(lanelet, own[name])
        for name in known or successors
    }
    lights = [light for light in road_map.lights if light.id in lanelet.lights]
    if not turns:
        return [tuple(light.id for light in lights)], False
    return [tuple(x.id for x in lights if x.holds_for(turn)) for turn in sorted(turns)], bool(known)


_ALONG: Final = np.cos(np.deg2rad(45.0))


def _forbidden(part: DrivenPart, lights: Iterable[int], step: int) -> bool:
    """Whether lights forbid at a state of the part and at the next."""
    first, ids = part.start_step + step, tuple(lights)
    return all(part.signals.at(k).shown(ids).forbids for k in (first, first + 1))


def stop_lines_ignored(part: ScoredPart) -> int | None:
    """Counts the stop signs that the ego passes without having stood.

    The front passes the stop line of a lanelet with a stop sign, or its end where there is no line,
    and at no step before was the ego slower than ``STANDING`` with its front at most ``STOP_ZONE``
    before the line. Where traffic lights are lit at the lanelet, they go before the sign. A line
    that is nearer than that at the start of the drive is not judged: who knows what was before.

    Args:
        part: What is scored.

    Returns:
        The number; None where the map has no stop sign, or no step was driven.
    """
    road_map = part.scenario.road_map
    stop = {sign.id for sign in road_map.signs if sign.rule is SignRule.STOP}
    if not stop or not part.drove:
        return None
    front = _front(part)
    signed = (x for x in part.lanes.lanelets if stop.intersection(x.signs))
    # Where lanelets overlap, a line is passed once for each of them.
    ignored = (x.step for x in _crossings(front, signed) if _ignores_stop(part, front, x))
    return len(set(ignored))


def _ignores_stop(part: ScoredPart, front: FloatArray, crossing: _Crossing) -> bool:
    shown = part.signals.at(part.episode.start_step + crossing.step).shown(crossing.lanelet.lights)
    if shown is not LightColour.INACTIVE:
        return False
    before = slice(0, crossing.step + 1)
    line = shapely.LineString(crossing.line)
    near = shapely.distance(line, shapely.points(front[before])) <= STOP_ZONE
    stands = part.ego[before, USER_VELOCITY] < STANDING
    return not near[0] and not bool(np.any(near & stands))


def excess_speed(part: ScoredPart) -> FloatArray | None:
    """By how much the ego is faster than the speed limit.

    The limit is that of the lanelet on which the ego's centre is. A lanelet without one has the
    largest of those before and after it, if all of these have one, as nuPlan takes it for the
    lanes inside an intersection.

    Args:
        part: What is scored.

    Returns:
        (K + 1,) m/s, zero where the ego is not faster or there is no limit; None where there is
        none at any step, or no step was driven.
    """
    lanes = part.lanes
    own = {lanelet.id: lanelet for lanelet in part.scenario.road_map.lanelets}
    limits = np.array([_limit(lanelet, own) for lanelet in lanes.lanelets] + [np.inf])
    limit = limits[lanes.at]  # The last one where the ego is beside every lanelet.
    if not part.drove or not np.isfinite(limit).any():
        return None
    return np.asarray(np.maximum(np.abs(part.ego[:, USER_VELOCITY]) - limit, 0.0))


def _limit(lanelet: Lanelet, lanelets: dict[int, Lanelet]) -> float:
    if lanelet.speed_limit is not None:
        return lanelet.speed_limit
    beside = [
        lanelets[name].speed_limit
        for name in (*lanelet.predecessors, *lanelet.successors)
        if name in lanelets
    ]
    known = [limit for limit in beside if limit is not None]
    return max(known) if known and len(known) == len(beside) else np.inf


def time_over_limit(part: ScoredPart) -> float | None:
    """Share of the time in which the ego is faster than the limit by ``OVERSPEED`` or more.

    Args:
        part: What is scored.

    Returns:
        0 to 1; None where no limit is known.
    """
    excess = excess_speed(part)
    return None if excess is None else float(np.mean(excess >= OVERSPEED))


def mean_excess(part: ScoredPart) -> float | None:
    """Mean excess of the speed limit over the time in which it is exceeded.

    Args:
        part: What is scored.

    Returns:
        m/s; None where no limit is exceeded by ``OVERSPEED``.
    """
    excess = excess_speed(part)
    if excess is None or not np.any(excess >= OVERSPEED):
        return None
    return float(excess[excess >= OVERSPEED].mean())


def largest_excess(part: ScoredPart) -> float | None:
    """Largest excess of the speed limit.

    Args:
        part: What is scored.

    Returns:
        m/s, zero where no limit is exceeded; None where none is known.
    """
    excess = excess_speed(part)
    return None if excess is None else float(excess.max())


def wrong_way(part: ScoredPart) -> float | None:
    """Largest distance against the lane's direction within a second.

    As in nuPlan, a step counts with its way along the direction of the lane, back where it is
    against it, and with nothing beside all lanes; what is summed up at a step is its own way and
    that of the ``DIRECTION_SECONDS`` before it, eleven steps of 0.1 s. Unlike there, a step on
    which the ego enters another lane counts as well.

    Args:
        part: What is scored.

    Returns:
        m, zero where the ego never drives against it; None where no step was driven.
    """
    if not part.drove:
        return None
    moved = np.diff(part.ego[:, :2], axis=0)
    direction = part.lanes.direction[1:]
    along = moved[:, 0] * np.cos(direction) + moved[:, 1] * np.sin(direction)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(along))])
    window = round(DIRECTION_SECONDS / part.scenario.dt) + 1
    begin = np.maximum(np.arange(len(total)) - window, 0)
    return max(0.0, -float((total - total[begin]).min()))


def solid_lines(part: ScoredPart) -> int | None:
    """Counts how often the ego's centre crosses a line that must not be crossed.

    That is the left or right bound of the lanelet on which the ego is, where it leaves the lanelet
    over it; ``LineMarking.may_be_crossed`` tells which lines may be crossed and in which direction.

    Args:
        part: What is scored.

    Returns:
        The number; None where the file says of no lanelet what is painted, or no step was driven.
    """
    lanelets = part.scenario.road_map.lanelets
    said = any(not _UNPAINTED.issuperset({x.left_marking, x.right_marking}) for x in lanelets)
    if not said or not part.drove:
        return None
    return len(set(_solid_crossings(part)))


_UNPAINTED: Final = frozenset({LineMarking.UNKNOWN, LineMarking.NO_MARKING})


def _solid_crossings(part: ScoredPart) -> Iterator[int]:
    """Steps from which the ego crosses a solid line."""
    centres, lanes = part.ego[:, :2], part.lanes
    ways = shapely.linestrings(np.stack([centres[:-1], centres[1:]], axis=1))
    for index in np.unique(lanes.at[:-1][lanes.at[:-1] >= 0]):
        lanelet = lanes.lanelets[index]
        steps = np.flatnonzero(lanes.at[:-1] == index)
        for bound, marking, leftwards in (
            (lanelet.left, lanelet.left_marking, True),
            (lanelet.right, lanelet.right_marking, False),
        ):
            if not marking.may_be_crossed(leftwards):
                crossed = shapely.intersects(shapely.LineString(bound), ways[steps])
                # The later state tells a crossing from a drive that ends on the line.
                yield from steps[crossed & ~lanes.inside[steps + 1, index]].tolist()


def _front(part: DrivenPart) -> FloatArray:
    """(K + 1, 2) middle of the ego's front edge, m."""
    heading = part.ego[:, USER_HEADING]
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return part.ego[:, :2] + 0.5 * part.scenario.task.vehicle.length * forward


def _crossings(
    front: FloatArray, lanelets: Iterable[Lanelet], ends: bool = False
) -> Iterator[_Crossing]:
    """Where the front passes the stop lines of lanelets in their direction.

    Args:
        front: (K + 1, 2) where the front is, m.
        lanelets: The lanelets.
        ends: Whether the ends of the lanelets count instead of their stop lines.

    Yields:
        The crossings, by lanelet and step.
    """
    for lanelet in lanelets:
        if ends or lanelet.stop_line is None:
            line = np.array([lanelet.left[-1], lanelet.right[-1]])
        else:
            line = lanelet.stop_line.ends
        for step in _passes(front, line, lanelet.centre[-1] - lanelet.centre[-2]):
            yield _Crossing(lanelet, line, int(step))


def _passes(points: FloatArray, line: FloatArray, forward: FloatArray) -> IntArray:
    """Indices of the points after which the way to the next passes a line in a direction.

    A point on the line is before it.
    """
    across = np.array([line[1, 1] - line[0, 1], line[0, 0] - line[1, 0]])
    across = across if across @ forward >= 0.0 else -across
    beyond = (points - line[0]) @ across
    steps = np.flatnonzero((beyond[:-1] <= 0.0) & (beyond[1:] > 0.0))
    share = beyond[steps] / (beyond[steps] - beyond[steps + 1])
    met = points[steps] + share[:, None] * (points[steps + 1] - points[steps])
    side = line[1] - line[0]
    place = (met - line[0]) @ side / (side @ side)
    return np.asarray(steps[(place >= 0.0) & (place <= 1.0)])
