"""The sides of a page: one arm of a run, or two that are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dosplan.report.html.scenarios import Scenes
from dosplan.results.comparison import Comparison
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording
from dosplan.results.unusable import Unusable
from dosplan.system.files import FileError
from dosplan.types import Arm, Score


@dataclass(frozen=True)
class Side:
    """One arm of one run.

    Attributes:
        name: Its name in the page.
        folder: The run folder.
        rows: Its rows by scenario; in a pairing, of what is usable.
        arm: The arm.
    """

    name: str
    folder: RunFolder
    rows: Mapping[str, Score]
    arm: Arm

    def recording(self, scenario: str) -> Recording | None:
        """Reads what an episode did.

        Args:
            scenario: Id of the scenario.

        Returns:
            The recording, or None where there is none that can be read.
        """
        try:
            return Recording.load(self.folder.recording(self.rows[scenario].key))
        except FileError:  # It failed before it drove, or the folder holds rows only.
            return None


@dataclass(frozen=True)
class Pairing:
    """The sides that are drawn and listed together.

    Attributes:
        title: What is compared.
        sides: One side, or two: the second is compared with the first.
        comparison: The second against the first; None for one side.
        scenarios: Ids of the scenarios that are usable, in the run's order.
        scenes: Their scenario files.
        unusable: The other scenarios, which nobody could drive.
    """

    title: str
    sides: tuple[Side, ...]
    comparison: Comparison | None
    scenarios: tuple[str, ...]
    scenes: Scenes
    unusable: tuple[Unusable, ...] = ()
