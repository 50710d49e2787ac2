"""dosplan's own check of a scenario: it can be solved, but not by constant speed or by braking."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from dosplan_baseline.brake import BrakePlanner
from dosplan_baseline.cruise import CruisePlanner
from dosplan_baseline.idm import IdmPlanner
from dosplan_simple.predictors import ConstantVelocityPredictor, NonePredictor

from dosplan.api import Planner, Predictor
from dosplan.scenario import load_scenario
from dosplan.scoring.bounds import outside
from dosplan.scoring.score import score
from dosplan.simulation.loop import known_drive, run_episode
from dosplan.types import Arm, Episode, FloatArray, Outcome, Scenario, Score
from dosplan.vehicle import VehicleParameters

VEHICLE = VehicleParameters()
FIRST_CONTACT = 12
"""Steps at least between the start and the collision of constant speed: time to react."""
KERB = 0.05
"""Least distance of the recorded drive from the edge of the road, m."""


def recorded_episode(scenario: Scenario, drive: FloatArray) -> Episode:
    """The recorded drive of the vehicle that was taken out, as an episode.

    Args:
        scenario: The scenario.
        drive: (K, 4) centre x, y, heading and velocity from the start step on.

    Returns:
        An episode with zeros for the inputs, which are not known.
    """
    states = np.array([VEHICLE.state_at(row[:2], row[2], row[3]) for row in drive])
    return known_drive(scenario, Arm.WITHOUT_DOS, scenario.task.start_step, states)


def _driven(scenario: Scenario, planner: Planner, predictor: Predictor) -> Score:
    episode = run_episode(scenario, planner, predictor, Arm.WITHOUT_DOS)
    return score(scenario, episode)


def _without_rules(scenario: Scenario) -> Scenario:
    """The scenario without lines to stop at and speed limits.

    Whether others can be met by following them alone is asked here, and nobody stops for that.
    """
    route = scenario.task.route
    free = replace(route, stops=(), speed_limit=np.full_like(route.speed_limit, np.inf))
    return replace(scenario, task=replace(scenario.task, route=free))


def collision_of_constant_speed(path: Path, drive: FloatArray, hard: bool) -> str | None:
    """Checks a scenario.

    Args:
        path: The file.
        drive: (K, 4) the recorded drive, see ``recorded_episode``.
        hard: Whether to reject what the Intelligent Driver Model solves, too.

    Returns:
        The road user that an ego at constant speed along the route hits, and when; None where
        the scenario is to be rejected: the recorded drive does not succeed or comes too close to
        the edge of the road, constant speed has no collision or one at once, or braking to a stop
        succeeds.
    """
    scenario = load_scenario(path)
    recorded = score(scenario, recorded_episode(scenario, drive))
    if recorded.outcome is not Outcome.SUCCESS:
        return None
    if outside(drive[:, :3], np.add(VEHICLE.size, 2.0 * KERB), scenario.road_map).any():
        return None
    if _driven(scenario, BrakePlanner(), NonePredictor()).outcome is Outcome.SUCCESS:
        return None
    cruise = _driven(scenario, CruisePlanner(), NonePredictor())
    if cruise.outcome is not Outcome.COLLISION or cruise.collision_step is None:
        return None
    first = cruise.collision_step - scenario.task.start_step
    if first < FIRST_CONTACT:
        return None
    if hard:
        idm = _driven(_without_rules(scenario), IdmPlanner(), ConstantVelocityPredictor())
        if idm.outcome is Outcome.SUCCESS:
            return None
    other = int(np.flatnonzero(scenario.tracks.ids == cruise.collision_with)[0])
    seconds = first * scenario.dt
    return f"{scenario.tracks.kinds[other]} after {seconds:.1f} s ({cruise.collision_class})"
