"""The command line: finds the subcommand and turns what it raises into a line and an exit code.

Nothing heavy is imported before a command runs, so that ``dosplan --help`` is immediate.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, NoReturn

from dosplan import __version__
from dosplan.cli.bench import BenchCommand
from dosplan.cli.check import CheckCommand
from dosplan.cli.command import BAD_INPUT, FAILED, INTERRUPTED, OK, Command, offered_commands
from dosplan.cli.compare import CompareCommand
from dosplan.cli.evaluate import EvaluateCommand
from dosplan.cli.listing import ListCommand
from dosplan.cli.run import RunCommand
from dosplan.cli.score import ScoreCommand
from dosplan.cli.submit import LeaderboardCommand, SubmitCommand
from dosplan.cli.sweep import SweepCommand
from dosplan.cli.table import TableCommand
from dosplan.system.errors import DosplanError

__all__ = ["BAD_INPUT", "FAILED", "INTERRUPTED", "OK", "main", "make_parser"]

_BUILT_IN: Final[Mapping[str, Command]] = {
    "run": RunCommand(),
    "sweep": SweepCommand(),
    "list": ListCommand(),
    "check": CheckCommand(),
    "compare": CompareCommand(),
    "table": TableCommand(),
    "score": ScoreCommand(),
    "submit": SubmitCommand(),
    "leaderboard": LeaderboardCommand(),
    "evaluate": EvaluateCommand(),
    "bench": BenchCommand(),
}

EXIT_CODES: Final = """\
exit codes:
  0    everything was done: every episode is scored, every file evaluated, every check passed
  1    some episodes are failures, some files are unusable or could not be evaluated, or a
       check failed
  2    wrong usage or bad input; one line on stderr says what and where
  130  interrupted (Ctrl-C or SIGTERM); for a run, the same command with the same --out resumes
"""


class _Parser(argparse.ArgumentParser):
    """A parser whose error message is one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: The arguments after the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    _open_closed_streams()
    _escape_what_cannot_be_shown()
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = make_parser().parse_args(given)
    try:
        with _terminated_as_interrupted():
            code: int = options.command(options)
    except KeyboardInterrupt:
        print("dosplan: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # Whoever reads has what it wanted; everything else was done.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except (DosplanError, OSError) as error:  # Plug-ins never raise as far as here.
        print(f"dosplan: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    return code


def _open_closed_streams() -> None:
    """Opens what the caller has closed: else the next file to be opened would be taken for it."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # It gets the lowest number that is free, which is this one, and workers have it, too.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def _escape_what_cannot_be_shown() -> None:
    """Writes stdout as stderr is written: a terminal that knows no m² is no reason to stop."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Stops in the same orderly way on SIGTERM as on Ctrl-C, workers included."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def make_parser() -> argparse.ArgumentParser:
    """Makes the parser of the whole command line, commands of packages included.

    Returns:
        The parser; `command` of what it parses runs the subcommand.
    """
    parser = _Parser(
        prog="dosplan",
        description="Benchmark motion planners under prediction uncertainty.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"dosplan {__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, command in {**_BUILT_IN, **offered_commands(_BUILT_IN, _warn)}.items():
        _add_command(subparsers, name, command)
    return parser


def _add_command(subparsers: Any, name: str, command: Command) -> None:
    summary = command.summary
    parser = subparsers.add_parser(
        name,
        help=summary.replace("%", "%%"),  # argparse fills its own figures in.
        description=summary[0].upper() + summary[1:] + ".",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_arguments(parser)
    parser.epilog = "\n".join(part for part in (parser.epilog, EXIT_CODES) if part)
    parser.set_defaults(command=command.run)


def _warn(line: str) -> None:
    print(f"dosplan: warning: {line}", file=sys.stderr)
