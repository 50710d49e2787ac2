"""Observers of a run: the runner reports rows, and observers show or count them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from dosplan.types import Arm, Score

Progress = Callable[[int, int], None]


class Observer:
    """Receives a run's rows; this one ignores them."""

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score]) -> None:
        """The run begins, or goes on.

        Args:
            episodes: Number of episodes of each arm.
            rows: The rows that an interrupted run left, in no order.
        """

    def add(self, row: Score) -> None:
        """An episode has ended and its row is written.

        Args:
            row: Its row.
        """


class ProgressObserver(Observer):
    """Passes on how many episodes have ended."""

    def __init__(self, progress: Progress) -> None:
        """Counts none yet.

        Args:
            progress: Called with the number of finished episodes and of all, first before any is
                driven.
        """
        self._progress = progress
        self._done = self._total = 0

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score]) -> None:
        """Passes on how many an interrupted run left.

        Args:
            episodes: Number of episodes of each arm.
            rows: The rows that it left.
        """
        self._done, self._total = len(rows), sum(episodes.values())
        self._progress(self._done, self._total)

    def add(self, row: Score) -> None:
        """Passes on that there is one more.

        Args:
            row: Its row.
        """
        self._done += 1
        self._progress(self._done, self._total)
