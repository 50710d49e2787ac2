"""The conformance checks: every built-in passes, every bad plug-in fails at its own rule."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import numpy as np
import pytest
from dosplan_baseline.cruise import CruisePlanner
from dosplan_simple.predictors import ConstantVelocityPredictor

from dosplan.api import NoSettings, Planner, PluginSpec, PredictorSettings
from dosplan.plugins import conformance
from dosplan.plugins.conformance import Report, check_planner, check_predictor
from dosplan.plugins.short_drives import HORIZON
from dosplan.scenario.synthetic import forking_sets
from dosplan.types import Observation, Occupancy, Plan, PlanningTask, RoadMap
from dosplan.vehicle import VehicleParameters
from tests.support.peers import skip_where_missing


def installed(kind: str) -> list[Any]:
    offers = entry_points(group=f"dosplan.{kind}")
    return [
        pytest.param(offer, id=offer.name, marks=skip_where_missing(offer.name))
        for offer in sorted(offers)
    ]


@pytest.mark.parametrize("offer", installed("planners"))
def test_every_installed_planner_conforms(offer: EntryPoint) -> None:
    assert check_planner(offer.load()).failures == ()


@pytest.mark.parametrize("offer", installed("predictors"))
def test_every_installed_predictor_conforms(offer: EntryPoint) -> None:
    assert check_predictor(offer.load()).failures == ()


def plan_of(observation: Observation, inputs: np.ndarray) -> Plan:
    states = [observation.ego]
    for u in inputs:
        states.append(VehicleParameters().step(states[-1], u, observation.dt))
    return Plan(states=np.stack(states), inputs=inputs)


class GoodPlanner(Planner):
    """Rolls on; the bad ones below each break one rule."""

    name = "good-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, np.zeros((10, 2)))


class NeedsArgument(GoodPlanner):
    def __init__(self, weights: str, *, seed: int = 0, settings: NoSettings = NoSettings()) -> None:
        super().__init__(seed=seed, settings=settings)


class NotAPlanner:
    name = "stranger-v1"

    def __init__(self, *, seed: int) -> None:
        self.seed = seed


class Unversioned(GoodPlanner):
    name = "good"


class ReturnsNothing(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Any:
        return None


class StartsElsewhere(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return Plan(states=np.tile(observation.ego + 0.1, (3, 1)), inputs=np.zeros((2, 2)))


class PlansNan(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, np.full((10, 2), np.nan))


class PlansTooShort(GoodPlanner):
    plan_steps = 11


class Dice(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, np.random.default_rng().normal(0.0, 0.1, (10, 2)))


class Rememberer(GoodPlanner):
    calls = 0

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        self.calls += 1
        return plan_of(observation, np.full((10, 2), [0.0, -0.01 * self.calls]))


class Writer(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        observation.states[:, -1, 0] += 1.0
        return super().compute_plan(observation, occupancy)


class Burglar(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        assert observation.states.base is not None
        observation.states.base.setflags(write=True)
        observation.states.base[..., 0] += 1.0
        return super().compute_plan(observation, occupancy)


class NeedsCompany(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        observation.states[:, -1, 0].min()
        return super().compute_plan(observation, occupancy)


class HatesCrowds(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        if len(observation.ids) > 20:
            raise MemoryError("at most 20 road users")
        return super().compute_plan(observation, occupancy)


class NeedsPast(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        inputs = np.zeros((10, 2))
        past = observation.states[:, 0, 3]
        inputs[:, 1] = past.mean() * 0.01 if len(past) else 0.0
        return plan_of(observation, inputs)


class FearsGhosts(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        braking = -0.1 * float(np.sum(occupancy.semi_axes > 0.0) > 0)
        return plan_of(observation, np.full((10, 2), [0.0, braking]))


class Teleporter(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return Plan(states=np.tile(observation.ego, (11, 1)), inputs=np.zeros((10, 2)))


class PathPoints(GoodPlanner):
    """Where the ego is on the path, and steers straight on, it returns what the vehicle does."""

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        states = np.tile(observation.ego * [1.0, 0.0, 0.0, 1.0, 0.0], (11, 1))
        states[:, 0] += states[:, 3] * observation.dt * np.arange(11)
        return Plan(states=states, inputs=np.zeros((10, 2)))


class Rocket(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, np.full((10, 2), [0.0, 30.0]))


class HatesUnions(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        if occupancy.union is not None:
            raise ValueError("what is this?")
        return super().compute_plan(observation, occupancy)


class Sleeper(GoodPlanner):
    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        time.sleep(0.05)
        return super().compute_plan(observation, occupancy)


def failures(report: Report) -> dict[str, str]:
    assert not report.ok
    return {check.name: check.message for check in report.failures}


# What is random cannot pass the other checks that compare two runs either.
ALSO = {"deterministic": {"reset_forgets", "future_unseen", "arms_agree_without_predictions"}}

BAD_PLANNERS = [
    (NeedsArgument, "constructs", "missing 1 required positional argument: 'weights'"),
    (NotAPlanner, "constructs", "is no dosplan.api.Planner; inherit from it"),
    (Unversioned, "versioned_name", "name is 'good'; results are kept by name"),
    (ReturnsNothing, "plans", "compute_plan returned NoneType, not a Plan"),
    (StartsElsewhere, "plans", "the plan starts 0.1 away"),
    (PlansNan, "plans", "Plan.inputs holds a NaN"),
    (PlansTooShort, "plans", "the plan holds 10 inputs, plan_steps says 11 or more; lower it"),
    (Dice, "deterministic", "two instances with the same seed differ in Plan.inputs"),
    (Rememberer, "reset_forgets", "prepare() must clear"),
    (Writer, "plans", "copy the array before you write to it"),
    (Burglar, "input_untouched", "changed Observation.states"),
    (NeedsCompany, "no_road_users", "ValueError: zero-size array"),
    (HatesUnions, "unions", "what is this?"),
    (HatesCrowds, "many_road_users", "MemoryError: at most 20 road users"),
    (NeedsPast, "short_history", "holds a NaN"),
    (FearsGhosts, "arms_agree_without_predictions", "the two arms differ in Plan.inputs"),
    (Teleporter, "vehicle_model", "make them with VehicleParameters.step"),
    (PathPoints, "vehicle_model", "Plan.states[0] must be observation.ego"),
    (Rocket, "actuator_limits", "limit them with VehicleParameters.clip_input"),
    (Sleeper, "time", "move what does not change to prepare()"),
]


@pytest.mark.parametrize(
    ("planner", "name", "message"), BAD_PLANNERS, ids=[bad[0].__name__ for bad in BAD_PLANNERS]
)
def test_a_bad_planner_fails_at_its_own_rule(
    planner: type[Any], name: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if planner is Sleeper:  # Alone, since a busy machine makes anybody slow.
        monkeypatch.setattr(conformance, "SLOW_SECONDS", 0.03)
    found = failures(check_planner(planner))
    assert message in found[name]
    assert "\n" not in found[name]
    assert set(found) - ALSO.get(name, set()) == {name}


class GoodPredictor(ConstantVelocityPredictor):
    name = "good-v1"
    has_sets = True

    def sets(self, observation: Observation, **changed: Any) -> Occupancy:
        plain = super().compute_occupancy(observation)
        fields = {f: getattr(plain, f) for f in plain.__dataclass_fields__} | changed
        return Occupancy(**fields)


class ForgetsSomebody(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        return self.sets(observation, ids=observation.ids[::-1])


class FixedHorizon(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        wanted, self.horizon = self.horizon, 40
        try:
            return super().compute_occupancy(observation)
        finally:
            self.horizon = wanted


class TakesNoSettings(GoodPredictor):
    def __init__(self, *, seed: int = 0) -> None:
        super().__init__(seed=seed)


class PredictsNan(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        shape = (len(observation.ids), self.horizon, 2)
        return self.sets(observation, centre=np.full(shape, np.nan))


class Gambler(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        shape = (len(observation.ids), self.horizon, 2)
        return self.sets(observation, semi_axes=np.random.default_rng().uniform(size=shape))


class Learner(GoodPredictor):
    met = 0.0

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        self.met += 0.01
        shape = (len(observation.ids), self.horizon, 2)
        return self.sets(observation, semi_axes=np.full(shape, self.met))


class Scribbler(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        assert observation.states.base is not None
        observation.states.base.setflags(write=True)
        observation.states.base[..., 0] += 1.0
        return super().compute_occupancy(observation)


class Loner(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        observation.size.max()
        return super().compute_occupancy(observation)


class Historian(GoodPredictor):
    def compute_occupancy(self, observation: Observation) -> Occupancy:
        shape = (len(observation.ids), self.horizon)
        first = np.broadcast_to(observation.states[:, :1, 2], shape)
        return self.sets(observation, heading=first)


class LeavesCover(GoodPredictor):
    """Has the most likely component where the cover should be."""

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        sets = forking_sets(observation, self.horizon)
        return replace(sets.likeliest(), union=sets.union)


BAD_PREDICTORS = [
    (TakesNoSettings, "constructs", "unexpected keyword argument 'settings'"),
    (GoodPlanner, "constructs", "is no dosplan.api.Predictor; inherit from it"),
    (ForgetsSomebody, "predicts", "Occupancy.ids must be observation.ids"),
    (PredictsNan, "predicts", "Occupancy.centre holds a NaN"),
    (LeavesCover, "unions_covered", "component 1 of road user 100 leaves the ellipse of Occupancy"),
    (FixedHorizon, "one_step_horizon", "predicted 40 steps, asked for 1"),
    (Gambler, "deterministic", "differ in Occupancy.semi_axes"),
    (Learner, "reset_forgets", "another Occupancy.semi_axes"),
    (Scribbler, "input_untouched", "changed Observation.states"),
    (Loner, "no_road_users", "zero-size array"),
    (Historian, "short_history", "Occupancy.heading holds a NaN"),
]


@pytest.mark.parametrize(
    ("predictor", "name", "message"),
    BAD_PREDICTORS,
    ids=[bad[0].__name__ for bad in BAD_PREDICTORS],
)
def test_a_bad_predictor_fails_at_its_own_rule(
    predictor: type[Any], name: str, message: str
) -> None:
    found = failures(check_predictor(predictor))
    assert message in found[name]
    assert set(found) - ALSO.get(name, set()) == {name}


def test_good_plugins_pass_every_check() -> None:
    for report in (check_planner(GoodPlanner), check_predictor(GoodPredictor)):
        assert report.ok
        assert report.plugin == "good-v1"
        assert len({check.name for check in report.checks}) == len(report.checks) >= 11
        assert all(check.message == "" for check in report.checks)


@dataclass(frozen=True)
class Braking:
    """The options of ``Brakes``."""

    deceleration: float = 1.0


class Brakes(GoodPlanner):
    """Brakes, as long as it is not told to go backwards."""

    settings = Braking

    def __init__(self, *, seed: int = 0, settings: Braking = Braking()) -> None:
        super().__init__(seed=seed, settings=settings)
        self.deceleration = settings.deceleration

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        return plan_of(observation, np.full((3, 2), [0.0, -self.deceleration]))


def test_settings_are_checked_with_their_plugin() -> None:
    assert check_planner(PluginSpec(Brakes)).ok
    found = failures(check_planner(PluginSpec(Brakes, Braking(deceleration=20.0))))
    assert "Plan.inputs ask at step 0 for" in found["actuator_limits"]


class FarSighted(GoodPlanner):
    look_ahead = 60

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        assert occupancy.horizon == 60
        return super().compute_plan(observation, occupancy)


def test_a_planner_is_handed_sets_as_far_as_it_looks_ahead() -> None:
    assert check_planner(FarSighted).failures == ()


def test_a_predictor_is_checked_at_two_horizons() -> None:
    seen: list[int] = []

    class Told(GoodPredictor):
        def __init__(self, *, seed: int = 0, settings: PredictorSettings) -> None:
            super().__init__(seed=seed, settings=settings)
            seen.append(settings.horizon)

    assert check_predictor(Told).ok
    assert set(seen) == {HORIZON, 1}


class Prepared(GoodPlanner):
    def prepare(self, task: PlanningTask, road_map: RoadMap, vehicle: VehicleParameters) -> None:
        raise OSError("no weights")


def test_a_planner_that_cannot_prepare_says_where() -> None:
    found = failures(check_planner(Prepared))
    assert found.keys() == {"plans"}
    assert found["plans"].startswith("raised OSError: no weights (test_conformance.py:")


class Leaver(CruisePlanner):
    """Ends the process, from far below its own code."""

    name = "leaver-v1"

    def compute_plan(self, observation: Observation, occupancy: Occupancy) -> Plan:
        argparse.ArgumentParser().error("no such option")


def test_a_planner_that_exits_fails_at_its_own_line() -> None:
    line = Leaver.compute_plan.__code__.co_firstlineno + 1
    message = f"raised SystemExit: 2 (test_conformance.py:{line})"
    assert failures(check_planner(Leaver)) == {"plans": message}
