"""Arguments that several built-in subcommands share, and how figures are shown and written."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

Setting = tuple[str, str, Any]
"""Whose option it is, its name and its value."""
STDOUT: Final = Path("-")
PLUGIN_HELP: Final = "a name of `dosplan list`, module:Class or path/to/file.py:Class"
SOURCE_HELP: Final = (
    "where the scenarios are: suite, suite-1, a CommonRoad file, a folder, a quoted glob, a .zip "
    "or .tar.*, a URL, or @LIST, a text file of such paths and of ids"
)


def add_runs(parser: argparse.ArgumentParser) -> None:
    """Declares the runs that are compared: folders, one arm of them, or sweeps.

    Args:
        parser: The command's parser.
    """
    parser.add_argument(
        "runs",
        nargs="+",
        metavar="RUN",
        help="a run folder, RUN:with_dos or RUN:without_dos for one arm of it, or the folder of a "
        "sweep",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declares ``--json``.

    Args:
        parser: The subcommand's parser.
    """
    parser.add_argument(
        "--json",
        type=_json_path,
        nargs="?",
        const=STDOUT,
        metavar="PATH",
        help="write the same figures there; without PATH, or with -, standard output has them "
        "as one JSON document and nothing else",
    )


def _json_path(text: str) -> Path:
    """A file to be written; a folder, or a file of another kind, was meant for another argument."""
    path = STDOUT if text == "/dev/stdout" else Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{text} is a folder; name a file, or write --json=-")
    if path.is_file() and not _may_be_json(path):
        raise argparse.ArgumentTypeError(
            f"{text} is there and is no JSON; name another file, or write --json=-"
        )
    return path


def _may_be_json(path: Path) -> bool:
    """Whether a file is empty or begins as what ``show`` writes; true if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(1) in (b"", b"{")
    except OSError:
        return True


def is_source(text: str) -> bool:
    """Whether a text names a file, a folder, a URL or the like, there or not; else it is an id.

    Args:
        text: What somebody wrote where a source or the id of a scenario may stand.

    Returns:
        Whether it does.
    """
    from dosplan.scenario.commonroad.document import SUFFIXES
    from dosplan.scenario.sources.archives import ENDINGS
    from dosplan.scenario.sources.fetch import LIST, SUITES

    if text in SUITES or text.startswith(LIST) or "://" in text or Path(text).exists():
        return True
    if ":" in text:  # An id that names its file, as of several files with one id.
        return False
    return any(mark in text for mark in {os.sep, *"/*?["}) or text.lower().endswith(
        (*SUFFIXES, ".pb", *ENDINGS)
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declares ``--workers``.

    Args:
        parser: The subcommand's parser.
    """
    parser.add_argument(
        "--workers",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="worker processes (default: the number of CPUs, here %(default)s)",
    )


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Declares ``--seed``.

    Args:
        parser: The subcommand's parser.
    """
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="default: %(default)s")


def add_loop(parser: argparse.ArgumentParser, what: str) -> None:
    """Declares ``--loop`` and ``--set`` for a command that drives nothing.

    Args:
        parser: The subcommand's parser.
        what: What becomes of the loop.
    """
    parser.add_argument("--loop", metavar="NAME", help=f"{what} (default: ideal)")
    parser.add_argument(
        "--set",
        dest="settings",
        type=setting_of("loop"),
        action="append",
        metavar="loop.NAME=VALUE",
        help="an option of the loop, such as loop.sensing.position=0.3; may be given again",
    )


def setting_of(*owners: str) -> Callable[[str], Setting]:
    """Reads the values of ``--set``.

    Args:
        owners: What has options: ``planner``, ``loop`` ...

    Returns:
        Takes ``OWNER.NAME=VALUE`` apart, for ``argparse``.
    """

    def setting(text: str) -> Setting:
        from dosplan.system.yaml_text import YamlError, parse_yaml

        key, equals, value = text.partition("=")
        owner, _, name = key.partition(".")
        if (
            owner not in owners
            or not equals
            or not all(part.isidentifier() for part in name.split("."))
        ):
            forms = [f"{owner}.NAME=VALUE" for owner in owners]
            raise argparse.ArgumentTypeError(
                f"{text!r:.100} is not of the form {', '.join(forms[:-1])}"
                f"{' or ' if len(forms) > 1 else ''}{forms[-1]}"
            )
        try:
            return owner, name, parse_yaml(value)
        except YamlError as error:
            raise argparse.ArgumentTypeError(f"{key!r}: the value {error}") from None

    return setting


def chosen_settings(settings: Sequence[Setting], owner: str) -> dict[str, Any]:
    """Finds the options of one owner.

    Args:
        settings: What ``--set`` was given.
        owner: The owner.

    Returns:
        Values by name; of two of one name, the last.
    """
    return {name: value for of, name, value in settings if of == owner}


def add_moved_source(parser: argparse.ArgumentParser) -> None:
    """Declares ``--source`` for a command that reads a run folder.

    Args:
        parser: The subcommand's parser.
    """
    parser.add_argument(
        "--source",
        metavar="SOURCE",
        help="where the scenarios lie now (default: where the run found them)",
    )


def show(parts: Sequence[RenderableType], figures: Any, json_path: Path | None) -> None:
    """Prints what a command found, and writes the same figures as JSON where asked to.

    Args:
        parts: Tables and lines for the terminal.
        figures: What they show, as ``json`` can write it.
        json_path: Where to write the figures, or None; ``STDOUT`` prints them in place of the
            parts.

    Raises:
        FileError: Standard output or the file cannot be written.
    """
    from dosplan.system.files import FileError, json_text, write_json

    try:
        if json_path == STDOUT:
            sys.stdout.write(json_text(figures))
        else:
            from dosplan.report.tables import Prose

            out = console()
            for part in parts:
                told = Prose(part) if isinstance(part, str) else part
                out.print(told, highlight=False, markup=False)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        # What could not be written is still buffered, and leaving would try to write it again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise FileError(f"cannot write to standard output: {error.strerror}") from error
    if json_path not in (None, STDOUT):
        write_json(json_path, figures)


def console(stderr: bool = False) -> Console:
    """Opens the terminal, or what stands in its place.

    Args:
        stderr: Whether to write to standard error.

    Returns:
        The console.
    """
    from rich.console import Console

    class Terminal(Console):
        def on_broken_pipe(self) -> None:
            """Leaves it to ``main``; rich itself would end the process as a failure."""
            raise BrokenPipeError

    found = Terminal(stderr=stderr)
    if not found.is_terminal:
        found.width = 200  # A pipe has no width: do not fold what a program may read.
    return found
