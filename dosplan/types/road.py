"""The map: lanelets, what is painted on them, and the rules that hold on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from shapely import Geometry, Polygon, box

from dosplan.types.arrays import FloatArray, ShapeError, frozen


class LineMarking(StrEnum):
    """What is painted along a bound of a lanelet, in the words of CommonRoad.

    Of two lines, the first named is the left one, as in Lanelet2.
    """

    DASHED = "dashed"
    SOLID = "solid"
    BROAD_DASHED = "broad_dashed"
    BROAD_SOLID = "broad_solid"
    DASHED_DASHED = "dashed_dashed"
    SOLID_SOLID = "solid_solid"
    SOLID_DASHED = "solid_dashed"
    DASHED_SOLID = "dashed_solid"
    CURB = "curb"
    LOWERED_CURB = "lowered_curb"
    NO_MARKING = "no_marking"
    UNKNOWN = "unknown"

    def may_be_crossed(self, leftwards: bool) -> bool:
        """Whether a vehicle may drive over it.

        Args:
            leftwards: Whether it is crossed from right to left. Of two lines, the one that is met
                first counts (German StVO, sign 296).

        Returns:
            False for a solid line and for a kerb.
        """
        if self is LineMarking.SOLID_DASHED:
            return leftwards
        if self is LineMarking.DASHED_SOLID:
            return not leftwards
        return self not in _NEVER_CROSSED


_NEVER_CROSSED = frozenset(
    {LineMarking.SOLID, LineMarking.BROAD_SOLID, LineMarking.SOLID_SOLID, LineMarking.CURB}
)


class SignRule(StrEnum):
    """What a traffic sign regulates."""

    SPEED_LIMIT = "speed_limit"
    SPEED_ZONE = "speed_zone"
    STOP = "stop"
    GIVE_WAY = "give_way"
    PRIORITY = "priority"
    RIGHT_BEFORE_LEFT = "right_before_left"
    NO_OVERTAKING = "no_overtaking"
    OTHER = "other"


@dataclass(frozen=True)
class TrafficSign:
    """One plate of a traffic sign.

    Attributes:
        id: Id of the sign in the file; the plates of one post share it.
        code: Number of the plate in its country's catalogue, as written: ``274``, ``R1-1``.
        rule: What it regulates.
        speed: The largest speed that it allows, m/s, or None.
        position: (2,) m, or None where the file names none.
        lanelets: Ids of the lanelets on which it holds.
    """

    id: int
    code: str
    rule: SignRule
    speed: float | None = None
    position: FloatArray | None = None
    lanelets: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.position is not None:
            frozen(self, "position", np.float64, (2,), finite=True)


@dataclass(frozen=True)
class TrafficLight:
    """A traffic light. What it shows is in ``Observation.lights``.

    Attributes:
        id: Its id in the file.
        direction: The ways for which it holds, in the words of CommonRoad: ``left``, ``straight``,
            ``right``, ``leftStraight``, ``straightRight``, ``leftRight`` or ``all``.
        position: (2,) m, or None where the file names none that is a place.
        lanelets: Ids of the lanelets at whose end it stands.
    """

    id: int
    direction: str = "all"
    position: FloatArray | None = None
    lanelets: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.position is not None:
            frozen(self, "position", np.float64, (2,), finite=True)

    def holds_for(self, turn: str) -> bool:
        """Whether it holds for a way through the intersection.

        Args:
            turn: ``left``, ``straight`` or ``right``.

        Returns:
            Whether its direction names that way.
        """
        return self.direction == "all" or turn in self.direction.lower()


@dataclass(frozen=True)
class StopLine:
    """A line before which one stops where a light or a sign asks for it.

    Attributes:
        ends: (2, 2) its ends, m.
        marking: What is painted.
        lights: Ids of the lights to which it belongs.
        signs: Ids of the signs to which it belongs.
    """

    ends: FloatArray
    marking: LineMarking = LineMarking.UNKNOWN
    lights: tuple[int, ...] = ()
    signs: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        frozen(self, "ends", np.float64, (2, 2), finite=True)


@dataclass(frozen=True)
class Incoming:
    """One road into an intersection.

    Attributes:
        id: Its id in the file.
        lanelets: Ids of the lanelets that lead in.
        left: Ids of the lanelets inside on which one turns left.
        straight: Ids of those on which one goes straight on.
        right: Ids of those on which one turns right.
        left_of: Id of the incoming road on whose left this one lies, or None: at crossings without
            signs the road on the right goes first.
    """

    id: int
    lanelets: tuple[int, ...]
    left: tuple[int, ...] = ()
    straight: tuple[int, ...] = ()
    right: tuple[int, ...] = ()
    left_of: int | None = None


@dataclass(frozen=True)
class Intersection:
    """A place where roads meet.

    Attributes:
        id: Its id in the file.
        incomings: The roads into it.
        crossings: Ids of the crosswalks that belong to it.
    """

    id: int
    incomings: tuple[Incoming, ...]
    crossings: tuple[int, ...] = ()

    @property
    def inside(self) -> frozenset[int]:
        """Ids of the lanelets inside."""
        return frozenset(
            name for road in self.incomings for name in (*road.left, *road.straight, *road.right)
        )


@dataclass(frozen=True)
class Lanelet:
    """A lane segment of the map.

    Attributes:
        id: The lanelet's id in the file.
        left: (P, 2) left bound, m.
        right: (P, 2) right bound, m, point by point beside ``left``.
        successors: Ids of the lanelets that follow.
        predecessors: Ids of the lanelets before it.
        left_neighbour: Id of the adjacent lanelet on the left **in the same direction**.
        right_neighbour: The same on the right.
        left_opposite: Id of the adjacent lanelet on the left that runs **against** it.
        right_opposite: The same on the right.
        speed_limit: m/s, or None where the map names none.
        speed_limit_source: What names the limit: ``sign 50 (274)``, ``zone sign 7 (274.1)``, or
            ``lanelet``; None where there is no limit.
        for_cars: Whether a route may use it; False for footways, bicycle lanes and bus lanes,
            which have no links to lanelets for cars.
        is_road: Whether it is carriageway, on which a car is not off the road; a bus lane is, a
            footway, a bicycle lane and a pedestrian crossing are not.
        kinds: What it is, in the words of CommonRoad: ``urban``, ``highway``, ``accessRamp``,
            ``busLane``, ``crosswalk``, ...
        users: Who may use it in its direction, in the words of CommonRoad: ``vehicle``, ``car``,
            ``bicycle``, ``pedestrian``, ...; empty where the file does not say.
        users_both_ways: Who may use it in both directions.
        left_marking: What is painted along its left bound.
        right_marking: The same of its right bound.
        stop_line: The stop line on it, or None.
        lights: Ids of the traffic lights at its end.
        signs: Ids of the traffic signs that hold on it.
    """

    id: int
    left: FloatArray
    right: FloatArray
    successors: tuple[int, ...] = ()
    predecessors: tuple[int, ...] = ()
    left_neighbour: int | None = None
    right_neighbour: int | None = None
    left_opposite: int | None = None
    right_opposite: int | None = None
    speed_limit: float | None = None
    speed_limit_source: str | None = None
    for_cars: bool = True
    is_road: bool = True
    kinds: frozenset[str] = frozenset()
    users: frozenset[str] = frozenset()
    users_both_ways: frozenset[str] = frozenset()
    left_marking: LineMarking = LineMarking.UNKNOWN
    right_marking: LineMarking = LineMarking.UNKNOWN
    stop_line: StopLine | None = None
    lights: tuple[int, ...] = ()
    signs: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        frozen(self, "left", np.float64, (None, 2), finite=True)
        frozen(self, "right", np.float64, self.left.shape, finite=True)

    @property
    def centre(self) -> FloatArray:
        """(P, 2) centre line, m."""
        return 0.5 * (self.left + self.right)

    @property
    def is_crosswalk(self) -> bool:
        """Whether pedestrians cross the road on it."""
        return "crosswalk" in self.kinds


@dataclass(frozen=True)
class RoadMap:
    """Lanelets, the area on which the ego may drive, and what regulates the traffic.

    Attributes:
        lanelets: Every lanelet of the map.
        drivable: Union of the lanelets that are road, a polygon or several, m; the ego's rectangle
            must stay inside it. CommonRoad's own drivability checker takes **all** lanelets, so
            that a car on a footway is on the road there; here it is off it. A crossing
            on a lane is road, as the lane is.
        open_ends: What lies beyond the ends of the map where a road is cut off, a car's length of
            it, m. No edge of the road is there, so the ego may hang over the end; CommonRoad's
            checker counts that as off the road.
        signs: The traffic signs, a plate each.
        lights: The traffic lights. What they show now is in ``Observation.lights``.
        intersections: The intersections that the file names.
    """

    lanelets: tuple[Lanelet, ...]
    drivable: Geometry
    open_ends: Geometry = field(default_factory=Polygon)
    signs: tuple[TrafficSign, ...] = ()
    lights: tuple[TrafficLight, ...] = ()
    intersections: tuple[Intersection, ...] = ()

    def __post_init__(self) -> None:
        names = [light.id for light in self.lights]
        if len(set(names)) != len(names):
            raise ShapeError("RoadMap.lights names a traffic light twice")

    @property
    def crosswalks(self) -> Iterator[Lanelet]:
        """The lanelets on which pedestrians cross the road."""
        return (lanelet for lanelet in self.lanelets if lanelet.is_crosswalk)

    def turn(self, before: int, inside: int) -> str | None:
        """Which way one takes through an intersection, as the file names it.

        Args:
            before: Id of the lanelet that leads in.
            inside: Id of its successor.

        Returns:
            ``left``, ``straight`` or ``right``; None where no intersection names the two.
        """
        for intersection in self.intersections:
            for road in intersection.incomings:
                if before in road.lanelets:
                    for turn in ("left", "straight", "right"):
                        if inside in getattr(road, turn):
                            return turn
        return None

    def road_within(self, west: float, south: float, east: float, north: float) -> Geometry:
        """The drivable area and the open ends of the map in a box.

        Args:
            west: Smallest x, m.
            south: Smallest y, m.
            east: Largest x, m.
            north: Largest y, m.

        Returns:
            Where a car is not off the road.
        """
        area = box(west, south, east, north)
        inside = self.drivable.intersection(area)
        beyond = self.open_ends.intersection(area)
        return inside if beyond.is_empty else inside.union(beyond)
