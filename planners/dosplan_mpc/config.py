"""Settings of the planner; the defaults were chosen on training scenarios only.

Each part of the planner has settings of its own. Any of them can be set by name, as in
``--set planner.sampler.lane=3.0``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from dosplan.api import DeadlineSettings
from dosplan.geometry import StopSettings
from dosplan.types.checks import check_numbers


@dataclass(frozen=True)
class Style:
    """Accelerations of the reference speed; a plan may use more.

    Attributes:
        lateral: At which curves are taken, m/s2.
        longitudinal: At which the speed changes, m/s2.
        comfort: Share of what jerk and uncomfortable accelerations cost that counts.
    """

    lateral: float
    longitudinal: float
    comfort: float

    def __post_init__(self) -> None:
        check_numbers(self, positive={"lateral", "longitudinal"}, shares={"comfort"})


@dataclass(frozen=True)
class PathSettings:
    """Settings of the reference path and its edges (``reference``).

    In a bend a car may swing out into a lane against it: a front that is l ahead of the rear axle
    runs ``kappa l^2 / 2`` further out.

    Attributes:
        edge_reach: An edge counts this far along the path, so that a corner between two stations
            is not missed, m.
        swing: Room beyond the lane's edge that the ego may use in a bend, by its curvature, m2.
        swing_reach: How far before and after a bend it may do so, m.
        widest_swing: Largest such room, m.
        end_margin: Distance between the ego's front and the end of the map, m.
    """

    edge_reach: float = 0.55
    swing: float = 10.0
    swing_reach: float = 8.0
    widest_swing: float = 1.5
    end_margin: float = 0.3

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True)
class GoalSettings:
    """Settings of the search for a goal's region along the path (``goal_window``).

    Attributes:
        spacing: Distance of the places along the path that are tried, m.
        lateral_spacing: Distance of the lateral offsets that are tried, m.
        lateral_reach: Largest lateral offset that is tried, m.
        edge_margin: Distance that is kept from the region's edge, m.
        turn: Angle by which the path may miss the goal's heading window, rad; the ego turns
            towards it.
        widest_turn: The same where no place beside the path is within ``turn``.
        least_turn: Up to this angle the price on the heading does, without a way of its own, rad.
        lateral_margin: Distance to the lateral edges at which the ego aims to drive, m.
        common_share: A lateral offset counts where it is inside the region at this share of the
            places at which the best offset is.
    """

    spacing: float = 0.25
    lateral_spacing: float = 0.1
    lateral_reach: float = 12.0
    edge_margin: float = 0.2
    turn: float = 0.3
    widest_turn: float = 2.2
    least_turn: float = 0.15
    lateral_margin: float = 0.5
    common_share: float = 0.9

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive={"spacing", "lateral_spacing", "lateral_reach"},
            shares={"common_share"},
        )


@dataclass(frozen=True)
class SpeedSettings:
    """Settings of the reference speed and of the way into a goal (``speed_profile``).

    Attributes:
        winding: Distance to both sides over which the change of steering is taken, m.
        steering_share: Share of the largest steering rate that the reference speed asks for.
        run_up: The reference accelerates at this many times the style's rate: the plan lags
            behind it.
        deadline_reserve: Time to spare before a goal's deadline, s.
        depth_margin: Distance from the ends of a goal's region that is aimed at, m.
        depth_share: The same as a share of the region's length, where that is less.
        crawl: Reference speed below which an ego that is too early for a goal waits for it, m/s.
        waiting: Factor of ``station_weight`` while waiting, so that the ego does not roll beyond
            the region's end.
        waiting_comfort: Share of what discomfort costs that counts at most while waiting.
        velocity_margin: Share of a goal's velocity window that is kept from both its ends.
        approach_seconds: Time of driving over which the goal's offset is taken up, s.
        shortest_approach: Shortest way over which it is, m.
        approach_end: Share of that way after which the offset is reached.
        heading_margin: Angle that is kept from the edges of a goal's heading window, rad.
        heading_share: The same as a share of the window, where that is less.
        turning: Where a goal's heading is not the path's, the ego begins to turn this far before
            its region, m.
        early_metres: A goal's edges and heading count this far before its region, m.
        late_metres: And this far behind it, m.
        early_steps: And so many steps before its time window.
        limit_factor: How many times the map's speed limit the reference may be.
        limit_first: Whether the speed limit is kept where a goal's deadline is missed by it, and
            where a follower is close behind.
    """

    winding: float = 1.5
    steering_share: float = 1.0
    run_up: float = 1.1
    deadline_reserve: float = 0.3
    depth_margin: float = 1.0
    depth_share: float = 0.3
    crawl: float = 1.0
    waiting: float = 20.0
    waiting_comfort: float = 0.5
    velocity_margin: float = 0.15
    approach_seconds: float = 3.0
    shortest_approach: float = 10.0
    approach_end: float = 0.8
    heading_margin: float = 0.06
    heading_share: float = 0.3
    turning: float = 2.0
    early_metres: float = 2.0
    late_metres: float = 1.0
    early_steps: int = 5
    limit_factor: float = 1.0
    limit_first: bool = False

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive={
                *("winding", "steering_share", "run_up", "shortest_approach", "approach_end"),
                *("limit_factor", "turning"),
            },
            shares={"depth_share", "velocity_margin", "approach_end", "heading_share"},
        )


@dataclass(frozen=True)
class TrafficSettings:
    """Settings of leader, follower and cruising speed (``traffic``).

    Attributes:
        side: Distance from the ego's lateral offset within which a road user is in its lane, m.
        alignment: Cosine of the largest angle to the path of a road user in the lane.
        ahead: Distance within which a leader counts, m.
        behind: Distance within which a follower counts, m.
        standstill_gap: Gap to a standing leader, m.
        headway: Time gap to a leader, s.
        pressing: Time gap below which a follower counts as close behind, s.
        gap_gain: Share of the gap's error that is closed in a second, 1/s.
    """

    side: float = 1.7
    alignment: float = 0.7
    ahead: float = 80.0
    behind: float = 40.0
    standstill_gap: float = 2.0
    headway: float = 0.8
    pressing: float = 1.5
    gap_gain: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self, shares={"alignment"})


@dataclass(frozen=True)
class SetSettings:
    """Settings of the forbidden sets (``obstacles``).

    Attributes:
        watched: Number of road users whose sets are looked at, the nearest ones.
        relevant: Normalised distance to the guess within which a set needs a slot at a step.
        tail: Length that a follower's set is given to its rear, m.
        follower_price: Share of the penalty that a follower's set has. It sees the ego and can
            brake: nobody else is hit to get away from it.
        release_seconds: Time after which a set that holds the ego now counts in full, s.
        smallest_release: Share below which such a set is never shrunk.
        release_distance: Normalised distance that the ego has to a shrunk set.
        aside: Distance to the ego's way from which on a further component of a union is left out,
            m.
        least_price: Share of the penalty that a component of a union has at least; what the most
            likely one of its road user has is the whole.
    """

    watched: int = 16
    relevant: float = 1.75
    tail: float = 15.0
    follower_price: float = 0.5
    release_seconds: float = 1.5
    smallest_release: float = 0.6
    release_distance: float = 1.02
    aside: float = 15.0
    least_price: float = 0.2

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive={"release_seconds", "smallest_release", "release_distance"},
            shares={"smallest_release", "least_price", "follower_price"},
        )


@dataclass(frozen=True)
class SamplerSettings:
    """Settings of the sampled alternatives (``sampler``), and of when they are solved.

    Attributes:
        accelerations: Constant accelerations that are tried beside the reference speed, m/s2.
        overspeed: Speed above that of the reference and of now that no candidate exceeds, m/s.
        manoeuvre_seconds: Times within which a lateral target is reached, s.
        shortest_manoeuvre: Shortest way to it, m; a car cannot change its lane on the spot.
        lane: Offset of a candidate that goes to the next lane, m.
        edge_distance: Distance ahead at which the road's edges bound the lateral targets, m.
        steepest: Angle to the path at which the tracking law's input is limited, rad.
        lookahead_seconds: The tracking law closes an error over the way of this time, s.
        shortest_lookahead: And over no shorter way than this, m.
        slip_penalty: Distance off the road that leaving the friction circle by its radius is
            worth, m.
        slack_seen: Slack of a set above which a plan makes the planner look at candidates.
        better: Share of its cost by which a candidate must beat the last plan to be solved.
        worth_it: Cost by which it must beat it at least.
    """

    accelerations: tuple[float, ...] = (-8.0, -5.0, -3.0, -1.5, -0.7, 0.0, 0.7, 1.5, 2.5, 4.0)
    overspeed: float = 3.0
    manoeuvre_seconds: tuple[float, ...] = (1.5, 3.0)
    shortest_manoeuvre: float = 8.0
    lane: float = 3.4
    edge_distance: float = 10.0
    steepest: float = 0.8
    lookahead_seconds: float = 0.6
    shortest_lookahead: float = 3.0
    slip_penalty: float = 5.0
    slack_seen: float = 0.02
    better: float = 0.25
    worth_it: float = 3.0

    def __post_init__(self) -> None:
        check_numbers(self, positive={"shortest_manoeuvre", "shortest_lookahead"})
        if not all(map(math.isfinite, self.accelerations)):
            raise ValueError(f"accelerations are {self.accelerations}, expected finite numbers")
        if not self.manoeuvre_seconds or not all(0 < s < math.inf for s in self.manoeuvre_seconds):
            raise ValueError(
                f"manoeuvre_seconds are {self.manoeuvre_seconds}, expected one or more above 0"
            )
        if not self.steepest < math.pi / 2.0:
            raise ValueError(f"steepest is {self.steepest}, expected less than pi / 2")


@dataclass(frozen=True)
class PassingSettings:
    """Settings of the decision to pass what blocks the lane (``passing``).

    Attributes:
        ahead: Distance ahead of the ego within which it is looked for, m.
        clearance: Room beside what is passed, m.
        lane: Width of road beyond the own lane from which on there is a lane against it, m.
        seconds: Time of driving over which the ego goes aside, and back, s.
        shortest_way: Shortest way over which it does, m; also where it waits before the place.
        commit: Distance of the front before the place from which on a pass is not given up, m.
        beside: Distance from the path up to which somebody who comes towards the ego counts, m.
        speed: Speed at which the ego is taken to pass, where it is not faster, m/s.
        reserve: Time that the lane has to be free beyond that of the pass, s.
    """

    ahead: float = 80.0
    clearance: float = 0.3
    lane: float = 1.0
    seconds: float = 1.5
    shortest_way: float = 9.0
    commit: float = 3.0
    beside: float = 6.0
    speed: float = 5.0
    reserve: float = 1.5

    def __post_init__(self) -> None:
        check_numbers(self, positive={"ahead", "shortest_way", "speed"})


@dataclass(frozen=True)
class GapSettings:
    """Settings of the decision for a gap (``lane_change``).

    Attributes:
        ahead: Time over which a drive into a gap is looked at, s.
        reach: Distance from the ego within which others count, m.
        alignment: Cosine of the largest angle to the path of somebody on a lane along it.
        arrived: Distance from the middle of the lane from which on the change is done, m.
        known: Time up to which sets grow, s; later ones are taken as large as at that time.
        clearance: Distance that is kept from others along the path, m.
        beside: Room beside what blocks the own lane, m.
        headway: Time that is kept from who is ahead in the gap, s.
        headway_behind: Time that is kept from who is behind, s.
        tight: Share of these distances that is kept where there is no other gap.
        gain: Share of the distance from a gap that is closed in a second, 1/s.
        answer: Time within which a drive takes up a speed, s.
        braking: Hardest braking of a drive, m/s2.
        speeding: Strongest acceleration of a drive, m/s2.
        jerk: Quickest change of its acceleration, m/s3.
        seconds: Time that the change takes, s.
        time_cost: What a second until the gap is beside the ego costs.
        way_cost: What a metre less way costs, 1/m.
        rate_cost: What a second of acceleration costs, s3/m2.
        keeping: How much better another gap has to be than the one that was chosen.
        station_weight: What being elsewhere than in the drive costs, 1/m2.
    """

    ahead: float = 8.0
    reach: float = 60.0
    alignment: float = 0.7
    arrived: float = 0.8
    known: float = 1.0
    clearance: float = 0.8
    beside: float = 0.3
    headway: float = 0.3
    headway_behind: float = 0.2
    tight: float = 0.4
    gain: float = 0.5
    answer: float = 0.6
    braking: float = 3.0
    speeding: float = 2.1
    jerk: float = 4.0
    seconds: float = 2.6
    time_cost: float = 1.0
    way_cost: float = 0.1
    rate_cost: float = 0.2
    keeping: float = 1.5
    station_weight: float = 0.05

    def __post_init__(self) -> None:
        check_numbers(
            self,
            positive={"ahead", "reach", "answer", "braking", "speeding", "seconds"},
            shares={"alignment", "tight"},
        )


@dataclass(frozen=True)
class ArrivalSettings:
    """Settings of the drives that are tried where a plan misses its goal (``arrival``).

    Attributes:
        angles: Number of steering angles, from stop to stop.
        switches: Steps after which the second angle is turned to.
        accelerations: m/s2.
        margin: Share of a goal's intervals of heading and velocity that is kept from their ends.
    """

    angles: int = 9
    switches: tuple[int, ...] = (2, 4, 7, 11)
    accelerations: tuple[float, ...] = (-8.0, -4.0, -1.5, 0.0, 2.0, 5.0, 9.0)
    margin: float = 0.02

    def __post_init__(self) -> None:
        check_numbers(self, positive={"angles"})
        if not self.margin < 0.5:
            raise ValueError(f"margin is {self.margin}, expected less than 0.5")
        if not self.switches or not self.accelerations:
            raise ValueError("switches and accelerations are empty, expected one or more of each")


@dataclass(frozen=True)
class ComfortSettings:
    """From where on accelerations cost more: a little inside nuPlan's bounds of comfort.

    Attributes:
        speeding: Acceleration, m/s2.
        braking: Deceleration, m/s2.
        lateral: Lateral acceleration, m/s2.
        speeding_weight: What the square of the excess of each costs, s4/m2.
        braking_weight: Likewise.
        lateral_weight: Likewise.
    """

    speeding: float = 1.8
    braking: float = 3.6
    lateral: float = 4.0
    speeding_weight: float = 10.0
    braking_weight: float = 1.0
    lateral_weight: float = 10.0

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True)
class BarrierSettings:
    """Settings of the way to a line before which the ego has to stop (``barrier``).

    A standing set blocks the road behind the line, so that a plan does not pass it for the sake of
    anything else.

    Attributes:
        length: Half length of that set along the path, m.
        width: Its half width, m.
    """

    length: float = 10.0
    width: float = 5.0

    def __post_init__(self) -> None:
        check_numbers(self, positive={"length", "width"})


@dataclass(frozen=True)
class MpcConfig(DeadlineSettings):
    """Settings of the optimal control problem and of what surrounds it.

    Attributes:
        deadline: Time after which the planner begins nothing more in a cycle, s; its best plan of
            until then is driven. None for never.
        horizon: Number N of steps that are planned.
        fine_steps: After so many of them, an input is held for two steps, and the limits hold at
            every other step.
        slots: Number M of sets that a stage can hold; the nearest to the guess fill them.
        discs: Number of discs that cover the ego's rectangle.
        lateral_weight: Cost of the offset from the reference path, 1/m2.
        heading_weight: Cost of the heading error, 1/rad2.
        velocity_weight: Cost of the velocity error, s2/m2.
        station_weight: Cost of being ahead or behind of the way to a goal, 1/m2.
        goal_heading_weight: Cost of the error of a goal's heading, 1/rad2.
        steering_weight: Cost of steering other than the path's own, 1/rad2.
        steering_rate_weight: Cost of the steering rate, s2/rad2.
        acceleration_weight: Cost of the acceleration, s4/m2.
        jerk_weight: Cost of the change of acceleration, s6/m2, of which the style's share counts.
        set_penalty: Exact penalty on entering a set, per unit of normalised distance.
        far_penalty: Share of it that counts at the last step; linear between.
        road_penalty: Exact penalty on leaving the road, 1/m.
        slack_curvature: Small square of the slacks, which keeps the problem strictly convex.
        norm_rounding: Smooths the norm of a set at its centre, where it has no derivative.
        clearance: Distance that is kept from every set, m.
        road_margin: Distance that is kept from the road's edge, m.
        calm: How the reference speed is driven.
        hurried: The same where ``calm`` misses a goal's deadline.
        utmost: The same where ``hurried`` misses it too.
        grip: Share of the friction circle that a plan may use.
        resample_every: Cycles after which alternatives are sampled in any case.
        max_iterations: Iterations the solver is given.
        cycle_iterations: After so many in a cycle, no other solve begins.
        tolerance: Tolerance of the solver.
        initial_barrier: Barrier parameter the solver begins with; a small one keeps it near a good
            guess.
        accept_residual: Largest constraint residual of a plan that is driven.
        path: The reference path and its edges.
        goal: The search for a goal's region along it.
        speed: The reference speed and the way into a goal.
        traffic: Leader, follower and cruising speed.
        sets: The forbidden sets.
        sampler: The sampled alternatives.
        arrival: The last metres into a goal.
        passing: The decision to pass what blocks the lane.
        gap: The decision for a gap to change lanes into.
        stops: When the ego stops for lights, signs and crosswalks.
        barrier: How it does.
        comfort: What is comfortable.
    """

    horizon: int = 30
    fine_steps: int = 10
    slots: int = 6
    discs: int = 3
    lateral_weight: float = 0.36
    heading_weight: float = 1.0
    velocity_weight: float = 0.25
    station_weight: float = 0.05
    goal_heading_weight: float = 100.0
    steering_weight: float = 1.0
    steering_rate_weight: float = 1.0
    acceleration_weight: float = 0.09
    jerk_weight: float = 0.1
    set_penalty: float = 2000.0
    far_penalty: float = 0.1
    road_penalty: float = 5000.0
    slack_curvature: float = 1e-2
    norm_rounding: float = 1e-4
    clearance: float = 0.15
    road_margin: float = 0.05
    calm: Style = Style(lateral=4.0, longitudinal=2.0, comfort=1.0)
    hurried: Style = Style(lateral=7.0, longitudinal=5.0, comfort=0.2)
    utmost: Style = Style(lateral=9.0, longitudinal=8.0, comfort=0.1)
    grip: float = 0.9
    resample_every: int = 5
    max_iterations: int = 30
    cycle_iterations: int = 40
    tolerance: float = 1e-3
    initial_barrier: float = 1e-3
    accept_residual: float = 0.02
    path: PathSettings = PathSettings()
    goal: GoalSettings = GoalSettings()
    speed: SpeedSettings = SpeedSettings()
    traffic: TrafficSettings = TrafficSettings()
    sets: SetSettings = SetSettings()
    sampler: SamplerSettings = SamplerSettings()
    arrival: ArrivalSettings = ArrivalSettings()
    passing: PassingSettings = PassingSettings()
    gap: GapSettings = GapSettings()
    stops: StopSettings = StopSettings()
    barrier: BarrierSettings = BarrierSettings()
    comfort: ComfortSettings = ComfortSettings()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_numbers(
            self,
            positive={
                *("horizon", "slots", "discs", "slack_curvature", "norm_rounding", "grip"),
                *("resample_every", "max_iterations", "cycle_iterations", "tolerance"),
                "initial_barrier",
            },
            shares={"far_penalty", "grip"},
        )
