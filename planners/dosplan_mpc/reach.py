"""Which goals cannot be reached any more: what a plan's report says of that.

A goal is given up only for what holds for any drive of the car: its time is over, it is farther
than the car can go or its velocity is farther off than the car can change it in the time that is
left, or it lies behind, for the car does not reverse. And for what the planner cannot do: drive
where no road of the route leads, or head where none of it points nearly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely

from dosplan.types import EGO_HEADING, EGO_VELOCITY, FloatArray, GoalState, PlanningTask
from dosplan.vehicle import VehicleParameters
from dosplan_mpc.goal_window import GoalWindow


class Reach:
    """Tells in every cycle of an episode whether a goal is left."""

    def __init__(
        self,
        task: PlanningTask,
        found: Sequence[GoalWindow | str | None],
        vehicle: VehicleParameters,
    ) -> None:
        """Keeps the goals.

        Args:
            task: Its goals.
            found: What ``locate_goal`` found of each.
            vehicle: The ego.
        """
        self._goals = tuple(zip(task.goals, found, strict=True))
        self._vehicle = vehicle
        self._dt = task.dt

    def lost(self, step: int, state: FloatArray, position: float) -> list[GoalWindow]:
        """Goals along the path that cannot be reached from here.

        Args:
            step: Present step.
            state: (5 or more) ego state.
            position: Arc length of its centre on the reference path, m.

        Returns:
            Their windows.
        """
        return [
            found
            for goal, found in self._goals
            if isinstance(found, GoalWindow)
            and self._why_not(goal, found, step, state, position) is not None
        ]

    def unreachable(self, step: int, state: FloatArray, position: float) -> str | None:
        """Why no goal can be reached from here.

        Args:
            step: Present step.
            state: (5 or more) ego state.
            position: Arc length of its centre on the reference path, m.

        Returns:
            The reason for each goal, in a few words; None where one can be reached, as far as is
            known.
        """
        reasons = []
        for number, (goal, found) in enumerate(self._goals, start=1):
            reason = self._why_not(goal, found, step, state, position)
            if reason is None:
                return None
            reasons.append(reason if len(self._goals) == 1 else f"goal {number}: {reason}")
        return "; ".join(reasons)

    def _why_not(
        self,
        goal: GoalState,
        found: GoalWindow | str | None,
        step: int,
        state: FloatArray,
        position: float,
    ) -> str | None:
        """Why a goal cannot be reached."""
        seconds = (goal.last_step - step) * self._dt
        if seconds < 0.0:
            return "its time is over"
        if isinstance(found, str):
            return found
        vehicle, velocity = self._vehicle, float(state[EGO_VELOCITY])
        gain = vehicle.max_acceleration * seconds
        if goal.velocity is not None:
            low, high = goal.velocity
            beyond = max(low - velocity, velocity - high) - gain
            if beyond > 0.0:
                return f"its velocity is {beyond:.1f} m/s too far off for {seconds:.1f} s"
        if goal.region is None or found is None:
            return None
        fastest = min(velocity + gain, vehicle.max_velocity)
        way = 0.5 * (velocity + fastest) * seconds
        if fastest < velocity + gain:
            way = fastest * seconds
        centre = vehicle.centre(state)
        far = float(shapely.distance(goal.region, shapely.Point(centre))) - way
        if far > 0.0:
            return f"its region is {far:.1f} m too far for {seconds:.1f} s"
        axis = np.array([np.cos(state[EGO_HEADING]), np.sin(state[EGO_HEADING])])
        ahead = float(((shapely.get_coordinates(goal.region) - centre) @ axis).max())
        if ahead < 0.0 and position > found.end:
            return f"its region is {-ahead:.1f} m behind"
        return None
