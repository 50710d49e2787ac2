"""The sides of a page: the arms that are set beside each other, and which two are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

from dosplan.report.html.scenarios import Scenes
from dosplan.results.comparison import Comparison
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.table import Table
from dosplan.results.unusable import Unusable
from dosplan.types import Arm, ScenarioFuture, Score

View = tuple[int, ...]
"""What is looked at together: the indices of two sides, or of the only one there is."""


@dataclass(frozen=True)
class Side:
    """One arm of one run.

    Attributes:
        name: Its name in the page.
        folder: The run folder.
        rows: Its rows by scenario and future; in a pairing, of what is usable.
        arm: The arm.
        spec: ``RUN:arm``, as the table of all arms calls it; empty where there is none.
    """

    name: str
    folder: RunFolder
    rows: Mapping[ScenarioFuture, Score]
    arm: Arm
    spec: str = ""

    def recording(self, driven: ScenarioFuture) -> Recording | None:
        """Reads what an episode did.

        Args:
            driven: The scenario and its future.

        Returns:
            The recording, or None where there is none: it failed before it drove, or the folder
            holds rows only.

        Raises:
            FileError: It is damaged; without it the page's figures would be other ones.
        """
        path = self.folder.recording(self.rows[driven].key)
        return Recording.load(path) if path.is_file() else None


@dataclass(frozen=True)
class Pairing:
    """The sides that are drawn and listed together.

    Attributes:
        title: What is compared.
        sides: One side or more.
        comparisons: Of each two of them, the later against the earlier one.
        driven: The scenarios that are usable with their futures, in the run's order.
        scenes: Their scenario files.
        unusable: The other scenarios, which nobody could drive.
        table: All arms that drove the same, in one block; None where one view shows everything.
    """

    title: str
    sides: tuple[Side, ...]
    comparisons: Mapping[View, Comparison]
    driven: tuple[ScenarioFuture, ...]
    scenes: Scenes
    unusable: tuple[Unusable, ...] = ()
    table: Table | None = None

    @property
    def views(self) -> tuple[View, ...]:
        """What can be looked at together, what is shown first in front."""
        return tuple(combinations(range(len(self.sides)), 2)) or ((0,),)

    @property
    def futures(self) -> int:
        """Number of futures of each scenario."""
        return len({one.future for one in self.driven})

    @property
    def unit(self) -> str:
        """What is counted: scenarios, or episodes where a scenario has several futures."""
        return "scenarios" if self.futures <= 1 else "episodes"
