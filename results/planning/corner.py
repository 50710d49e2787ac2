"""Whether the car fits through the sharpest corner of a scenario's route, traffic aside.

    python results/planning/corner.py FILE...

A search, generous to the car: it drives forward in steps of 0.4 m along arcs of any steering angle,
which may jump from step to step; speed and dynamics do not matter; it begins 12 m before the corner
at any of 9 offsets and 5 headings. A pose is kept where the whole rectangle is
on the drivable area, grown by the hairline that scoring overlooks, and the rear axle within 4 m
of the route; of the poses in a cell of 6 cm, 6 cm and 0.03 rad one is kept. Where no pose is left
before the route is 8 m past the corner, no way is found. That is no proof that there is none: the
cells do not bound the error, and with cells of 3 cm one corner opens that is closed with these.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import shapely

from dosplan.geometry import rectangle_corners
from dosplan.scenario import load_scenario
from dosplan.scoring.bounds import HAIRLINE
from dosplan.types import Scenario
from dosplan.vehicle import VehicleParameters

VEHICLE = VehicleParameters()
STEP, BEFORE, BEYOND, ASIDE = 0.4, 12.0, 8.0, 4.0  # m
CELL = np.array([0.06, 0.06, 0.03])
STEERING = np.linspace(-1.0, 1.0, 25) * VEHICLE.max_steering


def farthest(scenario: Scenario) -> tuple[float, float]:
    """Arc lengths of the corner and of the farthest pose on the road, m."""
    route, road = scenario.task.route, scenario.road_map.drivable.buffer(HAIRLINE)
    shapely.prepare(road)
    line = shapely.LineString(route.path)
    started = line.project(shapely.Point(scenario.task.start[:2]))
    ahead = route.arclength > started + BEFORE
    corner = float(route.arclength[ahead][np.argmax(np.abs(route.curvature[ahead]))])
    begin = int(np.searchsorted(route.arclength, corner - BEFORE))
    heading = route.heading[begin]
    normal = np.array([-np.sin(heading), np.cos(heading)])
    poses = np.array(
        [
            [*(route.path[begin] + offset * normal), heading + turn]
            for offset in np.linspace(-0.5, 0.5, 9)
            for turn in np.linspace(-0.2, 0.2, 5)
        ]
    )
    curvature, reached = np.tan(STEERING) / VEHICLE.wheelbase, corner - BEFORE
    for _ in range(int(2.0 * (BEFORE + BEYOND) / STEP)):
        bend = np.tile(curvature, len(poses))
        moved = np.repeat(poses, len(curvature), axis=0)
        middle = moved[:, 2] + 0.5 * STEP * bend
        moved += STEP * np.column_stack([np.cos(middle), np.sin(middle), bend])
        moved = moved[shapely.dwithin(line, shapely.points(moved[:, :2]), ASIDE)]
        axis = np.column_stack([np.cos(moved[:, 2]), np.sin(moved[:, 2])])
        rectangles = np.column_stack([moved[:, :2] + VEHICLE.rear_to_centre * axis, moved[:, 2]])
        moved = moved[
            shapely.covers(road, shapely.polygons(rectangle_corners(rectangles, VEHICLE.size)))
        ]
        if not len(moved):
            break
        poses = moved[np.unique(np.round(moved / CELL), axis=0, return_index=True)[1]]
        reached = max(
            reached, float(shapely.line_locate_point(line, shapely.points(poses[:, :2])).max())
        )
        if reached > corner + BEYOND:
            break
    return corner, reached


if __name__ == "__main__":
    for name in sys.argv[1:]:
        at, end = farthest(load_scenario(Path(name)))
        verdict = "passes" if end > at + BEYOND else "no way found"
        print(
            f"{Path(name).stem}: corner at {at:.1f} m, reached {end:.1f} m: {verdict}", flush=True
        )
