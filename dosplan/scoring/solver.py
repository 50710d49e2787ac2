"""How hard the solver had it, over the planning cycles of a drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dosplan.types import SolveReport

SLACK_SEEN: Final = 1e-3
"""Slack above which a plan enters a set. What a solver leaves of a slack that is zero is far less:
of 3244 recorded cycles of ``mpc-v1``, 2962 end below 1e-5 and 282 above this."""


@dataclass(frozen=True)
class Telemetry:
    """The solver's columns of a row; see ``Score``. All are None without a cycle."""

    iterations_p50: float | None = None
    iterations_max: int | None = None
    max_slack: float | None = None
    slack_cycles: int | None = None
    max_road_slack: float | None = None
    solver_failures: int | None = None


def telemetry(reports: Sequence[SolveReport]) -> Telemetry:
    """Sums up the reports of some cycles.

    Args:
        reports: One for each cycle.

    Returns:
        The figures.
    """
    if not reports:
        return Telemetry()
    iterations = [report.iterations for report in reports]
    slacks = [report.slack for report in reports]
    return Telemetry(
        iterations_p50=float(np.median(iterations)),
        iterations_max=int(max(iterations)),
        max_slack=float(max(slacks)),
        slack_cycles=int(sum(slack > SLACK_SEEN for slack in slacks)),
        max_road_slack=float(max(report.road_slack for report in reports)),
        solver_failures=sum(report.status.failed for report in reports),
    )
