"""``dosplan score``: scores a run again from its episode files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import add_json, add_moved_source, console, show
from dosplan.cli.command import FAILED, OK

_EXAMPLES: Final = """\
examples:
  dosplan score runs/mine                        which rows differ under today's scoring?
  dosplan score runs/mine --write                put the new rows and figures in their place
"""


class ScoreCommand:
    """Scores a run again."""

    summary = "score a run again from its episode files, without driving"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument("run_folder", type=Path, metavar="RUN", help="the folder of a run")
        parser.add_argument(
            "--write",
            action="store_true",
            help="write the rows and the summary in place of those of the run",
        )
        add_moved_source(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Scores, and shows which rows differ.

        Returns:
            0 where every row is as it was, or was written; 1 where one differs.

        Raises:
            FileError: It is not the folder of a finished run, a file of it or a scenario cannot be
                read, or a file cannot be written.
        """
        from dosplan.report.progress import show_progress
        from dosplan.results.rescore import change_lines, rescore

        with show_progress(console(stderr=True), "episodes") as progress:
            found = rescore(options.run_folder, options.source, progress)
        if options.write:
            found.write()
        changed = len(found.changes)
        figures = {
            "rows": len(found.rows),
            "agree": len(found.rows) - changed,
            "not_driven": found.kept,
            "differ": [
                {
                    **change.key._asdict(),
                    "columns": {
                        name: {"before": before, "now": now}
                        for name, (before, now) in change.columns.items()
                    },
                }
                for change in found.changes
            ],
            "written": options.write,
        }
        lines = change_lines(found.changes)
        agreement = f"{figures['agree']} of {len(found.rows)} rows agree"
        if found.kept:
            agreement += f"; {found.kept} of them were never driven and are kept"
        lines.append(agreement)
        if options.write:
            lines.append(f"rows and summary written in {options.run_folder}")
        show(lines, figures, options.json)
        return FAILED if changed and not options.write else OK
