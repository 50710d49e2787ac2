"""``cruise-v1``: keeps its speed along the route, whoever is in the way.

A scenario that this planner solves asks for no interaction.
"""

from __future__ import annotations

from dosplan_baseline.constant import ConstantAccelerationPlanner


class CruisePlanner(ConstantAccelerationPlanner):
    """Constant velocity along the route."""

    name = "cruise-v1"
