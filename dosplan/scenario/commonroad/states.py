"""States of a scenario file, its shapes, and the bodies that road users have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from dosplan.geometry import areas, rectangle_corners, to_body, to_world
from dosplan.scenario.commonroad.convex import (
    convex_pieces,
    enclosing_rectangles,
    halves,
    is_convex,
)
from dosplan.scenario.commonroad.elements import FaultError, child, point, points, scalar
from dosplan.types import FloatArray

CIRCLE_VERTICES: Final = 32
SHAPES: Final = ("rectangle", "circle", "polygon")
_OVERHANG: Final = 0.5
"""Width, m, of road that a rectangle may block where its body does not."""
_CUTS: Final = 5
"""How often a body is cut in two at most."""


@dataclass(frozen=True)
class Part:
    """One of the shapes that an element lists, in the element's own frame.

    Attributes:
        outline: (V, 2) vertices, m. A circle's is a regular polygon of 32 vertices around it,
            larger by at most 0.5 % of the radius.
        rectangle: Pose (3,) of its centre, m and rad, and size (2,), m, where it is given as one.
    """

    outline: FloatArray
    rectangle: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True)
class Body:
    """A convex body, relative to the point that the states of its road user describe.

    Attributes:
        pose: (3,) x, y, m, and heading, rad, of its centre in the frame of the states.
        size: (2,) length and width of the rectangle around it, m.
        outline: (V, 2) vertices in the frame of ``pose``, m, or None for a rectangle.
    """

    pose: FloatArray
    size: FloatArray
    outline: FloatArray | None = None


def read_shape(element: Element) -> list[Part]:
    """The shapes in an element; several are a group.

    Args:
        element: A ``<shape>``, or the ``<position>`` of a goal.

    Returns:
        The parts, at least one.

    Raises:
        FaultError: There is none, or one cannot be read.
    """
    parts = [_part(found) for found in element if found.tag in SHAPES]
    if not parts:
        held = ", ".join(sorted({f"<{part.tag}>" for part in element}))
        what = f"holds {held} and no shape" if held else "is empty"
        raise FaultError(f"the <{element.tag}> {what}; give it a rectangle, circle or polygon")
    return parts


def _part(element: Element) -> Part:
    if element.tag == "polygon":
        vertices = points(element)
        if len(vertices) < 3:
            raise FaultError(f"a <polygon> has {len(vertices)} points; give it three or more")
        clockwise = shapely.orient_polygons(shapely.Polygon(vertices), exterior_cw=True)
        return Part(shapely.get_coordinates(clockwise)[:-1])
    centre = element.find("center")
    middle = (0.0, 0.0) if centre is None else point(centre)
    if element.tag == "circle":
        angle = 2.0 * np.pi * np.arange(CIRCLE_VERTICES) / CIRCLE_VERTICES
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        radius = _size(element, "radius") / np.cos(np.pi / CIRCLE_VERTICES)
        return Part(np.asarray(middle) + radius * circle)
    turned = element.find("orientation")
    heading = 0.0 if turned is None else scalar(element, "orientation")
    pose = np.array([*middle, heading])
    size = np.array([_size(element, "length"), _size(element, "width")])
    return Part(rectangle_corners(pose, size), (pose, size))


def _size(element: Element, tag: str) -> float:
    found = scalar(element, tag)
    if found < 0.0:
        raise FaultError(f"a <{element.tag}> has the {tag} {found:g}; correct it")
    return found


def region(parts: list[Part]) -> shapely.Polygon | shapely.MultiPolygon:
    """Area of shapes that stand in the scenario frame.

    Args:
        parts: The shapes.

    Returns:
        A valid polygon, m.
    """
    valid = [shapely.make_valid(shapely.Polygon(part.outline)) for part in parts]
    return areas(shapely.union_all(valid))


def position(state: Element) -> FloatArray:
    """Where a state is: its point, or the centre of the area in which it is known to be.

    Args:
        state: The state.

    Returns:
        (2,) m.

    Raises:
        FaultError: It has no position, or one that cannot be read.
    """
    place = child(state, "position")
    exact = place.find("point")
    if exact is not None:
        return np.array(point(exact))
    return np.asarray(shapely.get_coordinates(shapely.centroid(region(read_shape(place))))[0])


def bodies(parts: list[Part], *, fixed: bool) -> list[Body]:
    """The bodies that together are what a road user's shapes cover.

    One rectangle stays one, wherever it is and however it is turned. Shapes that are convex
    together become one body. All others are cut into convex bodies, so that the space in a notch or
    between two pillars stays free.

    Args:
        parts: The shapes in the road user's frame.
        fixed: Whether the road user never moves. The rectangle around a piece of one that does
            keeps its heading, along which it drives; that of a piece of scenery is the smallest.

    Returns:
        The bodies, at least one.
    """
    if len(parts) == 1 and parts[0].rectangle is not None:
        return [Body(*parts[0].rectangle)]
    hull = shapely.convex_hull(shapely.MultiPoint(np.concatenate([x.outline for x in parts])))
    covered = region(parts)
    if covered.is_empty or is_convex(covered):
        return [_boxed(shapely.get_coordinates(hull)[:-1])]
    out: list[Body] = []
    for part in parts:
        if part.rectangle is not None:
            out.append(Body(*part.rectangle))
        else:
            out += [_body(piece, fixed) for piece in convex_pieces(region([part]))]
    return out or [_boxed(shapely.get_coordinates(hull)[:-1])]


def fitted(body: Body, place: FloatArray, road: shapely.Geometry) -> list[Body]:
    """Fits the rectangle around a fixed body so that it blocks no road that the body leaves open.

    Planners keep clear of rectangles; one around a slanted wall may lie on the road beside it.
    Where no rectangle along an edge does better, the body is cut in two, and so on.

    Args:
        body: The body.
        place: (3,) state of its road user, m and rad.
        road: Where cars drive, m.

    Returns:
        The body alone, or its slices.
    """
    if body.outline is None or _closed(body, place, road).is_empty:
        return [body]
    return _fitted(shapely.Polygon(to_world(body.outline, body.pose)), place, road, _CUTS)


def _fitted(
    piece: shapely.Polygon, place: FloatArray, road: shapely.Geometry, cuts: int
) -> list[Body]:
    for rectangle in enclosing_rectangles(piece):
        body = _within(piece, *rectangle)
        if _closed(body, place, road).is_empty:
            return [body]
    if cuts == 0:
        return [_body(piece, fixed=True)]
    return [body for half in halves(piece) for body in _fitted(half, place, road, cuts - 1)]


def _closed(body: Body, place: FloatArray, road: shapely.Geometry) -> shapely.Geometry:
    """The road that the rectangle of a body blocks and the body does not."""
    if body.outline is None:
        return shapely.Polygon()
    pose = moved(body.pose, place[None])[0]
    shape = shapely.Polygon(to_world(body.outline, pose))
    around = shapely.difference(shapely.Polygon(rectangle_corners(pose, body.size)), shape)
    return shapely.buffer(shapely.intersection(around, road), -0.5 * _OVERHANG)


def _body(piece: shapely.Polygon, fixed: bool) -> Body:
    if not fixed:
        return _boxed(shapely.get_coordinates(piece)[:-1])
    return _within(piece, *next(enclosing_rectangles(piece)))


def _within(piece: shapely.Polygon, pose: FloatArray, size: FloatArray) -> Body:
    """The body of a convex piece and a rectangle around it."""
    if piece.area > (1.0 - 1e-6) * size[0] * size[1]:
        return Body(pose, size)
    return Body(pose, size, to_body(shapely.get_coordinates(piece)[:-1], pose))


def _boxed(outline: FloatArray) -> Body:
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle = 0.5 * (low + high)
    return Body(np.array([*middle, 0.0]), high - low, outline - middle)


def moved(pose: FloatArray, states: FloatArray) -> FloatArray:
    """Centres of a body whose reference points are given.

    Args:
        pose: (3,) pose of the body in the frame of the states.
        states: (K, 3) x, y, m, and heading, rad, of the reference point.

    Returns:
        (K, 3) x, y and heading of the body.
    """
    centre = to_world(pose[None, :2], states)[:, 0]
    return np.column_stack([centre, states[:, 2] + pose[2]])
