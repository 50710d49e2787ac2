"""Where episodes are driven; the run loop knows only the protocol.

``dosplan.running.dask_cluster`` holds the other implementation, for more than one machine.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from queue import SimpleQueue
from typing import Protocol

from dosplan.running.config import RunConfig
from dosplan.running.job import EpisodeResult
from dosplan.running.process import EpisodeProcess
from dosplan.scenario import ScenarioRef
from dosplan.system.workers import WORKER_ENVIRONMENT, environment
from dosplan.types import Arm

Task = tuple[ScenarioRef, Arm]
Results = Generator[tuple[Task, EpisodeResult], None, None]


class Executor(Protocol):
    """Drives episodes somewhere."""

    def drive(self, tasks: Iterable[Task]) -> Results:
        """Drives episodes and yields each as it ends.

        Few tasks are held at a time, however many there are.

        Args:
            tasks: The episodes; taken up in this order.

        Yields:
            Each task, once, with its result, in the order in which they end. Closing the
            generator ends whatever is being driven.

        Raises:
            RunError: It cannot go on.
        """
        ...


class LocalExecutor:
    """Drives in worker processes on this machine."""

    def __init__(self, config: RunConfig) -> None:
        """Starts nothing yet.

        Args:
            config: The run.
        """
        self._config = config

    def drive(self, tasks: Iterable[Task]) -> Results:
        """Drives episodes, as ``Executor`` says."""
        processes = [EpisodeProcess(self._config) for _ in range(self._config.workers)]
        idle: SimpleQueue[EpisodeProcess] = SimpleQueue()
        for process in processes:
            idle.put(process)

        def drive_one(task: Task) -> EpisodeResult:
            process = idle.get()
            try:
                return process.drive(*task)
            finally:
                idle.put(process)

        source = iter(tasks)
        pending: dict[Future[EpisodeResult], Task] = {}
        threads = ThreadPoolExecutor(len(processes))

        def take_up(count: int) -> None:
            for task in islice(source, count):
                pending[threads.submit(drive_one, task)] = task

        with environment(WORKER_ENVIRONMENT):
            try:
                take_up(len(processes))
                while pending:
                    done = wait(pending, return_when=FIRST_COMPLETED).done
                    finished = [(pending.pop(future), future) for future in done]
                    take_up(len(done))  # First, so that no process waits for a row to be written.
                    for task, future in finished:
                        yield task, future.result()
            finally:
                for process in processes:
                    process.stop()
                threads.shutdown(cancel_futures=True)
                for process in processes:
                    process.close()
