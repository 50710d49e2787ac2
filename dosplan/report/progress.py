"""Progress of a run: a live table on a terminal, single lines elsewhere."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.progress import TimeRemainingColumn as Remaining
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from dosplan.report.tables import table
from dosplan.results.markdown import ARM_TITLES, folded
from dosplan.results.unusable import Unusable, unusable_lines
from dosplan.running.progress import Observer
from dosplan.types import Arm, Outcome, Score

Clock = Callable[[], float]

_LINE_EVERY: Final = 60.0  # s after which a line is due before the next tenth is done.
_COUNTED: Final = {
    "collisions": Outcome.COLLISION,
    "out of bounds": Outcome.OUT_OF_BOUNDS,
    "goals missed": Outcome.GOAL_MISSED,
    "failures": Outcome.PLANNER_FAILURE,
}


@contextmanager
def show_progress(console: Console, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Shows progress while the block runs.

    Args:
        console: Where to.
        unit: What is counted.

    Yields:
        A function to be called with the number of finished ones and of all.
    """
    if not console.is_terminal:
        yield _lines(console, unit)
        return
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), Remaining())
    with Progress(unit, *columns, console=console, transient=True) as bar:
        task = bar.add_task(unit, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def show_run(
    console: Console, clock: Clock = time.monotonic, *, live: bool = True, quiet: bool = False
) -> Iterator[Observer]:
    """Shows how a run goes on while the block runs.

    A terminal has a table, which goes when the block ends. Elsewhere there is a line for each
    tenth of the run, and for each minute where a tenth takes longer. Which scenarios are unusable
    is told in any case, before anything is driven.

    Args:
        console: Where to.
        clock: The time, s.
        live: Whether a terminal may have the table, which takes standard output, too, as long as
            it is shown.
        quiet: Whether to tell of unusable scenarios alone.

    Yields:
        What the runner reports to.
    """
    if quiet:
        yield _Teller(console)
        return
    tally = _Tally(console, clock)
    if not (live and console.is_terminal):
        yield _LineObserver(console, tally, clock)
        return
    # It is drawn anew several times a second, since the time left changes between two rows.
    with Live(get_renderable=lambda: _live(tally), console=console, transient=True):
        yield tally


class _Teller(Observer):
    """Tells which scenarios are unusable."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._scenarios = 0

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score], futures: int = 1) -> None:
        self._scenarios = max(episodes.values()) // futures

    def checked(self, rows: Sequence[Score], unusable: Sequence[Unusable]) -> None:
        for line in unusable_lines(unusable, self._scenarios):
            self._console.print(line, highlight=False, soft_wrap=True, markup=False)


class _Tally(_Teller):
    """Counts outcomes, too.

    Attributes:
        episodes: Number of episodes of each arm.
        outcomes: How many ended how, in each arm.
        done: How many have ended.
        checks: How many scenarios have been checked and are to be; None when all are.
    """

    def __init__(self, console: Console, clock: Clock) -> None:
        super().__init__(console)
        self.episodes: Mapping[Arm, int] = {}
        self.outcomes: dict[Arm, Counter[Outcome]] = {}
        self.done = 0
        self.checks: tuple[int, int] | None = None
        self._clock = clock
        self._began = 0.0
        self._left_over = 0  # Rows of an earlier start: they are left out of the rate.

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score], futures: int = 1) -> None:
        super().begin(episodes, rows, futures)
        self.outcomes = {arm: Counter() for arm in episodes}
        for row in rows:
            self.add(row)
        self._start_clock()
        self.episodes = episodes

    def checking(self, done: int, total: int) -> None:
        self.checks = (done, total) if done < total else None

    def checked(self, rows: Sequence[Score], unusable: Sequence[Unusable]) -> None:
        for row in rows:
            self.add(row)
        self._start_clock()
        super().checked(rows, unusable)

    def add(self, row: Score) -> None:
        self.outcomes[row.arm][row.outcome] += 1
        self.done += 1

    def _start_clock(self) -> None:
        self._began, self._left_over = self._clock(), self.done

    @property
    def total(self) -> int:
        return sum(self.episodes.values())

    @property
    def pace(self) -> str:
        """Rate and time left; nothing before the first row."""
        driven, seconds = self.done - self._left_over, self._clock() - self._began
        if not driven or seconds <= 0.0:
            return ""
        rate = driven / seconds
        shown = f"{rate:.1f} per second" if rate >= 1.0 else f"{60.0 * rate:.1f} per minute"
        return f", {shown}, {timedelta(seconds=round((self.total - self.done) / rate))} left"

    def cells(self, arm: Arm) -> list[str]:
        """Done, success so far in percent, and what is counted."""
        found = self.outcomes[arm]
        done = found.total()
        usable = sum(n for outcome, n in found.items() if outcome.of_planner)
        success = f"{100.0 * found[Outcome.SUCCESS] / usable:.1f}" if usable else "-"
        counts = [str(found[outcome]) for outcome in _COUNTED.values()]
        return [f"{done} of {self.episodes[arm]}", success, *counts]


def _live(tally: _Tally) -> RenderableType:
    if not tally.total:  # Scenarios are still being looked for.
        return ""
    headings = ["", "done", "success %", *_COUNTED]
    rows = [[ARM_TITLES[arm], *tally.cells(arm)] for arm in tally.episodes]
    foot = Table.grid(padding=(0, 2))
    foot.add_row(ProgressBar(tally.total, tally.done, width=32), Text(_head(tally)))
    return Group(table(headings, rows), foot)


def _head(tally: _Tally) -> str:
    if tally.checks is not None:
        return "{} of {} scenarios checked".format(*tally.checks)
    return f"{tally.done} of {tally.total} episodes{tally.pace}"


class _Tenths:
    """Keeps how many tenths of something are done."""

    def __init__(self) -> None:
        self._tenth = -1  # The beginning counts as one, too.

    def further(self, done: int, total: int) -> bool:
        """Whether it is a tenth further than when this was last so."""
        tenth, before = 10 * done // max(total, 1), self._tenth
        self._tenth = max(tenth, before)
        return tenth > before


class _LineObserver(Observer):
    """Writes a line for each tenth of a run and each minute."""

    def __init__(self, console: Console, tally: _Tally, clock: Clock) -> None:
        self._console, self._tally, self._clock = console, tally, clock
        self._tenths, self._written = _Tenths(), 0.0

    def begin(self, episodes: Mapping[Arm, int], rows: Sequence[Score], futures: int = 1) -> None:
        self._tally.begin(episodes, rows, futures)
        self._write_if_due()

    def checking(self, done: int, total: int) -> None:
        self._tally.checking(done, total)
        if self._clock() - self._written >= _LINE_EVERY:
            self._write()

    def checked(self, rows: Sequence[Score], unusable: Sequence[Unusable]) -> None:
        self._tally.checked(rows, unusable)
        if rows:
            self._write_if_due()

    def add(self, row: Score) -> None:
        self._tally.add(row)
        self._write_if_due()

    def _write_if_due(self) -> None:
        further = self._tenths.further(self._tally.done, self._tally.total)
        if further or self._clock() - self._written >= _LINE_EVERY:
            self._write()

    def _write(self) -> None:
        arms = [f"; {ARM_TITLES[arm]}: {self._arm(arm)}" for arm in self._tally.episodes]
        line = _head(self._tally) + ("".join(arms) if self._tally.done else "")
        line = folded(line, indent="  ")
        self._console.print(line, highlight=False, soft_wrap=True)
        self._written = self._clock()

    def _arm(self, arm: Arm) -> str:
        done, success, *counts = self._tally.cells(arm)
        counted = [f"{what} {count}" for what, count in zip(_COUNTED, counts, strict=True)]
        return ", ".join([done, f"success {success} %", *counted])


def _lines(console: Console, unit: str) -> Callable[[int, int], None]:
    """Writes a line for each tenth."""
    tenths = _Tenths()

    def update(done: int, total: int) -> None:
        if tenths.further(done, total):
            console.print(f"{done} of {total} {unit}", highlight=False)

    return update
