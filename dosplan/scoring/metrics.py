"""The metrics: one entry each, from which rows, summaries, comparisons, tables and docs follow.

To add a metric, add an entry to ``METRICS``: nothing else in the code names metrics one by one. An
entry reads its value from what a row says anyway (``read``), or measures it on the scored part of
an episode (``measure``); a measured value is a column of the row, of the metric's name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from dosplan.scoring.bounds import outside_lanelets
from dosplan.scoring.comfort import (
    MAX_LATERAL_ACCELERATION,
    MAX_LONGITUDINAL_JERK,
    MIN_ACCELERATION,
)
from dosplan.types import (
    DrivenEpisode,
    FloatArray,
    IntArray,
    Measure,
    Outcome,
    Scenario,
    Score,
    Signals,
    SolveReport,
    SolveStatus,
    Tracks,
)

SLACK_SEEN: Final = 1e-3
"""Slack above which a plan enters a set. A solver's error in a slack of zero is far smaller:
of 3244 recorded cycles of ``mpc-v1``, 2962 end below 1e-5 and 282 above this."""


@dataclass(frozen=True)
class ScoredPart:
    """The part of an episode that is scored: from its start to contact, goal or end.

    Attributes:
        scenario: The scenario.
        episode: The whole episode.
        tracks: The road users as they were driven.
        states: (K + 1, 5) ego states of the part.
        ego: (K + 1, 4) x, y, heading, velocity of the ego's centre.
        cycles: Indices of the planning cycles that a step of the part follows.
    """

    scenario: Scenario
    episode: DrivenEpisode
    tracks: Tracks
    states: FloatArray
    ego: FloatArray
    cycles: IntArray

    @property
    def signals(self) -> Signals:
        """The traffic lights as they were in the episode, at the steps of the scenario."""
        own = self.episode.signals
        return self.scenario.signals if own is None else own

    @property
    def reports(self) -> list[SolveReport]:
        """The planner's reports of ``cycles``."""
        reports = self.episode.reports
        return [reports[cycle] for cycle in self.cycles]


class Aggregate(StrEnum):
    """How the values of the episodes become one figure of an arm.

    An episode without a value (None) takes no part; the denominator is the episodes that have one.
    """

    SHARE = "share"
    MEAN = "mean"
    LARGEST = "largest"
    CYCLES_P50 = "median of all cycles"
    CYCLES_P99 = "99th percentile of all cycles"

    @property
    def percentile(self) -> float | None:
        """Which percentile of the cycle times it is, or None where it is not about cycles."""
        return {Aggregate.CYCLES_P50: 50.0, Aggregate.CYCLES_P99: 99.0}.get(self)


class Better(StrEnum):
    """Which way is better."""

    HIGHER = "higher"
    LOWER = "lower"
    NEITHER = "-"


class Group(StrEnum):
    """The table in which a metric stands, in the order in which the tables are shown."""

    MAIN = "main"
    OUTCOME = "outcome"
    RIDE = "ride"
    COMFORT = "comfort"
    SOLVER = "solver"


@dataclass(frozen=True)
class Metric:
    """A metric; exactly one of ``read`` and ``measure`` is given.

    Attributes:
        name: Its name, unique: its column where it is measured, its key in a comparison.
        title: Its title.
        short: Its title in a table.
        unit: Its unit; ``%`` for a share, which is kept between 0 and 1; empty for a count.
        definition: What it is, in a sentence without its stop.
        aggregate: How the values of the episodes become one.
        group: The table in which it stands.
        better: Which way is better.
        read: Reads it from a row; None where the episode has no value.
        measure: Measures it; None likewise.
        kind: Type of what ``measure`` gives.
        digits: Decimals that are shown.
        plotted: Whether pages draw its distribution over the episodes.
        bounds: Values that such a drawing marks.
    """

    name: str
    title: str
    short: str
    unit: str
    definition: str
    aggregate: Aggregate
    group: Group
    better: Better
    read: Callable[[Score], Measure] | None = None
    measure: Callable[[ScoredPart], Measure] | None = None
    kind: type[bool | int | float] = float
    digits: int = 2
    plotted: bool = False
    bounds: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if (self.read is None) == (self.measure is None):
            raise ValueError(f"metric {self.name}: give either read or measure")

    @property
    def is_share(self) -> bool:
        """Whether it is a share of episodes: then arms are compared as paired proportions.

        All others are compared by the paired means of the episodes' values.
        """
        return self.aggregate is Aggregate.SHARE

    @property
    def key(self) -> str:
        """Its key in a summary."""
        return f"{self.name}_rate" if self.is_share else self.name

    @property
    def scale(self) -> float:
        """What its values are multiplied by to be shown."""
        return 100.0 if self.unit == "%" else 1.0

    @property
    def heading(self) -> str:
        """Heading of its column in a table."""
        return f"{self.short} {self.unit}".rstrip()

    @property
    def long_heading(self) -> str:
        """Its title with its unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    def value(self, row: Score) -> Measure:
        """Its value in an episode.

        Args:
            row: The episode's row.

        Returns:
            The value, or None where the episode has none. What is unusable never has one: here, and
            here alone, it drops out of every share, mean and comparison.
        """
        if row.outcome is Outcome.UNUSABLE:
            return None
        return row.measures.get(self.name) if self.read is None else self.read(row)

    def values(self, rows: Sequence[Score]) -> FloatArray:
        """Its values in those episodes that have one.

        Args:
            rows: Rows of episodes.

        Returns:
            (V,) values in the order of the rows; a verdict is 0 or 1.
        """
        found = (self.value(row) for row in rows)
        return np.array([value for value in found if value is not None], dtype=np.float64)

    def summarise(self, rows: Sequence[Score], cycle_ms: FloatArray) -> float | None:
        """Its figure over the episodes of an arm.

        Args:
            rows: Their rows.
            cycle_ms: (C,) times of all their planning cycles, ms.

        Returns:
            The figure, or None where nothing has a value.
        """
        percentile = self.aggregate.percentile
        values = self.values(rows) if percentile is None else cycle_ms
        if not len(values):
            return None
        if percentile is not None:
            return float(np.percentile(values, percentile))
        return float(values.max() if self.aggregate is Aggregate.LARGEST else values.mean())

    def shown(self, value: float | None, sign: str = "") -> str:
        """Writes a figure of it.

        Args:
            value: The figure.
            sign: ``+`` to write the sign of what is positive, too.

        Returns:
            The figure without its unit; ``-`` for None.
        """
        return "-" if value is None else f"{self.scale * value:{sign}.{self.digits}f}"


def _share(
    name: str,
    title: str,
    definition: str,
    holds: Callable[[Score], bool | None],
    better: Better,
    group: Group,
    short: str | None = None,
) -> Metric:
    """A share of episodes."""
    return Metric(
        name=name,
        title=title,
        short=title if short is None else short,
        unit="%",
        definition=definition,
        aggregate=Aggregate.SHARE,
        group=group,
        better=better,
        read=holds,
        digits=1,
    )


def _leaves_lanelets(part: ScoredPart) -> bool | None:
    """Whether the ego leaves the union of all lanelets; None where it drove no step."""
    if len(part.states) < 2:
        return None
    scenario = part.scenario
    size = scenario.task.vehicle.size
    return bool(outside_lanelets(part.ego[:, :3], size, scenario.road_map).any())


def _of_cycles(
    figure: Callable[[list[SolveReport]], float | int],
) -> Callable[[ScoredPart], float | int | None]:
    """A measure of the solver's reports; None where no cycle asked a solver."""

    def measure(part: ScoredPart) -> float | int | None:
        reports = [r for r in part.reports if r.status is not SolveStatus.NOT_OPTIMISED]
        return figure(reports) if reports else None

    return measure


METRICS: tuple[Metric, ...] = (
    _share(
        "success",
        "Success",
        "a goal is reached, on the road and without a collision",
        lambda row: row.outcome is Outcome.SUCCESS,
        Better.HIGHER,
        Group.MAIN,
    ),
    _share(
        "safe",
        "Safe (the paper's success)",
        "driven to the end without collision and within bounds",
        lambda row: row.safe,
        Better.HIGHER,
        Group.OUTCOME,
        short="Safe",
    ),
    _share(
        "collision",
        "Collision",
        "the ego's rectangle overlaps a road user's shape, at a step or between two",
        lambda row: row.outcome is Outcome.COLLISION,
        Better.LOWER,
        Group.MAIN,
    ),
    _share(
        "at_fault_collision",
        "At-fault collision",
        "a collision that the ego is to blame for, by nuPlan's classes",
        lambda row: row.at_fault,
        Better.LOWER,
        Group.OUTCOME,
    ),
    _share(
        "out_of_bounds",
        "Out of bounds",
        "part of the ego's rectangle is outside the drivable area, and no collision",
        lambda row: row.outcome is Outcome.OUT_OF_BOUNDS,
        Better.LOWER,
        Group.MAIN,
    ),
    _share(
        "goal_missed",
        "Goal missed",
        "driven to the end, but no goal is reached",
        lambda row: row.outcome is Outcome.GOAL_MISSED,
        Better.LOWER,
        Group.OUTCOME,
    ),
    _share(
        "planner_failure",
        "Planner failure",
        "an exception, a time-out, or no plan and no fallback",
        lambda row: row.outcome is Outcome.PLANNER_FAILURE,
        Better.LOWER,
        Group.OUTCOME,
    ),
    Metric(
        name="velocity",
        title="Velocity",
        short="Velocity",
        unit="m/s",
        definition="mean ego speed over the steps driven; episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.MAIN,
        better=Better.HIGHER,
        read=lambda row: row.velocity if row.steps else None,
        plotted=True,
    ),
    Metric(
        name="progress",
        title="Progress",
        short="Progress",
        unit="m",
        definition="distance driven along the reference path; episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.RIDE,
        better=Better.HIGHER,
        read=lambda row: row.progress if row.steps else None,
    ),
    _share(
        "comfortable",
        "Comfortable (nuPlan's bounds)",
        "every one of nuPlan's comfort bounds holds; episodes that drove a step",
        lambda row: row.comfortable if row.steps else None,
        Better.HIGHER,
        Group.RIDE,
        short="Comfortable",
    ),
    Metric(
        name="off_commonroad_road",
        title="Off the road as CommonRoad counts it",
        short="Off CommonRoad's road",
        unit="%",
        definition="part of the ego's rectangle is outside the union of all lanelets, whatever "
        "their type, at a step, also before a collision; an open end of the map is an edge; "
        "episodes that drove a step",
        aggregate=Aggregate.SHARE,
        group=Group.RIDE,
        better=Better.LOWER,
        measure=_leaves_lanelets,
        kind=bool,
        digits=1,
    ),
    Metric(
        name="min_time_to_collision",
        title="Smallest time to collision",
        short="Min TTC",
        unit="s",
        definition="smallest time to collision if everyone kept the velocity of a step; episodes "
        "in which it falls below 3 s",
        aggregate=Aggregate.MEAN,
        group=Group.RIDE,
        better=Better.HIGHER,
        read=lambda row: row.min_time_to_collision,
    ),
    Metric(
        name="cycle_ms_p50",
        title="Cycle time (median)",
        short="Cycle p50",
        unit="ms",
        definition="median time of a planning cycle, predict and plan; arms are compared by the "
        "medians of the episodes",
        aggregate=Aggregate.CYCLES_P50,
        group=Group.RIDE,
        better=Better.LOWER,
        read=lambda row: row.cycle_ms_p50,
        digits=1,
    ),
    Metric(
        name="cycle_ms_p99",
        title="Cycle time (99th percentile)",
        short="Cycle p99",
        unit="ms",
        definition="99th percentile of the time of a planning cycle; arms are compared by the "
        "percentiles of the episodes",
        aggregate=Aggregate.CYCLES_P99,
        group=Group.RIDE,
        better=Better.LOWER,
        read=lambda row: row.cycle_ms_p99,
        digits=1,
    ),
    Metric(
        name="max_abs_acceleration",
        title="Largest longitudinal acceleration",
        short="Acceleration",
        unit="m/s²",
        definition="largest size of the smoothed longitudinal acceleration; episodes that drove a "
        "step",
        aggregate=Aggregate.MEAN,
        group=Group.COMFORT,
        better=Better.LOWER,
        read=lambda row: row.max_abs_acceleration if row.steps else None,
        plotted=True,
        bounds=(-MIN_ACCELERATION,),
    ),
    Metric(
        name="max_abs_lateral_acceleration",
        title="Largest lateral acceleration",
        short="Lateral",
        unit="m/s²",
        definition="largest size of the smoothed lateral acceleration at the rear axle; episodes "
        "that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.COMFORT,
        better=Better.LOWER,
        read=lambda row: row.max_abs_lateral_acceleration if row.steps else None,
        plotted=True,
        bounds=(MAX_LATERAL_ACCELERATION,),
    ),
    Metric(
        name="max_abs_jerk",
        title="Largest longitudinal jerk",
        short="Jerk",
        unit="m/s³",
        definition="largest size of the smoothed longitudinal jerk; episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.COMFORT,
        better=Better.LOWER,
        read=lambda row: row.max_abs_jerk if row.steps else None,
        plotted=True,
        bounds=(MAX_LONGITUDINAL_JERK,),
    ),
    Metric(
        name="fallback_cycles",
        title="Cycles in which a fallback was driven",
        short="Fallback cycles",
        unit="",
        definition="planning cycles in which a fallback was driven; episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.SOLVER,
        better=Better.LOWER,
        read=lambda row: row.fallback_cycles if row.steps else None,
    ),
    Metric(
        name="iterations_p50",
        title="Solver iterations (median)",
        short="Iterations",
        unit="",
        definition="median of the solver's iterations in a planning cycle; planners that optimise",
        aggregate=Aggregate.MEAN,
        group=Group.SOLVER,
        better=Better.LOWER,
        measure=_of_cycles(lambda reports: float(np.median([r.iterations for r in reports]))),
    ),
    Metric(
        name="iterations_max",
        title="Solver iterations (most)",
        short="Most iterations",
        unit="",
        definition="the most iterations of the solver in a planning cycle; planners that optimise",
        aggregate=Aggregate.LARGEST,
        group=Group.SOLVER,
        better=Better.LOWER,
        measure=_of_cycles(lambda reports: int(max(r.iterations for r in reports))),
        kind=int,
        digits=0,
    ),
    Metric(
        name="max_slack",
        title="Largest slack of a set",
        short="Slack",
        unit="",
        definition="largest slack of a set constraint, in normalised set distance; planners that "
        "optimise",
        aggregate=Aggregate.LARGEST,
        group=Group.SOLVER,
        better=Better.LOWER,
        measure=_of_cycles(lambda reports: float(max(r.slack for r in reports))),
    ),
    Metric(
        name="slack_cycles",
        title="Cycles whose plan enters a set",
        short="Slack cycles",
        unit="",
        definition=f"planning cycles whose plan enters a set, by a slack above {SLACK_SEEN:g}; "
        "planners that optimise",
        aggregate=Aggregate.MEAN,
        group=Group.SOLVER,
        better=Better.LOWER,
        measure=_of_cycles(lambda reports: sum(bool(r.slack > SLACK_SEEN) for r in reports)),
        kind=int,
    ),
    Metric(
        name="max_road_slack",
        title="Largest distance of a plan off the road",
        short="Road slack",
        unit="m",
        definition="how far a plan leaves the road at most; planners that optimise",
        aggregate=Aggregate.LARGEST,
        group=Group.SOLVER,
        better=Better.LOWER,
        measure=_of_cycles(lambda reports: float(max(r.road_slack for r in reports))),
    ),
    Metric(
        name="solver_failures",
        title="Cycles without a plan of the solver",
        short="Solver failures",
        unit="",
        definition="planning cycles in which the solver gave no plan; planners that optimise",
        aggregate=Aggregate.MEAN,
        group=Group.SOLVER,
        better=Better.LOWER,
        measure=_of_cycles(lambda reports: sum(r.status.failed for r in reports)),
        kind=int,
    ),
)
"""All metrics, in the order in which they are shown."""


def find_metric(name: str) -> Metric:
    """Finds a metric.

    Args:
        name: Its name.

    Returns:
        The metric.
    """
    return next(metric for metric in METRICS if metric.name == name)


def measured(part: ScoredPart) -> dict[str, Measure]:
    """Measures those metrics that are measured on the episode.

    Args:
        part: The scored part of the episode.

    Returns:
        Values by the metrics' names.
    """
    return {m.name: m.measure(part) for m in METRICS if m.measure is not None}


def measured_kinds() -> dict[str, type[bool | int | float]]:
    """The columns that measured metrics add to a row, with their types."""
    return {metric.name: metric.kind for metric in METRICS if metric.measure is not None}
