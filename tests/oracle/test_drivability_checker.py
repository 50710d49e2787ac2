"""Step by step beside commonroad-drivability-checker, on recorded scenes with bad drivers.

Every ego follows its route: at constant speed, braking, or swerving to either side, so that it
runs into traffic and off the road. Where the two disagree, the reason must be one of the
tolerances that are stated in ``dosplan.scoring.collision``, ``dosplan.scoring.bounds`` and
the map's closed seams, which shapely confirms without either of them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import shapely

from dosplan.geometry import rectangle_corners
from dosplan.scenario import ScenarioError, load_scenario
from dosplan.scoring.bounds import HAIRLINE, outside, outside_lanelets
from dosplan.scoring.collision import TOUCH, first_contacts, shape_at
from dosplan.types import FloatArray, Scenario
from dosplan.vehicle import VehicleParameters
from tests.oracle.real_data import commonroad_root
from tests.support.shares import every_other

VEHICLE = VehicleParameters()
SIZE = np.array(VEHICLE.size)
SCENARIOS = 30
PARTS = 3  # Which may be driven side by side.
SEAM = 0.2
"""Gaps between lanelets up to this wide count as road, m."""


def drives(scenario: Scenario) -> Iterator[FloatArray]:
    """(K + 1, 4) states of the ego's centre along the route, in four manners."""
    task, route = scenario.task, scenario.task.route
    t = scenario.dt * np.arange(min(task.final_step - task.start_step, 60) + 1)
    centre = VEHICLE.centre(task.start)
    begin = shapely.LineString(route.path).project(shapely.Point(centre))
    speed = max(task.start[3], 5.0)
    for braking, swerve in ((0.0, 0.0), (4.0, 0.0), (0.0, 5.0), (0.0, -5.0)):
        stop = min(speed / braking, np.inf) if braking else np.inf
        driven = np.minimum(t, stop)
        s = np.minimum(begin + speed * driven - 0.5 * braking * driven**2, route.arclength[-1])
        x, y = (np.interp(s, route.arclength, route.path[:, i]) for i in (0, 1))
        heading = np.interp(s, route.arclength, route.heading)
        aside = swerve * np.sin(0.3 * np.pi * t) ** 2
        turn = np.arctan2(np.gradient(aside, scenario.dt), speed) if swerve else 0.0 * t
        yield np.stack(
            [
                x - aside * np.sin(heading),
                y + aside * np.cos(heading),
                heading + turn,
                np.maximum(speed - braking * t, 0.0),
            ],
            axis=-1,
        )


def their_box(pose: FloatArray, crcc: Any) -> Any:
    return crcc.RectOBB(SIZE[0] / 2.0, SIZE[1] / 2.0, pose[2], pose[0], pose[1])


def overlaps(scenario: Scenario, pose: FloatArray, step: int, size: FloatArray) -> bool:
    """Whether a rectangle of that size overlaps anyone, by shapely."""
    box = shapely.Polygon(rectangle_corners(pose[:3], size))
    tracks = scenario.tracks
    if step >= tracks.steps:
        return False
    users = np.flatnonzero(tracks.valid[:, step])
    return any(box.intersects(shape_at(tracks, int(u), tracks.states[u, step])) for u in users)


def closed_road(source: Any) -> shapely.Geometry:
    """Union of a CommonRoad scenario's lanelets without the seams between them."""
    areas = [shapely.make_valid(x.polygon.shapely_object) for x in source.lanelet_network.lanelets]
    grown = shapely.union_all(areas).buffer(SEAM / 2.0, join_style="mitre")
    return grown.buffer(-SEAM / 2.0, join_style="mitre")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # commonroad-io's protobuf
@pytest.mark.parametrize("part", every_other(range(PARTS)))
def test_agrees_with_the_drivability_checker(part: int) -> None:
    reason = "install the extra `oracle` to run this"
    crcc = pytest.importorskip("commonroad_dc.pycrcc", reason=reason)
    reader = pytest.importorskip("commonroad.common.file_reader")
    boundary = pytest.importorskip("commonroad_dc.boundary.boundary", reason=reason)
    dispatch = pytest.importorskip(
        "commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch", reason=reason
    )

    seen = dict.fromkeys(("scenarios", "steps", "collisions", "off road", "clear"), 0)
    for path in sorted((commonroad_root() / "val").glob("*.xml"))[part::PARTS]:
        if seen["scenarios"] == SCENARIOS // PARTS:
            break
        try:
            scenario = load_scenario(path)
        except ScenarioError:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            source, _ = reader.CommonRoadFileReader(str(path)).open()
            if source.dt != scenario.dt:
                continue
            checker = dispatch.create_collision_checker(source)
            _, edge = boundary.create_road_boundary_obstacle(source, method="aligned_triangulation")
        seen["scenarios"] += 1
        road = closed_road(source)
        start = scenario.task.start_step
        slices = [checker.time_slice(start + k) for k in range(61)]
        for ego in drives(scenario):
            off_lanelets = outside_lanelets(ego[:, :3], SIZE, scenario.road_map)
            off_road = outside(ego[:, :3], SIZE, scenario.road_map)
            for k, pose in enumerate(ego):
                where = (path.stem, start + k, pose)
                theirs = slices[k].collide(their_box(pose, crcc))
                ours = bool(first_contacts(ego[k : k + 1], SIZE, scenario.tracks, start + k))
                if ours != theirs:
                    # They count what touches; ours must overlap by TOUCH on a side.
                    assert theirs, where
                    assert not overlaps(scenario, pose, start + k, SIZE - 2.0 * TOUCH - 1e-6), where
                off = bool(off_lanelets[k])
                if off != edge.collide(their_box(pose, crcc)):
                    # They count every crack; ours has none in closed seams, and no hairlines.
                    assert not off, where
                    box = shapely.Polygon(rectangle_corners(pose[:3], SIZE))
                    crack = box.difference(road)
                    assert crack.buffer(-0.5 * HAIRLINE - 1e-6).is_empty, where
                seen["steps"] += 1
                seen["collisions"] += ours
                seen["off road"] += bool(off_road[k])
                seen["clear"] += not ours and not off_road[k]
    assert seen["scenarios"] == SCENARIOS // PARTS
    assert min(seen["collisions"], seen["off road"], seen["clear"]) > 100 // PARTS
