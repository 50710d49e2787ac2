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
from dosplan.types import Arm, ScenarioFuture, Score


@dataclass(frozen=True)
class Side:
    """One arm of one run.

    Attributes:
        name: Its name in the page.
        folder: The run folder.
        rows: Its rows by scenario and future; in a pairing, of what is usable.
        arm: The arm.
    """

    name: str
    folder: RunFolder
    rows: Mapping[ScenarioFuture, Score]
    arm: Arm

    def recording(self, driven: ScenarioFuture) -> Recording | None:
        """Reads what an episode did.

        Args:
            driven: The scenario and its future.

        Returns:
            The recording, or None where there is none that can be read.
        """
        try:
            return Recording.load(self.folder.recording(self.rows[driven].key))
        except FileError:  # It failed before it drove, or the folder holds rows only.
            return None


@dataclass(frozen=True)
class Pairing:
    """The sides that are drawn and listed together.

    Attributes:
        title: What is compared.
        sides: One side, or two: the second is compared with the first.
        comparison: The second against the first; None for one side.
        driven: The scenarios that are usable with their futures, in the run's order.
        scenes: Their scenario files.
        unusable: The other scenarios, which nobody could drive.
    """

    title: str
    sides: tuple[Side, ...]
    comparison: Comparison | None
    driven: tuple[ScenarioFuture, ...]
    scenes: Scenes
    unusable: tuple[Unusable, ...] = ()

    @property
    def futures(self) -> int:
        """Number of futures of each scenario."""
        return len({one.future for one in self.driven})

    @property
    def unit(self) -> str:
        """What is counted: scenarios, or episodes where a scenario has several futures."""
        return "scenarios" if self.futures <= 1 else "episodes"
