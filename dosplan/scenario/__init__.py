"""CommonRoad files in, ``dosplan.types.Scenario`` out: the only place that knows CommonRoad."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from dosplan.scenario.commonroad.document import ScenarioError, read_document, read_file
from dosplan.scenario.sources.catalogue import ScenarioRef, find_scenarios
from dosplan.scenario.sources.futures import futures_file
from dosplan.scenario.sources.sumo import configuration_of
from dosplan.types import Scenario

__all__ = [
    "INTERACTIVE",
    "ScenarioError",
    "ScenarioRef",
    "find_scenarios",
    "has_problem",
    "load_recording",
    "load_scenario",
    "parse_scenario",
]

INTERACTIVE: Final = (
    "gives the first states of its road users alone, which a simulator has to move; run it with "
    "--traffic sumo, or record their trajectories into the file"
)
"""Why a scenario is of no use that is ``Scenario.interactive``."""


def load_scenario(ref: ScenarioRef | str | Path, *, cached: bool = False) -> Scenario:
    """Reads one episode.

    Recordings with a step other than 0.1 s are resampled: where a new step lies on an old one, it
    is that; between two it is linear, headings the short way round. Goals count at the new steps
    within their time.

    Args:
        ref: The episode, or a file that holds one planning problem.
        cached: Whether to take it from the cache where it is there, and put it there where not
            (``dosplan.scenario.cache``); the scenario is the same.

    Returns:
        The scenario.

    Raises:
        ScenarioError: The file cannot be used; one line that says why.
    """
    ref = ref if isinstance(ref, ScenarioRef) else ScenarioRef(Path(ref), "")
    content = read_file(ref.path)
    if cached:
        from dosplan.scenario import cache

        scenario = cache.cached(ref, content, lambda: parse_scenario(ref, content))
    else:
        scenario = parse_scenario(ref, content)
    # Not of the file's content, by which the cache knows a scenario.
    scenario = replace(scenario, sumo=configuration_of(ref.path))
    path = futures_file(ref.path)
    if path is None:
        return scenario
    from dosplan.scenario.futures import with_futures

    return with_futures(scenario, path)


def load_recording(ref: ScenarioRef | str | Path) -> Scenario:
    """Reads an episode of which only the road users matter.

    Unlike ``load_scenario`` it takes files without a planning problem: their ego stands where the
    map's first lanelet for cars begins. What is predicted does not depend on the ego. A file of
    interactive traffic holds no recording.

    Args:
        ref: The episode, or a file that holds one planning problem or none.

    Returns:
        The scenario.

    Raises:
        ScenarioError: The file cannot be used; one line that says why.
    """
    ref = ref if isinstance(ref, ScenarioRef) else ScenarioRef(Path(ref), "")
    scenario = parse_scenario(ref, read_file(ref.path), ego_optional=True)
    if scenario.interactive:
        raise ScenarioError(ref.path, INTERACTIVE)
    return scenario


def has_problem(ref: ScenarioRef) -> bool:
    """Whether a file holds a planning problem; without one it is a map or a recording alone.

    Args:
        ref: An episode of the file.

    Returns:
        Whether there is one.

    Raises:
        ScenarioError: The file is not a CommonRoad scenario that can be used.
    """
    document = read_document(ref.path, read_file(ref.path))
    return document.root.find("planningProblem") is not None


def parse_scenario(ref: ScenarioRef, content: bytes, *, ego_optional: bool = False) -> Scenario:
    """Makes one episode of what a file holds.

    Args:
        ref: The episode; its path is named in messages, and its ending says how it is compressed.
        content: What the file holds.
        ego_optional: Whether a file without a planning problem is given a standing ego, see
            ``load_recording``.

    Returns:
        The scenario.

    Raises:
        ScenarioError: The file cannot be used.
    """
    # networkx and scipy take long to import, and listing scenarios does not need them.
    from dosplan.scenario.commonroad.reader import read_scenario

    return read_scenario(ref, content, ego_optional=ego_optional)
