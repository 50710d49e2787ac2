"""What belongs to the benchmark cannot be overridden by a plug-in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from dosplan_baseline.brake import BrakePlanner
from dosplan_simple.predictors import ConstantVelocityPredictor

from dosplan.api import Planner, PluginError, Predictor
from dosplan.scenario.synthetic import busy_scenario, growing_sets
from dosplan.simulation.world import watch
from dosplan.types import Observation, Occupancy


def other(self: object, *arguments: object) -> Any:
    return None


@pytest.mark.parametrize("base", [Planner, BrakePlanner])
@pytest.mark.parametrize(("method", "hook"), [("plan", "compute_plan"), ("reset", "prepare")])
def test_planner_that_overrides_a_final_method_is_refused(
    base: type, method: str, hook: str
) -> None:
    wanted = f"Mine overrides Planner.{method}, .*; override {hook} instead"
    with pytest.raises(TypeError, match=wanted):
        type("Mine", (base,), {method: other})


@pytest.mark.parametrize("base", [Predictor, ConstantVelocityPredictor])
@pytest.mark.parametrize(
    ("method", "hook"), [("predict", "compute_occupancy"), ("reset", "prepare")]
)
def test_predictor_that_overrides_a_final_method_is_refused(
    base: type, method: str, hook: str
) -> None:
    wanted = f"Mine overrides Predictor.{method}, .*; override {hook} instead"
    with pytest.raises(TypeError, match=wanted):
        type("Mine", (base,), {method: other})


def test_a_second_base_cannot_smuggle_one_in() -> None:
    class Aside:
        plan: Callable[..., Any] = other

    with pytest.raises(TypeError, match=r"Planner\.plan"):
        type("Mine", (Aside, BrakePlanner), {})


def test_hooks_may_be_overridden() -> None:
    assert issubclass(type("Mine", (BrakePlanner,), {"compute_plan": other}), Planner)


def test_a_predictor_that_says_it_has_no_sets_has_none() -> None:
    class Odd(ConstantVelocityPredictor):
        name = "odd-v1"

        def compute_occupancy(self, observation: Observation) -> Occupancy:
            return growing_sets(observation, self.horizon)

    observation = next(iter(watch(busy_scenario(), 10)))
    with pytest.raises(PluginError, match="its sets have an extent; set has_sets = True"):
        Odd().predict(observation)
    Odd.has_sets = True
    assert Odd().predict(observation).semi_axes.any()
