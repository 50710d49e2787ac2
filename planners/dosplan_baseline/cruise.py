"""``cruise-v1``: keeps its speed along the route and ignores the road users.

A scenario that this planner solves needs no interaction.
"""

from __future__ import annotations

from dosplan_baseline.constant import ConstantAccelerationPlanner


class CruisePlanner(ConstantAccelerationPlanner):
    """Constant velocity along the route."""

    name = "cruise-v1"
