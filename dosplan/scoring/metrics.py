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

from dosplan.scoring import nuplan, progress, rules
from dosplan.scoring.bounds import outside_lanelets
from dosplan.scoring.comfort import (
    MAX_LATERAL_ACCELERATION,
    MAX_LONGITUDINAL_JERK,
    MIN_ACCELERATION,
)
from dosplan.scoring.commonroad_cost import COST_FUNCTIONS, commonroad_cost
from dosplan.scoring.imposed import imposed_braking
from dosplan.scoring.part import ScoredPart
from dosplan.types import FloatArray, Measure, Outcome, Score, SolveReport, SolveStatus

SLACK_SEEN: Final = 1e-3
"""Slack above which a plan enters a set. A solver's error in a slack of zero is far smaller:
of 3244 recorded cycles of ``mpc-v1``, 2962 end below 1e-5 and 282 above this."""


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

    @property
    def is_mean(self) -> bool:
        """Whether it is a mean over the episodes, as the difference of two arms is."""
        return self in (Aggregate.SHARE, Aggregate.MEAN)


class Better(StrEnum):
    """Which way is better."""

    HIGHER = "higher"
    LOWER = "lower"
    NEITHER = "-"


class Group(StrEnum):
    """The table in which a metric stands, in the order in which the tables are shown."""

    MAIN = "main"
    OUTCOME = "outcome"
    RULES = "rules"
    NUPLAN = "nuplan"
    RIDE = "ride"
    COMFORT = "comfort"
    COMMONROAD = "commonroad"
    SOLVER = "solver"

    @property
    def heading(self) -> str:
        """Heading of the table."""
        return _HEADINGS[self]


_HEADINGS: Final = {
    Group.MAIN: "Main figures",
    Group.OUTCOME: "Outcomes",
    Group.RULES: "Rules of the road",
    Group.NUPLAN: "nuPlan's score",
    Group.RIDE: "Ride",
    Group.COMFORT: "Largest of a drive",
    Group.COMMONROAD: "CommonRoad's costs",
    Group.SOLVER: "Planner",
}


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
        failed: What is measured where the planner failed before a step was driven.
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
    failed: Measure = None
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
            The value, or None where the episode has none. What is unusable, and a failure of the
            traffic, never has one, and drops out of every share and mean by that.
        """
        if not row.outcome.of_planner:
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
    if not part.drove:
        return None
    scenario = part.scenario
    size = scenario.task.vehicle.size
    return bool(outside_lanelets(part.ego[:, :3], size, scenario.road_map).any())


def _imposed_braking(part: ScoredPart) -> float | None:
    """How hard others had to brake for the ego; None where that cannot be told."""
    start = part.episode.start_step
    last = min(start + len(part.states), part.tracks.steps) - 1
    scenario, future = part.scenario, part.episode.future
    # Where a traffic has more futures than are recorded, they are of its own making.
    recorded = scenario.recorded(future if future <= len(scenario.futures) else 0)
    return imposed_braking(recorded, part.tracks, start, last, scenario.dt)


def _of_cycles(
    figure: Callable[[list[SolveReport]], float | int],
) -> Callable[[ScoredPart], float | int | None]:
    """A measure of the solver's reports; None where no cycle asked a solver."""

    def measure(part: ScoredPart) -> float | int | None:
        reports = [r for r in part.reports if r.status is not SolveStatus.NOT_OPTIMISED]
        return figure(reports) if reports else None

    return measure


def _progress_share(part: ScoredPart) -> float | None:
    """Share of the expected progress; None where no step was driven."""
    return progress.progress_ratio(part.progress, part.needed_progress) if part.drove else None


def _makes_progress(part: ScoredPart) -> bool | None:
    """Whether the ego makes progress; None where no step was driven, and none had to be."""
    if part.drove:
        return progress.makes_progress(part.progress, part.needed_progress)
    return False if part.outcome is Outcome.PLANNER_FAILURE else None


def _cost(name: str) -> Metric:
    """A cost function of CommonRoad."""
    terms = ", ".join(f"{weight:g} {term}" for term, weight in COST_FUNCTIONS[name].items())
    return Metric(
        name=f"cost_{name.lower()}",
        title=f"CommonRoad's cost {name}",
        short=name,
        unit="",
        definition=f"sum of partial costs: {terms}; episodes that succeed",
        aggregate=Aggregate.MEAN,
        group=Group.COMMONROAD,
        better=Better.LOWER,
        measure=lambda part: commonroad_cost(part, name),
    )


METRICS: tuple[Metric, ...] = (
    _share(
        "success",
        "Success",
        "a goal is reached, on the road and without a collision; one that is a time alone only by "
        "making progress",
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
        "a collision that the ego is to blame for, by nuPlan's classes, or by a cut-in before "
        "somebody who reacts",
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
        "driven to the end, but no goal is reached, or one that is a time alone without making "
        "progress",
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
        name="red_lights",
        title="Red lights run",
        short="Red lights",
        unit="",
        definition="times that the front passes the stop line of the lanelet, or its end, while "
        "the lights for the way that is taken are red or red with yellow, unless the ego stops "
        "before the intersection and enters it when they allow it; maps with traffic lights",
        aggregate=Aggregate.MEAN,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.red_lights,
        kind=int,
    ),
    Metric(
        name="stop_lines_ignored",
        title="Stop signs passed without standing",
        short="Stop lines",
        unit="",
        definition="times that the front passes the line of a stop sign, lights not lit, without "
        f"having been slower than {rules.STANDING:g} m/s at most {rules.STOP_ZONE:g} m before it; "
        "maps with stop signs",
        aggregate=Aggregate.MEAN,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.stop_lines_ignored,
        kind=int,
    ),
    Metric(
        name="time_over_limit",
        title="Time above the speed limit",
        short="Above limit",
        unit="%",
        definition="share of the drive's time in which the ego is faster than the limit of its "
        f"lanelet by {rules.OVERSPEED:g} m/s or more; drives past a limit",
        aggregate=Aggregate.MEAN,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.time_over_limit,
        digits=1,
    ),
    Metric(
        name="mean_overspeed",
        title="Mean excess of the speed limit",
        short="Mean excess",
        unit="m/s",
        definition="mean excess over the time above the limit; episodes with such a time",
        aggregate=Aggregate.MEAN,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.mean_excess,
    ),
    Metric(
        name="max_overspeed",
        title="Largest excess of the speed limit",
        short="Largest excess",
        unit="m/s",
        definition="largest excess of the limit of the lanelet, zero where it is kept; drives past "
        "a limit",
        aggregate=Aggregate.LARGEST,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.largest_excess,
    ),
    Metric(
        name="wrong_way",
        title="Way against the traffic",
        short="Wrong way",
        unit="m",
        definition="largest distance that the ego's centre moves against its lane's direction "
        "within a second, summed up as in nuPlan; episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.wrong_way,
    ),
    Metric(
        name="solid_lines",
        title="Solid lines crossed",
        short="Solid lines",
        unit="",
        definition="times that the ego's centre leaves its lanelet over a bound that must not be "
        "crossed in that direction; maps that say what is painted",
        aggregate=Aggregate.MEAN,
        group=Group.RULES,
        better=Better.LOWER,
        measure=rules.solid_lines,
        kind=int,
    ),
    Metric(
        name="nuplan_score",
        title="nuPlan's closed-loop score",
        short="Score",
        unit="%",
        definition="no_ego_at_fault_collisions · drivable_area_compliance · "
        "driving_direction_compliance · ego_is_making_progress · (5 "
        "ego_progress_along_expert_route + 5 time_to_collision_within_bound + 4 "
        "speed_limit_compliance + 2 ego_is_comfortable) / 16, 0 where the planner fails "
        "(below: what differs from nuPlan)",
        aggregate=Aggregate.MEAN,
        group=Group.NUPLAN,
        better=Better.HIGHER,
        measure=nuplan.nuplan_score,
        failed=0.0,
        digits=1,
    ),
    Metric(
        name="making_progress",
        title="Making progress",
        short="Making progress",
        unit="%",
        definition="nuPlan's ego_is_making_progress: the share of the expected progress is "
        f"{progress.MAKING_PROGRESS:g} or more",
        aggregate=Aggregate.SHARE,
        group=Group.NUPLAN,
        better=Better.HIGHER,
        measure=_makes_progress,
        kind=bool,
        failed=False,
        digits=1,
    ),
    Metric(
        name="route_progress",
        title="Share of the expected progress",
        short="Progress",
        unit="%",
        definition="nuPlan's ego_progress_along_expert_route, min(1, max(progress, 2 m) / "
        "max(expected, 2 m)); expected is the way to the goal, or, where that is a time alone, the "
        "way at the speed of the start, at most to whoever is ahead then and to a red light; "
        "episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.NUPLAN,
        better=Better.HIGHER,
        measure=_progress_share,
        digits=1,
    ),
    Metric(
        name="driving_direction_compliance",
        title="Driving direction kept (nuPlan's)",
        short="Direction",
        unit="%",
        definition="nuPlan's driving_direction_compliance: 1 below "
        f"{nuplan.MAX_WRONG_WAY:g} m against the lane's direction within a second, 0.5 below "
        f"{nuplan.NO_WRONG_WAY:g} m, otherwise 0; episodes that drove a step",
        aggregate=Aggregate.MEAN,
        group=Group.NUPLAN,
        better=Better.HIGHER,
        measure=nuplan.direction_compliance,
        digits=1,
    ),
    Metric(
        name="speed_limit_compliance",
        title="Speed limit kept (nuPlan's)",
        short="Speed limit",
        unit="%",
        definition="nuPlan's speed_limit_compliance: max(0, 1 - integral of the excess / "
        f"({nuplan.MAX_OVERSPEED:g} m/s · duration)); drives past a limit",
        aggregate=Aggregate.MEAN,
        group=Group.NUPLAN,
        better=Better.HIGHER,
        measure=nuplan.speed_compliance,
        digits=1,
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
        name="imposed_braking",
        title="Imposed braking",
        short="Imposed braking",
        unit="m/s²",
        definition="hardest braking that the ego's presence asks of a vehicle: how much faster it "
        "loses speed over 0.5 s than its recording does over the same way; 0 where nobody is off "
        "the recording; traffic that keeps to the recording unless the ego is in the way",
        aggregate=Aggregate.MEAN,
        group=Group.RIDE,
        better=Better.LOWER,
        measure=_imposed_braking,
    ),
    Metric(
        name="cycle_ms_p50",
        title="Cycle time (median)",
        short="Cycle p50",
        unit="ms",
        definition="median time of a planning cycle, predict and plan",
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
        definition="99th percentile of the time of a planning cycle",
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
    *(_cost(name) for name in COST_FUNCTIONS),
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


def failed_measures() -> dict[str, Measure]:
    """Values of measured metrics where the planner failed before a step was driven, by name."""
    return {metric.name: metric.failed for metric in METRICS if metric.measure is not None}


def measured_kinds() -> dict[str, type[bool | int | float]]:
    """The columns that measured metrics add to a row, with their types."""
    return {metric.name: metric.kind for metric in METRICS if metric.measure is not None}
