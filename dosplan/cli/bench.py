"""``dosplan bench``: time and memory of batches on this machine."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from dosplan.cli.arguments import add_json, show
from dosplan.cli.command import OK

if TYPE_CHECKING:
    from rich.console import RenderableType


class BenchCommand:
    """Measures how batches scale."""

    summary = "measure how batches scale on this machine"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        add_json(parser)
        parser.add_argument("what", choices=("scale",), help="what to measure")
        parser.add_argument("--planner", default="mpc", metavar="NAME", help="default: %(default)s")
        parser.add_argument(
            "--predictor", default="growing-circle", metavar="NAME", help="default: %(default)s"
        )
        parser.add_argument(
            "--scenarios",
            type=_count,
            default=10,
            metavar="N",
            help="scenarios of suite-1 to drive with one and two workers (default: %(default)s)",
        )
        parser.add_argument(
            "--episodes",
            type=_count,
            default=10_000,
            metavar="N",
            help="tiny episodes that show what one costs the runner (default: %(default)s)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Measures.

        Raises:
            RegistryError: A plug-in cannot be found.
            RunError: A run cannot go on.
            FileError: A file cannot be written.
        """
        from dosplan.running.scaling import measure_scale

        figures = measure_scale(
            options.planner,
            options.predictor,
            options.scenarios,
            options.episodes,
            lambda what: print(what, file=sys.stderr),
        )
        show(_tables(figures), figures, options.json)
        return OK


def _tables(figures: dict[str, Any]) -> list[RenderableType]:
    """The figures of ``measure_scale``, to be printed one after another."""
    from dosplan.report.tables import table

    runs = {f"workers: {workers}": run for workers, run in figures["drive"].items()}
    runs["tiny, workers: 2"] = figures["tiny"]
    measured = [
        [name.replace("_", " "), *(f"{run[name]:.4g}" for run in runs.values())]
        for name in figures["tiny"]
    ]
    single = {
        "part": {**figures["start"], **figures["parts"]},
        "a million scenarios": figures["million"],
    }
    return [
        table(["run", *runs], measured),
        *(
            table([title, ""], [[n.replace("_", " "), f"{v:.4g}"] for n, v in values.items()])
            for title, values in single.items()
        ),
    ]


def _count(text: str) -> int:
    """A number of at least two, as argparse wants it."""
    if (value := int(text)) < 2:
        raise argparse.ArgumentTypeError(f"{value} is too few; give 2 or more")
    return value
