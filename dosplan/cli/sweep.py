"""``dosplan sweep``: many runs out of one file."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Sequence
from datetime import timedelta
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from dosplan.cli.arguments import add_json, add_workers, console, show
from dosplan.cli.command import FAILED, INTERRUPTED, OK, CommandError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from dosplan.results.sweeps import SweepRun
    from dosplan.running.sweep import SweepPart

_EXAMPLES: Final = """\
examples:
  dosplan sweep mine.yaml --dry-run              what would be driven, and about how long
  dosplan sweep mine.yaml --limit 2              two scenarios of each run, as a trial
  dosplan sweep mine.yaml                        and then all: it goes on where it was stopped
  dosplan sweep mine.yaml --runs 'sets=union*'   a part of the runs
  dosplan sweep mine.yaml --cluster local:8
  dosplan table runs/mine --baseline RUN         its runs, compared

a file:
  base: {source: suite, loop.latency: 0.3}
  axes:
    planner: [mpc, idm]
    sets:
      union: {predictor.sets: union}
      circles: {predictor: growing-circle, predictor.base: net}
"""
_GUESS: Final = 3.0
"""Seconds of planning in an episode, where none was driven that would tell: about that of mpc."""
_SELECTION: Final = ("source", "limit", "sample", "futures")


class SweepCommand:
    """Drives every combination that a file names."""

    summary = "drive every combination of planners, predictors, options and loops of a file"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument("file", type=Path, metavar="FILE.yaml", help="what to drive")
        parser.add_argument(
            "--out",
            type=Path,
            metavar="DIR",
            help="folder of the sweep, which has a run folder for each run (default: runs/FILE)",
        )
        parser.add_argument(
            "--dry-run", action="store_true", help="list what would be driven, and drive nothing"
        )
        parser.add_argument(
            "--runs",
            action="append",
            metavar="PATTERN",
            help="drive those runs only whose names fit, as 'sets=union*'; may be given again",
        )
        parser.add_argument("--source", metavar="SOURCE", help="in place of that of the base")
        for name, metavar, what in (
            ("limit", "N", "drive the first N scenarios only"),
            ("sample", "N", "drive N scenarios by lot"),
            ("futures", "K", "drive K futures of each"),
        ):
            parser.add_argument(
                f"--{name}", type=int, metavar=metavar, help=f"{what}, in place of the base's"
            )
        add_workers(parser)
        parser.add_argument(
            "--cluster", metavar="ADDRESS", help="drive on a Dask cluster, as `dosplan run` does"
        )
        parser.add_argument(
            "--no-cache", action="store_true", help="parse every scenario anew for each run"
        )
        parser.add_argument(
            "--quiet", action="store_true", help="show no progress, only the final figures"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Drives what is missing, and shows the figures of all runs.

        Returns:
            0; 1 where an episode of a run is a failure or a scenario unusable; 130 where the sweep
            was interrupted.

        Raises:
            SweepError: The file is not that of a sweep, a run of it may not start, or the folder
                holds another one.
            RunError: A run cannot go on.
            RegistryError: A plug-in cannot be found.
            CommandError: No run fits ``--runs``.
            FileError: A file cannot be written.
        """
        from dosplan.results.sweeps import SweepFolder
        from dosplan.running.sweep import check_sweep, describe_sweep, open_sweep, read_sweep

        changes = {n: v for n in _SELECTION if (v := getattr(options, n)) is not None}
        runs = read_sweep(options.file, changes)
        folder = SweepFolder(options.out or Path("runs") / options.file.stem)
        check_sweep(folder, runs)
        chosen = _chosen(runs, options.runs)
        parts = describe_sweep(
            folder,
            chosen,
            workers=options.workers,
            cluster=options.cluster,
            cache=not options.no_cache,
        )
        if options.dry_run:
            _show_plan(parts, options)
            return OK
        open_sweep(folder, runs)
        try:
            _drive(parts, options)
        except KeyboardInterrupt:
            hint = f"the same command with --out {shlex.quote(str(folder.path))} resumes"
            print(f"dosplan: interrupted; {hint}", file=sys.stderr)
            return INTERRUPTED
        return _show_results(parts, folder.path, options)


def _chosen(runs: Sequence[SweepRun], patterns: Sequence[str] | None) -> list[SweepRun]:
    """The runs whose names fit one of the patterns; all, where there is none."""
    if not patterns:
        return list(runs)
    chosen = [run for run in runs if any(fnmatch(run.name, pattern) for pattern in patterns)]
    if not chosen:
        raise CommandError(f"no run fits --runs {' '.join(patterns)}; the first is {runs[0].name}")
    return chosen


def _drive(parts: Sequence[SweepPart], options: argparse.Namespace) -> None:
    """Drives what is missing, run by run."""
    from dosplan.report.progress import show_run
    from dosplan.results.markdown import folded
    from dosplan.running.run import run
    from dosplan.running.sweep import one_executor

    err = console(stderr=True)
    left, driven, began = sum(part.left for part in parts), 0, time.monotonic()
    with one_executor(options.workers, options.cluster) as executor:
        for number, part in enumerate(parts, start=1):
            if not options.quiet:
                line = f"run {number} of {len(parts)}: {part.run.name}"
                if driven and left > driven:
                    seconds = (left - driven) / driven * (time.monotonic() - began)
                    line += f" ({left - driven} episodes left of the sweep, about "
                    line += f"{timedelta(seconds=round(seconds))})"
                err.print(folded(line, indent="  "), highlight=False, soft_wrap=True, markup=False)
            with show_run(err, quiet=options.quiet) as observer:
                run(part.config, observer, executor)
            driven += part.left


def _show_plan(parts: Sequence[SweepPart], options: argparse.Namespace) -> None:
    """Shows what would be driven."""
    from dosplan.report.tables import table

    rows = [
        [
            part.run.name,
            " + ".join(part.config.arms),
            str(len(part.manifest.scenarios)),
            str(part.config.futures),
            str(part.left),
        ]
        for part in parts
    ]
    left = sum(part.left for part in parts)
    seconds, basis = _estimate(parts)
    told: dict[str, Any] = {
        "runs": [
            {
                "name": part.run.name,
                "values": part.run.values,
                "arms": part.config.arms,
                "scenarios": len(part.manifest.scenarios),
                "futures": part.config.futures,
                "episodes": len(part.manifest.episodes),
                "left": part.left,
            }
            for part in parts
        ],
        "episodes_left": left,
        "planning_s": seconds,
    }
    lines: list[RenderableType] = [
        table(["run", "arms", "scenarios", "futures", "episodes left"], rows),
        f"{len(parts)} runs, {left} episodes left to drive",
    ]
    if left:
        workers = "" if options.cluster else f" on {options.workers} workers"
        here = seconds if options.cluster else seconds / options.workers
        about = timedelta(seconds=round(here))
        lines += [f"about {about} of planning{workers}, {basis}"]
    show(lines, told, options.json)


def _estimate(parts: Sequence[SweepPart]) -> tuple[float, str]:
    """Seconds of planning that are left, and what they are reckoned from."""
    driven = [seconds for part in parts for seconds in part.seconds]
    if not driven:
        return _GUESS * sum(part.left for part in parts), (
            f"if an episode takes {_GUESS:g} s: drive some with --limit 2 to know"
        )
    mean = sum(driven) / len(driven)
    total = sum(
        part.left * (sum(own) / len(own) if (own := part.seconds) else mean) for part in parts
    )
    return total, f"as in the {len(driven)} episodes that were driven"


def _show_results(parts: Sequence[SweepPart], folder: Path, options: argparse.Namespace) -> int:
    """Shows the figures of the sweep so far, and what failed in the runs that were asked for."""
    from dosplan.report.tables import error_lines, run_tables
    from dosplan.results.folder import RunFolder
    from dosplan.results.rows import read_rows
    from dosplan.results.table import make_table
    from dosplan.types import Outcome

    found = make_table([str(folder)])
    show([*run_tables(found), f"results in {folder}"], found.content(), options.json)
    failures = {Outcome.PLANNER_FAILURE, Outcome.TRAFFIC_FAILURE, Outcome.UNUSABLE}
    failed = False
    for part in parts:
        rows = read_rows(RunFolder(part.config.out).rows)
        failed = failed or any(row.outcome in failures for row in rows)
        for line in error_lines(rows):
            print(f"{part.run.name}: {line}", file=sys.stderr)
    return FAILED if failed else OK
