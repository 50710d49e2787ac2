"""The command line: arguments in, a frozen config or a plain value out, one call.

Nothing heavy is imported before a command runs, so that ``dosplan --help`` is immediate.
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

from dosplan import __version__

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130

_EXIT_CODES: Final = """\
exit codes:
  0    everything was done: every episode is scored, every check passed
  1    some episodes are planner failures, or a check failed
  2    wrong usage or bad input; one line on stderr says what and where
  130  interrupted (Ctrl-C or SIGTERM); for a run, the same command with the same --out resumes
"""

_RUN_EXAMPLES: Final = """\
examples:
  dosplan run                                    the suite, both arms, the built-in planner
  dosplan run --planner idm --limit 10           another planner, the first ten scenarios
  dosplan run my/scenarios --planner mine.py:MyPlanner --with-dos
  dosplan run --predictor ground-truth --unranked

"""


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: The arguments after the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = _parser().parse_args(given)
    try:
        with _terminated_as_interrupted():
            code: int = options.command(options)
    except KeyboardInterrupt:
        print("dosplan: interrupted", file=sys.stderr)
        return INTERRUPTED
    except _user_errors() as error:  # Looked up, and imported, only when something is raised.
        print(f"dosplan: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    return code


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Stops in the same orderly way on SIGTERM as on Ctrl-C, workers included."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _user_errors() -> tuple[type[Exception], ...]:
    from dosplan.compare import CompareError
    from dosplan.files import FileError
    from dosplan.registry import RegistryError
    from dosplan.runner import RunError
    from dosplan.scenario import ScenarioError

    # Plug-ins never raise as far as here, so that an OSError is about a path that was given.
    return CompareError, FileError, OSError, RegistryError, RunError, ScenarioError


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="dosplan",
        description="Benchmark motion planners under prediction uncertainty.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"dosplan {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_run(commands)
    _add_list(commands)
    _add_check(commands)
    _add_compare(commands)
    return parser


def _add_command(commands: Any, name: str, function: Any, summary: str, epilog: str = "") -> Any:
    parser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog=epilog + _EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(command=function)
    parser.add_argument("--json", type=Path, metavar="PATH", help="write the same figures there")
    return parser


def _add_run(commands: Any) -> None:
    summary = "drive and score scenarios with a planner and a predictor"
    parser = _add_command(commands, "run", _run, summary, _RUN_EXAMPLES)
    parser.add_argument(
        "source",
        nargs="?",
        default="suite",
        metavar="SUITE_OR_FOLDER",
        help="'suite' (default), or a CommonRoad file or folder",
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
    spec = "a name of `dosplan list`, module:Class or path/to/file.py:Class"
    parser.add_argument("--planner", default="mpc", help=f"{spec} (default: %(default)s)")
    parser.add_argument(
        "--predictor", default="growing-circle", help="likewise (default: %(default)s)"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="worker processes (default: the number of CPUs, here %(default)s)",
    )
    parser.add_argument("--limit", type=int, metavar="N", help="drive the first N scenarios only")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="run folder (default: runs/<date and time>)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: %(default)s")
    parser.add_argument(
        "--replan-every",
        type=int,
        default=1,
        metavar="N",
        help="steps driven from each plan (default: %(default)s)",
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=600.0,
        metavar="S",
        help="seconds after which an episode counts as hung (default: %(default)g)",
    )
    parser.add_argument(
        "--unranked",
        action="store_true",
        help="allow a predictor that is shown the future, and mark the results",
    )


def _add_list(commands: Any) -> None:
    parser = _add_command(commands, "list", _list, "list plug-ins or scenarios")
    parser.add_argument(
        "what",
        nargs="?",
        choices=("planners", "predictors", "scenarios"),
        help="what to list (default: planners and predictors)",
    )
    parser.add_argument(
        "source",
        nargs="?",
        default="suite",
        metavar="SOURCE",
        help="for scenarios: 'suite' (default), or a file or folder",
    )


def _add_check(commands: Any) -> None:
    summary = "check that a planner or predictor keeps the contract"
    parser = _add_command(commands, "check", _check, summary)
    parser.add_argument(
        "name",
        metavar="NAME",
        help="a name of `dosplan list`, module:Class or path/to/file.py:Class",
    )


def _add_compare(commands: Any) -> None:
    summary = "compare two runs, or the two arms of one, scenario by scenario"
    parser = _add_command(commands, "compare", _compare, summary)
    run = "a run folder, or RUN:with_dos or RUN:without_dos for one arm of it"
    parser.add_argument("run_a", metavar="RUN_A", help=run)
    parser.add_argument(
        "run_b", nargs="?", metavar="RUN_B", help="likewise (default: RUN_A's arms)"
    )


def _run(options: argparse.Namespace) -> int:
    from dosplan.files import read_json
    from dosplan.report.progress import show_progress
    from dosplan.report.tables import error_lines, summary_tables
    from dosplan.results import read_rows
    from dosplan.runner import RunConfig, run
    from dosplan.types import Arm

    config = RunConfig(
        out=options.out or Path("runs") / f"{datetime.now():%Y-%m-%d-%H%M%S}",
        source=options.source,
        planner=options.planner,
        predictor=options.predictor,
        arms=tuple(Arm(arm) for arm in options.arms) if options.arms else tuple(Arm),
        workers=options.workers,
        limit=options.limit,
        seed=options.seed,
        replan_every=options.replan_every,
        episode_timeout=options.timeout,
        ranked=not options.unranked,
    )
    try:
        with show_progress(_console(stderr=True)) as progress:
            folder = run(config, progress)
    except KeyboardInterrupt:
        hint = f"the same command with --out {shlex.quote(str(config.out))} resumes"
        print(f"dosplan: interrupted; {hint}", file=sys.stderr)
        return INTERRUPTED
    summary = read_json(folder.summary)
    _show([summary_tables(summary), f"results in {folder.path}"], summary, options.json)
    for line in error_lines(read_rows(folder.rows)):
        print(line, file=sys.stderr)
    failures = any(summary[arm.value]["planner_failure_rate"] > 0 for arm in config.arms)
    return FAILED if failures else OK


def _list(options: argparse.Namespace) -> int:
    if options.what == "scenarios":
        return _list_scenarios(options)
    from dataclasses import asdict

    from dosplan.registry import PluginKind, list_plugins
    from dosplan.report.tables import table

    kinds = [kind for kind in PluginKind if options.what in (None, f"{kind.word}s")]
    plugins = {f"{kind.word}s": list_plugins(kind) for kind in kinds}
    tables = [
        table(
            [title, "target", "from"],
            [[p.name, p.target, p.distribution] for p in found],
            numbers=False,
        )
        for title, found in plugins.items()
    ]
    figures = {title: [asdict(plugin) for plugin in found] for title, found in plugins.items()}
    _show(tables, figures, options.json)
    return OK


def _list_scenarios(options: argparse.Namespace) -> int:
    from dosplan.report.tables import table
    from dosplan.scenario import find_scenarios

    refs = find_scenarios(options.source)
    tables: list[RenderableType] = [
        table(["scenario", "file"], [[ref.id, ref.path.name] for ref in refs], numbers=False),
        f"{len(refs)} scenarios",
    ]
    figures = {"scenarios": [{"id": ref.id, "file": ref.path.name} for ref in refs]}
    _show(tables, figures, options.json)
    return OK


def _check(options: argparse.Namespace) -> int:
    from dosplan.conformance import check_planner, check_predictor
    from dosplan.registry import (
        PluginKind,
        RegistryError,
        find_planner,
        find_predictor,
        list_plugins,
    )
    from dosplan.report.tables import table

    spec = options.name
    named = [k for k in PluginKind if spec in {plugin.name for plugin in list_plugins(k)}]
    complaints = []
    for kind in named or PluginKind:
        try:
            if kind is PluginKind.PLANNER:
                report = check_planner(find_planner(spec))
            else:
                report = check_predictor(find_predictor(spec))
            break
        except RegistryError as error:
            complaints.append(str(error))
    else:
        raise RegistryError("; ".join(complaints))

    rows = [[check.name, "ok" if check.ok else "FAILED", check.message] for check in report.checks]
    figures = {
        "plugin": report.plugin,
        "ok": report.ok,
        "checks": [{"name": c.name, "ok": c.ok, "message": c.message} for c in report.checks],
    }
    verdict = "keeps the contract" if report.ok else "breaks the contract"
    checks = table(["check", "result", ""], rows, numbers=False)
    _show([checks, f"{report.plugin} {verdict}"], figures, options.json)
    return OK if report.ok else FAILED


def _compare(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from dosplan.compare import compare_runs
    from dosplan.report.tables import comparison_tables

    specs = [spec for spec in (options.run_a, options.run_b) if spec is not None]
    comparisons = compare_runs(specs)
    figures = {"comparisons": [asdict(comparison) for comparison in comparisons]}
    _show([comparison_tables(c) for c in comparisons], figures, options.json)
    return OK


def _show(parts: Sequence[RenderableType], figures: Any, json_path: Path | None) -> None:
    """Prints what a command found, and writes the same figures as JSON where asked to."""
    console = _console()
    try:
        for part in parts:
            console.print(part, highlight=False, markup=False)
        sys.stdout.flush()
    except OSError as error:
        from dosplan.files import FileError

        # What could not be written is still buffered, and leaving would try to write it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise FileError(f"cannot write to standard output: {error.strerror}") from error
    if json_path is not None:
        from dosplan.files import write_json

        write_json(json_path, figures)


def _console(stderr: bool = False) -> Console:
    from rich.console import Console

    console = Console(stderr=stderr)
    if not console.is_terminal:
        console.width = 200  # A pipe has no width: do not fold what a program may read.
    return console
