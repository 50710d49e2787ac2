"""Checks that a plug-in keeps the contract of ``dosplan.api``: what ``dosplan check`` runs.

Every check is a function that returns when the plug-in is right and raises ``_BrokenError``
with what to fix when it is not. Anything else that a plug-in raises breaks the check as well.
The scenes are built in code (``dosplan.scenes``); no file is read.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from dosplan.api import NoPlanError, OraclePredictor, Planner, Predictor
from dosplan.registry import failure_place, one_line
from dosplan.scenes import busy_scenario, crowded_scenario, growing_sets, straight_scenario
from dosplan.simulation import observe
from dosplan.types import (
    HISTORY_STEPS,
    FloatArray,
    Observation,
    Occupancy,
    Plan,
    Scenario,
)
from dosplan.vehicle import VehicleParameters

SEED = 7
HORIZON = 40
SLOW_SECONDS = 2.0  # Median time of a call; a cycle of the benchmark is 0.1 s.
MODEL_TOLERANCE = 0.05  # m, rad and m/s between a plan's states and those of the vehicle model.
INPUT_TOLERANCE = 0.05  # rad/s and m/s2 beyond what the actuators deliver.

_CYCLES = 3


class _BrokenError(Exception):
    """A broken rule; the message says what to fix."""


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Attributes:
        name: What was checked.
        ok: Whether the plug-in passed.
        message: What to fix; empty when it passed.
    """

    name: str
    ok: bool
    message: str = ""


@dataclass(frozen=True)
class Report:
    """The results of all checks.

    Attributes:
        plugin: Name of the plug-in.
        checks: One result per check. Where a plug-in does not construct or does nothing on
            the plain scene, the checks end there.
    """

    plugin: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether every check passed."""
        return all(check.ok for check in self.checks)

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that did not pass."""
        return tuple(check for check in self.checks if not check.ok)


@dataclass(frozen=True)
class _Trace:
    """What a plug-in did over a few cycles.

    Attributes:
        results: What it returned, cycle by cycle.
        seconds: How long each call took, s.
        touched: Fields of what it was handed that it changed.
    """

    results: tuple[Any, ...]
    seconds: tuple[float, ...]
    touched: tuple[str, ...]


_Drive = Callable[..., _Trace]


def check_planner(factory: Callable[..., Planner]) -> Report:
    """Checks a planner.

    Args:
        factory: Its class, or anything that takes ``seed`` and returns an instance.

    Returns:
        The report; nothing is raised for a broken planner.
    """

    def build() -> Planner:
        planner = factory(seed=SEED)
        if not isinstance(planner, Planner):
            raise _BrokenError("is no dosplan.api.Planner; inherit from it")
        return planner

    def drive(scenario: Scenario, **options: Any) -> _Trace:
        return _drive_planner(build(), scenario, **options)

    return _report(
        factory,
        (
            ("constructs", build),
            ("plans", lambda: drive(busy_scenario())),
        ),
        (
            *_common_checks(build, drive, _drive_planner),
            ("arms_agree_without_predictions", lambda: _arms_agree(drive)),
            ("vehicle_model", lambda: _follows_model(drive(busy_scenario()))),
            ("actuator_limits", lambda: _within_limits(drive(busy_scenario()))),
        ),
    )


def check_predictor(factory: Callable[..., Predictor]) -> Report:
    """Checks a predictor.

    Args:
        factory: Its class, or anything that takes ``seed`` and ``horizon`` and returns an
            instance.

    Returns:
        The report; nothing is raised for a broken predictor.
    """

    def build(horizon: int = HORIZON) -> Predictor:
        predictor = factory(seed=SEED, horizon=horizon)
        if not isinstance(predictor, Predictor):
            raise _BrokenError("is no dosplan.api.Predictor; inherit from it")
        return predictor

    def drive(scenario: Scenario, **options: Any) -> _Trace:
        return _drive_predictor(build(), scenario, **options)

    return _report(
        factory,
        (
            ("constructs", build),
            ("predicts", lambda: drive(busy_scenario())),
        ),
        (
            *_common_checks(build, drive, _drive_predictor),
            ("one_step_horizon", lambda: _drive_predictor(build(1), busy_scenario())),
        ),
    )


def _common_checks(
    build: Callable[[], Planner | Predictor], drive: _Drive, drive_one: _Drive
) -> tuple[tuple[str, Callable[[], object]], ...]:
    return (
        ("versioned_name", lambda: _versioned(build())),
        ("deterministic", lambda: _deterministic(drive)),
        ("reset_forgets", lambda: _forgets(build(), drive, drive_one)),
        ("input_untouched", lambda: _keeps_input(drive(busy_scenario()))),
        ("no_road_users", lambda: drive(straight_scenario())),
        ("many_road_users", lambda: _copes(drive)),
        ("short_history", lambda: drive(busy_scenario(), visible=1)),
        ("time", lambda: _in_time(drive(busy_scenario()))),
    )


def _report(
    factory: Callable[..., Any],
    first: Sequence[tuple[str, Callable[[], object]]],
    then: Sequence[tuple[str, Callable[[], object]]],
) -> Report:
    """Runs ``first`` up to the first that breaks, for the rest would break alike; then ``then``."""
    plugin = getattr(factory, "name", getattr(factory, "__name__", repr(factory)))
    results: list[Check] = []
    for name, check in first:
        results.append(_check(name, check, factory))
        if not results[-1].ok:
            break
    else:
        results.extend(_check(name, check, factory) for name, check in then)
    return Report(str(plugin), tuple(results))


def _check(name: str, check: Callable[[], object], factory: Callable[..., Any]) -> Check:
    try:
        check()
    except _BrokenError as broken:
        return Check(name, False, str(broken))
    except (Exception, SystemExit) as error:
        advice = "; copy the array before you write to it" if "read-only" in str(error) else ""
        message = f"raised {one_line(error)} ({failure_place(error, factory)}){advice}"
        return Check(name, False, message)
    return Check(name, True)


def _observation(
    scenario: Scenario, driven: FloatArray, visible: int = HISTORY_STEPS
) -> Observation:
    """What is seen after some driving; road users have been on the scene for ``visible`` steps."""
    step = scenario.task.start_step + len(driven) - 1
    seen = observe(scenario, step, driven, HISTORY_STEPS)
    valid = np.array(seen.valid)
    valid[:, : HISTORY_STEPS - visible] = False
    return replace(seen, valid=valid, states=np.where(valid[..., None], seen.states, np.nan))


def _drive_planner(
    planner: Planner,
    scenario: Scenario,
    *,
    visible: int = HISTORY_STEPS,
    sets: Callable[[Observation], Occupancy] = growing_sets,
) -> _Trace:
    """A few cycles in closed loop."""
    vehicle = VehicleParameters()
    planner.reset(scenario.task, scenario.road_map, vehicle)
    driven = [np.array(scenario.task.start)]
    plans: list[Plan] = []
    seconds: list[float] = []
    touched: list[str] = []
    for _ in range(_CYCLES):
        observation = _observation(scenario, np.stack(driven), visible)
        occupancy = sets(observation)
        before = copy.deepcopy((observation, occupancy))
        plans.append(planner.plan(observation, occupancy))
        seconds.append(planner.last_seconds)
        for old, new in zip(before, (observation, occupancy), strict=True):
            touched.extend(_differences(old, new))
        applied = vehicle.clip_input(driven[-1], plans[-1].inputs[0], scenario.dt)
        driven.append(vehicle.step(driven[-1], applied, scenario.dt))
    return _Trace(tuple(plans), tuple(seconds), tuple(touched))


def _drive_predictor(
    predictor: Predictor, scenario: Scenario, *, visible: int = HISTORY_STEPS
) -> _Trace:
    """A few predictions of a scene that moves on; the ego stands."""
    if isinstance(predictor, OraclePredictor):
        predictor.reveal(scenario.tracks)
    predictor.reset(scenario.task, scenario.road_map)
    driven = np.repeat(scenario.task.start[None], _CYCLES, axis=0)
    sets: list[Occupancy] = []
    seconds: list[float] = []
    touched: list[str] = []
    for cycle in range(_CYCLES):
        observation = _observation(scenario, driven[: cycle + 1], visible)
        before = copy.deepcopy(observation)
        sets.append(predictor.predict(observation))
        seconds.append(predictor.last_seconds)
        touched.extend(_differences(before, observation))
    return _Trace(tuple(sets), tuple(seconds), tuple(touched))


def _differences(one: Any, other: Any) -> list[str]:
    """Names of the array fields in which two values of the same type differ."""
    return [
        f"{type(one).__name__}.{field.name}"
        for field in fields(one)
        if isinstance(getattr(one, field.name), np.ndarray)
        and not np.array_equal(
            getattr(one, field.name),
            getattr(other, field.name),
            equal_nan=getattr(one, field.name).dtype.kind == "f",
        )
    ]


def _changed(one: _Trace, other: _Trace) -> list[str]:
    """Array fields in which the results of two drives differ."""
    pairs = zip(one.results, other.results, strict=True)
    return sorted({name for a, b in pairs for name in _differences(a, b)})


# Checks.


def _versioned(plugin: Planner | Predictor) -> None:
    name = getattr(plugin, "name", None)
    if not isinstance(name, str) or not re.fullmatch(r"\S+-v\d+", name):
        raise _BrokenError(
            f"name is {name!r}; results are kept by name, so give it a version: 'my-idea-v1'"
        )


def _deterministic(drive: _Drive) -> None:
    if changed := _changed(drive(busy_scenario()), drive(busy_scenario())):
        raise _BrokenError(
            f"two instances with the same seed differ in {', '.join(changed)}; draw every "
            "random number from a generator made from seed"
        )


def _forgets(used: Planner | Predictor, drive: _Drive, drive_one: _Drive) -> None:
    drive_one(used, busy_scenario(velocity=4.0))
    if changed := _changed(drive(busy_scenario()), drive_one(used, busy_scenario())):
        raise _BrokenError(
            f"after another episode, a scene gives another {', '.join(changed)}; "
            "prepare() must clear what an episode left behind"
        )


def _keeps_input(trace: _Trace) -> None:
    if trace.touched:
        raise _BrokenError(
            f"changed {', '.join(sorted(set(trace.touched)))}; work on copies of what it is handed"
        )


def _copes(drive: _Drive) -> None:
    with suppress(NoPlanError):  # To say that nothing is free in a crowd is an answer, too.
        drive(crowded_scenario())


def _in_time(trace: _Trace) -> None:
    median = float(np.median(trace.seconds))
    if median > SLOW_SECONDS:
        raise _BrokenError(
            f"a call takes {median:.2f} s (median of {len(trace.seconds)}), more than "
            f"{SLOW_SECONDS:g} s; move what does not change to prepare()"
        )


def _arms_agree(drive: _Drive) -> None:
    def nobody(observation: Observation) -> Occupancy:
        sets = growing_sets(observation)
        return replace(sets, valid=np.zeros_like(sets.valid))

    with_sets = drive(busy_scenario(), sets=nobody)
    without = drive(busy_scenario(), sets=lambda observation: nobody(observation).without_sets())
    if changed := _changed(with_sets, without):
        raise _BrokenError(
            f"with nobody predicted, the two arms differ in {', '.join(changed)}; leave out road "
            "users and steps where Occupancy.valid is False"
        )


def _follows_model(trace: _Trace) -> None:
    vehicle, dt = VehicleParameters(), straight_scenario().dt
    for plan in trace.results:
        state = plan.states[0]
        for step, (u, planned) in enumerate(zip(plan.inputs, plan.states[1:], strict=True)):
            state = vehicle.step(state, u, dt)
            gap = float(np.max(np.abs(planned - state)))
            if gap > MODEL_TOLERANCE:
                raise _BrokenError(
                    f"Plan.states are {gap:.2g} away from what Plan.inputs lead to at step "
                    f"{step + 1}; make them with VehicleParameters.step"
                )


def _within_limits(trace: _Trace) -> None:
    vehicle, dt = VehicleParameters(), straight_scenario().dt
    for plan in trace.results:
        for step, (state, u) in enumerate(zip(plan.states[:-1], plan.inputs, strict=True)):
            excess = float(np.max(np.abs(vehicle.clip_input(state, u, dt) - u)))
            if excess > INPUT_TOLERANCE:
                raise _BrokenError(
                    f"Plan.inputs ask at step {step} for {excess:.2g} more than the vehicle "
                    "can do; limit them with VehicleParameters.clip_input"
                )
