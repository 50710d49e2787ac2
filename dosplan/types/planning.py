"""The values of one planning cycle: observation, prediction and plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from numbers import Integral, Real
from typing import Final, Self

import numpy as np

from dosplan.types.arrays import (
    EGO_COLUMNS,
    EGO_SIZE,
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    BoolArray,
    FloatArray,
    IntArray,
    ShapeError,
    derived,
    frozen,
)
from dosplan.types.lights import LightStates
from dosplan.types.road import RoadMap
from dosplan.types.scenario import PlanningTask, RoadUserKind

HISTORY_STEPS: Final = 31
"""Steps of the past that a predictor sees, the present one included: 3 s."""
WEIGHT_TOLERANCE: Final = 1e-6  # By which the weights of a union may miss a sum of 1.


@dataclass(frozen=True)
class Observation:
    """What a planner and a predictor may know at a step. The future is unreachable from it.

    In an imperfect loop (``docs/loop.md``) road users are as the ego's sensors see them, and what
    is planned acts only later. A planner then gets an observation of the step at which its plan
    will act: ``step`` and ``ego`` are of that moment, and the road users and lights are those
    that were seen ``delay`` steps before. A predictor gets what was seen, with a ``delay`` of 0;
    what it predicts is shifted to the planner's step.

    Attributes:
        step: The present step.
        dt: Step, s.
        ego: (5,) ego state now.
        ego_history: (H, 5) ego states at steps ``step - H + 1 .. step``; NaN before the start.
        ids: (N,) ids of the road users that are seen.
        kinds: N kinds.
        size: (N, 2) length and width, m.
        states: (N, H, 4) road-user states at steps ``seen_step - H + 1 .. seen_step``; NaN where
            not ``valid``.
        valid: (N, H) whether the road user was seen; the last column is all True.
        road_map: The map.
        task: Start, goal and route.
        lights: What every traffic light showed at ``seen_step``, and for how long it had.
        delay: Steps since the road users were seen.
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
    lights: LightStates = field(default_factory=LightStates)
    delay: int = 0

    def __post_init__(self) -> None:
        frozen(self, "ego", np.float64, (EGO_SIZE,), finite=True)
        frozen(self, "ego_history", np.float64, (None, EGO_SIZE))
        h = len(self.ego_history)
        frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        frozen(self, "size", np.float64, (n, 2), finite=True)
        frozen(self, "states", np.float64, (n, h, USER_SIZE))
        frozen(self, "valid", np.bool_, (n, h))
        if len(self.kinds) != n:
            raise ShapeError(f"Observation.kinds has {len(self.kinds)} entries, expected {n}")
        if not np.all(self.valid[:, -1]):
            raise ShapeError("Observation.valid names a road user that is not on the scene now")

    @property
    def moves(self) -> BoolArray:
        """(N,) whether each road user can move at all, see ``RoadUserKind.moves``."""
        return np.array([kind.moves for kind in self.kinds], dtype=np.bool_)

    @property
    def seen_step(self) -> int:
        """The step at which the road users were seen; ``step`` in the ideal loop."""
        return self.step - self.delay

    @property
    def present(self) -> FloatArray:
        """(N, 4) road-user states at ``step``: those seen last, carried on at constant velocity."""
        states = np.array(self.states[:, -1])
        if self.delay:
            heading, way = states[:, USER_HEADING], states[:, USER_VELOCITY] * self.delay * self.dt
            states[:, USER_X] += way * np.cos(heading)
            states[:, USER_Y] += way * np.sin(heading)
        return states


@dataclass(frozen=True)
class SetUnion:
    """Several sets for each road user and step: one ellipse for each thing that it may do.

    The road user is predicted to be in any of them. A component is one course of events, so its
    number m stands for the same one at every step. A component of weight zero is not there: it
    fills the arrays of a road user that has fewer than others, and no reader looks at it.

    Attributes:
        weight: (N, M) probability of each component; they sum to 1 for each road user.
        centre: (N, M, T, 2) predicted centre, m.
        semi_axes: (N, M, T, 2) semi-axes of the ellipses, m; zero means the centre itself.
        angle: (N, M, T) direction of the first semi-axis, rad.
        heading: (N, M, T) predicted heading of the road user, rad.
    """

    weight: FloatArray
    centre: FloatArray
    semi_axes: FloatArray
    angle: FloatArray
    heading: FloatArray

    def __post_init__(self) -> None:
        frozen(self, "weight", np.float64, (None, None), finite=True)
        n, m = self.weight.shape
        if m == 0:
            raise ShapeError(f"SetUnion.weight has shape ({n}, 0); a union needs one component")
        frozen(self, "centre", np.float64, (n, m, None, 2))
        t = self.centre.shape[2]
        frozen(self, "semi_axes", np.float64, (n, m, t, 2))
        frozen(self, "angle", np.float64, (n, m, t))
        frozen(self, "heading", np.float64, (n, m, t))
        if np.any(self.weight < 0.0):
            raise ShapeError("SetUnion.weight holds a negative weight")
        total = self.weight.sum(axis=1)
        wrong = np.flatnonzero(np.abs(total - 1.0) > WEIGHT_TOLERANCE)
        if len(wrong):
            raise ShapeError(
                f"SetUnion.weight sums to {total[wrong[0]]:g} in row {wrong[0]}, expected 1"
            )

    @property
    def count(self) -> int:
        """Number M of components."""
        return int(self.weight.shape[1])

    @property
    def horizon(self) -> int:
        """Number T of predicted steps."""
        return int(self.centre.shape[2])

    @property
    def present(self) -> BoolArray:
        """(N, M) whether each component is there: its weight is above zero."""
        return self.weight > 0.0

    @property
    def likeliest(self) -> IntArray:
        """(N,) number of the component of the largest weight; the first of several."""
        return np.asarray(np.argmax(self.weight, axis=1))

    def of_steps(self, steps: slice | IntArray) -> Self:
        """The same for some steps only.

        Args:
            steps: Which.

        Returns:
            These columns of every array.
        """
        parts = ("centre", "semi_axes", "angle", "heading")
        return derived(self, **{name: getattr(self, name)[:, :, steps] for name in parts})

    def of_users(self, rows: IntArray | BoolArray) -> Self:
        """The same for some road users only.

        Args:
            rows: Which.

        Returns:
            These rows of every array.
        """
        parts = ("weight", "centre", "semi_axes", "angle", "heading")
        return derived(self, **{name: getattr(self, name)[rows] for name in parts})


@dataclass(frozen=True)
class Occupancy:
    """Where road users will be: a set for each road user's **centre** and future step.

    The set is an ellipse, or a union of ellipses. A reader of ``centre``, ``semi_axes`` and
    ``angle`` alone is on the safe side: with a union, these are one ellipse that covers those of
    the union (``dosplan.geometry.occupancy_of_union`` makes it), and ``heading`` is that of the
    most likely component. A reader that knows unions goes over ``by_component()``, where an
    occupancy without a union has one component for each road user.

    Column ``t`` of the arrays stands for step ``observation.step + 1 + t``.

    Attributes:
        ids: (N,) ids of the road users.
        centre: (N, T, 2) predicted centre, m.
        semi_axes: (N, T, 2) semi-axes of the ellipse, m; zero means the centre itself.
        angle: (N, T) direction of the first semi-axis, rad.
        valid: (N, T) whether the road user is predicted to be on the scene.
        footprint: (N, 2) length and width of the road user, m.
        heading: (N, T) predicted heading of the road user, rad.
        union: The ellipses of each set where it is a union of several; None where the ellipse
            above is the set.
    """

    ids: IntArray
    centre: FloatArray
    semi_axes: FloatArray
    angle: FloatArray
    valid: BoolArray
    footprint: FloatArray
    heading: FloatArray
    union: SetUnion | None = None

    def __post_init__(self) -> None:
        frozen(self, "ids", np.int64, (None,))
        n = len(self.ids)
        frozen(self, "centre", np.float64, (n, None, 2))
        t = self.centre.shape[1]
        frozen(self, "semi_axes", np.float64, (n, t, 2))
        frozen(self, "angle", np.float64, (n, t))
        frozen(self, "valid", np.bool_, (n, t))
        frozen(self, "footprint", np.float64, (n, 2), finite=True)
        frozen(self, "heading", np.float64, (n, t))
        for name in ("centre", "semi_axes", "angle", "heading"):
            if not np.all(np.isfinite(getattr(self, name)[self.valid])):
                raise ShapeError(f"Occupancy.{name} holds a NaN or an infinite value where valid")
        if np.any(self.semi_axes[self.valid] < 0):
            raise ShapeError("Occupancy.semi_axes holds a negative length")
        if self.union is not None:
            self._check_union(self.union)

    def _check_union(self, union: SetUnion) -> None:
        if not isinstance(union, SetUnion):
            raise ShapeError(f"Occupancy.union is {union!r}, expected a SetUnion or None")
        n, t = self.valid.shape
        have = (len(union.weight), union.horizon)
        if have != (n, t):
            raise ShapeError(
                f"Occupancy.union is of {have[0]} road users and {have[1]} steps, expected "
                f"{n} and {t}"
            )
        known = union.present[:, :, None] & self.valid[:, None]
        for name in ("centre", "semi_axes", "angle", "heading"):
            if not np.all(np.isfinite(getattr(union, name)[known])):
                raise ShapeError(
                    f"Occupancy.union.{name} holds a NaN or an infinite value where valid"
                )
        if np.any(union.semi_axes[known] < 0):
            raise ShapeError("Occupancy.union.semi_axes holds a negative length")

    @classmethod
    def from_trajectory(
        cls,
        observation: Observation,
        centre: FloatArray,
        heading: FloatArray,
        semi_axes: FloatArray | None = None,
        angle: FloatArray | None = None,
        valid: BoolArray | None = None,
    ) -> Self:
        """Sets around the predicted trajectories of all road users that are on the scene now.

        Args:
            observation: What the prediction was made from; N road users.
            centre: (N, T, 2) predicted centres, m.
            heading: (N, T) predicted headings, rad.
            semi_axes: (N, T, 2) semi-axes, m; None for points.
            angle: (N, T) direction of the first semi-axis, rad; None for that of the heading.
            valid: (N, T) where there is a prediction; None for everywhere.

        Returns:
            The sets.

        Raises:
            ShapeError: The shapes do not match, or a value is not finite where valid.
        """
        return cls(
            ids=observation.ids,
            centre=centre,
            semi_axes=np.zeros_like(centre) if semi_axes is None else semi_axes,
            angle=heading if angle is None else angle,
            valid=np.ones_like(heading, dtype=np.bool_) if valid is None else valid,
            footprint=observation.size,
            heading=heading,
        )

    @property
    def horizon(self) -> int:
        """Number T of predicted steps."""
        return int(self.centre.shape[1])

    def first_steps(self, count: int) -> Self:
        """The same for the first steps only.

        Args:
            count: Number of steps to keep; of fewer, all are kept.

        Returns:
            The first columns of every array.
        """
        return self if count >= self.horizon else self.of_steps(slice(count))

    def later(self, steps: int) -> Self:
        """The same as it is for a planner that acts some steps after what was observed.

        Args:
            steps: Number of steps by which column 0 moves on.

        Returns:
            Every array without its first columns.
        """
        return self if steps == 0 else self.of_steps(slice(steps, None))

    def of_steps(self, steps: slice | IntArray) -> Self:
        """The same for some steps only.

        Args:
            steps: Which.

        Returns:
            These columns of every array.
        """
        parts = ("centre", "semi_axes", "angle", "valid", "heading")
        union = None if self.union is None else self.union.of_steps(steps)
        return derived(self, union=union, **{name: getattr(self, name)[:, steps] for name in parts})

    def of_users(self, rows: IntArray | BoolArray) -> Self:
        """The same for some road users only.

        Args:
            rows: Which.

        Returns:
            These rows of every array.
        """
        parts = ("ids", "centre", "semi_axes", "angle", "valid", "footprint", "heading")
        union = None if self.union is None else self.union.of_users(rows)
        return derived(self, union=union, **{name: getattr(self, name)[rows] for name in parts})

    def without_sets(self) -> Self:
        """The predicted positions with semi-axes of zero: the *without DOS* arm.

        Returns:
            Points where the ellipses were; of a union, those of the most likely component.
        """
        likeliest = self.likeliest()
        return derived(likeliest, semi_axes=np.zeros_like(self.semi_axes))

    @property
    def components(self) -> SetUnion:
        """The sets as unions: where there is no union, of one component of weight 1 each."""
        if self.union is not None:
            return self.union
        parts = ("centre", "semi_axes", "angle", "heading")
        return SetUnion(
            weight=np.ones((len(self.ids), 1)),
            **{name: getattr(self, name)[:, None] for name in parts},
        )

    def likeliest(self) -> Self:
        """The most likely component of every union.

        Returns:
            An occupancy of one ellipse each; itself where there is no union.
        """
        union = self.union
        if union is None:
            return self
        which = np.arange(len(self.ids)), union.likeliest
        parts = ("centre", "semi_axes", "angle", "heading")
        return derived(self, union=None, **{name: getattr(union, name)[which] for name in parts})

    def by_component(self) -> tuple[Self, IntArray, FloatArray]:
        """Every component as a road user of its own.

        Returns:
            An occupancy of one ellipse for each of R components, those of one road user one after
            another, the most likely one first, so that its id is there several times; (R,) the row
            of the road user here; (R,) the component's weight. Without a union that is itself,
            every row, and ones.
        """
        union = self.union
        if union is None:
            return self, np.arange(len(self.ids)), np.ones(len(self.ids))
        order = np.argsort(-union.weight, axis=1, kind="stable")
        rows, rank = np.nonzero(np.take_along_axis(union.present, order, axis=1))
        which = order[rows, rank]
        parts = ("centre", "semi_axes", "angle", "heading")
        spread = derived(
            self,
            ids=self.ids[rows],
            valid=self.valid[rows],
            footprint=self.footprint[rows],
            union=None,
            **{name: getattr(union, name)[rows, which] for name in parts},
        )
        return spread, rows, union.weight[rows, which]


class SolveStatus(Enum):
    """How a plan was found, with advice for the user.

    The value is the word that is stored in results; ``advice`` says what to do.
    """

    SOLVED = ("solved", "Nothing to do.")
    ACCEPTED = (
        "accepted",
        "The solver stopped early, but the residuals of its iterate are small enough to drive. "
        "Give it more iterations if this is frequent.",
    )
    MAX_ITERATIONS = (
        "max_iterations",
        "The solver ran out of iterations with large residuals; the fallback was driven. "
        "Give it more iterations, or look at the initial guess.",
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
        """Whether the solver failed to give a plan."""
        return self in (SolveStatus.MAX_ITERATIONS, SolveStatus.SOLVER_ERROR)


def _whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _finite(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


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
        road_slack: How far the plan leaves the road, as the planner itself computes it, m.
        waits_for: Why the ego stops, or will, in a few words, such as ``light 31``; None where no
            rule asks for it or the planner does not say.
        unreachable: Why no goal can be reached from here, in a few words that say what is missing
            and by how much; None where one can or the planner does not say.
        decision: What the planner has decided to do, in a few words, such as ``change lanes behind
            17``; None where there is nothing to decide or the planner does not say.
    """

    status: SolveStatus = SolveStatus.NOT_OPTIMISED
    iterations: int = 0
    seconds: float = 0.0
    slack: float = 0.0
    active_ids: tuple[int, ...] = ()
    fallback: str | None = None
    road_slack: float = 0.0
    waits_for: str | None = None
    unreachable: str | None = None
    decision: str | None = None

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
            ("waits_for", isinstance(self.waits_for, str | None), "a text or None"),
            ("unreachable", isinstance(self.unreachable, str | None), "a text or None"),
            ("decision", isinstance(self.decision, str | None), "a text or None"),
        )
        for name, holds, wanted in checks:
            if not holds:
                raise ShapeError(
                    f"SolveReport.{name} is {getattr(self, name)!r}, expected {wanted}"
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
        frozen(self, "inputs", np.float64, (None, 2), finite=True)
        shape = (len(self.inputs) + 1, EGO_SIZE)
        frozen(self, "states", np.float64, shape, finite=True, columns=EGO_COLUMNS)
        if len(self.inputs) == 0:
            raise ShapeError("Plan.inputs is empty: a plan needs one step at least")
        if not isinstance(self.report, SolveReport):
            raise ShapeError(f"Plan.report is {self.report!r}, expected a SolveReport")
