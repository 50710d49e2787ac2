"""``brake-v1``: brakes to a standstill on the path, whatever happens."""

from __future__ import annotations

from dosplan_baseline.constant import ConstantAccelerationPlanner


class BrakePlanner(ConstantAccelerationPlanner):
    """Full braking along the route; the lower bound of every comparison."""

    name = "brake-v1"
    acceleration = -8.0  # What tyres give on a dry road.
