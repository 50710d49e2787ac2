"""Observers of a run: the runner reports rows, and observers show or count them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from dosplan.results.unusable import Unusable
from dosplan.types import Arm, Score

Progress = Callable[[int, int], None]


class Observer:
    """Receives a run's rows; this one ignores them."""

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score], futures: int = 1) -> None:
        """The run begins, or goes on.

        Args:
            episodes: Number of episodes of each arm.
            rows: The rows that an interrupted run left, in no order.
            futures: How many episodes of an arm are of one scenario.
        """

    def checking(self, done: int, total: int) -> None:
        """The scenarios are being checked, before any is driven.

        Args:
            done: How many have been.
            total: How many are to be; those with rows that an interrupted run left are not.
        """

    def checked(self, rows: Sequence[Score], unusable: Sequence[Unusable]) -> None:
        """The scenarios have been checked, and driving begins where anything is left to drive.

        Args:
            rows: The rows that were written of those that nobody could drive.
            unusable: Those; also the ones of which an interrupted run left rows.
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

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score], futures: int = 1) -> None:
        """Passes on how many an interrupted run left.

        Args:
            episodes: Number of episodes of each arm.
            rows: The rows that it left.
            futures: Not used.
        """
        self._done, self._total = len(rows), sum(episodes.values())
        self._progress(self._done, self._total)

    def checked(self, rows: Sequence[Score], unusable: Sequence[Unusable]) -> None:
        """Tells how many episodes are over before any was driven.

        Args:
            rows: Their rows.
            unusable: The scenarios that nobody could drive.
        """
        if rows:
            self._done += len(rows)
            self._progress(self._done, self._total)

    def add(self, row: Score) -> None:
        """Passes on that there is one more.

        Args:
            row: Its row.
        """
        self._done += 1
        self._progress(self._done, self._total)
