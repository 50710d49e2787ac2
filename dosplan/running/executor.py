"""Where episodes are driven; the run loop knows only the protocol.

``dosplan.running.dask_cluster`` holds the implementation for more than one machine.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

from dosplan.running.config import RunConfig
from dosplan.running.job import EpisodeResult, Session
from dosplan.running.process import EpisodeProcesses
from dosplan.scenario import ScenarioRef
from dosplan.system.workers import WORKER_ENVIRONMENT, environment
from dosplan.types import Arm

Task = tuple[ScenarioRef, Arm]
Results = Generator[tuple[Task, EpisodeResult], None, None]


class Executor(Protocol):
    """Drives episodes, in this process or in others."""

    def drive(self, config: RunConfig, tasks: Iterable[Task]) -> Results:
        """Drives episodes and yields each as it ends.

        Few tasks are held at a time, however many there are.

        Args:
            config: The run.
            tasks: The episodes; taken up in this order.

        Yields:
            Each task, once, with its result, in the order in which they end. Closing the
            generator ends whatever is being driven.

        Raises:
            RunError: It cannot go on.
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

    def drive(self, config: RunConfig, tasks: Iterable[Task]) -> Results:
        """Drives episodes, as ``Executor`` says.

        Raises:
            KeyboardInterrupt: The user interrupts, or leaves a debugger.
        """
        session = Session(config, attended=True)
        for ref, arm in tasks:
            yield (ref, arm), session.drive(ref, arm)


@dataclass(frozen=True)
class LocalExecutor:
    """Drives in worker processes on this machine.

    Attributes:
        workers: How many.
    """

    workers: int

    def drive(self, config: RunConfig, tasks: Iterable[Task]) -> Results:
        """Drives episodes, as ``Executor`` says."""
        processes = EpisodeProcesses(config)
        source = iter(tasks)
        pending: dict[Future[EpisodeResult], Task] = {}
        threads = ThreadPoolExecutor(self.workers)

        def take_up(count: int) -> None:
            for task in islice(source, count):
                pending[threads.submit(processes.drive, *task)] = task

        with environment(WORKER_ENVIRONMENT):
            try:
                take_up(self.workers)
                while pending:
                    done = wait(pending, return_when=FIRST_COMPLETED).done
                    finished = [(pending.pop(future), future) for future in done]
                    take_up(len(done))  # First, so that no process waits for a row to be written.
                    for task, future in finished:
                        yield task, future.result()
            finally:
                processes.stop()
                threads.shutdown(cancel_futures=True)
