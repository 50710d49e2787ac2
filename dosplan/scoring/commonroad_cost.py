"""CommonRoad's cost functions of a drive that solves its problem.

A cost function is a weighted sum of partial costs, most of them an integral over the drive.
Source: "CommonRoad: Cost Functions", version 2020a; figures on the CommonRoad website are computed
by commonroad-drivability-checker (``commonroad_dc.costs``), whose numerical choices are made here
too where the definition leaves them open: differences of the driven states for derivatives,
Simpson's rule for integrals. The partial costs, integrals being over the drive of duration T:

    T      T                            ID     1 / T
    A      integral of a^2              L      integral of v
    J      integral of (da / dt)^2      Jlon   the same
    Jlat   integral of (d(v * yaw rate) / dt)^2
    SA     integral of delta^2          SR     integral of (d delta / dt)^2
    V      integral of (v - v_goal)^2   Vlon   the same
    LC     integral of d^2              O      integral of (heading - direction of the lane)^2
    D      integral of exp(-0.2 (gap - r)), greatest over those ahead

with acceleration a, steering angle delta, the offset d of the ego's centre from that of the lane,
the lowest velocity v_goal that a goal asks for (no cost where none does), the distance gap along
the route between the centres, and the ego's width over 2.5 as r.

What differs from that checker:

- The inverse duration (MW1) is 1 / duration; there it is 10 for any drive, ``min`` being taken
  where ``max`` is meant.
- The lateral jerk (MW1) is the derivative of velocity times yaw rate; there it is the first
  derivative of the lateral position. The longitudinal jerk (MW1, TR1) is that of the velocity;
  there it is the third derivative of a smoothed position.
- The longitudinal velocity offset (MW1) is the velocity offset; there it is always zero.
- Lanes are the lanelets on which the ego's centre is, and distances to those ahead are along the
  route's path; there a sequence of lanelets is matched to the drive.

TR2, which that checker does not compute either, and the partial costs that no function below uses
(energy, yaw rate, terminal offsets) are left out. Nothing that these functions need is missing from
a recorded drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import ReferencePath, wrap_angle
from dosplan.scoring.part import ScoredPart
from dosplan.types import (
    EGO_HEADING,
    EGO_STEERING,
    EGO_VELOCITY,
    USER_HEADING,
    FloatArray,
    Outcome,
)

COST_FUNCTIONS: Final[Mapping[str, Mapping[str, float]]] = {
    "JB1": {"T": 1.0},
    "MW1": {"Jlat": 5.0, "Jlon": 0.5, "Vlon": 0.2, "ID": 1.0},
    "SA1": {"SA": 0.1, "SR": 0.1, "D": 100000.0},
    "SM1": {"A": 50.0, "SA": 50.0, "SR": 50.0, "L": 1.0, "V": 20.0, "O": 50.0},
    "SM2": {"A": 50.0, "SA": 50.0, "SR": 50.0, "L": 1.0, "O": 50.0},
    "SM3": {"A": 50.0, "SA": 50.0, "SR": 50.0, "V": 20.0, "O": 50.0},
    "TR1": {"Jlon": 0.01, "SR": 22.0, "D": 8.0, "LC": 0.5},
    "WX1": {"T": 10.0, "V": 1.0, "A": 0.1, "J": 0.1, "D": 0.1, "L": 10.0},
}
"""Weights of the partial costs in each cost function."""

NEARNESS: Final = 0.2
"""How fast the cost of a distance to somebody ahead falls with the distance, 1/m."""

BESIDE: Final = 2.8
"""Lateral distance of centres up to which somebody is ahead of the ego, m."""

_FEWEST: Final = 4
"""States from which on every derivative has a value."""


def commonroad_cost(part: ScoredPart, name: str) -> float | None:
    """A cost function of CommonRoad.

    Args:
        part: What is scored.
        name: Name of the cost function.

    Returns:
        The cost; None where the drive solves no problem, or has fewer than four states.
    """
    if part.outcome is not Outcome.SUCCESS or len(part.states) < _FEWEST:
        return None
    weights = COST_FUNCTIONS[name]
    return float(sum(weight * partial_cost(part, term) for term, weight in weights.items()))


def partial_cost(part: ScoredPart, term: str) -> float:
    """A partial cost.

    Args:
        part: What is scored.
        term: ``A`` acceleration, ``D`` distance to those ahead, ``ID`` inverse duration, ``J``,
            ``Jlat`` and ``Jlon`` jerk, ``L`` length of the way, ``LC`` offset from the centre of
            the lane, ``O`` from its direction, ``SA`` steering angle, ``SR`` steering rate, ``T``
            duration, ``V`` and ``Vlon`` offset from the velocity that the goal asks for.

    Returns:
        The cost in powers of m, s and rad.
    """
    return float(_TERMS[term](part))


def _duration(part: ScoredPart) -> float:
    return (len(part.states) - 1) * part.scenario.dt


def _integral(values: FloatArray, dt: float) -> float:
    from scipy.integrate import simpson  # Not paid by a process that only lists or compares.

    return float(simpson(values, dx=dt))


def _squared(values: FloatArray, part: ScoredPart) -> float:
    return _integral(np.square(values), part.scenario.dt)


def _rate(values: FloatArray, part: ScoredPart, times: int = 1) -> FloatArray:
    return np.asarray(np.diff(values, times) / part.scenario.dt**times)


def _lateral_jerk(part: ScoredPart) -> float:
    velocity = part.states[:, EGO_VELOCITY]
    yaw_rate = _rate(np.unwrap(part.states[:, EGO_HEADING]), part)
    lateral = 0.5 * (velocity[1:] + velocity[:-1]) * yaw_rate
    return _squared(_rate(lateral, part), part)


def _jerk(part: ScoredPart) -> float:
    return _squared(_rate(part.states[:, EGO_VELOCITY], part, 2), part)


def _velocity_offset(part: ScoredPart) -> float:
    """From the lowest velocity of the goals; zero where they name none, or an interval from 0 on.

    Such an interval is a limit and no velocity that is wanted.
    """
    wanted = [goal.velocity[0] for goal in part.scenario.task.goals if goal.velocity is not None]
    lowest = min(wanted, default=0.0)
    return _squared(part.states[:, EGO_VELOCITY] - lowest, part) if lowest else 0.0


def _direction_offset(part: ScoredPart) -> float:
    """From the direction of the lane; beside every lane there is none."""
    off = wrap_angle(part.ego[:, USER_HEADING] - part.lanes.direction)
    return _squared(np.nan_to_num(off), part)


def _nearness(part: ScoredPart) -> float:
    """Of the nearest road user ahead, by the distance of the centres less the ego's radius."""
    task, tracks, first = part.scenario.task, part.tracks, part.episode.start_step
    route, count = task.route, min(len(part.ego), max(tracks.steps - first, 0))
    path = ReferencePath(
        route.arclength, route.path, route.heading, route.curvature, thinning=_THINNING
    )
    own = path.follow(part.ego[:, :2])
    aside = path.offset(part.ego[:, :2], own)
    window = slice(first, first + count)
    states = tracks.states[:, window, :2]
    away = np.abs(states - part.ego[:count, :2]).max(axis=-1)
    # Who is farther from the way that lies before the ego than that, is beside it.
    begin, end = np.searchsorted(route.arclength, [own.min(), own.max() + _FARTHEST])
    way = shapely.LineString(route.path[max(begin - 1, 0) : end + 2]).simplify(_THINNING)
    shapely.prepare(way)
    user, step = np.nonzero(tracks.valid[:, window] & (away < _FARTHEST))
    beside = shapely.dwithin(
        way, shapely.points(states[user, step]), BESIDE + float(np.abs(aside).max())
    )
    user, step = user[beside], step[beside]
    there = path.locate(states[user, step], own[step])
    ahead = there - own[step]
    counts = (ahead > 0.0) & (np.abs(path.offset(states[user, step], there) - aside[step]) < BESIDE)
    cost = np.zeros(len(part.ego))
    radius = task.vehicle.width / 2.5
    np.maximum.at(cost, step[counts], np.exp(-NEARNESS * (ahead[counts] - radius)))
    return _integral(cost, part.scenario.dt)


_FARTHEST: Final = 100.0
_THINNING: Final = 0.02  # m

_TERMS: Final[Mapping[str, Callable[[ScoredPart], float]]] = {
    "A": lambda part: _squared(_rate(part.states[:, EGO_VELOCITY], part), part),
    "D": _nearness,
    "ID": lambda part: 1.0 / _duration(part),
    "J": _jerk,
    "Jlat": _lateral_jerk,
    "Jlon": _jerk,
    "L": lambda part: _integral(part.states[:, EGO_VELOCITY], part.scenario.dt),
    "LC": lambda part: _squared(np.nan_to_num(part.lanes.centre_offset), part),
    "O": _direction_offset,
    "SA": lambda part: _squared(part.states[:, EGO_STEERING], part),
    "SR": lambda part: _squared(_rate(part.states[:, EGO_STEERING], part), part),
    "T": _duration,
    "V": _velocity_offset,
    "Vlon": _velocity_offset,
}
