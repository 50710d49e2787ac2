"""What a planning cycle may cost: iterations of the solver, and time where there is a deadline.

The bound on iterations makes the same plans on every machine. A deadline cannot: it is off unless
it is asked for, and each cycle in which it cut something short says so in its report.
"""

from __future__ import annotations

import math
import time
from typing import Final

from dosplan_mpc.config import MpcConfig
from dosplan_mpc.nlp import Solution

_KEPT: Final = 0.9  # Of the longest solve so far in a later cycle: a slow moment is forgotten.


class Effort:
    """The bounds of an episode's cycles."""

    def __init__(self, config: MpcConfig) -> None:
        """Takes the bounds.

        Args:
            config: Settings.
        """
        self._struck = False  # Whether the deadline has cut something short in this cycle.
        self._deadline = math.inf if config.deadline is None else config.deadline
        self._most = config.cycle_iterations
        self._iterations = 0
        self._longest = 0.0
        self._until = math.inf

    def begin(self) -> None:
        """Begins a cycle."""
        self._struck = False
        self._iterations = 0
        self._longest *= _KEPT
        self._until = time.perf_counter() + self._deadline

    def allows_solve(self) -> bool:
        """Whether a solve may begin: there are iterations left, and time for the longest so far."""
        return self._iterations < self._most and self.in_time(self._longest)

    def in_time(self, seconds: float = 0.0) -> bool:
        """Whether there is time left; where there is none, the deadline has struck.

        Args:
            seconds: For how long, s.
        """
        self._struck |= time.perf_counter() + seconds > self._until
        return not self._struck

    def spend(self, solution: Solution) -> None:
        """Counts a solve.

        Args:
            solution: What it found.
        """
        self._iterations += solution.iterations
        self._longest = max(self._longest, solution.seconds)
