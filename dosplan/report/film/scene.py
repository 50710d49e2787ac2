"""Draws a scene from above: map, road users, the ego and its task; import it only to draw."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline
from shapely.geometry import MultiPolygon, Polygon

from dosplan.geometry import lanelets_off_road
from dosplan.report.film.layers import Bodies, Lamps, Users, on_scene
from dosplan.report.film.paint import draw_paint, paint_keys
from dosplan.report.palette import (
    EGO_COLOUR,
    GOAL_COLOUR,
    INK,
    KERB,
    KIND_COLOURS,
    OFF_ROAD,
    ROAD,
)
from dosplan.report.road_paint import lamps, plates
from dosplan.types import FloatArray, GoalState, Scenario

_OFF_ROAD: Final[Mapping[str, Any]] = MappingProxyType(
    {"facecolor": OFF_ROAD[0], "edgecolor": OFF_ROAD[1], "hatch": "////", "linewidth": 0.5}
)
"""How lanelets are drawn that are no road for a car."""
_MARGIN = 30.0
_TRAIL = 10  # Steps, a second.
_BAR = 20.0


def draw_scene(axes: Axes, scenario: Scenario, step: int) -> None:
    """Draws a scene at a step, with the ego at its start.

    The view shows the ego's start and its goal; set the axes' limits afterwards for another one.

    Args:
        axes: Where to draw; their limits, ticks and aspect are set.
        scenario: The scene.
        step: Step of the recording at which road users and lights are shown, the road users
            trailing the second before.
    """
    draw_map(axes, scenario)
    draw_task(axes, scenario)
    _draw_trails(axes, scenario, step)
    Users(axes, scenario.tracks, KIND_COLOURS, zorder=6).show_step(step)
    _draw_ego(axes, scenario)
    Lamps(axes, lamps(scenario.road_map, scenario.signals), zorder=8).show_step(step)
    _set_view(axes, scenario)


def legend_handles(*scenarios: Scenario) -> list[Any]:
    """Keys for a legend, to be drawn with ``paint.LAMP_HANDLER``.

    Args:
        scenarios: What is drawn.

    Returns:
        The ego, the goal, lanelets that are no road for a car, lights and speed limits where
        there are any, and every kind of road user that occurs, in a fixed order.
    """
    present = {kind for scenario in scenarios for kind in scenario.tracks.kinds}
    return [
        Patch(facecolor=EGO_COLOUR, edgecolor=INK, label="ego"),
        Patch(facecolor=GOAL_COLOUR, alpha=0.35, label="goal"),
        *off_road_key(*scenarios),
        *paint_keys(
            [lamp for one in scenarios for lamp in lamps(one.road_map, one.signals)],
            [plate for one in scenarios for plate in plates(one.road_map)],
        ),
        *(
            Patch(facecolor=colour, edgecolor=INK, label=kind.value)
            for kind, colour in KIND_COLOURS.items()
            if kind in present
        ),
    ]


def off_road_key(*scenarios: Scenario) -> list[Patch]:
    """Key for a legend of the lanelets that are no road for a car.

    Args:
        scenarios: What is drawn.

    Returns:
        One key where there are such lanelets, none elsewhere.
    """
    there = any(not lanelets_off_road(scenario.road_map).is_empty for scenario in scenarios)
    return [Patch(**_OFF_ROAD, label="no road for cars")] if there else []


def _patch(area: Polygon | MultiPolygon) -> Outline:
    """The outline of an area; its holes turn against it, or they would be filled."""
    rings = [
        np.asarray(ring.coords)
        for polygon in shapely.get_parts(shapely.orient_polygons(area))
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    return Outline.make_compound_path(*(Outline(ring, closed=True) for ring in rings))


def draw_map(axes: Axes, scenario: Scenario) -> None:
    """Draws the road, what is painted on it, and signs; hatched, what is no road for a car.

    Args:
        axes: Where to draw.
        scenario: The scene.
    """
    road_map = scenario.road_map
    off_road = lanelets_off_road(road_map)
    if not off_road.is_empty:
        axes.add_patch(PathPatch(_patch(off_road), **_OFF_ROAD, zorder=1))
    road = _patch(road_map.drivable)
    axes.add_patch(PathPatch(road, facecolor=ROAD, edgecolor="none", zorder=1))
    axes.add_patch(PathPatch(road, facecolor="none", edgecolor=KERB, linewidth=0.8, zorder=2))
    draw_paint(axes, road_map, zorder=2)


def draw_task(axes: Axes, scenario: Scenario) -> None:
    """Draws the way to the goal, and the goal.

    Args:
        axes: Where to draw.
        scenario: The scene.
    """
    task = scenario.task
    axes.plot(*task.route.path.T, color=GOAL_COLOUR, linewidth=1.2, alpha=0.6, zorder=3)
    for region in filter(None, (goal.region for goal in task.goals)):
        axes.add_patch(
            PathPatch(
                _patch(region), facecolor=GOAL_COLOUR, edgecolor=GOAL_COLOUR, alpha=0.35, zorder=3
            )
        )


def _draw_trails(axes: Axes, scenario: Scenario, step: int) -> None:
    tracks = scenario.tracks
    users, begin = on_scene(tracks, step), max(0, step - _TRAIL)
    trails = [tracks.states[u, begin : step + 1][tracks.valid[u, begin : step + 1]] for u in users]
    colours = [KIND_COLOURS[tracks.kinds[u]] for u in users]
    lines = [states[:, :2] for states in trails]
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=1.0, alpha=0.5, zorder=5))


def _draw_ego(axes: Axes, scenario: Scenario) -> None:
    vehicle = scenario.task.vehicle
    poses = vehicle.poses(scenario.task.start[None])
    Bodies(axes, zorder=8, line=0.6).show(poses, np.array([vehicle.size]), [EGO_COLOUR])


def _set_view(axes: Axes, scenario: Scenario) -> None:
    task = scenario.task
    points = [task.vehicle.centre(task.start)[None], *map(_corners, task.goals)]
    low, high = np.min(np.vstack(points), axis=0), np.max(np.vstack(points), axis=0)
    middle, reach = 0.5 * (low + high), 0.5 * float(np.max(high - low)) + _MARGIN
    left, bottom = middle - reach
    axes.set_xlim(left, left + 2.0 * reach)
    axes.set_ylim(bottom, bottom + 2.0 * reach)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    start, level = left + 0.04 * reach, bottom + 0.05 * reach
    axes.plot([start, start + _BAR], [level, level], color=INK, linewidth=1.5, zorder=9)
    axes.text(
        start + 0.5 * _BAR,
        level,
        f"{_BAR:.0f} m",
        ha="center",
        va="bottom",
        size=7,
        zorder=9,
        clip_on=True,
    )


def _corners(goal: GoalState) -> FloatArray:
    """(V, 2) corners of the box around a goal's region, m; none where it has no region."""
    if goal.region is None:
        return np.zeros((0, 2))
    return np.reshape(goal.region.bounds, (2, 2))
