"""Settings of the planner; the defaults were chosen on training scenarios only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Style:
    """Accelerations of the reference speed; a plan may use more.

    Attributes:
        lateral: At which curves are taken, m/s2.
        longitudinal: At which the speed changes, m/s2.
    """

    lateral: float
    longitudinal: float


@dataclass(frozen=True)
class MpcConfig:
    """Settings of the optimal control problem and of what surrounds it.

    Attributes:
        horizon: Number N of steps that are planned.
        slots: Number M of road users that a stage can hold.
        discs: Number of discs that cover the ego's rectangle.
        lateral_weight: Cost of the offset from the reference path, 1/m2.
        heading_weight: Cost of the heading error, 1/rad2.
        velocity_weight: Cost of the velocity error, s2/m2.
        station_weight: Cost of being ahead or behind of the way to a goal, 1/m2.
        goal_heading_weight: Cost of the error of a goal's heading, 1/rad2.
        steering_weight: Cost of steering other than the path's own, 1/rad2.
        steering_rate_weight: Cost of the steering rate, s2/rad2.
        acceleration_weight: Cost of the acceleration, s4/m2.
        jerk_weight: Cost of the change of acceleration, s6/m2.
        set_penalty: Exact penalty on entering a set, per unit of normalised distance.
        far_penalty: Share of it that counts at the last step; linear between.
        road_penalty: Exact penalty on leaving the corridor, 1/m.
        clearance: Distance that is kept from every set, m.
        road_margin: Distance that is kept from the corridor's edge, m.
        calm: How the reference speed is driven.
        hurried: The same where a deadline cannot be met otherwise.
        utmost: The same where it cannot be met even so.
        grip: Share of the friction circle that a plan may use.
        resample_every: Cycles between two looks at the sampled alternatives.
        max_iterations: Iterations the solver is given.
        tolerance: Tolerance of the solver.
        accept_residual: Largest constraint residual of a plan that is driven.
    """

    horizon: int = 30
    slots: int = 10
    discs: int = 3
    lateral_weight: float = 0.36
    heading_weight: float = 1.0
    velocity_weight: float = 0.25
    station_weight: float = 0.05
    goal_heading_weight: float = 100.0
    steering_weight: float = 1.0
    steering_rate_weight: float = 1.0
    acceleration_weight: float = 0.09
    jerk_weight: float = 0.01
    set_penalty: float = 2000.0
    far_penalty: float = 0.1
    road_penalty: float = 1000.0
    clearance: float = 0.15
    road_margin: float = 0.05
    calm: Style = Style(lateral=4.0, longitudinal=2.5)
    hurried: Style = Style(lateral=7.0, longitudinal=5.0)
    utmost: Style = Style(lateral=9.0, longitudinal=8.0)
    grip: float = 0.9
    resample_every: int = 5
    max_iterations: int = 60
    tolerance: float = 1e-3
    accept_residual: float = 0.02
