"""Worker processes whose results do not depend on their number.

Each is spawned, so that it inherits no state; numerical libraries get one thread, and the
order of sets of strings is fixed. A worker ends with the process that started it.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import random
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from threading import Thread
from typing import Final

import numpy as np
import psutil
from pebble import ProcessPool

_PR_SET_PDEATHSIG: Final = 1
# Read once, when a numerical library is loaded. The hash seed fixes the order of sets of strings.
WORKER_ENVIRONMENT: Final = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "PYTHONHASHSEED": "0",
}


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPool]:
    """Opens a pool, and ends its processes on leaving, whatever they are doing.

    Args:
        workers: Number of processes.

    Yields:
        The pool.
    """
    context = multiprocessing.get_context("spawn")
    pool = ProcessPool(workers, initializer=prepare_worker, context=context)
    with environment(WORKER_ENVIRONMENT):
        try:
            with interrupts_blocked():
                _ = pool.active  # Starts its processes.
            yield pool
        finally:
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Starts child processes that Ctrl-C does not reach, from their first instruction on.

    The terminal sends it to them, too; their parent ends them. Threads that start in the block, and
    what they start later, are like it. For the caller it waits until the end of the block.

    Yields:
        Nothing.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows.
        yield
        return
    resource_tracker.ensure_running()  # Where it starts, it unblocks them.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def seed_globals(seed: int) -> None:
    """Seeds the global random generators, which a plug-in may use.

    Args:
        seed: Seed of the run.
    """
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002


def cause_of_death(exit_code: int) -> str:
    """Says how a worker ended that should not have.

    Args:
        exit_code: Its exit code; negative for a signal.

    Returns:
        One line.
    """
    if exit_code >= 0:
        return f"the worker process ended with exit code {exit_code}"
    return f"the worker process was killed by {signal.Signals(-exit_code).name}"


@contextmanager
def environment(variables: dict[str, str]) -> Iterator[None]:
    """Sets environment variables, which child processes inherit, for the length of the block.

    Args:
        variables: Names and values; what they were before is put back.

    Yields:
        Nothing.
    """
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def prepare_worker() -> None:
    """Prepares a worker process; runs in it first.

    What it prints does not go to stdout. It leads a process group of its own, so that
    what a plug-in starts can be ended with it, and it ends with the process that started it.
    """
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    os.dup2(2, 1)
    Thread(target=_end_with_parent, daemon=True).start()
    if sys.platform == "linux":
        # The thread cannot run while a plug-in holds the interpreter's lock; the kernel can.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def started_by(pid: int) -> list[psutil.Process]:
    """Lists what the plug-ins of a worker have started, for ``end_worker`` to end it.

    Args:
        pid: The worker's process id.

    Returns:
        All of it; nothing where there are process groups, which know it themselves.
    """
    if hasattr(os, "killpg"):
        return []
    try:
        return list(psutil.Process(pid).children(recursive=True))
    except psutil.NoSuchProcess:
        return []


def end_worker(pid: int, started: Iterable[psutil.Process] = ()) -> None:
    """Ends a worker and what its plug-ins have started, whatever they are doing.

    Where there are no process groups (Windows), what a worker has started can be listed only as
    long as the worker is there: what one that crashed has started goes on.

    Args:
        pid: Its process id; nothing happens where it and its process group have ended.
        started: What ``started_by`` has listed of it.
    """
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)
        return
    for process in started:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    with suppress(psutil.NoSuchProcess):
        psutil.Process(pid).kill()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # However it ends: killed, too, when it can no longer stop its workers.
        end_worker(os.getpid(), started_by(os.getpid()))
