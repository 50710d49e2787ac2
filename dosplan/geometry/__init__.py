"""Geometry of the plane, ellipses and paths in it, the goal's regions, lights and stops."""

from dosplan.geometry.ellipse import (
    ellipse_area,
    ellipse_boundary,
    ellipse_extent,
    inside_ellipse,
    mahalanobis,
    set_sizes,
)
from dosplan.geometry.following import (
    AccelerationLaw,
    PathFollower,
    extended_path,
    follow_poses,
)
from dosplan.geometry.lanes import side_by_side
from dosplan.geometry.lights import NO_LIGHT, LightIndex, LightsAhead, lights_at
from dosplan.geometry.path import (
    PATH_CURVATURE,
    PATH_HEADING,
    PATH_SIZE,
    PATH_X,
    PATH_Y,
    EvenPath,
    ReferencePath,
    braking_envelope,
)
from dosplan.geometry.plane import (
    areas,
    close_seams,
    cross,
    lanelet_cells,
    lanelet_polygon,
    lanelet_union,
    lanelets_off_road,
    rectangle_corners,
    rectangles_overlap,
    to_body,
    to_world,
    wrap_angle,
)
from dosplan.geometry.stops import StopRules, StopSettings, Wait
from dosplan.geometry.union import covering_ellipse, occupancy_of_union, set_distance
from dosplan.geometry.union_area import set_area

__all__ = [
    "NO_LIGHT",
    "PATH_CURVATURE",
    "PATH_HEADING",
    "PATH_SIZE",
    "PATH_X",
    "PATH_Y",
    "AccelerationLaw",
    "EvenPath",
    "LightIndex",
    "LightsAhead",
    "PathFollower",
    "ReferencePath",
    "StopRules",
    "StopSettings",
    "Wait",
    "areas",
    "braking_envelope",
    "close_seams",
    "covering_ellipse",
    "cross",
    "ellipse_area",
    "ellipse_boundary",
    "ellipse_extent",
    "extended_path",
    "follow_poses",
    "inside_ellipse",
    "lanelet_cells",
    "lanelet_polygon",
    "lanelet_union",
    "lanelets_off_road",
    "lights_at",
    "mahalanobis",
    "occupancy_of_union",
    "rectangle_corners",
    "rectangles_overlap",
    "set_area",
    "set_distance",
    "set_sizes",
    "side_by_side",
    "to_body",
    "to_world",
    "wrap_angle",
]
