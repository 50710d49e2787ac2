"""Everything that the configurations of the published results name can be built."""

from __future__ import annotations

from pathlib import Path

import pytest

from dosplan.evaluation.methods import build, read_methods
from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.running.sweep import read_sweep

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["all", "calibration", "conditional", "loops", "simple"])
def test_every_method_can_be_evaluated(name: str) -> None:
    for method in read_methods(ROOT / f"predictors/{name}.yaml"):
        build(method, seed=0)


def test_every_run_of_the_leaderboards_sweep_can_be_driven() -> None:
    runs = read_sweep(ROOT / "results/leaderboard/built-in.yaml")
    assert {run.settings.planner for run in runs} == {"mpc", "idm", "cruise", "brake"}
    for predictor, options in {
        run.settings.predictor: run.settings.predictor_options for run in runs
    }.items():
        create_predictor(predictor, 0, options)
    for planner in {run.settings.planner for run in runs}:
        create_planner(planner, 0)
