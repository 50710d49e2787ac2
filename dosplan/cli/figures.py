"""``dosplan figures``: the paper's figures."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

from dosplan.cli.command import FAILED, OK, Command
from dosplan.report.figures import FIGURES, FRONTIER

_EXAMPLES: Final = """\
examples:
  dosplan figures --out paper/figures
  dosplan figures trade-off planning --out paper/figures
  dosplan figures frontier runs/frontier --out paper/figures
"""
_FRONTIER: Final = "of the RUNs after it: collisions over velocity and success, by coverage"


class FiguresCommand:
    """Writes the paper's figures."""

    summary = "write the paper's figures from published results or from runs, as PNG and PDF"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        every = {**FIGURES, FRONTIER: _FRONTIER}
        listed = "\n".join(f"  {name:<18} {shows}" for name, shows in every.items())
        parser.epilog = f"figures:\n{listed}\n\n{_EXAMPLES}"
        parser.add_argument(
            "names",
            nargs="*",
            action=_Names,
            metavar="NAME",
            help="a figure (default: all of them that need no RUN); after frontier, run folders "
            "and folders of sweeps",
        )
        parser.add_argument(
            "--out", type=Path, required=True, metavar="DIR", help="folder to write them to"
        )
        parser.add_argument(
            "--results",
            type=Path,
            metavar="DIR",
            help="folder of results, laid out as the published ones (default: these)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Draws; where data of one figure is missing, the others are still drawn.

        Returns:
            0; 1 where a figure could not be drawn, which stderr has a line on.

        Raises:
            CompareError: Runs are not of one world and the same scenarios.
            FileError: A run cannot be read.
            RegistryError: The shipped predictor cannot be built.
            ScenarioError: The embedded suite cannot be read.
        """
        from dosplan.report.figures.sources import Published
        from dosplan.report.figures.write import write_figure, write_frontier
        from dosplan.results.published import default_results
        from dosplan.system.files import FileError

        if options.runs:
            png, pdf, cautions = write_frontier(options.runs, options.out)
            print(f"{png} and {pdf.name}")
            for line in cautions:
                print(f"dosplan: {FRONTIER}: {line}", file=sys.stderr)
        published = Published(options.results or default_results())
        code = OK
        for name in dict.fromkeys(options.names or ([] if options.runs else FIGURES)):
            try:
                png, pdf = write_figure(name, published, options.out)
            except FileError as error:
                print(f"dosplan: error: {name}: {' '.join(str(error).split())}", file=sys.stderr)
                code = FAILED
            else:
                print(f"{png} and {pdf.name}")
        return code


class _Names(argparse.Action):
    """Takes apart the figures of published results, and the runs whose frontier is wanted."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        first = values.index(FRONTIER) if FRONTIER in values else len(values)
        figures, runs = values[:first], values[first + 1 :]
        if odd := [name for name in figures if name not in FIGURES]:
            raise argparse.ArgumentError(
                self,
                f"there is no figure {odd[0]!r}; choose from {', '.join([*FIGURES, FRONTIER])}",
            )
        if first < len(values) and not runs:
            raise argparse.ArgumentError(
                self, f"{FRONTIER} is of runs: name their folders after it"
            )
        namespace.names, namespace.runs = figures, runs


FIGURES_COMMAND: Final[Command] = FiguresCommand()
