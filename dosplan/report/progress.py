"""How far a run is: a bar on a terminal, now and then a line elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.progress import TimeRemainingColumn as Remaining


@contextmanager
def show_progress(console: Console, unit: str = "episodes") -> Iterator[Callable[[int, int], None]]:
    """Shows how far a run is while the block runs.

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


def _lines(console: Console, unit: str) -> Callable[[int, int], None]:
    """Writes a line for each tenth of the run."""
    shown = -1

    def update(done: int, total: int) -> None:
        nonlocal shown
        tenth = 10 * done // max(total, 1)
        if tenth > shown:
            shown = tenth
            console.print(f"{done} of {total} {unit}", highlight=False)

    return update
