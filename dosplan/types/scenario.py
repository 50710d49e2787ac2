"""What a scenario file holds: the map, the recorded road users and what the ego has to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np
from shapely import Geometry, Polygon, box

from dosplan.types.arrays import (
    EGO_SIZE,
    USER_SIZE,
    BoolArray,
    FloatArray,
    IntArray,
    ShapeError,
    frozen,
)
from dosplan.types.vehicle import VehicleParameters

STEP_SECONDS: Final = 0.1


class RoadUserKind(StrEnum):
    """What a road user is."""

    CAR = "car"
    TRUCK = "truck"
    BUS = "bus"
    TRAIN = "train"
    MOTORCYCLE = "motorcycle"
    BICYCLE = "bicycle"
    PEDESTRIAN = "pedestrian"
    PARKED = "parked"
    STATIC = "static"
    UNKNOWN = "unknown"

    @property
    def moves(self) -> bool:
        """Whether it can move at all: it is neither parked nor part of the scenery."""
        return self not in (RoadUserKind.PARKED, RoadUserKind.STATIC)


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
        speed_limit: m/s, or None where the map names none.
        for_cars: Whether a route may use it; False for footways, bicycle lanes and bus lanes,
            which have no links to lanelets for cars.
        is_road: Whether it is carriageway, on which a car is not off the road; a bus lane is, a
            footway, a bicycle lane and a pedestrian crossing are not.
    """

    id: int
    left: FloatArray
    right: FloatArray
    successors: tuple[int, ...] = ()
    predecessors: tuple[int, ...] = ()
    left_neighbour: int | None = None
    right_neighbour: int | None = None
    speed_limit: float | None = None
    for_cars: bool = True
    is_road: bool = True

    def __post_init__(self) -> None:
        frozen(self, "left", np.float64, (None, 2), finite=True)
        frozen(self, "right", np.float64, self.left.shape, finite=True)

    @property
    def centre(self) -> FloatArray:
        """(P, 2) centre line, m."""
        return 0.5 * (self.left + self.right)


@dataclass(frozen=True)
class RoadMap:
    """Lanelets and the area on which the ego may drive.

    Attributes:
        lanelets: Every lanelet of the map.
        drivable: Union of the lanelets that are road, a polygon or several, m; the ego's rectangle
            must stay inside it. CommonRoad's own drivability checker takes **all** lanelets, so
            that a car on a footway is on the road there; here it is off it. A crossing
            on a lane is road, as the lane is.
        open_ends: What lies beyond the ends of the map where a road is cut off, a car's length of
            it, m. No edge of the road is there, so the ego may hang over the end; CommonRoad's
            checker counts that as off the road.
    """

    lanelets: tuple[Lanelet, ...]
    drivable: Geometry
    open_ends: Geometry = field(default_factory=Polygon)

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


@dataclass(frozen=True)
class Tracks:
    """Road users over many steps, as they were recorded, or as they were driven in an episode.

    It holds the future: only the simulation and the analysis of a finished episode may use it.

    Attributes:
        ids: (N,) ids of the road users, unique.
        kinds: N kinds.
        size: (N, 2) length and width of the bounding rectangle, m.
        states: (N, K, 4) road-user states at steps 0 .. K-1; NaN where not ``valid``.
        valid: (N, K) whether the road user is on the scene at that step.
        outlines: N polygons (V, 2) in the body frame, m, where the shape is not the
            rectangle of ``size``; None otherwise.
    """

    ids: IntArray
    kinds: tuple[RoadUserKind, ...]
    size: FloatArray
    states: FloatArray
    valid: BoolArray
    outlines: tuple[FloatArray | None, ...] = ()

    def __post_init__(self) -> None:
        frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        frozen(self, "size", np.float64, (n, 2), finite=True)
        frozen(self, "states", np.float64, (n, None, USER_SIZE))
        frozen(self, "valid", np.bool_, (n, self.states.shape[1]))
        if len(np.unique(self.ids)) != n:
            raise ShapeError("Tracks.ids names a road user twice")
        if len(self.kinds) != n:
            raise ShapeError(f"Tracks.kinds has {len(self.kinds)} entries, expected {n}")
        if not self.outlines:
            object.__setattr__(self, "outlines", (None,) * n)
        if len(self.outlines) != n:
            raise ShapeError(f"Tracks.outlines has {len(self.outlines)} entries, expected {n}")
        if not np.all(np.isfinite(self.states[self.valid])):
            raise ShapeError("Tracks.states holds a NaN at a step that is marked valid")

    @property
    def steps(self) -> int:
        """Number K of steps."""
        return int(self.states.shape[1])


@dataclass(frozen=True)
class GoalState:
    """One of the alternative goals of a planning problem; every part that is set must hold.

    Attributes:
        first_step: First step at which the goal counts.
        last_step: Last step at which the goal counts.
        region: Polygon, or several, in which the ego's **centre** must be, m; None where the
            goal sets no place.
        heading: Lower and upper heading, rad, or None.
        velocity: Lower and upper velocity, m/s, or None.
    """

    first_step: int
    last_step: int
    region: Geometry | None = None
    heading: tuple[float, float] | None = None
    velocity: tuple[float, float] | None = None


@dataclass(frozen=True)
class Route:
    """The way to the goal: lanelets and a smooth reference path with the free width beside it.

    The path begins behind the ego's start and is as long as the episode needs; past the end of
    the map it goes on straight.

    Attributes:
        lanelet_ids: Lanelets in the order they are driven; a lane change is a neighbour.
        arclength: (P,) arc length, m, equally spaced from 0.
        path: (P, 2) reference path, m.
        heading: (P,) heading of the path, rad, continuous (unwrapped).
        curvature: (P,) signed curvature, 1/m, left positive.
        left: (P,) lateral offset of the left edge of the drivable area less lanes against the
            path, m, >= 0.
        right: (P,) the same of the right edge, m, <= 0.
        outer_left: (P,) lateral offset of the drivable area's left edge, lanes against the path
            included, m, >= 0.
        outer_right: (P,) the same of its right edge, m, <= 0.
        speed_limit: (P,) m/s; infinite where the map names none.
    """

    lanelet_ids: tuple[int, ...]
    arclength: FloatArray
    path: FloatArray
    heading: FloatArray
    curvature: FloatArray
    left: FloatArray
    right: FloatArray
    outer_left: FloatArray
    outer_right: FloatArray
    speed_limit: FloatArray

    def __post_init__(self) -> None:
        frozen(self, "arclength", np.float64, (None,), finite=True)
        p = len(self.arclength)
        frozen(self, "path", np.float64, (p, 2), finite=True)
        for name in ("heading", "curvature", "left", "right", "outer_left", "outer_right"):
            frozen(self, name, np.float64, (p,), finite=True)
        frozen(self, "speed_limit", np.float64, (p,))
        if p < 2 or np.any(np.diff(self.arclength) <= 0):
            raise ShapeError("Route.arclength needs two points and must increase strictly")


@dataclass(frozen=True)
class PlanningTask:
    """What the ego has to do.

    Attributes:
        scenario_id: Id of the episode, for messages.
        dt: Step, s.
        start_step: Step at which the ego starts.
        start: (5,) ego state at that step.
        goals: Alternative goals; one is enough.
        final_step: Last step at which a goal can still be reached.
        route: The way to the goal.
        vehicle: The ego's size and limits.
    """

    scenario_id: str
    dt: float
    start_step: int
    start: FloatArray
    goals: tuple[GoalState, ...]
    final_step: int
    route: Route
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)

    def __post_init__(self) -> None:
        frozen(self, "start", np.float64, (EGO_SIZE,), finite=True)
        if not self.goals:
            raise ShapeError(f"PlanningTask.goals is empty (scenario {self.scenario_id})")


@dataclass(frozen=True)
class Scenario:
    """One episode's worth of a CommonRoad file: the map, the recording and one planning problem.

    Attributes:
        id: Unique name of the episode: the benchmark id, with ``@problem`` appended where the
            file holds several planning problems.
        benchmark_id: The CommonRoad scenario id.
        problem_id: The CommonRoad planning-problem id.
        dt: Step, s.
        road_map: The map.
        tracks: The recording, future included.
        task: Start, goal and route of the ego.
        tags: The file's tags (``simulated``, ``highway``, ...).
        notes: Parts of the file that were left out or corrected; a line each.
    """

    id: str
    benchmark_id: str
    problem_id: int
    dt: float
    road_map: RoadMap
    tracks: Tracks
    task: PlanningTask
    tags: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


def place_of(scenario_id: str) -> str:
    """Names the place of a scenario, by its id.

    Args:
        scenario_id: Id, such as ``USA_Lanker-2_25_T-1``.

    Returns:
        Country and map name, such as ``USA_Lanker``: what stands before the first hyphen, without
        the ``C-`` of a cooperative scenario.
    """
    return scenario_id.removeprefix("C-").partition("-")[0]
