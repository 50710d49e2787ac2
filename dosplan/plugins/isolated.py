"""The conformance checks, each in a process of its own, which a plug-in may harm.

A plug-in that hangs or takes its process down fails the check at which it does so; the other
checks go on in a new process.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pebble import ProcessExpired

from dosplan.plugins.conformance import (
    Check,
    Contract,
    Report,
    planner_contract,
    predictor_contract,
)
from dosplan.plugins.registry import PluginKind, find_plugin
from dosplan.plugins.traffic_conformance import traffic_contract
from dosplan.scenario import load_scenario
from dosplan.system.workers import cause_of_death, worker_pool


def check_isolated(
    kind: PluginKind, spec: str, limit: float, scenario: Path | None = None
) -> Report:
    """Checks a plug-in.

    Args:
        kind: What it is.
        spec: As for ``dosplan.plugins.registry.find_planner``.
        limit: Time after which a check counts as hung, s.
        scenario: File of the scenario that a traffic is checked on; scenes built in code by
            default.

    Returns:
        The report; nothing is raised for a plug-in that breaks the contract.

    Raises:
        RegistryError: It cannot be found or loaded.
        ScenarioError: The scenario cannot be read.
    """
    contract = _contract(kind, spec, scenario)
    with worker_pool(1) as pool:

        def check(name: str) -> Check:
            future = pool.schedule(_check, (kind, spec, scenario, name), timeout=limit)
            try:
                return future.result()
            except TimeoutError:
                advice = "give every loop and every wait an end"
                return Check(name, False, f"is not done after {limit:g} s; {advice}")
            except ProcessExpired as error:
                advice = "raise an exception to give up, and look at its native code"
                return Check(name, False, f"{cause_of_death(error.exitcode)}; {advice}")

        return contract.report(check)


def _check(kind: PluginKind, spec: str, scenario: Path | None, name: str) -> Check:
    return _kept_contract(kind, spec, scenario).check(name)


@lru_cache(maxsize=1)
def _kept_contract(kind: PluginKind, spec: str, scenario: Path | None) -> Contract:
    """In the process of the checks: a plug-in is loaded there once, not for every check."""
    return _contract(kind, spec, scenario)


def _contract(kind: PluginKind, spec: str, scenario: Path | None) -> Contract:
    plugin = find_plugin(kind, spec)
    if kind is PluginKind.TRAFFIC:
        return traffic_contract(plugin, None if scenario is None else load_scenario(scenario))
    return planner_contract(plugin) if kind is PluginKind.PLANNER else predictor_contract(plugin)
