"""What occupancy sets are worth where the loop is slow, late or noisy, and who else is on the road.

    python results/loop/loop.py drive --out RUNS --data DATA/commonroad
    python results/loop/loop.py table RUNS
    python results/loop/loop.py draw

`drive` makes a run folder of both arms for each cell: a traffic and a loop that differs from the
ideal one in one thing. The same command goes on where it was stopped, and one with larger samples
adds to what is there. Cells come in the order of what they tell, so that a part of them is of use.
`table` writes the figures of the cells that are driven to ``loop.json`` and ``loop.md`` beside this
file, and `draw` draws what ``loop.json`` holds: ``loop.png`` and ``loop.pdf``.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from dosplan.plugins.loops import choose_loop
from dosplan.report.figures import style
from dosplan.report.palette import ARM_COLOURS, INK
from dosplan.results.comparison import compare_rows
from dosplan.results.folder import RunFolder
from dosplan.results.intervals import metric_interval
from dosplan.results.manifest import read_manifest
from dosplan.results.markdown import ARM_TITLES, ARMS_SIDE_BY_SIDE, markdown
from dosplan.results.rows import read_run
from dosplan.running.config import RunConfig
from dosplan.running.progress import ProgressObserver
from dosplan.running.run import run
from dosplan.scoring.metrics import find_metric
from dosplan.simulation.settings import REALISTIC, LoopSettings
from dosplan.system.errors import DosplanError
from dosplan.system.files import FileError, read_json, write_json, write_text
from dosplan.types import Arm, Score

TRAFFICS: Final = ("replay", "reactive", "sumo")
SUITE: Final = "suite"  # The first one.
RECORDED: Final = "recorded"
HERE: Final = Path(__file__).parent
METRICS: Final = ("success", "collision", "at_fault_collision", "safe", "velocity")
ENDS: Final = ("value", "low", "high")
ERRORS: Final = ("position", "speed", "heading", "size")
AXES: Final[Mapping[str, tuple[str, float]]] = {
    "period": ("planning period, s", 0.1),
    "latency": ("latency, s", 0.0),
    "noise": ("sensor errors, 1 = realistic", 0.0),
}
"""What loops differ in from the ideal one: title, and where that one is."""


@dataclass(frozen=True)
class LoopCell:
    """A loop of the figure.

    Attributes:
        name: Name of its folders.
        options: What is changed of the ideal loop; of the realistic one where it is named so.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def base(self) -> str:
        """The loop that the options change."""
        return "realistic" if self.name == "realistic" else "ideal"

    @property
    def loop(self) -> LoopSettings:
        """The settings."""
        return choose_loop(self.base, self.options)

    def place_on(self, axis: str) -> float | None:
        """Where the loop is on an axis of ``AXES``; None where it differs in something else."""
        if self.name == "ideal":
            return AXES[axis][1]
        own, _, value = self.name.partition("-")
        return float(value) if own == axis else None


def _noise(share: float) -> dict[str, Any]:
    """The errors of the realistic sensors, times a factor; without drop-outs or hidden places."""
    errors = {name: share * getattr(REALISTIC.sensing, name) for name in ERRORS}
    return {
        f"sensing.{name}": value
        for name, value in (errors | {"correlation": REALISTIC.sensing.correlation}).items()
    }


FIRST: Final = (
    LoopCell("ideal"),
    LoopCell("latency-0.3", {"latency": 0.3}),
    LoopCell("period-0.5", {"period": 0.5}),
    LoopCell("realistic"),
)
"""The loops that tell most."""
THEN: Final = (
    LoopCell("noise-1", _noise(1.0)),
    LoopCell("latency-0.5", {"latency": 0.5}),
    LoopCell("period-1.0", {"period": 1.0}),
    LoopCell("noise-2", _noise(2.0)),
    LoopCell("latency-0.1", {"latency": 0.1}),
    LoopCell("period-0.2", {"period": 0.2}),
)
LOOPS: Final = (*FIRST, *THEN)


@dataclass(frozen=True)
class Cell:
    """A traffic and a loop.

    Attributes:
        traffic: Name of the traffic.
        loop: The loop.
    """

    traffic: str
    loop: LoopCell

    @property
    def sources(self) -> tuple[str, ...]:
        """Where its scenarios are from: SUMO needs a place's net, which recordings lack."""
        return (SUITE,) if self.traffic == "sumo" else (SUITE, RECORDED)

    def folder(self, runs: Path, source: str) -> Path:
        """The run folder of a source's scenarios."""
        return runs / self.traffic / self.loop.name / source


def cells(traffics: Sequence[str] = TRAFFICS) -> Iterator[Cell]:
    """All cells, those that tell most first: replay, then the loops of ``FIRST`` elsewhere."""
    yield from (Cell("replay", loop) for loop in LOOPS if "replay" in traffics)
    others = [traffic for traffic in traffics if traffic != "replay"]
    for loops in (FIRST, THEN):
        yield from (Cell(traffic, loop) for traffic in others for loop in loops)


def drive(
    runs: Path, data: Path | None, counts: Mapping[str, int], traffics: Sequence[str], workers: int
) -> None:
    """Drives all cells, or what is missing of them.

    Args:
        runs: Where the run folders go.
        data: Folder with the recordings: ``train`` and ``val``.
        counts: How many scenarios are drawn of each source; of 0, it is left out. A folder that
            holds more keeps them.
        traffics: Which traffics.
        workers: Number of worker processes.
    """
    started = time.monotonic()
    for cell in cells(traffics):
        for source in cell.sources:
            if counts[source]:
                place = cell.folder(runs, source)
                config = RunConfig(
                    out=place,
                    source="suite-1" if source == SUITE else _recordings(data),
                    traffic=cell.traffic,
                    loop=cell.loop.base,
                    loop_options=cell.loop.options,
                    sample=max(counts[source], _sample(place)),
                    workers=workers,
                    cache=True,
                )
                title = f"{cell.traffic} {cell.loop.name} {source}"
                run(config, ProgressObserver(partial(_show, title, started)))
                print(file=sys.stderr)


def _recordings(data: Path | None) -> tuple[str, ...]:
    if data is None:
        raise SystemExit("loop.py: --data names the folder with train/ and val/, or --recorded 0")
    return tuple(str(data / part) for part in ("train", "val"))


def _sample(place: Path) -> int:
    """How many scenarios a folder was last asked for."""
    folder = RunFolder(place)
    if not folder.manifest.exists():
        return 0
    return read_manifest(folder).config.sample or 0


def _show(title: str, started: float, done: int, total: int) -> None:
    minutes = (time.monotonic() - started) / 60.0
    text = f"\r{minutes:5.1f} min  {title}: {done} of {total} episodes "
    print(text, end="", file=sys.stderr, flush=True)


def table(runs: Path) -> dict[str, Any]:
    """Collects the figures of the cells that are driven.

    A cell counts once all its run folders are finished: one that was stopped holds the scenarios
    that come first, which are no sample.

    Args:
        runs: The folder that ``drive`` was given.

    Returns:
        Content of ``loop.json``: ``cells`` in the order of ``cells``, each of them of both arms
        together with their paired difference, over all scenarios and over those of each source;
        and ``missing``, the cells that were not driven or not to their end.

    Raises:
        FileError: There is no finished cell, or the runs are not of one planner and predictor.
    """
    found, missing, plugins = [], [], set()
    for cell in cells():
        sources = [source for source in cell.sources if _begun(runs, cell.traffic, source)]
        rows: dict[str, list[Score]] = {}
        for source in sources:
            try:
                manifest, rows[source] = read_run(cell.folder(runs, source))
            except FileError:
                continue
            plugins.add((manifest.planner, manifest.predictor, manifest.config.seed))
        name = {"traffic": cell.traffic, "loop": cell.loop.name}
        if not sources or len(rows) < len(sources):
            begun = any(RunFolder(cell.folder(runs, s)).manifest.exists() for s in sources)
            missing.append(name | {"state": "not finished" if begun else "not driven"})
            continue
        parts = {"all": [row for part in rows.values() for row in part]}
        parts |= rows if len(rows) > 1 else {}
        loop = {"loop": cell.loop.name, "of": cell.loop.base, "changes": dict(cell.loop.options)}
        found.append(
            {"traffic": cell.traffic, **loop, "sources": sources}
            | {part: _figures(part_rows) for part, part_rows in parts.items()}
        )
    if not found:
        raise FileError(f"{runs} holds no finished cell: drive first, or to the end of a cell")
    if len(plugins) > 1:
        raise FileError(f"{runs} holds runs of several planners, predictors or seeds: {plugins}")
    ((planner, predictor, seed),) = plugins
    return {
        "planner": planner,
        "predictor": predictor,
        "seed": seed,
        "cells": found,
        "missing": missing,
    }


def _begun(runs: Path, traffic: str, source: str) -> bool:
    """Whether a source's scenarios were driven with a traffic, in any loop."""
    return any(
        RunFolder(Cell(traffic, loop).folder(runs, source)).manifest.exists() for loop in LOOPS
    )


def _figures(rows: Sequence[Score]) -> dict[str, Any]:
    """The figures of both arms, and with the sets minus without."""
    arms = {arm: [row for row in rows if row.arm is arm] for arm in Arm}
    compared = compare_rows(arms[Arm.WITHOUT_DOS], arms[Arm.WITH_DOS])
    found: dict[str, Any] = {
        "n": compared.n,
        "places": compared.places,
        "unusable": compared.unusable,
    }
    for arm, own in arms.items():
        usable = [row for row in own if row.outcome.of_planner]
        intervals = {name: metric_interval(find_metric(name), usable) for name in METRICS}
        found[arm.value] = {"n": len(usable)} | {
            name: None if interval is None else _rounded(interval._asdict())
            for name, interval in intervals.items()
        }
    found["difference"] = {
        name: None
        if (one := compared.differences.get(name)) is None
        else _rounded(
            {"difference": one.difference, "low": one.low, "high": one.high}
            | {"only_with": one.only_b, "only_without": one.only_a}
            | {"p": one.p, "p_places": one.p_places}
        )
        for name in METRICS
    }
    return found


def _rounded(figures: Mapping[str, float | None]) -> dict[str, float | None]:
    """What JSON holds of figures: to a millionth, and None where there is none."""
    return {
        name: None if value is None or math.isnan(value) else round(value, 6)
        for name, value in figures.items()
    }


def table_markdown(content: Mapping[str, Any]) -> str:
    """Writes ``loop.md``.

    Args:
        content: Content of ``loop.json``.

    Returns:
        Its text.
    """
    shares = METRICS[:-1]
    titles = ("success", "collision", "at fault", "safe")
    heads = ["traffic", "loop", "scenarios", "n", "arm", *(f"{t}, %" for t in titles)]
    paired = ["traffic", "loop", "n", "places", *(f"{t}, points" for t in titles)]
    arms, differences = [], []
    for cell in content["cells"]:
        for part in ("all", SUITE, RECORDED):
            if (figures := cell.get(part)) is None:
                continue
            named = " + ".join(cell["sources"]) if part == "all" else part
            for arm in ARMS_SIDE_BY_SIDE:
                own = figures[arm.value]
                texts = [_interval(own[name], 100.0, 1) for name in shares]
                texts.append(_interval(own["velocity"], 1.0, 2))
                start = [cell["traffic"], cell["loop"], named, str(own["n"])]
                arms.append([*start, ARM_TITLES[arm].replace("DOS", "sets"), *texts])
        figures = cell["all"]
        texts = [_difference(figures["difference"][name], 100.0, 1) for name in shares]
        texts.append(_difference(figures["difference"]["velocity"], 1.0, 2))
        start = [cell["traffic"], cell["loop"], str(figures["n"]), str(figures["places"])]
        differences.append([*start, *texts])
    parts = [
        "# The loop and the traffic, with and without sets",
        f"`{content['planner']}` with `{content['predictor']}`, seed {content['seed']}. "
        "95 % intervals in brackets; they take into account which scenarios are of one place.",
        "## With sets minus without, over the same scenarios",
        "(only with : only without), and p of the exact test by scenarios; of velocity, that of "
        "the t test by places.",
        markdown([*paired, "velocity, m/s"], differences, numbers=False),
        "## Each arm",
        markdown([*heads, "velocity, m/s"], arms, numbers=False),
    ]
    if content["missing"]:
        lines = [f"- {one['traffic']}, {one['loop']}: {one['state']}" for one in content["missing"]]
        parts += ["## What is missing", "\n".join(lines)]
    return "\n\n".join(parts) + "\n"


def _interval(figure: Mapping[str, float | None] | None, scale: float, digits: int) -> str:
    if figure is None or figure["value"] is None:
        return "-"
    return f"{scale * figure['value']:.{digits}f}{_ends(figure, scale, digits, '')}"


def _difference(figure: Mapping[str, float | None] | None, scale: float, digits: int) -> str:
    if figure is None or figure["difference"] is None:
        return "-"
    text = f"{scale * figure['difference']:+.{digits}f}{_ends(figure, scale, digits, '+')}"
    if figure["only_with"] is not None:
        text += f" ({figure['only_with']:.0f} : {figure['only_without']:.0f})"
    return text if figure["p"] is None else f"{text}, p {figure['p']:.2g}"


def _ends(figure: Mapping[str, float | None], scale: float, digits: int, sign: str) -> str:
    low, high = figure["low"], figure["high"]
    if low is None or high is None:
        return ""
    return f" [{scale * low:{sign}.{digits}f}, {scale * high:{sign}.{digits}f}]"


def digest(content: Path) -> str:
    """What a figure holds of the file that it shows.

    Args:
        content: ``loop.json``.

    Returns:
        SHA-256 of the file.
    """
    return sha256(content.read_bytes()).hexdigest()


def draw(content: Mapping[str, Any]) -> Figure:
    """Draws the figures of all cells: a block for each traffic, the one of replay the highest.

    Args:
        content: Content of ``loop.json``.

    Returns:
        The figure, of a page's width.
    """
    by_traffic: dict[str, dict[str, Any]] = {}
    for cell in content["cells"]:
        by_traffic.setdefault(cell["traffic"], {})[cell["loop"]] = cell
    heights = [3.6 if traffic == "replay" else 2.75 for traffic in by_traffic]
    figure = style.new_figure(style.PAGE, sum(heights) + 0.3)
    blocks = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    panels = [_block(block, *one) for block, one in zip(blocks, by_traffic.items(), strict=True)]
    for row in zip(*(block[:, 0] for block in panels), strict=True):
        low, high = np.transpose([axes.get_ylim() for axes in row])
        for axes in row:
            axes.set_ylim(low.min(), high.max())
    arms = [Line2D([], [], color=ARM_COLOURS[arm], marker=style.ARM_MARKERS[arm]) for arm in _ARMS]
    dashed = Line2D([], [], color=INK, linestyle="--")
    names = [ARM_TITLES[arm].replace("DOS", "sets") for arm in _ARMS]
    figure.legend(
        [*arms, dashed],
        [*names, "collisions the ego is to blame for"],
        loc="outside lower center",
        ncols=3,
    )
    return figure


_ARMS: Final = (Arm.WITH_DOS, Arm.WITHOUT_DOS)
_ROWS: Final = (
    ("success", "success, %"),
    ("collision", "collisions, %"),
    ("velocity", "velocity, m/s"),
)


def _block(block: SubFigure, traffic: str, found: Mapping[str, Any]) -> Any:
    """Draws the panels of a traffic, and gives them in rows and columns."""
    panels = block.subplots(
        len(_ROWS), len(AXES) + 1, sharey="row", sharex="col", width_ratios=(3, 3, 3, 1.3)
    )
    numbers = sorted({cell["all"]["n"] for cell in found.values()})
    sources = sorted({" + ".join(cell["sources"]) for cell in found.values()})
    n = " to ".join(str(number) for number in dict.fromkeys((numbers[0], numbers[-1])))
    block.suptitle(
        f"{traffic}: {', '.join(sources)}, n = {n}", x=0.01, ha="left", fontsize=8, weight="bold"
    )
    known = [loop for loop in LOOPS if loop.name in found]
    for column, (axis, (title, _)) in enumerate(AXES.items()):
        curve = {
            x: found[loop.name]["all"] for loop in known if (x := loop.place_on(axis)) is not None
        }
        _column(panels[:, column], dict(sorted(curve.items())))
        places = sorted(x for loop in LOOPS if (x := loop.place_on(axis)) is not None)
        margin = 0.05 * (places[-1] - places[0])
        panels[-1, column].set_xlabel(title)
        panels[-1, column].set_xticks(places, [f"{x:g}" for x in places])
        panels[-1, column].set_xlim(places[0] - margin, places[-1] + margin)
        if len(curve) < 2:
            for axes in panels[:, column]:
                axes.text(
                    0.5, 0.5, "not driven", transform=axes.transAxes, ha="center", va="center"
                )
    named = [loop.name for loop in known if loop.name in ("ideal", "realistic")]
    _column(panels[:, -1], {float(i): found[name]["all"] for i, name in enumerate(named)}, False)
    panels[-1, -1].set_xticks(range(len(named)), named)
    panels[-1, -1].set_xlim(-0.5, 1.5)
    for (name, title), axes in zip(_ROWS, panels[:, 0], strict=True):
        axes.set_ylabel(title, fontsize=7)
        if name == "collision":
            axes.set_ylim(bottom=0.0)
    block.align_ylabels(panels[:, 0])
    return panels


def _column(panels: Sequence[Axes], curve: Mapping[float, Any], joined: bool = True) -> None:
    """Draws the rows of panels over one axis; the points are joined, or beside each other."""
    for (name, _), axes in zip(_ROWS, panels, strict=True):
        for i, arm in enumerate(_ARMS):
            _curve(axes, curve, name, arm, "-", 0.0 if joined else 0.24 * (i - 0.5), joined)
            if name == "collision":
                shift = 0.0 if joined else 0.24 * (i - 0.5)
                _curve(axes, curve, "at_fault_collision", arm, "--", shift, joined)


def _curve(
    axes: Axes,
    curve: Mapping[float, Any],
    name: str,
    arm: Arm,
    dashes: str,
    shift: float,
    joined: bool,
) -> None:
    """Draws a figure of an arm, with its interval; that of a part of another has none."""
    scale = find_metric(name).scale
    points = [
        (x + shift, *(scale * (math.nan if own[end] is None else own[end]) for end in ENDS))
        for x, figures in curve.items()
        if (own := figures[arm.value][name]) is not None
    ]
    if not points:
        return
    x, value, low, high = np.transpose(points)
    whole = dashes == "-"
    axes.plot(
        x,
        value,
        color=ARM_COLOURS[arm],
        linestyle=dashes if joined else "none",
        marker=style.ARM_MARKERS[arm],
        markerfacecolor=ARM_COLOURS[arm] if whole else "white",
    )
    if whole and joined:
        axes.fill_between(x, low, high, color=ARM_COLOURS[arm], alpha=0.16, linewidth=0.0)
    elif whole:
        axes.vlines(x, low, high, color=ARM_COLOURS[arm], linewidth=0.8)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: Of the command line; those of the process by default.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    part = commands.add_parser("drive", help="drive the cells, or what is missing of them")
    part.add_argument("--out", type=Path, required=True, help="where the run folders go")
    part.add_argument("--data", type=Path, help="folder with the recordings' train/ and val/")
    part.add_argument("--suite", type=int, default=60, help="scenarios of the suite (60)")
    part.add_argument("--recorded", type=int, default=60, help="recorded scenarios (60)")
    part.add_argument("--traffic", nargs="+", choices=TRAFFICS, default=TRAFFICS)
    part.add_argument("--workers", type=int, default=2)
    part = commands.add_parser("table", help="write loop.json and loop.md")
    part.add_argument("runs", type=Path, help="what drive was given as --out")
    commands.add_parser("draw", help="draw loop.json: loop.png and loop.pdf")
    options = parser.parse_args(arguments)
    try:
        if options.command == "drive":
            counts = {SUITE: options.suite, RECORDED: options.recorded}
            drive(options.out, options.data, counts, options.traffic, options.workers)
        elif options.command == "table":
            content = table(options.runs)
            write_json(HERE / "loop.json", content)
            write_text(HERE / "loop.md", table_markdown(content))
        else:
            shown = HERE / "loop.json"
            with style.styled():
                style.save(draw(read_json(shown)), HERE, "loop", digest(shown))
    except DosplanError as error:
        print(f"loop.py: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nloop.py: stopped; the same command goes on from here", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
