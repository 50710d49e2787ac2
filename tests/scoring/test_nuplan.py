"""nuPlan's score: its formula, by hand, and what a drive has to do with it.

Whole drives, each with one thing taken away, are golden scenes: ``tests/golden/scenes/nuplan_*``.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.scoring.nuplan import NuplanScore
from dosplan.scoring.score import failed_score, score
from dosplan.simulation.loop import known_drive
from dosplan.types import EGO_VELOCITY, EGO_X, EGO_Y, Arm, EpisodeEnd, EpisodeKey

ALL = NuplanScore(**{field.name: 1.0 for field in fields(NuplanScore)})
MULTIPLIERS = (
    "no_ego_at_fault_collisions",
    "drivable_area_compliance",
    "driving_direction_compliance",
    "ego_is_making_progress",
)
WEIGHTS = {
    "ego_progress_along_expert_route": 5,
    "time_to_collision_within_bound": 5,
    "speed_limit_compliance": 4,
    "ego_is_comfortable": 2,
}
"""Those of ``closed_loop_nonreactive_agents_weighted_average.yaml``; they sum up to 16."""


def test_every_part_is_a_multiplier_or_has_a_weight() -> None:
    assert {field.name for field in fields(NuplanScore)} == {*MULTIPLIERS, *WEIGHTS}
    assert ALL.total == 1.0


@pytest.mark.parametrize("name", MULTIPLIERS)
@pytest.mark.parametrize("value", [0.0, 0.5])
def test_a_multiplier_multiplies(name: str, value: float) -> None:
    assert replace(ALL, **{name: value}).total == value


@pytest.mark.parametrize(("name", "weight"), WEIGHTS.items())
def test_a_weight_weighs(name: str, weight: int) -> None:
    assert replace(ALL, **{name: 0.0}).total == pytest.approx(1.0 - weight / 16.0)


share = st.floats(0.0, 1.0)


@given(st.builds(NuplanScore, *[share] * len(fields(NuplanScore))))
def test_the_score_is_a_share_and_zero_where_a_multiplier_is(parts: NuplanScore) -> None:
    assert 0.0 <= parts.total <= 1.0 + 1e-12
    assert parts.total <= min(getattr(parts, name) for name in MULTIPLIERS) + 1e-12


def test_a_planner_that_fails_has_a_score_of_zero() -> None:
    """It would raise the mean of its arm if it had none."""
    failed = failed_score(EpisodeKey("s", Arm.WITH_DOS), "it broke")
    assert failed.measures["nuplan_score"] == 0.0
    assert failed.measures["making_progress"] is False
    scenario = straight_scenario(final_step=60)
    states = np.repeat(scenario.task.start[None], 10, axis=0)
    states[:, 0] += np.arange(10.0)
    drive = known_drive(scenario, Arm.WITH_DOS, 0, states)
    broken = replace(drive, end=EpisodeEnd.PLANNER_FAILURE, error="it broke")
    assert score(scenario, broken).measures["nuplan_score"] == 0.0
    assert score(scenario, drive).measures["nuplan_score"] != 0.0


@pytest.mark.parametrize(("y", "lost"), [(-1.1, 1.0), (-0.9, 0.0)])
def test_who_comes_near_from_beside_counts_where_the_ego_is_over_the_edge(
    y: float, lost: float
) -> None:
    """The ego is 0.15 m over the road's edge, or 0.05 m inside; a car drifts in from beside."""
    beside = steady_tracks([[1.4227, 1.6, -0.2, 10.0]], steps=2)
    states = np.zeros((2, 5))
    states[:, EGO_X], states[:, EGO_Y], states[:, EGO_VELOCITY] = np.arange(2), y, 10.0
    found = []
    for tracks in (steady_tracks(steps=2), beside):
        scenario = straight_scenario(tracks, velocity=10.0, final_step=50)
        drive = known_drive(scenario, Arm.WITH_DOS, 0, states)
        found.append(score(scenario, drive).measures["nuplan_score"])
    alone, near = found
    assert isinstance(alone, float)
    assert isinstance(near, float)
    assert alone - near == pytest.approx(lost * 5.0 / 16.0)
