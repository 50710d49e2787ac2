"""Drives episodes on a Dask cluster: many machines, and one runner that writes.

Each thread of a Dask worker drives in an ``EpisodeProcess`` of its own, so that an episode has
the same isolation and gives the same row as on one machine. The scenario is read where it is
driven; its row and files travel back. When a Dask worker dies, the scheduler hands its episodes to
another one.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import re
import signal
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import islice
from queue import SimpleQueue
from threading import Lock
from typing import Any, Final, TypeVar

from dosplan import __version__
from dosplan.plugins.registry import (
    PluginKind,
    choose_planner,
    choose_plugin,
    choose_predictor,
    portable_options,
    target,
)
from dosplan.running.config import RunConfig, RunError
from dosplan.running.executor import Results, Verdicts, Workers, parted
from dosplan.running.job import EpisodeResult, Task
from dosplan.running.process import EpisodeProcesses
from dosplan.scenario import ScenarioRef
from dosplan.scoring.score import failed_score
from dosplan.system.errors import one_line
from dosplan.system.workers import WORKER_ENVIRONMENT

try:
    import dask
    import distributed
    from distributed.client import ClosedClientError
    from distributed.scheduler import KilledWorker
except ImportError as error:
    raise RunError(f"--cluster needs Dask ({error}); pip install 'dosplan[cluster]'") from error

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_LOCAL: Final = "local:"
_ADDRESS: Final = re.compile(r"local:\d+|(?:[a-z]+://)?\S+:\d+|inproc://\S+")
_WINDOW: Final = 2000  # Tasks that the scheduler holds at a time.
_RETRIES: Final = 2  # For a machine that cannot start processes; another one may.
_CONNECT_SECONDS: Final = 15.0
_CLOSE_SECONDS: Final = 1.0
_DIED: Final = "every Dask worker that took it up died"
_WORKER_NAME: Final = "Dask Worker process"
_LOG_LENGTH: Final = 100
"""Entries of each of a scheduler's logs in memory. It keeps one for every client, so for every run
of a sweep, and nobody reads them."""


@dataclass(frozen=True)
class DaskExecutor:
    """Drives on the workers of a Dask cluster; connects when it is to drive.

    Attributes:
        address: Address of the scheduler, such as ``tcp://host:8786``, or ``local:N`` for N
            workers on this machine.

    Raises:
        RunError: It is not such an address.
    """

    address: str

    def __post_init__(self) -> None:
        count = self.address.removeprefix(_LOCAL)
        if self.address.startswith(_LOCAL) and not (count.isdecimal() and int(count) > 0):
            raise RunError(
                f"cluster is {self.address!r}; local: takes a number of workers, as local:4"
            )
        if not _ADDRESS.fullmatch(self.address):
            raise RunError(
                f"cluster is {self.address!r}; it takes the address of a scheduler, as "
                "tcp://host:8786, or local:4"
            )

    @contextmanager
    def start(self, config: RunConfig) -> Iterator[Workers]:
        """Connects to the cluster, as ``Executor`` says."""
        config = _anywhere(config)
        _silence_dask()
        with _connected(self.address) as client:
            try:
                yield _Cluster(config, client, self.address)
            finally:
                _stop_driving(client, config)


@dataclass(frozen=True)
class _Cluster:
    """Works on the Dask workers.

    Attributes:
        config: The run, as it can be read everywhere.
        client: The client of the cluster.
        address: The address that was given.
    """

    config: RunConfig
    client: Any
    address: str

    def check(self, refs: Iterable[ScenarioRef]) -> Verdicts:
        def submit(part: tuple[ScenarioRef, ...]) -> Any:
            return self._submit(_check, tuple(map(_absolute, part)))

        def lost(_: tuple[ScenarioRef, ...]) -> list[str | None]:
            # A file that ends a process ends that of the episodes, not the Dask worker.
            raise RunError(
                "every Dask worker that took up scenarios to check them died; see to the workers, "
                "then the same command resumes"
            )

        workers = max(len(self.client.scheduler_info()["workers"]), 1)
        for part, found in self._all(submit, parted(refs, workers), lost):
            yield from zip(part, found, strict=True)

    def drive(self, tasks: Iterable[Task]) -> Results:
        def submit(task: Task) -> Any:
            return self._submit(_drive, task._replace(ref=_absolute(task.ref)))

        return self._all(submit, tasks, lambda task: EpisodeResult(failed_score(task.key, _DIED)))

    def _submit(self, call: Callable[..., Any], *arguments: Any) -> Any:
        return self.client.submit(
            call, *arguments, self.config, __version__, pure=False, retries=_RETRIES
        )

    def _all(
        self,
        submit: Callable[[_Item], Any],
        items: Iterable[_Item],
        lost: Callable[[_Item], _Result],
    ) -> Generator[tuple[_Item, _Result], None, None]:
        """Each item with its result, or with ``lost`` of it where its Dask workers died."""
        source = iter(items)
        pending: dict[Future[Any], _Item] = {}
        ended: SimpleQueue[Future[Any]] = SimpleQueue()

        def hand_out(count: int) -> None:
            for item in islice(source, count):
                # Each is fetched by itself: the scheduler tries for half a minute to fetch what a
                # worker has driven that is dead by now, and nobody else is to wait for that.
                fetched = asyncio.run_coroutine_threadsafe(
                    _result(submit(item)), self.client.loop.asyncio_loop
                )
                pending[fetched] = item
                fetched.add_done_callback(ended.put)

        try:
            hand_out(_WINDOW)
            while pending:
                fetched = ended.get()
                item = pending.pop(fetched)
                hand_out(1)
                died, result = fetched.result()
                yield item, lost(item) if died else result
        except (OSError, CancelledError, ClosedClientError) as error:
            raise RunError(
                f"lost the Dask scheduler at {self.address}; what was driven is kept, "
                "and the same command resumes when a scheduler is there"
            ) from error


def _absolute(ref: ScenarioRef) -> ScenarioRef:
    return replace(ref, path=ref.path.absolute())


async def _result(future: Any) -> tuple[bool, Any]:
    """Whether every worker that took up a task died, and its result otherwise."""
    try:
        return False, await future
    except Exception as error:
        if future.status != "error":  # It is not the task that failed, but the scheduler is lost.
            raise
        if isinstance(error, KilledWorker):
            return True, None
        if isinstance(error, RunError):
            raise
        raise RunError(f"a Dask worker cannot drive episodes: {one_line(error)}") from error


class _Run:
    """The run that a Dask worker drives episodes of, one at a time."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._processes: EpisodeProcesses | None = None

    def processes(self, config: RunConfig) -> EpisodeProcesses:
        """The processes of a run; those of an earlier one end with their episodes."""
        with self._lock:
            if self._processes is None or self._processes.config != config:
                if self._processes is not None:
                    self._processes.retire()
                self._processes = EpisodeProcesses(config)
            return self._processes

    def stop(self, config: RunConfig) -> None:
        """Ends every process of a run, whatever it is doing; another run goes on."""
        with self._lock:
            if self._processes is not None and self._processes.config == config:
                self._processes.stop()
                self._processes = None


_RUN: Final = _Run()


def _drive(task: Task, config: RunConfig, version: str) -> EpisodeResult:
    """Drives an episode; runs in a thread of a Dask worker."""
    return _processes(config, version).drive(task)


def _check(refs: Sequence[ScenarioRef], config: RunConfig, version: str) -> list[str | None]:
    """Checks scenarios, likewise."""
    return _processes(config, version).check(refs)


def _processes(config: RunConfig, version: str) -> EpisodeProcesses:
    """The processes of a run on this worker."""
    if version != __version__:
        raise RunError(f"a Dask worker has dosplan {__version__} and the runner {version}")
    if multiprocessing.current_process().daemon:
        raise RunError(
            "the Dask workers are daemons, which may start no process; start them with "
            "--no-nanny, or with DASK_DISTRIBUTED__WORKER__DAEMON=False in their environment"
        )
    os.environ.update(WORKER_ENVIRONMENT)
    return _RUN.processes(config)


async def _stop_processes(config: RunConfig) -> None:
    """Ends the episode processes of a run; runs in each Dask worker."""
    _RUN.stop(config)


def _stop_driving(client: Any, config: RunConfig) -> None:
    """Asks the workers to end the run, without waiting for them."""
    if client.status == "running":
        with suppress(OSError):  # The cluster may be closing, too.
            client.run(_stop_processes, config, wait=False)


def dask_setup(_: Any) -> None:
    """Makes a worker of a local cluster ignore Ctrl-C, which the runner handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def kept_cluster(address: str) -> Iterator[str]:
    """Keeps one cluster for several runs; a local one is started here, once.

    Args:
        address: As of ``DaskExecutor``.

    Yields:
        The address for each run's ``DaskExecutor``.

    Raises:
        RunError: It is not such an address.
    """
    DaskExecutor(address)
    if not address.startswith(_LOCAL):
        yield address
        return
    _silence_dask()
    with _local_cluster(int(address.removeprefix(_LOCAL))) as started:
        yield started


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """A client of the cluster, which is started first where it is a local one."""
    with ExitStack() as stack:
        if address.startswith(_LOCAL):
            count = int(address.removeprefix(_LOCAL))
            address = stack.enter_context(_local_cluster(count))
        try:
            client = distributed.Client(  # type: ignore[no-untyped-call]
                address, timeout=_CONNECT_SECONDS, set_as_default=False
            )
        except (OSError, ValueError) as error:
            raise RunError(f"no Dask scheduler answers at {address} ({one_line(error)})") from error
        stack.callback(client.close, timeout=_CLOSE_SECONDS)
        yield client


@contextmanager
def _local_cluster(workers: int) -> Iterator[str]:
    """Starts a scheduler and workers on this machine; its address."""
    settings = {
        "distributed.worker.daemon": False,
        "distributed.worker.profile.enabled": False,  # Dask's own, which grows for a quarter hour.
        "distributed.admin.log-length": _LOG_LENGTH,
        "distributed.admin.low-level-log-length": _LOG_LENGTH,
    }
    with dask.config.set(settings):
        cluster = distributed.LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            memory_limit=0,  # An episode's process has a limit of its own.
            silence_logs=logging.CRITICAL,
            preload=__name__,  # For ``dask_setup``.
        )
        try:
            yield str(cluster.scheduler_address)
        finally:
            with suppress(OSError):
                cluster.close(timeout=_CLOSE_SECONDS)
            for child in multiprocessing.active_children():
                if child.name.startswith(_WORKER_NAME):  # What did not end in time.
                    child.kill()


def _silence_dask() -> None:
    """Turns off Dask's log lines: dosplan reports what matters in one line.

    They stay off, since its threads still log when the run is over.
    """
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _anywhere(config: RunConfig) -> RunConfig:
    """The same run for a worker that stands in another folder: paths are absolute."""
    planner = choose_planner(config.planner, config.planner_options)
    predictor = choose_predictor(config.predictor, config.predictor_options)
    traffic = choose_plugin(PluginKind.TRAFFIC, config.traffic, config.traffic_options)
    return replace(
        config,
        planner=target(planner.plugin),
        predictor=target(predictor.plugin),
        traffic=target(traffic.plugin),
        planner_options=portable_options(planner),
        predictor_options=portable_options(predictor),
        traffic_options=portable_options(traffic),
    )
