"""The commands as functions, for scripts and notebooks: what ``import dosplan`` offers.

A run drives in worker processes, which import the script that started it: a script that calls
``run_suite`` does so below ``if __name__ == "__main__":``, or has it drive in its own process:
``run_suite(..., executor=SerialExecutor())``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from dosplan.api import Planner, Predictor
from dosplan.plugins.loops import choose_loop
from dosplan.plugins.registry import (
    RegistryError,
    create_planner,
    create_predictor,
    create_traffic,
    target,
)
from dosplan.results.comparison import Comparison, compare_runs
from dosplan.results.dataframes import to_pandas, to_polars
from dosplan.results.drive import Drive
from dosplan.results.folder import RunFolder
from dosplan.results.leaderboard import About, write_submission
from dosplan.results.manifest import RunManifest
from dosplan.results.markdown import comparison_text
from dosplan.results.published import LEADERBOARD
from dosplan.results.recording import Recording
from dosplan.results.rows import read_run
from dosplan.results.summary import Summary, read_summary
from dosplan.results.table import COLUMNS, Table, make_table
from dosplan.results.table_text import markdown_table, plain_table
from dosplan.running.config import RunConfig, default_folder
from dosplan.running.executor import Executor
from dosplan.running.progress import Progress, ProgressObserver
from dosplan.running.run import run
from dosplan.running.submission import make_submission
from dosplan.simulation.loop import run_episode as simulate
from dosplan.simulation.traffic import Traffic
from dosplan.types import Arm, EpisodeKey, Scenario, Score

if TYPE_CHECKING:
    import pandas
    import polars


@dataclass(frozen=True)
class Results:
    """A finished run.

    Attributes:
        path: The run folder.
        manifest: Content of ``run.json``.
        rows: The rows, in the order of the scenarios.
    """

    path: Path
    manifest: RunManifest
    rows: tuple[Score, ...]

    @property
    def summary(self) -> Summary:
        """Content of ``summary.json``: the figures of each arm, and their comparison.

        Raises:
            FileError: It cannot be read.
        """
        return read_summary(RunFolder(self.path))

    def recording(self, scenario: str, arm: Arm | str, future: int = 0) -> Recording:
        """Reads what was driven, planned and predicted in an episode.

        Args:
            scenario: Id of the scenario.
            arm: The arm.
            future: Which continuation of the scenario's past.

        Returns:
            The recording.

        Raises:
            FileError: There is none, or it cannot be read.
        """
        return Recording.load(
            RunFolder(self.path).recording(EpisodeKey(scenario, Arm(arm), future))
        )

    def to_polars(self) -> polars.DataFrame:
        """The rows as a polars frame.

        Raises:
            ImportError: polars is not installed.
        """
        return to_polars(self.rows)

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a pandas frame.

        Raises:
            ImportError: pandas is not installed.
        """
        return to_pandas(self.rows)


def run_episode(
    scenario: Scenario,
    planner: Planner | str = "mpc",
    predictor: Predictor | str = "dos",
    arm: Arm | str = Arm.WITH_DOS,
    *,
    seed: int = 0,
    loop: str = "ideal",
    loop_options: Mapping[str, Any] = MappingProxyType({}),
    traffic: Traffic | str = "replay",
    future: int = 0,
) -> Drive:
    """Drives and scores one scenario, in this process.

    Args:
        scenario: What to drive, from ``load_scenario``.
        planner: A planner, or the name of one.
        predictor: A predictor, or the name of one.
        arm: With or without the sets.
        seed: Seed of a plug-in that is given by its name.
        loop: How often and how late the ego plans, and what it sees: ``ideal`` or ``realistic``.
        loop_options: What is changed of it, such as ``{"latency": 0.3}``.
        traffic: The other road users: a traffic, or the name of one.
        future: Which continuation of the past a traffic drives that is given by its name.

    Returns:
        The drive: ``row``, its score; ``episode``, all that happened; ``recording``, what a run
        would keep of that. What a plug-in raises is in the row's ``error``.

    Raises:
        RegistryError: There is no plug-in of that name.
        SettingsError: There is no such loop, or an option of it is wrong.
    """
    if isinstance(planner, str):
        planner = create_planner(planner, seed)
    settings = choose_loop(loop, loop_options)
    if isinstance(predictor, str):
        predictor = create_predictor(predictor, seed, loop=settings)
    if isinstance(traffic, str):
        traffic = create_traffic(traffic, seed, future=future)
    episode = simulate(scenario, planner, predictor, Arm(arm), settings, traffic)
    return Drive.of(scenario, episode)


def run_suite(
    source: str | Path = "suite",
    planner: type[Planner] | str = "mpc",
    predictor: type[Predictor] | str = "dos",
    *,
    traffic: type[Traffic] | str = "replay",
    out: str | Path | None = None,
    progress: Progress = lambda done, total: None,
    executor: Executor | None = None,
    **settings: Any,
) -> Results:
    """Drives and scores many scenarios, as ``dosplan run`` does; resumes a run that was stopped.

    Args:
        source: Where the scenarios are, as ``find_scenarios`` takes it.
        planner: A planner's class, or the name of one.
        predictor: A predictor's class, or the name of one.
        traffic: The other road users: a traffic's class, or the name of one.
        out: The run folder; ``runs/<date and time>`` by default.
        progress: Called with the number of finished episodes and of all.
        executor: Drives the episodes; worker processes do by default.
        **settings: Further fields of ``dosplan.running.config.RunConfig``, such as ``limit=10``,
            ``workers=2``, ``futures=4``, ``predictor_options={"coverage": 0.9}`` or
            ``solutions=True``. Unlike
            there, every CPU has a worker and parsed scenarios are kept.

    Returns:
        The run.

    Raises:
        RunError: The run may not start or cannot go on.
        RegistryError: A plug-in cannot be found, or not by a worker process.
        ScenarioError: There are no scenarios.
        FileError: A result cannot be written.
    """
    config = RunConfig(
        out=default_folder() if out is None else Path(out),
        source=str(source),
        planner=_spec(planner),
        predictor=_spec(predictor),
        traffic=_spec(traffic),
        **{"workers": os.cpu_count() or 1, "cache": True, **settings},
    )
    return open_run(run(config, ProgressObserver(progress), executor).path)


def open_run(path: str | Path) -> Results:
    """Reads a finished run.

    Args:
        path: A run folder.

    Returns:
        The run.

    Raises:
        FileError: It is not the folder of a finished run.
    """
    manifest, rows = read_run(Path(path))
    return Results(Path(path), manifest, tuple(rows))


class Comparisons(list[Comparison]):
    """Comparisons that print as tables."""

    def __str__(self) -> str:
        return "\n\n".join(map(comparison_text, self))

    __repr__ = __str__


def compare(a: Results | str | Path, b: Results | str | Path | None = None) -> Comparisons:
    """Compares two runs, or the two arms of one, as ``dosplan compare`` does.

    Args:
        a: A run or its folder; a folder may be followed by ``:with_dos`` or ``:without_dos``.
        b: Another one; None compares the arms of ``a``.

    Returns:
        ``b`` against ``a``, once for each arm that both hold; for one run, its arm with sets
        against its arm without. They print as tables.

    Raises:
        CompareError: The sides do not match.
        FileError: A folder is not that of a finished run.
    """
    runs = [run for run in (a, b) if run is not None]
    return Comparisons(compare_runs([_folder(run) for run in runs]))


class RunTable(Table):
    """A table that prints as text, and in a notebook as Markdown."""

    def __str__(self) -> str:
        return plain_table(self)

    __repr__ = __str__

    def _repr_markdown_(self) -> str:
        return markdown_table(self)


def table(
    *runs: Results | str | Path,
    baseline: Results | str | Path | None = None,
    columns: Sequence[str] = COLUMNS,
    across_worlds: bool = False,
) -> RunTable:
    """Puts any number of runs side by side, as ``dosplan table`` does.

    Args:
        *runs: Runs, their folders, or folders of sweeps; a run folder may be followed by
            ``:with_dos`` or ``:without_dos``.
        baseline: What the others are compared with, likewise, or the name of a run of a sweep; by
            default it is in each block the first arm without sets, or the first row.
        columns: Names of metrics.
        across_worlds: Whether to put runs of another traffic or loop into one block, too.

    Returns:
        The table: ``blocks``, with rows over the same episodes. It prints as text, and in a
        notebook as Markdown.

    Raises:
        CompareError: There is no such metric or baseline, or nothing to show.
        FileError: A folder is not that of a finished run, or of a sweep.
    """
    found = make_table(
        [_folder(run) for run in runs],
        baseline=None if baseline is None else _folder(baseline),
        columns=columns,
        across_worlds=across_worlds,
    )
    return RunTable(found.columns, found.blocks, found.missing)


def submit(
    run: Results | str | Path,
    *,
    name: str = "",
    authors: str = "",
    url: str = "",
    out: str | Path = LEADERBOARD,
    source: str | Path | None = None,
) -> Path:
    """Checks a run and writes its row of the leaderboard, as ``dosplan submit`` does.

    Args:
        run: A run or its folder, with its episode files.
        name: What the leaderboard calls it; planner and predictor by default.
        authors: Whose it is.
        url: Page about it, or its code.
        out: Folder of the rows.
        source: Where the scenarios lie now; where the run found them by default.

    Returns:
        The file of the row.

    Raises:
        SubmissionError: The leaderboard does not take the run; ``reasons`` has a line for each
            reason.
        FileError: The row cannot be written.
    """
    about = About(name=name, authors=authors, url=url)
    where = None if source is None else str(source)
    return write_submission(Path(out), make_submission(Path(_folder(run)), about, where))


def _folder(run: Results | str | Path) -> str:
    return str(run.path if isinstance(run, Results) else run)


def _spec(plugin: type[Any] | str) -> str:
    """How a worker process finds a class: by its module, or by the file of the running script."""
    if isinstance(plugin, str):
        return plugin
    if plugin.__module__ != "__main__":
        return target(plugin)
    file = getattr(sys.modules["__main__"], "__file__", None)
    if file is None:
        raise RegistryError(
            f"worker processes cannot import {plugin.__qualname__}, which is defined in a "
            "notebook or a console; write it to a file and give file.py:Class"
        )
    return f"{file}:{plugin.__qualname__}"
