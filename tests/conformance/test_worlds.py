"""Every built-in planner drives in every loop and copes with gaps in the prediction."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint, entry_points
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dosplan_reactive.traffic import ReactiveTraffic

from dosplan.api import Predictor
from dosplan.scenario.synthetic import LANE_WIDTH, busy_scenario, growing_sets, straight_scenario
from dosplan.scoring.score import score
from dosplan.simulation.loop import run_episode
from dosplan.simulation.settings import IDEAL, REALISTIC, LoopSettings
from dosplan.simulation.traffic import Replay
from dosplan.types import Arm, Observation, Occupancy, Outcome, Scenario
from tests.support.peers import skip_where_missing

LOOPS = {
    "ideal": IDEAL,
    "realistic": REALISTIC,
    "late": LoopSettings(latency=0.3),
    "seldom": LoopSettings(period=0.5),
    "seldom and late": LoopSettings(period=1.0, latency=0.5),
    "real time": LoopSettings(real_time=True),
}


class GappyPredictor(Predictor):
    """Has nothing of the first road user, a beginning of the second and an end of the third."""

    name = "gappy-v1"

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        sets = growing_sets(observation, self.horizon)
        valid = np.array(sets.valid)
        valid[:1] = False
        valid[1:2, 5:] = False
        valid[2:3, :5] = False
        # What is not valid says nothing, whatever it is.
        centre = np.where(valid[..., None], sets.centre, 0.0)
        return replace(sets, valid=valid, centre=centre)


def planners() -> list[Any]:
    return [
        pytest.param(offer, id=offer.name, marks=skip_where_missing(offer.name))
        for offer in sorted(entry_points(group="dosplan.planners"))
    ]


def coming_and_going() -> Scenario:
    """One is on the scene at the start only, one comes later, and one turns up for a moment."""
    scenario = busy_scenario()
    start, valid = scenario.task.start_step, np.array(scenario.tracks.valid)
    valid[0, start + 8 :] = False
    valid[1, : start + 4] = False
    valid[2] = False
    valid[2, start + 5 : start + 7] = True
    task = replace(scenario.task, final_step=start + 20)
    return replace(scenario, task=task, tracks=replace(scenario.tracks, valid=valid))


@pytest.mark.parametrize("loop", LOOPS.values(), ids=LOOPS)
@pytest.mark.parametrize("offer", planners())
def test_every_planner_drives_in_every_loop(
    offer: EntryPoint, loop: LoopSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = count()  # However busy the machine is, prediction and plan take 0.07 s each.
    clock = SimpleNamespace(perf_counter=lambda: 0.07 * next(ticks))
    monkeypatch.setattr("dosplan.api.time", clock)
    planner = offer.load()()
    scenario = coming_and_going()
    episode = run_episode(scenario, planner, GappyPredictor(), Arm.WITH_DOS, loop)
    assert episode.error is None
    assert len(episode.inputs) == 20
    assert all(len(plan.inputs) >= (planner.plan_steps or 0) for plan in episode.plans)
    assert score(scenario, episode).outcome in (Outcome.SUCCESS, Outcome.GOAL_MISSED)


@pytest.mark.parametrize("traffic", [Replay, ReactiveTraffic])
@pytest.mark.parametrize("offer", planners())
def test_every_planner_drives_in_an_empty_world(
    offer: EntryPoint, traffic: type[Replay | ReactiveTraffic]
) -> None:
    scenario = straight_scenario(final_step=12)
    world = REALISTIC, traffic()
    episode = run_episode(scenario, offer.load()(), GappyPredictor(), Arm.WITH_DOS, *world)
    assert episode.error is None
    assert np.abs(episode.states[:, 1]).max() < 0.25 * LANE_WIDTH
