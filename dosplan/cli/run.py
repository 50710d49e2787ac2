"""``dosplan run``: drives and scores scenarios."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import (
    PLUGIN_HELP,
    SOURCE_HELP,
    STDOUT,
    add_json,
    add_seed,
    add_workers,
    chosen_settings,
    console,
    is_source,
    setting_of,
    show,
)
from dosplan.cli.command import FAILED, INTERRUPTED, OK, CommandError

_EXAMPLES: Final = """\
examples:
  dosplan run                                    the suite, both arms, the built-in plug-ins
  dosplan run --planner idm --limit 10           another planner, the first ten scenarios
  dosplan run my/scenarios --planner mine.py:MyPlanner --with-dos
  dosplan run ZAM_Weaving-2_1_T-1 ZAM_Zebra-7_1_T-1    by their ids; of another --source, too
  dosplan run my/scenarios more.zip              several sources
  dosplan run --only roundabout --only highway   by a part of the id, a tag or a kind
  dosplan run --sample 20 --out runs/s           20 by lot; with 50 then, 30 are driven besides
  dosplan run scenarios.zip --solutions          a CommonRoad solution for each drive, too
  dosplan run --set predictor.coverage=0.8 --set predictor.sets=free
  dosplan run --predictor dos --set predictor.base=constant-velocity
  dosplan run --predictor ground-truth --unranked
  dosplan run my/interactive --traffic sumo      SUMO drives the others, who see the ego
  dosplan run --loop realistic                   late, noisy and partly blind, as on a car
  dosplan run --set loop.period=0.5 --set loop.latency=0.3
  dosplan run --quiet --json > figures.json      for scripts
  dosplan run --planner mine.py:MyPlanner --limit 1 --in-process    stops at breakpoint()
"""

Source = str | tuple[str, ...]


class RunCommand:
    """Drives scenarios with a planner and a predictor."""

    summary = "drive and score scenarios with a planner and a predictor"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument(
            "--quiet", action="store_true", help="show no progress, only the final figures"
        )
        _add_what_to_drive(parser)
        _add_how_to_drive(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Drives, and shows the figures of the run.

        Returns:
            0; 1 where an episode is a failure or a scenario unusable; 130 where the run was
            interrupted.

        Raises:
            RunError: The run may not start or cannot go on.
            RegistryError: A plug-in cannot be found or takes no such option.
            ScenarioError: There are no scenarios.
            SelectionError: Nothing is left of the choice among them.
            CommandError: ``--source`` is given, and something that is no id.
            FileError: A file cannot be written.
        """
        from dosplan.report.progress import show_run
        from dosplan.report.tables import error_lines, summary_tables
        from dosplan.results.rows import read_rows
        from dosplan.results.summary import read_summary
        from dosplan.running.config import default_folder
        from dosplan.running.executor import SerialExecutor
        from dosplan.running.run import RunConfig, run
        from dosplan.types import Arm

        source, ids = _what(options.names, options.source)
        config = RunConfig(
            out=options.out or default_folder(),
            source=source,
            ids=ids,
            only=tuple(options.only),
            sample=options.sample,
            planner=options.planner,
            predictor=options.predictor,
            traffic=options.traffic,
            planner_options=chosen_settings(options.settings, "planner"),
            predictor_options=chosen_settings(options.settings, "predictor"),
            traffic_options=chosen_settings(options.settings, "traffic"),
            loop=options.loop,
            loop_options=chosen_settings(options.settings, "loop")
            | ({"real_time": True} if options.real_time else {}),
            futures=options.futures,
            arms=tuple(Arm(arm) for arm in options.arms) if options.arms else tuple(Arm),
            workers=options.workers,
            limit=options.limit,
            seed=options.seed,
            episode_timeout=options.timeout,
            memory_limit=options.memory_limit,
            ranked=not options.unranked,
            cluster=options.cluster,
            cache=not options.no_cache,
            solutions=options.solutions,
        )
        try:
            # A table that is drawn anew would hide the prompt of a debugger.
            with (
                # Of plug-ins in this process. A debugger keeps its terminal, without --json.
                redirect_stdout(sys.stderr) if options.json == STDOUT else nullcontext(),
                show_run(
                    console(stderr=True), live=not options.in_process, quiet=options.quiet
                ) as observer,
            ):
                folder = run(config, observer, SerialExecutor() if options.in_process else None)
        except KeyboardInterrupt:
            hint = f"the same command with --out {shlex.quote(str(config.out))} resumes"
            print(f"dosplan: interrupted; {hint}", file=sys.stderr)
            return INTERRUPTED
        summary = read_summary(folder)
        report = _report(folder.path)
        parts = [summary_tables(summary), f"results in {folder.path}"]
        if report is not None:
            parts.append(f"report in {report}")
        show(parts, summary.content, options.json)
        for line in error_lines(read_rows(folder.rows)):
            print(line, file=sys.stderr)
        failed = any(
            arm["planner_failure_rate"] or arm["usable"] != arm["n"]
            for arm in summary.arms.values()
        )
        return FAILED if failed else OK


def _report(folder: Path) -> Path | None:
    """Writes the report; None where that fails, which does not fail the run."""
    try:
        from dosplan.report.html.write import write_report

        return write_report(folder)
    except Exception as error:  # Whatever it is: the run itself is complete and written.
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        again = f"dosplan report {shlex.quote(str(folder))}"
        print(f"no report ({reason}); to try again: {again}", file=sys.stderr)
        return None


def _add_what_to_drive(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names",
        nargs="*",
        metavar="SOURCE|ID",
        help=f"{SOURCE_HELP}; or ids of scenarios (default: suite, all of it)",
    )
    parser.add_argument(
        "--source", metavar="SOURCE", help="where the ids are looked up (default: the suites)"
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="TEXT|KIND",
        help="drive those with TEXT in their id, or of such a tag or kind, as roundabout or "
        "jaywalker; given again, those to which one of them applies",
    )
    parser.add_argument(
        "--sample",
        type=int,
        metavar="N",
        help="drive N of them, by lot: --seed decides, a larger N adds to a smaller one, and a "
        "source may grow",
    )
    arms = parser.add_mutually_exclusive_group()
    arms.add_argument(
        "--with-dos",
        dest="arms",
        action="store_const",
        const=("with_dos",),
        help="drive only the arm with occupancy sets (default: both arms)",
    )
    arms.add_argument(
        "--without-dos",
        dest="arms",
        action="store_const",
        const=("without_dos",),
        help="drive only the arm without them",
    )
    parser.add_argument("--planner", default="mpc", help=f"{PLUGIN_HELP} (default: %(default)s)")
    parser.add_argument("--predictor", default="dos", help="likewise (default: %(default)s)")
    parser.add_argument(
        "--traffic",
        default="replay",
        help="who else is on the road, likewise (default: %(default)s, as recorded)",
    )
    parser.add_argument(
        "--futures",
        type=int,
        default=1,
        metavar="K",
        help="drive K continuations of each scenario's past, the same for both arms and every "
        "planner; for traffic that has several (default: %(default)s)",
    )
    parser.add_argument(
        "--set",
        dest="settings",
        type=setting_of("planner", "predictor", "traffic", "loop"),
        action="append",
        default=[],
        metavar="PLUGIN.NAME=VALUE",
        help="an option of a plug-in or of the loop, such as predictor.coverage=0.9, "
        "predictor.base=net or loop.period=0.5; VALUE as in YAML; may be given again",
    )


def _add_how_to_drive(parser: argparse.ArgumentParser) -> None:
    add_workers(parser)
    parser.add_argument("--limit", type=int, metavar="N", help="drive the first N of them only")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="run folder (default: runs/<date and time>)"
    )
    parser.add_argument(
        "--solutions",
        action="store_true",
        help="write what was driven as CommonRoad solutions, too: DIR/solutions/*.xml",
    )
    add_seed(parser)
    parser.add_argument(
        "--loop",
        default="ideal",
        metavar="NAME",
        help="how often and how late the ego plans, and what it sees: ideal, or realistic, as on a "
        "car; --set loop.latency=0.3 and the like change it (default: %(default)s)",
    )
    parser.add_argument(
        "--real-time",
        action="store_true",
        help="add the time that prediction and plan take to the loop's latency; such a run cannot "
        "be repeated, and is marked",
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=600.0,
        metavar="S",
        help="seconds after which an episode counts as hung (default: %(default)g)",
    )
    parser.add_argument(
        "--memory-limit",
        type=int,
        default=4000,
        metavar="MB",
        help="resident memory at which a worker process is ended (default: %(default)s)",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="drive on a Dask cluster: tcp://host:port of its scheduler, or local:N processes",
    )
    where.add_argument(
        "--in-process",
        action="store_true",
        help="drive in this process, one episode after another, so that breakpoint() in a plug-in "
        "stops there; --workers, --timeout and --memory-limit have no effect",
    )
    parser.add_argument(
        "--no-cache", action="store_true", help="parse every scenario anew, and keep none"
    )
    parser.add_argument(
        "--unranked",
        action="store_true",
        help="allow a predictor that is shown the future, and mark the results",
    )


def _what(names: Sequence[str], source: str | None) -> tuple[Source, tuple[str, ...]]:
    """The source, or several, and the ids that are wanted of it; none wants all."""
    from dosplan.scenario.sources.catalogue import suites_of

    sources = [name for name in names if is_source(name)]
    if not sources:
        return source or suites_of(names), tuple(names)
    if source is not None:
        raise CommandError(
            f"--source {source} is where ids are looked up, and {sources[0]} is no id: name the "
            "sources alone, or the ids alone and their --source"
        )
    return names[0] if len(names) == 1 else tuple(names), ()
