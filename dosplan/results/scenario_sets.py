"""The scenario sets of the leaderboard: the embedded suites, and the published recordings.

A set is its scenarios' ids and the content of their files: a suite of another version is another
set, though its ids may be the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dosplan.results.folder import RunFolder
from dosplan.results.manifest import SCENARIO_FILES, read_manifest
from dosplan.results.published import default_results
from dosplan.scenario import ScenarioRef, find_scenarios
from dosplan.scenario.futures import count_futures
from dosplan.scenario.sources.fetch import SUITES
from dosplan.scenario.sources.futures import futures_file
from dosplan.system.provenance import content_digest

RECORDED: Final = "recorded"
"""The set of 150 public scenarios of ``results/recorded``, whose files are CommonRoad's."""


@dataclass(frozen=True)
class ScenarioSet:
    """A set of scenarios that planners are ranked on.

    Attributes:
        name: Its name.
        scenarios: The ids of its scenarios, in its order.
        futures: How many futures are recorded of each of them.
        digest: ``content_digest`` of its files, with those of their futures, in its order.
        source: Where it is found, as ``find_scenarios`` takes it; None where it does not come with
            dosplan.
    """

    name: str
    scenarios: tuple[str, ...]
    futures: int
    digest: str
    source: str | None = None

    def is_in(self, refs: Mapping[str, ScenarioRef]) -> bool:
        """Whether files are those of this set.

        Args:
            refs: The scenarios of a source, by their ids.

        Returns:
            Whether all its scenarios are among them, with the content that they have in the set.
        """
        there = [refs[name] for name in self.scenarios if name in refs]
        return len(there) == len(self.scenarios) and _digest(there) == self.digest


def known_sets() -> tuple[ScenarioSet, ...]:
    """Lists the sets that a leaderboard has.

    Returns:
        The suites, and the published recordings where these results are there.

    Raises:
        FileError: The published run cannot be read.
        ScenarioError: A suite is not there.
    """
    return (*map(_suite, SUITES), *_published())


def _suite(name: str) -> ScenarioSet:
    refs = find_scenarios(name)
    futures = min(count_futures(ref.path) for ref in refs)
    return ScenarioSet(name, tuple(ref.id for ref in refs), futures, _digest(refs), name)


def _published() -> Iterator[ScenarioSet]:
    """The set that the published run drove, of whose files it kept the digest."""
    folder = RunFolder(default_results() / RECORDED)
    if folder.manifest.is_file():
        run = read_manifest(folder)
        yield ScenarioSet(RECORDED, run.scenarios, 1, run.digests[SCENARIO_FILES])


def _digest(refs: Iterable[ScenarioRef]) -> str:
    return content_digest(_files(refs))


def _files(refs: Iterable[ScenarioRef]) -> Iterator[Path]:
    for ref in refs:
        yield ref.path
        if (futures := futures_file(ref.path)) is not None:
            yield futures
