"""``dosplan compare``: two runs, scenario by scenario."""

from __future__ import annotations

import argparse
from pathlib import Path

from dosplan.cli.arguments import add_json, show
from dosplan.cli.command import OK


class CompareCommand:
    """Compares two runs, or the arms of one."""

    summary = "compare two runs, or the two arms of one, scenario by scenario"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        add_json(parser)
        parser.add_argument(
            "--html", type=Path, metavar="FILE", help="write a page, with a player, there"
        )
        run = "a run folder, or RUN:with_dos or RUN:without_dos for one arm of it"
        parser.add_argument("run_a", metavar="RUN_A", help=run)
        parser.add_argument(
            "run_b", nargs="?", metavar="RUN_B", help="likewise (default: RUN_A's arms)"
        )

    def run(self, options: argparse.Namespace) -> int:
        """Compares.

        Raises:
            CompareError: The runs cannot be compared.
            FileError: A run cannot be read, or a file cannot be written.
        """
        from dosplan.report.tables import comparison_tables
        from dosplan.results.comparison import compare_runs, world_lines

        specs = [spec for spec in (options.run_a, options.run_b) if spec is not None]
        comparisons = compare_runs(specs)
        figures = {"comparisons": [comparison.content() for comparison in comparisons]}
        parts = [*(comparison_tables(c) for c in comparisons), *world_lines(specs)]
        if options.html is not None:
            from dosplan.report.html.write import write_comparison

            parts.append(f"page in {write_comparison(specs, options.html)}")
        show(parts, figures, options.json)
        return OK
