"""The figures of a run: ``summary.json``.

How the figures of the summary are averaged:

* shares are over all scenarios of the run, but for ``comfortable_rate``;
* ``velocity``, ``progress`` and ``comfortable_rate`` are means over the episodes that drove a
  step (an episode that failed before its first step has no velocity);
* ``min_time_to_collision`` is the mean over the episodes that have one;
* ``cycle_ms_p50`` and ``cycle_ms_p99`` are percentiles over all planning cycles of all episodes
  pooled, read from the episode files: a percentile of per-episode percentiles would be neither.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dosplan.results.comparison import Comparison, compare_rows
from dosplan.results.folder import RunFolder
from dosplan.results.manifest import RunManifest
from dosplan.results.recording import load_cycle_ms
from dosplan.system.files import FileError, read_json, write_json
from dosplan.system.typed import plain, typed
from dosplan.types import Arm, FloatArray, Outcome, Score


@dataclass(frozen=True)
class ArmSummary:
    """The figures of one arm; shares lie between 0 and 1.

    Attributes:
        n: Number of scenarios, the denominator of every share.
        success_rate: Share of ``success``.
        safe_rate: Share without collision and within bounds (the paper's success).
        collision_rate: Share of ``collision``.
        at_fault_collision_rate: Share with a collision that the ego is to blame for.
        out_of_bounds_rate: Share of ``out_of_bounds``.
        goal_missed_rate: Share of ``goal_missed``.
        planner_failure_rate: Share of ``planner_failure``.
        comfortable_rate: Share, of the episodes that drove a step, in which every comfort bound
            holds, or None where none did.
        velocity: Mean velocity, m/s, or None where no episode drove a step.
        progress: Mean distance along the reference path, m, or None likewise.
        min_time_to_collision: Mean of the smallest times to collision, s, or None where no
            episode has one.
        cycle_ms_p50: Median time of a planning cycle, ms, or None where none ran.
        cycle_ms_p99: 99th percentile of it.
    """

    n: int
    success_rate: float
    safe_rate: float
    collision_rate: float
    at_fault_collision_rate: float
    out_of_bounds_rate: float
    goal_missed_rate: float
    planner_failure_rate: float
    comfortable_rate: float | None
    velocity: float | None
    progress: float | None
    min_time_to_collision: float | None
    cycle_ms_p50: float | None
    cycle_ms_p99: float | None


@dataclass(frozen=True, kw_only=True)
class RunTitle:
    """Which run a summary is of: what decides its figures.

    Attributes:
        source: Where the scenarios were, as it was given to the run.
        planner: Name of the planner, with its version.
        predictor: Name of the predictor, likewise.
        planner_options: Options of the planner.
        predictor_options: Options of the predictor.
        seed: Seed of everything random.
        ranked: Whether the run kept the rules: false where the predictor may have seen the future.
    """

    source: str
    planner: str
    predictor: str
    planner_options: Mapping[str, Any]
    predictor_options: Mapping[str, Any]
    seed: int
    ranked: bool


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Content of ``summary.json``.

    Attributes:
        with_dos: Figures of the arm with sets; absent where the run does not drive it.
        without_dos: Figures of the arm without sets; absent likewise.
        run: Which run it is.
        comparison: The arm with sets against the arm without; absent where one arm was driven.
    """

    with_dos: ArmSummary | None = None
    without_dos: ArmSummary | None = None
    run: RunTitle
    comparison: Comparison | None = None

    @property
    def arms(self) -> dict[Arm, ArmSummary]:
        """The figures of each arm that was driven."""
        both = {Arm.WITH_DOS: self.with_dos, Arm.WITHOUT_DOS: self.without_dos}
        return {arm: figures for arm, figures in both.items() if figures is not None}

    @property
    def content(self) -> dict[str, Any]:
        """What ``summary.json`` and ``--json`` hold: no key for what there is not."""
        return {key: value for key, value in plain(self).items() if value is not None}


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
    config = manifest.config
    times = {arm: pooled_cycle_ms(folder, rows, arm) for arm in config.arms}
    figures = summarise(rows, len(manifest.scenarios), times)
    comparison = None
    if len(figures) == len(Arm):
        a, b = ([row for row in rows if row.arm is arm] for arm in (Arm.WITHOUT_DOS, Arm.WITH_DOS))
        comparison = compare_rows(a, b, Arm.WITHOUT_DOS.value, Arm.WITH_DOS.value)
    return Summary(
        with_dos=figures.get(Arm.WITH_DOS),
        without_dos=figures.get(Arm.WITHOUT_DOS),
        run=RunTitle(
            source=config.source,
            planner=manifest.planner,
            predictor=manifest.predictor,
            planner_options=config.planner_options,
            predictor_options=config.predictor_options,
            seed=config.seed,
            ranked=config.ranked,
        ),
        comparison=comparison,
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
        return typed(read_json(folder.summary), Summary)
    except ValueError as error:
        raise FileError(
            f"{folder.summary} is not a summary.json of this version ({error}); "
            "run the same command again to have it written anew"
        ) from None


def summarise(
    rows: Sequence[Score], n: int, cycle_ms: Mapping[Arm, FloatArray]
) -> dict[Arm, ArmSummary]:
    """Summarises the rows, arm by arm.

    Args:
        rows: Rows of a run.
        n: Number of scenarios of the run: the denominator of every share.
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
        (C,) times, ms, over all its episodes; an episode without a cycle has no part in it.

    Raises:
        FileError: The file of an episode that has cycles is missing or broken.
    """
    times = [
        load_cycle_ms(folder.recording(row.scenario, arm))
        for row in rows
        if row.arm is arm and row.cycle_ms_p50 is not None
    ]
    return np.concatenate([np.empty(0), *times])


def _summarise_arm(rows: Sequence[Score], n: int, cycle_ms: FloatArray) -> ArmSummary:
    if len(rows) != n:
        raise ValueError(f"{len(rows)} rows for {n} scenarios: every scenario needs its row")
    outcomes = [row.outcome for row in rows]
    driven = [row for row in rows if row.steps > 0]
    times = [r.min_time_to_collision for r in rows if r.min_time_to_collision is not None]
    p50, p99 = np.percentile(cycle_ms, [50, 99]).tolist() if len(cycle_ms) else (None, None)
    return ArmSummary(
        n=n,
        success_rate=outcomes.count(Outcome.SUCCESS) / n,
        safe_rate=sum(row.safe for row in rows) / n,
        collision_rate=outcomes.count(Outcome.COLLISION) / n,
        at_fault_collision_rate=sum(row.at_fault for row in rows) / n,
        out_of_bounds_rate=outcomes.count(Outcome.OUT_OF_BOUNDS) / n,
        goal_missed_rate=outcomes.count(Outcome.GOAL_MISSED) / n,
        planner_failure_rate=outcomes.count(Outcome.PLANNER_FAILURE) / n,
        comfortable_rate=_mean([row.comfortable for row in driven]),
        velocity=_mean([row.velocity for row in driven]),
        progress=_mean([row.progress for row in driven]),
        min_time_to_collision=_mean(times),
        cycle_ms_p50=p50,
        cycle_ms_p99=p99,
    )


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None
