"""``dosplan report``: the page of a run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import add_moved_source
from dosplan.cli.command import OK, Command


class ReportCommand:
    """Writes the page of a run."""

    summary = "write the page of a run: figures, plots, and a player for every episode"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.add_argument("run_folder", type=Path, metavar="RUN", help="a run folder")
        parser.add_argument(
            "--out", type=Path, metavar="FILE", help="where to write it (default: RUN/report.html)"
        )
        add_moved_source(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Writes the page.

        Raises:
            FileError: It is not the folder of a finished run, or the file cannot be written.
        """
        from dosplan.report.html.write import write_report

        print(f"report in {write_report(options.run_folder, options.out, options.source)}")
        return OK


REPORT: Final[Command] = ReportCommand()
