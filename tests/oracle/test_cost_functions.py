"""CommonRoad's cost functions beside commonroad-drivability-checker, on drives of the suite.

Duration, acceleration, jerk, steering, length and velocity are the same integrals. The offsets from
the lane and the distance to those ahead are measured along other curves, and may differ as much
as the curves do. MW1 is left out: ``dosplan.scoring.commonroad_cost`` tells why.
"""

from __future__ import annotations

import gzip
from typing import Any

import numpy as np
import pytest
from suitegen.verdict import recorded_episode

from dosplan.scenario import load_scenario
from dosplan.scoring.score import score
from dosplan.types import EGO_STEERING, EGO_VELOCITY, Episode, Outcome, Scenario
from tests.support.suite import ROWS, SUITE, Row, drives

NAMES = ("ZAM_OnRamp-2_1_T-1", "ZAM_TJunction-4_1_T-1", "ZAM_LaneDrop-5_1_T-1", "ZAM_Zebra-6_1_T-1")
CLOSE = {"JB1": 1e-9, "SM1": 1e-3, "SM2": 1e-3, "SM3": 1e-3, "WX1": 1e-3, "SA1": 0.1, "TR1": 0.1}
"""How far the cost functions may be apart, as a share."""


def steered(scenario: Scenario, episode: Episode) -> Episode:
    """The drive with wheels that are turned, which the recording does not tell."""
    states = episode.states.copy()
    states[:, EGO_STEERING] = 0.05 * np.sin(0.7 * scenario.dt * np.arange(len(states)))
    states[0] = episode.states[0]
    object.__setattr__(episode, "states", states)
    return episode


@pytest.mark.parametrize("row", [row for row in ROWS if row["id"] in NAMES], ids=lambda r: r["id"])
def test_costs_are_those_of_the_checker(row: Row) -> None:
    theirs = _their_costs(row)
    scenario = load_scenario(SUITE / row["file"], cached=True)
    episode = steered(scenario, recorded_episode(scenario, drives()[row["id"]]))
    found = score(scenario, episode)
    assert found.outcome is Outcome.SUCCESS
    part = episode.states[: found.steps + 1]
    expected = theirs(episode.start_step, scenario.task.vehicle.poses(part), part)
    for name, share in CLOSE.items():
        assert found.measures[f"cost_{name.lower()}"] == pytest.approx(expected[name], rel=share), (
            name
        )


def _their_costs(row: Row) -> Any:
    reason = "commonroad-drivability-checker is not installed"
    evaluation = pytest.importorskip("commonroad_dc.costs.evaluation", reason=reason)
    reader = pytest.importorskip("commonroad.common.file_reader")
    util = pytest.importorskip("commonroad.common.util")
    solution = pytest.importorskip("commonroad.common.solution")
    state = pytest.importorskip("commonroad.scenario.state")
    trajectory = pytest.importorskip("commonroad.scenario.trajectory")
    text = gzip.decompress((SUITE / row["file"]).read_bytes())
    scene, problems = reader.CommonRoadFileReader(text, util.FileFormat.XML).open()
    (problem,) = problems.planning_problem_dict.values()

    def costs(first: int, poses: Any, states: Any) -> dict[str, float]:
        driven = trajectory.Trajectory(
            first,
            [
                state.KSState(
                    time_step=first + i,
                    position=pose[:2],
                    orientation=float(pose[2]),
                    velocity=float(row[EGO_VELOCITY]),
                    steering_angle=float(row[EGO_STEERING]),
                )
                for i, (pose, row) in enumerate(zip(poses, states, strict=True))
            ],
        )
        found = {}
        for name in CLOSE:
            judge = evaluation.CostFunctionEvaluator(
                solution.CostFunction[name], solution.VehicleType.BMW_320i
            )
            found[name] = float(judge.evaluate_pp_solution(scene, problem, driven).total_costs)
        return found

    return costs
