"""``dosplan table``: any number of runs, side by side."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Final

from dosplan.cli.arguments import STDOUT, add_json, add_runs, show
from dosplan.cli.command import OK, CommandError

if TYPE_CHECKING:
    from rich.console import RenderableType

_EXAMPLES: Final = """\
examples:
  dosplan table runs/a runs/b runs/c                   every arm of three runs
  dosplan table runs/mine                              a sweep's runs
  dosplan table runs/mine --baseline 'sets=union'      each against one of them
  dosplan table runs/a runs/b:with_dos --baseline runs/a:without_dos
  dosplan table runs/mine --columns safe,collision,progress --format latex
  dosplan table runs/mine --format csv > mine.csv
"""
_FORMATS: Final = ("markdown", "csv", "latex", "json")


class TableCommand:
    """Puts runs side by side."""

    summary = "put any number of runs side by side, each against a baseline"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        add_runs(parser)
        parser.add_argument(
            "--baseline",
            metavar="RUN[:ARM]",
            help="compare the others with this one, a folder or the name of a run of a sweep "
            "(default: in each block the first arm without sets, or the first row)",
        )
        parser.add_argument(
            "--columns",
            type=lambda text: tuple(text.split(",")),
            metavar="NAME,NAME",
            help="metrics to show, by their names in docs/metrics.md (default: "
            "success,collision,at_fault_collision,velocity)",
        )
        parser.add_argument(
            "--across-worlds",
            action="store_true",
            help="put runs of another traffic or loop into one block, too",
        )
        parser.add_argument(
            "--format", choices=_FORMATS, help="write it so (default: for the terminal)"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Shows the table.

        Raises:
            CompareError: There is no such metric or baseline, or nothing to show.
            CommandError: The options do not go together.
            FileError: A run cannot be read, or a file cannot be written.
        """
        from dosplan.results.table import COLUMNS, make_table
        from dosplan.results.table_text import FORMATS

        wanted, path = options.format, options.json
        if wanted == "json":
            wanted, path = None, STDOUT if path is None else path
        elif wanted is not None and path == STDOUT:
            raise CommandError(f"--json and --format {wanted} both write to standard output")
        found = make_table(
            options.runs,
            baseline=options.baseline,
            columns=options.columns or COLUMNS,
            across_worlds=options.across_worlds,
        )
        if wanted is not None:
            sys.stdout.write(FORMATS[wanted](found))
            parts: list[RenderableType] = []
        else:
            from dosplan.report.tables import run_tables

            parts = run_tables(found)
        show(parts, found.content(), path)
        return OK
