"""Geometry of the plane, and the goal's regions."""

from dosplan.geometry.plane import (
    areas,
    lanelet_cells,
    lanelet_polygon,
    rectangle_corners,
    to_body,
    to_world,
    wrap_angle,
)

__all__ = [
    "areas",
    "lanelet_cells",
    "lanelet_polygon",
    "rectangle_corners",
    "to_body",
    "to_world",
    "wrap_angle",
]
