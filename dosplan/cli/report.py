"""``dosplan report``: the page of a run, or of several."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import add_moved_source, add_runs
from dosplan.cli.command import OK, Command

_EXAMPLES: Final = """\
examples:
  dosplan report runs/mine                             the page that the run ended with, again
  dosplan report runs/a runs/b runs/c --out abc.html   all arms of three runs on one page
  dosplan report runs/a:with_dos runs/b:with_dos       two arms
  dosplan report runs/my-sweep                         a sweep's runs
"""


class ReportCommand:
    """Writes the page of a run, or of several."""

    summary = "write the page of runs: figures, plots, any two arms compared, and a player"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_runs(parser)
        parser.add_argument(
            "--out",
            type=Path,
            metavar="FILE",
            help="where to write it (default: RUN/report.html; of several runs report.html here)",
        )
        add_moved_source(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Writes the page.

        Raises:
            CompareError: A run does not hold an arm, or no run of a sweep is finished.
            FileError: It is not the folder of a finished run, or the file cannot be written.
        """
        from dosplan.report.html.write import write_report, write_runs
        from dosplan.results.comparison import named_arm
        from dosplan.results.sweeps import SweepFolder

        out, source = options.out, options.source
        path, arm = named_arm(options.runs[0])
        is_sweep = SweepFolder(path).record.is_file()
        if len(options.runs) == 1 and arm is None and not is_sweep:
            page = write_report(path, out, source)
        else:
            folder = path if is_sweep and len(options.runs) == 1 else Path()
            page = write_runs(options.runs, folder / "report.html" if out is None else out, source)
        print(f"report in {page}")
        return OK


REPORT: Final[Command] = ReportCommand()
