"""The sweep of the frontier: its sets have the sizes that were measured, and all can be driven."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from dosplan.plugins.registry import choose_predictor, create_predictor
from dosplan.results.sweeps import SweepRun
from dosplan.running.sweep import read_sweep
from dosplan.system.files import read_json
from dosplan.types import Arm
from results.frontier import scales

LEVELS = {"50", "70", "80", "90", "95", "99"}
CALIBRATED = {"union", "free"}
POINTS = {"points", "constant-velocity-points", "true-future"}


@pytest.fixture(scope="module")
def runs() -> tuple[SweepRun, ...]:
    return read_sweep(scales.HERE / "frontier.yaml")


def test_every_method_has_every_coverage_in_one_world(runs: tuple[SweepRun, ...]) -> None:
    counts = Counter(run.values["method"] for run in runs)
    methods = {method.label for method in scales.METHODS} | CALIBRATED
    assert counts == dict.fromkeys(methods, len(LEVELS)) | dict.fromkeys(POINTS, 1)
    for run in runs:
        own = run.settings
        assert (own.source, own.planner, own.traffic, own.loop) == (
            "suite",
            "mpc",
            "replay",
            "ideal",
        )
        assert (own.loop_options, own.futures) == ({"latency": 0.3}, 5)
        alone = run.values["method"] in POINTS
        assert own.arms == ((Arm.WITHOUT_DOS,) if alone else (Arm.WITH_DOS,))
        assert own.ranked is (run.values["method"] != "true-future")


def test_sizes_are_those_that_were_measured(runs: tuple[SweepRun, ...]) -> None:
    written = read_json(scales.HERE / "scales.json")
    assert written["every"] == scales.EVERY  # As the command of the page measures.
    found = written["factors"]
    assert {level for factors in found.values() for level in factors} == LEVELS
    measured = {method.label: method for method in scales.METHODS}
    for run in runs:
        name, options = run.values["method"], run.settings.predictor_options
        if name in CALIBRATED:
            assert options == {"sets": name, "coverage": float(run.values["coverage"]) / 100.0}
        elif name not in POINTS:
            # The measured method, but for its factor of one.
            one = measured[name]
            (factor,) = (key for key in ("scale", "r", "z") if key in one.options)
            wanted = {**one.options, factor: found[name][run.values["coverage"]]}
            chosen = choose_predictor(run.settings.predictor, options)
            assert chosen == choose_predictor(one.predictor, wanted)


def test_a_level_of_each_method_can_be_made(runs: tuple[SweepRun, ...]) -> None:
    for run in runs:
        if run.values.get("coverage", "99") == "99":  # The highest level needs the most windows.
            own = run.settings
            made = create_predictor(own.predictor, own.seed, own.predictor_options)
            assert made.has_sets is (run.values["method"] not in POINTS)


def test_a_factor_covers_its_share_with_each_horizon_counting_alike() -> None:
    near, far = np.arange(1.0, 11.0), np.array([100.0, 200.0])
    assert scales.factor([near], 0.5) == 5.0
    assert scales.factor([near, far], 0.5) == 10.0  # All of the near and none of the far.
    assert scales.factor([near, far], 0.75) == 100.0
    assert scales.factor([near, far], 0.99) == 200.0
