"""What must hold of everything that could be read: it can be driven, and gives a row."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np

from dosplan.api import Planner, Predictor
from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.results.rows import row_line
from dosplan.scoring.score import score
from dosplan.scoring.usable import unusable
from dosplan.simulation.loop import run_episode
from dosplan.types import Arm, EpisodeEnd, Scenario
from tests.fuzz.harness import check_message

_STEPS: Final = 4


def check_usable(scenario: Scenario) -> None:
    """Raises where a scenario holds what no planner or scorer could use, or is told unclearly."""
    task, tracks, route = scenario.task, scenario.tracks, scenario.task.route
    assert scenario.id
    assert 0 <= task.start_step < task.final_step < tracks.steps
    assert all(goal.first_step <= goal.last_step <= task.final_step for goal in task.goals)
    assert np.all(tracks.size > 0.0), tracks.size
    assert np.all(np.isfinite(tracks.states[tracks.valid]))
    assert np.all(np.isfinite(task.start))
    assert np.isfinite(scenario.road_map.drivable.area)
    assert scenario.road_map.drivable.area > 0.0
    assert np.all(route.left >= 0.0)
    assert np.all(route.right <= 0.0)
    assert np.all(route.speed_limit >= 0.0), route.speed_limit.min()
    if (reason := unusable(scenario)) is not None:
        check_message(reason, "planning problem")


def drive(
    scenario: Scenario, planner: Planner | None = None, predictor: Predictor | None = None
) -> None:
    """Drives some steps and scores them; a plug-in that fails must say why in one line."""
    end = min(scenario.task.start_step + _STEPS, scenario.task.final_step)
    short = replace(scenario, task=replace(scenario.task, final_step=end))
    episode = run_episode(
        short,
        planner or _cruise(),
        predictor or _constant_velocity(),
        Arm.WITH_DOS,
    )
    row = score(short, episode)
    row_line(row)
    if episode.end is EpisodeEnd.PLANNER_FAILURE:
        check_message(row.error or "")


@cache
def _cruise() -> Planner:
    return create_planner("cruise", 0)


@cache
def _constant_velocity() -> Predictor:
    return create_predictor("constant-velocity", 0)
