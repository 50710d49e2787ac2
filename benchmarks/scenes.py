"""Scenes whose planning cycle is timed: more and more road users, larger and larger maps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from shapely.affinity import translate
from shapely.ops import unary_union

from dosplan.scenario.synthetic import LANE_WIDTH, steady_tracks, straight_scenario
from dosplan.types import STEP_SECONDS, FloatArray, Lanelet, RoadMap, Scenario


def steady_flow(n: int) -> Scenario:
    """The ego amid the ``n`` nearest cars of thirteen lanes of traffic that flows at 7 to 10 m/s.

    More cars are cars further away: what grows is their number, not the tightness of the scene.
    """
    start_step = 40
    place, lane = (grid.ravel() for grid in np.meshgrid(np.arange(-12, 13), np.arange(-6, 7)))
    x, y = 25.0 * place + 7.0 * lane, LANE_WIDTH * lane
    nearest = np.argsort(np.hypot(x, y), kind="stable")[1 : n + 1]  # The first is the ego's own.
    velocity = 10.0 - 0.5 * np.abs(lane)
    x = x - start_step * STEP_SECONDS * velocity  # Tracks are given at step 0.
    first = np.column_stack([x, y, np.zeros_like(x), velocity])[nearest]
    return straight_scenario(steady_tracks(first), start_step=start_step, final_step=65)


def tiled(road_map: RoadMap, copies: int) -> RoadMap:
    """A map and its copies in a square, apart from each other; the first is where it was."""
    west, south, east, north = road_map.drivable.bounds
    highest = 1 + max(lanelet.id for lanelet in road_map.lanelets)
    side = math.isqrt(copies)
    lanelets: list[Lanelet] = []
    areas = []
    for copy_of in range(copies):
        shift = np.array([copy_of % side, copy_of // side]) * (east - west, north - south) * 1.1
        offset = highest * copy_of
        areas.append(translate(road_map.drivable, *shift))
        lanelets += [_moved(lanelet, shift, offset) for lanelet in road_map.lanelets]
    return RoadMap(tuple(lanelets), unary_union(areas))


def _moved(lanelet: Lanelet, shift: FloatArray, offset: int) -> Lanelet:
    """A lanelet elsewhere; its ids, and those it is linked to, are ``offset`` higher."""

    def linked(other: int | None) -> int | None:
        return None if other is None else other + offset

    return replace(
        lanelet,
        id=lanelet.id + offset,
        left=lanelet.left + shift,
        right=lanelet.right + shift,
        successors=tuple(i + offset for i in lanelet.successors),
        predecessors=tuple(i + offset for i in lanelet.predecessors),
        left_neighbour=linked(lanelet.left_neighbour),
        right_neighbour=linked(lanelet.right_neighbour),
    )
