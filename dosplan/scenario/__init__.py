"""CommonRoad files in, ``dosplan.types.Scenario`` out: the only place that knows CommonRoad."""

from __future__ import annotations

import warnings
from pathlib import Path

from dosplan.scenario.catalogue import ScenarioRef, find_scenarios
from dosplan.scenario.document import ScenarioError
from dosplan.types import Scenario

__all__ = ["ScenarioError", "ScenarioRef", "find_scenarios", "load_scenario"]


def load_scenario(ref: ScenarioRef | str | Path) -> Scenario:
    """Reads one episode.

    Recordings with a step other than 0.1 s are resampled where that is exact: a step that is a
    multiple of 0.1 s by linear interpolation (headings the short way round), a step of which
    0.1 s is a multiple by leaving steps out. Any other step is refused.

    Args:
        ref: The episode, or a file that holds one planning problem.

    Returns:
        The scenario.

    Raises:
        ScenarioError: The file cannot be used; one line that says why.
    """
    # commonroad-io, networkx and scipy take half a second to import, which listing does not need.
    # Importing it warns of the protobuf bindings it was generated with, which nobody can help.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from dosplan.scenario.reader import read_scenario

    return read_scenario(ref if isinstance(ref, ScenarioRef) else ScenarioRef(Path(ref), ""))
