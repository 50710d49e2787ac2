"""The value types of dosplan: one frozen dataclass of arrays for each arrow of the pipeline.

``Scenario -> Observation -> Occupancy -> Plan -> Episode -> Score``; nothing flows back.

Conventions shared by every type:

* Frame: the scenario's own right-handed Cartesian frame, x and y in metres. Angles are in
  radians, counter-clockwise from the x axis, and are not wrapped unless a docstring says so.
* Time is counted in steps of ``dt`` seconds; ``dt`` is 0.1 s everywhere after loading.
* An *ego state* is a row ``(x, y, steering_angle, velocity, heading)`` of the CommonRoad
  kinematic single track: x and y are those of the **rear axle**. ``dosplan.vehicle`` turns
  it into the centre of the ego's rectangle.
* A *road-user state* is a row ``(x, y, heading, velocity)`` of the shape's **centre**.
* Arrays are stored as read-only copies: nobody can change what was handed over, neither who
  made it nor who got it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, StrEnum
from numbers import Integral, Real
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from shapely.geometry import MultiPolygon, Polygon

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

EGO_X: Final = 0
EGO_Y: Final = 1
EGO_STEERING: Final = 2
EGO_VELOCITY: Final = 3
EGO_HEADING: Final = 4
EGO_SIZE: Final = 5

USER_X: Final = 0
USER_Y: Final = 1
USER_HEADING: Final = 2
USER_VELOCITY: Final = 3
USER_SIZE: Final = 4

STEP_SECONDS: Final = 0.1
HISTORY_STEPS: Final = 31  # Steps that a predictor is shown, the present one included: 3 s.


class ShapeError(ValueError):
    """An array that does not have the shape or the finiteness its field promises."""


def _frozen(
    owner: object, field: str, dtype: Any, shape: Sequence[int | None], finite: bool = False
) -> None:
    """Replaces ``owner.field`` by a read-only copy after checking its shape.

    What is stored is a view of a copy that is read-only itself, so that ``setflags`` cannot make
    it writable again.

    Args:
        owner: A frozen dataclass instance.
        field: Name of the field.
        dtype: The numpy dtype that is wanted.
        shape: Expected shape; ``None`` stands for any length.
        finite: Whether NaN and infinity are refused.

    Raises:
        ShapeError: The array has another shape or holds a value that is not finite.
    """
    value = getattr(owner, field)
    where = f"{type(owner).__name__}.{field}"
    name = getattr(owner, "scenario_id", None)
    suffix = f" (scenario {name})" if name else ""
    try:
        if np.iscomplexobj(value):  # numpy would drop the imaginary part, and only warn.
            raise TypeError("it holds complex numbers")
        array = np.array(value, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{where} is not an array of {np.dtype(dtype)}: {error}{suffix}") from None
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise ShapeError(f"{where} has shape {array.shape}, expected {wanted}{suffix}")
    if finite and not np.all(np.isfinite(array)):
        raise ShapeError(f"{where} holds a NaN or an infinite value{suffix}")
    array.setflags(write=False)
    object.__setattr__(owner, field, array.view())


def _whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _finite(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


class Arm(StrEnum):
    """The two arms of the comparison; they differ in the ``Occupancy`` the planner is handed."""

    WITH_DOS = "with_dos"
    WITHOUT_DOS = "without_dos"


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
        for_cars: Whether a route may use it; False for footways and bicycle lanes, which are
            linked to none that is for cars.
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

    def __post_init__(self) -> None:
        _frozen(self, "left", np.float64, (None, 2), finite=True)
        _frozen(self, "right", np.float64, self.left.shape, finite=True)

    @property
    def centre(self) -> FloatArray:
        """(P, 2) centre line, m."""
        return 0.5 * (self.left + self.right)


@dataclass(frozen=True)
class RoadMap:
    """Lanelets and the area on which the ego may drive.

    Attributes:
        lanelets: Every lanelet of the map.
        drivable: Union of **all** lanelets, m; the ego's rectangle must stay inside it. Footways
            and bicycle lanes belong to it, as they do for CommonRoad's own drivability checker:
            no route leads over them, but to touch one is not to leave the road.
    """

    lanelets: tuple[Lanelet, ...]
    drivable: Polygon | MultiPolygon


@dataclass(frozen=True)
class Tracks:
    """The recorded road users, past and future: only simulation and scoring may hold it.

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
        _frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        _frozen(self, "size", np.float64, (n, 2), finite=True)
        _frozen(self, "states", np.float64, (n, None, USER_SIZE))
        _frozen(self, "valid", np.bool_, (n, self.states.shape[1]))
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
        """Number K of recorded steps."""
        return int(self.states.shape[1])


@dataclass(frozen=True)
class GoalState:
    """One of the alternative goals of a planning problem; every part that is set must hold.

    Attributes:
        first_step: First step at which the goal counts.
        last_step: Last step at which the goal counts.
        region: Where the ego's **centre** must be, m; None where any place will do.
        heading: Lower and upper heading, rad, or None.
        velocity: Lower and upper velocity, m/s, or None.
    """

    first_step: int
    last_step: int
    region: Polygon | MultiPolygon | None = None
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
        _frozen(self, "arclength", np.float64, (None,), finite=True)
        p = len(self.arclength)
        _frozen(self, "path", np.float64, (p, 2), finite=True)
        for field in ("heading", "curvature", "left", "right", "outer_left", "outer_right"):
            _frozen(self, field, np.float64, (p,), finite=True)
        _frozen(self, "speed_limit", np.float64, (p,))
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
    """

    scenario_id: str
    dt: float
    start_step: int
    start: FloatArray
    goals: tuple[GoalState, ...]
    final_step: int
    route: Route

    def __post_init__(self) -> None:
        _frozen(self, "start", np.float64, (EGO_SIZE,), finite=True)
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
    """

    id: str
    benchmark_id: str
    problem_id: int
    dt: float
    road_map: RoadMap
    tracks: Tracks
    task: PlanningTask
    tags: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Observation:
    """What a planner and a predictor may know at a step. The future is unreachable from it.

    Attributes:
        step: The present step.
        dt: Step, s.
        ego: (5,) ego state now.
        ego_history: (H, 5) ego states at steps ``step - H + 1 .. step``; NaN before the start.
        ids: (N,) ids of the road users that are on the scene now.
        kinds: N kinds.
        size: (N, 2) length and width, m.
        states: (N, H, 4) road-user states at the same steps; NaN where not ``valid``.
        valid: (N, H) whether the road user was on the scene; the last column is all True.
        road_map: The map.
        task: Start, goal and route.
    """

    step: int
    dt: float
    ego: FloatArray
    ego_history: FloatArray
    ids: IntArray
    kinds: tuple[RoadUserKind, ...]
    size: FloatArray
    states: FloatArray
    valid: BoolArray
    road_map: RoadMap
    task: PlanningTask

    def __post_init__(self) -> None:
        _frozen(self, "ego", np.float64, (EGO_SIZE,), finite=True)
        _frozen(self, "ego_history", np.float64, (None, EGO_SIZE))
        h = len(self.ego_history)
        _frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        _frozen(self, "size", np.float64, (n, 2), finite=True)
        _frozen(self, "states", np.float64, (n, h, USER_SIZE))
        _frozen(self, "valid", np.bool_, (n, h))
        if len(self.kinds) != n:
            raise ShapeError(f"Observation.kinds has {len(self.kinds)} entries, expected {n}")
        if not np.all(self.valid[:, -1]):
            raise ShapeError("Observation.valid names a road user that is not on the scene now")

    @property
    def moves(self) -> BoolArray:
        """(N,) whether each road user can move at all, see ``RoadUserKind.moves``."""
        return np.array([kind.moves for kind in self.kinds], dtype=np.bool_)


@dataclass(frozen=True)
class Occupancy:
    """Where road users will be: one ellipse for each road user's **centre** and future step.

    Column ``t`` of the arrays stands for step ``observation.step + 1 + t``.

    Attributes:
        ids: (N,) ids of the road users.
        centre: (N, T, 2) predicted centre, m.
        semi_axes: (N, T, 2) semi-axes of the ellipse, m; zero means the centre itself.
        angle: (N, T) direction of the first semi-axis, rad.
        valid: (N, T) whether the road user is predicted to be on the scene.
        footprint: (N, 2) length and width of the road user, m.
        heading: (N, T) predicted heading of the road user, rad.
    """

    ids: IntArray
    centre: FloatArray
    semi_axes: FloatArray
    angle: FloatArray
    valid: BoolArray
    footprint: FloatArray
    heading: FloatArray

    def __post_init__(self) -> None:
        _frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        _frozen(self, "centre", np.float64, (n, None, 2))
        t = self.centre.shape[1]
        _frozen(self, "semi_axes", np.float64, (n, t, 2))
        _frozen(self, "angle", np.float64, (n, t))
        _frozen(self, "valid", np.bool_, (n, t))
        _frozen(self, "footprint", np.float64, (n, 2), finite=True)
        _frozen(self, "heading", np.float64, (n, t))
        for field in ("centre", "semi_axes", "angle", "heading"):
            if not np.all(np.isfinite(getattr(self, field)[self.valid])):
                raise ShapeError(f"Occupancy.{field} holds a NaN or an infinite value where valid")
        if np.any(self.semi_axes[self.valid] < 0):
            raise ShapeError("Occupancy.semi_axes holds a negative length")

    @property
    def horizon(self) -> int:
        """Number T of predicted steps."""
        return int(self.centre.shape[1])

    def without_sets(self) -> Self:
        """The same predicted positions with semi-axes of zero: the *without DOS* arm."""
        return replace(self, semi_axes=np.zeros_like(self.semi_axes))


class SolveStatus(Enum):
    """How a plan came about, with what a reader can do about it.

    The value is the word that is stored in results; ``advice`` says what to do.
    """

    SOLVED = ("solved", "Nothing to do.")
    ACCEPTED = (
        "accepted",
        "The solver stopped early, but the residuals of its iterate are small enough to drive. "
        "Raise max_iter if this is frequent.",
    )
    MAX_ITERATIONS = (
        "max_iterations",
        "The solver ran out of iterations with large residuals; the fallback was driven. "
        "Raise max_iter or look at the initial guess.",
    )
    SOLVER_ERROR = (
        "solver_error",
        "The solver returned NaN or raised; the fallback was driven. "
        "Look at the scaling of the scene and at the initial guess.",
    )
    NOT_OPTIMISED = ("not_optimised", "The planner does not solve an optimisation problem.")

    def __init__(self, word: str, advice: str) -> None:
        self.word = word
        self.advice = advice

    @property
    def failed(self) -> bool:
        """Whether the solver was asked for a plan and gave none."""
        return self in (SolveStatus.MAX_ITERATIONS, SolveStatus.SOLVER_ERROR)


@dataclass(frozen=True)
class SolveReport:
    """How one plan was found.

    Attributes:
        status: What the solver said.
        iterations: Iterations over all solves of this cycle.
        seconds: Wall-clock time inside the solver, s.
        slack: Largest slack of a set constraint in the plan, in normalised set distance.
        active_ids: Ids of the road users whose sets touch the plan.
        fallback: Name of the fallback that was driven, or None.
        road_slack: How far the plan leaves the road, by the planner's own reckoning, m.
    """

    status: SolveStatus = SolveStatus.NOT_OPTIMISED
    iterations: int = 0
    seconds: float = 0.0
    slack: float = 0.0
    active_ids: tuple[int, ...] = ()
    fallback: str | None = None
    road_slack: float = 0.0

    def __post_init__(self) -> None:
        checks = (
            ("status", isinstance(self.status, SolveStatus), "a SolveStatus"),
            ("iterations", _whole(self.iterations) and self.iterations >= 0, "an integer >= 0"),
            ("seconds", _finite(self.seconds), "a finite number"),
            ("slack", _finite(self.slack), "a finite number"),
            (
                "active_ids",
                isinstance(self.active_ids, tuple) and all(map(_whole, self.active_ids)),
                "a tuple of integers",
            ),
            ("fallback", isinstance(self.fallback, str | None), "a name or None"),
            ("road_slack", _finite(self.road_slack), "a finite number"),
        )
        for field, holds, wanted in checks:
            if not holds:
                raise ShapeError(
                    f"SolveReport.{field} is {getattr(self, field)!r}, expected {wanted}"
                )


@dataclass(frozen=True)
class Plan:
    """A trajectory for the ego from now on.

    Attributes:
        states: (T + 1, 5) ego states, the present one first.
        inputs: (T, 2) steering rate, rad/s, and acceleration, m/s2, held for a step each.
        report: How it was found.
    """

    states: FloatArray
    inputs: FloatArray
    report: SolveReport = SolveReport()

    def __post_init__(self) -> None:
        _frozen(self, "inputs", np.float64, (None, 2), finite=True)
        _frozen(self, "states", np.float64, (len(self.inputs) + 1, EGO_SIZE), finite=True)
        if len(self.inputs) == 0:
            raise ShapeError("Plan.inputs is empty: a plan needs one step at least")
        if not isinstance(self.report, SolveReport):
            raise ShapeError(f"Plan.report is {self.report!r}, expected a SolveReport")


class EpisodeEnd(StrEnum):
    """Why the simulation stopped."""

    GOAL_REACHED = "goal_reached"
    TIME_OVER = "time_over"
    PLANNER_FAILURE = "planner_failure"


@dataclass(frozen=True)
class Episode:
    """Everything that happened in one closed-loop run.

    Attributes:
        scenario_id: Id of the scenario.
        arm: Which arm was driven.
        start_step: Step of the first state.
        states: (K + 1, 5) driven ego states.
        inputs: (K, 2) inputs that were applied.
        end: Why the simulation stopped.
        predict_seconds: (C,) wall-clock time of each prediction, s; C planning cycles.
        plan_seconds: (C,) wall-clock time of each plan, s.
        plans: The C plans.
        occupancies: The C occupancies that were handed to the planner.
        cycle_steps: (C,) step at which each cycle ran.
        error: What went wrong, where ``end`` is ``PLANNER_FAILURE``.
    """

    scenario_id: str
    arm: Arm
    start_step: int
    states: FloatArray
    inputs: FloatArray
    end: EpisodeEnd
    predict_seconds: FloatArray
    plan_seconds: FloatArray
    plans: tuple[Plan, ...]
    occupancies: tuple[Occupancy, ...]
    cycle_steps: IntArray
    error: str | None = None

    def __post_init__(self) -> None:
        _frozen(self, "inputs", np.float64, (None, 2), finite=True)
        _frozen(self, "states", np.float64, (len(self.inputs) + 1, EGO_SIZE), finite=True)
        c = len(self.plans)
        _frozen(self, "predict_seconds", np.float64, (c,))
        _frozen(self, "plan_seconds", np.float64, (c,))
        _frozen(self, "cycle_steps", np.int64, (c,))
        if len(self.occupancies) != c:
            raise ShapeError(
                f"Episode.occupancies has {len(self.occupancies)} entries, expected {c}"
            )


class Outcome(StrEnum):
    """What became of an episode: the first that applies, in this order."""

    COLLISION = "collision"
    OUT_OF_BOUNDS = "out_of_bounds"
    PLANNER_FAILURE = "planner_failure"
    GOAL_MISSED = "goal_missed"
    SUCCESS = "success"


class CollisionClass(StrEnum):
    """nuPlan's classes of a collision, in the order they are tried."""

    STOPPED_EGO = "stopped_ego"
    STOPPED_TRACK = "stopped_track"
    ACTIVE_REAR = "active_rear"
    ACTIVE_FRONT = "active_front"
    ACTIVE_LATERAL = "active_lateral"


@dataclass(frozen=True)
class Score:
    """Outcome and metrics of one episode: the columns of a row of ``scenarios.jsonl``.

    Attributes:
        scenario: Id of the scenario.
        arm: The arm.
        outcome: What became of the episode.
        safe: Driven to the end without collision and within bounds (the paper's success).
        at_fault: Whether the ego is to blame for a collision; False without one.
        collision_class: Class of the first collision, or None.
        collision_with: Id of the road user of the first collision, or None.
        collision_step: Step of the first contact, or None.
        out_of_bounds_step: First step off the drivable area, or None.
        goal_step: Step at which the goal was reached, or None.
        velocity: Mean ego speed over the steps driven, m/s.
        progress: Distance driven along the reference path, m.
        steps: Steps driven.
        comfortable: Whether every one of nuPlan's comfort bounds holds.
        max_abs_acceleration: Largest |longitudinal acceleration|, m/s2.
        max_abs_lateral_acceleration: Largest |lateral acceleration|, m/s2.
        max_abs_jerk: Largest |longitudinal jerk|, m/s3.
        min_time_to_collision: Smallest time to collision under constant velocities, s;
            None where none is below the horizon that is looked at.
        cycle_ms_p50: Median time of a full cycle (predict and plan), ms.
        cycle_ms_p99: 99th percentile of it, ms.
        fallback_cycles: Cycles in which a fallback was driven.
        error: What went wrong in a planner failure, or None.

    The solver's columns are None where no cycle ran, and in rows of versions without them:

        iterations_p50: Median of the solver's iterations in a cycle.
        iterations_max: The most of them in a cycle.
        max_slack: Largest slack of a set constraint, in normalised set distance.
        slack_cycles: Cycles whose plan enters a set (``dosplan.telemetry.SLACK_SEEN``).
        max_road_slack: How far a plan leaves the road at most, m.
        solver_failures: Cycles in which the solver gave no plan.
    """

    scenario: str
    arm: Arm
    outcome: Outcome
    safe: bool
    at_fault: bool
    collision_class: CollisionClass | None
    collision_with: int | None
    collision_step: int | None
    out_of_bounds_step: int | None
    goal_step: int | None
    velocity: float
    progress: float
    steps: int
    comfortable: bool
    max_abs_acceleration: float
    max_abs_lateral_acceleration: float
    max_abs_jerk: float
    min_time_to_collision: float | None
    cycle_ms_p50: float | None
    cycle_ms_p99: float | None
    fallback_cycles: int
    error: str | None
    iterations_p50: float | None = None
    iterations_max: int | None = None
    max_slack: float | None = None
    slack_cycles: int | None = None
    max_road_slack: float | None = None
    solver_failures: int | None = None
