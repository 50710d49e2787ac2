"""The figures of a run: ``summary.json``.

The figures are those of ``dosplan.scoring.metrics``, which says of each how it is averaged.
Percentiles of cycle times are over all planning cycles of all episodes pooled, read from the
episode files: a percentile of per-episode percentiles would be neither.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, make_dataclass
from typing import Any

import numpy as np

from dosplan.results.comparison import Comparison, compare_rows
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest
from dosplan.results.recording import load_cycle_ms
from dosplan.results.unusable import Unusable, unusable_scenarios
from dosplan.scenario.sources.catalogue import source_text
from dosplan.scoring import metrics
from dosplan.system.files import FileError, read_json, write_json
from dosplan.system.typed import plain, typed
from dosplan.types import Arm, FloatArray, Score

ArmSummary = dict[str, int | float | None]
"""The figures of one arm: ``n``, the number of episodes (scenarios times futures), ``usable``, the
number of those that are not unusable and in which the traffic did not fail, and over these the
figure of each metric by its key (``dosplan.scoring.metrics.Metric.key``). Shares lie between 0 and
1; None where no episode has a value."""


@dataclass(frozen=True, kw_only=True)
class RunTitle:
    """The run that a summary is of: everything that its figures depend on.

    Attributes:
        source: Where the scenarios were, as it was given to the run.
        planner: Name of the planner, with its version.
        predictor: Name of the predictor, likewise.
        traffic: Name of the traffic.
        planner_options: Options of the planner.
        predictor_options: Options of the predictor.
        traffic_options: Options of the traffic.
        loop: Name of the loop, with what was changed of it.
        futures: Number of futures of each scenario.
        seed: Seed of everything random.
        ranked: Whether the run may be ranked: false where the predictor may have seen the future,
            and where the run cannot be repeated.
        reproducible: Whether the run can be repeated: false where it depends on the
            time that plans took.
    """

    source: str
    planner: str
    predictor: str
    traffic: str = "replay"
    planner_options: Mapping[str, Any]
    predictor_options: Mapping[str, Any]
    traffic_options: Mapping[str, Any] = field(default_factory=dict)
    loop: str = "ideal"
    futures: int = 1
    seed: int
    ranked: bool
    reproducible: bool = True


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Content of ``summary.json``.

    Attributes:
        with_dos: Figures of the arm with sets; absent where the run does not drive it.
        without_dos: Figures of the arm without sets; absent likewise.
        run: Which run it is.
        comparison: The arm with sets against the arm without; absent where one arm was driven.
        unusable: The scenarios that nobody could drive; absent where there is none.
    """

    with_dos: ArmSummary | None = None
    without_dos: ArmSummary | None = None
    run: RunTitle
    comparison: Comparison | None = None
    unusable: tuple[Unusable, ...] = ()

    @property
    def arms(self) -> dict[Arm, ArmSummary]:
        """The figures of each arm that was driven."""
        both = {Arm.WITH_DOS: self.with_dos, Arm.WITHOUT_DOS: self.without_dos}
        return {arm: figures for arm, figures in both.items() if figures is not None}

    @property
    def content(self) -> dict[str, Any]:
        """What ``summary.json`` and ``--json`` hold: absent figures have no key."""
        compared = None if self.comparison is None else self.comparison.content()
        content = {**vars(self), "comparison": compared, "unusable": self.unusable or None}
        return {key: plain(value) for key, value in content.items() if value is not None}


def summarise_run(folder: RunFolder, manifest: RunManifest, rows: Sequence[Score]) -> Summary:
    """Summarises a run.

    Args:
        folder: The run folder, with its episode files.
        manifest: Its ``run.json``.
        rows: Its rows, one for each episode.

    Returns:
        The summary.

    Raises:
        FileError: The file of an episode that has cycles is missing or broken.
    """
    times = {arm: pooled_cycle_ms(folder, rows, arm) for arm in manifest.config.arms}
    return _summary(manifest, rows, summarise(rows, manifest.episodes_per_arm, times))


def summarise_rows(folder: RunFolder, manifest: RunManifest, rows: Sequence[Score]) -> Summary:
    """Summarises a run again of which the rows are kept and the episode files are not.

    Args:
        folder: The run folder.
        manifest: Its ``run.json``.
        rows: Its rows, one for each episode.

    Returns:
        The summary; percentiles of cycle times are those of the ``summary.json`` that is there.

    Raises:
        FileError: There is no ``summary.json``.
    """
    old = read_json(folder.summary)
    no_times = dict.fromkeys(manifest.config.arms, np.empty(0))
    figures = summarise(rows, manifest.episodes_per_arm, no_times)
    for arm, found in figures.items():
        found |= {
            metric.key: old.get(arm.value, {}).get(metric.key)
            for metric in metrics.METRICS
            if metric.aggregate.percentile is not None
        }
    return _summary(manifest, rows, figures)


def _summary(
    manifest: RunManifest, rows: Sequence[Score], figures: Mapping[Arm, ArmSummary]
) -> Summary:
    config, comparison = manifest.config, None
    if len(figures) == len(Arm):
        a, b = ([row for row in rows if row.arm is arm] for arm in (Arm.WITHOUT_DOS, Arm.WITH_DOS))
        comparison = compare_rows(a, b, Arm.WITHOUT_DOS.value, Arm.WITH_DOS.value)
    return Summary(
        with_dos=figures.get(Arm.WITH_DOS),
        without_dos=figures.get(Arm.WITHOUT_DOS),
        run=RunTitle(
            source=source_text(config.source),
            planner=manifest.planner,
            predictor=manifest.predictor,
            traffic=manifest.traffic,
            planner_options=config.planner_options,
            predictor_options=config.predictor_options,
            traffic_options=config.traffic_options,
            loop=manifest.loop,
            futures=config.futures,
            seed=config.seed,
            ranked=config.ranked and manifest.reproducible,
            reproducible=manifest.reproducible,
        ),
        comparison=comparison,
        unusable=unusable_scenarios(rows),
    )


def write_summary(folder: RunFolder, summary: Summary) -> None:
    """Writes ``summary.json``.

    Args:
        folder: The run folder.
        summary: Its summary.

    Raises:
        FileError: It cannot be written.
    """
    write_json(folder.summary, summary.content)


def read_summary(folder: RunFolder) -> Summary:
    """Reads ``summary.json``.

    Args:
        folder: The run folder.

    Returns:
        Its content.

    Raises:
        FileError: It cannot be read or is not the summary of a run.
    """
    try:
        found = typed(read_json(folder.summary), _content_kind())
    except ValueError as error:
        raise FileError(
            f"{folder.summary} is not a summary.json of this version ({error}); "
            "run the same command again to have it written anew"
        ) from None
    arms = {
        arm: None if (figures := getattr(found, arm.value)) is None else _figures(figures)
        for arm in Arm
    }
    return Summary(
        with_dos=arms[Arm.WITH_DOS],
        without_dos=arms[Arm.WITHOUT_DOS],
        run=found.run,
        comparison=None if found.comparison is None else Comparison.of_content(found.comparison),
        unusable=found.unusable,
    )


def summarise(
    rows: Sequence[Score], n: int, cycle_ms: Mapping[Arm, FloatArray]
) -> dict[Arm, ArmSummary]:
    """Summarises the rows, arm by arm.

    Args:
        rows: Rows of a run.
        n: Number of episodes of each arm; every share is over those of them that are usable.
        cycle_ms: Times of all planning cycles of each arm, ms.

    Returns:
        The figures of each arm of ``cycle_ms``, in its order.

    Raises:
        ValueError: An arm does not have exactly ``n`` rows.
    """
    return {
        arm: _summarise_arm([row for row in rows if row.arm is arm], n, times)
        for arm, times in cycle_ms.items()
    }


def pooled_cycle_ms(folder: RunFolder, rows: Iterable[Score], arm: Arm) -> FloatArray:
    """Reads the times of all planning cycles of an arm.

    Args:
        folder: The run folder.
        rows: Its rows.
        arm: The arm.

    Returns:
        (C,) times, ms, over the scored drives of all its episodes that have a cycle.

    Raises:
        FileError: The file of an episode that has cycles is missing or broken.
    """
    times = [
        load_cycle_ms(folder.recording(row.key), row.steps)
        for row in rows
        if row.arm is arm and row.cycle_ms_p50 is not None
    ]
    return np.concatenate([np.empty(0), *times])


def _summarise_arm(rows: Sequence[Score], n: int, cycle_ms: FloatArray) -> ArmSummary:
    if len(rows) != n:
        raise ValueError(f"{len(rows)} rows for {n} episodes: every episode needs its row")
    usable = sum(row.outcome.of_planner for row in rows)
    figures: ArmSummary = {"n": n, "usable": usable}
    return figures | {m.key: m.summarise(rows, cycle_ms) for m in metrics.METRICS}


def _figures(read: Any) -> ArmSummary:
    """The figures of an arm as they were read; an older file takes every scenario as usable."""
    figures: ArmSummary = asdict(read)
    return figures if figures["usable"] is not None else figures | {"usable": figures["n"]}


def _content_kind() -> type[Any]:
    """A dataclass of the keys of ``summary.json``; a metric may be absent in an older file."""
    figures = make_dataclass(
        "ArmSummary",
        [
            ("n", int),
            ("usable", int | None, field(default=None)),
            *((m.key, float | None, field(default=None)) for m in metrics.METRICS),
        ],
    )
    return make_dataclass(
        "SummaryContent",
        [
            ("run", RunTitle),
            *((arm.value, figures | None, field(default=None)) for arm in Arm),
            ("comparison", Comparison.content_kind() | None, field(default=None)),
            ("unusable", tuple[Unusable, ...], ()),
        ],
    )
