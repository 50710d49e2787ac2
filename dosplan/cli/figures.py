"""``dosplan figures``: the paper's figures."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

from dosplan.cli.command import FAILED, OK, Command
from dosplan.report.figures import FIGURES

_EXAMPLES: Final = """\
examples:
  dosplan figures --out paper/figures
  dosplan figures trade-off planning --out paper/figures
"""


class FiguresCommand:
    """Writes the paper's figures."""

    summary = "write the paper's figures from the published results, as PNG and PDF"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        listed = "\n".join(f"  {name:<18} {shows}" for name, shows in FIGURES.items())
        parser.epilog = f"figures:\n{listed}\n\n{_EXAMPLES}"
        parser.add_argument(
            "names",
            nargs="*",
            type=_name,
            metavar="NAME",
            help="a figure (default: all of them)",
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
            RegistryError: The shipped predictor cannot be built.
            ScenarioError: The embedded suite cannot be read.
        """
        from dosplan.report.figures.sources import Published, default_results
        from dosplan.report.figures.write import write_figure
        from dosplan.system.files import FileError

        published = Published(options.results or default_results())
        code = OK
        for name in dict.fromkeys(options.names or FIGURES):
            try:
                png, pdf = write_figure(name, published, options.out)
            except FileError as error:
                print(f"dosplan: error: {name}: {' '.join(str(error).split())}", file=sys.stderr)
                code = FAILED
            else:
                print(f"{png} and {pdf.name}")
        return code


def _name(text: str) -> str:
    if text not in FIGURES:
        raise argparse.ArgumentTypeError(
            f"there is no figure {text!r}; choose from {', '.join(FIGURES)}"
        )
    return text


FIGURES_COMMAND: Final[Command] = FiguresCommand()
