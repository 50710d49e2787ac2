"""The free road beside a path: drivable, less the lanes of oncoming traffic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
import shapely
from scipy.spatial import cKDTree

from dosplan.geometry import areas, cross, lanelet_cells
from dosplan.types import BoolArray, FloatArray, IntArray, Lanelet, RoadMap

AGAINST: Final = np.cos(np.deg2rad(100.0))
"""Cosine of the angle to the path from which on a lane runs against it."""
OFF_ROAD: Final = 1.75
"""Width to each side that is given where the path itself is off the road, m."""


@dataclass(frozen=True)
class Corridor:
    """The free area around a path.

    Attributes:
        free: Drivable area near the path, less what lies on lanelets against it only, m.
        edges: (S, 2, 2) the segments of the area's boundary, m.
        tree: Index of ``edges``.
    """

    WIDTH: ClassVar[float] = 12.0
    """Largest lateral bound, m."""

    free: shapely.Polygon | shapely.MultiPolygon
    edges: FloatArray
    tree: shapely.STRtree

    @classmethod
    def along(
        cls, path: FloatArray, road_map: RoadMap, near: list[int], always: frozenset[int]
    ) -> Self:
        """The corridor of a path.

        Args:
            path: (P, 2) path, m, driven from first to last.
            road_map: The map.
            near: Lanelets within reach of the path.
            always: Lanelets that may be driven whatever their direction: those of the route and
                those that are open both ways.

        Returns:
            The corridor.
        """
        free = cls.of_area(path, road_map).free
        with_path, against_path = _cells(road_map, path, near, always)
        if len(against_path):
            against = shapely.union_all(against_path)
            beside = with_path[shapely.intersects(with_path, against)]
            free = areas(free.difference(against.difference(shapely.union_all(beside))))
        return cls._with_edges(free)

    @classmethod
    def of_area(cls, path: FloatArray, road_map: RoadMap) -> Self:
        """All of the drivable area near a path, lanes against it included.

        Args:
            path: (P, 2) path, m.
            road_map: The map.

        Returns:
            The area as a corridor.
        """
        low, high = path.min(axis=0) - 1.5 * cls.WIDTH, path.max(axis=0) + 1.5 * cls.WIDTH
        return cls._with_edges(areas(shapely.clip_by_rect(road_map.drivable, *low, *high)))

    @classmethod
    def _with_edges(cls, free: shapely.Polygon | shapely.MultiPolygon) -> Self:
        rings = shapely.get_rings(shapely.get_parts(free))
        points, ring = shapely.get_coordinates(rings, return_index=True)
        same = ring[1:] == ring[:-1]
        edges = np.stack([points[:-1][same], points[1:][same]], axis=1)
        return cls(free, edges, shapely.STRtree(shapely.linestrings(edges)))

    def clearance(self, points: FloatArray) -> FloatArray:
        """Distance of points to the corridor's edge.

        Args:
            points: (P, 2) m.

        Returns:
            (P,) m; negative outside.
        """
        distance = np.full(len(points), np.inf)
        (asked, _), found = self.tree.query_nearest(
            shapely.points(points), return_distance=True, all_matches=False
        )
        distance[asked] = found
        return np.where(self._inside(points), distance, -distance)

    def bounds(self, path: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lateral offsets at which the normals of the path first leave the corridor.

        Each normal is intersected with the segments of the corridor's boundary; a corner of the
        boundary that lies between two normals bounds the one it is nearest to.

        Args:
            path: (P, 2) m.
            heading: (P,) rad.

        Returns:
            (P,) to the left, >= 0, and (P,) to the right, <= 0, m, at most ``WIDTH`` away;
            ``OFF_ROAD`` where the path is not in the corridor.
        """
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        inside = self._inside(path)
        point, across = self._corners(path, normal)
        left, right = (self._first_hit(path, side * self.WIDTH * normal) for side in (1.0, -1.0))
        for side, bound in ((1.0, left), (-1.0, right)):
            there = side * across >= 0.0
            np.minimum.at(bound, point[there], side * across[there])
        return np.where(inside, left, OFF_ROAD), -np.where(inside, right, OFF_ROAD)

    def _corners(self, path: FloatArray, normal: FloatArray) -> tuple[IntArray, FloatArray]:
        """The boundary's corners beside the path: nearest point of it and offset there, m."""
        corners = self.edges[:, 0]
        distance, point = cKDTree(path).query(corners, distance_upper_bound=self.WIDTH)
        near = np.isfinite(distance)
        corners, point = corners[near], point[near]
        away = corners - path[point]
        across = np.sum(away * normal[point], axis=1)
        # A corner that is nearest to an end of the path may lie beyond it.
        spacing = np.hypot(*np.diff(path, axis=0).T).max()
        beside = np.abs(cross(normal[point], away)) <= spacing
        return point[beside], across[beside]

    def _inside(self, points: FloatArray) -> BoolArray:
        shapely.prepare(self.free)
        return np.asarray(shapely.contains_xy(self.free, points))

    def _first_hit(self, origins: FloatArray, rays: FloatArray) -> FloatArray:
        """Distance, m, along each ray to the first edge, ``WIDTH`` where it meets none."""
        lines = shapely.linestrings(np.stack([origins, origins + rays], axis=1))
        ray, edge = self.tree.query(lines)
        start = self.edges[edge, 0] - origins[ray]
        along = self.edges[edge, 1] - self.edges[edge, 0]
        across = cross(rays[ray], along)
        with np.errstate(divide="ignore", invalid="ignore"):
            on_ray = cross(start, along) / across
            on_edge = cross(start, rays[ray]) / across
        slack = 1e-9
        hit = (on_edge >= -slack) & (on_edge <= 1.0 + slack) & (on_ray >= 0.0) & (on_ray <= 1.0)
        share = np.ones(len(origins))
        np.minimum.at(share, ray[hit], on_ray[hit])
        return share * self.WIDTH


def _cells(
    road_map: RoadMap, path: FloatArray, near: list[int], always: frozenset[int]
) -> tuple[FloatArray, FloatArray]:
    """Cells of the lanelets near the path, as polygons: those along it and those against it.

    A cell is compared with the path's direction at the point nearest to it, so that a bending lane
    is against the path only where its direction is.
    """
    chosen = [lanelet for lanelet in road_map.lanelets if lanelet.id in set(near)]
    if not chosen:
        return np.empty(0), np.empty(0)
    corners = np.concatenate([lanelet_cells(x.left, x.right) for x in chosen])
    direction = np.concatenate([np.diff(lanelet.centre, axis=0) for lanelet in chosen])
    exempt = np.concatenate([_repeat(lanelet, always) for lanelet in chosen])
    nearest = cKDTree(path[:-1]).query(corners.mean(axis=1))[1]
    step = np.diff(path, axis=0)[nearest]
    product = np.sum(step * direction, axis=1)
    scale = np.hypot(*step.T) * np.hypot(*direction.T)
    against = (product < AGAINST * scale) & ~exempt
    cells = shapely.polygons(corners)
    cells = np.where(shapely.is_valid(cells), cells, shapely.convex_hull(cells))
    return cells[~against], cells[against]


def _repeat(lanelet: Lanelet, always: frozenset[int]) -> BoolArray:
    return np.full(len(lanelet.left) - 1, lanelet.id in always)
