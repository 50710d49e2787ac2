"""What sets cover of what comes where road users are seen through the sensors of a loop."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dosplan.cli.main import main
from dosplan.evaluation.evaluate import EvaluationConfig, EvaluationError
from dosplan.evaluation.methods import Method
from dosplan.evaluation.samples import sample_file
from dosplan.evaluation.windows import moments
from dosplan.plugins.registry import create_predictor
from dosplan.scenario.synthetic import steady_tracks, straight_scenario
from dosplan.simulation.settings import IDEAL, LoopSettings, SensingSettings
from dosplan.simulation.traffic import Replay
from dosplan.simulation.world import World, watch
from dosplan.system.files import read_json
from dosplan.types import RoadUserKind
from tests.support.scenes import User, driving, write_scenario_xml
from tests.support.sensors import leave_unfiltered

SIGMA = 0.5
NOISY = LoopSettings(sensing=SensingSettings(position=SIGMA, correlation=0.0))
CIRCLE = Method("circle", "fixed-circle", {"r": 0.8})


def test_a_circle_covers_the_share_that_the_noise_of_the_position_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    leave_unfiltered(monkeypatch)
    # The predicted centre is off by the plane normal error of the present one, at every horizon.
    steady = [[12.0 * k, 40.0 * k, 0.0, 5.0] for k in range(40)]
    scenario = straight_scenario(steady_tracks(steady, steps=90))
    methods = [("circle", create_predictor("fixed-circle", 0, {"r": 0.8}))]
    samples = sample_file(scenario, methods, every=1, loop=replace(NOISY, latency=0.3), seed=3)
    expected = 1.0 - math.exp(-(0.8**2) / (2.0 * SIGMA**2))
    for h in range(3):
        distance = samples.sets[0].distance[samples.recorded[:, h], h]
        assert len(distance) > 1500
        four_errors = 4.0 * math.sqrt(expected * (1.0 - expected) / len(distance))
        assert np.mean(distance <= 1.0) == pytest.approx(expected, abs=four_errors)


def test_the_future_begins_when_a_plan_acts_and_ends_with_the_prediction() -> None:
    tracks = steady_tracks([[0.0, 0.0, 0.0, 5.0]], steps=101)
    late = LoopSettings(latency=0.3)
    first = next(moments(straight_scenario(tracks), 5, late, reach=37))
    assert np.array_equal(first.truth[0, :37], tracks.states[0, 4:41])
    assert first.recorded[0].tolist() == [True] * 37 + [False] * 3
    assert np.array_equal(first.now[0], tracks.states[0, 0])

    # The road user drives as it is predicted, so that every set that is judged is about it.
    scenario = straight_scenario(tracks)
    predictors = {n: create_predictor("constant-velocity", 0, {"horizon": n}) for n in (40, 43)}
    for horizon, counted in ((40, [True, True, True, False]), (43, [True] * 4)):
        samples = sample_file(scenario, [("cv", predictors[horizon])], 100, late)
        assert samples.recorded[0].tolist() == counted
        (trajectory,) = samples.trajectories.values()
        assert np.nanmax(trajectory.error) < 1e-6
        assert trajectory.count.tolist() == [horizon - 3]


def test_errors_are_those_that_an_ego_meets_that_drives_in_the_loop() -> None:
    scenario = straight_scenario(steady_tracks([[9.0, 0.0, 0.0, 5.0]], steps=60))
    driving_world = World(scenario, Replay(seed=7), loop=NOISY)
    for seen in watch(scenario, 1, loop=NOISY, seed=7):
        if seen.step == driving_world.now:
            there = driving_world.observation()
            assert np.array_equal(seen.states[:, -1], there.states[:, -1])
            assert not np.array_equal(seen.states[0, -1], scenario.tracks.states[0, seen.step])
            if seen.step == 20:
                return
            driving_world.step(np.zeros(2))
    pytest.fail("step 20 was not reached")


def test_who_is_not_seen_is_in_no_window() -> None:
    first = [[20.0, 0.0, 0.0, 0.0], [40.0, 0.0, 0.0, 0.0], [-20.0, 0.0, 0.0, 0.0]]
    kinds = (RoadUserKind.TRUCK, RoadUserKind.CAR, RoadUserKind.CAR)
    tracks = steady_tracks(first, steps=30, kinds=kinds)
    scenario = straight_scenario(tracks)
    blind = LoopSettings(sensing=SensingSettings(occlusion=True))
    for loop, ids in ((IDEAL, tracks.ids), (blind, tracks.ids[[0, 2]])):
        for moment in moments(scenario, 5, loop):
            assert sorted(moment.observation.ids[moment.rows]) == sorted(ids)


def test_the_command_takes_a_loop_and_says_so(tmp_path: Path) -> None:
    users = [User(7, driving(20.0, 0.0, 5.0, steps=61))]
    file = write_scenario_xml(tmp_path / "ZAM_A-1_1_T-1.xml", users=users)
    figures: dict[str, Any] = {}
    for name, options in {
        "plain": [],
        "ideal": ["--loop", "ideal"],
        "late": ["--set", "loop.latency=0.2"],
        "real": ["--loop", "realistic", "--set", "loop.sensing.dropout_rate=0"],
    }.items():
        out = tmp_path / f"{name}.json"
        common = ["--predictor", "constant-velocity", "--workers", "1", "--json", str(out)]
        assert main(["evaluate", str(file), *common, *options]) == 0
        figures[name] = read_json(out)
    assert figures["plain"] == figures["ideal"]
    assert figures["plain"]["data"]["loop"] == "ideal"
    assert figures["late"]["data"]["loop"] == "ideal, latency=0.2"
    assert figures["real"]["data"]["loop"] == "realistic, sensing.dropout_rate=0.0"
    assert figures["real"]["trajectories"][0]["ade"] > figures["late"]["trajectories"][0]["ade"]


def test_a_loop_that_cannot_be_measured_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, message in (
        ({"loop": "reaslistic"}, "there is no loop 'reaslistic'"),
        ({"loop_options": {"real_time": True}}, "real_time is True"),
        ({"loop_options": {"latency": 4.0}}, "latency is 4.0 s; it must be less than the 4 s"),
    ):
        with pytest.raises(EvaluationError, match=message):
            EvaluationConfig(source=str(tmp_path), methods=(CIRCLE,), **options)
    args = ["evaluate", str(tmp_path), "--predictor", "dos", "--futures", "2"]
    assert main([*args, "--traffic", "reactive", "--set", "loop.latency=0.1"]) == 2
    assert "--set does not go with --futures" in capsys.readouterr().err
