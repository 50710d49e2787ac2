"""Checks that a plug-in keeps the contract of ``dosplan.api``: what ``dosplan check`` runs.

Every check is a function that returns when the plug-in is right and raises ``BrokenError``
with what to fix when it is not. Anything else that a plug-in raises breaks the check as well.
The scenes are built in code (``dosplan.scenario.synthetic``); no file is read.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dosplan.api import NoPlanError, OraclePredictor, Planner, PluginSpec, PluginT, Predictor
from dosplan.geometry import ellipse_boundary, mahalanobis
from dosplan.plugins.short_drives import (
    HORIZON,
    Trace,
    another_future,
    changed_fields,
    drive_planner,
    drive_predictor,
)
from dosplan.scenario.synthetic import (
    busy_scenario,
    crowded_scenario,
    forking_sets,
    growing_sets,
    off_path_scenario,
    straight_scenario,
)
from dosplan.system.errors import failure_place, one_line
from dosplan.types import Observation, Occupancy, Scenario

SEED = 7
SLOW_SECONDS = 2.0  # Median time of a call; a cycle of the benchmark is 0.1 s.
MODEL_TOLERANCE = 0.05  # m, rad and m/s between a plan's states and those of the vehicle model.
BOUNDARY_POINTS = 64  # On each component of a union, of which none may be outside of its cover.
COVER_TOLERANCE = 1e-6  # Of the cover's size.
INPUT_TOLERANCE = 0.05  # rad/s and m/s2 beyond what the actuators deliver.


class BrokenError(Exception):
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
class Rule:
    """A check that is still to be made.

    Attributes:
        name: What it checks.
        holds: Returns when the plug-in is right, and raises when it is not.
        advice: What to do where the plug-in itself raises.
    """

    name: str
    holds: Callable[[], object]
    advice: str = ""


_Drive = Callable[..., Trace]


@dataclass(frozen=True)
class Contract:
    """The checks of one plug-in, to be made one by one.

    Attributes:
        plugin: Name of the plug-in.
        made_by: The plug-in's class.
        first: Checks that end at the first failure, as the others would fail for the same reason.
        then: The other checks.
    """

    plugin: str
    made_by: type[Any]
    first: tuple[Rule, ...]
    then: tuple[Rule, ...]

    def check(self, name: str) -> Check:
        """Makes one check.

        Args:
            name: Its name.

        Returns:
            The result; nothing is raised for a broken plug-in.
        """
        (rule,) = (rule for rule in (*self.first, *self.then) if rule.name == name)
        try:
            rule.holds()
        except BrokenError as broken:
            return Check(name, False, str(broken))
        except (Exception, SystemExit) as error:
            writes = "read-only" in str(error)
            advice = "copy the array before you write to it" if writes else rule.advice
            raised = f"raised {one_line(error)} ({failure_place(error, self.made_by)})"
            return Check(name, False, f"{raised}; {advice}" if advice else raised)
        return Check(name, True)

    def report(self, check: Callable[[str], Check]) -> Report:
        """Makes all checks.

        Args:
            check: Makes one, by its name: ``self.check``, or the same in a separate process.

        Returns:
            The report.
        """
        results: list[Check] = []
        for rule in self.first:
            results.append(check(rule.name))
            if not results[-1].ok:
                break
        else:
            results.extend(check(rule.name) for rule in self.then)
        return Report(self.plugin, tuple(results))


def check_planner(plugin: type[Planner] | PluginSpec[Planner]) -> Report:
    """Checks a planner.

    Args:
        plugin: Its class, or that with settings.

    Returns:
        The report; nothing is raised for a broken planner.
    """
    contract = planner_contract(plugin)
    return contract.report(contract.check)


def check_predictor(plugin: type[Predictor] | PluginSpec[Predictor]) -> Report:
    """Checks a predictor.

    Args:
        plugin: Its class, or that with settings.

    Returns:
        The report; nothing is raised for a broken predictor.
    """
    contract = predictor_contract(plugin)
    return contract.report(contract.check)


def planner_contract(plugin: type[Planner] | PluginSpec[Planner]) -> Contract:
    """Lists what a planner is checked for.

    Args:
        plugin: As for ``check_planner``.

    Returns:
        The checks.
    """
    made_by = plugin.plugin if isinstance(plugin, PluginSpec) else plugin

    def build() -> Planner:
        if not issubclass(made_by, Planner):
            raise BrokenError("is no dosplan.api.Planner; inherit from it")
        return _chosen(plugin).build(SEED)

    def drive(scenario: Scenario, **options: Any) -> Trace:
        return drive_planner(build(), scenario, **options)

    return Contract(
        _name(made_by),
        made_by,
        (
            Rule("constructs", build),
            Rule("plans", lambda: drive(busy_scenario())),
        ),
        (
            *_common_rules(build, drive, drive_planner),
            Rule("arms_agree_without_predictions", lambda: _arms_agree(drive)),
            Rule(
                "unions",
                lambda: drive(busy_scenario(), sets=forking_sets),
                "a set may be a union of ellipses; Occupancy.by_component() lists them one by one",
            ),
            Rule("vehicle_model", lambda: _follows_model(drive)),
            Rule("actuator_limits", lambda: _within_limits(drive(busy_scenario()))),
        ),
    )


def predictor_contract(plugin: type[Predictor] | PluginSpec[Predictor]) -> Contract:
    """Lists what a predictor is checked for.

    Args:
        plugin: As for ``check_predictor``.

    Returns:
        The checks.
    """
    made_by = plugin.plugin if isinstance(plugin, PluginSpec) else plugin

    def build(horizon: int = HORIZON) -> Predictor:
        if not issubclass(made_by, Predictor):
            raise BrokenError("is no dosplan.api.Predictor; inherit from it")
        chosen = _chosen(plugin)
        settings = replace(chosen.settings, horizon=horizon)
        return replace(chosen, settings=settings).build(SEED)

    def drive(scenario: Scenario, **options: Any) -> Trace:
        return drive_predictor(build(), scenario, **options)

    return Contract(
        _name(made_by),
        made_by,
        (
            Rule("constructs", build),
            Rule("predicts", lambda: drive(busy_scenario())),
        ),
        (
            *_common_rules(build, drive, drive_predictor),
            Rule("unions_covered", lambda: _covers_unions(drive(busy_scenario()))),
            Rule(
                "one_step_horizon",
                lambda: drive_predictor(build(1), busy_scenario()),
                "predict as many steps as self.horizon says",
            ),
        ),
    )


def _chosen(plugin: type[PluginT] | PluginSpec[PluginT]) -> PluginSpec[PluginT]:
    return plugin if isinstance(plugin, PluginSpec) else PluginSpec(plugin)


def _name(plugin: type[Any]) -> str:
    return str(getattr(plugin, "name", plugin.__name__))


def _common_rules(
    build: Callable[[], Planner | Predictor], drive: _Drive, drive_one: _Drive
) -> tuple[Rule, ...]:
    return (
        Rule("versioned_name", lambda: check_version(build())),
        Rule("deterministic", lambda: _deterministic(drive)),
        Rule("reset_forgets", lambda: _forgets(build(), drive, drive_one)),
        Rule("future_unseen", lambda: _sees_no_future(build(), drive)),
        Rule("input_untouched", lambda: _keeps_input(drive(busy_scenario()))),
        Rule(
            "no_road_users",
            lambda: drive(straight_scenario()),
            "where no road user is on the scene, the arrays of road users have no rows",
        ),
        Rule(
            "many_road_users",
            lambda: _copes(drive),
            "take any number of road users; here they are fifty",
        ),
        Rule(
            "short_history",
            lambda: drive(busy_scenario(), visible=1),
            "where Observation.valid is False, the past of a road user is NaN",
        ),
        Rule("time", lambda: _in_time(drive(busy_scenario()))),
    )


# Checks.


def check_version(plugin: object) -> None:
    """Checks that a plug-in has a name with a version.

    Args:
        plugin: The plug-in.

    Raises:
        BrokenError: It has none.
    """
    name = getattr(plugin, "name", None)
    if not isinstance(name, str) or not re.fullmatch(r"\S+-v\d+", name):
        raise BrokenError(
            f"name is {name!r}; results are kept by name, so give it a version: 'my-idea-v1'"
        )


def _deterministic(drive: _Drive) -> None:
    if changed := changed_fields(drive(busy_scenario()), drive(busy_scenario())):
        raise BrokenError(
            f"two instances with the same seed differ in {', '.join(changed)}; draw every "
            "random number from a generator made from seed"
        )


def _forgets(used: Planner | Predictor, drive: _Drive, drive_one: _Drive) -> None:
    drive_one(used, busy_scenario(velocity=4.0))
    if changed := changed_fields(drive(busy_scenario()), drive_one(used, busy_scenario())):
        raise BrokenError(
            f"after another episode, a scene gives another {', '.join(changed)}; "
            "prepare() must clear what an episode left behind"
        )


def _sees_no_future(plugin: Planner | Predictor, drive: _Drive) -> None:
    if isinstance(plugin, OraclePredictor):
        return
    scenario = busy_scenario()
    if changed := changed_fields(drive(scenario), drive(another_future(scenario))):
        raise BrokenError(
            f"with another future, the same past gives another {', '.join(changed)}; use nothing "
            "but what it is handed, or be a dosplan.api.OraclePredictor"
        )


def _keeps_input(trace: Trace) -> None:
    if trace.touched:
        raise BrokenError(
            f"changed {', '.join(sorted(set(trace.touched)))}; work on copies of what it is handed"
        )


def _copes(drive: _Drive) -> None:
    with suppress(NoPlanError):  # A planner may report that there is no plan in a crowd.
        drive(crowded_scenario())


def _in_time(trace: Trace) -> None:
    median = float(np.median(trace.seconds))
    if median > SLOW_SECONDS:
        raise BrokenError(
            f"a call takes {median:.2f} s (median of {len(trace.seconds)}), more than "
            f"{SLOW_SECONDS:g} s; move what does not change to prepare()"
        )


def _arms_agree(drive: _Drive) -> None:
    def no_prediction(observation: Observation, horizon: int) -> Occupancy:
        sets = growing_sets(observation, horizon)
        return replace(sets, valid=np.zeros_like(sets.valid))

    with_sets = drive(busy_scenario(), sets=no_prediction)
    without = drive(busy_scenario(), sets=lambda *args: no_prediction(*args).without_sets())
    if changed := changed_fields(with_sets, without):
        raise BrokenError(
            f"with no road user predicted, the two arms differ in {', '.join(changed)}; leave out "
            "road users and steps where Occupancy.valid is False"
        )


def _covers_unions(trace: Trace) -> None:
    for occupancy in trace.results:
        union = occupancy.union
        if union is None:
            continue
        known = union.present[:, :, None] & occupancy.valid[:, None]
        points = ellipse_boundary(union.centre, union.semi_axes, union.angle, BOUNDARY_POINTS)
        cover = (occupancy.centre, occupancy.semi_axes, occupancy.angle)
        reach = mahalanobis(points, *(part[:, None, :, None] for part in cover)).max(axis=-1)
        if np.any(outside := known & ~(reach <= 1.0 + COVER_TOLERANCE)):
            user, component, step = np.argwhere(outside)[0]
            raise BrokenError(
                f"component {component} of road user {occupancy.ids[user]} leaves the ellipse of "
                f"Occupancy.centre, semi_axes and angle at step {step + 1}, which is to cover it; "
                "make the occupancy with dosplan.geometry.occupancy_of_union"
            )


def _follows_model(drive: _Drive) -> None:
    _keeps_to_model(drive(busy_scenario()))
    # On the path, and at its speed, points of the path look like a drive of the vehicle.
    with suppress(NoPlanError):
        _keeps_to_model(drive(off_path_scenario()))


def _keeps_to_model(trace: Trace) -> None:
    task = busy_scenario().task
    vehicle, dt = task.vehicle, task.dt
    for plan in trace.results:
        state = plan.states[0]
        for step, (u, planned) in enumerate(zip(plan.inputs, plan.states[1:], strict=True)):
            state = vehicle.step(state, u, dt)
            gap = float(np.max(np.abs(planned - state)))
            if gap > MODEL_TOLERANCE:
                raise BrokenError(
                    f"Plan.states are {gap:.2g} away from what Plan.inputs lead to at step "
                    f"{step + 1}; make them with VehicleParameters.step"
                )


def _within_limits(trace: Trace) -> None:
    task = busy_scenario().task
    vehicle, dt = task.vehicle, task.dt
    for plan in trace.results:
        possible = vehicle.clip_input(plan.states[:-1], plan.inputs, dt)
        excess = np.abs(possible - plan.inputs).max(axis=1)
        if np.any(excess > INPUT_TOLERANCE):
            step = int(np.argmax(excess > INPUT_TOLERANCE))
            raise BrokenError(
                f"Plan.inputs ask at step {step} for {excess[step]:.2g} more than the vehicle "
                "can do; limit them with VehicleParameters.clip_input"
            )
