"""The scenario files of a run, as far as they still exist, and the groups of scenarios."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dosplan.scenario import ScenarioError, ScenarioRef, find_scenarios, load_scenario
from dosplan.scenario.sources.catalogue import Source, suite_kinds
from dosplan.scenario.sources.fetch import SUITES
from dosplan.types import Scenario, scene_of

ROAD_TAGS: Final = (
    "roundabout",
    "intersection",
    "slip_road",
    "merging_lanes",
    "highway",
    "interstate",
    "rural",
    "urban",
)
"""Tags that say what road a recording is of; the first that a scenario has is its road kind."""

OTHER: Final = "other"
SMALLEST_FAMILY: Final = 4
"""A place with fewer scenarios is counted with its country."""


@dataclass(frozen=True)
class Scenes:
    """The scenario files of a run.

    Attributes:
        refs: The files by id; those that were not found are left out.
        kinds: Their kinds by id, where a list of them comes with the files.
        problem: Why nothing was found, in a line, or None.
        cached: Whether parsed scenarios are taken from the cache and put there.
    """

    refs: Mapping[str, ScenarioRef]
    kinds: Mapping[str, str]
    problem: str | None = None
    cached: bool = True

    def load(self, scenario: str) -> Scenario | None:
        """Reads a scenario.

        Args:
            scenario: Its id.

        Returns:
            The scenario, or None where its file is gone or cannot be used.
        """
        ref = self.refs.get(scenario)
        if ref is None:
            return None
        try:
            return load_scenario(ref, cached=self.cached)
        except ScenarioError:
            return None

    def kind(self, scenario: str, scene: Scenario | None) -> str:
        """Names the kind of a scenario: what happens in it, or on what road.

        Args:
            scenario: Id of the scenario.
            scene: The scenario, or None where it is not there.

        Returns:
            The suite's own word, or the first of ``ROAD_TAGS``, or ``other``.
        """
        tags = frozenset[str]() if scene is None else scene.tags
        tag = next((tag for tag in ROAD_TAGS if tag in tags), OTHER)
        return self.kinds.get(scenario, tag.replace("_", " "))


def find_scenes(source: Source, cached: bool) -> Scenes:
    """Looks for the scenarios of a run.

    Args:
        source: Where they are, as ``dosplan run`` takes it.
        cached: Whether to use the cache of parsed scenarios.

    Returns:
        What is there; a source that is gone is no error.
    """
    try:
        refs = find_scenarios(source)
    except (ScenarioError, OSError) as error:
        return Scenes({}, {}, " ".join(str(error).split()), cached)
    named = [source] if isinstance(source, str | Path) else source
    kinds = suite_kinds() if any(one in SUITES for one in named) else {}
    return Scenes({ref.id: ref for ref in refs}, kinds, cached=cached)


def families(scenarios: Sequence[str]) -> dict[str, str]:
    """Sorts scenarios by where they come from, according to their ids.

    Args:
        scenarios: Ids, such as ``USA_Lanker-2_25_T-1``.

    Returns:
        For each id its scene (``USA_Lanker``), or its country (``USA``) where the scene has fewer
        than ``SMALLEST_FAMILY`` scenarios.
    """
    scenes = {scenario: scene_of(scenario) for scenario in scenarios}
    sizes = Counter(scenes.values())
    return {
        scenario: scene if sizes[scene] >= SMALLEST_FAMILY else scene.partition("_")[0]
        for scenario, scene in scenes.items()
    }
