"""``dosplan submit`` and ``dosplan leaderboard``: a run becomes a row, and rows become a page."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

from dosplan.cli.arguments import add_json, add_moved_source, console, show
from dosplan.cli.command import BAD_INPUT, FAILED, OK
from dosplan.results.published import LEADERBOARD

_SUBMIT: Final = """\
examples:
  dosplan run suite --planner mine.py:Coast --futures 2 --out runs/mine
  dosplan submit runs/mine --name Coast --authors 'Ada L.' --url https://example.org/coast
  dosplan submit runs/mine --check                  what speaks against it? Nothing is written
  dosplan submit runs/recorded --source commonroad/bench
"""
_LEADERBOARD: Final = """\
examples:
  dosplan leaderboard                               in a checkout: docs/leaderboard.md
  dosplan leaderboard --rows rows --out page.md
  dosplan leaderboard --check                       is the page that of the rows?
"""
_PAGE: Final = Path("docs/leaderboard.md")


class SubmitCommand:
    """Checks a run, and writes its row of the leaderboard."""

    summary = "check a run, score it again, and write its row of the leaderboard"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _SUBMIT
        add_json(parser)
        parser.add_argument("run_folder", type=Path, metavar="RUN", help="the folder of a run")
        parser.add_argument(
            "--out",
            type=Path,
            default=LEADERBOARD,
            metavar="DIR",
            help="folder of the rows (default: %(default)s)",
        )
        parser.add_argument(
            "--name", default="", help="what it is called (default: planner and predictor)"
        )
        parser.add_argument("--authors", default="", metavar="NAMES", help="whose it is")
        parser.add_argument("--url", default="", help="page about it, or its code")
        parser.add_argument("--check", action="store_true", help="check the run and write nothing")
        add_moved_source(parser)

    def run(self, options: argparse.Namespace) -> int:
        """Checks the run and writes its row.

        Returns:
            2 where the leaderboard does not take the run; a line on stderr for each reason.

        Raises:
            FileError: The row cannot be written.
            ScenarioError: A suite of dosplan is not there.
        """
        from dosplan.report.progress import show_progress
        from dosplan.results.leaderboard import About, SubmissionError, write_submission
        from dosplan.running.submission import make_submission
        from dosplan.system.typed import plain

        try:
            about = About(name=options.name, authors=options.authors, url=options.url)
            with show_progress(console(stderr=True), "episodes") as progress:
                found = make_submission(options.run_folder, about, options.source, progress)
            path = None if options.check else write_submission(options.out, found)
        except SubmissionError as error:
            for reason in error.reasons:
                line = " ".join(reason.split())
                print(f"dosplan: error: {options.run_folder}: {line}", file=sys.stderr)
            return BAD_INPUT
        lines = [f"{found.title} on {found.scenario_set}, {found.world.title}: taken"]
        if path is not None:
            lines.append(f"{path} is its row; dosplan leaderboard puts it on the page")
        show(lines, {"row": None if path is None else str(path), **plain(found)}, options.json)
        return OK


class LeaderboardCommand:
    """Writes the page of the leaderboard."""

    summary = "write the page of the leaderboard from the files of its rows"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _LEADERBOARD
        parser.add_argument(
            "--rows",
            type=Path,
            default=LEADERBOARD,
            metavar="DIR",
            help="folder of the rows (default: %(default)s)",
        )
        parser.add_argument(
            "--out",
            type=Path,
            default=_PAGE,
            metavar="FILE",
            help="the page (default: %(default)s)",
        )
        parser.add_argument(
            "--check", action="store_true", help="write nothing; 1 where the page is another"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Writes the page.

        Returns:
            With ``--check`` 1 where the page is not that of the rows.

        Raises:
            FileError: A row cannot be read, or the page cannot be written.
        """
        from dosplan.results.leaderboard import read_submissions
        from dosplan.results.leaderboard_page import leaderboard_page
        from dosplan.system.files import FileError, write_text

        if not options.rows.is_dir():
            raise FileError(f"{options.rows} is no folder; name that of the rows with --rows")
        rows = read_submissions(options.rows)
        if not rows:
            raise FileError(f"{options.rows} holds no rows; name their folder with --rows")
        page = leaderboard_page(rows)
        if not options.check:
            write_text(options.out, page)
            print(f"{options.out}: {len(rows)} runs")
            return OK
        same = options.out.is_file() and options.out.read_text(encoding="utf-8") == page
        print(f"{options.out} is {'' if same else 'not '}that of the rows in {options.rows}")
        return OK if same else FAILED
