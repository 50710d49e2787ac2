"""What a subcommand of ``dosplan`` is, and those that other packages add.

A package offers one as an entry point of the group ``dosplan.commands``; the entry point's name is
the subcommand's. Its module is imported for every ``dosplan`` call, so heavy imports belong into
``run``.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Collection
from importlib.metadata import EntryPoint, entry_points
from typing import Final, Protocol

from dosplan.system.errors import DosplanError

GROUP: Final = "dosplan.commands"

OK: Final = 0
FAILED: Final = 1
BAD_INPUT: Final = 2
INTERRUPTED: Final = 130


class CommandError(DosplanError):
    """Wrong usage or bad input of a subcommand; the message is one line."""


class Command(Protocol):
    """A subcommand.

    Attributes:
        summary: What it does, in a line that begins in lower case.
    """

    summary: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares its arguments; called more than once.

        It may also set ``parser.description``, and ``parser.epilog`` to examples; the exit codes
        follow those.

        Args:
            parser: The subcommand's parser.
        """

    def run(self, options: argparse.Namespace) -> int:
        """Runs the subcommand.

        Args:
            options: The arguments.

        Returns:
            The exit code: ``OK``, ``FAILED`` where something could not be done, ``INTERRUPTED``.

        Raises:
            CommandError: The arguments or what they name cannot be used.
        """


def offered_commands(
    taken: Collection[str] = (), complain: Callable[[str], None] = lambda line: None
) -> dict[str, Command]:
    """Finds the subcommands of installed packages; one that cannot be used is left out.

    Args:
        taken: Names that a package may not use: those of the built-in subcommands.
        complain: Called with a line on each that is left out.

    Returns:
        The commands by name, sorted.
    """
    offers: defaultdict[str, list[EntryPoint]] = defaultdict(list)
    for entry in entry_points(group=GROUP):
        offers[entry.name].append(entry)
    commands = {}
    for name, entries in sorted(offers.items()):
        left_out = f"command {name!r} ({', '.join(map(_giver, entries))}) is left out"
        if name in taken:
            complain(f"{left_out}: a built-in command has that name")
        elif len(entries) > 1:
            complain(f"{left_out}: offered {len(entries)} times; uninstall all but one")
        else:
            try:
                commands[name] = _load(entries[0])
            except (Exception, SystemExit) as error:  # A plug-in may raise anything.
                reason = " ".join(f"{type(error).__name__}: {error}".split())
                complain(f"{left_out}: {reason}")
    return commands


def _giver(entry: EntryPoint) -> str:
    distribution = entry.dist.name if entry.dist is not None else "unknown"
    return f"{entry.value} from {distribution}"


def _load(entry: EntryPoint) -> Command:
    """Imports a command and tries it, so that later nothing of it fails for other commands."""
    command: Command = entry.load()
    if not isinstance(command.summary, str) or not command.summary:
        raise TypeError("its summary must be a line of text")
    command.add_arguments(argparse.ArgumentParser())
    return command
