"""A separate process for episodes: an episode that harms it loses its own row only.

The process is watched from outside, because an episode that hangs or uses up memory may hold the
interpreter's lock. Three things are watched: that it takes an episode up, that the episode ends
in time, and that its resident memory stays below a limit. Resident memory, and not a limit of the
address space (``RLIMIT_AS``), since numerical libraries reserve far more address space than they
use; and a limit set by the kernel would appear as an abort somewhere in a library, without a hint
that memory was the cause. How far memory can run past the limit is bounded by what a process
can touch between two looks.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from threading import Event, Lock
from typing import Any, Final, TypeVar

import psutil
from pebble import ProcessExpired, ProcessPool

from dosplan.running.config import RunConfig, RunError
from dosplan.running.job import EpisodeResult, Session, Task, failed_result, unreadable
from dosplan.scenario import ScenarioRef
from dosplan.scoring.score import failed_score
from dosplan.system.errors import one_line
from dosplan.system.workers import (
    cause_of_death,
    end_worker,
    interrupts_blocked,
    prepare_worker,
    started_by,
)

_T = TypeVar("_T")

_LOOK_EVERY: Final = 0.05  # s
_START_SECONDS: Final = 120.0  # Within which a process must take up an episode.
_ATTEMPTS: Final = 4  # Processes that may be lost before they take an episode up.
_RESULT_SECONDS: Final = 1.0  # Time for a result to arrive after its process has ended.


class _NotTakenUpError(Exception):
    """The process was lost before it took up the episode, which is not the episode's fault."""


class EpisodeProcess:
    """Drives episodes, one at a time, in a process that is replaced when one harms it.

    Planner and predictor stay in the process from episode to episode.
    """

    def __init__(self, config: RunConfig) -> None:
        """Starts nothing yet: the process is started with the first episode.

        Args:
            config: The run.
        """
        self._config = config
        self._context = multiprocessing.get_context("spawn")
        # One pool for one process: nothing is shared that a dying process could leave locked.
        self._pool: ProcessPool | None = None
        self._pid: Any = None
        self._stopping = Event()

    def drive(self, task: Task) -> EpisodeResult:
        """Drives one episode; blocks.

        Args:
            task: The episode.

        Returns:
            The episode's result, or a failed row that says how the process ended.

        Raises:
            RunError: No process lives long enough to take up the episode.
            CancelledError: ``stop`` was called.
        """
        return self._tried(
            _drive, (task,), lambda reason: EpisodeResult(failed_score(task.key, reason))
        )

    def check(self, refs: Sequence[ScenarioRef]) -> list[str | None]:
        """Tells which scenarios can be driven; blocks.

        Args:
            refs: The scenarios. Handing one to the process takes longer than checking it, so they
                are handed over together.

        Returns:
            For each what ``Session.check`` returns; also where the file ended the process.

        Raises:
            RunError: As for ``drive``.
            CancelledError: Likewise.
        """

        def lost(reason: str) -> list[str | None]:
            if len(refs) == 1:
                return [unreadable(refs[0], reason)]
            return [found for ref in refs for found in self.check([ref])]  # To know which it was.

        return self._tried(_check, (tuple(refs),), lost)

    def stop(self) -> None:
        """Has a ``drive`` in another thread end at once and its process with it."""
        self._stopping.set()

    def close(self) -> None:
        """Ends the process; a later ``drive`` would start another."""
        if self._pool is not None:
            pid = self._pid.value  # 0 as long as it has not started.
            started = started_by(pid) if pid else []
            self._pool.stop()  # type: ignore[no-untyped-call]
            if pid:
                end_worker(pid, started)
            self._pool.join()
            self._pool = None

    def _tried(
        self, call: Callable[..., _T], arguments: tuple[Any, ...], lost: Callable[[str], _T]
    ) -> _T:
        """What a call in the process returns; where it did not return, ``lost`` of the reason."""
        for _ in range(_ATTEMPTS):
            try:
                return self._attempt(call, arguments, lost)
            except _NotTakenUpError:
                continue
        raise RunError(
            "worker processes die before they take up an episode; "
            "look at the machine's free memory and try fewer workers"
        )

    def _attempt(
        self, call: Callable[..., _T], arguments: tuple[Any, ...], lost: Callable[[str], _T]
    ) -> _T:
        if self._pool is None:
            self._pid = self._context.Value("i", 0, lock=False)
            self._pool = ProcessPool(
                1,
                initializer=_prepare,
                initargs=(self._pid, self._config),
                context=self._context,
            )
        healthy = False
        try:
            future: Future[_T] = self._schedule(self._pool, call, arguments)
            reason = self._watch(future)
            if reason is None:
                result = future.result()
                healthy = True
                return result
            return lost(reason)
        finally:
            if not healthy:
                self.close()

    def _schedule(
        self, pool: ProcessPool, call: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> Future[Any]:
        try:
            with interrupts_blocked():  # The first call starts the process.
                return pool.schedule(call, arguments)
        except RuntimeError as error:  # Its process was killed while it waited for work.
            raise _NotTakenUpError from error

    def _watch(self, future: Future[Any]) -> str | None:
        """Waits for the end of a call.

        Returns:
            Why there is no result, or None where there is one.
        """
        asked = time.monotonic()
        taken_up = gone = None
        watched = 0
        while not wait([future], timeout=_LOOK_EVERY).done:
            now = time.monotonic()
            if self._stopping.is_set():
                raise CancelledError
            if taken_up is None:
                if future.running():
                    taken_up, watched = now, self._pid.value
                elif now - asked > _START_SECONDS:
                    raise _NotTakenUpError
                continue
            if now - taken_up > self._config.episode_timeout:
                return f"timed out after {self._config.episode_timeout:g} s"
            memory = _resident_bytes(watched)
            if memory is None:
                gone = gone or now
                if now - gone > _RESULT_SECONDS:
                    return cause_of_death(0)  # The pool reports an end with any other code.
            elif memory > 1e6 * self._config.memory_limit:
                return f"took more than the memory limit of {self._config.memory_limit} MB"
        error = future.exception()
        if isinstance(error, BrokenProcessPool):
            raise _NotTakenUpError from error
        if isinstance(error, ProcessExpired):
            end_worker(error.pid)
            return cause_of_death(error.exitcode)
        return None if error is None else one_line(error)


class EpisodeProcesses:
    """The episode processes of a run on this machine: as many as threads drive at a time."""

    def __init__(self, config: RunConfig) -> None:
        """Starts nothing yet.

        Args:
            config: The run.
        """
        self.config = config
        self._lock = Lock()
        self._idle: list[EpisodeProcess] = []
        self._busy: list[EpisodeProcess] = []
        self._retired = self._stopped = False

    def drive(self, task: Task) -> EpisodeResult:
        """Drives one episode in a process that is idle, or in a new one; blocks.

        Args:
            task: The episode.

        Returns:
            As ``EpisodeProcess.drive`` returns it.

        Raises:
            RunError: No process lives long enough to take up the episode.
            CancelledError: ``stop`` was called.
        """
        with self._lent() as process:
            return process.drive(task)

    def check(self, refs: Sequence[ScenarioRef]) -> list[str | None]:
        """Tells which scenarios can be driven, likewise; blocks.

        Args:
            refs: The scenarios.

        Returns:
            As ``EpisodeProcess.check`` returns it.

        Raises:
            RunError: As for ``drive``.
            CancelledError: Likewise.
        """
        with self._lent() as process:
            return process.check(refs)

    def retire(self) -> None:
        """Ends every process as soon as it is idle."""
        with self._lock:
            self._retired = True
            self._close_idle()

    def stop(self) -> None:
        """Ends every process, whatever it is doing, and starts no more."""
        with self._lock:
            self._retired = self._stopped = True
            self._close_idle()
            for process in self._busy:
                process.stop()

    @contextmanager
    def _lent(self) -> Iterator[EpisodeProcess]:
        with self._lock:
            if self._stopped:
                raise CancelledError
            process = self._idle.pop() if self._idle else EpisodeProcess(self.config)
            self._busy.append(process)
        try:
            yield process
        finally:
            with self._lock:
                self._busy.remove(process)
                if self._retired:
                    process.close()
                else:
                    self._idle.append(process)

    def _close_idle(self) -> None:
        while self._idle:
            self._idle.pop().close()


class _Worker:
    """What an episode process keeps; set when it starts."""

    session: Session


def _prepare(pid: Any, config: RunConfig) -> None:
    prepare_worker()
    _Worker.session = Session(config)
    pid.value = os.getpid()


def _drive(task: Task) -> EpisodeResult:
    try:
        return _Worker.session.drive(task)
    except BaseException as error:  # KeyboardInterrupt: here only a plug-in raises it.
        return failed_result(task.key, error)


def _check(refs: Sequence[ScenarioRef]) -> list[str | None]:
    return [_Worker.session.check(ref) for ref in refs]


def _resident_bytes(pid: int) -> int | None:
    """Resident memory of a process, or None where it has ended."""
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.NoSuchProcess:  # A zombie's is found, and is zero.
        return None
