"""What a scenario file holds: the map, the recorded road users and what the ego has to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
from shapely import Geometry, Polygon

from dosplan.types.arrays import (
    EGO_SIZE,
    USER_SIZE,
    BoolArray,
    FloatArray,
    IntArray,
    ShapeError,
    check_finite,
    frozen,
)
from dosplan.types.lights import Signals
from dosplan.types.road import RoadMap
from dosplan.types.vehicle import VehicleParameters

STEP_SECONDS: Final = 0.1
"""Time between two steps of every scenario once it is loaded, s."""


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
        check_finite(self.states[self.valid], "Tracks.states", " at a step that is marked valid")

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


class StopCause(StrEnum):
    """Why the ego may have to stop at a place of its route."""

    LIGHT = "light"
    STOP_SIGN = "stop_sign"
    GIVE_WAY = "give_way"
    CROSSWALK = "crosswalk"


@dataclass(frozen=True)
class RouteStop:
    """A place of a route at which the ego may have to stop.

    Attributes:
        cause: What may make it stop: a light that is red; a stop sign, always; a sign to give way,
            for those who have priority; a crosswalk, for who is on it or about to step on it.
        arclength: Arc length of the line before which it stops, along the route's path, m; the
            ego's front must not pass it.
        until: Arc length at which the place is left behind, m: the far end of the intersection or
            of the crosswalk.
        lights: Ids of the lights that hold for the way the route goes on. Those of a sign overrule
            it while they are lit; those of a crosswalk are of the crossing that it belongs to.
        conflict: Area in which others go first, m: the lanelets with priority whose way crosses
            the route's, or the crosswalk; empty for a light.
    """

    cause: StopCause
    arclength: float
    until: float
    lights: tuple[int, ...] = ()
    conflict: Geometry = field(default_factory=Polygon)


@dataclass(frozen=True)
class Route:
    """The way to the goal: lanelets and a smooth reference path with the free width beside it.

    The path begins behind the ego's start and is as long as the episode needs; past the end of
    the map it goes on straight.

    Attributes:
        lanelet_ids: Lanelets in the order they are driven; a lane change is a neighbour.
        arclength: (P,) arc length, m, equally spaced from 0.
        path: (P, 2) reference path for the rear axle, along the middle of the lanes, m.
        heading: (P,) heading of the path, rad, continuous (unwrapped).
        curvature: (P,) signed curvature, 1/m, left positive.
        left: (P,) lateral offset of the left edge of the drivable area less lanes against the
            path, m, >= 0.
        right: (P,) the same of the right edge, m, <= 0.
        outer_left: (P,) lateral offset of the drivable area's left edge, lanes against the path
            included, m, >= 0.
        outer_right: (P,) the same of its right edge, m, <= 0.
        speed_limit: (P,) m/s; infinite where the map names none.
        stops: Where the ego may have to stop, in the order of the path.
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
    stops: tuple[RouteStop, ...] = ()

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
        tracks: The recording, future included; where several futures are recorded, future 0.
        task: Start, goal and route of the ego.
        signals: The lights of the map as they are recorded, future included.
        tags: The file's tags (``simulated``, ``highway``, ...).
        notes: Parts of the file that were left out or corrected; a line each.
        interactive: Whether the file holds no more than the first states of its road users, whom
            a simulator has to move: there is no recording.
        sumo: Configuration with which SUMO can drive the traffic, a ``.sumo.cfg`` file; None where
            there is none.
        futures: The other recorded futures, 1 first, at the steps of ``tracks``. They have the
            past of ``tracks``, to the last bit, up to and including the ego's start.
    """

    id: str
    benchmark_id: str
    problem_id: int
    dt: float
    road_map: RoadMap
    tracks: Tracks
    task: PlanningTask
    signals: Signals = field(default_factory=Signals)
    tags: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    interactive: bool = False
    sumo: Path | None = None
    futures: tuple[Tracks, ...] = ()

    def recorded(self, future: int) -> Tracks:
        """A recorded future.

        Args:
            future: Its number, 0 for the recording of the scenario file.

        Returns:
            All road users, the same object at each call.

        Raises:
            ShapeError: So many futures are not recorded.
        """
        recordings = (self.tracks, *self.futures)
        if not 0 <= future < len(recordings):
            raise ShapeError(
                f"scenario {self.id} has {len(recordings)} recorded "
                f"future{'s' if self.futures else ''}, and future {future} is asked for; take "
                "fewer, or put the file of its futures beside it again"
            )
        return recordings[future]

    def is_recorded(self, tracks: Tracks) -> bool:
        """Whether tracks are one of the recorded futures, the very object.

        Args:
            tracks: Road users as they were driven.

        Returns:
            Whether all drove as recorded.
        """
        return any(tracks is recording for recording in (self.tracks, *self.futures))


def scene_of(scenario_id: str) -> str:
    """Names the scene of a scenario, by its id: ``COUNTRY_SCENE-MAP_CONFIGURATION_...``.

    Args:
        scenario_id: Id, such as ``USA_Lanker-2_25_T-1``.

    Returns:
        Country and scene, such as ``USA_Lanker``, without the ``C-`` of a cooperative scenario.
    """
    return scenario_id.removeprefix("C-").partition("-")[0]


def place_of(scenario_id: str) -> str:
    """Names the place of a scenario, by its id.

    Maps of a real scene are cut from one place. CommonRoad's imaginary country, ``ZAM``, has no
    places: there a scene is a kind of road, and each of its maps is another road.

    Args:
        scenario_id: Id, such as ``USA_Lanker-2_25_T-1`` or ``ZAM_Zebra-3_1_T-1``.

    Returns:
        The scene; with the map where the country is imaginary, as ``ZAM_Zebra-3``.
    """
    scene = scene_of(scenario_id)
    if not scene.startswith("ZAM_"):
        return scene
    return "_".join(scenario_id.removeprefix("C-").split("_")[:2])
