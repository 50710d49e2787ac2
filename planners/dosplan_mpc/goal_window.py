"""Where along the reference path a goal's region lies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import PATH_HEADING, PATH_X, PATH_Y, EvenPath, wrap_angle
from dosplan.types import BoolArray, FloatArray, GoalState, IntArray
from dosplan_mpc.config import GoalSettings

Interval = tuple[float, float]
_FINER: Final = 5  # How many times finer a region is looked for that was not found.


@dataclass(frozen=True)
class GoalWindow:
    """A goal in the path's coordinates, for the ego's centre.

    Attributes:
        first_step: First step at which it counts.
        last_step: Last step at which it counts.
        begin: Arc length at which the region begins, m.
        end: Arc length at which it ends, m.
        offset: Lateral offset to drive at there, m.
        right: Right edge of the region beside the path, m.
        left: Left edge, m.
        heading: Heading window on the path's turn, rad, or None.
        velocity: Velocity window, m/s, or None.
        turn: Angle from the path's heading to that window, rad; zero where it is (nearly) inside.
    """

    first_step: int
    last_step: int
    begin: float
    end: float
    offset: float
    right: float
    left: float
    heading: Interval | None
    velocity: Interval | None
    turn: float = 0.0


def locate_goal(
    goal: GoalState, path: EvenPath, settings: GoalSettings, farthest: float = np.inf
) -> GoalWindow | str | None:
    """Finds a goal along the path.

    Args:
        goal: The goal.
        path: Reference path.
        settings: Settings of the search.
        farthest: Arc length up to which the ego's centre may go, m.

    Returns:
        Its window; why there is none, in a few words; None for a goal without a region.
    """
    if goal.region is None:
        return None
    # A region that is smaller than the spacing of the search lies between its places.
    fine = replace(
        settings,
        spacing=settings.spacing / _FINER,
        lateral_spacing=settings.lateral_spacing / _FINER,
        edge_margin=0.0,
    )
    for search, turn in product((settings, fine), (settings.turn, settings.widest_turn)):
        window = _locate(goal, goal.region, path, search, turn)
        if window is not None:
            return replace(window, end=max(min(window.end, farthest), window.begin))
    return _why_not(goal, goal.region, path, settings)


def _why_not(
    goal: GoalState, region: shapely.Geometry, path: EvenPath, settings: GoalSettings
) -> str:
    """Why a goal has no window: its heading, where the ego could go there, or else its place."""
    away = float(shapely.distance(shapely.LineString(path.points), region))
    if goal.heading is not None and away <= settings.lateral_reach:
        along = path.locate(np.array(region.centroid.coords[0]))
        low, high = goal.heading
        turned = abs(float(wrap_angle(path.heading_at(along) - 0.5 * (low + high))))
        off = turned - 0.5 * (high - low)
        if off > settings.widest_turn:
            return f"its heading is {np.rad2deg(off):.0f} degrees off the route's"
    return f"its region is {away:.1f} m beside the route"


def _locate(
    goal: GoalState,
    area: shapely.Geometry,
    path: EvenPath,
    settings: GoalSettings,
    turn: float,
) -> GoalWindow | None:
    """The window of one goal: a grid of arc lengths and lateral offsets is searched for it."""
    arclength = np.arange(0.0, path.length, settings.spacing)
    reach, spacing = settings.lateral_reach, settings.lateral_spacing
    offsets = np.arange(-reach, reach + 0.5 * spacing, spacing)
    region = area.buffer(-settings.edge_margin)
    if region.is_empty:
        region = area
    rows = path.at(arclength)
    near = _near(goal, region, rows, float(offsets[-1]), turn)
    arclength, rows = arclength[near], rows[near]
    inside = _inside(region, rows, offsets)
    touched = np.any(inside, axis=1)
    if not touched.any():
        return None
    first, last = _first_stretch(touched, np.flatnonzero(near))
    low, high = _common_offsets(inside[first : last + 1], offsets, settings.common_share)
    right, left = float(offsets[low]), float(offsets[high])
    offset = _nearest_offset(right, left, settings.lateral_margin)
    column = int(np.argmin(np.abs(offsets - offset)))
    along = first + np.flatnonzero(inside[first : last + 1, column])
    begin, end = along[0], along[-1]
    heading = _on_turn_of(rows[begin, PATH_HEADING], goal.heading)
    aside = 0.0 if heading is None else _turn_to(rows[begin : end + 1, PATH_HEADING], heading)
    return GoalWindow(
        first_step=goal.first_step,
        last_step=goal.last_step,
        begin=float(arclength[begin]),
        end=float(arclength[end]),
        offset=offset,
        right=right,
        left=left,
        heading=heading,
        velocity=goal.velocity,
        turn=aside if abs(aside) > settings.least_turn else 0.0,
    )


def _near(
    goal: GoalState, region: shapely.Geometry, rows: FloatArray, reach: float, turn: float
) -> BoolArray:
    """(S,) whether rows of the path are near the region and head about as the goal asks."""
    near: BoolArray = shapely.dwithin(region, shapely.points(rows[:, :2]), reach)
    if goal.heading is not None:
        middle = 0.5 * (goal.heading[0] + goal.heading[1])
        half = 0.5 * (goal.heading[1] - goal.heading[0])
        near = near & (np.abs(wrap_angle(rows[:, PATH_HEADING] - middle)) <= half + turn)
    return near


def _inside(region: shapely.Geometry, rows: FloatArray, offsets: FloatArray) -> BoolArray:
    """(S, O) whether the region holds the points beside rows of the path."""
    x = rows[:, PATH_X, None] - np.sin(rows[:, PATH_HEADING, None]) * offsets
    y = rows[:, PATH_Y, None] + np.cos(rows[:, PATH_HEADING, None]) * offsets
    inside: BoolArray = shapely.contains_xy(region, x, y)
    return inside


def _first_stretch(touched: BoolArray, place: IntArray) -> tuple[int, int]:
    """First and last index of the first run of true values at places that follow each other."""
    first = int(np.argmax(touched))
    goes_on = touched[first + 1 :] & (np.diff(place[first:]) == 1)
    more = len(goes_on) if goes_on.all() else int(np.argmin(goes_on))
    return first, first + more


def _common_offsets(inside: BoolArray, offsets: FloatArray, share: float) -> tuple[int, int]:
    """First and last index of the offsets around the path that are inside nearly all along.

    They are taken from the middle half of the stretch: a region's corners are narrow.
    """
    quarter = (len(inside) - 1) // 4
    held = inside[quarter : len(inside) - quarter].mean(axis=0)
    common = held >= share * held.max()
    low = high = int(np.argmin(np.where(common, np.abs(offsets), np.inf)))
    while low > 0 and common[low - 1]:
        low -= 1
    while high < len(offsets) - 1 and common[high + 1]:
        high += 1
    return low, high


def _nearest_offset(right: float, left: float, margin: float) -> float:
    """The lateral offset next to the path that keeps its distance from both edges."""
    middle = 0.5 * (right + left)
    return float(np.clip(0.0, min(right + margin, middle), max(left - margin, middle)))


def _on_turn_of(path_heading: float, window: Interval | None) -> Interval | None:
    """A heading window, rad, shifted by full turns to be near the path's heading."""
    if window is None:
        return None
    middle = path_heading - float(wrap_angle(path_heading - 0.5 * sum(window)))
    half = 0.5 * (window[1] - window[0])
    return middle - half, middle + half


def _turn_to(path_heading: FloatArray, window: Interval) -> float:
    """The smallest turn from some headings of the path, rad, into a window."""
    turns = np.clip(path_heading, *window) - path_heading
    return float(turns[np.argmin(np.abs(turns))])
