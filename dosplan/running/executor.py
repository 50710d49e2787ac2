"""Where episodes are driven; the run loop knows only the protocol.

``dosplan.running.dask_cluster`` holds the implementation for more than one machine.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Final, Protocol, TypeVar

from dosplan.running.config import RunConfig
from dosplan.running.job import EpisodeResult, Session, Task
from dosplan.running.process import EpisodeProcesses
from dosplan.scenario import ScenarioRef
from dosplan.system.workers import WORKER_ENVIRONMENT, environment

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

Results = Generator[tuple[Task, EpisodeResult], None, None]
Verdicts = Generator[tuple[ScenarioRef, str | None], None, None]


MOST_AT_ONCE: Final = 16
"""Scenarios that a worker checks at once, at most."""


def parted(refs: Iterable[ScenarioRef], workers: int) -> Iterator[tuple[ScenarioRef, ...]]:
    """Parts scenarios for workers that check them.

    Args:
        refs: The scenarios.
        workers: How many share them.

    Yields:
        Parts of at most ``MOST_AT_ONCE``, small enough that every worker has some.
    """
    source = tuple(refs)
    size = min(MOST_AT_ONCE, max(len(source) // (2 * workers), 1))
    for first in range(0, len(source), size):
        yield source[first : first + size]


class Workers(Protocol):
    """The workers of a run: this process, or others.

    Few tasks are held at a time, however many there are. Closing a generator ends whatever is
    being done.
    """

    def check(self, refs: Iterable[ScenarioRef]) -> Verdicts:
        """Tells which scenarios can be driven.

        Args:
            refs: The scenarios; taken up in this order.

        Yields:
            Each scenario, once, with its file and why nobody could drive it, or None where
            somebody may; in the order in which they end.

        Raises:
            RunError: It cannot go on.
        """
        ...

    def drive(self, tasks: Iterable[Task]) -> Results:
        """Drives episodes.

        Args:
            tasks: The episodes; taken up in this order.

        Yields:
            Each task, once, with its result, in the order in which they end.

        Raises:
            RunError: It cannot go on.
        """
        ...


class Executor(Protocol):
    """Has the scenarios of a run checked and its episodes driven somewhere."""

    def start(self, config: RunConfig) -> AbstractContextManager[Workers]:
        """Starts the workers of a run.

        Args:
            config: The run.

        Returns:
            The workers; when the context ends, they end, with whatever they are doing.

        Raises:
            RunError: They cannot be started.
        """
        ...


@dataclass(frozen=True)
class SerialExecutor:
    """Drives one episode after another in the process that calls, so that a debugger can stop it.

    What a plug-in raises becomes a row, as everywhere. But an episode that hangs, crashes or
    uses up memory does so to the whole run: neither ``episode_timeout`` nor ``memory_limit`` is
    watched. Standard input and output are the plug-in's, and the global random generators are
    seeded for each episode.

    The rows are those of worker processes to the last bit where this process started with
    ``dosplan.system.workers.WORKER_ENVIRONMENT``: numerical libraries and Python read their number
    of threads and the seed of hashes when they are loaded, which has happened by now. A planner
    whose sums do not depend on either has equal rows anyway.
    """

    @contextmanager
    def start(self, config: RunConfig) -> Iterator[Workers]:
        """Works in this process; Ctrl-C, and leaving a debugger, end the run."""
        yield _ThisProcess(Session(config, attended=True))


@dataclass(frozen=True)
class _ThisProcess:
    """Works in this process."""

    session: Session

    def check(self, refs: Iterable[ScenarioRef]) -> Verdicts:
        for ref in refs:
            yield ref, self.session.check(ref)

    def drive(self, tasks: Iterable[Task]) -> Results:
        for task in tasks:
            yield task, self.session.drive(task)


@dataclass(frozen=True)
class LocalExecutor:
    """Drives in worker processes on this machine.

    Attributes:
        workers: How many.
    """

    workers: int

    @contextmanager
    def start(self, config: RunConfig) -> Iterator[Workers]:
        """Starts processes as they are needed, as ``Executor`` says."""
        processes = EpisodeProcesses(config)
        threads = ThreadPoolExecutor(self.workers)
        with environment(WORKER_ENVIRONMENT):
            try:
                yield _Processes(processes, threads, self.workers)
            finally:
                processes.stop()
                threads.shutdown(cancel_futures=True)


@dataclass(frozen=True)
class _Processes:
    """Works in worker processes, of which each has a thread here."""

    processes: EpisodeProcesses
    threads: ThreadPoolExecutor
    workers: int

    def check(self, refs: Iterable[ScenarioRef]) -> Verdicts:
        parts = list(parted(refs, self.workers))
        for part, found in self._all(self.processes.check, parts):
            yield from zip(part, found, strict=True)

    def drive(self, tasks: Iterable[Task]) -> Results:
        return self._all(self.processes.drive, tasks)

    def _all(
        self, call: Callable[[_Item], _Result], items: Iterable[_Item]
    ) -> Generator[tuple[_Item, _Result], None, None]:
        """Each item with what the call returns, as it ends."""
        source = iter(items)
        pending: dict[Future[_Result], _Item] = {}

        def take_up(count: int) -> None:
            for item in islice(source, count):
                pending[self.threads.submit(call, item)] = item

        take_up(self.workers)
        while pending:
            done = wait(pending, return_when=FIRST_COMPLETED).done
            finished = [(pending.pop(future), future) for future in done]
            take_up(len(done))  # First, so that no process waits for a row to be written.
            for item, future in finished:
                yield item, future.result()
