"""``dosplan convert``: recorded traffic of other data sets as CommonRoad files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, Final

from dosplan.cli.arguments import add_json, console, show
from dosplan.cli.command import OK, Command

_EXAMPLES: Final = """\
examples:
  dosplan convert sind Data/Tianjin/8_2_1 --out sind
  dosplan evaluate sind/recordings --predictor constant-velocity
  dosplan run sind/scenarios
"""


class ConvertCommand:
    """Makes CommonRoad files of recorded traffic."""

    summary = "make CommonRoad files of a record of another data set: SinD"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.epilog = _EXAMPLES
        add_json(parser)
        parser.add_argument("format", choices=("sind",), help="format of the record")
        parser.add_argument("record", type=Path, metavar="RECORD_DIR", help="folder of the record")
        parser.add_argument(
            "--out",
            type=Path,
            required=True,
            metavar="DIR",
            help="folder for recordings/ (all of the record, for predictors) and scenarios/ "
            "(an episode for each car that makes one, for planners)",
        )
        parser.add_argument(
            "--map",
            type=Path,
            metavar="FILE",
            help="Lanelet2 map (default: the one .osm file in RECORD_DIR or beside it)",
        )

    def run(self, options: argparse.Namespace) -> int:
        """Converts, and shows what was made.

        Raises:
            ScenarioError: The record or its map cannot be used.
            FileError: A file cannot be written.
        """
        from dosplan.convert.files import convert_sind
        from dosplan.report.progress import show_progress

        with show_progress(console(stderr=True), "cars") as progress:
            figures = convert_sind(options.record, options.out, options.map, progress)
        show([_line(figures, options.out)], figures, options.json)
        return OK


def _line(figures: dict[str, Any], out: Path) -> str:
    tracks = ", ".join(f"{number} {label}" for label, number in figures["tracks"].items())
    refused = ", ".join(f"{number} {why}" for why, number in figures["refused"].items())
    return (
        f"{figures['record']}: {tracks} in {figures['seconds']:.0f} s on {figures['lanelets']} "
        f"lanelets with {figures['lights']} lights\n"
        f"wrote {figures['recordings']} to {out / 'recordings'}, "
        f"{figures['scenarios']} to {out / 'scenarios'}"
        + (f" (moments refused: {refused})" if refused else "")
    )


CONVERT: Final[Command] = ConvertCommand()
