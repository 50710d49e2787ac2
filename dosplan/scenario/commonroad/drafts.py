"""What a CommonRoad file is made of, before ``dosplan.scenario.commonroad.writer`` writes it.

Ids are CommonRoad's: whole numbers that nothing else in the file has. Positions are in m,
headings in rad, times in steps of the file: of 0.1 s in those that are written whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from dosplan.types import FloatArray

AUTHOR = "The dosplan developers"
DATE = "2026-11-01"
"""The same in every file, so that its bytes do not depend on the day on which it was made."""


@dataclass
class LaneletDraft:
    """A lanelet to be written.

    Attributes:
        id: CommonRoad id.
        left: (P, 2) m.
        right: (P, 2) m.
        kind: CommonRoad lanelet type.
        users: CommonRoad types of the road users that drive here in the lanelet's direction.
        speed: Limit, m/s, or None.
        both_ways: Types of the road users that use it in both directions.
        successors: Ids.
        predecessors: Ids.
        adjacent_left: Id and whether it has the same direction, or None.
        adjacent_right: The same on the right.
        lights: Ids of the signals at its end.
    """

    id: int
    left: FloatArray
    right: FloatArray
    kind: str
    users: tuple[str, ...]
    speed: float | None = None
    both_ways: tuple[str, ...] = ()
    successors: list[int] = field(default_factory=list)
    predecessors: list[int] = field(default_factory=list)
    adjacent_left: tuple[int, bool] | None = None
    adjacent_right: tuple[int, bool] | None = None
    lights: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class Light:
    """A signal.

    Attributes:
        id: CommonRoad id.
        position: (2,) m.
        direction: ``left``, ``straight``, ``right``, ..., or None where that is not known.
        cycle: Colour and duration in steps of each part of the cycle.
        offset: Steps from step 0 to the begin of a cycle, >= 0.
    """

    id: int
    position: FloatArray
    direction: str | None
    cycle: tuple[tuple[str, int], ...]
    offset: int = 0


@dataclass(frozen=True)
class Incoming:
    """A road into an intersection: its lanelets and theirs inside, by direction."""

    id: int
    lanelets: tuple[int, ...]
    inside: dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class Intersection:
    """A place where roads meet."""

    id: int
    incomings: tuple[Incoming, ...]
    crossings: tuple[int, ...]


@dataclass(frozen=True)
class LaneletMap:
    """A whole map; ``free_ids`` gives ids that nothing else in the file has."""

    lanelets: tuple[LaneletDraft, ...]
    lights: tuple[Light, ...]
    intersections: tuple[Intersection, ...]
    free_ids: Iterator[int]


@dataclass(frozen=True)
class UserDraft:
    """A road user.

    Attributes:
        kind: CommonRoad obstacle type.
        size: Length and width, m.
        first: Step of the first state.
        states: (K, 4) centre x, y, heading and velocity, step by step.
        static: Whether it stays where it is; its first state alone counts then.
        id: CommonRoad id, or None for the next free one.
    """

    kind: str
    size: tuple[float, float]
    first: int
    states: FloatArray
    static: bool = False
    id: int | None = None


@dataclass(frozen=True)
class Goal:
    """The goal of a planning problem.

    Attributes:
        length: Of the rectangle around the recorded arrival, along it, m.
        width: Across, m.
        heading_window: Half the width of the window of headings, rad, or None.
        velocity: Lower and upper velocity, m/s, or None.
    """

    length: float
    width: float
    heading_window: float | None
    velocity: tuple[float, float] | None


@dataclass(frozen=True)
class ProblemDraft:
    """A planning problem made from a drive.

    Attributes:
        drive: (K, 4) centre x, y, heading and velocity from the ego's start to its arrival.
        start: Step of the first of them.
        goal_first: First step at which the goal counts.
        goal_last: Last step at which it does.
        goal: The goal, around the last state of the drive.
    """

    drive: FloatArray
    start: int
    goal_first: int
    goal_last: int
    goal: Goal


@dataclass(frozen=True)
class Header:
    """The metadata of a file.

    Attributes:
        benchmark_id: CommonRoad id.
        source: Where it comes from.
        tags: CommonRoad tags.
    """

    benchmark_id: str
    source: str
    tags: frozenset[str]
