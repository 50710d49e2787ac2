"""Planning with and without sets: outcomes and velocity of both arms, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dosplan.report.figures import style
from dosplan.report.figures.sources import Published
from dosplan.report.palette import ARM_COLOURS
from dosplan.results.intervals import Interval, metric_interval
from dosplan.results.markdown import ARM_TITLES
from dosplan.scoring.metrics import find_metric
from dosplan.system.files import FileError
from dosplan.types import Arm, Score

RUNS: Final = {"suite": "suite", "suite-1": "first suite", "recorded": "public scenarios"}
GOOD: Final = ("success", "safe")
BAD: Final = ("collision", "at_fault_collision", "out_of_bounds", "goal_missed")
"""Names of the shares that are drawn."""
_BARS: Final = "Bars: 95 % interval of each arm by itself, not of the paired difference."
_APART: Final = 0.24  # Between the arms.


def sources(published: Published) -> list[Path]:
    """The files that the figure shows."""
    return [published.rows_file(run) for run in RUNS]


def draw(published: Published) -> Figure:
    """Draws the figure.

    Args:
        published: The results.

    Returns:
        A figure of a page's width, a row of panels for each run.

    Raises:
        FileError: A run is missing, or does not hold both arms, or nothing was driven in one.
    """
    figure = style.new_figure(style.PAGE, 5.0)
    panels = figure.subplots(len(RUNS), 3, sharex="col", width_ratios=(2, 3, 1.4), squeeze=False)
    for (good, bad, speed), (run, title) in zip(panels, RUNS.items(), strict=True):
        rows = published.rows(run)
        arms = {arm: [row for row in rows if row.arm is arm] for arm in Arm}
        if not all(arms.values()):
            raise FileError(f"{published.path / run} holds one arm only; drive both")
        speeds = {arm: metric_interval(find_metric("velocity"), arms[arm]) for arm in arms}
        velocities = {arm: [found] for arm, found in speeds.items() if found is not None}
        if len(velocities) < len(arms):
            raise FileError(f"{published.path / run} holds an arm in which no step was driven")
        _shares(good, arms, GOOD)
        _shares(bad, arms, BAD)
        _intervals(speed, velocities, [""])
        good.set_title(f"{title}: {_count(arms[Arm.WITH_DOS])}", loc="left", fontweight="bold")
    for axes, label in zip(panels[-1], ("share, %", "share, %", "velocity, m/s"), strict=True):
        axes.set_xlabel(label)
    panels[0, 0].set_xlim(right=100.6)
    panels[0, 1].set_xlim(left=-0.4)
    handles, titles = panels[0, 0].get_legend_handles_labels()
    legend = figure.legend(handles, titles, loc="outside lower center", ncols=2, title=_BARS)
    legend.get_title().set_fontsize(7)
    return figure


def _count(rows: Sequence[Score]) -> str:
    """How many scenarios, and how many drives where each has several futures."""
    scenarios = len({row.scenario for row in rows})
    futures = "" if scenarios == len(rows) else f", {len(rows)} futures"
    return f"{scenarios} scenarios{futures}"


def _shares(axes: Axes, arms: dict[Arm, list[Score]], names: Sequence[str]) -> None:
    shown = [find_metric(name) for name in names]
    found = {}
    for arm, rows in arms.items():
        shares = [metric_interval(metric, rows) for metric in shown]
        found[arm] = [Interval(*(100.0 * end for end in share)) for share in shares if share]
    _intervals(axes, found, [metric.short.lower() for metric in shown])


def _intervals(axes: Axes, found: dict[Arm, list[Interval]], names: Sequence[str]) -> None:
    """Draws values with intervals from top to bottom, the arms of each below each other."""
    places = np.arange(len(names), dtype=np.float64)
    for i, (arm, intervals) in enumerate(found.items()):
        value, low, high = np.transpose(intervals)
        axes.errorbar(
            value,
            places + _APART * (i - 0.5),
            xerr=(value - low, high - value),
            color=ARM_COLOURS[arm],
            marker=style.ARM_MARKERS[arm],
            linestyle="none",
            label=ARM_TITLES[arm],
        )
    axes.set_yticks(places, names)
    axes.tick_params(axis="y", length=0.0)
    axes.grid(visible=False, axis="y")
    axes.set_ylim(len(names) - 0.5, -0.5)
