"""Off the drivable area: how far, which corner, and what the road is like there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from dosplan.geometry import ReferencePath, lanelet_polygon, rectangle_corners, to_body
from dosplan.results.drive import Drive
from dosplan.types import EGO_STEERING, EGO_VELOCITY, FloatArray, Route

BEND: Final = 0.01
"""Curvature of the reference path from which on it is called a bend, 1/m."""

_FINE: Final = 0.02
"""Distance of the points that are tried for the depth, m."""


@dataclass(frozen=True)
class RoadFacts:
    """The ego at the first step off the drivable area.

    Attributes:
        step: That step.
        seconds: Since the start, s.
        depth: How far its rectangle reaches beyond the drivable area, m.
        part: Which part of it reaches out farthest.
        corners_outside: How many of its corners are outside; where none is, it reaches over an
            inner edge, a notch or a gap of the road.
        worst_depth: The largest depth of the drive, m.
        worst_seconds: When that is, s.
        centre_outside: Whether even the rectangle's centre is off the area.
        lanelet: Id of the lanelet that its centre is on, or the nearest one.
        curvature: Of the reference path there, 1/m, left positive.
        velocity: m/s.
        lateral_acceleration: v^2 tan(steering) / wheelbase, m/s2, left positive.
        offset: Of its centre from the reference path, m, left positive.
        free_left: Lateral offset up to which the route gives free road there, m.
        free_right: The same to the right, negative.
    """

    step: int
    seconds: float
    depth: float
    part: str
    corners_outside: int
    worst_depth: float
    worst_seconds: float
    centre_outside: bool
    lanelet: int
    curvature: float
    velocity: float
    lateral_acceleration: float
    offset: float
    free_left: float
    free_right: float

    def lines(self) -> list[str]:
        """Where the ego left the road, in plain words."""
        bend = "on a straight"
        if abs(self.curvature) >= BEND:
            side = "left" if self.curvature > 0.0 else "right"
            bend = f"in a bend to the {side} (radius {1.0 / abs(self.curvature):.0f} m)"
        out = f"its {self.part} is {self.depth:.3f} m outside"
        if self.centre_outside:
            out += ", and so is its centre"
        if not self.corners_outside:
            out += ", but no corner is (an inner edge, a notch or a gap of the road)"
        at_start = " at the start already" if self.seconds == 0.0 else ""
        return [
            f"off the road{at_start}: {out}; at worst {self.worst_depth:.3f} m, "
            f"{self.worst_seconds:.1f} s after the start",
            f"lanelet {self.lanelet}, {bend}, at {self.velocity:.1f} m/s, lateral acceleration "
            f"{self.lateral_acceleration:+.1f} m/s2 (left positive)",
            f"its centre is {_aside(self.offset)} of the reference path, where the route gives "
            f"{self.free_left:.2f} m to the left and {-self.free_right:.2f} m to the right",
        ]


def road_facts(drive: Drive, step: int) -> RoadFacts:
    """Gathers what is known of the place where the ego left the road.

    Args:
        drive: A drive that left it.
        step: The row's first step off the drivable area.

    Returns:
        The facts.
    """
    area = _road_around(drive)
    depths, points = _depths(drive, area)
    first, worst = step - drive.start, int(np.argmax(depths))
    corners = rectangle_corners(drive.ego[first, :3], drive.vehicle.size)
    centre, state = shapely.Point(drive.ego[first, :2]), drive.states[first]
    curvature, offset, left, right = _beside(drive.scenario.task.route, drive.ego[first, :2])
    velocity = float(state[EGO_VELOCITY])
    turning = np.tan(state[EGO_STEERING]) / drive.vehicle.wheelbase
    return RoadFacts(
        step=step,
        seconds=drive.seconds(step),
        depth=float(depths[first]),
        part=_part(to_body(points[first, None], drive.ego[first, :3])[0], drive.vehicle.length),
        corners_outside=int(np.sum(~shapely.covers(area, shapely.points(corners)))),
        worst_depth=float(depths[worst]),
        worst_seconds=drive.seconds(drive.start + worst),
        centre_outside=not shapely.covers(area, centre),
        lanelet=min(
            drive.scenario.road_map.lanelets,
            key=lambda x: shapely.distance(lanelet_polygon(x.left, x.right), centre),
        ).id,
        curvature=curvature,
        velocity=velocity,
        lateral_acceleration=float(velocity**2 * turning),
        offset=offset,
        free_left=left,
        free_right=right,
    )


def _road_around(drive: Drive) -> shapely.Geometry:
    """Where a car is not off the road, as far as the ego came."""
    shapes = shapely.polygons(rectangle_corners(drive.ego[:, :3], drive.vehicle.size))
    box = shapely.box(*shapely.total_bounds(shapes)).buffer(max(drive.vehicle.size))
    return drive.scenario.road_map.road_within(*box.bounds)


def _depths(drive: Drive, road: shapely.Geometry) -> tuple[FloatArray, FloatArray]:
    """(K + 1,) depth, m, and (K + 1, 2) the farthest point of the rectangle's part outside."""
    shapes = shapely.polygons(rectangle_corners(drive.ego[:, :3], drive.vehicle.size))
    depths, points = np.zeros(len(shapes)), np.array(drive.ego[:, :2])
    for i, part in enumerate(shapely.difference(shapes, road)):
        if shapely.area(part) == 0.0:
            continue
        # Over a notch, the farthest point is on a side of the rectangle; over a gap, inside it.
        inner = shapely.get_coordinates(shapely.maximum_inscribed_circle(part, _FINE))[:1]
        tried = np.vstack([shapely.get_coordinates(shapely.segmentize(part, _FINE)), inner])
        distances = shapely.distance(shapely.points(tried), road)
        depths[i], points[i] = distances.max(), tried[distances.argmax()]
    return depths, points


def _part(point: FloatArray, length: float) -> str:
    """Which part of a rectangle a body-frame point belongs to."""
    side = "left" if point[1] >= 0.0 else "right"
    if abs(point[0]) < length / 4.0:
        return f"{side} side"
    return f"{'front' if point[0] > 0.0 else 'rear'} {side}"


def _beside(route: Route, place: FloatArray) -> tuple[float, float, float, float]:
    """Curvature, 1/m, offset of a place, m, and free road to the left and right, m."""
    index = int(np.argmin(np.abs(route.arclength - ReferencePath.of(route).locate(place))))
    heading = route.heading[index]
    aside = place - route.path[index]
    offset = float(np.cos(heading) * aside[1] - np.sin(heading) * aside[0])
    return (
        float(route.curvature[index]),
        offset,
        float(route.left[index]),
        float(route.right[index]),
    )


def _aside(offset: float) -> str:
    return f"{abs(offset):.2f} m to the {'left' if offset >= 0.0 else 'right'}"
