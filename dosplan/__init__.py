"""dosplan: a benchmark for motion planners under prediction uncertainty.

What a script or a notebook needs is imported when it is asked for, so that ``import dosplan`` costs
nothing: ``find_scenarios``, ``load_scenario``, ``run_episode``, ``run_suite``, ``open_run``,
``compare``, ``table``, ``submit``, ``Arm``, ``ScenarioRef`` and ``SerialExecutor``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from dosplan._public import compare, open_run, run_episode, run_suite, submit, table
    from dosplan.running.executor import SerialExecutor
    from dosplan.scenario import ScenarioRef, find_scenarios, load_scenario
    from dosplan.types import Arm

__version__ = "0.4.0"

__all__ = [
    "Arm",
    "ScenarioRef",
    "SerialExecutor",
    "compare",
    "find_scenarios",
    "load_scenario",
    "open_run",
    "run_episode",
    "run_suite",
    "submit",
    "table",
]

_MODULES: Final = {
    "Arm": "dosplan.types",
    "ScenarioRef": "dosplan.scenario",
    "SerialExecutor": "dosplan.running.executor",
    "find_scenarios": "dosplan.scenario",
    "load_scenario": "dosplan.scenario",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES.get(name, "dosplan._public")), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
